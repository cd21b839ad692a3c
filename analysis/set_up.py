"""Installation of an arm, amended in the model before any other cause is looked for.

`excitant.identify.faults` finds it by a search with bodies near the nominal ones. Faults of the
data (signs, order, units, clock) are repaired, mounting and zero positions changed in the model.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from excitant.analysis.evidence import Candidate
from excitant.analysis.selection import Rival
from excitant.exceptions import BadRobot
from excitant.identify.faults import Checked, Fault, check_recordings
from excitant.identify.faults.fault import (
    DOUBT,
    INSTALLATION,
    OPEN,
    PROVEN,
    is_modelled,
)
from excitant.identify.faults.installation import (
    Installation,
    inertias_beyond_size,
)
from excitant.identify.recording import Recording
from excitant.robots.effects import EFFECTS, Acts, Effect, Size, Words
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
        checked: The recordings, repaired, and their faults.
    """

    given: Robot
    robot: Robot
    checked: Checked

    @cached_property
    def rivals(self) -> tuple[Rival, ...]:
        """Other installations that would make the same torque; they have no columns."""
        none = np.zeros((0, 0))
        effects = (
            _effect_of(name, joints, self.robot.joints)
            for fault in self.checked.of_the_arm
            for name, joints in fault.evidence.get("alike", ())
        )
        return tuple(
            Rival(Candidate(effect, slice(0, 0), none), (), 0.0, 1.0)
            for effect in effects
        )

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
        repaired = {
            (f.fault, f.joints): f for _, f in self._of_data if f.repairable
        }
        return tuple(
            DataFault(f.joints, (), f.fault, f.detail) for f in repaired.values()
        )

    @cached_property
    def _of_data(self) -> list[tuple[str, Fault]]:
        """Faults of the data, with the names of their recordings."""
        return [
            (name, fault)
            for name, faults in self.checked.faults.items()
            for fault in faults
            if fault.fault not in INSTALLATION
        ]

    @property
    def doubt(self) -> str:
        """What the log may mean otherwise, though less likely; or empty."""
        every = itertools.chain(*self.checked.faults.values())
        return next((f.detail for f in every if DOUBT in f.evidence), "")

    @property
    def standing(self) -> list[str]:
        """Faults that leave every figure wrong and that nothing repairs, a sentence each."""
        return [
            f.detail
            for _, f in self._of_data
            if not f.repairable and DOUBT not in f.evidence
        ]

    def amends(self, fault: Mapping[str, Any]) -> bool:
        """Whether a fault, under its JSON names, is repaired or in the model."""
        repaired = {(name, f.fault) for name, f in self._of_data if f.repairable}
        return (fault["recording"], fault["fault"]) in repaired or (
            self.robot is not self.given and is_modelled(fault)
        )

    def without(self, effect: Effect, model: Robot) -> Robot:
        """A model of the arm that has this one thing as given."""
        if effect.family == "static":
            return model.with_gravity(self.given.gravity)
        return model.with_zero(effect.joints[0], -(effect.values or (0.0,))[0])

    def std_of(self, effect: Effect) -> Array:
        """Standard deviations of the coefficients of one of its effects [m/s² or rad].

        That of any direction or angle where it is not known.
        """
        static = effect.family == "static"
        evidence = next(
            fault.evidence
            for fault in reversed(self.checked.of_the_arm)
            if fault.fault == ("wrong_mounting" if static else "wrong_zero")
            and (static or {*effect.joints} <= {*fault.joints})
        )
        unknown = np.pi * np.linalg.norm(evidence.get("gravity", 1.0))
        std = evidence.get("std", np.full(len(effect.values or ()), unknown))
        return np.atleast_1d(std)


def set_up(
    robot: Robot, recordings: Sequence[Recording]
) -> tuple[SetUp, list[Recording]]:
    """The installation that recordings show, and the recordings, repaired.

    Faults of the data that leave every figure wrong are repaired, no others.

    Raises:
        BadRobot: Inertias in another unit: no cause can be told beside them.
    """
    if beyond := next(inertias_beyond_size(robot), None):
        raise BadRobot(robot.source, beyond.detail)
    checked = check_recordings(
        robot, recordings, repaired=True, only=PROVEN, modelled=INSTALLATION
    )
    certain = tuple(f for f in checked.of_the_arm if OPEN not in f.evidence)
    mounted = Installation(certain).robot(robot)
    return SetUp(robot, mounted, checked), checked.recordings


def _effect_of(fault: str, at: tuple[str, ...], joints: tuple[str, ...]) -> Effect:
    """What a fault is called among the causes of a model's errors."""
    if fault == "wrong_mounting":
        return EFFECTS["gravity_direction"](joints)
    if fault == "wrong_zero":
        return EFFECTS["encoder_offset"](at)
    return DataFault(at, (), fault)
