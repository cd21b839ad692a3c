"""Accuracy of predicted torque: errors of one joint, chance of losses, intervals of readings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy

from excitant.identify.least_squares import (
    LeastSquares,
    autocorrelation,
    autocorrelation_time,
)
from excitant.identify.preprocessing import Segment, away_from_rest
from excitant.identify.signals import noise
from excitant.robots.motion import Array, Mask, Noun, read_only, root_mean_square

if TYPE_CHECKING:
    from excitant.identify.rows import Poses

LEVEL = 0.95  # share of readings that an interval is to hold
BLOCKS = 10  # of time, whose means are as good as independent
FEWEST_FREEDOM = 3.0  # degrees of freedom of the noise that are taken at least
LARGEST_SHARE = (
    0.5  # of the residual's variance that a fit is taken to have explained
)
COVERAGE_MARGIN = (
    0.02  # of the readings outside that are no shortcoming of the model
)
COVERAGE_STDS = 2.0  # standard deviations that chance is allowed beyond that

CHANCE_OF_LOSS = 0.01
"""Of a prediction as good as another that is taken for a worse one."""


@dataclass(frozen=True, eq=False)
class Accuracy(Noun):
    """Prediction errors per joint at rows where it moves, each of shape (nv,).

    Attributes:
        rms: Root mean square of measured − predicted, both filtered [torque unit].
        rms_raw: The same with the measured torque unfiltered [torque unit].
        nrmse: rms / standard deviation of the filtered measured torque.
        r2: 1 − nrmse².
        rms_all: rms over all rows, those of rest included, where dry friction holds any torque.
        judged: Share of the rows at which the joint moves.
    """

    rms: Array
    rms_raw: Array
    nrmse: Array
    r2: Array
    rms_all: Array
    judged: Array

    def entry(self, joint: int) -> dict[str, Any]:
        """Figures of one joint under their JSON names."""
        return {name: float(values[joint]) for name, values in vars(self).items()}

    def entries(self, joints: Sequence[str]) -> list[dict[str, Any]]:
        """Those of all joints, with their names."""
        return [{"name": name, **self.entry(j)} for j, name in enumerate(joints)]


@dataclass(frozen=True, eq=False)
class Series:
    """Rows of segments: by these, every error is judged.

    Attributes:
        t: Time without gaps, shape (n,) [s].
        measured: Filtered torque, shape (n, nv) [torque unit].
        raw: Unfiltered torque, shape (n, nv) [torque unit].
        moves: Rows that no rest of the joint affects, shape (n, nv).
        least: Standard deviation of the torque that shows more than friction, shape (nv,) [torque
            unit]; None where that is more than noise.
    """

    t: Array
    measured: Array
    raw: Array
    moves: Mask
    least: Array | None = None

    @cached_property
    def counts(self) -> Mask:
        """Rows at which an error counts: where the joint moves, all if it never does, (n, nv)."""
        return np.where(self.moves.any(axis=0), self.moves, True)

    def counted(self, values: Array) -> list[Array]:
        """Values of each joint, shape (n, nv), at its rows that count."""
        return [
            column[rows]
            for column, rows in zip(values.T, self.counts.T, strict=True)
        ]

    def in_motion(self, values: Array) -> Array:
        """Values at rows that count, shape (n, nv); NaN where the joint rests."""
        return read_only(np.where(self.counts, values, np.nan))

    def rms(self, error: Array) -> Array:
        """Root mean square of an error, (n, nv), of each joint, shape (nv,)."""
        return np.sqrt(np.mean(error**2, axis=0, where=self.counts))

    def accuracy(self, predicted: Array) -> Accuracy:
        """Accuracy of a prediction at these rows, shape (n, nv)."""
        error = self.measured - predicted
        rms = self.rms(error)
        nrmse = np.divide(
            rms, self.std, out=np.full_like(rms, np.nan), where=self._shown
        )
        return Accuracy(
            rms,
            self.rms(self.raw - predicted),
            nrmse,
            1 - nrmse**2,
            rms_all=root_mean_square(error),
            judged=self.moves.mean(axis=0),
        )

    @property
    def std(self) -> Array:
        """Standard deviation of the measured torque where it counts, shape (nv,)."""
        return self.measured.std(axis=0, where=self.counts)

    @property
    def _shown(self) -> Mask:
        return self.std > (0.0 if self.least is None else self.least)

    @cached_property
    def judged(self) -> Mask:
        """Joints that move here and whose torque varies by more than its noise, shape (nv,)."""
        least = self.least
        if least is None:
            least = np.array([noise(x) for x in self.raw.T])
        return self.moves.any(axis=0) & (self.std > least)

    def losses(self, predicted: Array, instead: Array) -> Array:
        """How much larger the squared error of one prediction is than that of another, (n, nv).

        Relative to the variance of the torque; 0 where an error does not count.
        """
        std = self.std
        scale = np.divide(1.0, std, out=np.zeros_like(std), where=self._shown)
        error = (self.measured - predicted) * scale
        other = (self.measured - instead) * scale
        return np.where(self.counts, error**2 - other**2, 0.0)


def chance_of_loss(losses: Array) -> float:
    """Chance of losses in a row, shape (n,), so large where there are none in the mean.

    Student's t of the means of ten blocks of time, in which errors that go on stay together.
    """
    if len(losses) < BLOCKS:
        return 1.0
    means = np.array([block.mean() for block in np.array_split(losses, BLOCKS)])
    error = means.std(ddof=1) / np.sqrt(BLOCKS)
    if not error > 0:
        return 1.0
    return float(scipy.special.stdtr(BLOCKS - 1, -means.mean() / error))


def series(segments: Sequence[Segment], poses: Poses | None = None) -> Series:
    """Rows of all segments, one after the other, and what torque shows where they are poses."""
    times = []
    start = 0.0
    for segment in segments:
        times.append(segment.t - segment.t[0] + start)
        start = times[-1][-1] + (segment.t[1] - segment.t[0])
    return Series(
        read_only(np.concatenate(times)),
        read_only(np.concatenate([s.tau[s.keep] for s in segments])),
        read_only(np.concatenate([s.tau_raw[s.keep] for s in segments])),
        away_from_rest(segments),
        poses and poses.least,
    )


class PredictionInterval(NamedTuple):
    """95 % prediction interval of a new reading, around the predicted torque.

    The torque W β̂ of a row has the variance w Σ wᵀ, Σ the covariance of the base parameters, which
    counts coloured noise. A new reading lies around it by that and by the noise of its joint, whose
    variance is that of the residuals, with what the fit took out of them given back. Coloured
    residuals know it from ν = n / Σ ρ_k² independent samples (Bartlett): quantiles are Student's.

    Attributes:
        parameters: Standard deviation of the predicted torque by parameters, shape (n, nv)
            [torque unit].
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
    def too_few(self) -> Mask:
        """Joints with more readings outside than by chance, shape (nv,) of bool."""
        least = LEVEL - COVERAGE_MARGIN - COVERAGE_STDS * self.std
        return self.share < least


def torque_std(W: Array, covariance: Array) -> Array:
    """Standard deviation of the torque W β by the covariance of β, shape (n, nv)."""
    variance = np.einsum("njr,njr->nj", W @ covariance, W, optimize=True)
    return np.sqrt(np.maximum(variance, 0.0))


def prediction_interval(
    W: Array,
    fit: LeastSquares,
    residuals: Sequence[Array],
    gains: Array | float = 1.0,
) -> PredictionInterval:
    """95 % intervals of readings at new rows of the base columns, shape (n, nv, r).

    The residual of each joint, (m_j,), is measured less predicted torque at its fitted rows.
    """
    rows = sum(map(len, residuals))
    explained = np.minimum(fit.inflation * len(fit.beta) / rows, LARGEST_SHARE)
    remaining = 1 - explained
    noise_std = np.sqrt(np.array([(e**2).mean() for e in residuals]) / remaining)
    freedom = np.array([independent_squares(e) for e in residuals]) * remaining
    parameters = torque_std(W, fit.covariance) / gains
    return PredictionInterval(
        parameters, noise_std, np.maximum(freedom, FEWEST_FREEDOM)
    )


def independent_squares(residual: Array) -> float:
    """ν = n / (1 + 2 Σ ρ_k²): how many independent samples know the variance as well, (n,) → ν.

    Correlations that samples of white noise have by chance are left out.
    """
    n = len(residual)
    rho = autocorrelation(residual)[1:]
    chance = np.flatnonzero(np.abs(rho) < 2 / np.sqrt(n))
    end = int(chance[0]) if len(chance) else len(rho)
    return n / (1 + 2 * np.sum(rho[:end] ** 2))


def coverage(inside: Sequence[Mask]) -> Coverage:
    """Share of readings within their intervals: whether each of a joint's is, one (n,) a joint."""
    hits = [joint.astype(float) for joint in inside]
    independent = np.array([len(hit) / autocorrelation_time(hit) for hit in hits])
    share = np.array([hit.mean() for hit in hits])
    return Coverage(share, np.sqrt(LEVEL * (1 - LEVEL) / independent))


def worse_joints(
    joints: Sequence[str], rows: Series, predicted: Array, other: Array
) -> list[str]:
    """Joints that another prediction suits better beyond chance, with both errors."""
    first = rows.accuracy(other).nrmse
    then = rows.accuracy(predicted).nrmse
    losses = rows.losses(predicted, other)
    return [
        f"{joint} (nrmse {first[j]:.3g} → {then[j]:.3g})"
        for j, joint in enumerate(joints)
        if chance_of_loss(losses[rows.counts[:, j], j])
        < CHANCE_OF_LOSS / len(joints)
    ]
