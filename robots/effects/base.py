"""Effect: anything that makes torque beyond the rigid-body inertia of the given links."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
import numpy.typing as npt

from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot


@dataclass(frozen=True)
class Parameter:
    """One coefficient of an effect.

    Attributes:
        name: Name, ``joint.symbol`` or ``link.symbol``.
        unit: Unit where torque is in N·m.
        lower: Smallest value physics allows.
    """

    name: str
    unit: str
    lower: float = -np.inf


@dataclass(frozen=True)
class Effect(ABC):
    """Torque that is linear in the effect's coefficients once its shape is fixed.

    Attributes:
        joints: The joints it acts on.
        values: One value per parameter; None while unknown.
    """

    name: ClassVar[str]

    joints: tuple[str, ...]
    values: tuple[float, ...] | None = None

    @abstractmethod
    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Its coefficients, in the order of the columns."""

    @abstractmethod
    def columns(self, robot: Robot, motion: Motion) -> Array:
        """Torque per unit of each coefficient, shape (n, nv, k) [N·m per unit]."""

    def torque(self, robot: Robot, motion: Motion) -> Array:
        """Torque that the joints must give for it, shape (n, nv) [N·m]."""
        tau: Array = self.columns(robot, motion) @ np.array(self._known())
        return tau

    def _known(self) -> tuple[float, ...]:
        if self.values is None:
            raise ValueError(f"{self.name} has no values yet")
        return self.values

    def with_values(self, values: npt.ArrayLike) -> Self:
        """The same effect with these coefficients."""
        return replace(self, values=tuple(float(v) for v in np.ravel(values)))


@dataclass(frozen=True)
class Term:
    """One coefficient that every joint of a `JointEffect` has: its symbol, unit, lower bound."""

    symbol: str
    unit: str
    lower: float = -np.inf


class JointEffect(Effect):
    """Effect on each joint by that joint's own motion."""

    terms: ClassVar[tuple[Term, ...]]

    @abstractmethod
    def shape(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """Torque per unit of each term for one joint, each of shape (n,)."""

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Each joint's terms, joint by joint."""
        return tuple(
            Parameter(f"{joint}.{term.symbol}", term.unit, term.lower)
            for joint in self.joints
            for term in self.terms
        )

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """Each joint's terms in that joint's row."""
        columns = np.zeros((len(motion), robot.nv, len(self.joints) * len(self.terms)))
        column = 0
        for joint in self.joints:
            j = robot.joint_index(joint)
            for values in self.shape(motion.q[:, j], motion.dq[:, j], motion.ddq[:, j]):
                columns[:, j, column] = values
                column += 1
        return columns

    def torque(self, robot: Robot, motion: Motion) -> Array:
        """Each joint's terms summed; the columns, of which most are zero, are not built."""
        tau, values = np.zeros((len(motion), robot.nv)), iter(self._known())
        for joint in self.joints:
            j = robot.joint_index(joint)
            for column in self.shape(motion.q[:, j], motion.dq[:, j], motion.ddq[:, j]):
                tau[:, j] += next(values) * column
        return tau
