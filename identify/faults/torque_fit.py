"""A log's torque against bodies near the nominal ones, each joint's own effects free.

    y_j = g_j Y_j(q, q̇, q̈) (φ̄ + S z) + F_j θ_j + noise,   z ~ N(0, 1)

φ̄ are the nominal bodies, off by `BODY_STD`, and one of them, or a tool, by more. F_j: viscous and
dry friction, rotor inertia and offset. g_j is 1 where torque was recorded, else the gain that suits
the nominal bodies best, to what their errors leave open. Filters are set in parts of the motion's
own bandwidth, so that they mean the same whatever the unit of time.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
import scipy

from excitant.identify.drive_gains import BODY_STD, PLACEHOLDER_STD, without_effects
from excitant.identify.faults.fault import Log, Remedy, Rows
from excitant.identify.least_squares import autocorrelation_time
from excitant.identify.prior import (
    link_coordinates,
    link_weights,
    placeholder_links,
    prior_parameters,
)
from excitant.identify.signals import differentiated, low_pass
from excitant.robots.motion import (
    Array,
    Motion,
    interpolated,
    read_only,
    root_mean_square,
)
from excitant.robots.regressor import regressor, rigid_body_torque
from excitant.robots.robot import Robot

MODEL_ERROR = 0.05  # of a torque's rms: errors of the model that count as noise
TOOL = 10.0  # std of the last link, which carries a tool, in those of `BODY_STD`
ANOTHER_BODY = 1 / BODY_STD  # std of one link that is another body, likewise
_BAND = 8.0  # bandwidth kept, in parts of the motion's rms frequency
_ROWS = 60  # fewer filtered rows tell nothing
_RANK_TOLERANCE = 1e-10  # of the largest eigenvalue
_MOTION = ("q", "dq", "ddq")
_OF_LOG = ("dry", "tau", "recorded", "scale")
_MOVED = {"q": (*_MOTION, "dry"), "tau": ("tau",)}
"""Arrays of a `Smooth` that a remedy of a channel acts on."""


class Smooth(NamedTuple):
    """A log in its motion's own bandwidth, evenly sampled at N instants."""

    motion: Motion
    dry: Array  # signs of the velocities through the same filter, shape (N, nv)
    tau: Array  # likewise, shape (N, nv)
    cutoff: float  # of the filters [1/time unit of the log]
    rate: float  # rows per time unit of the log
    recorded: Rows  # column of the log that each joint's torque is, shape (nv,)
    scale: Array  # of each torque per its reading, without sign, shape (nv,)
    # when dry friction and offset become others, shape (nv,)
    since: Array | None = None

    @property
    def effects(self) -> Array:
        """Columns of each joint's own effects, shape (N, nv, 4), or 6 where they change."""
        ones = np.ones_like(self.dry)
        columns = [self.motion.dq, self.dry, self.motion.ddq, ones]
        if self.since is not None:
            late = self.motion.t[:, None] >= self.since
            columns += [late * self.dry, late * ones]
        return np.stack(columns, axis=2)

    def remedied(self, remedies: Iterable[Remedy]) -> Smooth:
        """The log with remedies of time, positions and torque; speeds are those of positions."""
        arrays = dict[str, Any]()
        arrays |= {name: np.array(getattr(self.motion, name)) for name in _MOTION}
        arrays |= {name: np.array(getattr(self, name)) for name in _OF_LOG}
        for remedy in remedies:
            if remedy.channel == "t":
                arrays["dq"] /= remedy.factor
                arrays["ddq"] /= remedy.factor**2
                arrays["dry"] *= np.sign(remedy.factor)
            joints = [*remedy.joints]
            if (remedy.action, remedy.channel) == ("order", "tau"):
                for name in ("recorded", "scale"):
                    arrays[name] = arrays[name][joints]
            if (remedy.action, remedy.channel) == ("scale", "tau"):
                arrays["scale"][joints] *= abs(remedy.factor)
            for name in _MOVED.get(remedy.channel, ()):
                x = arrays[name]
                arrays[name] = (
                    remedy.advanced(x, self.motion.t)
                    if remedy.action == "advance"
                    else remedy.on_columns(x)
                )
        motion = Motion(self.motion.t, *(arrays.pop(name) for name in _MOTION))
        return self._replace(motion=motion, **arrays)

    def filtered(self, values: Array) -> Array:
        """Values at the instants of the motion, (N, ...), filtered once more, without the ends."""
        edge = round(self.rate / self.cutoff)
        low = min(self.cutoff / 2, 0.45 * self.rate)
        return low_pass(values, low, self.rate, slice(edge, len(values) - edge))


def smooth(log: Log) -> Smooth | None:
    """Filter, differentiate and decimate; None when the log is too short for it."""
    if not 99 <= log.duration / log.step <= 4 * len(log) or np.ptp(log.q) == 0:
        return None
    grid = np.arange(log.t[0], log.t[-1] + 1e-9 * log.step, log.step)
    rate = 1 / log.step
    span = np.std(log.q, axis=0)
    speed = root_mean_square(log.travel) / log.step
    per_span = np.divide(speed, span, out=0 * span, where=span > 50 * log.grain)
    frequency = per_span.max() / (2 * np.pi)
    least = 2 * _BAND / (grid[-1] - grid[0])
    cutoff = min(max(_BAND * frequency, least), 0.2 * rate)

    def even(x: Array) -> Array:
        return interpolated(grid, log.t, x)

    # eight rows per period of the cut-off, and at most some 1200 in all
    rows = slice(None, None, max(1, int(rate / (8 * cutoff)), len(grid) // 1200))
    motion = differentiated(grid, even(log.q), cutoff)
    dry = low_pass(np.sign(motion.dq), cutoff, rate, rows)
    tau = low_pass(even(log.tau), cutoff, rate, rows)
    columns = np.arange(log.nv)
    ones = np.ones(log.nv)
    return Smooth(motion[rows], dry, tau, cutoff, rate / rows.step, columns, ones)


def is_described(robot: Robot) -> bool:
    """Whether the nominal bodies say anything: none of them only holds a place."""
    return not placeholder_links(robot).any()


@lru_cache(maxsize=16)
def nominal_bodies(robot: Robot) -> Array:
    """Root of the covariance of bodies near the nominal ones, and these, (10 nv, 10 nv + 1)."""
    bodies = prior_parameters(robot)
    std = BODY_STD if is_described(robot) else PLACEHOLDER_STD
    spread = link_coordinates(bodies) / link_weights(robot.nv, std)
    return read_only(np.column_stack([spread, bodies.ravel()]))


class Sums(NamedTuple):
    """Sums over the rows of a fit of k joints, for u = 10 nv + k unknowns: bodies, and gains.

    Attributes:
        grams: Products of the columns of what is not known and of its error, without what each
            joint's own effects explain, shape (k, u + 1, u + 1).
        unexplained: Torque that no bodies explain that are the same for all joints, shape (n, k).
        friction: Power of each joint's friction in these columns, and its variance per that of the
            noise, shape (k, u + 2).
        loose: Relative std of the gain of each of the joints; 0 for torques, shape (k,).
    """

    grams: Array
    unexplained: Array
    friction: Array
    loose: Array


@dataclass(frozen=True, eq=False)
class TorqueFit:
    """A log's filtered torque and the columns that may make it.

    Attributes:
        robot: The arm.
        log: Its log.
        data: The same, filtered.
        joints: The k joints whose torque counts.
        unscaled: Those of them whose readings are torque by an unknown factor.
        weighed: The arm under the gravity that errors of the nominal bodies bear, where the torque
            that holds those was taken off.
    """

    robot: Robot
    log: Log
    data: Smooth
    joints: Sequence[int]
    unscaled: frozenset[int] = frozenset()
    weighed: Robot | None = None

    @cached_property
    def tau(self) -> Array:
        """Filtered torque, shape (n, nv)."""
        return self.data.filtered(self.data.tau)

    @cached_property
    def F(self) -> Array:
        """Columns of each joint's own effects, shape (n, nv, 4 or 6)."""
        return self.data.filtered(self.data.effects)

    def _columns(self) -> Array:
        """Filtered columns of the links in `nominal_bodies`, shape (n, nv, 10 nv + 1)."""
        motion = self.data.motion
        bodies = nominal_bodies(self.robot)
        columns = regressor(self.weighed or self.robot, motion) @ bodies
        if self.weighed:
            columns[:, :, -1] = rigid_body_torque(self.robot, motion)
        return self.data.filtered(columns)

    @cached_property
    def size(self) -> Array:
        """Mean square of each torque, shape (nv,)."""
        return np.maximum((self.tau**2).mean(axis=0), 1e-300)

    @cached_property
    def gains(self) -> tuple[Array, Array]:
        """Readings per torque of the nominal bodies, and their relative std, shape (k,) each."""
        return self._gains(self._columns())

    def _gains(self, X: Array) -> tuple[Array, Array]:
        gains = []
        stds = []
        for j in self.joints:
            columns, y = without_effects(self.F[:, j], X[:, j], self.tau[:, j])
            nominal = columns[:, -1]
            along = max(float(nominal @ nominal), len(y) * 1e-24)
            gain = nominal @ y / along
            error = y - gain * nominal
            noise = error @ error / len(y) * autocorrelation_time(error)
            by_noise = np.sqrt(noise / along) / max(abs(gain), 1e-300)
            by_bodies = np.linalg.norm(nominal @ columns[:, :-1]) / along
            gains.append(max(abs(gain), 1e-300))
            stds.append(np.hypot(by_noise, by_bodies))
        return np.array(gains), np.array(stds)

    @cached_property
    def sums(self) -> Sums:
        """What is kept of the columns, which are many times as large."""
        X = self._columns()
        gains = np.ones(len(self.joints))
        loose = np.zeros(len(self.joints))
        unscaled = [
            self.log.unit != "N·m" or j in self.unscaled for j in self.joints
        ]
        if any(unscaled):
            suited, std = self._gains(X)
            gains = np.where(unscaled, suited, gains)
            loose = np.where(unscaled, std, loose)
        friction = []
        free = []
        by_gains = np.eye(len(gains))
        for j, gain, own in zip(self.joints, gains, by_gains, strict=True):
            F = self.F[:, j]
            torque = gain * X[:, j]
            nominal = torque[:, -1]
            error = nominal - self.tau[:, j]
            unknown = [torque[:, :-1], np.outer(nominal, own), error]
            columns = np.column_stack(unknown)
            braking = np.append(F[:, 0] @ F[:, :2], np.zeros(F.shape[1] - 2))
            x = _solve(F.T @ F, braking)
            friction.append(np.append(F @ x @ columns, braking @ x))
            free.append(without_effects(F, columns)[0])
        grams = np.array([columns.T @ columns for columns in free])
        unexplained = self._unexplained(free, grams)
        return Sums(grams, unexplained, np.array(friction), loose)

    def _unexplained(self, free: Sequence[Array], products: Array) -> Array:
        bodies = slice(10 * self.robot.nv)
        grams = products[:, bodies, bodies]
        torques = products[:, bodies, -1]
        alone = np.array([*map(_solve, grams, torques)])
        squares = products[:, -1, -1] - (torques * alone).sum(axis=1)
        least = 1e-10 * self.size[self.joints]
        weight = 1 / np.maximum(squares / len(self.tau), least)
        z = _solve(np.tensordot(weight, grams, 1), weight @ torques)
        return np.stack([own[:, bodies] @ z - own[:, -1] for own in free], axis=1)

    @cached_property
    def power(self) -> Array:
        """Mean square of each torque that no bodies explain, shape (nv,)."""
        power = self.size.copy()
        noise = (self.sums.unexplained**2).mean(axis=0)
        power[self.joints] = np.maximum(noise, 1e-10 * power[self.joints])
        return power

    @cached_property
    def rows(self) -> Array:
        """Independent rows of each joint's error, shape (nv,)."""
        rows = np.ones(self.robot.nv)
        for j, error in zip(self.joints, self.sums.unexplained.T, strict=True):
            if error.any():
                rows[j] = len(error) / autocorrelation_time(error)
        return rows

    def weight(self, noise: Array | float, rows: Array) -> Array:
        """Weight of each joint's squares, for noise and independent rows, (nv,) each; (k,)."""
        noise = noise + MODEL_ERROR**2 * self.size
        return (rows / len(self.tau) / noise)[self.joints]

    def surprise(
        self, noise: Array, rows: Array, other: int
    ) -> tuple[float, float]:
        """Squares that bodies near the nominal ones leave, and −2 log of the evidence for them.

        Gains of drives are off by what is not known of them; each joint's own effects are free, but
        that friction brakes.

        Args:
            noise: Mean square of the noise of each joint's reading, shape (nv,); `MODEL_ERROR`
                comes to it.
            rows: Independent rows that it has, shape (nv,).
            other: Link that may be another body.
        """
        per_reading = self.data.scale**2
        weight = self.weight(noise * per_reading, rows)
        L = self._factor(weight, other)
        root = L[:-1, :-1]
        occam = 2 * np.log(np.diag(root)).sum()
        # power of the friction, of which errors of bodies and of gains take a part
        friction = self.sums.friction
        reach = friction[:, :-2] * self._std(other)
        solved = scipy.linalg.solve_triangular(root, reach.T, lower=True)
        power = L[-1, :-1] @ solved - friction[:, -2]
        variance = friction[:, -1] / weight + (solved**2).sum(axis=0)
        # dry friction of a joint that stands could be anything
        moving = self.log.moving[:, self.joints].any(axis=0)
        driving = (
            moving * np.minimum(power, 0.0) ** 2 / np.maximum(variance, 1e-300)
        )
        total = L[-1, -1] ** 2 + driving.sum() + self._shrunk(weight, other)
        # sums of readings are not likelier for being larger, nor for another unit
        density = np.log(weight * per_reading[self.joints])
        surprise = total + occam - rows[self.joints] @ density
        return float(total), float(surprise)

    def _shrunk(self, weight: Array, other: int) -> float:
        """Squares of bodies that are too small, beyond those of a normal prior; of one joint.

        Sizes are log-normal: a tenth of the nominal torque is no likelier than ten times as much,
        though it is closer.
        """
        own = np.arange(len(weight))
        gains = 10 * self.robot.nv + own
        products = self.sums.grams[own, gains]
        along = np.maximum(products[own, gains], 1e-300)
        gain = np.clip(1 - products[:, -1] / along, 1e-6, 1.0)
        spread = products[:, :-1] * self._std(other) / along[:, None]
        by_bodies = (spread**2).sum(axis=1)
        by_noise = 1 / (weight * along)
        normal = (1 - gain) ** 2 / (by_bodies + by_noise)
        log_normal = np.log(gain) ** 2 / (by_bodies + by_noise / gain**2)
        return float((log_normal - normal).max(initial=0.0))

    @cached_property
    def left(self) -> Array:
        """Share of each torque that bodies near the nominal ones, one another, leave, rms, (k,)."""
        weight = self.weight(0.0, self.rows)
        factors = [self._factor(weight, link) for link in range(self.robot.nv)]
        other = int(np.argmin([L[-1, -1] for L in factors]))
        L = factors[other]
        z = scipy.linalg.solve_triangular(
            L[:-1, :-1], L[-1, :-1], lower=True, trans=1
        )
        x = np.append(-z * self._std(other), 1.0)
        squares = np.einsum("i,jik,k->j", x, self.sums.grams, x)
        return np.sqrt(squares / len(self.tau) / self.size[self.joints])

    def squares(self, weight: Array) -> float:
        """Squares that bodies near the nominal ones leave, friction of any sign."""
        return float(self._factor(weight, self.robot.nv - 1)[-1, -1] ** 2)

    def _std(self, other: int) -> Array:
        """Std of what is not known: bodies in `BODY_STD`, and gains, shape (u,)."""
        std = np.ones((self.robot.nv, 10))
        std[other] = TOOL if other == self.robot.nv - 1 else ANOTHER_BODY
        return np.append(std, self.sums.loose)

    def _factor(self, weight: Array, other: int) -> Array:
        """Cholesky factor, (u + 1, u + 1), of the information, bordered by the torque.

        The square of the last pivot is that of the residual and of what is not known together.
        """
        std = np.append(self._std(other), 1.0)
        A = np.tensordot(weight, self.sums.grams, 1) * np.outer(std, std)
        # rounding, where the prior hardly bounds a body
        A += np.diag(1e-12 * np.diag(A))
        A += np.diag(np.append(np.ones(len(A) - 1), 0.0))
        return np.asarray(np.linalg.cholesky(A), float)


def torque_fit(
    robot: Robot, log: Log, data: Smooth | None, dead: set[str]
) -> TorqueFit | None:
    """The fit of a log's torque; None when no joint's torque can be used."""
    if data is None:
        return None
    moved = np.ptp(data.tau, axis=0) > 0
    alive = [j for j in range(robot.nv) if log.joints[j] not in dead and moved[j]]
    fit = TorqueFit(robot, log, data, alive) if alive else None
    return fit if fit and len(fit.tau) >= _ROWS else None


def _solve(A: Array, b: Array) -> Array:
    """Solution of least norm of A x = b, (u,), A positive semidefinite, in scaled unknowns.

    Unknowns without a column, as of links that a joint does not carry, are 0.
    """
    d = np.sqrt(np.maximum(np.diag(A), 0.0))  # rounding leaves some below zero
    live = np.flatnonzero(d)
    d = d[live]
    values, V = np.linalg.eigh(A[np.ix_(live, live)] / np.outer(d, d))
    determined = values > _RANK_TOLERANCE * values.max(initial=1e-300)
    V = V[:, determined] / d[:, None]
    x = np.zeros(len(b))
    x[live] = V @ (V.T @ b[live] / values[determined])
    return x
