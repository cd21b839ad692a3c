"""Drives: offset, rotors, springs, ripple, elasticity, play, and how their torque is read."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from excitant.exceptions import BadInput
from excitant.robots.effects import experiments as by
from excitant.robots.effects.base import (
    Effect,
    JointEffect,
    JointFacts,
    PairEffect,
    Parameter,
    Shape,
    Size,
    StandardEffect,
    registered,
)
from excitant.robots.motion import Array, Motion
from excitant.robots.regressor import (
    carried_torque,
    rigid_torque,
    torque_along,
    torque_derivatives,
)
from excitant.robots.robot import Robot

_GAPS = np.geomspace(3e-4, 0.1, 12).tolist()  # rad
_MASSLESS = 1e-9  # of the largest inertia that a joint moves: rounding
_DELAYS = (-0.05, -0.02, -0.005, 0.002, 0.005, 0.01, 0.02, 0.04, 0.08)  # s
_LONGEST = 0.04  # s, of a delay where another is at work
_ORDERS = 3  # of ripple at each joint, the best of all
_MOST_ORDERS = 600
_TOGETHER = 30  # orders at a time: they fit into the processor's cache
_WAVES = 3.0  # periods per turn, below which a ripple is as smooth as a spring
_RIDGE = 1e-8  # of the determinant of two columns: nothing is left of them
_SLOWEST = 1e-3  # rad/s


@registered
class TorqueOffset(StandardEffect):
    """τ = τ_0: constant torque, current-sensor offset or asymmetric Coulomb friction."""

    name = "torque_offset"
    family = "static"
    terms = (Parameter("offset", "N·m"),)
    needs_motion = False
    abscissa = "time"
    joint_property = "offset"
    formats = ("mjcf", "ros2_control")
    format_notes: ClassVar[Mapping[str, str]] = {
        "mjcf": "torque offsets are the bias of the actuators: they act on controls, and are not "
        "part of what mj_inverse returns"
    }
    told = (
        (f"{by.POSTURE}: an offset does not turn with gravity", "inertial_parameters"),
        ("repeat the motion without the load: an offset stays", "payload"),
        (by.STATIC, "spring torque_ripple"),
        (f"{by.TURNED}: an offset stays, tilt turns along", "gravity_direction"),
        (f"{by.ZERO}; {by.UNPOWERED}", "encoder_offset"),
    )

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        return (np.ones(dq.shape),)


@registered
class RotorInertia(StandardEffect):
    """τ = I_a q̈: rotor and gear inertia at the joint side."""

    name = "rotor_inertia"
    family = "body"
    terms = (Parameter("Ia", "kg·m²", 0.0),)
    abscissa = "acceleration"
    joint_property = "rotor"
    formats = ("mjcf", "sdf", "ros2_control")
    format_notes: ClassVar[Mapping[str, str]] = {
        "sdf": "rotor inertia is written as drake:rotor_inertia, which Drake reads and Gazebo "
        "passes over"
    }
    told = (
        (by.FOLDED, "inertial_parameters"),
        (f"find the resonance by a chirp; {by.LOCKED}", "joint_elasticity"),
        (
            "hold the joint at several angles: a spring pulls at rest, inertia does not",
            "spring",
        ),
        (by.HOLD_OTHER, "inertia_coupling"),
        (f"{by.LEVER}; {by.DATA_SHEET}", "torque_gain"),
        (by.UNLOADED, "payload"),
        (by.SECOND, "time_delay torque_ripple"),
        (by.DATA_SHEET, "kinematic_error"),
    )

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        return (ddq,)


@registered
class InertiaCoupling(PairEffect):
    """τ_i = I q̈_k, τ_k = I q̈_i: a rotor that turns with both joints."""

    name = "inertia_coupling"
    family = "body"
    terms = (Parameter("Ic", "kg·m²"),)
    abscissa = "other acceleration"

    def columns(self, robot: Robot, motion: Motion) -> Array:
        i, k = self.rows(robot)
        columns = np.zeros((len(motion), robot.nv, 1))
        columns[:, i, 0], columns[:, k, 0] = motion.ddq[:, k], motion.ddq[:, i]
        return columns


@dataclass(frozen=True)
class _ReadingEffect(Effect):
    """One coefficient of the torque readings of one joint, or of all."""

    family = "reading"
    acts_on_torque = True
    of_state_alone = False

    @classmethod
    def proposed(
        cls, robot: Robot, facts: Sequence[JointFacts]
    ) -> list[tuple[Self, int]]:
        """Of each joint, then of all."""
        of_all = cls.candidates(robot.joints[0], facts[0])
        everywhere = [(replace(effect, joints=robot.joints), 1) for effect in of_all]
        return super().proposed(robot, facts) + everywhere


@registered
class TorqueGain(_ReadingEffect):
    """Reading = (1 + g) τ: the torque sensor's or the drive's constant is wrong."""

    name = "torque_gain"
    further = False
    of_given_torque = True
    terms = (Parameter("gain", "1", typical=0.5),)
    abscissa = "torque"
    told = (
        (f"{by.LOADS}: a gain scales its torque too", "inertial_parameters"),
        (f"{by.LOADS} beside the unknown one", "payload"),
        (f"{by.LEVEL}; {by.LOADS}", "gravity_direction"),
        (f"{by.LOADS}; {by.KINEMATICS}", "kinematic_error"),
        (by.KINEMATICS, "encoder_scale"),
        (f"{by.ZERO}; {by.LOADS}", "encoder_offset"),
    )

    def columns(self, robot: Robot, motion: Motion) -> Array:
        columns = np.zeros((len(motion), robot.nv, 1))
        rows = self.rows(robot)
        columns[:, rows, 0] = carried_torque(robot, motion)[:, rows]
        return columns

    def sentence(
        self, robot: Robot, joints: Sequence[str], sizes: Sequence[Size]
    ) -> str:
        if len(joints) > 1:
            return super().sentence(robot, joints, sizes)
        gain = 100 * sizes[0].value
        std = 100 * sizes[0].std
        return (
            f"{joints[0]}: torque reads {gain:+.1f} ± {std:.2g} % against the model's"
        )


@registered
class TorqueRipple(JointEffect):
    """τ = a cos(N q) + b sin(N q): cogging, tooth mesh, eccentricity."""

    name = "torque_ripple"
    family = "static"
    terms = (Parameter("ripple_cos", "N·m"), Parameter("ripple_sin", "N·m"))
    shapes = (Shape("order", "1/turn"),)
    abscissa = "position"
    told = (
        (by.STATIC, "spring inertial_parameters"),
        (by.ORDERS, "joint_elasticity backlash"),
        (by.UNLOADED, "payload"),
    )

    order: float = 1.0  # N, periods per turn of the joint

    @classmethod
    def candidates(cls, joint: str, facts: JointFacts) -> Iterable[Self]:
        """The orders that lower the joint's error most, far enough apart to differ."""
        if not len(orders := _orders(facts)):
            return []
        q = facts.q
        step = _step(facts)
        local, _ = np.linalg.qr(
            np.column_stack([np.ones_like(q), q, np.cos(q), np.sin(q)])
        )
        gains = _gains(orders, q, facts.unexplained, local)
        found: list[float] = []
        for order in orders[np.argsort(-gains)].tolist():
            if len(found) < _ORDERS and all(
                abs(order - known) > 3 * step for known in found
            ):
                found.append(order)
        return [cls((joint,), order=order) for order in found]

    @classmethod
    def proposed(
        cls, robot: Robot, facts: Sequence[JointFacts]
    ) -> list[tuple[Self, int]]:
        """Each the best of all orders that its joint was looked at for."""
        looked = dict(
            zip(robot.joints, (len(_orders(seen)) for seen in facts), strict=True)
        )
        return [
            (effect, looked[effect.joints[0]])
            for effect, _ in super().proposed(robot, facts)
        ]

    def refined(self, beside: Iterable[Effect], facts: JointFacts) -> list[Self]:
        """Orders at thirds of the way to the next ones that would be looked at, and at ninths."""
        far, close = (
            [self.reshaped("order", self.order + sign * step) for sign in (-1, 1)]
            for step in (_step(facts), _step(facts) / 3)
        )
        return super().refined(far, facts) + super().refined(close, facts)

    @property
    def own_terms(self) -> tuple[Parameter, ...]:
        """Coefficients of the cosine and the sine, named after the order."""
        order = f"{self.order:.4g}"
        amplitude = f"amplitude of order {order}"
        return tuple(
            replace(term, name=f"{term.name}{order}", vector=amplitude)
            for term in self.terms
        )

    @property
    def is_position_curve(self) -> bool:
        return self.order < _WAVES

    def drawn(self, label: str, x: Array) -> tuple[str, Array]:
        period = 2 * np.pi / self.order
        return "joint position within one period of the ripple [rad]", np.mod(x, period)

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        return np.cos(self.order * q), np.sin(self.order * q)


def _step(facts: JointFacts) -> float:
    """Half of the difference in order that the range of a joint resolves."""
    return float(np.pi / (2 * max(np.ptp(facts.q), 1e-9)))


def _orders(facts: JointFacts) -> Array:
    """Orders of ripple to look at, by half of what q resolves.

    From where they differ from a spring, which is of order 1 where it pulls a lever, to where they
    no longer pass the torque filter.
    """
    if not len(facts.unexplained):
        return np.zeros(0)
    step = _step(facts)
    first = 1.0 + step
    last = (
        2 * np.pi * facts.cutoff_hz / max(float(np.median(np.abs(facts.dq))), _SLOWEST)
    )
    count = min(_MOST_ORDERS, max(0, int((last - first) / step) + 1))
    return np.asarray(first + step * np.arange(count), float)


def _gains(orders: Array, q: Array, e: Array, beside: Array) -> Array:
    """Fall of ‖e‖² by a cosine and a sine of each of evenly spaced orders, shape (orders,).

    Beside orthonormal columns, (n, k), that are free; none where these leave nothing of the two.
    """
    columns = np.column_stack([beside, e - beside @ (beside.T @ e)])
    waves = np.exp(1j * np.outer(q, (orders - orders[0])[:_TOGETHER]))
    n = len(q)
    m = len(orders)
    squares = np.empty(m, complex)
    along = np.empty((columns.shape[1], m), complex)
    for k in range(0, m, _TOGETHER):
        part = slice(k, k + _TOGETHER)
        z = (
            np.exp(1j * orders[k] * q)[:, None] * waves[:, : len(orders[part])]
        )  # e^{i N q}
        along[:, part] = (columns.T @ z.view(float)).view(complex)
        squares[part] = np.einsum("no,no->o", z, z)
    known = along[:-1]
    own = along[-1]
    # with what is left of them, c and s: Σ c² + s², Σ (c + i s)², and four times their determinant
    power = n - (np.abs(known) ** 2).sum(axis=0)
    square = squares - (known**2).sum(axis=0)
    determinant = power**2 - np.abs(square) ** 2
    least = 4 * _RIDGE * n**2
    fall = 2 * (power * np.abs(own) ** 2 - (square.conj() * own**2).real)
    gains = np.where(determinant > least, fall / np.maximum(determinant, least), 0.0)
    return np.asarray(gains, float)


@registered
class Spring(JointEffect):
    """A spring beside the joint: τ = k q − k q_0, or a cos q + b sin q where it pulls a lever."""

    name = "spring"
    family = "static"
    contains = ("torque_offset",)
    usual = True
    abscissa = "position"
    told = (
        (f"{by.UNPOWERED}; or {by.TILTED}, a spring's stays", "inertial_parameters"),
        (by.UNLOADED, "payload"),
        (f"{by.TURNED}: a spring's torque stays", "gravity_direction"),
    )
    terms = (Parameter("k", "N·m/rad"), Parameter("moment", "N·m"))

    lever: bool = False  # whether it pulls one, as in counterbalanced shoulders

    @classmethod
    def candidates(cls, joint: str, facts: JointFacts) -> Iterable[Self]:
        return cls((joint,)), cls((joint,), lever=True)

    @property
    def own_terms(self) -> tuple[Parameter, ...]:
        lever = tuple(
            Parameter(f"spring_{s}", "N·m", vector="amplitude") for s in ("cos", "sin")
        )
        return lever if self.lever else self.terms

    @property
    def is_position_curve(self) -> bool:
        return True

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        return (np.cos(q), np.sin(q)) if self.lever else (q, np.ones_like(q))


@dataclass(frozen=True)
class _Lag(Effect):
    """The link lags behind the motor, on whose side the encoder sits."""

    family = "transmission"
    arity = 1
    of_state_alone = False


@registered
class JointElasticity(_Lag):
    """Link angle = motor angle − c τ with the compliance c = 1/k, to first order in c."""

    name = "joint_elasticity"
    smooth = True
    terms = (Parameter("compliance", "rad/(N·m)", 0.0),)
    told = (
        (f"{by.LOCKED}: play yields at once, a spring in proportion", "backlash"),
        (by.UNLOADED, "payload"),
    )

    def columns(self, robot: Robot, motion: Motion) -> Array:
        j = self.rows(robot)[0]
        return torque_along(robot, motion, j, -rigid_torque(robot, motion)[:, j])[
            :, :, None
        ]


@registered
class Backlash(_Lag):
    """Link angle = motor angle − lag, the lag within ± g / 2.

    Where the load's sign changes the link flies from one end of the gap to the other, its
    acceleration less than the motor's by the torque that nothing gives it.
    """

    name = "backlash"
    terms = (Parameter("gap", "rad", 0.0),)
    shapes = (
        Shape(
            "trial",
            "rad",
            trial=True,
            grid=lambda facts: _GAPS,
            most=lambda facts: _GAPS[-1],
        ),
    )
    told = ((by.SPEEDS, "time_delay"),)

    trial: float = 3e-3  # gap for which the flights are computed [rad]

    def columns(self, robot: Robot, motion: Motion) -> Array:
        j = self.rows(robot)[0]
        _, _, by_ddq = torque_derivatives(robot, motion)
        inertia = np.diagonal(by_ddq, axis1=1, axis2=2)
        if inertia[:, j].min() <= _MASSLESS * inertia.max():
            return np.zeros((*motion.q.shape, 1))  # such a link is never left behind
        acceleration = rigid_torque(robot, motion)[:, j] / inertia[:, j]
        lag = play(motion.t, acceleration, self.trial)
        return torque_along(robot, motion, j, -(lag / self.trial))[:, :, None]


def play(t: Array, acceleration: Array, gap: float) -> Array:
    """Lag of a link behind its motor over time, within ± gap / 2; arrays of shape (n,).

    ``acceleration`` is what the motor would have to give the link to take it along.
    """
    half = gap / 2
    n = len(t)
    lags = np.empty(n)
    pulls = (np.flatnonzero(acceleration < 0), np.flatnonzero(acceleration > 0))
    steps = np.diff(t, prepend=t[0]).tolist()
    gives = acceleration.tolist()
    lag = half * float(np.sign(acceleration[0]) or 1.0)
    k = 0
    while k < n:
        leaves = pulls[
            lag < 0
        ]  # instants that pull the link away from this end of the gap
        at = int(np.searchsorted(leaves, max(k, 1)))
        free = int(leaves[at]) if at < len(leaves) else n
        lags[k:free], k, speed = lag, free, 0.0
        while k < n:  # it flies
            speed += gives[k] * steps[k]
            lag += speed * steps[k]
            landed = abs(lag) >= half
            lags[k] = lag = half * float(np.sign(lag)) if landed else lag
            k += 1
            if landed:
                break
    return lags


@registered
class TimeDelay(_ReadingEffect):
    """Reading(t) = τ(t − d), to first order in d around a trial delay.

    Positions that come late are a negative delay of the torque.
    """

    name = "time_delay"
    terms = (Parameter("delay", "s", typical=0.05),)
    shapes = (
        Shape(
            "trial",
            "s",
            positive=False,
            trial=True,
            grid=lambda facts: _DELAYS,
            most=lambda facts: _LONGEST,
        ),
    )
    abscissa = "torque rate"
    told = (
        (by.SPEEDS, "inertial_parameters encoder_scale"),
        (by.WARM, "thermal_friction_drift"),
    )

    trial: float = 1e-3  # delay at which the column is the exact difference [s]

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.trial:
            raise BadInput(f"effect {self.name}: trial must not be zero")

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """(τ(t − d₀) − τ(t)) / d₀ at these joints."""
        tau = carried_torque(robot, motion)
        t = motion.t
        columns = np.zeros((len(motion), robot.nv, 1))
        for j in self.rows(robot):
            late = np.interp(t - self.trial, t, tau[:, j])
            columns[:, j, 0] = (late - tau[:, j]) / self.trial
        return columns

    def sentence(
        self, robot: Robot, joints: Sequence[str], sizes: Sequence[Size]
    ) -> str:
        delay = 1e3 * sizes[0].value
        std = 1e3 * sizes[0].std
        return f"The torque lags the motion by {delay:.1f} ± {std:.2g} ms"
