"""Effects between two joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar, Self

import numpy as np

from excitant.robots.effects.base import Effect, JointFacts, Parameter, Shape
from excitant.robots.effects.experiments import HOLD_OTHER
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot


@dataclass(frozen=True)
class _PairEffect(Effect):
    """Acts on two joints, ``joints = (one, other)``."""

    arity: ClassVar[int] = 2
    depends_on_model: ClassVar[bool] = False

    @classmethod
    def proposed(cls, robot: Robot, facts: Sequence[JointFacts]) -> list[tuple[Self, int]]:
        """Of each joint with the next."""
        return [(effect, 1) for pair in pairwise(robot.joints) for effect in cls._of(pair)]

    @classmethod
    def _of(cls, pair: tuple[str, str]) -> Sequence[Self]:
        return (cls(pair),)


@dataclass(frozen=True)
class FrictionCoupling(_PairEffect):
    """Friction of a shaft that turns with both joints, at speed w = q̇_i + ρ q̇_k.

    τ_i = F_v w + F_c sign(w), τ_k = ρ τ_i, as in wrists whose motors sit in the forearm
    (Gautier, Janot, Vandanjon 2013, Stäubli TX40).

    Attributes:
        ratio: ρ.
    """

    name: ClassVar[str] = "friction_coupling"
    family: ClassVar[str] = "friction"
    shapes: ClassVar[tuple[Shape, ...]] = (Shape("ratio", "1", positive=False),)
    abscissa: ClassVar[str] = "other velocity"
    told: ClassVar[Mapping[str, str]] = {"inertia_coupling": HOLD_OTHER}

    ratio: float = 1.0

    @classmethod
    def _of(cls, pair: tuple[str, str]) -> Sequence[Self]:
        return cls(pair), cls(pair, ratio=-1.0)

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Viscous and Coulomb friction of the shaft."""
        pair = "-".join(self.joints)
        return (Parameter(f"{pair}.Fv", "N·m·s/rad", 0.0), Parameter(f"{pair}.Fc", "N·m", 0.0))

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """Speed and its sign in both rows."""
        i, k = self.rows(robot)
        speed = motion.dq[:, i] + self.ratio * motion.dq[:, k]
        columns = np.zeros((len(motion), robot.nv, 2))
        for row, lever in ((i, 1.0), (k, self.ratio)):
            columns[:, row, 0], columns[:, row, 1] = lever * speed, lever * np.sign(speed)
        return columns


@dataclass(frozen=True)
class InertiaCoupling(_PairEffect):
    """τ_i = I q̈_k, τ_k = I q̈_i: a rotor that turns with both joints."""

    name: ClassVar[str] = "inertia_coupling"
    family: ClassVar[str] = "body"
    abscissa: ClassVar[str] = "other acceleration"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Coupling inertia."""
        return (Parameter(f"{'-'.join(self.joints)}.Ic", "kg·m²"),)

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """Each joint's acceleration in the other's row."""
        i, k = self.rows(robot)
        columns = np.zeros((len(motion), robot.nv, 1))
        columns[:, i, 0], columns[:, k, 0] = motion.ddq[:, k], motion.ddq[:, i]
        return columns
