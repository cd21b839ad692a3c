"""How well a model predicts the torque of a recording, and how well it knows that.

The torque W β̂ of a row has the variance w Σ wᵀ, Σ the covariance of the base parameters, which
counts coloured noise. A new reading lies around it by that and by the noise of its joint, whose
variance is that of the residuals the fit left, with what the fit took out of them given back:
E ‖e‖² = (N − tr(A⁻¹Ω)) σ², of which each joint has a share by its inflation. Coloured residuals
know their variance from ν = n / Σ ρ_k² independent samples (Bartlett), so quantiles are Student's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from excitant.identify.least_squares import LeastSquares, autocorrelation, autocorrelation_time
from excitant.identify.preprocessing import Segment
from excitant.robots.motion import Array, freeze, read_only
from excitant.robots.robot import Robot
from excitant.robots.torque import torque

LEVEL = 0.95
_FEWEST = 3.0  # degrees of freedom, below which no noise is known
_MOST = 0.5  # of the residual's variance that is given back
_FAR, _CERTAIN = 0.02, 2.0  # share of samples and standard deviations that chance is allowed


@dataclass(frozen=True, eq=False)
class Accuracy:
    """Prediction errors per joint, each of shape (nv,).

    Attributes:
        rms: Root mean square of measured − predicted, both filtered [torque unit].
        rms_raw: The same with the measured torque unfiltered [torque unit].
        nrmse: rms / standard deviation of the filtered measured torque.
        r2: 1 − nrmse².
    """

    rms: Array
    rms_raw: Array
    nrmse: Array
    r2: Array

    def entry(self, joint: int) -> dict[str, Any]:
        """Figures of one joint under their JSON names."""
        return {
            name: float(getattr(self, name)[joint]) for name in ("rms", "rms_raw", "nrmse", "r2")
        }


@dataclass(frozen=True, eq=False)
class Series:
    """Rows of the hold-out (or of the fit): time, measured torque filtered and raw.

    Attributes:
        t: Time; parts follow each other without gaps, shape (n,) [s].
        measured: Filtered torque, shape (n, nv) [torque unit].
        raw: Unfiltered torque at the same instants, shape (n, nv) [torque unit].
    """

    t: Array
    measured: Array
    raw: Array

    def accuracy(self, predicted: Array) -> Accuracy:
        """Accuracy of a prediction at these rows, shape (n, nv)."""
        rms = np.sqrt(np.mean((self.measured - predicted) ** 2, axis=0))
        raw = np.sqrt(np.mean((self.raw - predicted) ** 2, axis=0))
        spread = self.measured.std(axis=0)
        nrmse = np.divide(rms, spread, out=np.full_like(rms, np.nan), where=spread > 0)
        return Accuracy(*(read_only(v) for v in (rms, raw, nrmse, 1 - nrmse**2)))


def series(segments: Sequence[Segment]) -> Series:
    """Rows of all segments, one after the other."""
    times, start = [], 0.0
    for segment in segments:
        times.append(segment.t - segment.t[0] + start)
        start = times[-1][-1] + (segment.t[1] - segment.t[0])
    return Series(
        read_only(np.concatenate(times)),
        read_only(np.concatenate([s.tau[s.keep] for s in segments])),
        read_only(np.concatenate([s.tau_raw[s.keep] for s in segments])),
    )


def predicted_torque(robot: Robot, segments: Sequence[Segment]) -> Array:
    """Torque of the robot with its effects at the rows, filtered alike, shape (n, nv) [N·m]."""
    return np.concatenate([s.rows(lambda motion: torque(robot, motion)) for s in segments])


@dataclass(frozen=True, eq=False)
class PredictionInterval:
    """Where a new reading lies with 95 % probability, around the predicted torque.

    Attributes:
        parameters: Standard deviation of the predicted torque by that of the base parameters,
            shape (n, nv) [torque unit].
        noise: Standard deviation of the noise, shape (nv,) [torque unit].
        freedom: Degrees of freedom that the noise is known with, shape (nv,).
    """

    parameters: Array
    noise: Array
    freedom: Array

    def __post_init__(self) -> None:
        freeze(self, "parameters", "noise", "freedom")

    @property
    def std(self) -> Array:
        """Standard deviation of a new reading, shape (n, nv) [torque unit]."""
        return np.asarray(np.hypot(self.parameters, self.noise), float)

    @property
    def half_width(self) -> Array:
        """Half of the interval's width, shape (n, nv) [torque unit]."""
        quantile = scipy.stats.t.ppf(0.5 + LEVEL / 2, self.freedom)
        return np.asarray(quantile * self.std, float)


@dataclass(frozen=True, eq=False)
class Coverage:
    """Share of readings that lie in their intervals.

    Attributes:
        share: Shape (nv,).
        std: Its standard deviation by chance where 95 % do, readings in a row counted by how many
            are independent, shape (nv,).
    """

    share: Array
    std: Array

    def __post_init__(self) -> None:
        freeze(self, "share", "std")

    @property
    def too_few(self) -> Array:
        """Where chance does not explain how many lie outside, shape (nv,) of bool."""
        return np.asarray(self.share < LEVEL - _FAR - _CERTAIN * self.std, bool)


def torque_std(W: Array, covariance: Array) -> Array:
    """Standard deviation of the torque W β, shape (n, nv).

    Args:
        W: Columns of the base parameters, shape (n, nv, r).
        covariance: Of β, shape (r, r).
    """
    variance = np.einsum("njr,njr->nj", W @ covariance, W, optimize=True)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)), float)


def prediction_interval(
    W: Array, fit: LeastSquares, residual: Array, gains: Array | float = 1.0
) -> PredictionInterval:
    """95 % intervals of readings at new rows.

    Args:
        W: Columns of the base parameters at the new rows, shape (n, nv, r).
        fit: Their estimate.
        residual: Measured less predicted at the fitted rows, shape (m, nv) [torque unit].
        gains: Torque per reading, shape (nv,).
    """
    m, nv = residual.shape
    taken = fit.inflation * len(fit.beta) / (m * nv)
    variance = (residual**2).mean(axis=0) / (1 - np.minimum(taken, _MOST))
    freedom = np.array([independent_squares(e) for e in residual.T]) * (
        1 - np.minimum(taken, _MOST)
    )
    return PredictionInterval(
        torque_std(W, fit.covariance) / gains,
        np.sqrt(variance),
        np.maximum(freedom, _FEWEST),
    )


def independent_squares(residual: Array) -> float:
    """ν = n / (1 + 2 Σ ρ_k²): how many independent samples know the variance as well, (n,) → ν.

    Correlations that samples of white noise have by chance are left out.
    """
    n = len(residual)
    rho = autocorrelation(residual)[1:]
    chance = np.flatnonzero(np.abs(rho) < 2 / np.sqrt(n))
    end = int(chance[0]) if len(chance) else len(rho)
    return float(n / (1 + 2 * np.sum(rho[:end] ** 2)))


def coverage(measured: Array, predicted: Array, half_width: Array) -> Coverage:
    """How many readings lie within their intervals, all arrays of shape (n, nv)."""
    inside = (np.abs(measured - predicted) <= half_width).astype(float)
    independent = np.array([len(hits) / autocorrelation_time(hits) for hits in inside.T])
    return Coverage(inside.mean(axis=0), np.sqrt(LEVEL * (1 - LEVEL) / independent))
