"""Maximum likelihood: joints weighted with the covariance of their noise."""

from __future__ import annotations

import numpy as np
import scipy.linalg

from excitant.identify.estimators.regression import Regression
from excitant.identify.least_squares import (
    LeastSquares,
    factorised,
    noise_of,
    weighted_least_squares,
    with_covariance,
)
from excitant.robots.motion import Array

_ROUNDS = 4  # of re-estimating the covariance where only the residual shows it
_SHRINK = 1e-3  # of the correlations, so that a covariance from few samples can be inverted
_SILENT = 1e-9  # of a joint's rms torque: noise taken for none


def ml(problem: Regression) -> LeastSquares:
    """Gaussian maximum likelihood of torque whose noise joints share.

    Minimises Σ_t e(t)ᵀ Σ⁻¹ e(t), e = τ − W β, with the covariance Σ of the noise of the joints at
    one instant: known per segment from the differences between periods (Swevers, Ganseman, Tükel,
    De Schutter, Van Brussel 1997; `excitant.identify.periodic`), or else that of the residual,
    in turn with β, which is maximum likelihood of both. The covariance of β is valid for noise
    coloured in time and for what the model lacks; `wls` is the case of a diagonal Σ.

    Raises:
        RankDeficient: The motion does not show some columns.
    """
    W, tau = problem.W, problem.tau
    beta = weighted_least_squares(W, tau, problem.names).beta
    for _ in range(1 if problem.noise is not None else _ROUNDS):
        residual = tau - W @ beta
        roots = _roots(problem, residual)
        white = _whitened(problem, W, roots)
        factor = factorised(white, np.ones(tau.shape[1]), problem.names)
        beta = factor.solve(_whitened(problem, tau[:, :, None], roots)[:, :, 0])
    residual = tau - W @ beta
    error = _whitened(problem, residual[:, :, None], roots)[:, :, 0]
    fit = with_covariance(factor, beta, error, noise_of(error, len(beta)))
    return LeastSquares(beta, fit.covariance, noise_of(residual, len(beta)), fit.inflation)


def _roots(problem: Regression, residual: Array) -> list[Array]:
    """Cholesky factor of the covariance of each segment's noise."""
    if problem.noise is not None:
        covariances = list(problem.noise)
    else:
        covariances = [residual.T @ residual / len(residual)] * len(problem.segments)
    smallest = _SILENT * np.sqrt((problem.tau**2).mean(axis=0))
    smallest = np.maximum(smallest, np.finfo(float).tiny ** 0.25)
    return [_root(covariance, smallest) for covariance in covariances]


def _root(covariance: Array, smallest: Array) -> Array:
    std = np.maximum(np.sqrt(np.diag(covariance)), smallest)
    correlation = (1 - _SHRINK) * covariance / np.outer(std, std)
    np.fill_diagonal(correlation, 1.0)
    return np.asarray(std[:, None] * np.linalg.cholesky(correlation), float)


def _whitened(problem: Regression, values: Array, roots: list[Array]) -> Array:
    """L⁻¹ v at every instant, shape (n, nv, k) → (n, nv, k)."""
    found = np.empty_like(values)
    for part, root in zip(problem.segments, roots, strict=True):
        inverse = scipy.linalg.solve_triangular(root, np.eye(len(root)), lower=True)
        found[part] = np.einsum("ij,tjk->tik", inverse, values[part])
    return found
