"""Accuracy of predicted torque: errors of one joint, chance of losses, intervals of readings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy

from excitant.identify.least_squares import (
    LeastSquares,
    autocorrelation,
    autocorrelation_time,
)
from excitant.identify.preprocessing import Mask, Segment, away_from_rest
from excitant.identify.smoother import noise
from excitant.robots.motion import Array, read_only

LEVEL = 0.95  # share of readings that an interval is to hold
_BLOCKS = 10  # of time, whose means are as good as independent
_FEWEST = 3.0  # degrees of freedom, below which no noise is known
_MOST = 0.5  # of the residual's variance that is given back
_FAR = 0.02
_CERTAIN = 2.0  # share of samples and standard deviations that chance is allowed


@dataclass(frozen=True, eq=False)
class Accuracy:
    """Prediction errors per joint at rows where it moves, each of shape (nv,).

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
        return {name: float(values[joint]) for name, values in vars(self).items()}


@dataclass(frozen=True, eq=False)
class Series:
    """Rows of segments: by these, every error is judged.

    Attributes:
        t: Time without gaps, shape (n,) [s].
        measured: Filtered torque, shape (n, nv) [torque unit].
        raw: Unfiltered torque, shape (n, nv) [torque unit].
        moves: Rows that no rest of the joint affects, shape (n, nv).
    """

    t: Array
    measured: Array
    raw: Array
    moves: Mask

    @cached_property
    def counts(self) -> Mask:
        """Rows at which an error counts: where the joint moves, all if it never does, (n, nv)."""
        return np.where(self.moves.any(axis=0), self.moves, True)

    def counted(self, values: Array) -> list[Array]:
        """Values of each joint, shape (n, nv), at its rows that count."""
        return [
            column[rows] for column, rows in zip(values.T, self.counts.T, strict=True)
        ]

    def in_motion(self, values: Array) -> Array:
        """Values at rows that count, shape (n, nv); NaN where the joint rests."""
        return read_only(np.where(self.counts, values, np.nan))

    def rms(self, error: Array) -> Array:
        """Root mean square of an error, (n, nv), of each joint, shape (nv,)."""
        return np.asarray(np.sqrt(np.mean(error**2, axis=0, where=self.counts)), float)

    def accuracy(self, predicted: Array) -> Accuracy:
        """Accuracy of a prediction at these rows, shape (n, nv)."""
        rms = self.rms(self.measured - predicted)
        raw = self.rms(self.raw - predicted)
        spread = self.measured.std(axis=0, where=self.counts)
        nrmse = np.divide(rms, spread, out=np.full_like(rms, np.nan), where=spread > 0)
        return Accuracy(*map(read_only, (rms, raw, nrmse, 1 - nrmse**2)))

    @cached_property
    def judged(self) -> Mask:
        """Joints that move here and whose torque varies by more than its noise, shape (nv,)."""
        spread = self.measured.std(axis=0, where=self.counts)
        return np.asarray(
            self.moves.any(axis=0) & (spread > [noise(x) for x in self.raw.T])
        )

    def losses(self, predicted: Array, instead: Array) -> Array:
        """How much larger the squared error of one prediction is than that of another, (n, nv).

        Relative to the variance of the torque; 0 where an error does not count.
        """
        spread = self.measured.std(axis=0, where=self.counts)
        scale = np.divide(1.0, spread, out=np.zeros_like(spread), where=spread > 0)
        first, second = ((self.measured - x) * scale for x in (predicted, instead))
        return np.asarray(np.where(self.counts, first**2 - second**2, 0.0))


def chance_of_loss(losses: Array) -> float:
    """Chance of losses in a row, shape (n,), so large where there are none in the mean.

    Student's t of the means of ten blocks of time, in which errors that go on stay together.
    """
    means = np.array(
        [block.mean() for block in np.array_split(losses, _BLOCKS) if len(block)]
    )
    error = means.std(ddof=1) / np.sqrt(len(means)) if len(means) == _BLOCKS else 0.0
    if not error > 0:
        return 1.0
    return float(scipy.special.stdtr(len(means) - 1, -means.mean() / error))


def series(segments: Sequence[Segment]) -> Series:
    """Rows of all segments, one after the other."""
    times = []
    start = 0.0
    for segment in segments:
        times.append(segment.t - segment.t[0] + start)
        start = times[-1][-1] + (segment.t[1] - segment.t[0])
    torques = ([s.tau[s.keep] for s in segments], [s.tau_raw[s.keep] for s in segments])
    t, measured, raw = (read_only(np.concatenate(parts)) for parts in (times, *torques))
    return Series(t, measured, raw, away_from_rest(segments))


class PredictionInterval(NamedTuple):
    """95 % prediction interval of a new reading, around the predicted torque.

    The torque W β̂ of a row has the variance w Σ wᵀ, Σ the covariance of the base parameters, which
    counts coloured noise. A new reading lies around it by that and by the noise of its joint, whose
    variance is that of the residuals, with what the fit took out of them given back. Coloured
    residuals know it from ν = n / Σ ρ_k² independent samples (Bartlett): quantiles are Student's.

    Attributes:
        parameters: Standard deviation of the predicted torque by parameters, and by lengths where
            these may be off, shape (n, nv) [torque unit].
        noise: Standard deviation of the noise, shape (nv,) [torque unit].
        freedom: Degrees of freedom that the noise is known with, shape (nv,).
    """

    parameters: Array
    noise: Array
    freedom: Array

    @property
    def half_width(self) -> Array:
        """Half of the interval's width, shape (n, nv) [torque unit]."""
        quantile = scipy.special.stdtrit(self.freedom, 0.5 + LEVEL / 2)
        return np.asarray(quantile * np.hypot(self.parameters, self.noise), float)


class Coverage(NamedTuple):
    """Share of readings that lie in their intervals, each array of shape (nv,).

    The standard deviation is that by chance where 95 % do, readings in a row counted by how many
    are independent.
    """

    share: Array
    std: Array

    @property
    def too_few(self) -> Array:
        """Joints with more readings outside than by chance, shape (nv,) of bool."""
        return np.asarray(self.share < LEVEL - _FAR - _CERTAIN * self.std, bool)


def torque_std(W: Array, covariance: Array) -> Array:
    """Standard deviation of the torque W β by the covariance of β, shape (n, nv)."""
    variance = np.einsum("njr,njr->nj", W @ covariance, W, optimize=True)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)), float)


def prediction_interval(
    W: Array,
    fit: LeastSquares,
    residuals: Sequence[Array],
    gains: Array | float = 1.0,
    covariance: Array | None = None,
) -> PredictionInterval:
    """95 % intervals of readings at new rows of the base columns, shape (n, nv, r).

    The residual of each joint, (m_j,), is measured less predicted torque at its fitted rows. The
    covariance is that of the fit, or of what W has columns of.
    """
    size = sum(map(len, residuals))
    left = 1 - np.minimum(fit.inflation * len(fit.beta) / size, _MOST)
    noise = np.sqrt(np.array([(e**2).mean() for e in residuals]) / left)
    freedom = np.array([independent_squares(e) for e in residuals]) * left
    parameters = (
        torque_std(W, fit.covariance if covariance is None else covariance) / gains
    )
    return PredictionInterval(parameters, noise, np.maximum(freedom, _FEWEST))


def independent_squares(residual: Array) -> float:
    """ν = n / (1 + 2 Σ ρ_k²): how many independent samples know the variance as well, (n,) → ν.

    Correlations that samples of white noise have by chance are left out.
    """
    n = len(residual)
    rho = autocorrelation(residual)[1:]
    chance = np.flatnonzero(np.abs(rho) < 2 / np.sqrt(n))
    end = int(chance[0]) if len(chance) else len(rho)
    return float(n / (1 + 2 * np.sum(rho[:end] ** 2)))


def coverage(inside: Sequence[Mask]) -> Coverage:
    """Share of readings within their intervals: whether each of a joint's is, one (n,) a joint."""
    hits = [each.astype(float) for each in inside]
    independent = np.array([len(each) / autocorrelation_time(each) for each in hits])
    share = np.array([each.mean() for each in hits])
    return Coverage(share, np.sqrt(LEVEL * (1 - LEVEL) / independent))
