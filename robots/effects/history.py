"""Friction that depends on what happened before: displacement since reversal, warming up."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from excitant.robots.effects import experiments as by
from excitant.robots.effects.base import JointFacts, JointwiseEffect, Parameter, Shape
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot

_SHORT = 0.1  # of a joint's range: friction that builds up over more is a spring
_REACH = 8.0  # break-away distances from a reversal that show hysteresis


@dataclass(frozen=True)
class PreslidingHysteresis(JointwiseEffect):
    """τ = F_h (z − sign q̇): dry friction that builds up over a distance instead of at once.

    z follows Dahl's law dz/dq = (1 − z sign q̇) / δ (Dahl 1968), so that Coulomb friction F_c
    with F_h = F_c is F_c z; its motion must come in the order of time.

    Attributes:
        distance: δ, over which friction builds up [rad].
    """

    name = "presliding_hysteresis"
    family = "friction"
    depends_on_model = False
    terms = (Parameter("Fh", "N·m", 0.0),)
    shapes = (
        Shape(
            "distance",
            "rad",
            grid=lambda facts: facts.reach * np.geomspace(3e-4, _SHORT, 8),
            most=lambda facts: _SHORT * facts.reach,
        ),
    )
    abscissa = "reversal"
    told = ((by.REVERSALS, "backlash"),)

    distance: float = 0.01

    def at(self, robot: Robot, motion: Motion, j: int) -> Sequence[Array]:
        """State of the bristles less the velocity's sign."""
        return (bristles(motion.q[:, j], self.distance) - np.sign(motion.dq[:, j]),)

    def stepper(self, robot: Robot) -> Bristles:
        """Bristles of all joints, those of joints without the effect with no force."""
        force = np.zeros(robot.nv)
        force[self.rows(robot)] = self._known()
        return Bristles(self.distance, force, np.zeros(robot.nv), np.full(robot.nv, np.nan))

    def drawn(self, label: str, x: Array) -> tuple[str, Array]:
        """Near reversals only, where any of it is."""
        far = np.abs(x) > _REACH * self.distance
        return label, np.where(far & (far.mean() < 1), np.nan, x)


@dataclass(frozen=True, eq=False)
class Bristles:
    """Dahl's state z of each joint, carried from step to step of a simulation.

    Attributes:
        distance: δ [rad].
        force: F_h, zero for joints without it, shape (nv,) [N·m].
        z: State after the last step, shape (nv,).
        q: Positions then, NaN before the first, shape (nv,).
    """

    distance: float
    force: Array
    z: Array
    q: Array

    def __call__(self, t: float, q: Array, dq: Array, ddq: Array) -> Array:
        """Torque, shape (nv,) [N·m]."""
        return self.force * (self._state(q) - np.sign(dq))

    def _state(self, q: Array) -> Array:
        moved = np.where(np.isnan(self.q), 0.0, q - self.q)
        sign = np.sign(moved)
        kept = np.exp(-np.abs(moved) / self.distance)
        return np.where(sign != 0, sign + (self.z - sign) * kept, self.z)

    def advance(self, q: Array) -> None:
        """End a step at some positions, shape (nv,)."""
        self.z[:] = self._state(q)
        self.q[:] = q


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

    name = "thermal_friction_drift"
    family = "friction"
    depends_on_model = False
    shapes = (Shape("time", "s", most=lambda facts: facts.duration),)
    abscissa = "time"
    contains = ("viscous_friction", "coulomb_friction")
    terms = (
        Parameter("Fv_cold", "N·m·s/rad"),
        Parameter("Fc_cold", "N·m"),
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
