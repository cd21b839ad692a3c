"""Inertia that the given links do not have: of bodies, rotors and gears."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from excitant.robots.effects import experiments as by
from excitant.robots.effects.base import (
    Effect,
    JointFacts,
    PairEffect,
    Parameter,
    StandardEffect,
    within,
)
from excitant.robots.motion import Array, Motion
from excitant.robots.parameters import STANDARD, UNITS
from excitant.robots.regressor import regressor
from excitant.robots.robot import Robot

_BODY = tuple(zip(STANDARD, UNITS, strict=True))


@dataclass(frozen=True)
class AddedInertia(Effect):
    """Inertial parameters added to the link that one joint carries, about the joint frame."""

    family = "body"
    arity = 1
    depends_on_model = False
    further = False
    terms = tuple(Parameter(f"delta_{name}", unit) for name, unit in _BODY)

    def owners(self, robot: Robot) -> tuple[str, ...]:
        """The link."""
        return (robot.links[self.rows(robot)[0]],)

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """The link's columns of the regressor."""
        j = self.rows(robot)[0]
        return regressor(robot, motion)[:, :, 10 * j : 10 * j + 10]

    def applied(self, robot: Robot) -> Robot:
        """The robot with the link changed."""
        phi = robot.phi.reshape(-1, 10).copy()
        phi[self.rows(robot)[0]] += self._known()
        return robot.with_parameters(phi)


@dataclass(frozen=True)
class InertialParameters(AddedInertia):
    """A link's inertial parameters differ from the given ones."""

    name = "inertial_parameters"
    role = "link"

    def noun(self, robot: Robot) -> str:
        """With its link."""
        return f"wrong inertial parameters of {robot.links[self.rows(robot)[0]]}"

    def sentence(self, robot: Robot, joints: Sequence[str], given: Sequence[float]) -> str:
        """By how much the link's mass is off."""
        j, mass = self.rows(robot)[0], self._known()[0]
        if j == robot.nv - 1 and mass < 0:
            return (
                f"{robot.links[j]} is lighter than the model says ({mass:+.2f} kg), as if a tool "
                "in the model were not mounted"
            )
        return f"The inertial parameters of {robot.links[j]} are wrong (mass {mass:+.2f} kg)"


@dataclass(frozen=True)
class Payload(AddedInertia):
    """A body held by the last link: mass, first moment and inertia about its joint frame."""

    name = "payload"
    role = "body"
    terms = tuple(Parameter(f"payload_{name}", unit) for name, unit in _BODY)
    told = ((by.UNLOADED, "inertial_parameters"),)

    @classmethod
    def proposed(cls, robot: Robot, facts: Sequence[JointFacts]) -> list[tuple[Self, int]]:
        """At the last link."""
        return [(cls(robot.joints[-1:]), 1)]

    def is_common(self, robot: Robot) -> bool:
        """It is: all joints carry the same body."""
        return True

    def plausible(self, robot: Robot, values: Array, std: Array) -> bool:
        """Whether its mass is not negative."""
        return within(values[:1], 0.0, std[:1])

    def noun(self, robot: Robot) -> str:
        """There is one place for it."""
        return "a payload"

    def sentence(self, robot: Robot, joints: Sequence[str], given: Sequence[float]) -> str:
        """With its mass."""
        return f"A payload of {self._known()[0]:.2f} kg on the last link is missing from the model"


@dataclass(frozen=True)
class RotorInertia(StandardEffect):
    """τ = I_a q̈: rotor and gear inertia at the joint side."""

    name = "rotor_inertia"
    family = "body"
    terms = (Parameter("Ia", "kg·m²", 0.0),)
    abscissa = "acceleration"
    joint_property = "rotor"
    formats = ("mjcf", "sdf")
    format_notes: ClassVar[Mapping[str, str]] = {
        "sdf": "rotor inertia is written as drake:rotor_inertia, which Drake reads and Gazebo "
        "passes over"
    }
    told = (
        (
            "move the joint with the outer joints folded and stretched; for a first "
            "joint, and those parallel to it, only the data sheet tells",
            "inertial_parameters",
        ),
        (f"find the resonance by a chirp; {by.LOCKED}", "joint_elasticity"),
        ("hold the joint at several angles: a spring pulls at rest, inertia does not", "spring"),
        (by.HOLD_OTHER, "inertia_coupling"),
        (f"{by.LEVER}; {by.DATA_SHEET}", "torque_gain"),
        (by.UNLOADED, "payload"),
        (by.SECOND, "time_delay torque_ripple"),
        (by.DATA_SHEET, "kinematic_error"),
    )

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """Acceleration."""
        return (ddq,)


@dataclass(frozen=True)
class InertiaCoupling(PairEffect):
    """τ_i = I q̈_k, τ_k = I q̈_i: a rotor that turns with both joints."""

    name = "inertia_coupling"
    family = "body"
    terms = (Parameter("Ic", "kg·m²"),)
    abscissa = "other acceleration"

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """Each joint's acceleration in the other's row."""
        i, k = self.rows(robot)
        columns = np.zeros((len(motion), robot.nv, 1))
        columns[:, i, 0], columns[:, k, 0] = motion.ddq[:, k], motion.ddq[:, i]
        return columns
