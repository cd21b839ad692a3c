"""Effect: anything that makes torque beyond the rigid-body inertia of the given links."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
import numpy.typing as npt

from excitant.exceptions import BadInput
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot

_LARGEST = 2.0  # of the typical size of a coefficient that has one
_PERSONS = ("coulomb", "stribeck")
_NEAR = (0.3, 2.5)  # of a trial value, for which the columns are right


def near_trial(value: float, trial: float) -> bool:
    """Whether a coefficient is one that columns computed for a trial value are right for."""
    return _NEAR[0] < value / trial < _NEAR[1]


def plain(name: object) -> str:
    """A word of the vocabulary as it stands in a sentence, such as ``Coulomb friction``."""
    words = str(name).replace("_", " ").replace("load dependent", "load-dependent")
    for person in _PERSONS:
        words = words.replace(person, person.capitalize())
    return words


@dataclass(frozen=True)
class Parameter:
    """One coefficient of an effect.

    Attributes:
        name: Name, ``joint.symbol`` or ``link.symbol``.
        unit: Unit where torque is in N·m.
        lower: Smallest value physics allows.
        typical: Size that it has when it matters; None where that depends on the arm.
    """

    name: str
    unit: str
    lower: float = -np.inf
    typical: float | None = None


@dataclass(frozen=True)
class Effect(ABC):
    """Torque that is linear in the effect's coefficients once its shape is fixed.

    Attributes:
        joints: The joints it acts on.
        values: One value per parameter; None while unknown.

    Raises:
        BadInput: It acts on another number of joints, or a field of its shape cannot be.
    """

    name: ClassVar[str]
    arity: ClassVar[int] = 0  # how many joints it acts on; 0: as many as it is given
    positive: ClassVar[tuple[str, ...]] = ()  # fields of its shape that must be
    acts_on_torque: ClassVar[bool] = False  # its columns are made of the other effects' torque
    contains: ClassVar[tuple[str, ...]] = ()  # what it is when some of its coefficients are zero
    imitates: ClassVar[tuple[str, ...]] = ()  # those of them that it can really be at work for

    joints: tuple[str, ...]
    values: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if self.arity and len(self.joints) != self.arity:
            wanted = "one joint" if self.arity == 1 else f"{self.arity} joints"
            count = len(self.joints)
            raise BadInput(f"effect {self.name} acts on {wanted}, not on {count}; name it or them")
        if len(set(self.joints)) < len(self.joints):
            raise BadInput(f"effect {self.name} names a joint twice: {', '.join(self.joints)}")
        for field in self.positive:
            if not getattr(self, field) > 0:
                raise BadInput(f"effect {self.name}: {field} must be positive")

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

    def credible(self, robot: Robot, values: Array) -> bool:
        """Whether coefficients are of a size at which they mean what the effect says."""
        typical = [p.typical for p in self.parameters(robot)]
        most = np.array([np.inf if size is None else _LARGEST * size for size in typical])
        return bool((np.abs(values) < most).all())

    def with_values(self, values: npt.ArrayLike) -> Self:
        """The same effect with these coefficients."""
        return replace(self, values=tuple(float(v) for v in np.ravel(values)))


@dataclass(frozen=True)
class Term:
    """One coefficient that every joint of an effect has: its symbol, unit, lower bound."""

    symbol: str
    unit: str
    lower: float = -np.inf


@dataclass(frozen=True)
class JointFacts:
    """What a recording shows of one joint's motion, to scale the shapes of effects by.

    Attributes:
        speed: Highest speed [rad/s or m/s].
        reach: Range of positions [rad or m].
        start: First instant [s].
        duration: Length of the longest recording [s].
    """

    speed: float
    reach: float
    start: float
    duration: float


class JointwiseEffect(Effect):
    """Effect with coefficients of its own on each joint, which act on that joint only."""

    terms: ClassVar[tuple[Term, ...]]

    @classmethod
    def candidates(cls, joint: str, facts: JointFacts) -> Iterable[Self]:
        """Shapes of the effect that a diagnosis shall consider at a joint; the usual one."""
        return (cls((joint,)),)

    @abstractmethod
    def at(self, robot: Robot, motion: Motion, j: int) -> Sequence[Array]:
        """Torque per unit of each term for joint j, each of shape (n,)."""

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Each joint's terms, joint by joint."""
        return tuple(
            Parameter(f"{joint}.{term.symbol}", term.unit, term.lower)
            for joint in self.joints
            for term in self.terms
        )

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """Each joint's terms in that joint's row."""
        columns = np.zeros((len(motion), robot.nv, len(self.parameters(robot))))
        column = 0
        for joint in self.joints:
            j = robot.joint_index(joint)
            for values in self.at(robot, motion, j):
                columns[:, j, column] = values
                column += 1
        return columns

    def torque(self, robot: Robot, motion: Motion) -> Array:
        """Each joint's terms summed; the columns, of which most are zero, are not built."""
        tau, values = np.zeros((len(motion), robot.nv)), iter(self._known())
        for joint in self.joints:
            j = robot.joint_index(joint)
            for column in self.at(robot, motion, j):
                tau[:, j] += next(values) * column
        return tau


class JointEffect(JointwiseEffect):
    """Effect on each joint by that joint's own motion at that instant."""

    @abstractmethod
    def shape(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """Torque per unit of each term for one joint, each of shape (n,)."""

    def at(self, robot: Robot, motion: Motion, j: int) -> Sequence[Array]:
        """The shape at the joint's motion."""
        return self.shape(motion.q[:, j], motion.dq[:, j], motion.ddq[:, j])
