"""The same two tasks for others and for excitant: torque of unseen data; see README.md."""

import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

Table = dict[str, np.ndarray]
CUTOFF_HZ = 10.0
WINDOW_S = 1.0  # of a simulation that starts in a recorded state


def read(folder: Path, task: str) -> tuple[list[str], list[Table]]:
    """Joints of a task, and its tables to fit and held out: t, q, dq, tau."""
    joints = (folder / f"{task}.txt").read_text(encoding="utf-8").split()
    found = []
    for part in ("fit", "held"):
        rows = np.loadtxt(folder / f"{task}-{part}.csv", delimiter=",", skiprows=1)
        t, *signals = np.split(rows, [1, *(1 + len(joints) * k for k in (1, 2))], axis=1)
        found.append({"t": t[:, 0]} | dict(zip(("q", "dq", "tau"), signals, strict=True)))
    return joints, found


def say(who: str, task: str, held: Table, predicted: np.ndarray, seconds: float) -> None:
    rms = np.sqrt(np.mean((held["tau"] - predicted) ** 2, axis=0))
    share = 100 * rms / held["tau"].std(axis=0)
    listed = " ".join(f"{x:.3f}" for x in rms), " ".join(f"{x:.1f}" for x in share)
    print(f"{task:7s}{who:10s}rms [N·m] {listed[0]}; nrmse [%] {listed[1]}; {seconds:.1f} s")


def derived(table: Table) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions through a zero-phase filter, and their differences."""
    from scipy.signal import butter, filtfilt

    step = float(np.median(np.diff(table["t"])))
    q = filtfilt(*butter(4, CUTOFF_HZ, fs=1 / step), table["q"], axis=0)
    dq = np.gradient(q, step, axis=0)
    return q, dq, np.gradient(dq, step, axis=0)


def make(folder: Path) -> None:
    """Write the tasks, and run what needs no environment of its own."""
    import pandas as pd
    from common import DATA

    import excitant as ex
    from excitant.identify.export import model_files

    planar, rng = ex.load_robot("planar_2r"), np.random.default_rng(5)
    arm = ex.virtual_arm(planar, rng, hidden=(), tolerance=0.03)
    logs = [arm.record(ex.random_trajectory(planar, rng, 10.0, 5), 10.0, rng) for _ in range(2)]
    tasks = {"planar": (planar, [ex.recording_from_table(x, 2, file="x", name="x") for x in logs])}
    if (DATA / "ur10").is_dir():
        ur10 = ex.load_dataset(DATA / "ur10")
        [whole] = ur10.recordings([])
        parts = [whole.between(0, 0.7, "first"), whole.between(0.7, 1, "last")]
        tasks["ur10"] = (ur10.robot, parts)
    folder.mkdir(parents=True, exist_ok=True)
    for task, (robot, recordings) in tasks.items():
        for name, text in model_files(robot, task, f"{task}.yaml").items():
            (folder / name).write_text(text, encoding="utf-8")
        (folder / f"{task}.txt").write_text(" ".join(robot.joints), encoding="utf-8")
        for part, r in zip(("fit", "held"), recordings, strict=True):
            table = pd.DataFrame(np.column_stack([r.t, r.q, r.dq, r.tau]))
            table.to_csv(folder / f"{task}-{part}.csv", index=False)
        begin = time.perf_counter()
        found = ex.identify_robot(robot, recordings[:1], validate=recordings[1:])
        spent, kept = time.perf_counter() - begin, found.holdout
        for who, torque in (("given", found.predicted_given), ("excitant", found.predicted)):
            say(who, task, {"tau": kept.raw}, torque, spent)
        pinocchio(folder, task)


def pinocchio(folder: Path, task: str) -> None:
    """What a short script does: least squares of all columns, with the smallest solution."""
    import pinocchio as pin

    begin = time.perf_counter()
    model = pin.buildModelFromUrdf(str(folder / f"{task}.urdf"))
    data = model.createData()

    def columns(table: Table) -> np.ndarray:
        rows = []
        for q, dq, ddq in zip(*derived(table), strict=True):
            bodies = pin.computeJointTorqueRegressor(model, data, q, dq, ddq)
            own = [np.diag(x) for x in (ddq, dq, np.sign(dq), np.ones(model.nv))]
            rows.append(np.hstack([bodies, *own]))
        return np.array(rows)

    _, (fit, held) = read(folder, task)
    W = columns(fit)
    x = np.linalg.lstsq(W.reshape(-1, W.shape[2]), fit["tau"].ravel(), rcond=None)[0]
    say("Pinocchio", task, held, columns(held) @ x, time.perf_counter() - begin)
    print(f"{'':17s}masses [kg] {x[: 10 * model.nv : 10].round(2)}")


def figaroh(folder: Path, task: str) -> None:
    """FIGAROH's weighted least squares, with friction, offsets and rotors, by its classes."""
    import yaml
    from figaroh.identification.base_identification import BaseIdentification
    from figaroh.tools.robot import load_robot
    from figaroh_driver import activate, settings

    joints, tables = read(folder, task)
    rate = float(1 / np.median(np.diff(tables[0]["t"])))

    class Identification(BaseIdentification):  # type: ignore[misc]
        def load_trajectory_data(self, data_source: str | None = None) -> dict[str, Any]:
            table = tables[data_source == "held"]
            named = {"timestamps": table["t"], "positions": table["q"], "torques": table["tau"]}
            return named | {"velocities": None, "accelerations": None}

    with tempfile.NamedTemporaryFile("w", suffix=".yaml") as file:
        yaml.safe_dump(settings(joints, rate, CUTOFF_HZ, drives=True), file)
        file.flush()
        begin = time.perf_counter()
        robot = load_robot(str(folder / f"{task}.urdf"), load_by_urdf=True)
        found = Identification(robot, file.name)
    activate(found, robot, joints)
    found._load_validation_data("held")
    found.solve(plotting=False, wls=True)
    judged = found.result["validation_metrics"]["per_joint"].values()
    rms = np.array([each["rmse_identified"] for each in judged])
    held = tables[1]
    say("FIGAROH", task, held, held["tau"] + rms, time.perf_counter() - begin)


def mujoco(folder: Path, task: str) -> None:
    """MuJoCo's sysid: masses, centres, damping, friction and armatures by simulated windows."""
    import mujoco as mj
    from mujoco import sysid

    joints, (fit, held) = read(folder, task)
    sensors = "".join(f'<jointpos name="{j}" joint="{j}"/>' for j in joints)
    text = (folder / f"{task}.xml").read_text(encoding="utf-8")
    text = text.replace("</actuator>", f"</actuator><sensor>{sensors}</sensor>")
    spec, step = mj.MjSpec.from_string(text), float(np.median(np.diff(fit["t"])))
    for actuator in spec.actuators:
        actuator.ctrllimited = 0
    spec.option.timestep = step
    model, n = spec.compile(), round(WINDOW_S / step)
    t, runs = step * np.arange(n), []
    for k in range(0, len(fit["t"]) - n, n):
        q, dq, tau = (fit[key][k : k + n] for key in ("q", "dq", "tau"))
        state = sysid.create_initial_state(model, q[0], dq[0])
        seen = sysid.TimeSeries.from_names(t, q, model)
        runs.append((f"{k}", state, sysid.TimeSeries(t, tau), seen))
    params = sysid.ParameterDict()
    for body in spec.worldbody.find_all("body"):
        params.add(sysid.body_inertia_param(spec, model, body.name))
    for joint in joints:
        for name in ("damping", "frictionloss", "armature"):
            value = float(np.ravel(getattr(spec.joint(joint), name))[0])

            def put(s: Any, p: Any, joint: str = joint, name: str = name) -> None:
                old = np.array(getattr(s.joint(joint), name), float)
                old.flat[0] = p.value[0]
                setattr(s.joint(joint), name, old if old.ndim else float(old))

            most = 100.0
            params.add(sysid.Parameter(f"{joint}.{name}", value or 0.1, 0.0, most, modifier=put))
    begin, columns = time.perf_counter(), [list(x) for x in zip(*runs, strict=True)]
    residual = sysid.build_residual_fn(
        models_sequences=[sysid.ModelSequences(task, spec, *columns)]
    )
    found, _ = sysid.optimize(params, residual, optimizer="mujoco", verbose=False, max_iters=30)
    model = sysid.apply_param_modifiers_spec(found, spec.copy()).compile()
    model.opt.disableflags |= mj.mjtDisableBit.mjDSBL_LIMIT
    data, predicted = mj.MjData(model), np.empty_like(held["tau"])
    for k, (q, dq, ddq) in enumerate(zip(*derived(held), strict=True)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, dq, ddq
        mj.mj_inverse(model, data)
        predicted[k] = data.qfrc_inverse
    say("MuJoCo", task, held, predicted, time.perf_counter() - begin)
    print(f"{'':17s}masses [kg] {model.body_mass[1:].round(3)}")


if __name__ == "__main__":
    place, *who = sys.argv[1:]
    if not who:
        make(Path(place))
    for task_file in sorted(Path(place).glob("*.txt")) if who else ():
        {"figaroh": figaroh, "mujoco": mujoco}[who[0]](Path(place), task_file.stem)
