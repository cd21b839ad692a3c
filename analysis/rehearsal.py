"""`rehearse`: a motion tried on a virtual arm, up to what it recovers of it.

The arm is the robot with typical friction, rotor inertia and offsets planted, its inertias a
little wrong, seen by industrial sensors. It runs the motion, and once more at 80 % of the speed as
hold-out; the whole pipeline must then find again what was planted. Finally the arm changes, by a
payload or more friction, and the diagnosis of the identified model must name the change.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from excitant.analysis.diagnosis import Diagnosis, diagnose
from excitant.analysis.requirements import (
    Item,
    Situation,
    diagnosis_item,
    limit_items,
    recovery_items,
    undetermined_item,
)
from excitant.exceptions import RankDeficient
from excitant.identify import Estimate, Recording, identify_robot, recording_from_table
from excitant.robots.effects import Effect, standard_effects
from excitant.robots.html_table import html_table
from excitant.robots.motion import Array, read_only
from excitant.robots.plant.planting import plant
from excitant.robots.plant.sensors import Run
from excitant.robots.robot import Robot
from excitant.robots.virtual_arm import (
    HiddenEffect,
    VirtualArm,
    draw_hidden_effect,
    industrial_sensors,
    nominal_truth,
    typical_motion,
    typical_torque,
    virtual_arm,
)

Path = Callable[[Array, int], Array]
Progress = Callable[[float, str], None]

_CHANGES = ("payload", "viscous_friction", "coulomb_friction")
_SHARE = {"viscous": 0.1, "coulomb": 0.04, "rotor": 0.1, "offset": 0.01}  # of the torque limit
_TOLERANCE = 0.05  # of masses, centres of mass and inertias
_SLOWER = 0.8  # speed of the hold-out
_READINGS, _CASES = 6, 300  # of the same run, at least, and values of which intervals are judged


@dataclass(frozen=True, eq=False)
class Rehearsal:
    """What a motion recovered of a virtual arm.

    Attributes:
        robot: The robot as given, with the limits that count.
        duration: Length of the motion [s].
        arm: The arm that ran it.
        change: What the arm had beside that when it was diagnosed.
        run: What it did.
        items: What was required, in order.
        estimate: What was identified; None where the motion leaves parameters undetermined.
        diagnosis: What was diagnosed after the change; None without an estimate.
    """

    robot: Robot
    duration: float
    arm: VirtualArm
    change: HiddenEffect
    run: Run
    items: tuple[Item, ...]
    estimate: Estimate | None = None
    diagnosis: Diagnosis | None = None

    @property
    def passed(self) -> bool:
        """Whether the motion would do."""
        return all(item.passed for item in self.items)

    def result(self) -> dict[str, Any]:
        """Contents of result.json: what was required, and whether it was met."""
        failed = [item for item in self.items if not item.passed]
        limits = self.robot.limits
        return {
            "verb": "rehearse",
            "robot": self.robot.name,
            "joints": list(self.robot.joints),
            "duration": self.duration,
            "passed": self.passed,
            "headline": self.headline,
            "items": [asdict(item) for item in self.items],
            "advice": list(dict.fromkeys(item.advice for item in failed)),
            "effect": {
                "effect": self.change.effect,
                "joint": self.change.joint,
                "parameters": dict(self.change.parameters),
            },
            "limit_values": {
                name: getattr(limits, name) for name in ("position", "velocity", "torque")
            },
        }

    def series(self) -> dict[str, Array]:
        """The run of the motion on the virtual arm: t [s], q, dq, tau in SI units, (n, nv)."""
        run = self.run
        return {"t": run.t, "q": run.q, "dq": run.dq, "tau": run.tau}

    @property
    def headline(self) -> str:
        """The verdict in a sentence."""
        failed = [item for item in self.items if not item.passed]
        if not failed:
            count = len(self.items)
            return f"The motion would do: all {count} requirements are met on a virtual arm"
        names = list(dict.fromkeys(f"{x.name} of {x.joint}" if x.joint else x.name for x in failed))
        listed = ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
        return f"The motion would not do: {listed}"

    def _repr_html_(self) -> str:
        rows = [("met" if x.passed else "not met", x.name, x.joint, x.detail) for x in self.items]
        verdict = "would do" if self.passed else "would not do"
        heads = ("", "requirement", "joint", "figures")
        return html_table(f"Rehearsal: the motion {verdict}", heads, rows)


def rehearse(
    robot: Robot,
    path: Path,
    duration: float,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> Rehearsal:
    """Try a motion on a virtual arm.

    Args:
        robot: The arm as it is known, with its limits.
        path: ``path(t, order)``, shape (n, nv); from rest.
        duration: Length of the motion [s].
        rng: Draws the arm, its noise and its change.
        progress: Told the fraction done and what is being done.

    Raises:
        BadInput: The motion starts at speed, or an arm cannot follow it.
        BadRecording: The motion is too short to be identified from.
        BadRobot: Links without mass.
        Infeasible: The semidefinite solver failed.
    """
    tell = progress or (lambda fraction, words: None)
    tell(0.0, "running the motion")
    arm, change = rehearsal_arm(robot, rng), draw_change(robot, rng)
    run = arm.run(path, duration, rng)
    situation = Situation(robot, arm, run)
    common = (robot, duration, arm, change, run)
    items = limit_items(situation)
    tell(0.15, "running it slower")

    def slower(t: npt.ArrayLike, order: int = 0) -> Array:
        return _SLOWER**order * path(_SLOWER * np.asarray(t, float), order)

    slow = slower, duration / _SLOWER
    held = _recording(arm, arm.run(*slow, rng), "slower", rng)
    tell(0.35, "identifying")
    try:
        estimates = [identify_robot(robot, [_recording(arm, run, "motion", rng)], validate=[held])]
        for _ in range(max(_READINGS, -(-_CASES // len(estimates[0].base))) - 1):
            reading = _recording(arm, run, "motion", rng)
            estimates.append(identify_robot(robot, [reading], validate=[held]))
    except RankDeficient as error:
        items.append(undetermined_item(situation, error))
        return Rehearsal(*common, tuple(items))
    tell(0.55, "running it on the changed arm")
    later = changed(arm, change)
    recordings = [
        _recording(later, later.run(p, d, rng), name, rng)
        for name, p, d in (("motion after the change", path, duration), ("slower after it", *slow))
    ]
    tell(0.8, "diagnosing")
    found = diagnose(estimates[0].model, recordings[:1], validate=recordings[1:])
    planted = planted_parameters(arm, standard_effects(robot.joints))
    items += recovery_items(situation, estimates, planted)
    items.append(diagnosis_item(situation, found, change))
    return Rehearsal(*common, tuple(items), estimates[0], found)


def _recording(arm: VirtualArm, run: Run, name: str, rng: np.random.Generator) -> Recording:
    """One reading of a run; every reading has other noise."""
    table = arm.recorded(run, rng)
    return recording_from_table(table, arm.nominal.nv, file=name, name=name)


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
    given = robot.with_limits(free).with_effects(_drives(robot, rng))
    sensors = industrial_sensors(robot.with_effects(()))
    return virtual_arm(given, rng, hidden=(), tolerance=_TOLERANCE, sensors=sensors)


def _drives(robot: Robot, rng: np.random.Generator) -> list[Effect]:
    """Friction, offset and rotor inertia of all joints, as known or else as usual."""
    known = robot.with_effects([e for e in robot.effects if e.standard])
    given, limit = nominal_truth(known).drives, robot.limits.torque
    strength = np.where(np.isfinite(limit), limit, 4 * typical_torque(robot))
    _, dq, ddq = (2 * np.abs(x).max(axis=0) for x in typical_motion(robot))  # close to the limits
    per_unit = {"viscous": dq, "rotor": ddq, "offset": rng.choice([-1.0, 1.0], robot.nv)}
    effects = []
    for effect in standard_effects(robot.joints):
        drive = effect.joint_property
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
    drives = [getattr(arm.truth.drives, effect.joint_property) for effect in effects]
    return read_only(np.concatenate([*bodies, *drives]))
