"""Instrumental variables, and a test of whether they are needed."""

from __future__ import annotations

import numpy as np
import scipy.linalg
import scipy.stats

from excitant.exceptions import BadInput
from excitant.identify.estimators.regression import Regression
from excitant.identify.least_squares import (
    Factor,
    LeastSquares,
    factorised,
    noise_of,
    weighted_least_squares,
    with_covariance,
)
from excitant.robots.motion import Array

_ROUNDS = 3  # of re-estimating the noise of each joint
_SAME = 1e-6  # of a column's length: smaller errors are those of interpolation


def iv(problem: Regression) -> LeastSquares:
    """Two-stage least squares: W projected on the instruments Z, then fitted to the torque.

    Least squares is biased where W has errors, because WᵀW contains their squares. Instruments
    have errors independent of those of W and of the torque, so that Zᵀ(τ − W β) = 0 has no such
    term. Janot, Vandanjon, Gautier (2014) simulate the closed loop for them; here they are
    columns on a reference motion or on other samples of the same motion
    (`excitant.identify.estimators.halves`). For as many instruments as columns the estimate is
    (ZᵀW)⁻¹ Zᵀτ, rows weighted by the noise of their joint. Variance is larger than that of least
    squares; weak instruments leave bias. Columns that are no linear functions of the noise (signs
    of velocities) keep part of theirs.

    Raises:
        BadInput: No instruments.
        RankDeficient: Columns, or instruments, that the motion does not show.
    """
    W, tau, Z = problem.W, problem.tau, problem.Z
    sigma = weighted_least_squares(W, tau, problem.names).sigma
    for _ in range(_ROUNDS):
        stage = _first_stage(Z, sigma, problem.names)
        factor = factorised(stage.projected(W), sigma, problem.names)
        beta = factor.solve(tau)
        residual = tau - W @ beta
        sigma = noise_of(residual, len(beta))
    return with_covariance(factor, beta, residual, sigma)


def _first_stage(Z: Array, sigma: Array, names: tuple[str, ...]) -> Factor:
    k = Z.shape[2]
    labels = names if k == len(names) else tuple(f"instrument {i + 1}" for i in range(k))
    return factorised(Z, sigma, labels)


def errors_in_variables(W: Array, tau: Array, instruments: Array) -> tuple[float, float]:
    """Test whether errors of W move with those of the torque.

    Durbin (1954), Wu (1973), Hausman (1978), as a regression with the errors added.
    V is the part of W that instruments do not explain. Without errors in W that matter, V has no
    coefficient of its own in τ ≈ W β + V γ. The statistic γ̂ᵀ C⁻¹ γ̂, C the covariance of γ̂ under
    coloured noise, is then χ² with as many degrees of freedom as V has independent columns. A
    small p says that least squares is biased, by noise in the motion or by its filter (perhaps by
    little: compare the estimates); a model that lacks physics leaves p large, unless what it lacks
    moves with V.

    Args:
        W: Columns of the base parameters, shape (n, nv, r).
        tau: Torque, shape (n, nv).
        instruments: Columns with errors independent of W's, shape (n, nv, k), k ≥ r.

    Returns:
        Statistic, and p, the chance of one as large where least squares is not biased.

    Raises:
        BadInput: Instruments that explain W entirely leave nothing to test.
        RankDeficient: Columns, or instruments, that the motion does not show.
    """
    r = W.shape[2]
    names = tuple(f"column {k + 1}" for k in range(r))
    problem = Regression(W, tau, names, instruments=instruments)
    sigma = weighted_least_squares(W, tau, names).sigma
    stage = _first_stage(problem.Z, sigma, names)
    V = _independent(W - stage.projected(W), W, sigma)
    added = tuple(f"error {k + 1}" for k in range(V.shape[2]))
    fit = weighted_least_squares(np.concatenate([W, V], axis=2), tau, (*names, *added))
    gamma, C = fit.beta[r:], fit.covariance[r:, r:]
    statistic = float(gamma @ scipy.linalg.solve(C, gamma, assume_a="pos"))
    return statistic, float(scipy.stats.chi2.sf(statistic, len(gamma)))


def _independent(V: Array, W: Array, sigma: Array) -> Array:
    """Orthogonal columns, rows unweighted, that span those of V that are more than rounding."""
    lengths = np.linalg.norm(W / sigma[:, None], axis=(0, 1))
    flat = (V / sigma[:, None] / lengths).reshape(-1, V.shape[2])
    U, s, _ = scipy.linalg.svd(flat, full_matrices=False)
    keep = s > _SAME
    if not keep.any():
        raise BadInput(
            "the instruments explain the columns entirely, so nothing is left to test; "
            "give instruments with errors of their own"
        )
    return np.asarray(U[:, keep].reshape(*V.shape[:2], -1) * sigma[:, None], float)
