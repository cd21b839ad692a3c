"""Weighted least squares on base parameters, and what it shares with other estimators."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
import scipy.stats

from excitant.exceptions import RankDeficient
from excitant.identify.coloured_noise import score_covariances
from excitant.robots.motion import Array, freeze

_ROUNDS = 4  # of re-estimating the noise of each joint; the weights settle in two or three
SMALLEST = 1e-12  # torque noise taken for none
_SILENT = 1e-10  # of the longest column
_DEPENDENT = 1e-9  # of the largest singular value, columns of unit length
_UNDETERMINED = (
    "this motion does not determine these parameters (move the joints that show them, "
    "or design an excitation)"
)


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
    settled = reweighted(W, tau, names, tau.std(axis=0), len(tau))
    factor = settled.factor
    fit = with_covariance(factor, settled.beta, settled.residual, factor.weight)
    return replace(fit, sigma=settled.sigma)


@dataclass(frozen=True, eq=False)
class Settled:
    """Least squares whose weights have settled.

    Attributes:
        factor: Factorisation of the weighted columns.
        beta: Estimate, shape (r,).
        residual: Torque less what the columns explain, shape (n, nv) [torque unit].
        sigma: Its standard deviation per joint, shape (nv,) [torque unit].
    """

    factor: Factor
    beta: Array
    residual: Array
    sigma: Array


def reweighted(W: Array, tau: Array, names: tuple[str, ...], sigma: Array, n: int) -> Settled:
    """Least squares of rows that stand for n rows, the noise of joints estimated along the way.

    Args:
        W: Columns, shape (m, nv, r): all rows, or a triangle of each joint's.
        tau: Torque, shape (m, nv).
        names: What the columns stand for, for messages.
        sigma: First guess of each joint's noise, shape (nv,) [torque unit].
        n: Number of rows of each joint.
    """
    sigma = np.maximum(sigma, SMALLEST)
    for _ in range(_ROUNDS):
        factor = factorised(W, sigma, names)
        beta = factor.solve(tau)
        residual = tau - W @ beta
        sigma = noise_of(residual, len(beta), n)
    return Settled(factor, beta, residual, sigma)


@dataclass(frozen=True, eq=False)
class Factor:
    """QR factorisation of weighted columns X / σ = Q R diag(norms).

    Attributes:
        X: Weighted columns, each of unit length, shape (n, nv, r).
        norms: Their lengths before, shape (r,).
        Q: Shape (n nv, r).
        R: Shape (r, r).
        weight: Noise that rows were divided by, shape (nv,) [torque unit].
    """

    X: Array
    norms: Array
    Q: Array
    R: Array
    weight: Array

    def solve(self, tau: Array) -> Array:
        """β of least squares of torque, shape (n, nv) → (r,)."""
        target = self.Q.T @ (tau / self.weight).ravel()
        return np.asarray(scipy.linalg.solve_triangular(self.R, target) / self.norms, float)

    def projected(self, values: Array) -> Array:
        """Part of columns that X explains, weighted: (n, nv, k) → (n, nv, k)."""
        flat = (values / self.weight[:, None]).reshape(len(self.Q), -1)
        fitted = (self.Q @ (self.Q.T @ flat)).reshape(values.shape)
        return np.asarray(fitted * self.weight[:, None], float)


def factorised(X: Array, weight: Array, names: tuple[str, ...]) -> Factor:
    """Factorisation of columns, rows divided by their joint's noise.

    Args:
        X: Shape (n, nv, r).
        weight: Shape (nv,) [torque unit].
        names: What the columns stand for.

    Raises:
        RankDeficient: Columns that are silent, or that others explain.
    """
    r = X.shape[2]
    weighted = X / weight[:, None]
    norms = np.linalg.norm(weighted, axis=(0, 1))
    silent = norms <= _SILENT * norms.max(initial=0.0)
    if silent.any():
        raise RankDeficient([names[k] for k in np.flatnonzero(silent)], _UNDETERMINED)
    weighted /= norms
    Q, R = scipy.linalg.qr(weighted.reshape(-1, r), mode="economic")
    _, s, Vt = np.linalg.svd(R)
    if len(s) < r or s[-1] < _DEPENDENT * s[0]:
        weak = np.flatnonzero(np.abs(Vt[-1]) > 0.1)
        raise RankDeficient([names[k] for k in weak], _UNDETERMINED)
    return Factor(weighted, norms, np.asarray(Q, float), np.asarray(R, float), weight)


def noise_of(residual: Array, r: int, n: int | None = None) -> Array:
    """Standard deviation of each joint's residual after r parameters, shape (nv,).

    Args:
        residual: Residuals, shape (m, nv).
        r: Number of parameters.
        n: Number of rows that they stand for; m when None.
    """
    n = len(residual) if n is None else n
    size = n * residual.shape[1]
    variance = (residual**2).sum(axis=0) / n * (size / max(size - r, 1))
    return np.asarray(np.sqrt(np.maximum(variance, SMALLEST**2)), float)


def with_covariance(factor: Factor, beta: Array, error: Array, sigma: Array) -> LeastSquares:
    """An estimate with its covariance A⁻¹ Ω A⁻¹, widened for what the noise is known from.

    Every estimator here is, at its solution and to first order in the noise, least squares of some
    columns X_j with an error ε_j: β̂ − β = A⁻¹ Σ_j X_jᵀ ε_j, A = Σ_j X_jᵀ X_j. The columns are W
    itself (ordinary and weighted), W with the slope of the influence (robust), W projected on the
    instruments, or W corrected (total).


    Args:
        factor: Columns X_j.
        beta: The estimate, shape (r,).
        error: ε_j as the residual shows it, shape (n, nv) [torque unit].
        sigma: What to report as noise of each joint, shape (nv,) [torque unit].
    """
    inverse = scipy.linalg.solve_triangular(factor.R, np.eye(len(beta)))
    scaled = error / factor.weight
    size = max(float(np.sqrt((scaled**2).mean())), SMALLEST)  # far from underflow
    scores, freedom = score_covariances(factor.X, scaled / size, inverse @ inverse.T)
    return sandwiched(factor, beta, scores * size**2, freedom, sigma)


def sandwiched(
    factor: Factor, beta: Array, scores: Array, freedom: Array, sigma: Array
) -> LeastSquares:
    """An estimate with its covariance A⁻¹ Ω A⁻¹, given the covariance of its scores.

    Args:
        factor: Columns X_j.
        beta: The estimate, shape (r,).
        scores: Ω_j of X_jᵀ ε_j, each joint's part of Ω, shape (nv, r, r).
        freedom: Degrees of freedom that they are known with, shape (nv,).
        sigma: What to report as noise of each joint, shape (nv,) [torque unit].
    """
    inverse = scipy.linalg.solve_triangular(factor.R, np.eye(len(beta)))
    root = inverse / factor.norms[:, None]
    parts = np.array([root @ (inverse.T @ each @ inverse) @ root.T for each in scores])
    widths = _widths(np.diagonal(parts, axis1=1, axis2=2), freedom)
    effect = traces(scores, inverse)
    plain = traces(information(factor.X), inverse) * (sigma / factor.weight) ** 2
    inflation = np.divide(effect, plain, out=np.ones(len(sigma)), where=plain > 0)
    covariance = parts.sum(axis=0) * np.outer(widths, widths)
    return LeastSquares(beta, covariance, sigma, np.maximum(inflation, 1.0))


def information(X: Array) -> Array:
    """X_jᵀ X_j of each joint, shape (nv, r, r)."""
    return np.asarray(np.einsum("njr,njs->jrs", X, X, optimize=True), float)


def traces(matrices: Array, inverse: Array) -> Array:
    """tr(A⁻¹ M_j) of each M_j, shape (nv,), with A⁻¹ = inverse · inverseᵀ."""
    return np.asarray(np.einsum("ra,jrs,sa->j", inverse, matrices, inverse, optimize=True), float)


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
