"""Torque against motion, in a form in which hypotheses about the recording are cheap to test.

Y(q, q̇, q̈) = G(q) + D(q, q̇, q̈), and D scales with 1/c² when the time of the log runs c times too
slow. Parameters are left free, so nothing depends on the masses given; friction, rotor inertia
and an offset per joint are free as well. Filters are set in parts of the motion's own bandwidth,
so that they mean the same whatever the unit of time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from excitant.identify.differentiators import low_pass
from excitant.identify.faults.log import Log, Rows
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


@dataclass(frozen=True, eq=False)
class Fit:
    """Least squares of the torque on free parameters, those of the links shared by all joints.

    Attributes:
        x: Parameters of the links (those that show), then of each joint, shape (10 nv + 4 nv,).
        power: Mean square of what is left of each joint's torque, shape (nv,).
    """

    x: Array
    power: Array


class Problem:
    """Least squares of the filtered torque on everything that is free.

    Normal equations, assembled for any time factor and torque signs.

    Attributes:
        joints: Joints whose torque is used.
        G: Columns of the links at rest, shape (N, nv, 10 nv).
        D: What motion adds to them, same shape.
        F: Columns of each joint's own effects, shape (N, nv, 4).
        tau: Filtered torque, shape (N, nv).
        size: Mean square of each joint's torque, shape (nv,).
        sigma: Error of each joint by parameters of its own, shape (nv,).

    Args:
        robot: The arm.
        data: Motion and torque.
        joints: Joints whose torque is used.
        factor: Factor of each joint's position, shape (nv,); velocities follow.
    """

    def __init__(
        self, robot: Robot, data: Smooth, joints: list[int], factor: Array | float = 1.0
    ) -> None:
        q, dq, ddq = (x * factor for x in (data.motion.q, data.motion.dq, data.motion.ddq))
        still = np.zeros_like(q)
        G = regressor(robot, Motion(data.motion.t, q, still, still))
        D = regressor(robot, Motion(data.motion.t, q, dq, ddq)) - G
        F = np.stack([dq, np.sign(dq), ddq, np.ones_like(q)], axis=2)
        edge, cutoff = round(data.rate / data.cutoff), min(data.cutoff / 2, 0.45 * data.rate)
        filtered = (low_pass(x, cutoff, data.rate) for x in (G, D, F, data.tau))
        self.G, self.D, self.F, self.tau = (x[edge : len(q) - edge] for x in filtered)
        self.joints, self.p, self.nv = joints, self.G.shape[2], robot.nv
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
        own = self.p + _PER_JOINT * j
        return np.append(np.arange(self.p), np.arange(own, own + _PER_JOINT))

    def fit(self, s: float = 1.0, sign: Array | None = None) -> Fit:
        """Parameters and errors with what motion adds times s, and torques times their sign."""
        size = self.p + _PER_JOINT * self.nv
        A, b = np.zeros((size, size)), np.zeros(size)
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
        return Fit(x, power)

    def independent(self, fit: Fit) -> Array:
        """Independent rows of each joint's error, shape (nv,)."""
        rows = np.ones(self.nv)
        for j in range(self.nv):
            error = self.tau[:, j]
            if j in self.joints:
                W = np.hstack([self.G[:, j] + self.D[:, j], self.F[:, j]])
                error = error - W @ fit.x[self._members(j)]
            if error.any():
                rows[j] = len(error) / autocorrelation_time(error)
        return rows


def _solve(A: Array, b: Array) -> Array:
    """Least-squares solution of normal equations that may be singular."""
    d = np.sqrt(np.diag(A))
    d = np.where(d > 0, d, 1.0)
    values, V = np.linalg.eigh(A / np.outer(d, d))
    kept = values > _RANK * max(float(values[-1]), 1e-300)
    V = V[:, kept] / d[:, None]
    return np.asarray(V @ ((V.T @ b) / values[kept]), float)
