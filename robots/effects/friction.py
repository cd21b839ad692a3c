"""Friction at the joints."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from excitant.robots.effects.base import JointEffect, JointFacts, JointwiseEffect, Parameter, Term
from excitant.robots.effects.reference import rigid_torque
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot


@dataclass(frozen=True)
class ViscousFriction(JointEffect):
    """τ = F_v q̇."""

    name: ClassVar[str] = "viscous_friction"
    terms: ClassVar[tuple[Term, ...]] = (Term("Fv", "N·m·s/rad", 0.0),)

    def shape(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """Velocity."""
        return (dq,)


@dataclass(frozen=True)
class CoulombFriction(JointEffect):
    """τ = F_c sign(q̇)."""

    name: ClassVar[str] = "coulomb_friction"
    terms: ClassVar[tuple[Term, ...]] = (Term("Fc", "N·m", 0.0),)

    def shape(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """Sign of the velocity."""
        return (np.sign(dq),)


@dataclass(frozen=True)
class StribeckFriction(JointEffect):
    """τ = F_s exp(−|q̇ / v_s|²) sign(q̇), on top of Coulomb friction (Armstrong-Hélouvry 1991).

    Attributes:
        velocity: Stribeck velocity v_s [rad/s].
    """

    name: ClassVar[str] = "stribeck_friction"
    positive: ClassVar[tuple[str, ...]] = ("velocity",)
    terms: ClassVar[tuple[Term, ...]] = (Term("Fs", "N·m", 0.0),)

    velocity: float = 0.1

    @classmethod
    def candidates(cls, joint: str, facts: JointFacts) -> Iterable[Self]:
        """Stribeck speeds of 1 to 40 % of the highest speed."""
        speeds = facts.speed * np.geomspace(0.01, 0.4, 8)
        return [cls((joint,), velocity=float(speed)) for speed in speeds]

    def shape(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """Bell around zero velocity with the velocity's sign."""
        return (np.sign(dq) * np.exp(-((dq / self.velocity) ** 2)),)


@dataclass(frozen=True)
class AsymmetricFriction(JointEffect):
    """τ = F_c± sign(q̇) + F_v± q̇: friction that differs with the direction.

    Attributes:
        viscous: Whether viscous friction differs too.
    """

    name: ClassVar[str] = "asymmetric_friction"
    contains: ClassVar[tuple[str, ...]] = ("torque_offset", "coulomb_friction", "viscous_friction")
    imitates: ClassVar[tuple[str, ...]] = ("torque_offset",)
    terms: ClassVar[tuple[Term, ...]] = (
        Term("Fc_plus", "N·m"),
        Term("Fc_minus", "N·m"),
        Term("Fv_plus", "N·m·s/rad"),
        Term("Fv_minus", "N·m·s/rad"),
    )

    viscous: bool = True

    @classmethod
    def candidates(cls, joint: str, facts: JointFacts) -> Iterable[Self]:
        """Coulomb friction alone, or both."""
        return cls((joint,), viscous=False), cls((joint,))

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Coulomb and, where asked for, viscous friction forward and backward."""
        kept = [(term.symbol, term.unit) for term in self.terms[: 2 + 2 * self.viscous]]
        return tuple(Parameter(f"{joint}.{s}", unit) for joint in self.joints for s, unit in kept)

    def shape(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """Sign and velocity, forward and backward."""
        ahead, back = np.maximum(dq, 0.0), np.minimum(dq, 0.0)
        return (np.sign(ahead), np.sign(back), ahead, back)[: 2 + 2 * self.viscous]


@dataclass(frozen=True)
class NonlinearViscousFriction(JointEffect):
    """τ = F_n |q̇|^a sign(q̇), on top of viscous friction.

    Attributes:
        exponent: a, not one.
    """

    name: ClassVar[str] = "nonlinear_viscous_friction"
    contains: ClassVar[tuple[str, ...]] = ("viscous_friction",)  # exponent one
    exponents: ClassVar[tuple[float, ...]] = (0.3, 0.5, 0.7, 1.5, 2.0, 3.0)  # to try
    positive: ClassVar[tuple[str, ...]] = ("exponent",)
    terms: ClassVar[tuple[Term, ...]] = (Term("Fn", "N·m·(s/rad)^a"),)

    exponent: float = 2.0

    @classmethod
    def candidates(cls, joint: str, facts: JointFacts) -> Iterable[Self]:
        """Roots and powers."""
        return [cls((joint,), exponent=a) for a in cls.exponents]

    def shape(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """Power of the speed with the velocity's sign."""
        return (np.sign(dq) * np.abs(dq) ** self.exponent,)


@dataclass(frozen=True)
class LoadDependentFriction(JointwiseEffect):
    """τ = F_l |τ_load| sign(q̇) with the torque of the bodies as load."""

    name: ClassVar[str] = "load_dependent_friction"
    terms: ClassVar[tuple[Term, ...]] = (Term("Fl", "1", 0.0),)

    def at(self, robot: Robot, motion: Motion, j: int) -> Sequence[Array]:
        """Load with the velocity's sign."""
        return (np.abs(rigid_torque(robot, motion)[:, j]) * np.sign(motion.dq[:, j]),)
