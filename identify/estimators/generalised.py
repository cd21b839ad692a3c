"""Generalised least squares: noise made white before the fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.signal

from excitant.identify.coloured_noise import autocovariance, autoregression
from excitant.identify.estimators.regression import Regression
from excitant.identify.least_squares import (
    LeastSquares,
    information,
    noise_of,
    traces,
    weighted_least_squares,
)
from excitant.robots.motion import Array

_ROUNDS = 3  # of estimating the noise; the second already has residuals of an efficient fit
_WHITE = 1e-2  # of the residual's power taken for white: bounds what whitening amplifies


def gls(problem: Regression) -> LeastSquares:
    """Weighted least squares of rows prewhitened by an autoregression of each joint's residual.

    With A_j(z) the autoregression that Akaike's criterion prefers, A_j W_j β ≈ A_j τ_j has white
    noise; residual and autoregression are estimated in turn (Cochrane and Orcutt 1949). Segments
    are whitened one by one and their first instants, whose past is unknown, left out; where all
    are too short for that, it is `wls`. The covariance is the one of weighted least squares of
    whitened rows, valid also where they are not quite white.

    It is efficient where torque noise is coloured. It trusts the frequencies where the residual
    is small: rows that were low-passed are amplified again near and above the cut-off, and with
    them what differentiation did to the columns there. A hundredth of the residual's power is
    taken for white to bound that; where differentiation is noisy it does not suffice. And slow
    misfit that is missing physics, not noise, counts for little here, so that torque may be
    predicted worse than by `wls`: compare them on the hold-out.

    Raises:
        RankDeficient: The motion does not show some columns.
    """
    W, tau = problem.W, problem.tau
    fit = weighted_least_squares(W, tau, problem.names)
    lags = _lags(problem)
    if lags == 0:
        return fit
    for _ in range(_ROUNDS):
        filters = _whiteners(problem, tau - W @ fit.beta, lags)
        whitened = _whitened(problem, W, filters)
        fit = weighted_least_squares(whitened, _whitened(problem, tau, filters), problem.names)
    residual = tau - W @ fit.beta
    sigma = noise_of(residual, len(fit.beta))
    white = information(whitened / (fit.sigma * np.sqrt(fit.inflation))[:, None])
    scale = np.sqrt(np.diag(fit.covariance))
    root = scale[:, None] * np.linalg.cholesky(fit.covariance / np.outer(scale, scale))
    told, plain = traces(white, root), traces(information(W / sigma[:, None]), root)
    inflation = np.divide(plain, told, out=np.ones(len(sigma)), where=told > 0)
    return LeastSquares(fit.beta, fit.covariance, sigma, np.maximum(inflation, 1.0))


def _lags(problem: Regression) -> int:
    """Largest order of an autoregression; the longest segment keeps most of its rows."""
    longest = max(int(part.stop - part.start) for part in problem.segments)
    return min(longest // 8, int(10 * np.log10(len(problem.tau))))


def _whiteners(problem: Regression, residual: Array, lags: int) -> list[Array]:
    """Polynomial A_j(z) of each joint; lags do not reach over the borders of segments."""
    n = len(residual)
    parts = [residual[part] for part in problem.segments if part.stop - part.start > lags]
    gamma = sum((autocovariance(part, lags) * len(part) / n for part in parts), np.zeros(1))
    corrected = gamma * np.where(np.arange(lags + 1) == 0, 1 + _WHITE, 1.0)[:, None]
    return [autoregression(own, n)[0] if own[0] > 0 else np.ones(1) for own in corrected.T]


def _whitened(problem: Regression, values: Array, filters: Sequence[Array]) -> Array:
    """A_j(z) on rows of each joint within each segment, shape (n, nv, ...) → (fewer, nv, ...)."""
    past = max(len(a) for a in filters) - 1
    parts = [values[part] for part in problem.segments if part.stop - part.start > past]
    return np.concatenate(
        [
            np.stack(
                [
                    scipy.signal.lfilter(a, np.ones(1), part[:, j], axis=0)
                    for j, a in enumerate(filters)
                ],
                axis=1,
            )[past:]
            for part in parts
        ]
    )
