"""Torque against motion, in a form in which hypotheses about the recording are cheap to test.

Y(q, q̇, q̈) = G(q) + D(q, q̇, q̈), and D scales with 1/c² when the time of the log runs c times too
slow. Parameters are left free, so nothing depends on the masses given; friction, rotor inertia
and an offset per joint are free as well. Filters are set in parts of the motion's own bandwidth,
so that they mean the same whatever the unit of time.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from excitant.identify.differentiators import low_pass
from excitant.identify.faults.log import ALARM, Log, Rows
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


@dataclass(frozen=True, eq=False)
class Smooth:
    """A log in its motion's own bandwidth, evenly sampled.

    Attributes:
        motion: Filtered motion, N instants.
        tau: Torque through the same filter, shape (N, nv).
        cutoff: Cut-off of the filters [1/time unit of the log].
        rate: Rows per time unit of the log.
    """

    motion: Motion
    tau: Array
    cutoff: float
    rate: float


def smooth(log: Log) -> Smooth | None:
    """Filter, differentiate and decimate; None when the log is too short for it."""
    grid = np.arange(log.t[0], log.t[-1] + 1e-9 * log.step, log.step)
    if len(grid) < 100 or len(grid) > 4 * len(log) or np.ptp(log.q) == 0:
        return None
    rate = 1 / log.step
    least = 2 * _BAND / (grid[-1] - grid[0])
    cutoff = min(max(_BAND * _frequency(log), least), _NYQUIST * rate)
    q = np.column_stack([np.interp(grid, log.t, x) for x in log.q.T])
    tau = np.column_stack([np.interp(grid, log.t, x) for x in log.tau.T])
    q, tau = (low_pass(x, min(cutoff, 0.45 * rate), rate) for x in (q, tau))
    spline = scipy.interpolate.make_interp_spline(grid, q, k=5)
    stride = max(1, int(rate / (_OVERSAMPLED * cutoff)), len(grid) // _ROWS)
    at = grid[::stride]
    motion = Motion(at, spline(at), spline.derivative(1)(at), spline.derivative(2)(at))
    return Smooth(motion, tau[::stride], cutoff, rate / stride)


def _frequency(log: Log) -> float:
    """Largest rms frequency of a joint's motion [1/time unit]."""
    span = np.std(log.q, axis=0)
    moved = span > 50 * log.grain
    if not moved.any():
        return 0.0
    speed = np.sqrt((log.travel[:, moved] ** 2).mean(axis=0)) / log.step
    return float((speed / span[moved]).max() / (2 * np.pi))


class TorqueFit:
    """Least squares of a log's filtered torque on everything that is free.

    Normal equations, assembled for any time factor and torque signs.

    Attributes:
        robot: The arm.
        log: The log.
        data: The same, filtered.
        joints: Joints whose torque is used.
        G: Columns of the links at rest, shape (N, nv, 10 nv).
        D: What motion adds to them, same shape.
        F: Columns of each joint's own effects, shape (N, nv, 4).
        tau: Filtered torque, shape (N, nv).
        size: Mean square of each joint's torque, shape (nv,).
        sigma: Error of each joint by parameters of its own, shape (nv,).
        freedom: Parameters of the links and of each joint, 10 nv + 4 nv.

    Args:
        robot: The arm.
        log: The log.
        data: The same, filtered.
        joints: Joints whose torque is used.
        factor: Factor of each joint's position, shape (nv,); velocities follow.
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
        """Fit with what motion adds times s, and torques times their sign.

        Returns:
            Parameters of the links (those that show), then of each joint, shape (10 nv + 4 nv,),
            and mean square of what is left of each joint's torque, shape (nv,).
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
        """Whether another reading explains the torque beyond chance.

        Args:
            power: Mean squares that the other reading leaves, shape (nv,).
            tests: Readings that were tried.
            freedom: Parameters that it has more; where the models are not nested, and when None,
                as many as the model has, since all of them can adapt to a wrong reading.
        """
        ratio = (power / self.power)[self.joints]
        bound = float(scipy.special.chdtri(freedom or self.freedom, ALARM / tests))
        return self.gain(power) > bound and bool(ratio.min() < _HALVED and ratio.max() < 2)


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
