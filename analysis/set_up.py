"""Installation of an arm, amended in the model before any other cause is looked for.

`excitant.identify.faults` finds it by a search with bodies near the nominal ones. Faults of the
data (signs, order, units, clock) are repaired, mounting and zero positions changed in the model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from excitant.analysis.evidence import Candidate
from excitant.analysis.selection import Rival
from excitant.identify.faults import Fault, check_recordings
from excitant.identify.faults.fault import INSTALLATION, PROVEN
from excitant.identify.faults.installation import Installation
from excitant.identify.recording import Recording
from excitant.robots.effects import (
    EFFECTS,
    Acts,
    Effect,
    Size,
    Words,
)
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot


def _detail(
    fault: DataFault, robot: Robot, joints: Sequence[str], sizes: Sequence[Size]
) -> str:
    return f"{fault.detail[:1].upper()}{fault.detail[1:]} (repaired)"


@dataclass(frozen=True)
class DataFault(Effect):
    """A fault of the data that was repaired, as a cause of the given model's errors."""

    family = "set-up"
    acts_on = Acts.EACH
    words = Words("time", sentence=_detail)
    fault: str = ""
    detail: str = ""

    @property
    def name(self) -> str:  # type: ignore[override]
        """The fault."""
        return self.fault

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """It has none."""
        return np.zeros((len(motion), robot.nv, 0))


@dataclass(frozen=True, eq=False)
class SetUp:
    """An arm as it is installed.

    Attributes:
        given: The nominal robot.
        robot: The robot with the estimated mounting and zero positions.
        std: Standard deviations of these: of each joint's zero position, by its name, or of gravity
            along three axes.
        repaired: Faults of the data that are repaired, by recording.
        notes: What was done, a sentence each.
        shown: Faults of the arm, which all recordings share.
        standing: Faults that leave every figure wrong and that nothing repairs, a sentence each.
    """

    given: Robot
    robot: Robot
    std: dict[str, tuple[float, ...]]
    repaired: dict[str, tuple[Fault, ...]]
    notes: tuple[str, ...] = ()
    shown: tuple[Fault, ...] = ()
    standing: tuple[str, ...] = ()

    @cached_property
    def rivals(self) -> tuple[Rival, ...]:
        """Other installations that would make the same torque; they have no columns."""
        none = np.zeros((0, 0))
        rivals = list[Rival]()
        for fault in self.shown:
            for name, joints in fault.evidence.get("alike", ()):
                effect = _effect_of(name, joints, self.robot.joints)
                rivals.append(Rival(Candidate(effect, slice(0, 0), none), 0.0, 1.0))
        return tuple(rivals)

    @cached_property
    def effects(self) -> tuple[Effect, ...]:
        """The changes of mounting and zero positions, with values."""
        effects: list[Effect] = []
        turned = self.robot.gravity - self.given.gravity
        if turned.any():
            effect = EFFECTS["gravity_direction"](self.robot.joints)
            effects.append(effect.with_values(turned))
        nominal = dict(self.given.zeros)
        for joint, angle in self.robot.zeros:
            if offset := angle - nominal.get(joint, 0.0):
                effect = EFFECTS["encoder_offset"]((joint,))
                effects.append(effect.with_values([offset]))
        return tuple(effects)

    @cached_property
    def faults(self) -> tuple[DataFault, ...]:
        """The faults that are repaired, each once, whatever the number of recordings."""
        causes = dict[tuple[str, tuple[str, ...]], DataFault]()
        for faults in self.repaired.values():
            for fault in faults:
                cause = DataFault(fault.joints, (), fault.fault, fault.detail)
                causes.setdefault((fault.fault, fault.joints), cause)
        return tuple(causes.values())

    def amends(self, fault: Mapping[str, Any]) -> bool:
        """Whether a fault, under its JSON names, is repaired or in the model."""
        repaired = {f.fault for f in self.repaired.get(str(fault["recording"]), ())}
        changed = self.robot is not self.given
        return fault["fault"] in repaired or (
            changed and fault["fault"] in INSTALLATION
        )

    def without(self, effect: Effect, model: Robot) -> Robot:
        """A model of the arm that has this one thing as given."""
        if effect.family == "static":
            return model.with_gravity(self.given.gravity)
        return model.with_zero(effect.joints[0], -(effect.values or (0.0,))[0])

    def std_of(self, effect: Effect) -> tuple[float, ...]:
        """Standard deviations of the coefficients of one of its effects."""
        return self.std[
            "gravity" if effect.family == "static" else effect.joints[0]
        ]


def set_up(
    robot: Robot, recordings: Sequence[Recording]
) -> tuple[SetUp, list[Recording]]:
    """The installation that recordings show, and the recordings, repaired.

    Faults of the data that leave every figure wrong are repaired, no others.
    """
    found = check_recordings(
        robot, recordings, repaired=True, only=PROVEN, modelled=INSTALLATION
    )
    every = [fault for faults in found.faults.values() for fault in faults]
    of_arm = [fault for fault in every if fault.of_the_arm]
    shown = tuple({(f.fault, f.joints): f for f in of_arm}.values())
    repaired = {
        name: remedied
        for name, faults in found.faults.items()
        if (remedied := tuple(filter(_is_of_the_data, faults)))
    }
    standing = [f for f in every if not f.remedies and f.fault not in INSTALLATION]
    std = {
        "gravity" if fault.fault == "wrong_mounting" else fault.joints[0]: _std(
            fault
        )
        for fault in shown
        if fault.fault in INSTALLATION
    }
    installation = SetUp(
        robot,
        Installation(shown).robot(robot),
        std,
        repaired,
        found.notes,
        shown,
        tuple(dict.fromkeys(fault.detail for fault in standing)),
    )
    return installation, found.recordings


def _is_of_the_data(fault: Fault) -> bool:
    return bool(fault.remedies) and fault.fault not in INSTALLATION


def _std(fault: Fault) -> tuple[float, ...]:
    """Standard deviations of an angle [rad] or of gravity [m/s²]; where unknown, of any."""
    gravity = fault.evidence.get("gravity", np.ones(1))
    unknown = np.full(len(gravity), np.pi * np.linalg.norm(gravity))
    return tuple(np.atleast_1d(fault.evidence.get("std", unknown)).tolist())


def _effect_of(fault: str, at: tuple[str, ...], joints: tuple[str, ...]) -> Effect:
    """What a fault is called among the causes of a model's errors."""
    if fault == "wrong_mounting":
        return EFFECTS["gravity_direction"](joints)
    if fault == "wrong_zero":
        return EFFECTS["encoder_offset"](at)
    return DataFault(at, (), fault)
