"""Excitation trajectories, Fourier series or B-splines, with exact derivatives and extrema."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar, Self

import numpy as np
import numpy.typing as npt
import scipy

from excitant.robots.motion import Array, Motion, freeze, read_only
from excitant.robots.shown import Shown, Table

_REST = 1e-9  # of the largest coefficient at the highest frequency
_DEGREE = 5  # of splines: jerk is continuous, and so is its rate


@dataclass(frozen=True, eq=False)
class Series(ABC):
    """Basis functions in time, of which a periodic joint motion is a combination."""

    name: ClassVar[str]
    period: float  # duration of one period [s]
    periods: int = field(default=1, kw_only=True)  # that the motion has

    def __post_init__(self) -> None:
        if not self.period > 0:
            raise ValueError(f"period {self.period} is not positive")
        if self.periods < 1:
            raise ValueError(f"{self.periods} periods: at least one is needed")

    @property
    @abstractmethod
    def size(self) -> int:
        """Number c of basis functions, the constant among what they span."""

    @property
    @abstractmethod
    def one(self) -> Array:
        """Coefficients of the constant 1, shape (c,)."""

    @abstractmethod
    def basis(self, t: npt.ArrayLike, order: int = 0) -> Array:
        """The order-th time derivative of the basis functions, shape (n, c)."""

    @abstractmethod
    def extremum_times(self, coefficients: Array, order: int) -> Array:
        """Instants among which every extremum of a derivative lies, shape (k, nv) [s]."""

    @abstractmethod
    def resized(self, terms: int) -> Self:
        """The same kind of functions with another number of terms."""

    @abstractmethod
    def reach(self, bound: Array) -> Array:
        """Largest useful change of each coefficient alone (c, nv), from half ranges of q, q̇, q̈."""

    def trajectory(self, coefficients: npt.ArrayLike) -> Trajectory:
        """The motion with these coefficients, shape (c, nv)."""
        return Trajectory(self, np.asarray(coefficients, float))

    @property
    def duration(self) -> float:
        """Length of the motion, all its periods [s]."""
        return self.period * self.periods

    def split(self, periods: int) -> Self:
        """The same functions within another number of periods of the same duration."""
        return replace(self, period=self.duration / periods, periods=periods)

    def slowed(self, speed: float) -> Self:
        """The same functions at a share of the speed."""
        return replace(self, period=self.period / speed)

    @property
    def terms(self) -> int:
        """Number of harmonics of a Fourier series with as many coefficients."""
        return self.size // 2

    @cached_property
    def rest(self) -> Array:
        """Orthonormal basis of the coefficients at rest at both ends, shape (c, c − 2)."""
        ends = np.vstack([self.basis(0.0, order) for order in (1, 2)])
        return scipy.linalg.null_space(
            ends / np.abs(ends).max(axis=1, keepdims=True)
        )

    def constant(self, pose: Array) -> Array:
        """Coefficients of standing still, shape (c, nv)."""
        return np.outer(self.one, pose)

    def along(self, times: Array, coefficients: Array, order: int) -> Array:
        """A derivative of joint j at its own instants ``times[:, j]``, same shape (k, nv)."""
        basis = self.basis(times.ravel(), order).reshape(*times.shape, -1)
        values: Array = np.einsum("njc,cj->nj", basis, coefficients, optimize=True)
        return values

    def instants(self, per_term: int) -> Array:
        """Equidistant instants over one period, the end left out [s]."""
        n = per_term * self.terms
        return np.arange(n) / n * self.period

    def nearest(self, trajectory: Trajectory) -> Array:
        """Coefficients at rest nearest to another motion by least squares, shape (c, nv)."""
        t = np.arange(16 * self.size) / (16 * self.size) * self.period
        z = np.linalg.lstsq(self.basis(t) @ self.rest, trajectory(t), rcond=None)[0]
        coefficients: Array = self.rest @ z
        return coefficients


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
    """Periodic joint motion, known at every instant with its derivatives."""

    series: Series  # the basis functions, c of them
    coefficients: Array  # of each, shape (c, nv) [rad or m]

    def __post_init__(self) -> None:
        freeze(self, "coefficients")
        if (
            self.coefficients.ndim != 2
            or len(self.coefficients) != self.series.size
        ):
            raise ValueError(
                f"coefficients have shape {self.coefficients.shape}, expected "
                f"({self.series.size}, number of joints)"
            )

    @property
    def period(self) -> float:
        """Duration of one period [s]."""
        return self.series.period

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
        """Number of harmonics, or that of a Fourier series with as many coefficients."""
        return self.series.terms

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
        t: Array = np.arange(repetitions * n + 1.0) * (self.duration / n)
        once = self.at(np.linspace(0.0, self.duration, n + 1))
        k = np.append(np.tile(np.arange(n), repetitions), n)
        return Motion(t, once.q[k], once.dq[k], once.ddq[k])

    def slowed(self, speed: float) -> Trajectory:
        """The same path at a share of the speed."""
        return self.series.slowed(speed).trajectory(self.coefficients)

    def extrema_in_time(self, order: int = 0) -> tuple[Array, Array]:
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
        many = f" in {self.series.periods} periods" * (self.series.periods > 1)
        return [
            f"{self.series.name.capitalize()} trajectory of {self.duration:.4g} s{many}, SI units",
            f"{self.nv} joints, {self.harmonics} harmonics, {ends}",
            "top speed {:.4g}, top acceleration {:.4g}".format(*tops),
        ]

    def _table(self) -> Table:
        low, high = self.extrema()
        tops = [np.abs(self.extrema(order)).max(axis=0) for order in (1, 2)]
        columns = [np.arange(1, self.nv + 1), low, high, *tops]
        heads = ("joint", "from", "to", "top speed", "top acceleration")
        return heads, zip(*(c.tolist() for c in columns), strict=True)


@dataclass(frozen=True, eq=False)
class FourierSeries(Series):
    """1, cos hωt, sin hωt for h = 1 … H, ω = 2π / period (Swevers et al. 1997)."""

    name = "fourier"
    harmonics: int  # number of harmonics H

    @property
    def size(self) -> int:
        return 1 + 2 * self.harmonics

    @property
    def one(self) -> Array:
        one: Array = np.eye(self.size)[0]
        return one

    @cached_property
    def rest(self) -> Array:
        """Orthonormal basis of Σ h sine_h = 0 and Σ h² cosine_h = 0, shape (1 + 2 H, 2 H − 1)."""
        h = np.arange(1.0, self.harmonics + 1)
        zero = np.zeros(self.harmonics)
        return scipy.linalg.null_space(
            np.array([[0.0, *zero, *h], [0.0, *(h**2), *zero]])
        )

    def basis(self, t: npt.ArrayLike, order: int = 0) -> Array:
        w = 2 * np.pi / self.period * np.arange(1, self.harmonics + 1)
        angle = np.atleast_1d(np.asarray(t, float))[:, None] * w
        cos = np.cos(angle)
        sin = np.sin(angle)
        turned = ((cos, sin), (-sin, cos), (-cos, -sin), (sin, -cos))[order % 4]
        constant = np.full((len(angle), 1), float(order == 0))
        return np.hstack([constant, turned[0] * w**order, turned[1] * w**order])

    def trajectory(self, coefficients: npt.ArrayLike) -> FourierTrajectory:
        return from_coefficients(coefficients, self.period, self.periods)

    def extremum_times(self, coefficients: Array, order: int) -> Array:
        """Roots of the next derivative, polished by Newton's method, and the start [s].

        Roots off the unit circle give instants too; they are no extrema and do no harm.
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
        times: Array = np.vstack([start, np.mod(theta, 2 * np.pi) / w])
        return times

    def resized(self, terms: int) -> Self:
        return replace(self, harmonics=terms)

    def reach(self, bound: Array) -> Array:
        w = 2 * np.pi / self.period * np.arange(1, self.harmonics + 1)
        peaks = [
            np.concatenate([[float(k == 0)], w**k, w**k]) for k in range(len(bound))
        ]
        with np.errstate(divide="ignore"):
            each = [b / peak[:, None] for b, peak in zip(bound, peaks, strict=True)]
        least: Array = np.min(each, axis=0)
        return least


class FourierTrajectory(Trajectory):
    """Periodic joint motion as a finite Fourier series (Swevers et al. 1997, eq. 4).

    q(t) = offset + Σ_h cosine_h cos(hωt) + sine_h sin(hωt), with ω = 2π / period.

    Args:
        offset: Mean position per joint, shape (nv,) [rad or m].
        cosine: Coefficients, shape (harmonics, nv) [rad or m].
        sine: Coefficients, shape (harmonics, nv) [rad or m].
        period: Duration of one period [s].
        periods: Number of periods that the motion has.
    """

    def __init__(
        self,
        offset: npt.ArrayLike,
        cosine: npt.ArrayLike,
        sine: npt.ArrayLike,
        period: float,
        periods: int = 1,
    ) -> None:
        parts = [np.asarray(part, float) for part in (offset, cosine, sine)]
        shapes = [part.shape for part in parts]
        if (
            len(shapes[0]) != 1
            or shapes[1] != shapes[2]
            or shapes[1][1:] != shapes[0]
        ):
            names = zip(("offset", "cosine", "sine"), shapes, strict=True)
            raise ValueError(
                "shapes differ: " + ", ".join(f"{n} {shape}" for n, shape in names)
            )
        super().__init__(
            FourierSeries(float(period), len(parts[1]), periods=periods),
            np.vstack(parts),
        )

    @property
    def offset(self) -> Array:
        """Mean position per joint, shape (nv,)."""
        return read_only(self.coefficients[0])

    @property
    def cosine(self) -> Array:
        """Coefficients of the cosines, shape (harmonics, nv)."""
        return read_only(self.coefficients[1 : 1 + self.harmonics])

    @property
    def sine(self) -> Array:
        """Coefficients of the sines, shape (harmonics, nv)."""
        return read_only(self.coefficients[1 + self.harmonics :])


def from_coefficients(
    coefficients: npt.ArrayLike, period: float, periods: int = 1
) -> FourierTrajectory:
    """Trajectory from stacked offset, cosine and sine coefficients, shape (1 + 2 H, nv)."""
    X = np.asarray(coefficients, float)
    cosine, sine = np.split(X[1:], 2)
    return FourierTrajectory(X[0], cosine, sine, period, periods)


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


@dataclass(frozen=True, eq=False)
class SplineSeries(Series):
    """Quintic B-splines B(t / h − k), h = period / pieces, closed to a period (de Boor 1978)."""

    name = "spline"
    pieces: int  # number of polynomial pieces, and of basis functions; at least 6

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.pieces <= _DEGREE:
            raise ValueError(
                f"{self.pieces} pieces: at least {_DEGREE + 1} are needed"
            )

    @property
    def size(self) -> int:
        return self.pieces

    @property
    def one(self) -> Array:
        return np.ones(self.pieces)

    @cached_property
    def _unit(self) -> scipy.interpolate.BSpline:
        return self._spline(np.eye(self.pieces))

    def _spline(self, coefficients: Array) -> scipy.interpolate.BSpline:
        knots = np.arange(-_DEGREE, self.pieces + _DEGREE + 1) * (
            self.period / self.pieces
        )
        wrapped = coefficients[np.arange(self.pieces + _DEGREE) % self.pieces]
        return scipy.interpolate.BSpline(knots, wrapped, _DEGREE)

    def basis(self, t: npt.ArrayLike, order: int = 0) -> Array:
        t = np.atleast_1d(np.asarray(t, float))
        values: Array = self._unit(np.mod(t, self.period), nu=order)
        return values

    def extremum_times(self, coefficients: Array, order: int) -> Array:
        """Roots of the next derivative, piece by piece, and the knots, shape (k, nv) [s]."""
        knots = np.arange(self.pieces) * (self.period / self.pieces)
        instants = []
        for points in coefficients.T:
            spline = self._spline(points)
            slope = scipy.interpolate.PPoly.from_spline(
                (spline.t, spline.c, _DEGREE)
            ).derivative(order + 1)
            roots = slope.roots(extrapolate=False)
            inside = roots[
                np.isfinite(roots) & (roots >= 0) & (roots <= self.period)
            ]
            instants.append(np.concatenate([knots, inside]))
        length = max(map(len, instants))
        return np.stack(
            [np.pad(times, (0, length - len(times))) for times in instants], axis=1
        )

    def resized(self, terms: int) -> Self:
        return replace(self, pieces=2 * terms)

    def reach(self, bound: Array) -> Array:
        """Half the range, shape (pieces, nv): other limits are on differences of coefficients."""
        return np.tile(bound[0], (self.pieces, 1))


class HermiteTrajectory(_Curve):
    """Quintic Hermite interpolant through q, q̇, q̈ of samples at strictly increasing times."""

    def __init__(self, samples: Motion) -> None:
        self.samples = samples
        knots = np.stack([samples.q, samples.dq, samples.ddq], axis=1)
        self._q = scipy.interpolate.BPoly.from_derivatives(samples.t, knots)

    def __call__(self, t: npt.ArrayLike, order: int = 0) -> Array:
        values: Array = self._q(np.atleast_1d(np.asarray(t, float)), nu=order)
        return values
