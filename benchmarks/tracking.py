"""How closely arms follow by given, identified and extended models; see README.md."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import common
import mujoco
import numpy as np
from worlds_plant import Plant

from excitant.analysis.rehearsal import changed, rehearse, with_strength
from excitant.analysis.tracking import track
from excitant.design import random_trajectory
from excitant.robots import load_robot
from excitant.robots.plant import arm as plant
from excitant.robots.plant.sensors import Run
from excitant.robots.virtual_arm import VirtualArm, nominal_truth

_FINE = 1e-4  # s, under control: damping of the loop is explicit in MuJoCo
_TEST, _HARMONICS = 5.0, 4  # s, of the motion that is followed


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


def main(*, robots: Sequence[str] = ("planar_2r", "ur10", "panda"), seed: int = 0) -> None:
    """Identify virtual arms, change and diagnose them, and follow another motion."""
    for name in robots:
        controlled(name, seed)


if __name__ == "__main__":
    common.run(main)
