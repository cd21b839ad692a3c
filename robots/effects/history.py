"""Friction that depends on what happened before: displacement since reversal, warming up."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from excitant.robots.effects.base import JointFacts, JointwiseEffect, Term
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot


@dataclass(frozen=True)
class PreslidingHysteresis(JointwiseEffect):
    """τ = F_h (z − sign q̇): dry friction that builds up over a distance instead of at once.

    z follows Dahl's law dz/dq = (1 − z sign q̇) / δ (Dahl 1968), so that Coulomb friction F_c
    with F_h = F_c is F_c z; its motion must come in the order of time.

    Attributes:
        distance: δ, over which friction builds up [rad].
    """

    name: ClassVar[str] = "presliding_hysteresis"
    positive: ClassVar[tuple[str, ...]] = ("distance",)
    terms: ClassVar[tuple[Term, ...]] = (Term("Fh", "N·m", 0.0),)

    distance: float = 0.01

    @classmethod
    def candidates(cls, joint: str, facts: JointFacts) -> Iterable[Self]:
        """Distances of 0.03 to 10 % of the range."""
        distances = facts.reach * np.geomspace(3e-4, 0.1, 8)
        return [cls((joint,), distance=float(distance)) for distance in distances]

    def at(self, robot: Robot, motion: Motion, j: int) -> Sequence[Array]:
        """State of the bristles less the velocity's sign."""
        return (bristles(motion.q[:, j], self.distance) - np.sign(motion.dq[:, j]),)


def bristles(q: Array, distance: float) -> Array:
    """Dahl's state z along a motion, from z = 0, shape (n,)."""
    steps = np.diff(q)
    decay, sign = np.exp(-np.abs(steps) / distance).tolist(), np.sign(steps).tolist()
    state, states = 0.0, [0.0]
    for keeps, s in zip(decay, sign, strict=True):
        state = s + (state - s) * keeps if s else state
        states.append(state)
    return np.array(states)


@dataclass(frozen=True)
class ThermalFrictionDrift(JointwiseEffect):
    """τ = e^{−(t − t_0)/T} (F_v q̇ + F_c sign q̇): what friction loses while the joint warms up.

    Attributes:
        time: T [s].
        start: t_0, when the arm was cold [s].
    """

    name: ClassVar[str] = "thermal_friction_drift"
    positive: ClassVar[tuple[str, ...]] = ("time",)
    contains: ClassVar[tuple[str, ...]] = ("viscous_friction", "coulomb_friction")
    terms: ClassVar[tuple[Term, ...]] = (
        Term("Fv_cold", "N·m·s/rad"),
        Term("Fc_cold", "N·m"),
    )

    time: float = 60.0
    start: float = 0.0

    @classmethod
    def candidates(cls, joint: str, facts: JointFacts) -> Iterable[Self]:
        """Time constants up to the recording's length; longer ones look like a ramp."""
        times = facts.duration * np.array([0.15, 0.4, 1.0])
        return [cls((joint,), time=float(time), start=facts.start) for time in times]

    def at(self, robot: Robot, motion: Motion, j: int) -> Sequence[Array]:
        """Velocity and its sign, fading: of the cold joint beyond those of the warm one."""
        fading = np.exp(-np.maximum(motion.t - self.start, 0.0) / self.time)
        return fading * motion.dq[:, j], fading * np.sign(motion.dq[:, j])
