"""What a sampled motion does between its samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BPoly

from excitant.robots.motion import Array, Motion


@dataclass(frozen=True, eq=False)
class HermiteTrajectory:
    """Quintic Hermite interpolant through the q, q̇, q̈ samples of a motion.

    Attributes:
        samples: The motion; its time strictly increasing.
    """

    samples: Motion

    def __post_init__(self) -> None:
        m = self.samples
        knots = np.stack([m.q, m.dq, m.ddq], axis=1)
        object.__setattr__(self, "_q", BPoly.from_derivatives(m.t, knots))

    def __call__(self, t: npt.ArrayLike, order: int = 0) -> Array:
        """Evaluate the motion or its time derivative of the given order, shape (n, nv)."""
        spline: BPoly = self._q  # type: ignore[attr-defined]
        values: Array = spline(np.atleast_1d(np.asarray(t, float)), nu=order)
        return values

    def at(self, t: npt.ArrayLike) -> Motion:
        """The motion at the given instants [s], shape (n,)."""
        t = np.atleast_1d(np.asarray(t, float))
        return Motion(t, self(t), self(t, 1), self(t, 2))


def peak_times(t: Array, value: Array, slope: Array) -> tuple[Array, Array]:
    """Interior extrema of the cubic Hermite interpolants of several channels.

    Args:
        t: Instants, increasing, shape (n,) [s].
        value: Values, shape (n, m).
        slope: Time derivatives, shape (n, m).

    Returns:
        Instants of the (up to two) stationary points of every interval, and the channel each
        belongs to; both of shape (k,).
    """
    h = np.diff(t)[:, None]
    d0, d1 = h * slope[:-1], h * slope[1:]
    rise = np.diff(value, axis=0)
    a, b, c = 3 * (d0 + d1 - 2 * rise), 2 * (3 * rise - 2 * d0 - d1), d0
    root = np.sqrt(np.maximum(b**2 - 4 * a * c, 0.0))
    w = -0.5 * (b + np.where(b < 0, -1.0, 1.0) * root)
    times, channels = [], []
    for top, bottom in ((w, a), (c, w)):
        u = np.divide(top, bottom, out=np.full_like(top, -1.0), where=np.abs(bottom) > 1e-300)
        k, channel = np.nonzero((u > 0) & (u < 1) & (b**2 >= 4 * a * c))
        times.append(t[k] + u[k, channel] * h[k, 0])
        channels.append(channel)
    return np.concatenate(times), np.concatenate(channels)


def largest(
    evaluate: Callable[[Array], Array], slope: Callable[[Array], Array], t: Array
) -> tuple[Array, Array]:
    """Value of largest magnitude of each channel over continuous time, and when.

    The instants given are joined by cubic Hermite interpolation (error h⁴ |f⁗| / 384); the
    function itself is then evaluated at the interpolants' stationary points.

    Args:
        evaluate: Values at instants (n,), shape (n, m).
        slope: Their time derivatives.
        t: Instants fine enough for the interpolation, increasing [s].
    """
    value = evaluate(t)
    k = np.abs(value).argmax(axis=0)
    best, when = value[k, np.arange(value.shape[1])], t[k]
    times, channels = peak_times(t, value, slope(t))
    if len(times):
        peaks = evaluate(times)[np.arange(len(times)), channels]
        for j in range(value.shape[1]):
            own = np.flatnonzero(channels == j)
            if len(own) and np.abs(peaks[own]).max() > abs(best[j]):
                k = own[np.abs(peaks[own]).argmax()]
                best[j], when[j] = peaks[k], times[k]
    return best, when
