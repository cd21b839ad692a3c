"""Every command on arms that are not six revolute joints with a sound inertia each."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
from marks import slow
from robustness_inputs import ExtremeArm, motion
from urdf_arms import urdf_of

from excitant.identify import identify_robot, load_recording
from excitant.robots import Robot, load_robot

X, Y, Z = "1 0 0", "0 1 0", "0 0 1"
ONE, SLIDE = {"axis": Y}, {"kind": "prismatic", "low": -0.4, "high": 0.4}
WRIST = [{"axis": Z}, {"axis": Y}, {"axis": Y}, {"axis": Z}, {"axis": Y}, {"axis": Z}]
KINDS: dict[str, list[dict[str, Any]]] = {
    "one joint": [ONE],
    "one joint about the vertical": [{"axis": Z}],
    "one sliding joint": [SLIDE],
    "last link without inertia": [ONE, ONE | {"inertia": 0.0}],
    "last link without mass": [{"axis": Z}, ONE, ONE | {"mass": 0.0, "inertia": 0.0}],
    "continuous": [{"axis": Z, "kind": "continuous"}, ONE],
    "angles in seven digits": [{"rpy": f"{angle} 0 0"} for angle in (1.5707963, -1.57, 1.5707963)],
    "coupled joint, held": [ONE, ONE, ONE | {"more": '<mimic joint="joint2"/>'}],
    "selective compliance": [{}, {"xyz": "0.3 0 0"}, SLIDE | {"xyz": "0.3 0 0"}, {"xyz": "0 0 0"}],
    "two sliding joints": [SLIDE, SLIDE | {"axis": X}],
    "continuous alone": [{"axis": Y, "kind": "continuous"}],
    "no gravity": [SLIDE | {"axis": X}, {"axis": Y}],
    "axes along gravity": [{}, {"xyz": "0.3 0 0"}],
    "almost no last link": [{"axis": Z}, ONE, ONE | {"mass": 1e-6, "inertia": 1e-9}],
    "wrist without inertia": [*WRIST[:-1], WRIST[-1] | {"inertia": 0.0}],
    "twelve joints": WRIST * 2,  # along one chain
}
FAST = {"one sliding joint", "last link without inertia"}
EVERY_VERB = ("one sliding joint", "no gravity", "axes along gravity", "almost no last link")
HIDDEN = 1.0  # N·m or N of Coulomb friction at every joint


def description(kind: str) -> str:
    joints = enumerate(KINDS[kind], start=1)
    return urdf_of(*({"mass": 3 / k, "inertia": 0.02 / k} | joint for k, joint in joints))


def recorded(robot: Robot, seed: int) -> pd.DataFrame:
    """Time, positions and torque of an arm whose bodies are 5 % heavier and whose joints rub."""
    rng, t = np.random.default_rng(seed), np.arange(0, 10, 0.01)
    model, n = robot.model.copy(), robot.nv
    unknown = pin.Inertia(0.3, np.array([0.05, 0.02, 0.1]), 1e-3 * np.eye(3))
    for k, body in enumerate(1.05 * robot.phi.reshape(n, 10), start=1):
        true = pin.Inertia.FromDynamicParameters(body) if body[0] > 0 else unknown
        model.inertias[k] = true
    scale = np.where(robot.revolute, 1.0, 0.3)
    true = ExtremeArm(robot.name, {}, model, np.full(n, HIDDEN), scale)
    return true.table(rng, t, motion(rng, t, scale))


def as_currents(table: pd.DataFrame, gains: Any) -> pd.DataFrame:
    read = table.filter(like="tau") / gains
    return table.drop(columns=read).join(read.rename(columns=lambda name: name.replace("tau", "i")))


def prepared(kind: str) -> tuple[str, Robot]:
    """The arm as a file, and two recordings of it; what to give to a command, and the robot."""
    Path("arm.urdf").write_text(description(kind))
    given = "model: arm.urdf\n"
    given += "lock: {joint2: 0.0, joint3: 0.0}\n" if "mimic" in description(kind) else ""
    given += "gravity: [0, 0, 0]\n" if kind == "no gravity" else ""
    Path("arm.yaml").write_text(given)
    robot = load_robot("arm.yaml")
    for seed in (1, 2):
        run = recorded(robot, seed)
        run.to_csv(f"run{seed}.csv", index=False)
        as_currents(run, 1.0).to_csv(f"currents{seed}.csv", index=False)
    return "arm.yaml", robot


@pytest.mark.parametrize("kind", [kind if kind in FAST else slow(kind) for kind in KINDS])
def test_every_command(kind: str, here: Path, excitant: Any) -> None:
    arm, robot = prepared(kind)
    runs = "run1.csv --validate run2.csv"
    options = {"analyze": "", "identify": runs, "diagnose": f"{runs} --no-experiments"}
    options["design"] = "--time-limit 0.5 --starts 1 --harmonics 3 --duration 6"
    found = {verb: excitant(f"{verb} {arm} {more} --json") for verb, more in options.items()}
    assert {verb: ran.err for verb, ran in found.items() if ran.status} == {}
    for joint in found["identify"].result["joints"]:
        assert joint["validate"]["r2"] > 0.99, joint
    causes = found["diagnose"].result["findings"]
    rubbing = {joint for f in causes if "friction" in f["effect"] for joint in f["joints"]}
    assert rubbing == {*robot.joints}


def test_currents_where_rotors_are_like_masses_have_no_known_gain(here: Path) -> None:
    """On a gantry without gravity: the currents are predicted, and no gain is told."""
    Path("arm.urdf").write_text(description("two sliding joints"))
    Path("arm.yaml").write_text("model: arm.urdf\ngravity: [0, 0, 0]\n")
    robot, gains = load_robot("arm.yaml"), np.array([3.0, 7.0])
    as_currents(recorded(robot, 1), gains).to_csv("run.csv", index=False)
    found = identify_robot(robot, [load_recording("run.csv", robot)])
    assert found.result()["drive_gain_Nm_per_A"] == [None, None]
    assert (found.validate.r2 > 0.99).all()


@pytest.mark.filterwarnings("error::RuntimeWarning", "error::scipy.linalg.LinAlgWarning")
@pytest.mark.parametrize("kind", [slow(k) for k in EVERY_VERB])
def test_every_verb_in_every_way(kind: str, here: Path, excitant: Any) -> None:
    """All verbs with all that changes their numerical core: a result each, and no warning."""
    arm, _ = prepared(kind)
    few = "--time-limit 4 --starts 1 --harmonics 3 --duration 6"
    runs = "run1.csv --validate run2.csv"
    commands = [
        f"robots {arm}",
        f"design {arm} {few} -o motion",
        f"design {arm} {few} --criterion a --columns inertial",
        f"design {arm} {few} --link-by-link",
        f"check {arm} motion/trajectory.json",
        f"simulate {arm} motion/trajectory.json -o simulated.csv --hidden",
        f"analyze {arm} --trajectory motion/trajectory.json",
        f"analyze {arm} --recording run1.csv",
        f"identify {arm} {runs} -o model",
        *(f"identify {arm} {runs} --estimator {name}" for name in ("irls", "iv")),
        f"identify {arm} {runs} --effects auto",
        f"identify {arm} {runs} --online",
        f"identify {arm} {runs} --link-by-link",
        f"identify {arm} run1.csv --payload --unloaded run2.csv",
        f"identify {arm} currents1.csv --validate currents2.csv",
        f"diagnose {arm} {runs} --experiment-time 2",
        f"diagnose {arm} currents1.csv --no-experiments",
        "report model",
    ]
    ran = {command: excitant(f"{command} --json") for command in commands}
    assert {command: found.err for command, found in ran.items() if found.status} == {}
