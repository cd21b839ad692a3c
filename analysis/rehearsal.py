"""`rehearse`: a motion tried on a virtual arm, up to what it recovers of it.

The arm is the robot with typical friction, rotor inertia and offsets planted, its inertias a
little wrong, seen by industrial sensors. It runs the motion, and once more at 80 % of the speed as
hold-out; the whole pipeline must then find again what was planted. Finally the arm changes, by a
payload or more friction, and the diagnosis of the identified model must name the change.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from excitant.analysis.diagnosis import Diagnosis, diagnose
from excitant.analysis.rehearsal_arm import (
    changed,
    draw_change,
    planted_parameters,
    rehearsal_arm,
)
from excitant.analysis.rehearsal_items import (
    Item,
    Situation,
    coverage_item,
    diagnosis_item,
    friction_items,
    limit_items,
    other_motions_item,
    prediction_item,
    undetermined_item,
)
from excitant.exceptions import RankDeficient
from excitant.identify import Estimate, Recording, identify, recording_from_table
from excitant.robots.effects import standard_effects
from excitant.robots.html_table import html_table
from excitant.robots.motion import Array
from excitant.robots.plant.sensors import Run, recorded
from excitant.robots.robot import Robot
from excitant.robots.virtual_arm import HiddenEffect, VirtualArm

Path = Callable[[Array, int], Array]
Progress = Callable[[float, str], None]

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
    slow = _slower(path), duration / _SLOWER
    held = _recording(arm, arm.run(*slow, rng), "slower", rng)
    tell(0.35, "identifying")
    try:
        estimates = [identify(robot, [_recording(arm, run, "motion", rng)], validate=[held])]
        for _ in range(max(_READINGS, -(-_CASES // len(estimates[0].base))) - 1):
            reading = _recording(arm, run, "motion", rng)
            estimates.append(identify(robot, [reading], validate=[held]))
    except RankDeficient as error:
        return Rehearsal(*common, (*items, undetermined_item(situation, error)))
    tell(0.55, "running it on the changed arm")
    later = changed(arm, change)
    recordings = [
        _recording(later, later.run(p, d, rng), name, rng)
        for name, p, d in (("motion after the change", path, duration), ("slower after it", *slow))
    ]
    tell(0.8, "diagnosing")
    found = diagnose(estimates[0].model, recordings[:1], validate=recordings[1:])
    items = (*items, *_recovered(situation, estimates), diagnosis_item(situation, found, change))
    return Rehearsal(*common, items, estimates[0], found)


def _recovered(situation: Situation, estimates: Sequence[Estimate]) -> tuple[Item, ...]:
    """Whether estimates agree with the arm."""
    robot = situation.robot
    planted = planted_parameters(situation.arm, standard_effects(robot.joints))
    beta = estimates[0].base.regrouping @ planted
    return (
        *friction_items(situation, estimates[0], beta),
        coverage_item(situation, estimates, beta),
        prediction_item(situation, estimates[0], beta),
        other_motions_item(situation, estimates[0], beta),
    )


def _slower(path: Path) -> Path:
    """The same path at 80 % of the speed."""

    def slow(t: npt.ArrayLike, order: int = 0) -> Array:
        return _SLOWER**order * path(_SLOWER * np.asarray(t, float), order)

    return slow


def _recording(arm: VirtualArm, run: Run, name: str, rng: np.random.Generator) -> Recording:
    """One reading of a run; every reading has other noise."""
    table = recorded(run, arm.sensors, arm.truth.recorder, arm.drives.offset, rng)
    return recording_from_table(table, arm.nominal.nv, file=name, name=name)
