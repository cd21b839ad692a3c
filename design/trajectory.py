"""Excitation trajectories as finite Fourier series, exact in every derivative and extremum."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy.linalg

from excitant.robots.motion import Array, Motion, freeze, read_only

_REST = 1e-9  # of the largest possible speed or acceleration of the series


@dataclass(frozen=True, eq=False)
class FourierTrajectory:
    """Periodic joint motion as a finite Fourier series (Swevers et al. 1997, eq. 4).

    q(t) = offset + Σ_h cosine_h cos(hωt) + sine_h sin(hωt), with ω = 2π / period.

    Attributes:
        offset: Mean position per joint, shape (nv,) [rad or m].
        cosine: Coefficients, shape (harmonics, nv) [rad or m].
        sine: Coefficients, shape (harmonics, nv) [rad or m].
        period: Duration of one period [s].
    """

    offset: Array
    cosine: Array
    sine: Array
    period: float

    def __post_init__(self) -> None:
        freeze(self, "offset", "cosine", "sine")
        object.__setattr__(self, "period", float(self.period))
        shape = (len(self.cosine), *self.offset.shape)
        if self.offset.ndim != 1 or self.cosine.shape != shape or self.sine.shape != shape:
            raise ValueError(
                f"shapes differ: offset {self.offset.shape}, cosine {self.cosine.shape}, "
                f"sine {self.sine.shape}"
            )
        if not self.period > 0:
            raise ValueError(f"period {self.period} is not positive")

    def __call__(self, t: npt.ArrayLike, order: int = 0) -> Array:
        """Evaluate the motion or its time derivative of the given order, shape (n, nv)."""
        return fourier_basis(t, self.harmonics, self.period, order) @ self.coefficients

    @property
    def nv(self) -> int:
        """Number of joints."""
        return len(self.offset)

    @property
    def harmonics(self) -> int:
        """Number of harmonics."""
        return len(self.cosine)

    @cached_property
    def coefficients(self) -> Array:
        """Offset, cosine and sine coefficients below one another, shape (1 + 2 H, nv)."""
        return read_only(np.vstack([self.offset, self.cosine, self.sine]))

    @property
    def at_rest(self) -> bool:
        """Whether q̇ = q̈ = 0 at t = 0 and t = period."""
        w = 2 * np.pi / self.period * np.arange(1, self.harmonics + 1)[:, None]
        size = np.abs(self.cosine) + np.abs(self.sine)
        return all(
            bool(np.all(np.abs(self(0.0, k)) <= _REST * (w**k * size).sum(axis=0) + 1e-300))
            for k in (1, 2)
        )

    def at(self, t: npt.ArrayLike) -> Motion:
        """The motion at the given instants [s], shape (n,)."""
        t = np.atleast_1d(np.asarray(t, float))
        return Motion(t, self(t), self(t, 1), self(t, 2))

    def sample(self, n: int) -> Motion:
        """One period at ``n`` equidistant instants, first and last included."""
        return self.at(np.linspace(0.0, self.period, n))

    def motion(self, rate_hz: float) -> Motion:
        """One period at a control rate [Hz], first and last sample included.

        The rate is adjusted, by less than half a sample per period, to divide the period.
        """
        return self.sample(max(2, round(self.period * rate_hz) + 1))

    def extremum_times(self, order: int = 0) -> Array:
        """Instants among which every extremum of a derivative lies, shape (2 H + 1, nv) [s].

        They are the roots of the next derivative, a trigonometric polynomial: eigenvalues of
        its companion matrix, polished by Newton's method; the start of the period is added.
        Roots off the unit circle give instants too; they are no extrema and do no harm.
        """
        w = 2 * np.pi / self.period
        scaled = FourierTrajectory(
            self.offset, self.cosine, self.sine, 2 * np.pi
        )  # in the angle θ = ωt, so that high derivatives keep their size
        theta = np.stack([_root_angles(scaled, order + 1, j) for j in range(self.nv)], axis=1)
        for _ in range(4):
            slope, curve = (_along(scaled, theta, order + k) for k in (1, 2))
            step = np.divide(slope, curve, out=np.zeros_like(slope), where=np.abs(curve) > 1e-12)
            theta = theta - np.where(np.abs(step) < 0.5 / max(self.harmonics, 1), step, 0.0)
        times: Array = np.vstack([np.zeros(self.nv), np.mod(theta, 2 * np.pi) / w])
        return times

    def extrema_in_time(self, order: int = 0) -> tuple[Array, Array]:
        """Instants of `extremum_times` and the derivative there, both (2 H + 1, nv)."""
        times = self.extremum_times(order)
        return times, _along(self, times, order)

    def extrema(self, order: int = 0) -> tuple[Array, Array]:
        """Exact smallest and largest value of a derivative per joint, each of shape (nv,)."""
        values = self.extrema_in_time(order)[1]
        return values.min(axis=0), values.max(axis=0)


def from_coefficients(coefficients: npt.ArrayLike, period: float) -> FourierTrajectory:
    """Trajectory from stacked offset, cosine and sine coefficients, shape (1 + 2 H, nv)."""
    X = np.asarray(coefficients, float)
    H = len(X) // 2
    return FourierTrajectory(X[0], X[1 : 1 + H], X[1 + H :], period)


def fourier_basis(t: npt.ArrayLike, harmonics: int, period: float, order: int = 0) -> Array:
    """The order-th time derivative of 1, cos hωt, sin hωt, shape (n, 1 + 2 H)."""
    w = 2 * np.pi / period * np.arange(1, harmonics + 1)
    angle = np.atleast_1d(np.asarray(t, float))[:, None] * w
    cos, sin = np.cos(angle), np.sin(angle)
    turned = ((cos, sin), (-sin, cos), (-cos, -sin), (sin, -cos))[order % 4]
    constant = np.full((len(angle), 1), float(order == 0))
    return np.hstack([constant, turned[0] * w**order, turned[1] * w**order])


def rest_basis(harmonics: int) -> Array:
    """Orthonormal basis of the coefficients at rest, shape (1 + 2 H, 2 H − 1).

    Rest, q̇ = q̈ = 0 at both ends, is two linear equations: Σ h sine_h = 0, Σ h² cosine_h = 0.
    """
    h = np.arange(1.0, harmonics + 1)
    zero = np.zeros(harmonics)
    equations = np.array([[0.0, *zero, *h], [0.0, *(h**2), *zero]])
    return scipy.linalg.null_space(equations)


def _along(trajectory: FourierTrajectory, times: Array, order: int) -> Array:
    """Joint j evaluated at its own instants ``times[:, j]``, same shape."""
    n, nv = times.shape
    basis = fourier_basis(times.ravel(), trajectory.harmonics, trajectory.period, order)
    values: Array = np.einsum(
        "njc,cj->nj", basis.reshape(n, nv, -1), trajectory.coefficients, optimize=True
    )
    return values


def _root_angles(trajectory: FourierTrajectory, order: int, joint: int) -> Array:
    """Angles of all complex roots of one joint's derivative, padded to shape (2 H,)."""
    H = trajectory.harmonics
    h = np.arange(1, H + 1)
    c = (1j * h) ** order * (trajectory.cosine[:, joint] - 1j * trajectory.sine[:, joint])
    size = np.abs(c)
    high = np.flatnonzero(size > 1e-13 * max(float(size.max(initial=0.0)), 1e-300))
    angles = np.zeros(2 * H)
    if len(high):
        c = c[: high[-1] + 1]
        roots = np.roots(np.concatenate([c[::-1], [0.0], np.conj(c)]))
        angles[: len(roots)] = np.angle(roots)
    return angles
