"""Drives: torque offset, rotors, springs, ripple, elasticity and play."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
import scipy

from excitant.robots.effects import experiments as by
from excitant.robots.effects.base import (
    Acts,
    Effect,
    Export,
    JointEffect,
    PairEffect,
    Parameter,
    Physics,
    Words,
    registered,
)
from excitant.robots.effects.search import JointFacts, Search, Shape, between
from excitant.robots.motion import Array, Motion, frozen, power_density
from excitant.robots.regressor import (
    CACHED_MOTIONS,
    rigid_torque,
    torque_along,
    torque_derivatives,
)
from excitant.robots.robot import Robot

BACKLASH_GAPS = np.geomspace(3e-4, 0.1, 12).tolist()  # rad
MASSLESS = 1e-9  # of the largest inertia that a joint moves: rounding
RIPPLE_CANDIDATES = 3  # orders at each joint, the best of all
MOST_ORDERS = 600
ORDERS_AT_ONCE = 30  # which fit into the processor's cache
SPECTRUM = 256  # samples of each stretch of which power is averaged
NOISE_BAND = 4.0  # times a frequency, up to which noise is looked for
NOISE_RISE = 3.0  # times the power at that frequency, which noise exceeds
SLOW_RIPPLE = 3.0  # periods per turn, below which a ripple is as smooth as a spring
DEPENDENT = 1e-8  # determinant of two unit columns of which nothing is left
SLOWEST_MEDIAN = 1e-3  # rad/s


@registered
class TorqueOffset(JointEffect):
    """τ = τ_0: constant torque, current-sensor offset or asymmetric Coulomb friction."""

    name = "torque_offset"
    family = "static"
    terms = (Parameter("offset", "N·m"),)
    search = Search("standard", at_rest=True)
    export = Export(
        "offset",
        {
            "mjcf": "torque offsets are the bias of the actuators: they act on controls, and are "
            "not part of what mj_inverse returns",
            "ros2_control": "",
        },
    )
    words = Words(
        "time",
        {
            "inertial_parameters": f"{by.POSTURE}: an offset does not turn with gravity",
            "payload": "repeat the motion without the load: an offset stays",
            "spring torque_ripple": by.STATIC,
            "gravity_direction": f"{by.TURNED}: an offset stays, tilt turns along",
            "encoder_offset": f"{by.ZERO}; {by.UNPOWERED}",
        },
    )

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        return (np.ones(dq.shape),)


@registered
class RotorInertia(JointEffect):
    """τ = I_a q̈: rotor and gear inertia at the joint side."""

    name = "rotor_inertia"
    family = "body"
    terms = (Parameter("Ia", "kg·m²", 0.0),)
    search = Search("standard")
    export = Export(
        "rotor",
        {
            "mjcf": "",
            "sdf": "rotor inertia is written as drake:rotor_inertia, which Drake reads and Gazebo "
            "passes over",
            "ros2_control": "",
        },
    )
    words = Words(
        "acceleration",
        {
            "inertial_parameters": by.FOLDED,
            "joint_elasticity": f"find the resonance by a chirp; {by.LOCKED}",
            "spring": "hold the joint at several angles: a spring pulls at rest, inertia does not",
            "inertia_coupling": by.HOLD_OTHER,
            "torque_gain": f"{by.LEVER}; {by.DATA_SHEET}",
            "payload": by.UNLOADED,
            "time_delay torque_ripple": by.SECOND,
            "kinematic_error": by.DATA_SHEET,
        },
    )

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        return (ddq,)


@registered
class InertiaCoupling(PairEffect):
    """τ_i = I q̈_k, τ_k = I q̈_i: a rotor that turns with both joints."""

    name = "inertia_coupling"
    family = "body"
    terms = (Parameter("Ic", "kg·m²"),)
    words = Words("other acceleration")

    def columns(self, robot: Robot, motion: Motion) -> Array:
        rows = self.rows(robot)
        columns = np.zeros((len(motion), robot.nv, 1))
        columns[:, rows, 0] = motion.ddq[:, rows[::-1]]
        return columns


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
    speed = max(float(np.median(np.abs(facts.dq))), SLOWEST_MEDIAN)
    last = 2 * np.pi * facts.cutoff_hz / speed
    count = min(MOST_ORDERS, max(0, int((last - first) / step) + 1))
    return first + step * np.arange(float(count))


def _gains(orders: Array, q: Array, e: Array, beside: Array) -> Array:
    """Fall of ‖e‖² by a cosine and a sine of each of evenly spaced orders, shape (orders,).

    Beside orthonormal columns, (n, k), that are free; none where these leave nothing of the two.
    """
    columns = np.column_stack([beside, e - beside @ (beside.T @ e)])
    waves = np.exp(1j * np.outer(q, (orders - orders[0])[:ORDERS_AT_ONCE]))
    n = len(q)
    m = len(orders)
    squares = np.empty(m, complex)
    along = np.empty((columns.shape[1], m), complex)
    for k in range(0, m, ORDERS_AT_ONCE):
        part = slice(k, k + ORDERS_AT_ONCE)
        # e^{i N q}
        z = np.exp(1j * orders[k] * q)[:, None] * waves[:, : len(orders[part])]
        along[:, part] = (columns.T @ z.view(float)).view(complex)
        squares[part] = np.einsum("no,no->o", z, z)
    known = along[:-1]
    own = along[-1]
    # with what is left of them, c and s: Σ c² + s², Σ (c + i s)², and four times their determinant
    power = n - (np.abs(known) ** 2).sum(axis=0)
    square = squares - (known**2).sum(axis=0)
    determinant = power**2 - np.abs(square) ** 2
    least = 4 * DEPENDENT * n**2
    fall = 2 * (power * np.abs(own) ** 2 - (square.conj() * own**2).real)
    return np.where(determinant > least, fall / np.maximum(determinant, least), 0.0)


def _best_orders(ripple: TorqueRipple, facts: JointFacts) -> list[Effect]:
    """The orders that lower the joint's error most, far enough apart to differ."""
    orders = _orders(facts)
    if not len(orders):
        return []
    q = facts.q
    smooth = np.column_stack([np.ones_like(q), q, np.cos(q), np.sin(q)])
    basis, _ = np.linalg.qr(smooth)
    gains = _gains(orders, q, facts.unexplained, basis)
    apart = 3 * _step(facts)
    best: list[float] = []
    for order in orders[np.argsort(-gains)].tolist():
        if len(best) == RIPPLE_CANDIDATES:
            break
        if all(abs(order - other) > apart for other in best):
            best.append(order)
    return [replace(ripple, order=order) for order in best]


def _finer_orders(
    ripple: TorqueRipple, beside: Iterable[Effect], facts: JointFacts
) -> list[Effect]:
    """Orders at thirds of the way to the next ones that would be looked at, and at ninths."""
    finer: list[Effect] = []
    for step in (_step(facts), _step(facts) / 3):
        ends = [
            replace(ripple, order=ripple.order + sign * step) for sign in (-1, 1)
        ]
        finer += between(ripple, ends, facts)
    return finer


@registered
class TorqueRipple(JointEffect):
    """τ = a cos(N q) + b sin(N q): cogging, tooth mesh, eccentricity."""

    name = "torque_ripple"
    family = "static"
    terms = (Parameter("ripple_cos", "N·m"), Parameter("ripple_sin", "N·m"))
    search = Search(
        shapes=(Shape("order", "1/turn"),),
        candidates=_best_orders,
        trials=lambda facts: len(_orders(facts)),
        refined=_finer_orders,
    )
    words = Words(
        "position",
        {
            "spring inertial_parameters": by.STATIC,
            "joint_elasticity backlash": by.ORDERS,
            "payload": by.UNLOADED,
        },
        drawn=lambda ripple, label, q: (
            "joint position within one period of the ripple [rad]",
            np.mod(q, 2 * np.pi / ripple.order),
        ),
    )

    order: float = 1.0  # N, periods per turn of the joint

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
    def curve(self) -> str:
        return "position" if self.order < SLOW_RIPPLE else ""

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        return np.cos(self.order * q), np.sin(self.order * q)


@registered
class Spring(JointEffect):
    """A spring beside the joint: τ = k q − k q_0, or a cos q + b sin q where it pulls a lever."""

    name = "spring"
    family = "static"
    search = Search(
        "usual",
        contains=("torque_offset",),
        candidates=lambda effect, facts: (effect, replace(effect, lever=True)),
    )
    words = Words(
        "position",
        {
            "inertial_parameters": f"{by.UNPOWERED}; or {by.TILTED}, a spring's stays",
            "payload": by.UNLOADED,
            "gravity_direction": f"{by.TURNED}: a spring's torque stays",
        },
    )
    terms = (Parameter("k", "N·m/rad"), Parameter("moment", "N·m"))
    export = Export("spring", {"mjcf": "", "sdf": ""})

    lever: bool = False  # whether it pulls one, as in counterbalanced shoulders

    @property
    def own_terms(self) -> tuple[Parameter, ...]:
        lever = tuple(
            Parameter(f"spring_{s}", "N·m", vector="amplitude")
            for s in ("cos", "sin")
        )
        return lever if self.lever else self.terms

    @property
    def exported(self) -> Export:
        return Export() if self.lever else self.export

    @property
    def curve(self) -> str:
        return "position"

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        return (np.cos(q), np.sin(q)) if self.lever else (q, np.ones_like(q))


class _Lag(Effect):
    """The link lags behind the motor, on whose side the encoder sits."""

    family = "transmission"
    acts_on = Acts.ONE


@lru_cache(maxsize=CACHED_MOTIONS)
def _load(robot: Robot, motion: Motion, j: int) -> Array:
    """Rigid-body torque of joint j, shape (n,), without noise of positions.

    Power of a motion falls with frequency; that of noise rises, and then derivatives of the torque
    would be noise alone.
    """
    tau = rigid_torque(robot, motion)[:, j]
    if len(tau) < SPECTRUM:
        return tau
    rate = 1 / (motion.t[1] - motion.t[0])
    f, power = power_density(tau, rate, SPECTRUM)
    for edge, least in zip(f[1:], power[1:], strict=True):
        above = power[(f > edge) & (f <= NOISE_BAND * edge)]
        if len(above) and np.median(above) > NOISE_RISE * least:
            return frozen(_low_passed(tau, edge / rate))
    return tau


def _low_passed(x: Array, edge: float) -> Array:
    """A signal, (n,), through a Butterworth filter of order 4 forward and backward.

    Two sections of order 2 by the bilinear transform, K = tan(π edge), the edge in cycles a sample.
    ``scipy.signal.sosfiltfilt`` does the same, but loading that takes half a second.
    """
    K = np.tan(np.pi * edge)
    ends = 15  # samples that are mirrored beyond each
    passed = np.pad(x, ends, mode="reflect", reflect_type="odd")
    for _ in range(2):
        start = passed[0]
        passed = passed - start
        for damping in 2 * np.sin(np.pi / 8 * np.array([1, 3])):
            recursion = [
                1 + damping * K + K**2,
                2 * (K**2 - 1),
                1 - damping * K + K**2,
            ]
            bands = np.repeat(np.c_[recursion], len(passed), axis=1)
            driven = K**2 * np.convolve(passed, [1, 2, 1])[: len(passed)]
            passed = scipy.linalg.solve_banded((2, 0), bands, driven)
        passed = (passed + start)[::-1]
    return passed[ends:-ends]


@registered
class JointElasticity(_Lag):
    """Link angle = motor angle − c τ with the compliance c = 1/k, to first order in c."""

    name = "joint_elasticity"
    physics = Physics(smooth=True)
    terms = (Parameter("compliance", "rad/(N·m)", 0.0),)
    words = Words(
        separated_by={
            "backlash": f"{by.LOCKED}: play yields at once, a spring in proportion",
            "payload": by.UNLOADED,
        }
    )

    def columns(self, robot: Robot, motion: Motion) -> Array:
        j = self.rows(robot)[0]
        return torque_along(robot, motion, j, -_load(robot, motion, j))


@registered
class Backlash(_Lag):
    """Link angle = motor angle − lag, the lag within ± g / 2.

    Where the load's sign changes the link flies from one end of the gap to the other, its
    acceleration less than the motor's by the torque that nothing gives it.
    """

    name = "backlash"
    terms = (Parameter("gap", "rad", 0.0),)
    search = Search(
        shapes=(
            Shape(
                "trial",
                "rad",
                trial=True,
                grid=lambda facts: BACKLASH_GAPS,
                most=lambda facts: BACKLASH_GAPS[-1],
            ),
        )
    )
    words = Words(
        separated_by={
            "time_delay": by.SPEEDS,
        }
    )

    trial: float = 3e-3  # gap for which the flights are computed [rad]

    def columns(self, robot: Robot, motion: Motion) -> Array:
        j = self.rows(robot)[0]
        _, _, by_ddq = torque_derivatives(robot, motion)
        inertia = np.diagonal(by_ddq, axis1=1, axis2=2)
        if inertia[:, j].min() <= MASSLESS * inertia.max():
            # such a link is never left behind
            return np.zeros((*motion.q.shape, 1))
        acceleration = _load(robot, motion, j) / inertia[:, j]
        lag = play(motion.t, acceleration, self.trial)
        return torque_along(robot, motion, j, -(lag / self.trial))


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
    lag = half * (np.sign(acceleration[0]) or 1.0)
    k = 0
    while k < n:
        # instants that pull the link away from this end of the gap
        leaves = pulls[int(lag < 0)]
        at = int(np.searchsorted(leaves, max(k, 1)))
        free = int(leaves[at]) if at < len(leaves) else n
        lags[k:free] = lag
        k = free
        speed = 0.0
        while k < n:  # it flies
            speed += gives[k] * steps[k]
            lag += speed * steps[k]
            landed = abs(lag) >= half
            lags[k] = lag = half * float(np.sign(lag)) if landed else lag
            k += 1
            if landed:
                break
    return lags
