"""Ordinary and weighted least squares."""

from __future__ import annotations

import numpy as np

from excitant.identify.estimators.regression import Regression
from excitant.identify.least_squares import (
    LeastSquares,
    factorised,
    noise_of,
    weighted_least_squares,
    with_covariance,
)


def ols(problem: Regression) -> LeastSquares:
    """Ordinary least squares: minimise Σ (τ − W β)² with all joints alike (Gauss 1809).

    A joint of large torque noise spoils the parameters of the others; `wls` weighs them. The
    covariance is valid for joints of different and coloured noise.

    Raises:
        RankDeficient: The motion does not show some columns.
    """
    ones = np.ones(problem.tau.shape[1])
    factor = factorised(problem.W, ones, problem.names)
    beta = factor.solve(problem.tau)
    residual = problem.tau - problem.W @ beta
    return with_covariance(factor, beta, residual, noise_of(residual, len(beta)))


def wls(problem: Regression) -> LeastSquares:
    """Weighted least squares, one noise level per joint (Gautier 1997; Swevers et al. 1997).

    See `excitant.identify.least_squares.weighted_least_squares`.

    Raises:
        RankDeficient: The motion does not show some columns.
    """
    return weighted_least_squares(problem.W, problem.tau, problem.names)
