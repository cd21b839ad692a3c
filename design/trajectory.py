"""Excitation trajectories as Fourier series, with exact derivatives and extrema."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy

from excitant.exceptions import BadInput
from excitant.robots.motion import Array, Motion, freeze
from excitant.robots.shown import Shown, Table

_REST = 1e-9  # of the largest coefficient at the highest frequency


@dataclass(frozen=True, eq=False)
class FourierSeries:
    """1, cos hωt, sin hωt for h = 1 … H, ω = 2π / period (Swevers et al. 1997).

    Attributes:
        period: Duration of one period [s].
        harmonics: Number of harmonics H.
        periods: Number of periods that a motion has.
    """

    period: float
    harmonics: int
    periods: int = 1

    def __post_init__(self) -> None:
        if not self.period > 0:
            raise ValueError(f"period {self.period} is not positive")
        if self.periods < 1:
            raise ValueError(f"{self.periods} periods: at least one is needed")

    @property
    def size(self) -> int:
        """Number c of functions, 1 + 2 H."""
        return 1 + 2 * self.harmonics

    @property
    def duration(self) -> float:
        """Length of the motion, all its periods [s]."""
        return self.period * self.periods

    @cached_property
    def rest(self) -> Array:
        """Orthonormal basis of Σ h sine_h = 0 and Σ h² cosine_h = 0, shape (1 + 2 H, 2 H − 1)."""
        h = np.arange(1.0, self.harmonics + 1)
        zero = np.zeros(self.harmonics)
        return scipy.linalg.null_space(
            np.array([[0.0, *zero, *h], [0.0, *(h**2), *zero]])
        )

    def split(self, periods: int) -> FourierSeries:
        """The same functions within another number of periods of the same duration."""
        return replace(self, period=self.duration / periods, periods=periods)

    def trajectory(self, coefficients: npt.ArrayLike) -> Trajectory:
        """The motion with these coefficients, shape (c, nv)."""
        return Trajectory(
            np.asarray(coefficients, float), self.period, self.periods
        )

    def constant(self, pose: Array) -> Array:
        """Coefficients of standing still, shape (c, nv)."""
        return np.outer(np.eye(self.size)[0], pose)

    def basis(self, t: npt.ArrayLike, order: int = 0) -> Array:
        """The order-th time derivative of the functions, shape (n, c)."""
        w = 2 * np.pi / self.period * np.arange(1, self.harmonics + 1)
        angle = np.atleast_1d(np.asarray(t, float))[:, None] * w
        cos = np.cos(angle)
        sin = np.sin(angle)
        turned = ((cos, sin), (-sin, cos), (-cos, -sin), (sin, -cos))[order % 4]
        constant = np.full((len(angle), 1), float(order == 0))
        return np.hstack([constant, turned[0] * w**order, turned[1] * w**order])

    def along(self, times: Array, coefficients: Array, order: int) -> Array:
        """A derivative of joint j at its own instants ``times[:, j]``, same shape (k, nv)."""
        basis = self.basis(times.ravel(), order).reshape(*times.shape, -1)
        return np.einsum("njc,cj->nj", basis, coefficients, optimize=True)

    def instants(self, per_term: int) -> Array:
        """Equidistant instants over one period, the end left out [s]."""
        n = per_term * self.harmonics
        return np.arange(n) / n * self.period

    def nearest(self, trajectory: Trajectory) -> Array:
        """Coefficients at rest nearest to another motion by least squares, shape (c, nv)."""
        t = np.arange(16 * self.size) / (16 * self.size) * self.period
        z = np.linalg.lstsq(self.basis(t) @ self.rest, trajectory(t), rcond=None)[0]
        return self.rest @ z

    def extremum_times(self, coefficients: Array, order: int) -> Array:
        """Instants among which every extremum of a derivative lies, shape (k, nv) [s].

        They are the roots of the next derivative, polished by Newton's method, and the start. Roots
        off the unit circle give instants too; they are no extrema and do no harm.
        """
        # in the angle θ = ωt high derivatives keep their size
        scaled = FourierSeries(2 * np.pi, self.harmonics)
        theta = np.stack(
            [_root_angles(x, order + 1) for x in coefficients.T], axis=1
        )
        for _ in range(4):
            slope, curve = (
                scaled.along(theta, coefficients, order + k) for k in (1, 2)
            )
            step = np.divide(
                slope, curve, out=np.zeros_like(slope), where=np.abs(curve) > 1e-12
            )
            theta = theta - np.where(
                np.abs(step) < 0.5 / max(self.harmonics, 1), step, 0.0
            )
        w = 2 * np.pi / self.period
        start = np.zeros(coefficients.shape[1])
        return np.vstack([start, np.mod(theta, 2 * np.pi) / w])

    def reach(self, bound: Array) -> Array:
        """Largest useful change of each coefficient alone (c, nv), from half ranges of q, q̇, q̈."""
        w = 2 * np.pi / self.period * np.arange(1, self.harmonics + 1)
        peaks = [
            np.concatenate([[float(k == 0)], w**k, w**k]) for k in range(len(bound))
        ]
        with np.errstate(divide="ignore"):
            each = [b / peak[:, None] for b, peak in zip(bound, peaks, strict=True)]
        return np.min(each, axis=0)


def resting_series(
    duration: float, harmonics: int, periods: int = 1
) -> FourierSeries:
    """Functions that motions at rest at both ends are made of, in periods of a duration [s].

    Raises:
        BadInput: The duration is not positive, or too few periods or harmonics.
    """
    if not (np.isfinite(duration) and duration > 0):
        raise BadInput(f"duration {duration} s is not a positive number")
    if periods < 1:
        raise BadInput(f"{periods} periods: at least one is needed")
    if harmonics < 2:
        raise BadInput(
            f"{harmonics} harmonics cannot move and be at rest at both ends; use at least 2"
        )
    return FourierSeries(float(duration), harmonics).split(periods)


class _Curve(ABC):
    """Joint motion known at every instant."""

    @abstractmethod
    def __call__(self, t: npt.ArrayLike, order: int = 0) -> Array: ...

    def at(self, t: npt.ArrayLike) -> Motion:
        """The motion at the given instants [s], shape (n,)."""
        t = np.atleast_1d(np.asarray(t, float))
        return Motion(t, self(t), self(t, 1), self(t, 2))


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory(_Curve, Shown):
    """Periodic joint motion as a finite Fourier series (Swevers et al. 1997, eq. 4).

    q(t) = offset + Σ_h cosine_h cos(hωt) + sine_h sin(hωt), with ω = 2π / period; known at every
    instant with its derivatives.

    Attributes:
        coefficients: Offset, cosines and sines, shape (1 + 2 H, nv) [rad or m].
        period: Duration of one period [s].
        periods: Number of periods that the motion has.
    """

    coefficients: Array
    period: float
    periods: int = 1

    def __post_init__(self) -> None:
        freeze(self, "coefficients")
        if self.coefficients.ndim != 2 or len(self.coefficients) % 2 == 0:
            raise ValueError(
                f"coefficients of shape {self.coefficients.shape}, expected (1 + 2 H, nv)"
            )
        _ = self.series  # which refuses what is no period

    @cached_property
    def series(self) -> FourierSeries:
        """The functions that the motion is a combination of."""
        return FourierSeries(float(self.period), self.harmonics, self.periods)

    @property
    def offset(self) -> Array:
        """Mean position per joint, shape (nv,) [rad or m]."""
        return self.coefficients[0]

    @property
    def duration(self) -> float:
        """Length of the motion, all its periods [s]."""
        return self.series.duration

    def __call__(self, t: npt.ArrayLike, order: int = 0) -> Array:
        """Evaluate the motion or its time derivative of the given order, shape (n, nv)."""
        return self.series.basis(t, order) @ self.coefficients

    @property
    def nv(self) -> int:
        """Number of joints."""
        return int(self.coefficients.shape[1])

    @property
    def harmonics(self) -> int:
        """Number of harmonics."""
        return len(self.coefficients) // 2

    @property
    def at_rest(self) -> bool:
        """Whether q̇ = q̈ = 0 at t = 0 and t = period."""
        w = 2 * np.pi * self.harmonics / self.period
        size = np.abs(self.coefficients).max()
        return all(
            np.abs(self(0.0, k)).max() <= _REST * w**k * size for k in (1, 2)
        )

    def sample(self, n: int) -> Motion:
        """One period at ``n`` equidistant instants, first and last included."""
        return self.at(np.linspace(0.0, self.period, n))

    def motion(self, rate_hz: float, repetitions: int = 1) -> Motion:
        """All periods at a control rate [Hz], once or more, first and last sample included.

        The rate is adjusted, by less than half a sample, to divide the duration.
        """
        n = max(1, round(self.duration * rate_hz))
        t = np.arange(repetitions * n + 1.0) * (self.duration / n)
        once = self.at(np.linspace(0.0, self.duration, n + 1))
        k = np.append(np.tile(np.arange(n), repetitions), n)
        return replace(once[k], t=t)

    def slowed(self, speed: float) -> Trajectory:
        """The same path at a share of the speed."""
        return replace(self, period=self.period / speed)

    def extrema_in_time(self, order: int) -> tuple[Array, Array]:
        """Instants among which every extremum of a derivative lies, and values there, (k, nv)."""
        times = self.series.extremum_times(self.coefficients, order)
        return times, self.series.along(times, self.coefficients, order)

    def extrema(self, order: int = 0) -> tuple[Array, Array]:
        """Exact smallest and largest value of a derivative per joint, each of shape (nv,)."""
        values = self.extrema_in_time(order)[1]
        return values.min(axis=0), values.max(axis=0)

    def _lines(self) -> list[str]:
        ends = "at rest at both ends" if self.at_rest else "not at rest at its ends"
        tops = (np.abs(self.extrema(order)).max() for order in (1, 2))
        many = f" in {self.periods} periods" * (self.periods > 1)
        return [
            f"Fourier trajectory of {self.duration:.4g} s{many}, SI units",
            f"{self.nv} joints, {self.harmonics} harmonics, {ends}",
            "top speed {:.4g}, top acceleration {:.4g}".format(*tops),
        ]

    def _table(self) -> Table:
        low, high = self.extrema()
        tops = [np.abs(self.extrema(order)).max(axis=0) for order in (1, 2)]
        columns = [np.arange(1, self.nv + 1), low, high, *tops]
        heads = ("joint", "from", "to", "top speed", "top acceleration")
        return heads, zip(*(c.tolist() for c in columns), strict=True)


def _root_angles(x: Array, order: int) -> Array:
    """Angles of all complex roots of a derivative, by its companion matrix, padded to (2 H,)."""
    H = len(x) // 2
    c = (1j * np.arange(1, H + 1)) ** order * (x[1 : 1 + H] - 1j * x[1 + H :])
    size = np.abs(c)
    high = np.flatnonzero(size > 1e-13 * max(float(size.max(initial=0.0)), 1e-300))
    angles = np.zeros(2 * H)
    if len(high):
        c = c[: high[-1] + 1]
        roots = np.roots(np.concatenate([c[::-1], [0.0], np.conj(c)]))
        angles[: len(roots)] = np.angle(roots)
    return angles


class HermiteTrajectory(_Curve):
    """Quintic Hermite interpolant through q, q̇, q̈ of samples at strictly increasing times."""

    def __init__(self, samples: Motion) -> None:
        self.samples = samples
        knots = np.stack([samples.q, samples.dq, samples.ddq], axis=1)
        self._q = scipy.interpolate.BPoly.from_derivatives(samples.t, knots)

    def __call__(self, t: npt.ArrayLike, order: int = 0) -> Array:
        return self._q(np.atleast_1d(np.asarray(t, float)), nu=order)
