"""How closely arms follow by given and by identified models, and models follow recordings.

See README.md.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from threadpoolctl import threadpool_limits
from worlds_plant import Plant

from excitant.analysis.rehearsal import changed, rehearse, with_strength
from excitant.analysis.tracking import track
from excitant.design import random_trajectory
from excitant.identify import Estimate, identify_robot, load_dataset, recording_from_table
from excitant.identify.export import model_files
from excitant.identify.preprocessing import Segment
from excitant.robots import Robot, load_robot
from excitant.robots.plant import arm as plant
from excitant.robots.plant.sensors import Run
from excitant.robots.virtual_arm import VirtualArm, nominal_truth, virtual_arm

_STEP = 1e-3  # s, of the simulation
_FINE = 1e-4  # s, under control: damping of the loop is explicit in MuJoCo
_TEST, _HARMONICS = 5.0, 4  # s, of the motion that is followed
_PIECE = 3.0  # s, of simulation from a recorded state
_LOST = 2.0  # rad or m: the model has run away
_YIELD = 0.2  # rad or m: the loop bears the recorded torque there

Case = tuple[str, Estimate]  # where a recording came from, and its estimate


@dataclass(frozen=True, eq=False)
class MuJoCoArm:
    """A virtual arm whose bodies, rotors, viscous and dry friction are MuJoCo's."""

    arm: VirtualArm

    @cached_property
    def model(self) -> Any:
        """MuJoCo's model of the true arm, which moves without limits."""
        truth, nominal = self.arm.truth, self.arm.nominal
        phi = np.concatenate([b.toDynamicParameters() for b in list(truth.model.inertias)[1:]])
        drives = truth.drives
        if drives.stribeck.any() or truth.dry or truth.loads or truth.gears or truth.presliding:
            raise NotImplementedError("effects that MuJoCo does not have")
        model = Plant(nominal.with_parameters(phi), drives.viscous, drives.coulomb).model
        model.dof_damping[:], model.dof_frictionloss[:] = drives.viscous, drives.coulomb
        model.dof_armature[:] = drives.rotor
        # dry friction as stiff as the step allows; by default it creeps
        model.dof_solref[:], model.dof_solimp[:, :2] = (2 * _FINE, 1.0), 0.9999
        model.opt.timestep = _FINE
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        return model

    def follow(
        self,
        path: plant.Trajectory,
        duration: float,
        torque: Callable[[np.ndarray], np.ndarray],
        rng: np.random.Generator,
    ) -> Run:
        """As `VirtualArm.follow`, by the same controller."""
        arm, sensors, offset = self.arm, self.arm.sensors, self.arm.truth.drives.offset
        known = nominal_truth(arm.nominal)
        believed = plant.Believed(known.model, known.drives, lambda t: torque(t) - offset)
        noise = plant.ReadingNoise(sensors.position_resolution, sensors.velocity_noise, rng)
        t = np.arange(0.0, duration + _FINE / 2, _FINE)
        chunks = np.array_split(t, max(1, len(t) // 2000))
        data, kept = mujoco.MjData(self.model), []
        data.qpos[:] = path(t[:1], 0)[0]
        for chunk in chunks:
            control = plant.tracking_controller(arm.nominal, believed, path, chunk, noise)
            for k in range(len(chunk)):
                tau = control(k, data.qpos, data.qvel)
                kept.append((data.qpos.copy(), data.qvel.copy(), tau, data.qpos.copy()))
                data.qfrc_applied[:] = tau
                mujoco.mj_step(self.model, data)
        return Run(t, *(np.array(x) for x in zip(*kept, strict=True)))


def controlled(name: str, seed: int) -> None:
    """Tracking errors of a motion by each model, on the plant and in MuJoCo."""
    robot, rng = load_robot(name), np.random.default_rng(seed)
    found = rehearse(robot, random_trajectory(robot, rng, 10.0, 5), 10.0, rng)
    if found.estimate is None or found.diagnosis is None:
        print(f"\n{name}: the motion leaves parameters open")
        return
    path, noise = random_trajectory(robot, rng, _TEST, _HARMONICS), int(rng.integers(2**32))
    models = {"given": robot, "identified": found.estimate.model}
    later = models | {"extended": found.diagnosis.extension.model}
    known = with_strength(robot)
    print(f"\n{name}, virtual; changes by {found.change.effect} at {found.change.joint}")
    pairs = (("as identified", found.arm, models), ("changed", None, later))
    for when, arm, by in pairs:
        true = replace(arm or changed(found.arm, found.change), nominal=known)
        for judge, each in (("plant", true), ("MuJoCo", MuJoCoArm(true))):
            tracked = track(each, by, path, _TEST, np.random.default_rng(noise))
            for model, rms in zip(tracked.models, tracked.rms, strict=True):
                joints = " ".join(f"{1e3 * x:7.3f}" for x in rms)
                print(f"  {when:13s} {judge:6s} {model:10s} rms [mrad] {joints}")
            joints = " ".join(f"{x:7.1f}" for x in tracked.ratio)
            print(f"  {when:13s} {judge:6s} {'ratio':10s}            {joints}", flush=True)


def simulated(name: str, seed: int) -> Case:
    robot, rng = load_robot(name), np.random.default_rng(seed)
    arm = virtual_arm(robot, rng)
    tables = [arm.record(random_trajectory(robot, rng, 10.0, 5), 10.0, rng) for _ in range(2)]
    fit, held = (recording_from_table(x, robot.nv, file="x.parquet", name="x") for x in tables)
    hidden, found = arm.hidden[0], identify_robot(robot, [fit], validate=[held])
    return f"{name}, virtual, hides {hidden.effect} at {hidden.joint}", found


def loaded(robot: Robot, gains: np.ndarray | None) -> mujoco.MjModel:
    """The robot's MJCF in MuJoCo, with controls that nothing clamps."""
    model = mujoco.MjModel.from_xml_string(
        model_files(robot, "arm", "arm.yaml", ["mjcf"], gains)["arm.xml"]
    )
    model.opt.timestep = _STEP
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL
    return model


def mean_inertia(model: mujoco.MjModel, segment: Segment) -> np.ndarray:
    """Mean inertia of each joint over a motion, shape (nv,) [kg·m²]."""
    data, inertia = mujoco.MjData(model), []
    dense = np.zeros((model.nv, model.nv))
    for q in segment.motion.q[:: max(1, len(segment.motion) // 50)]:
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, dense)
        inertia.append(np.diag(dense).copy())
    return np.asarray(np.mean(inertia, axis=0), float)


def squared_error(
    model: mujoco.MjModel, segment: Segment, rows: slice, stiffness: np.ndarray, omega: float
) -> np.ndarray:
    """Squared tracking error of one piece at every step, shape (n, nv) [rad² or m²].

    The loop's damping is part of the model, where the integrator takes it implicitly.
    """
    motion, tau = segment.motion[rows], segment.tau[rows]
    damping = 2 * stiffness / omega
    data, own = mujoco.MjData(model), np.array(model.dof_damping)
    model.dof_damping[:] = own + damping
    data.qpos[:], data.qvel[:] = motion.q[0], motion.dq[0]
    steps = np.arange(motion.t[0], motion.t[-1], _STEP)
    sampled = (motion.q, motion.dq, tau)
    wanted = [np.column_stack([np.interp(steps, motion.t, x) for x in y.T]) for y in sampled]
    error, lost = np.empty((len(steps), model.nv)), False
    for k in range(len(steps)):
        error[k] = wanted[0][k] - data.qpos
        lost = lost or not np.isfinite(error[k]).all() or bool(np.abs(error[k]).max() > _LOST)
        if lost:
            error[k] = error[k - 1]
            continue
        data.qfrc_applied[:] = stiffness * error[k] + damping * wanted[1][k]
        data.ctrl[:] = wanted[2][k]
        mujoco.mj_step(model, data)
    model.dof_damping[:] = own
    return np.asarray(error**2, float)


def tracking(
    model: mujoco.MjModel, segments: Sequence[Segment], stiffness: np.ndarray, omega: float
) -> np.ndarray:
    """Root mean square tracking error per joint over all pieces, shape (nv,) [rad or m]."""
    errors = []
    for segment in segments:
        length, edge = int(_PIECE * segment.rate_hz), segment.keep.start
        for start in range(edge, max(edge + 1, len(segment.motion) - edge - length // 2), length):
            rows = slice(start, min(start + length, len(segment.motion) - edge))
            errors.append(squared_error(model, segment, rows, stiffness, omega))
    return np.asarray(np.sqrt(np.concatenate(errors).mean(axis=0)), float)


def report(case: Case, bandwidths: Sequence[float]) -> None:
    name, found = case
    gains = found.gains if found.data.unit == "A" else None
    models = [loaded(robot, gains) for robot in (found.given, found.model)]
    segments = found.data.validate
    inertia = np.mean([mean_inertia(model, segments[0]) for model in models], axis=0)
    nrmse = [float(np.nansum(x.nrmse)) for x in (found.baseline, found.validate)]
    print(f"\n{name}: hold-out nrmse, sum of joints, {nrmse[0]:.3g} → {nrmse[1]:.3g}")
    torque = np.sqrt(np.mean((segments[0].tau * found.gains) ** 2, axis=0))
    for omega in bandwidths:
        stiffness = np.maximum(omega**2 * inertia, torque / _YIELD)
        before, after = (tracking(model, segments, stiffness, omega) for model in models)
        joints = " ".join(f"{b / a:7.2f}" for b, a in zip(before, after, strict=True))
        first, second = (1e3 * float(np.sqrt((x**2).mean())) for x in (before, after))
        print(f"  loop of {omega:4g} rad/s: rms {first:8.3f} → {second:8.3f} mrad, "
              f"ratio {first / second:6.2f}; per joint {joints}")  # fmt: skip


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("EXCITANT_DATA", beside)))
    parser.add_argument("--sets", nargs="*", default=["ur10", "panda"])
    parser.add_argument("--robots", nargs="*", default=["planar_2r", "ur10", "panda"])
    parser.add_argument("--bandwidth", nargs="+", type=float, default=[5.0, 20.0],
                        help="of the position loops [rad/s]")  # fmt: skip
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args(words)
    with threadpool_limits(1):
        for name in args.robots:
            controlled(name, args.seed)
            report(simulated(name, args.seed), args.bandwidth)
        for name in args.sets:
            if not (args.data / name).is_dir():
                print(f"\n{name}: no recordings in {args.data}; set EXCITANT_DATA")
                continue
            dataset = load_dataset(args.data / name)
            for run in dataset.recordings([]):
                found = identify_robot(dataset.robot, [run])
                report((f"{name}, {run.name}", found), args.bandwidth)


if __name__ == "__main__":
    main()
