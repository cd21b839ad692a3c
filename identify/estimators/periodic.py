"""Maximum likelihood of averaged periods, and what the model lacks beside the noise between them.

Swevers, Ganseman, Tükel, De Schutter and Van Brussel (1997): periods are averaged, the averaged
motion is differentiated as a Fourier series, and torque is weighted with the covariance of its
noise, which the differences between periods show. Olsen, Swevers and Verdonck (2002) add the
noise of the positions to that covariance: here as the torque that the model needs for what each
period's own motion differs from the average, so that motion which does not quite repeat is no
torque noise either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import scipy.ndimage
import scipy.stats

from excitant.exceptions import BadInput
from excitant.identify.estimators.maximum_likelihood import ml
from excitant.identify.estimators.ordinary import wls
from excitant.identify.estimators.regression import Regression
from excitant.identify.estimators.unfiltered import unfiltered_positions, with_recordings
from excitant.identify.least_squares import (
    SMALLEST,
    LeastSquares,
    autocorrelation_time,
    factorised,
)
from excitant.identify.periods import Periods, between_covariance, periods_of
from excitant.identify.preprocessing import Segment
from excitant.identify.recording import Recording
from excitant.identify.rows import FitRows
from excitant.robots.motion import Array, Motion, freeze
from excitant.robots.robot import Robot
from excitant.robots.torque import observation_columns

_REST = 3.0  # standard deviations of the velocity, below which its sign is not known
_TILES = 3  # periods that a filter sees for one: it has forgotten where they began


@dataclass(frozen=True, eq=False)
class LackOfFit:
    """Residual of the averaged torque against the noise that averaging left.

    Attributes:
        ratio: Residual variance over noise variance between periods / number of periods, corrected
            for what the fit explains of the noise, shape (nv,). About 1 where nothing is missing.
        p: Chance of a ratio as large where nothing is missing, shape (nv,).
        residual: Standard deviation of the residual of the averaged torque, shape (nv,) [N·m].
        noise: Standard deviation of the noise left in it, shape (nv,) [N·m].
    """

    ratio: Array
    p: Array
    residual: Array
    noise: Array

    def __post_init__(self) -> None:
        freeze(self, "ratio", "p", "residual", "noise")


@dataclass(frozen=True, eq=False)
class AveragedRows:
    """Rows of averaged periods.

    Attributes:
        problem: Columns on the averaged motion, averaged torque, and its noise per segment.
        periods: What was averaged, one per segment.
        independent: Independent samples of noise in one period, shape (segments, nv).
    """

    problem: Regression
    periods: tuple[Periods, ...]
    independent: Array

    def __post_init__(self) -> None:
        freeze(self, "independent")

    @property
    def noise(self) -> Array:
        """Covariance of the averaged torque's noise, shape (segments, nv, nv) [(N·m)²]."""
        if self.problem.noise is None:
            raise BadInput("averaged rows: give their problem the noise between periods")
        return self.problem.noise


@dataclass(frozen=True, eq=False)
class MaximumLikelihood:
    """Maximum-likelihood estimate of averaged periods.

    Attributes:
        fit: The estimate; its noise is that of the residual of the averaged torque.
        rows: What was fitted.
        lack_of_fit: Whether the model explains the average to within its noise.
    """

    fit: LeastSquares
    rows: AveragedRows
    lack_of_fit: LackOfFit


def maximum_likelihood(
    robot: Robot,
    rows: FitRows,
    recordings: Sequence[Recording],
    *,
    position_noise: bool = True,
) -> MaximumLikelihood:
    """Average the periods of every segment, and fit them weighted with the noise between them.

    Args:
        robot: The arm.
        rows: What is fitted; its effects, base parameters, filter and gains are used.
        recordings: Behind these rows, in order.
        position_noise: Whether the noise is that of torque less what the model needs for each
            period's own motion (Olsen), or of torque alone (Swevers).

    Raises:
        BadRecording: A motion that does not repeat.
        RankDeficient: The motion does not show some columns.
    """
    averaged = averaged_rows(robot, rows, recordings, position_noise=position_noise)
    fit = ml(averaged.problem)
    return MaximumLikelihood(fit, averaged, lack_of_fit(averaged, fit.beta))


def averaged_rows(
    robot: Robot,
    rows: FitRows,
    recordings: Sequence[Recording],
    *,
    position_noise: bool = True,
) -> AveragedRows:
    """Rows of averaged periods with their noise; see `maximum_likelihood`."""
    pairs = []
    for segment, recording in with_recordings(rows.data.to_fit, recordings):
        q, tau = unfiltered_positions(segment, recording), segment.tau_raw * rows.gains
        periods = periods_of(segment.motion.t, q, tau, recording.name, recording.file)
        pairs.append((segment, periods))
    parts = [_average(robot, rows, *pair) for pair in pairs]
    starts = np.cumsum([0, *(len(tau) for _, tau in parts[:-1])])
    problem = Regression(
        np.concatenate([W for W, _ in parts]),
        np.concatenate([tau for _, tau in parts]),
        rows.base.expressions,
        tuple(int(start) for start in starts),
    )
    beta = wls(problem).beta if position_noise else None
    noise, independent = [], []
    for segment, periods in pairs:
        deviations = _deviations(robot, rows, segment, periods, beta)
        noise.append(between_covariance(deviations) / periods.count)
        flat, n = deviations.reshape(-1, robot.nv).T, len(periods.t)
        independent.append([max(n / autocorrelation_time(own), 2.0) for own in flat])
    problem = replace(problem, noise=np.array(noise))
    return AveragedRows(problem, tuple(periods for _, periods in pairs), np.array(independent))


def _average(
    robot: Robot, rows: FitRows, segment: Segment, periods: Periods
) -> tuple[Array, Array]:
    """Filtered and decimated columns and torque of the average of one segment's periods."""
    thin, motion = segment.keep.step or 1, periods.motion()
    moving = ~_at_rest(segment, periods, motion)[::thin]
    W = _circular(segment, _columns(robot, rows, motion))[::thin]
    tau = _circular(segment, periods.mean_tau)[::thin]
    return W * moving[:, :, None], tau * moving


def _columns(robot: Robot, rows: FitRows, motion: Motion) -> Array:
    return observation_columns(robot, rows.effects, motion)[:, :, list(rows.base.columns)]


def _circular(segment: Segment, values: Array) -> Array:
    """Columns of one period through the filter of a segment, as if they repeated for ever."""
    n = len(values)
    tiled = np.tile(values, (_TILES, *(1,) * (values.ndim - 1)))
    first = _TILES // 2 * n
    return _passed(segment, tiled)[first : first + n]


def _passed(segment: Segment, values: Array) -> Array:
    """Columns of any number of instants through the filter of a segment, all rows counting."""
    return replace(segment, silent=None).filtered(values)


def _at_rest(segment: Segment, periods: Periods, motion: Motion) -> npt.NDArray[np.bool_]:
    """Instants whose row of a joint hangs on a sign that is not known, shape (n, nv).

    Where a joint's velocity stays within its noise for longer than a fifth of the filter's time
    constant, with what the filter makes of these instants. A reversal is shorter.
    """
    constant = segment.rate_hz / float(np.min(segment.cutoff_hz))
    short, reach = max(1, round(0.2 * constant)), 2 * round(constant) + 1
    still = (np.abs(motion.dq) <= _REST * periods.dq_noise).astype(float)
    still = scipy.ndimage.minimum_filter1d(still, short, axis=0, mode="wrap")
    return np.asarray(scipy.ndimage.maximum_filter1d(still, reach, axis=0, mode="wrap") > 0)


def _deviations(
    robot: Robot, rows: FitRows, segment: Segment, periods: Periods, beta: Array | None
) -> Array:
    """Filtered torque of each period less that of the mean one, shape (periods, n, nv) [N·m]."""
    tau = np.array(periods.tau)
    if beta is not None:
        for k in range(periods.count):
            tau[k] -= _columns(robot, rows, periods.motion(k)) @ beta
    deviations = tau - tau.mean(axis=0)
    flat = deviations.reshape(-1, robot.nv)
    return _passed(segment, flat).reshape(deviations.shape)


def lack_of_fit(averaged: AveragedRows, beta: Array) -> LackOfFit:
    """F-test of the residual of averaged rows against the noise between periods.

    Its numerator has as many degrees of freedom as there are independent samples of noise in a
    period, less those that the fit takes; its denominator the periods less one times as many.
    Independent samples are counted by the integrated autocorrelation time of the filtered noise.

    Args:
        averaged: What was fitted.
        beta: Base parameters, shape (r,).
    """
    problem, segments = averaged.problem, averaged.problem.segments
    variance = np.diagonal(averaged.noise, axis1=1, axis2=2)
    variance = np.maximum(variance, SMALLEST**2)
    residual = problem.tau - problem.W @ beta
    moving = (problem.W != 0).any(axis=2)
    share = np.array([moving[part].mean(axis=0) for part in segments])
    own = np.array([(residual[part] ** 2).mean(axis=0) for part in segments])
    own = np.divide(own, share, out=np.zeros_like(own), where=share > 0)
    independent = np.maximum(averaged.independent * share, 1e-6)
    total = independent.sum(axis=0)
    pooled = (independent * variance).sum(axis=0) / total
    factor = factorised(problem.W, np.sqrt(pooled), problem.names)
    taken = (factor.Q.reshape(*problem.tau.shape, -1) ** 2).sum(axis=(0, 2))
    freedom = np.maximum(total - taken, 1.0)
    ratio = (independent * own / variance).sum(axis=0) / freedom
    repeats = np.array([periods.count - 1 for periods in averaged.periods])
    p = scipy.stats.f.sf(ratio, freedom, (repeats[:, None] * independent).sum(axis=0))
    left = (independent * own).sum(axis=0) / total
    return LackOfFit(ratio, p, np.sqrt(left), np.sqrt(pooled))
