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
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import scipy

from excitant.identify.drive_gains import BODY_STD, PLACEHOLDER_STD, without_effects
from excitant.identify.faults.fault import Log, Remedy
from excitant.identify.least_squares import autocorrelation_time
from excitant.identify.prior import link_coordinates, link_weights, prior_parameters
from excitant.identify.signals import low_pass
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
        for remedy in remedies:
            if remedy.channel == "t":
                arrays["dq"] /= remedy.factor
                arrays["ddq"] /= remedy.factor**2
            for name in _MOVED.get(remedy.channel, ()):
                x = arrays[name]
                arrays[name] = (
                    remedy.advanced(x, self.motion.t)
                    if remedy.action == "advance"
                    else remedy.on_columns(x)
                )
        motion = Motion(self.motion.t, *(arrays[name] for name in _MOTION))
        return self._replace(motion=motion, dry=arrays["dry"], tau=arrays["tau"])

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

    def filtered(x: Array) -> Array:
        even = np.column_stack([np.interp(grid, log.t, column) for column in x.T])
        return low_pass(even, cutoff, rate)

    spline = scipy.interpolate.make_interp_spline(grid, filtered(log.q), k=5)
    # eight rows per period of the cut-off, and at most some 1200 in all
    stride = max(1, int(rate / (8 * cutoff)), len(grid) // 1200)
    at = grid[::stride]
    speed = spline.derivative(1)
    motion = Motion(at, spline(at), speed(at), spline.derivative(2)(at))
    dry = low_pass(np.sign(speed(grid)), cutoff, rate)[::stride]
    tau = filtered(log.tau)[::stride]
    return Smooth(motion, dry, tau, cutoff, rate / stride)


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


class _Friction(NamedTuple):
    """Power of the friction of each of k joints.

    Attributes:
        power: Least-squares estimate without bodies, shape (k,).
        variance: Its variance per that of the noise, shape (k,).
        reach: Its derivative by what bodies explain, shape (k, p).
    """

    power: Array
    variance: Array
    reach: Array


@dataclass(frozen=True, eq=False)
class TorqueFit:
    """Normal equations of a log's filtered torque, for mixtures of m parts of columns.

    Attributes:
        robot: The arm.
        log: Its log.
        data: The same, filtered.
        joints: The k joints whose torque counts.
        unscaled: Those of them whose readings are torque by an unknown factor.
        parts: Columns of the links, (N, nv, 10 nv) each; as the log stands, all in one.
        given_doubt: Relative std of the joints' gains, if not that of their own columns, (k,).
    """

    robot: Robot
    log: Log
    data: Smooth
    joints: Sequence[int]
    unscaled: frozenset[int] = frozenset()
    parts: tuple[Array, ...] = ()
    given_doubt: Array | None = None

    @cached_property
    def tau(self) -> Array:
        """Filtered torque, shape (n, nv)."""
        return self.data.filtered(self.data.tau)

    @cached_property
    def F(self) -> Array:
        """Columns of each joint's own effects, shape (n, nv, 4)."""
        return self.data.filtered(self.data.effects)

    @cached_property
    def X(self) -> tuple[Array, ...]:
        """Filtered columns of the links, shape (n, nv, 10 nv), by part."""
        parts = self.parts or (regressor(self.robot, self.data.motion),)
        return tuple(self.data.filtered(part) for part in parts)

    @cached_property
    def size(self) -> Array:
        """Mean square of each torque, shape (nv,)."""
        return np.maximum((self.tau**2).mean(axis=0), 1e-300)

    @cached_property
    def columns(self) -> list[tuple[Array, Array]]:
        """Columns (m, n, p) of each joint in `nominal_bodies`, and its torque, without effects."""
        basis = nominal_bodies(self.robot)
        joints = []
        for j in self.joints:
            # no joint's torque depends on the links before it
            acting = basis[10 * j :]
            parts = [X[:, j, 10 * j :] @ acting for X in self.X]
            *rest, y = without_effects(self.F[:, j], *parts, self.tau[:, j])
            joints.append((np.array(rest), y))
        return joints

    @cached_property
    def moments(self) -> tuple[Array, Array, Array]:
        """Products of columns, (m, m, k, p, p), with the torque, (m, k, p), and its own, (k,)."""
        grams = []
        products = []
        squares = []
        for columns, y in self.columns:
            flat = np.concatenate([*columns], axis=1)
            gram = (flat.T @ flat).reshape(
                len(columns), flat.shape[1] // len(columns), -1
            )
            gram = gram.reshape(*gram.shape[:2], len(columns), -1)
            grams.append(gram.swapaxes(1, 2))
            products.append(y @ columns)
            squares.append(y @ y)
        return (
            np.stack(grams, axis=2),
            np.stack(products, axis=1),
            np.array(squares),
        )

    @cached_property
    def gains(self) -> tuple[Array, Array]:
        """Readings per torque of the nominal bodies, and their relative std, shape (k,) each."""
        grams, products, _ = self.moments
        along = np.maximum(grams[0, 0, :, -1, -1], len(self.tau) * 1e-24)
        gain = products[0, :, -1] / along
        by_bodies = np.linalg.norm(grams[0, 0, :, -1, :-1], axis=1) / along
        std = np.zeros(len(self.joints))
        for k, (columns, y) in enumerate(self.columns):
            error = y - gain[k] * columns[0][:, -1]
            noise = float(error @ error) / len(y) * autocorrelation_time(error)
            by_noise = np.sqrt(noise / along[k]) / max(abs(gain[k]), 1e-300)
            std[k] = np.hypot(by_noise, by_bodies[k])
        return np.maximum(np.abs(gain), 1e-300), std

    @cached_property
    def _loose(self) -> Array:
        """Relative std of the gain of each of the joints; 0 for torques, shape (k,)."""
        if self.given_doubt is not None:
            return self.given_doubt
        unknown = [
            self.log.unit != "N·m" or j in self.unscaled for j in self.joints
        ]
        return (
            np.where(unknown, self.gains[1], 0.0)
            if any(unknown)
            else np.zeros(len(unknown))
        )

    @property
    def _per(self) -> Array:
        """Readings per torque, shape (k,)."""
        loose = self._loose > 0
        return (
            np.where(loose, self.gains[0], 1.0)
            if loose.any()
            else np.ones(len(loose))
        )

    @cached_property
    def _scaled(self) -> tuple[Array, Array, Array]:
        """Products as `moments` of the first part, in readings: (k, p, p), (k, p), (k,)."""
        grams, products, squares = self.moments
        per = self._per
        return (
            per[:, None, None] ** 2 * grams[0, 0],
            per[:, None] * products[0],
            squares,
        )

    @cached_property
    def _free(self) -> tuple[Array, Array]:
        """Bodies z that suit all joints best, shape (p − 1,), and mean squares left, (k,)."""
        A, b, squares = self._scaled
        A = A[:, :-1, :-1]
        b = b[:, :-1]

        def left(x: Array) -> Array:
            explained = ((2 * b - np.einsum("kpq,kq->kp", A, x)) * x).sum(axis=1)
            least = 1e-10 * self.size[self.joints]
            return np.maximum((squares - explained) / len(self.tau), least)

        alone = left(np.array(list(map(_solve, A, b))))
        z = _solve(np.tensordot(1 / alone, A, 1), (1 / alone) @ b)
        return z, left(np.broadcast_to(z, b.shape))

    @cached_property
    def power(self) -> Array:
        """Mean square of each torque that no bodies explain, shape (nv,)."""
        power = self.size.copy()
        power[self.joints] = self._free[1]
        return power

    @cached_property
    def rows(self) -> Array:
        """Independent rows of each joint's error, shape (nv,)."""
        rows = np.ones(self.robot.nv)
        z = self._free[0]
        for j, gain, (columns, y) in zip(
            self.joints, self._per, self.columns, strict=True
        ):
            error = y - gain * columns[0][:, :-1] @ z
            if error.any():
                rows[j] = len(error) / autocorrelation_time(error)
        return rows

    @cached_property
    def _friction(self) -> _Friction:
        basis = nominal_bodies(self.robot)
        power = []
        variance = []
        reach = []
        for j in self.joints:
            F = self.F[:, j]
            weight = np.append(F[:, 0] @ F[:, :2], np.zeros(2))
            x = _solve(F.T @ F, weight)
            power.append(F @ x @ self.tau[:, j])
            variance.append(weight @ x)
            reach.append(F @ x @ self.X[0][:, j] @ basis)
        reached = self._per[:, None] * np.array(reach)
        return _Friction(np.array(power), np.array(variance), reached)

    def weight(self, noise: Array, rows: Array) -> Array:
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
            noise: Mean square of each joint's noise, shape (nv,); `MODEL_ERROR` comes to it.
            rows: Independent rows that it has, shape (nv,).
            other: Link that may be another body.
        """
        weight = self.weight(noise, rows)
        A, b, squares = self._scaled
        # a gain that is off by N(0, loose²) is projected out of each joint's columns
        v = A[:, :, -1]
        t = b[:, -1]
        information = weight * v[:, -1] * self._loose**2
        share = weight * self._loose**2 / (1 + information)
        G = np.tensordot(weight, A, 1) - (weight * share * v.T) @ v
        h = weight @ b - (weight * share * t) @ v
        y = float(weight @ (squares - share * t**2))
        std = link_std(self.robot, other)
        H = std[:, None] * G[:-1, :-1] * std + np.eye(len(std))
        g = std * (h - G[-1])[:-1]
        factor = scipy.linalg.cho_factor(H)
        z = scipy.linalg.cho_solve(factor, g)
        left = max(y - 2 * h[-1] + G[-1, -1] - float(g @ z), 1e-10 * y)
        # power of the friction, whose own errors, those of the gain and of bodies add up
        power, variance, reach = self._friction
        along = reach[:, -1]
        reach = reach - (along * share)[:, None] * v
        power = power - along * share * t - reach @ np.append(std * z, 1.0)
        variance = (variance + along**2 * share) / weight
        by_bodies = reach[:, :-1] * std
        solved = scipy.linalg.cho_solve(factor, by_bodies.T)
        variance = variance + np.einsum("kp,pk->k", by_bodies, solved)
        # dry friction of a joint that stands could be anything
        moving = np.asarray(self.log.moving[:, self.joints].any(axis=0))
        power = np.where(moving, power, 0.0)
        driving = np.minimum(power, 0.0) ** 2 / np.maximum(variance, 1e-300)
        total = left + float(driving.sum())
        occam = 2 * float(np.log(np.diag(factor[0])).sum())
        occam += float(np.log1p(information).sum())
        # sums of readings are not likelier for being larger
        return total, total + occam - float(rows[self.joints] @ np.log(weight))

    def mixed(self, parts: Sequence[Array]) -> TorqueFit:
        """The fit of mixtures of parts."""
        return replace(self, parts=tuple(parts), given_doubt=self._loose)

    def family(self, weight: Array) -> Callable[..., Array]:
        """Squares that bodies near the nominal ones leave, as a function of the mixture.

        ``squares(mixtures, flipped)``: of mixtures (..., m) of the parts, the torque of one of the
        joints negated where that is given, shape (...).

        Args:
            weight: Weight of each joint's squares; see `weight`.
        """
        grams, products, squares = self.moments
        grams = grams * weight[:, None, None]
        products = products * weight[:, None]
        squares = squares * weight
        whole = grams.sum(axis=2)
        moments = grams if self._loose.any() else whole

        def left(mixtures: Array, flipped: int | None = None) -> Array:
            pairs = mixtures[..., :, None] * mixtures[..., None, :]
            h = np.tensordot(mixtures, products, 1)
            if flipped is not None:
                h[..., flipped, :] *= -1
            return self._left(np.tensordot(pairs, moments, 2), h, squares)

        return left

    def _left(self, A: Array, h: Array, y: Array) -> Array:
        """Squares left (...), for products of columns, of one joint or all, and with torque."""
        if self._loose.any():
            # as in `surprise`, with the gain that suits the nominal bodies of each mixture
            G = A
            along = np.maximum(G[..., -1, -1], 1e-300)
            gain = np.where(
                self._loose > 0, np.maximum(h[..., -1], 0.0) / along, 1.0
            )
            G = gain[..., None, None] ** 2 * G
            h = gain[..., None] * h
            share = self._loose**2 / (gain**2 * along * self._loose**2 + 1)
            v = G[..., -1]
            t = h[..., -1]
            G = G - share[..., None, None] * v[..., :, None] * v[..., None, :]
            h = h - (share * t)[..., None] * v
            y = y - share * t**2
            A = G.sum(axis=-3)
        b = h.sum(axis=-2)
        std = np.append(link_std(self.robot, self.robot.nv - 1), 1.0)
        A = std[:, None] * A * std
        b = std * b
        # H z = g minimises: the squares are the last pivot of H bordered by g
        A[..., :-1, :-1] += np.eye(b.shape[-1] - 1)
        A[..., -1, -1] += y.sum(axis=-1) - 2 * b[..., -1]
        A[..., -1, :-1] -= b[..., :-1]
        # rounding, where the prior hardly bounds a body
        A += 1e-12 * A * np.eye(b.shape[-1])
        return np.asarray(np.linalg.cholesky(A)[..., -1, -1] ** 2, float)


def torque_fit(
    robot: Robot, log: Log, data: Smooth, dead: set[str]
) -> TorqueFit | None:
    """The fit of a log's torque; None when no joint's torque can be used."""
    moved = np.ptp(data.tau, axis=0) > 0
    alive = [j for j in range(robot.nv) if log.joints[j] not in dead and moved[j]]
    fit = TorqueFit(robot, log, data, alive) if alive else None
    return fit if fit and len(fit.tau) >= _ROWS else None


def link_std(robot: Robot, other: int) -> Array:
    """Std of each coordinate of the bodies in those of `BODY_STD`; one link is another body."""
    std = np.ones((robot.nv, 10))
    std[other] = TOOL if other == robot.nv - 1 else ANOTHER_BODY
    return std.ravel()


def _solve(A: Array, b: Array) -> Array:
    """Solution of least norm of A x = b, A positive semidefinite, in scaled unknowns."""
    d = np.sqrt(np.maximum(np.diag(A), 0.0))  # rounding leaves some below zero
    d = np.where(d > 0, d, 1.0)
    values, V = np.linalg.eigh(A / np.outer(d, d))
    determined = values > _RANK_TOLERANCE * max(float(values[-1]), 1e-300)
    V = V[:, determined] / d[:, None]
    return np.asarray(V @ ((V.T @ b).T / values[determined]).T, float)
