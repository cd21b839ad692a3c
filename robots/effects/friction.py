"""Friction at the joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from excitant.robots.effects.base import JointEffect, Term
from excitant.robots.motion import Array


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
    terms: ClassVar[tuple[Term, ...]] = (Term("Fs", "N·m", 0.0),)

    velocity: float = 0.1

    def shape(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """Bell around zero velocity with the velocity's sign."""
        return (np.sign(dq) * np.exp(-((dq / self.velocity) ** 2)),)
