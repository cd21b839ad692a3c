"""Static torque and what lies between motor and link: offset, springs, ripple, elasticity, play."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from excitant.robots.effects import experiments as by
from excitant.robots.effects.base import (
    Effect,
    JointEffect,
    JointFacts,
    Parameter,
    Shape,
    StandardEffect,
)
from excitant.robots.motion import Array, Motion
from excitant.robots.regressor import rigid_torque, torque_along, torque_derivatives
from excitant.robots.robot import Robot

_GAPS = np.geomspace(3e-4, 0.1, 12).tolist()  # rad
_ORDERS = 3  # of ripple at each joint, the best of all
_MOST_ORDERS = 600
_SLOWEST = 1e-3  # rad/s


@dataclass(frozen=True)
class TorqueOffset(StandardEffect):
    """τ = τ_0: constant torque, current-sensor offset or asymmetric Coulomb friction."""

    name = "torque_offset"
    family = "static"
    terms = (Parameter("offset", "N·m"),)
    needs_motion = False
    abscissa = "time"
    joint_property = "offset"
    formats = ("mjcf",)
    format_notes: ClassVar[Mapping[str, str]] = {
        "mjcf": "torque offsets are the bias of the actuators: they act on controls, and are not "
        "part of what mj_inverse returns"
    }
    told = (
        (
            "repeat the motion in another posture: an offset does not turn with gravity",
            "inertial_parameters",
        ),
        ("repeat the motion without the load: an offset stays", "payload"),
        (by.STATIC, "spring torque_ripple"),
        (f"{by.TURNED}: an offset stays, tilt turns along", "gravity_direction"),
        (f"{by.ZERO}; {by.UNPOWERED}", "encoder_offset"),
    )

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """One."""
        return (np.ones_like(dq),)


@dataclass(frozen=True)
class TorqueRipple(JointEffect):
    """τ = a cos(N q) + b sin(N q): cogging, tooth mesh, eccentricity.

    Attributes:
        order: N, periods per turn of the joint.
    """

    name = "torque_ripple"
    family = "static"
    terms = (
        Parameter("ripple_cos", "N·m"),
        Parameter("ripple_sin", "N·m"),
    )
    shapes = (Shape("order", "1/turn"),)
    abscissa = "position"
    told = (
        (by.STATIC, "spring inertial_parameters"),
        (by.ORDERS, "joint_elasticity backlash"),
        (by.UNLOADED, "payload"),
    )

    order: float = 1.0

    @classmethod
    def candidates(cls, joint: str, facts: JointFacts) -> Iterable[Self]:
        """The orders that lower the joint's error most, far enough apart to differ."""
        if not len(orders := _orders(facts)):
            return []
        q, step = facts.q, _step(facts)
        local = np.column_stack([np.ones_like(q), q, np.cos(q), np.sin(q)])
        e = facts.unexplained
        e = e - local @ np.linalg.lstsq(local, e, rcond=None)[0]
        gains = np.concatenate([_gains(part, q, e) for part in np.array_split(orders, 20)])
        found: list[float] = []
        for order in orders[np.argsort(-gains)].tolist():
            if all(abs(order - known) > 3 * step for known in found):
                found.append(order)
            if len(found) == _ORDERS:
                break
        return [cls((joint,), order=order) for order in found]

    @classmethod
    def searched(cls, facts: JointFacts) -> int:
        """Orders looked at."""
        return len(_orders(facts))

    def refined(self, beside: Iterable[Effect], facts: JointFacts) -> list[Self]:
        """Orders at thirds of the way to the next ones that would be looked at."""
        next_ones = (self.order - _step(facts), self.order + _step(facts))
        return super().refined([self.reshaped("order", order) for order in next_ones], facts)

    @property
    def own_terms(self) -> tuple[Parameter, ...]:
        """Amplitudes, named after the order."""
        return tuple(Parameter(f"{term.name}{self.order:.4g}", term.unit) for term in self.terms)

    def drawn(self, label: str, x: Array) -> tuple[str, Array]:
        """Folded into one period."""
        period = 2 * np.pi / self.order
        return "joint position within one period of the ripple [rad]", np.mod(x, period)

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """Cosine and sine of the angle's multiple."""
        return np.cos(self.order * q), np.sin(self.order * q)


def _step(facts: JointFacts) -> float:
    """Half of the difference in order that the range of a joint resolves."""
    return float(np.pi / (2 * max(np.ptp(facts.q), 1e-9)))


def _orders(facts: JointFacts) -> Array:
    """Orders of ripple to look at: those that pass the torque filter, by half what q resolves."""
    if not len(facts.unexplained):
        return np.zeros(0)
    step = _step(facts)
    first = max(1.0, 6 * step) if np.ptp(facts.q) < 1.5 * np.pi else 1.0
    last = 2 * np.pi * facts.cutoff_hz / max(float(np.median(np.abs(facts.dq))), _SLOWEST)
    count = min(_MOST_ORDERS, max(0, int((last - first) / step) + 1))
    return np.asarray(first + step * np.arange(count), float)


def _gains(orders: Array, q: Array, e: Array) -> Array:
    """Fall of ‖e‖² by a cosine and a sine of each order, shape (orders,)."""
    angle = np.outer(q, orders)
    c, s = np.cos(angle), np.sin(angle)
    cc, ss, cs = (c * c).sum(axis=0), (s * s).sum(axis=0), (c * s).sum(axis=0)
    a, b = e @ c, e @ s
    determinant = np.maximum(cc * ss - cs**2, 1e-12)
    return np.asarray((ss * a**2 - 2 * cs * a * b + cc * b**2) / determinant, float)


@dataclass(frozen=True)
class Spring(JointEffect):
    """A spring beside the joint: τ = k q − k q_0, or a cos q + b sin q where it pulls a lever.

    Attributes:
        lever: Whether it pulls a lever, as in counterbalanced shoulders.
    """

    name = "spring"
    family = "static"
    contains = ("torque_offset",)
    usual = True
    abscissa = "position"
    told = (
        (
            f"{by.UNPOWERED}; or tilt the base: gravity's part turns, a spring's stays",
            "inertial_parameters",
        ),
        (by.UNLOADED, "payload"),
        (f"{by.TURNED}: a spring's torque stays", "gravity_direction"),
    )
    terms = (Parameter("k", "N·m/rad"), Parameter("moment", "N·m"))

    lever: bool = False

    @classmethod
    def candidates(cls, joint: str, facts: JointFacts) -> Iterable[Self]:
        """Both forms."""
        return cls((joint,)), cls((joint,), lever=True)

    @property
    def own_terms(self) -> tuple[Parameter, ...]:
        """Stiffness and moment at zero, or amplitudes of cosine and sine."""
        lever = tuple(Parameter(f"spring_{s}", "N·m") for s in ("cos", "sin"))
        return lever if self.lever else self.terms

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """Angle and one, or cosine and sine of the angle."""
        return (np.cos(q), np.sin(q)) if self.lever else (q, np.ones_like(q))


@dataclass(frozen=True)
class _Lag(Effect):
    """The link lags behind the motor, on whose side the encoder sits."""

    family = "transmission"
    arity = 1
    of_state_alone = False

    def _torque_along(self, robot: Robot, motion: Motion, lag: Array) -> Array:
        j = self.rows(robot)[0]
        return torque_along(robot, motion, j, -lag)[:, :, None]


@dataclass(frozen=True)
class JointElasticity(_Lag):
    """Link angle = motor angle − c τ with the compliance c = 1/k, to first order in c."""

    name = "joint_elasticity"
    terms = (Parameter("compliance", "rad/(N·m)", 0.0),)
    told = (
        (f"{by.LOCKED}: play yields at once, a spring in proportion", "backlash"),
        (by.UNLOADED, "payload"),
    )

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """Change of the torque by a link angle that yields to the torque."""
        j = self.rows(robot)[0]
        return self._torque_along(robot, motion, rigid_torque(robot, motion)[:, j])


@dataclass(frozen=True)
class Backlash(_Lag):
    """Link angle = motor angle − lag, the lag within ± g / 2.

    Where the load's sign changes the link flies from one end of the gap to the other, its
    acceleration less than the motor's by the torque that nothing gives it.

    Attributes:
        trial: Gap for which the flights are computed [rad].
    """

    name = "backlash"
    terms = (Parameter("gap", "rad", 0.0),)
    shapes = (
        Shape("trial", "rad", trial=True, grid=lambda facts: _GAPS, most=lambda facts: _GAPS[-1]),
    )
    told = ((by.SPEEDS, "time_delay"),)

    trial: float = 3e-3

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """Change of the torque by the lag, per gap."""
        j = self.rows(robot)[0]
        _, _, by_ddq = torque_derivatives(robot, motion)
        acceleration = rigid_torque(robot, motion)[:, j] / by_ddq[:, j, j]
        lag = play(motion.t, acceleration, self.trial)
        return self._torque_along(robot, motion, lag / self.trial)


def play(t: Array, acceleration: Array, gap: float) -> Array:
    """Lag of a link behind its motor over time, shape (n,), within ± gap / 2.

    Args:
        t: Time, shape (n,) [s].
        acceleration: What the motor would have to give the link to take it along, shape (n,).
        gap: Width of the play.
    """
    half, lag, speed = gap / 2, gap / 2 * float(np.sign(acceleration[0]) or 1.0), 0.0
    lags = [lag]
    for h, a in zip(np.diff(t).tolist(), acceleration[1:].tolist(), strict=True):
        speed += a * h
        lag += speed * h
        if abs(lag) >= half:
            lag, speed = (half if lag > 0 else -half), 0.0
        lags.append(lag)
    return np.array(lags)
