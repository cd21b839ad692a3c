"""Effects of mass that the given links do not have."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from excitant.robots.effects.base import Effect, Parameter
from excitant.robots.motion import Array, Motion
from excitant.robots.parameters import STANDARD, UNITS
from excitant.robots.regressor import regressor
from excitant.robots.robot import Robot


@dataclass(frozen=True)
class AddedInertia(Effect):
    """Inertial parameters added to the link that one joint carries, about the joint frame."""

    arity: ClassVar[int] = 1
    prefix: ClassVar[str] = "delta_"

    def _index(self, robot: Robot) -> int:
        return robot.joint_index(self.joints[0])

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """The ten standard parameters, as increments."""
        link = robot.links[self._index(robot)]
        return tuple(
            Parameter(f"{link}.{self.prefix}{name}", unit)
            for name, unit in zip(STANDARD, UNITS, strict=True)
        )

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """The link's columns of the regressor."""
        j = self._index(robot)
        return regressor(robot, motion)[:, :, 10 * j : 10 * j + 10]


@dataclass(frozen=True)
class InertialParameters(AddedInertia):
    """A link's inertial parameters differ from the given ones."""

    name: ClassVar[str] = "inertial_parameters"


@dataclass(frozen=True)
class Payload(AddedInertia):
    """A body held by the last link: mass, first moment and inertia about its joint frame."""

    name: ClassVar[str] = "payload"
    prefix: ClassVar[str] = "payload_"
