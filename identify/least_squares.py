"""Weighted least squares on base parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.stats

from excitant.exceptions import RankDeficient
from excitant.identify.coloured_noise import score_covariances
from excitant.robots.motion import Array, freeze

_ROUNDS = 4  # of re-estimating the noise of each joint; the weights settle in two or three


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """Weighted least-squares estimate.

    Attributes:
        beta: Estimate, shape (r,).
        covariance: Its covariance, for noise as coloured as the residual, shape (r, r).
        sigma: Standard deviation of each joint's residual, shape (nv,) [torque unit].
        inflation: Rows of each joint that count as one independent row, at least 1, (nv,).
    """

    beta: Array
    covariance: Array
    sigma: Array
    inflation: Array

    def __post_init__(self) -> None:
        freeze(self, "beta", "covariance", "sigma", "inflation")


def weighted_least_squares(W: Array, tau: Array, names: tuple[str, ...]) -> LeastSquares:
    """Solve τ ≈ W β with one noise level per joint, estimated along the way.

    The covariance is A⁻¹ Ω A⁻¹ with A the information of rows taken for independent and Ω the
    covariance of the scores Wᵀε under coloured noise (`excitant.identify.coloured_noise`), so
    that slow structure in the residual does not count as many independent samples. It is widened by
    Student's t for the samples that the noise is known from, so that ± 1.96 standard deviations are
    a 95 % interval. Inflation is
    tr(A⁻¹ Ω_j) / tr(A⁻¹ A_j), the mean of that effect over what joint j's rows determine.

    Args:
        W: Columns of the base parameters, shape (n, nv, r).
        tau: Torque, shape (n, nv).
        names: What the columns stand for, for messages.

    Raises:
        RankDeficient: The motion does not show some columns.
    """
    n, nv, r = W.shape
    sigma = np.maximum(tau.std(axis=0), 1e-12)
    for _ in range(_ROUNDS):
        used, weighted = sigma, W / sigma[:, None]
        norms = np.linalg.norm(weighted, axis=(0, 1))
        _refuse_silent(norms, names)
        weighted /= norms
        Q, R = scipy.linalg.qr(weighted.reshape(-1, r), mode="economic")
        _refuse_rank_deficient(R, names)
        beta = scipy.linalg.solve_triangular(R, Q.T @ (tau / sigma).ravel()) / norms
        residual = tau - W @ beta
        dof = n * nv / max(n * nv - r, 1)
        sigma = np.sqrt(np.maximum((residual**2).mean(axis=0) * dof, 1e-24))
    inverse = scipy.linalg.solve_triangular(R, np.eye(r))
    scores, freedom = score_covariances(weighted, residual / used, inverse @ inverse.T)
    root = inverse / norms[:, None]
    parts = np.array([root @ (inverse.T @ each @ inverse) @ root.T for each in scores])
    widths = _widths(np.diagonal(parts, axis1=1, axis2=2), freedom)
    covariance = parts.sum(axis=0) * np.outer(widths, widths)
    information = np.einsum("njr,njs->jrs", weighted, weighted, optimize=True)
    effect, plain = (_traces(matrices, inverse) for matrices in (scores, information))
    inflation = np.maximum(np.divide(effect, plain, out=np.ones(nv), where=plain > 0), 1.0)
    return LeastSquares(beta, covariance, sigma, inflation)


def _widths(variances: Array, freedom: Array) -> Array:
    """Student's over normal 97.5 % quantile of each parameter, shape (r,).

    Degrees of freedom of a sum of variances by Satterthwaite (1946).

    Args:
        variances: Part of each parameter's variance from each joint's noise, shape (nv, r).
        freedom: Degrees of freedom of each joint, shape (nv,).
    """
    total, spread = variances.sum(axis=0), (variances**2 / freedom[:, None]).sum(axis=0)
    nu = np.divide(total**2, spread, out=np.full(len(total), np.inf), where=spread > 0)
    return student_width(nu)


def student_width(freedom: Array | float) -> Array:
    """Student's over normal 97.5 % quantile, for degrees of freedom of any shape."""
    return np.asarray(scipy.stats.t.ppf(0.975, freedom) / scipy.stats.norm.ppf(0.975), float)


def _traces(matrices: Array, inverse: Array) -> Array:
    """tr(A⁻¹ M_j) of each M_j, shape (nv,), with A⁻¹ = inverse · inverseᵀ."""
    return np.asarray(np.einsum("ra,jrs,sa->j", inverse, matrices, inverse, optimize=True), float)


_UNDETERMINED = (
    "this motion does not determine these parameters (move the joints that show them, "
    "or design an excitation)"
)


def _refuse_silent(norms: Array, names: tuple[str, ...]) -> None:
    silent = norms <= 1e-10 * norms.max()
    if silent.any():
        raise RankDeficient([names[k] for k in np.flatnonzero(silent)], _UNDETERMINED)


def _refuse_rank_deficient(R: Array, names: tuple[str, ...]) -> None:
    _, s, Vt = np.linalg.svd(R)
    if len(s) < len(names) or s[-1] < 1e-9 * s[0]:
        weak = np.flatnonzero(np.abs(Vt[-1]) > 0.1)
        raise RankDeficient([names[k] for k in weak], _UNDETERMINED)


def autocorrelation_time(residual: Array) -> float:
    """Integrated autocorrelation time 1 + 2 Σ ρ_k, summed to the first non-positive ρ_k."""
    centred = residual - residual.mean()
    size = len(centred)
    spectrum = np.abs(np.fft.rfft(centred, 2 * size)) ** 2
    correlation = np.fft.irfft(spectrum)[: size // 3]
    if correlation[0] <= 0:
        return 1.0
    rho = correlation / correlation[0]
    end = int(np.argmax(rho <= 0)) if (rho <= 0).any() else len(rho)
    return float(max(1.0, 1 + 2 * rho[1:end].sum()))
