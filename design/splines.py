"""Excitation trajectories as periodic B-splines, for cells too tight for few harmonics."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline, PPoly

from excitant.design.trajectory import Series, Trajectory
from excitant.robots.motion import Array, freeze, read_only

_DEGREE = 5  # jerk is continuous, and so is its rate


@dataclass(frozen=True, eq=False)
class SplineSeries(Series):
    """Quintic B-splines on equidistant knots that close to a period.

    Attributes:
        period: Duration of one period [s].
        pieces: Number of polynomial pieces, and of basis functions; at least 6.
    """

    period: float
    pieces: int

    @property
    def size(self) -> int:
        """Number of basis functions."""
        return self.pieces

    @cached_property
    def _unit(self) -> BSpline:
        return _periodic(np.eye(self.pieces), self.period)

    def basis(self, t: npt.ArrayLike, order: int = 0) -> Array:
        """The order-th time derivative of the basis functions, shape (n, pieces)."""
        t = np.atleast_1d(np.asarray(t, float))
        values: Array = self._unit(np.mod(t, self.period), nu=order)
        return values

    def trajectory(self, coefficients: npt.ArrayLike) -> SplineTrajectory:
        """The motion with these coefficients, shape (pieces, nv)."""
        return SplineTrajectory(np.asarray(coefficients, float), self.period)

    def resized(self, terms: int, period: float | None = None) -> SplineSeries:
        """The same functions with another number of terms, or another period [s]."""
        return SplineSeries(period or self.period, 2 * terms)

    def constant(self, pose: Array) -> Array:
        """Coefficients of standing still, shape (pieces, nv)."""
        return np.tile(pose, (self.pieces, 1))

    def mean(self, coefficients: Array) -> Array:
        """Mean pose of the motion with these coefficients, shape (nv,)."""
        middle: Array = coefficients.mean(axis=0)
        return middle

    def peaks(self, order: int) -> Array:
        """Largest magnitude of each basis function's derivative, shape (pieces,)."""
        t = np.linspace(0.0, self.period, 64 * self.pieces + 1)
        return np.full(self.pieces, np.abs(self.basis(t, order)).max())

    def reach(self, bound: Array) -> Array:
        """Largest useful change of each coefficient, shape (pieces, nv): half the range.

        Velocity and acceleration limit differences of coefficients, not their size.
        """
        return np.tile(bound[0], (self.pieces, 1))


@dataclass(frozen=True, eq=False)
class SplineTrajectory(Trajectory):
    """Periodic joint motion as a quintic B-spline on equidistant knots.

    q(t) = Σ_k c_k B(t / h − k), periodic, with h = period / pieces (de Boor 1978).

    Attributes:
        control_points: c, one row per piece, shape (pieces, nv) [rad or m].
        period: Duration of one period [s].
    """

    control_points: Array
    period: float

    def __post_init__(self) -> None:
        freeze(self, "control_points")
        object.__setattr__(self, "period", float(self.period))
        if self.control_points.ndim != 2 or len(self.control_points) <= _DEGREE:
            raise ValueError(
                f"control points have shape {self.control_points.shape}; at least {_DEGREE + 1} "
                "pieces are needed"
            )
        if not self.period > 0:
            raise ValueError(f"period {self.period} is not positive")

    @property
    def coefficients(self) -> Array:
        """The control points."""
        return self.control_points

    @cached_property
    def series(self) -> SplineSeries:
        """The basis functions."""
        return SplineSeries(self.period, len(self.control_points))

    def extremum_times(self, order: int = 0) -> Array:
        """Instants among which every extremum of a derivative lies, shape (k, nv) [s].

        The roots of the next derivative, piece by piece, and the knots.
        """
        pieces = len(self.control_points)
        knots = np.arange(pieces) * (self.period / pieces)
        found = []
        for points in self.control_points.T:
            spline = _periodic(points, self.period)
            slope = PPoly.from_spline((spline.t, spline.c, _DEGREE)).derivative(order + 1)
            roots = slope.roots(extrapolate=False)
            inside = roots[np.isfinite(roots) & (roots >= 0) & (roots <= self.period)]
            found.append(np.concatenate([knots, inside]))
        length = max(len(times) for times in found)
        padded = [np.pad(times, (0, length - len(times))) for times in found]
        return read_only(np.stack(padded, axis=1))


def _periodic(coefficients: Array, period: float) -> BSpline:
    """Spline over one period of coefficients (pieces, ...)."""
    pieces = len(coefficients)
    knots = np.arange(-_DEGREE, pieces + _DEGREE + 1) * (period / pieces)
    wrapped = coefficients[np.arange(pieces + _DEGREE) % pieces]
    return BSpline(knots, wrapped, _DEGREE)
