"""The arm of a rehearsal: as arms typically turn out to be, and as they change afterwards."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from excitant.robots.effects import Effect, standard_effects
from excitant.robots.motion import Array, read_only
from excitant.robots.plant.nominal import typical_motion
from excitant.robots.plant.planting import plant
from excitant.robots.robot import Robot
from excitant.robots.virtual_arm import (
    HiddenEffect,
    VirtualArm,
    draw_hidden_effect,
    industrial_sensors,
    nominal_truth,
    typical_torque,
    virtual_arm,
)

_DRIVES = {
    "viscous_friction": "viscous",
    "coulomb_friction": "coulomb",
    "torque_offset": "offset",
    "rotor_inertia": "rotor",
}
"""Effects that every drive has, and the plant's array of each."""

_CHANGES = ("payload", "viscous_friction", "coulomb_friction")
_SHARE = {"viscous": 0.1, "coulomb": 0.04, "rotor": 0.1, "offset": 0.01}  # of the torque limit
_TOLERANCE = 0.05  # of masses, centres of mass and inertias


def rehearsal_arm(robot: Robot, rng: np.random.Generator) -> VirtualArm:
    """An arm like the robot, with drives, wrong inertias, and sensors as industry has them.

    Masses, centres of mass and inertias are off by up to 5 %. Of the joint's torque limit, Coulomb
    friction takes about 4 %, viscous friction 10 % at the highest speed, the rotor 10 % at the
    highest acceleration, an offset 1 %, as datasheets of geared arms have it; where the robot
    knows such values of its own, they are planted instead. All are off by up to 5 % from what the
    controller of the arm believes. The arm's torque has no limits, so that what a motion would
    need can be compared with them.
    """
    free = replace(robot.limits, torque=np.full(robot.nv, np.inf))
    return virtual_arm(
        robot.with_limits(free).with_effects(_drives(robot, rng)), rng, hidden=(),
        tolerance=_TOLERANCE, sensors=industrial_sensors(robot.with_effects(())),
    )  # fmt: skip


def _drives(robot: Robot, rng: np.random.Generator) -> list[Effect]:
    """Friction, offset and rotor inertia of all joints, as known or else as usual."""
    known = robot.with_effects([e for e in robot.effects if e.name in _DRIVES])
    given, limit = nominal_truth(known).drives, robot.limits.torque
    strength = np.where(np.isfinite(limit), limit, 4 * typical_torque(robot))
    _, dq, ddq = (2 * np.abs(x).max(axis=0) for x in typical_motion(robot))  # close to the limits
    per_unit = {"viscous": dq, "rotor": ddq, "offset": rng.choice([-1.0, 1.0], robot.nv)}
    effects = []
    for effect in standard_effects(robot.joints):
        drive = _DRIVES[effect.name]
        own = getattr(given, drive)
        usual = _SHARE[drive] * strength / per_unit.get(drive, 1.0)
        effects.append(replace(effect, values=tuple(np.where(own != 0, own, usual).tolist())))
    return effects


def draw_change(robot: Robot, rng: np.random.Generator) -> HiddenEffect:
    """What may change after identification: a payload, or more friction on one joint."""
    while True:
        effect = draw_hidden_effect(robot, rng)
        if effect.effect in _CHANGES:
            return effect


def changed(arm: VirtualArm, effect: HiddenEffect) -> VirtualArm:
    """The same arm later."""
    truth = plant(arm.truth, arm.nominal.joints, [effect])
    return replace(arm, truth=truth, hidden=(*arm.hidden, effect))


def planted_parameters(arm: VirtualArm, effects: tuple[Effect, ...]) -> Array:
    """True standard parameters of the links, then those of the effects, shape (p,).

    Args:
        arm: The arm.
        effects: Standard effects, each on all joints.
    """
    bodies = [body.toDynamicParameters() for body in list(arm.truth.model.inertias)[1:]]
    drives = [getattr(arm.drives, _DRIVES[effect.name]) for effect in effects]
    return read_only(np.concatenate([*bodies, *drives]))
