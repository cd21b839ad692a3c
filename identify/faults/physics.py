"""Rate, units and signs judged by the physics: which reading of the log explains its torque.

A hypothesis ("positions in degrees", "joint 3 counted the other way", "time twice too slow") is
named when it explains the torque better than the log as it stands: a likelihood ratio beyond
chance in independent rows, at least one joint's squared error halved, and no joint's doubled.

Y(q, q̇, q̈) = G(q) + D(q, q̇, q̈), and D scales with 1/c² when the time of the log runs c times too
slow. All parameters are free, so nothing depends on the masses given, and filters are set in parts
of the motion's own bandwidth, so that they mean the same whatever the unit of time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from excitant.identify.differentiators import low_pass
from excitant.identify.faults.fault import ALARM, Fault, Log, Remedy, Rows, normal_bound
from excitant.identify.faults.velocity import RATES, slower
from excitant.identify.least_squares import autocorrelation_time
from excitant.robots.motion import Array, Motion
from excitant.robots.regressor import regressor
from excitant.robots.robot import Robot

_BAND = 8.0  # bandwidth kept, in parts of the motion's rms frequency
_OVERSAMPLED = 8  # rows per period of the cut-off
_ROWS = 1200  # at most
_NYQUIST = 0.2  # of the sampling rate: highest cut-off
_PER_JOINT = 4  # columns of each joint's own effects
_RANK = 1e-10
_HALVED = 0.5
_BROAD = np.geomspace(1e-3, 1e3, 25)  # time factors tried first
_NEAR = 0.05  # of a clear factor
_EXPLAINED = 0.5  # of the torque's variance: the model is worth listening to
_SIGNAL = 3.0  # a part of the torque that is to have a sign exceeds the error by so much
_BEYOND = 1.2 * 2 * np.pi  # rad: more than joints turn to one side


@dataclass(frozen=True, eq=False)
class Smooth:
    """A log in its motion's own bandwidth, evenly sampled at N instants."""

    motion: Motion
    tau: Array  # through the same filter, shape (N, nv)
    cutoff: float  # of the filters [1/time unit of the log]
    rate: float  # rows per time unit of the log


def smooth(log: Log) -> Smooth | None:
    """Filter, differentiate and decimate; None when the log is too short for it."""
    grid = np.arange(log.t[0], log.t[-1] + 1e-9 * log.step, log.step)
    if len(grid) < 100 or len(grid) > 4 * len(log) or np.ptp(log.q) == 0:
        return None
    rate, span = 1 / log.step, np.std(log.q, axis=0)
    frequency, moved = 0.0, span > 50 * log.grain
    if moved.any():
        speed = np.sqrt((log.travel[:, moved] ** 2).mean(axis=0)) / log.step
        frequency = float((speed / span[moved]).max() / (2 * np.pi))
    least = 2 * _BAND / (grid[-1] - grid[0])
    cutoff = min(max(_BAND * frequency, least), _NYQUIST * rate)
    q, tau = (
        low_pass(np.column_stack([np.interp(grid, log.t, c) for c in x.T]), cutoff, rate)
        for x in (log.q, log.tau)
    )
    spline = scipy.interpolate.make_interp_spline(grid, q, k=5)
    stride = max(1, int(rate / (_OVERSAMPLED * cutoff)), len(grid) // _ROWS)
    at = grid[::stride]
    motion = Motion(at, spline(at), spline.derivative(1)(at), spline.derivative(2)(at))
    return Smooth(motion, tau[::stride], cutoff, rate / stride)


class TorqueFit:
    """Least squares of a log's filtered torque on everything that is free.

    Normal equations, assembled for any time factor and torque signs. Columns of the links at rest G
    and what motion adds to them D have the shape (N, nv, 10 nv), those of each joint's own effects
    F (N, nv, 4). ``size`` is the mean square of each joint's torque, ``sigma`` its error by
    parameters of its own, shape (nv,). Positions (and velocities) are multiplied by ``factor``.
    """

    def __init__(
        self, robot: Robot, log: Log, data: Smooth, joints: list[int], factor: Array | float = 1.0
    ) -> None:
        q, dq, ddq = (x * factor for x in (data.motion.q, data.motion.dq, data.motion.ddq))
        still = np.zeros_like(q)
        G = regressor(robot, Motion(data.motion.t, q, still, still))
        D = regressor(robot, Motion(data.motion.t, q, dq, ddq)) - G
        F = np.stack([dq, np.sign(dq), ddq, np.ones_like(q)], axis=2)
        edge, cutoff = round(data.rate / data.cutoff), min(data.cutoff / 2, 0.45 * data.rate)
        filtered = (low_pass(x, cutoff, data.rate) for x in (G, D, F, data.tau))
        self.G, self.D, self.F, self.tau = (x[edge : len(q) - edge] for x in filtered)
        self.robot, self.log, self.data, self.joints = robot, log, data, joints
        self.freedom = self.G.shape[2] + _PER_JOINT * robot.nv
        self.size: Array = np.maximum((self.tau**2).mean(axis=0), 1e-300)
        self._A, self._b = {}, {}
        alone = self.size.copy()
        for j in joints:
            own, y = self.F[:, j], self.tau[:, j]
            W, V = np.hstack([self.G[:, j], own]), np.hstack([self.D[:, j], 0 * own])
            self._A[j] = W.T @ W, W.T @ V + V.T @ W, V.T @ V
            self._b[j] = W.T @ y, V.T @ y
            A, b = np.sum(self._A[j], axis=0), np.sum(self._b[j], axis=0)
            alone[j] = self._left(j, A, b, _solve(A, b))
        self.sigma: Array = np.sqrt(alone)

    def _left(self, j: int, A: Array, b: Array, x: Array) -> float:
        left = self.size[j] - (2 * b - A @ x) @ x / len(self.tau)
        return float(max(left, 1e-10 * self.size[j]))

    def _members(self, j: int) -> Rows:
        """Indices of the parameters that act on joint j."""
        p = self.G.shape[2]
        return np.append(np.arange(p), p + _PER_JOINT * j + np.arange(_PER_JOINT))

    def fit(self, s: float = 1.0, sign: Array | None = None) -> tuple[Array, Array]:
        """Parameters, shape (14 nv,), and mean square of what is left of each torque, shape (nv,).

        What motion adds is multiplied by s, torques by their sign.
        """
        A, b = np.zeros((self.freedom, self.freedom)), np.zeros(self.freedom)
        parts = []
        for j in self.joints:
            still, mixed, moved = self._A[j]
            own = still + s * mixed + s**2 * moved
            side = (1.0 if sign is None else sign[j]) * (self._b[j][0] + s * self._b[j][1])
            rows = self._members(j)
            A[np.ix_(rows, rows)] += own / self.sigma[j] ** 2
            b[rows] += side / self.sigma[j] ** 2
            parts.append((j, rows, own, side))
        x = _solve(A, b)
        power = self.size.copy()
        for j, rows, own, side in parts:
            power[j] = self._left(j, own, side, x[rows])
        return x, power

    @cached_property
    def power(self) -> Array:
        """What the log as it stands leaves of each joint's torque, mean square, shape (nv,)."""
        return self.fit()[1]

    @cached_property
    def rows(self) -> Array:
        """Independent rows of each joint's error, shape (nv,)."""
        rows, (x, _) = np.ones(self.robot.nv), self.fit()
        for j in self.joints:
            W = np.hstack([self.G[:, j] + self.D[:, j], self.F[:, j]])
            error = self.tau[:, j] - W @ x[self._members(j)]
            rows[j] = len(error) / autocorrelation_time(error) if error.any() else 1.0
        return rows

    def gain(self, power: Array) -> float:
        """Twice the log-likelihood ratio of another reading against the log as it stands."""
        return float((self.rows * np.log(self.power / power))[self.joints].sum())

    def better(self, power: Array, tests: int, freedom: int | None = None) -> bool:
        """Whether another of some readings, which leaves ``power``, is better beyond chance.

        ``freedom`` counts the parameters that it has more; where the models are not nested (None),
        as many as the model has, since all of them can adapt to a wrong reading.
        """
        ratio = (power / self.power)[self.joints]
        bound = float(scipy.special.chdtri(freedom or self.freedom, ALARM / tests))
        return self.gain(power) > bound and bool(ratio.min() < _HALVED and ratio.max() < 2)

    def compared(self, power: Array) -> str:
        """How much better another reading is, in words."""
        ratio = np.sqrt(power / self.power)[self.joints]
        best = self.joints[int(np.argmin(ratio))]
        return (
            f"the error of the best model of its torque falls to {100 * ratio.min():.2g} % at "
            f"{self.log.joints[best]} (likelihood ratio {self.gain(power):.3g} in "
            f"{self.rows[self.joints].sum():.0f} independent rows)"
        )


def torque_fit(robot: Robot, log: Log, data: Smooth, dead: set[str]) -> TorqueFit | None:
    """The fit of a log's torque; None when no joint's torque can be used."""
    alive = [j for j in range(robot.nv) if log.joints[j] not in dead and np.ptp(data.tau[:, j]) > 0]
    case = TorqueFit(robot, log, data, alive)
    return case if alive and len(case.tau) >= 60 else None


def scaled_least_squares(W: Array, y: Array) -> tuple[Array, Array, Array]:
    """Columns scaled to a mean square of 1, their coefficients, and what is left of y."""
    size = np.sqrt((W**2).mean(axis=0))
    W = W / np.where(size > 0, size, 1.0)
    x = np.asarray(np.linalg.lstsq(W, y, rcond=_RANK)[0], float)
    return W, x, y - W @ x


def _solve(A: Array, b: Array) -> Array:
    """Least-squares solution of normal equations that may be singular."""
    d = np.sqrt(np.diag(A))
    d = np.where(d > 0, d, 1.0)
    values, V = np.linalg.eigh(A / np.outer(d, d))
    kept = values > _RANK * max(float(values[-1]), 1e-300)
    V = V[:, kept] / d[:, None]
    return np.asarray(V @ ((V.T @ b) / values[kept]), float)


def physics_faults(case: TorqueFit) -> list[Fault]:
    """The faults of rate, unit and sign that the torque tells; the strongest reading counts."""
    if found := [*_degrees(case)] or [*_torque_signs(case)]:
        return found
    readings = [*_rate(case), *_position_signs(case)]
    return sorted(readings, key=lambda fault: -fault.evidence["gain"])[:1]


def _degrees(case: TorqueFit) -> Iterator[Fault]:
    """Positions in degrees, of all joints or of those beyond a turn."""
    log, largest = case.log, np.abs(case.log.q).max(axis=0)
    turning = np.asarray(case.robot.revolute)
    beyond = turning & (largest > _BEYOND)
    if not beyond.any():
        return
    tried = []
    for mask in [turning] if beyond.all() else [turning, beyond]:
        factor = np.where(mask, np.pi / 180, 1.0)
        power = TorqueFit(case.robot, log, case.data, case.joints, factor).power
        tried.append((case.gain(power), np.flatnonzero(mask), power))
    gain, joints, power = max(tried, key=lambda reading: reading[0])
    widest = int(np.argmax(largest))
    if not case.better(power, len(tried)):
        return
    yield Fault(
        "wrong_unit",
        log.names(joints),
        f"q is in degrees: it reaches {largest[widest]:.4g} at {log.joints[widest]}, and read in "
        f"degrees {case.compared(power)}",
        {"channel": "q", "gain": gain, "largest": largest},
        "multiplies q and dq, which agrees with it, by π/180",
        tuple(
            Remedy("scale", name, (int(j),), factor=np.pi / 180)
            for j in joints
            for name in ("q", "dq")
        ),
    )


def _position_signs(case: TorqueFit) -> Iterator[Fault]:
    for j, joint in enumerate(case.log.joints):
        flip = np.where(np.arange(case.robot.nv) == j, -1.0, 1.0)
        negated = TorqueFit(case.robot, case.log, case.data, case.joints, flip)
        readings = (
            ("q", ("q", "dq"), negated.power),
            ("q and tau", ("q", "dq", "tau"), negated.fit(sign=flip)[1]),
        )
        for what, channels, power in readings:
            if case.better(power, 2 * case.robot.nv):
                yield Fault(
                    "wrong_sign",
                    (joint,),
                    f"{what} of {joint} count the other way than the robot's: negated, "
                    f"{case.compared(power)}",
                    {"channel": what, "gain": case.gain(power)},
                    f"negates {what} (and dq) of {joint}",
                    tuple(Remedy("scale", name, (j,), factor=-1.0) for name in channels),
                )


def _rate(case: TorqueFit) -> Iterator[Fault]:
    """Profile likelihood over a factor of the time: inertial torque goes with its square."""

    def gain(logarithm: float) -> float:
        return case.gain(case.fit(s=float(np.exp(2 * logarithm)))[1])

    def bound(side: int) -> float:
        """Factor at which the likelihood has fallen by its 95 % bound."""
        width = 0.01
        while gain(peak) - gain(peak + side * width) < 3.84 and width < 3:
            width *= 1.5
        return float(np.exp(peak + side * width))

    start = max(np.log(_BROAD).tolist(), key=gain)
    step = np.log(_BROAD[1] / _BROAD[0])
    peak = scipy.optimize.minimize_scalar(
        lambda x: -gain(x),
        bounds=(start - step, start + step),
        method="bounded",
        options={"xatol": 1e-3, "maxiter": 25},
    ).x
    c, log = float(np.exp(peak)), case.log
    power = case.fit(s=c**2)[1]
    near = [r for r in RATES if abs(c / r - 1) < _NEAR]
    freedom = 1 if near else None  # an odd factor may stand for anything the model lacks
    if abs(c - 1) < 2 * _NEAR or not case.better(power, len(_BROAD), freedom):
        return
    low, high = bound(-1), bound(1)
    factor = near[0] if near else c
    detail = (
        f"the time runs {c:.3g} times too {'slow' if c > 1 else 'fast'} for the torque "
        f"(95 % between {low:.3g} and {high:.3g}): so corrected, {case.compared(power)}; the "
        f"median step is {log.step:.4g} s, {log.step / factor:.4g} s would fit"
    )
    yield slower(log, factor, detail, factor=c, interval=(low, high), gain=case.gain(power))


def _torque_signs(case: TorqueFit) -> Iterator[Fault]:
    """Torques against the given model and against the friction they pay for.

    τ_j = g τ_model + F_v q̇ + F_c sign q̇ + I_a q̈ + offset. Gain g and the power that friction takes
    must not be negative. One that is, beyond chance, flips the sign unless the other objects.
    """
    model = (case.G + case.D) @ case.robot.phi
    bound = normal_bound(2 * len(case.joints))
    for j in case.joints:
        gain, friction, explained = _signs(case, model[:, j], j)
        votes = [z for z in (gain, friction) if abs(z) > bound]
        if explained < _EXPLAINED or not votes or max(votes) > 0:
            continue
        joint, why = case.log.joints[j], []
        if gain < -bound:
            why.append(f"it is {gain:.1f} standard errors opposite to the given model's torque")
        if friction < -bound:
            why.append(f"its friction would drive the joint by {-friction:.1f} standard errors")
        yield Fault(
            "wrong_sign",
            (joint,),
            f"tau of {joint} has the wrong sign: {' and '.join(why)} "
            f"({100 * explained:.0f} % of its variance explained)",
            {"channel": "tau", "gain": gain, "friction": friction, "explained": explained},
            f"negates tau of {joint}",
            (Remedy("scale", "tau", (j,), factor=-1.0),),
        )


def _signs(case: TorqueFit, model: Array, j: int) -> tuple[float, float, float]:
    """Gain and friction power in standard errors (0 when within the error), variance explained."""
    dq, dry, y = *case.F[:, j, :2].T, case.tau[:, j]
    columns = np.column_stack([model, case.F[:, j]])
    W, x, error = scaled_least_squares(columns, y)
    left = float(error.std())
    independent = max(len(y) / autocorrelation_time(error), 8.0)
    C = np.linalg.pinv(W.T @ W / len(y), rcond=1e-10) * left**2 / independent
    size = np.sqrt((columns[:, 1:3] ** 2).mean(axis=0))
    power = np.array([(dq * dq).mean(), np.abs(dq * dry).mean()]) / np.where(size > 0, size, 1.0)
    z = []
    for part, weight in ((slice(0, 1), np.ones(1)), (slice(1, 3), power)):
        clear = (W[:, part] @ x[part]).std() > _SIGNAL * left
        variance = float(weight @ C[part, part] @ weight)
        z.append(float(weight @ x[part] / np.sqrt(max(variance, 1e-300))) if clear else 0.0)
    return z[0], z[1], 1 - float(error.var() / max(y.var(), 1e-300))
