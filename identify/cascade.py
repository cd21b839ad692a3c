"""Parameters from the last joint inward: what stage i adds to what the stages before it know.

Property 4 (Khosla 1987): row τ_i contains no parameter of links before i. Base parameters are
counted from the given robot in units of its uncertainty, β = β₀ + L y with y ~ N(0, 1). The stages
so far know c = Dᵀ y, D orthonormal, with covariance P. Rows of joint i, A = W_i L, give

    minimise  ‖τ_i − W_i β₀ − A (D c + V η)‖,

V the directions outside D that they show. The values from outside stay as they are ("known"), so
no row of an outer joint is needed again; what is not known of them reaches η with

    δη = H (ε − A D δc),   H = (A V)⁺,   G = H A D,

    cov(c, η) = [ P       −P Gᵀ           ]
                [ −G P    H Γ Hᵀ + G P Gᵀ ],

Γ the covariance of coloured noise ε (`excitant.identify.coloured_noise`). It is known from what no
value of any parameter explains of the row: the residual itself holds errors of outer values too.
To weigh the rows by (Γ + A D P Dᵀ Aᵀ)⁻¹ instead would serve η a little better and torque worse: it
allows for outer values that the model, which keeps them, does not have.

A direction counts as shown when its standard deviation is at most half of that of the given
robot; what is not shown stays at the given robot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from excitant.identify.information import Information, gaussian
from excitant.identify.least_squares import JointRows, score_covariances, student_width
from excitant.identify.prior import BasePrior
from excitant.robots.motion import Array, freeze

_SURER = 2.0  # times surer than the given robot: then the recordings decide
_CLEAR = (0.3, 0.1, 1e-2, 1e-4, 1e-7)  # share of a leading parameter outside those before it
_NOTHING = 1e-6  # coefficient, in units of the parameters' scale
_ROUNDING = 1e-8  # of the clearest direction: less than rounding and interpolation leave


@dataclass(frozen=True, eq=False)
class Cascade:
    """What the stages so far know of the r base parameters.

    Attributes:
        mean: β₀, shape (r,).
        L: Square root of the given robot's covariance, shape (r, r).
        D: Directions known, orthonormal, shape (r, k).
        c: Their values, shape (k,).
        P: Their covariance, shape (k, k).
    """

    mean: Array
    L: Array
    D: Array
    c: Array
    P: Array

    def __post_init__(self) -> None:
        freeze(self, "mean", "L", "D", "c", "P")

    @property
    def beta(self) -> Array:
        """Base parameters: known where shown, else those of the given robot, shape (r,)."""
        return np.asarray(self.mean + self.L @ (self.D @ self.c), float)

    @property
    def covariance(self) -> Array:
        """Their covariance; that of the given robot in directions not shown, shape (r, r)."""
        left = np.eye(len(self.mean)) - self.D @ self.D.T
        return np.asarray(self.L @ (self.D @ self.P @ self.D.T + left) @ self.L.T, float)

    @property
    def functionals(self) -> Array:
        """The combinations of base parameters known: rows F with F β = F β̂, shape (k, r)."""
        return np.asarray(scipy.linalg.solve_triangular(self.L, self.D, lower=True, trans=1).T)

    def of(self, F: Array) -> tuple[Array, Array]:
        """Values of known combinations F β, F of shape (m, r), and their covariance (m, m)."""
        J = F @ self.L @ self.D
        return np.asarray(F @ self.beta), np.asarray(J @ self.P @ J.T)

    def information(self) -> Information:
        """All that is known, as rows about β of unit noise; nothing of the given robot in it."""
        known = gaussian(self.c, self.P)
        R = known.R @ self.functionals
        return Information(R, known.z + R @ self.mean)


def beginning(prior: BasePrior) -> Cascade:
    """Nothing known but the given robot."""
    scale = np.sqrt(np.diag(prior.covariance))
    L = scale[:, None] * np.linalg.cholesky(prior.covariance / np.outer(scale, scale))
    r = len(scale)
    return Cascade(prior.mean, L, np.zeros((r, 0)), np.zeros(0), np.zeros((0, 0)))


def further(known: Cascade, W: Array, tau: Array) -> tuple[Cascade, float, float]:
    """One stage further inward.

    Args:
        known: What the outer stages know.
        W: Rows of the stage's joint, shape (n, r).
        tau: Its torque, shape (n,).

    Returns:
        What is known then, the noise of the rows [torque unit], NaN without rows, and how many
        of them count as one independent row, at least 1.
    """
    if len(tau) == 0:
        return known, np.nan, 1.0
    A, D = W @ known.L, known.D
    outer = A @ D
    target = tau - W @ known.mean - outer @ known.c
    size = float(np.linalg.norm(A))
    U, s, Vt = _directions(A - outer @ D.T, size)
    scores, sigma, inflation = _noise(_directions(A, size)[0], U, target)
    shown = s >= _SURER * np.sqrt(np.diag(scores))
    if not shown.any():
        return known, sigma, inflation
    U, s, V = U[:, shown], s[shown], Vt[shown].T
    own = scores[np.ix_(shown, shown)] / np.outer(s, s)
    H = U.T / s[:, None]
    G = H @ outer
    cross = -G @ known.P
    P = np.block([[known.P, cross.T], [cross, own - cross @ G.T]])
    c = np.concatenate([known.c, H @ target])
    V = V - D @ (D.T @ V)  # once more, against rounding
    V /= np.linalg.norm(V, axis=0)
    return Cascade(known.mean, known.L, np.hstack([D, V]), c, P), sigma, inflation


def _directions(A: Array, size: float) -> tuple[Array, Array, Array]:
    """Singular vectors and values of A above rounding."""
    U, s, Vt = scipy.linalg.svd(A, full_matrices=False)
    keep = s > _ROUNDING * size
    return U[:, keep], s[keep], Vt[keep]


def _noise(every: Array, U: Array, target: Array) -> tuple[Array, float, float]:
    """Covariance of the scores Uᵀε, widened for the samples it is known from; size of ε; inflation.

    Args:
        every: Orthonormal basis of all that parameters can explain of the row, shape (n, m).
        U: Part of it, shape (n, k).
        target: Torque, with what is known subtracted, shape (n,).
    """
    n, m = every.shape
    residual = target - every @ (every.T @ target)
    floor = 1e-9 * float(np.linalg.norm(target)) / np.sqrt(n) + 1e-12  # data without noise
    sigma = max(float(np.linalg.norm(residual)) / np.sqrt(max(n - m, n / 10)), floor)
    scores, freedom = score_covariances(
        [JointRows(np.arange(m), every)], residual[:, None] / sigma, np.eye(m)
    )
    T = every.T @ U
    covariance = sigma**2 * student_width(freedom[0]) ** 2 * (T.T @ scores[0] @ T)
    inflation = max(float(np.trace(covariance)) / max(len(T.T), 1) / sigma**2, 1.0)
    return covariance + floor**2 * np.eye(len(T.T)), sigma, inflation


def led_combinations(
    F: Array, leading: Sequence[int], rows: Array, scale: Array, preferred: Sequence[int]
) -> tuple[Array, list[int]]:
    """Combinations of base parameters in readable form, and further ones.

    Args:
        F: Coefficients, shape (k, r), each row with the coefficient 1 of a parameter that no other
            row has and that leads it.
        leading: The parameters that lead, k of them.
        rows: Coefficients of the further combinations, independent of these, shape (m, r).
        scale: Scale of each parameter, shape (r,).
        preferred: Parameters that should lead, in this order; then the others.

    Returns:
        Coefficients of all, shape (k + m, r), and the parameters that lead them.
    """
    if len(rows) == 0:
        return F, list(leading)
    led = list(leading)
    rest = (rows - rows[:, led] @ F) * scale
    rest[:, led] = 0.0
    Q = np.linalg.qr(rest.T)[0].T
    order = [k for k in dict.fromkeys((*preferred, *range(len(scale)))) if k not in led]
    added = _leading(Q, order)
    new = np.linalg.solve(Q[:, added], Q)
    new[np.abs(new) < _NOTHING] = 0.0
    new[:, added] = np.eye(len(added))
    new *= scale[added, None] / scale
    return np.vstack([F, new]), led + added


def _leading(Q: Array, order: Sequence[int]) -> list[int]:
    """The first columns, in an order, that are clearly independent; as many as rows."""
    chosen: list[int] = []
    basis = np.zeros((len(Q), 0))
    for clear in _CLEAR:
        for k in order:
            if len(chosen) == len(Q):
                return chosen
            if k in chosen:
                continue
            rest = Q[:, k] - basis @ (basis.T @ Q[:, k])
            size = float(np.linalg.norm(rest))
            if size > clear:
                basis = np.column_stack([basis, rest / size])
                chosen.append(k)
    return chosen
