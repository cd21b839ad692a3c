"""Weighted least squares on base parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from excitant.exceptions import RankDeficient
from excitant.robots.motion import Array, freeze

_ROUNDS = 4  # of re-estimating the noise of each joint; the weights settle in two or three


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """Weighted least-squares estimate.

    Attributes:
        beta: Estimate, shape (r,).
        covariance: Its covariance, inflated for autocorrelated residuals, shape (r, r).
        sigma: Standard deviation of each joint's residual, shape (nv,) [torque unit].
        inflation: Integrated autocorrelation time of each joint's residual [rows], shape (nv,).
    """

    beta: Array
    covariance: Array
    sigma: Array
    inflation: Array

    def __post_init__(self) -> None:
        freeze(self, "beta", "covariance", "sigma", "inflation")


def weighted_least_squares(W: Array, tau: Array, names: tuple[str, ...]) -> LeastSquares:
    """Solve τ ≈ W β with one noise level per joint, estimated along the way.

    The covariance is A⁻¹ (Σ_j k_j A_j) A⁻¹ with A_j the information of joint j's rows and
    k_j the integrated autocorrelation time of its residual, so that slow structure in the
    residual does not count as many independent samples.

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
        weighted = (W / sigma[:, None]).reshape(-1, r)
        norms = np.linalg.norm(weighted, axis=0)
        _refuse_silent(norms, names)
        Q, R = scipy.linalg.qr(weighted / norms, mode="economic")
        _refuse_rank_deficient(R, names)
        beta = scipy.linalg.solve_triangular(R, Q.T @ (tau / sigma).ravel()) / norms
        residual = tau - W @ beta
        dof = n * nv / max(n * nv - r, 1)
        sigma = np.sqrt(np.maximum((residual**2).mean(axis=0) * dof, 1e-24))
    inverse = scipy.linalg.solve_triangular(R, np.eye(r)) / norms[:, None]
    covariance = inverse @ inverse.T
    inflation = np.array([autocorrelation_time(column) for column in residual.T])
    information = np.einsum("njr,njs,j->rs", W, W, inflation / sigma**2, optimize=True)
    return LeastSquares(beta, covariance @ information @ covariance, sigma, inflation)


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
