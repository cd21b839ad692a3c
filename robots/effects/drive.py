"""Effects of the drives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from excitant.robots.effects.base import JointEffect, Term
from excitant.robots.motion import Array


@dataclass(frozen=True)
class RotorInertia(JointEffect):
    """τ = I_a q̈: rotor and gear inertia at the joint side."""

    name: ClassVar[str] = "rotor_inertia"
    terms: ClassVar[tuple[Term, ...]] = (Term("Ia", "kg·m²", 0.0),)

    def shape(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """Acceleration."""
        return (ddq,)


@dataclass(frozen=True)
class TorqueOffset(JointEffect):
    """τ = τ_0: constant torque, current-sensor offset or asymmetric Coulomb friction."""

    name: ClassVar[str] = "torque_offset"
    terms: ClassVar[tuple[Term, ...]] = (Term("offset", "N·m"),)

    def shape(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """One."""
        return (np.ones_like(dq),)
