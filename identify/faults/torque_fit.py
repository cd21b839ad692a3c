"""A log's torque against bodies near the nominal ones, each joint's own effects free.

    y_j = g_j Y_j(q, q̇, q̈) (φ̄ + S z) + F_j θ_j + noise,   z ~ N(0, 1)

φ̄ are the nominal bodies, off by `BODY_STD`, and one of them, or a tool, by more. F_j: viscous and
dry friction, rotor inertia and offset. g_j is 1 where torque was recorded, else the gain that suits
the nominal bodies best, to what their errors leave open. Filters are set in parts of the motion's
own bandwidth, so that they mean the same whatever the unit of time.

Torque is linear in gravity and in the square of the rate, and a trigonometric polynomial of degree
2 in the zero position of a joint: the columns of any such installation are mixtures of a few parts,
and small matrices judge all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import scipy

from excitant.identify.drive_gains import BODY_STD, PLACEHOLDER_STD, without_effects
from excitant.identify.faults.fault import Log, Remedy, Rows
from excitant.identify.least_squares import autocorrelation_time
from excitant.identify.prior import link_coordinates, link_weights, prior_parameters
from excitant.identify.signals import differentiated, low_pass
from excitant.robots.motion import Array, Motion, read_only
from excitant.robots.regressor import regressor
from excitant.robots.robot import Robot

MODEL_ERROR = 0.05  # of a torque's rms: errors of the model that count as noise
TOOL = 10.0  # std of the last link, which carries a tool, in those of `BODY_STD`
ANOTHER_BODY = 1 / BODY_STD  # std of one link that is another body, likewise
_BAND = 8.0  # bandwidth kept, in parts of the motion's rms frequency
_ROWS = 60  # fewer filtered rows tell nothing
_RANK_TOLERANCE = 1e-10  # of the largest eigenvalue
_MOTION = ("q", "dq", "ddq")
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

    @property
    def effects(self) -> Array:
        """Columns of each joint's own effects, shape (N, nv, 4)."""
        ones = np.ones_like(self.dry)
        columns = [self.motion.dq, self.dry, self.motion.ddq, ones]
        return np.stack(columns, axis=2)

    def remedied(self, remedies: Iterable[Remedy]) -> Smooth:
        """The log with remedies of time, positions and torque; speeds are those of positions."""
        arrays = {name: np.array(getattr(self.motion, name)) for name in _MOTION}
        arrays |= {"dry": np.array(self.dry), "tau": np.array(self.tau)}
        recorded = self.recorded
        for remedy in remedies:
            if remedy.channel == "t":
                arrays["dq"] /= remedy.factor
                arrays["ddq"] /= remedy.factor**2
            if (remedy.action, remedy.channel) == ("order", "tau"):
                recorded = recorded[[*remedy.joints]]
            for name in _MOVED.get(remedy.channel, ()):
                x = arrays[name]
                arrays[name] = (
                    remedy.advanced(x, self.motion.t)
                    if remedy.action == "advance"
                    else remedy.on_columns(x)
                )
        motion = Motion(self.motion.t, *(arrays[name] for name in _MOTION))
        return self._replace(
            motion=motion, dry=arrays["dry"], tau=arrays["tau"], recorded=recorded
        )

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
    frequency = 0.0
    moved = span > 50 * log.grain
    if moved.any():
        speed = np.sqrt((log.travel[:, moved] ** 2).mean(axis=0)) / log.step
        frequency = float((speed / span[moved]).max() / (2 * np.pi))
    least = 2 * _BAND / (grid[-1] - grid[0])
    cutoff = min(max(_BAND * frequency, least), 0.2 * rate)

    def even(x: Array) -> Array:
        return np.column_stack([np.interp(grid, log.t, column) for column in x.T])

    # eight rows per period of the cut-off, and at most some 1200 in all
    rows = slice(None, None, max(1, int(rate / (8 * cutoff)), len(grid) // 1200))
    motion = differentiated(grid, even(log.q), cutoff)
    dry = low_pass(np.sign(motion.dq), cutoff, rate, rows)
    tau = low_pass(even(log.tau), cutoff, rate, rows)
    columns = np.arange(log.nv)
    return Smooth(motion[rows], dry, tau, cutoff, rate / rows.step, columns)


def is_described(robot: Robot) -> bool:
    """Whether the nominal bodies say anything: each has a mass, and not all the same."""
    mass = robot.phi[::10]
    return bool((mass > 0).all() and np.ptp(mass) > 1e-6 * mass.max())


@lru_cache(maxsize=16)
def nominal_bodies(robot: Robot) -> Array:
    """Root of the covariance of bodies near the nominal ones, and these, (10 nv, 10 nv + 1)."""
    bodies = prior_parameters(robot)
    std = BODY_STD if is_described(robot) else PLACEHOLDER_STD
    spread = link_coordinates(bodies) / link_weights(robot.nv, std)
    return read_only(np.column_stack([spread, bodies.ravel()]))


@dataclass(frozen=True, eq=False)
class TorqueFit:
    """A log's filtered torque and the columns that may make it.

    Attributes:
        robot: The arm.
        log: Its log.
        data: The same, filtered.
        joints: The k joints whose torque counts.
        unscaled: Those of them whose readings are torque by an unknown factor.
    """

    robot: Robot
    log: Log
    data: Smooth
    joints: Sequence[int]
    unscaled: frozenset[int] = frozenset()

    @cached_property
    def tau(self) -> Array:
        """Filtered torque, shape (n, nv)."""
        return self.data.filtered(self.data.tau)

    @cached_property
    def F(self) -> Array:
        """Columns of each joint's own effects, shape (n, nv, 4)."""
        return self.data.filtered(self.data.effects)

    @cached_property
    def X(self) -> Array:
        """Filtered columns of the links, shape (n, nv, 10 nv)."""
        return self.data.filtered(regressor(self.robot, self.data.motion))

    @cached_property
    def size(self) -> Array:
        """Mean square of each torque, shape (nv,)."""
        return np.maximum((self.tau**2).mean(axis=0), 1e-300)

    @cached_property
    def columns(self) -> list[tuple[Array, Array]]:
        """Columns (1, n, p) of each joint in `nominal_bodies`, and its torque, without effects."""
        return self._without_effects([self.X])

    def _without_effects(self, parts: Sequence[Array]) -> list[tuple[Array, Array]]:
        """The same for m parts of filtered columns of the links, shape (m, n, p)."""
        basis = nominal_bodies(self.robot)
        joints = []
        for j in self.joints:
            # no joint's torque depends on the links before it
            acting = basis[10 * j :]
            own = [X[:, j, 10 * j :] @ acting for X in parts]
            *rest, y = without_effects(self.F[:, j], *own, self.tau[:, j])
            joints.append((np.array(rest), y))
        return joints

    @cached_property
    def gains(self) -> tuple[Array, Array]:
        """Readings per torque of the nominal bodies, and their relative std, shape (k,) each."""
        gains = []
        stds = []
        for (columns,), y in self.columns:
            nominal = columns[:, -1]
            along = max(float(nominal @ nominal), len(y) * 1e-24)
            gain = float(nominal @ y) / along
            error = y - gain * nominal
            noise = float(error @ error) / len(y) * autocorrelation_time(error)
            by_noise = np.sqrt(noise / along) / max(abs(gain), 1e-300)
            by_bodies = np.linalg.norm(nominal @ columns[:, :-1]) / along
            gains.append(max(abs(gain), 1e-300))
            stds.append(np.hypot(by_noise, by_bodies))
        return np.array(gains), np.array(stds)

    @cached_property
    def loose(self) -> Array:
        """Relative std of the gain of each of the joints; 0 for torques, shape (k,)."""
        unknown = [
            self.log.unit != "N·m" or j in self.unscaled for j in self.joints
        ]
        return np.where(unknown, self.gains[1], 0.0)

    @cached_property
    def unexplained(self) -> Array:
        """Torque that no bodies explain that are the same for all joints, shape (n, k)."""
        per = np.where(self.loose > 0, self.gains[0], 1.0)
        columns = [
            g * C[:, :-1] for g, ((C,), _) in zip(per, self.columns, strict=True)
        ]
        torque = [y for _, y in self.columns]
        grams = np.array([C.T @ C for C in columns])
        products = np.array([C.T @ y for C, y in zip(columns, torque, strict=True)])
        least = 1e-10 * self.size[self.joints]

        def error(bodies: Sequence[Array]) -> Array:
            known = zip(columns, torque, bodies, strict=True)
            return np.stack([y - C @ z for C, y, z in known], axis=1)

        alone = error(list(map(_solve, grams, products)))
        weight = 1 / np.maximum((alone**2).mean(axis=0), least)
        z = _solve(np.tensordot(weight, grams, 1), weight @ products)
        return error([z] * len(torque))

    @cached_property
    def power(self) -> Array:
        """Mean square of each torque that no bodies explain, shape (nv,)."""
        power = self.size.copy()
        noise = (self.unexplained**2).mean(axis=0)
        power[self.joints] = np.maximum(noise, 1e-10 * power[self.joints])
        return power

    @cached_property
    def rows(self) -> Array:
        """Independent rows of each joint's error, shape (nv,)."""
        rows = np.ones(self.robot.nv)
        for j, error in zip(self.joints, self.unexplained.T, strict=True):
            if error.any():
                rows[j] = len(error) / autocorrelation_time(error)
        return rows

    def weight(self, noise: Array | float, rows: Array) -> Array:
        """Weight of each joint's squares, for noise and independent rows, (nv,) each; (k,)."""
        noise = noise + MODEL_ERROR**2 * self.size
        return np.asarray((rows / len(self.tau) / noise)[self.joints], float)

    @cached_property
    def _moments(self) -> _Moments:
        return _moments(self.columns)

    @cached_property
    def _friction(self) -> tuple[Array, Array, Array]:
        """Power of each joint's friction without bodies, (k,), its variance per that of the noise.

        Also what of it the columns of the bodies explain, (k, p).
        """
        basis = nominal_bodies(self.robot)
        power = []
        variance = []
        reach = []
        for j in self.joints:
            F = self.F[:, j]
            braking = np.append(F[:, 0] @ F[:, :2], np.zeros(2))
            x = _solve(F.T @ F, braking)
            power.append(F @ x @ self.tau[:, j])
            variance.append(braking @ x)
            reach.append(F @ x @ self.X[:, j] @ basis)
        return np.array(power), np.array(variance), np.array(reach)

    def surprise(
        self, noise: Array, rows: Array, other: int
    ) -> tuple[float, float]:
        """Squares that bodies near the nominal ones leave, and −2 log of the evidence for them.

        Gains of drives are off by what is not known of them; each joint's own effects are free, but
        that friction brakes.

        Args:
            noise: Mean square of each joint's noise, shape (nv,); `MODEL_ERROR` comes to it.
            rows: Independent rows that it has, shape (nv,).
            other: Link that may be another body.
        """
        weight = self.weight(noise, rows)
        L = self._factors(self._moments, weight, other)(np.ones(1))
        root = L[:-1, :-1]
        occam = 2 * float(np.log(np.diag(root)).sum())
        # power of the friction, of which errors of bodies and of gains take a part
        power, variance, reach = self._friction
        gain = np.where(self.loose > 0, self.gains[0], 1.0)
        reach = gain[:, None] * reach
        by_unknown = np.hstack([reach[:, :-1], np.diag(reach[:, -1])])
        by_unknown *= self._std(other)
        solved = scipy.linalg.solve_triangular(root, by_unknown.T, lower=True)
        power = power - reach[:, -1] + L[-1, :-1] @ solved
        variance = variance / weight + (solved**2).sum(axis=0)
        # dry friction of a joint that stands could be anything
        moving = self.log.moving[:, self.joints].any(axis=0)
        driving = np.where(moving, np.minimum(power, 0.0), 0.0) ** 2
        total = float(
            L[-1, -1] ** 2 + (driving / np.maximum(variance, 1e-300)).sum()
        )
        # sums of readings are not likelier for being larger
        return total, total + occam - float(rows[self.joints] @ np.log(weight))

    def squares(self, weight: Array) -> float:
        """Squares that bodies near the nominal ones leave, friction of any sign."""
        factor = self._factors(self._moments, weight, self.robot.nv - 1)(np.ones(1))
        return float(factor[-1, -1] ** 2)

    def family(self, parts: Sequence[Array], weight: Array) -> Callable[..., Array]:
        """Squares that bodies near the nominal ones leave, as a function of a mixture of parts.

        ``squares(mixtures, flipped)``: of mixtures (..., m) of the parts, the torque of one of the
        joints negated where that is given, shape (...).

        Args:
            parts: Columns of the links, shape (N, nv, 10 nv) each.
            weight: Weight of each joint's squares; see `weight`.
        """
        columns = self._without_effects([self.data.filtered(X) for X in parts])
        factors = self._factors(_moments(columns), weight, self.robot.nv - 1)
        return lambda *mixture: factors(*mixture)[..., -1, -1] ** 2

    def _std(self, other: int) -> Array:
        """Std of what is not known, u = p − 1 + k: bodies in `BODY_STD`, and gains."""
        std = np.ones((self.robot.nv, 10))
        std[other] = TOOL if other == self.robot.nv - 1 else ANOTHER_BODY
        return np.append(std, self.loose)

    def _factors(
        self, moments: _Moments, weight: Array, other: int
    ) -> Callable[..., Array]:
        """Cholesky factors, (..., u + 1, u + 1), of the information, bordered by the torque.

        The square of the last pivot is that of the residual and of what is not known together.
        """
        grams = moments.grams * weight[:, None, None, None, None]
        products = moments.products * weight[:, None, None]
        squares = moments.squares * weight
        whole = grams.sum(axis=0)
        std = np.append(self._std(other), 1.0)
        unknown = np.arange(len(std) - 1)
        bodies = unknown[: whole.shape[-1] - 1]
        gains = unknown[len(bodies) :]

        def factors(mixtures: Array, flipped: int | None = None) -> Array:
            pairs = mixtures[..., :, None] * mixtures[..., None, :]
            h = np.tensordot(mixtures, products, ((-1,), (1,)))
            v = np.tensordot(pairs, grams[..., -1], ((-2, -1), (1, 2)))
            if flipped is not None:
                h[..., flipped, :] *= -1
            if self.loose.any():
                # those that suit the nominal bodies of the mixture
                best = np.abs(h[..., -1]) / np.maximum(v[..., -1], 1e-300)
                gain = np.where(self.loose > 0, best, 1.0)[..., None]
                h = gain * h
                v = gain**2 * v
                scaled = gain[..., None] ** 2 * pairs[..., None, :, :]
                G = np.tensordot(scaled, grams, 3)
            else:
                G = np.tensordot(pairs, whole, 2)
            along = v[..., -1]
            A = np.zeros((*pairs.shape[:-2], len(std), len(std)))
            A[..., : len(bodies), : len(bodies)] = G[..., :-1, :-1]
            A[..., gains, : len(bodies)] = v[..., :-1]
            A[..., gains, gains] = along
            A[..., -1, : len(bodies)] = (v - h)[..., :-1].sum(axis=-2)
            A[..., -1, gains] = along - h[..., -1]
            A[..., -1, -1] = (squares - 2 * h[..., -1] + along).sum(axis=-1)
            A *= np.outer(std, std)
            A[..., unknown, unknown] += 1.0
            # rounding, where the prior hardly bounds a body
            A += 1e-12 * A * np.eye(len(std))
            # the lower triangle of A is all that this reads
            return np.asarray(np.linalg.cholesky(A), float)

        return factors


class _Moments(NamedTuple):
    """Products of m parts of columns without effects.

    Attributes:
        grams: Of the parts with each other, shape (k, m, m, p, p).
        products: With the torque, shape (k, m, p).
        squares: Of the torque, shape (k,).
    """

    grams: Array
    products: Array
    squares: Array


def _moments(columns: Sequence[tuple[Array, Array]]) -> _Moments:
    grams = [np.tensordot(X, X, ((1,), (1,))).swapaxes(1, 2) for X, _ in columns]
    products = [y @ X for X, y in columns]
    squares = [y @ y for _, y in columns]
    return _Moments(np.array(grams), np.array(products), np.array(squares))


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
    """Solution of least norm of A x = b, A positive semidefinite, in scaled unknowns."""
    d = np.sqrt(np.maximum(np.diag(A), 0.0))  # rounding leaves some below zero
    d = np.where(d > 0, d, 1.0)
    values, V = np.linalg.eigh(A / np.outer(d, d))
    determined = values > _RANK_TOLERANCE * max(float(values[-1]), 1e-300)
    V = V[:, determined] / d[:, None]
    return np.asarray(V @ ((V.T @ b).T / values[determined]).T, float)
