"""Effects of mass that the given links do not have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal, Self

from excitant.robots.effects.base import Effect, JointFacts, Parameter, within
from excitant.robots.effects.experiments import UNLOADED
from excitant.robots.motion import Array, Motion
from excitant.robots.parameters import STANDARD, UNITS
from excitant.robots.regressor import regressor
from excitant.robots.robot import Robot


@dataclass(frozen=True)
class AddedInertia(Effect):
    """Inertial parameters added to the link that one joint carries, about the joint frame."""

    family: ClassVar[str] = "body"
    arity: ClassVar[int] = 1
    depends_on_model: ClassVar[bool] = False
    further: ClassVar[bool] = False
    prefix: ClassVar[str] = "delta_"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """The ten standard parameters, as increments."""
        link = robot.links[self.rows(robot)[0]]
        return tuple(
            Parameter(f"{link}.{self.prefix}{name}", unit)
            for name, unit in zip(STANDARD, UNITS, strict=True)
        )

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

    name: ClassVar[str] = "inertial_parameters"
    role: ClassVar[Literal["link"]] = "link"

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

    name: ClassVar[str] = "payload"
    role: ClassVar[Literal["body"]] = "body"
    prefix: ClassVar[str] = "payload_"
    told: ClassVar[Mapping[str, str]] = {"inertial_parameters": UNLOADED}

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
