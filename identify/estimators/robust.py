"""Robust regression: rows that do not fit count less, by iteratively reweighted least squares."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.stats

from excitant.exceptions import Infeasible
from excitant.identify.estimators.regression import Regression
from excitant.identify.least_squares import (
    SMALLEST,
    Factor,
    LeastSquares,
    factorised,
    noise_of,
    with_covariance,
)
from excitant.robots.motion import Array

_ROUNDS = 200
_SETTLED = 1e-7  # of the noise: change of the fitted torque, rms
_FLATTEST = 0.05  # mean slope of an influence; less is no minimum
_NORMAL = float(scipy.stats.norm.ppf(0.75))  # median magnitude of a standard normal variable
_HUBER = 1.345  # 95 % efficient for normal noise (Huber and Ronchetti 2009)
_STUDENT = 4.0  # degrees of freedom (Lange, Little, Taylor 1989)


@dataclass(frozen=True)
class Influence:
    """Influence ψ(u) of a residual of u standard deviations.

    Attributes:
        name: Its name.
        weight: ψ(u) / u.
        slope: ψ'(u).
    """

    name: str
    weight: Callable[[Array], Array]
    slope: Callable[[Array], Array]


def _huber_weight(u: Array) -> Array:
    return np.minimum(1.0, _HUBER / np.maximum(np.abs(u), SMALLEST))


def _huber_slope(u: Array) -> Array:
    return (np.abs(u) <= _HUBER).astype(float)


def _student_weight(u: Array) -> Array:
    return np.asarray((_STUDENT + 1) / (_STUDENT + u**2), float)


def _student_slope(u: Array) -> Array:
    return np.asarray((_STUDENT + 1) * (_STUDENT - u**2) / (_STUDENT + u**2) ** 2, float)


HUBER = Influence("Huber", _huber_weight, _huber_slope)
STUDENT = Influence("Student's t", _student_weight, _student_slope)


def irls(problem: Regression, influence: Influence = STUDENT) -> LeastSquares:
    """Solve Σ_j W_jᵀ ψ(ε_j / σ_j) / σ_j = 0, σ_j from the median magnitude of joint j's residual.

    Huber's ψ first, whose solution is unique; from there the one asked for. Student's, of four
    degrees of freedom, gives gross errors no influence in the end, Huber's gives every one the
    same. With m_j the mean of ψ', the pseudo-torque W_j β + σ_j ψ / m_j has β for its
    least-squares solution under weights m_j / σ_j², and errors to which the estimate responds to
    first order as least squares does: hence the covariance, valid for coloured noise too (Huber
    and Ronchetti 2009, ch. 7; Holland and Welsch 1977 for the iteration).

    It withstands wrong torques, not wrong positions: a row wrong in W may fit and still mislead.
    A filter before it spreads a spike over its neighbours, which then look like noise.

    Args:
        problem: What to solve.
        influence: ψ.

    Raises:
        RankDeficient: The motion does not show some columns.
        Infeasible: The weights did not settle, or leave too few rows.
    """
    W, tau, names = problem.W, problem.tau, problem.names
    start = factorised(W, np.maximum(_scale(tau - tau.mean(axis=0), 0), SMALLEST), names)
    beta = start.solve(tau)
    for each in (HUBER, influence):
        beta = _settled(start, W, tau, beta, each)
    residual = tau - W @ beta
    sigma = _scale(residual, len(beta))
    u = residual / sigma
    slope = np.maximum(influence.slope(u).mean(axis=0), _FLATTEST)
    factor = factorised(W, sigma / np.sqrt(slope), names)
    pseudo = sigma * u * influence.weight(u) / slope
    return with_covariance(factor, beta, pseudo, sigma)


def _scale(residual: Array, r: int) -> Array:
    """Standard deviation of the normal noise with this median magnitude, shape (nv,)."""
    freedom = np.sqrt(residual.size / max(residual.size - r, 1))
    size = np.median(np.abs(residual), axis=0) / _NORMAL * freedom
    least = 1e-9 * noise_of(residual, r)  # most rows fit exactly
    return np.asarray(np.maximum(size, np.maximum(least, SMALLEST)), float)


def _settled(start: Factor, W: Array, tau: Array, beta: Array, influence: Influence) -> Array:
    """β at which reweighting rests; steps are taken in the orthonormal columns of the start."""
    Q = start.Q.reshape(W.shape)
    for _ in range(_ROUNDS):
        residual = tau - W @ beta
        sigma = _scale(residual, len(beta))
        weight = influence.weight(residual / sigma) * (start.weight / sigma) ** 2
        weighted = (Q * weight[:, :, None]).reshape(start.Q.shape)
        score = weighted.T @ (residual / start.weight).ravel()
        step = _step(weighted.T @ start.Q, score, influence)
        beta = beta + scipy.linalg.solve_triangular(start.R, step) / start.norms
        moved = (Q @ step) * start.weight / sigma
        if float((moved**2).mean()) <= _SETTLED**2:
            return beta
    raise Infeasible(
        "robust regression",
        f"weights did not settle in {_ROUNDS} rounds with {influence.name} influence; "
        "use another estimator, or record more",
    )


def _step(A: Array, score: Array, influence: Influence) -> Array:
    """A⁻¹ score, refused where hardly a row that counts is left for some parameters."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", scipy.linalg.LinAlgWarning)
            return np.asarray(scipy.linalg.solve(A, score, assume_a="pos"), float)
    except (np.linalg.LinAlgError, scipy.linalg.LinAlgWarning):
        raise Infeasible(
            "robust regression",
            f"rows that count with {influence.name} influence do not determine all parameters; "
            "use another estimator, or record more",
        ) from None
