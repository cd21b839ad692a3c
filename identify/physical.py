"""Physically consistent identification: a semidefinite least-squares fit of all parameters.

With the pseudo-inertia of link k written P_k = L_k Q_k L_kᵀ, where L_k L_kᵀ is the prior's,

    minimise  ‖R x − z‖² + Σ_k ‖Q_k − 1‖² / σ_k² + Σ_i (θ_i − θ̄_i)² / s_i²
    subject to  Q_k ⪰ ε 1,  θ ≥ bounds,

where ‖R x − z‖² is the whitened data (a QR factor of it, so the size of the problem does not
grow with the recording) and x holds the standard parameters φ and the effect coefficients θ.
‖Q − 1‖_F is the coordinate-invariant distance to the prior (the constant pull-back of the
affine-invariant metric: Lee, Wensing, Park 2020). Sousa and Cortesão 2014 for the fit itself.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import cvxpy as cp
import numpy as np
import scipy.linalg

from excitant.exceptions import BadRobot, Infeasible
from excitant.robots.motion import Array, freeze
from excitant.robots.parameters import (
    from_pseudo_inertia,
    nearest_consistent,
    pseudo_inertia,
)
from excitant.robots.robot import Robot

PRIOR_SIGMA = 1.0  # links are known to about ±100 %; decides only what the data leave open
_MARGIN = 1e-4  # smallest eigenvalue of Q: no link shrinks below this part of its prior
_UPPER = np.triu_indices(4)


@dataclass(frozen=True)
class KktResiduals:
    """How well the solution satisfies the optimality conditions, relative to the gradient.

    Attributes:
        stationarity: Gradient of the Lagrangian.
        complementarity: Inner products of multipliers and slacks.
        primal: Violation of the constraints, absolute in Q and θ.
    """

    stationarity: float
    complementarity: float
    primal: float


@dataclass(frozen=True, eq=False)
class EffectPrior:
    """What is known of effect coefficients beforehand, each array of shape (e,).

    Attributes:
        mean: Expected values.
        std: Their standard deviations; large where only the data shall decide.
        lower: Smallest values physics allows.
    """

    mean: Array
    std: Array
    lower: Array


@dataclass(frozen=True, eq=False)
class PhysicalFit:
    """Physically consistent estimate.

    Attributes:
        x: Standard parameters followed by effect coefficients, shape (p,).
        covariance: Posterior covariance (data and prior; constraints ignored), shape (p, p).
        prior_share: Part of each parameter's precision that comes from the prior, shape (p,).
        kkt: Residuals of the optimality conditions.
    """

    x: Array
    covariance: Array
    prior_share: Array
    kkt: KktResiduals

    def __post_init__(self) -> None:
        freeze(self, "x", "covariance", "prior_share")


def prior_parameters(robot: Robot) -> Array:
    """The robot's standard parameters made usable as a prior, shape (nv, 10).

    Links whose inertia no body can have are moved to the nearest consistent one.

    Raises:
        BadRobot: A link without mass; there is no prior to start from.
    """
    phi = robot.phi.reshape(robot.nv, 10)
    for link, values in zip(robot.links, phi, strict=True):
        if values[0] <= 0:
            raise BadRobot(
                robot.source,
                f"link '{link}' has mass {values[0]:g} kg, but a prior is needed; "
                "give it a rough mass and inertia in the URDF",
            )
    return np.array([nearest_consistent(values) for values in phi])


def fit_physical(
    R: Array,
    z: Array,
    prior: Array,
    effects: EffectPrior,
    prior_sigma: float | Array = PRIOR_SIGMA,
    metric: Array | None = None,
) -> PhysicalFit:
    """Solve the semidefinite fit.

    Args:
        R: Whitened observation matrix or its QR factor, shape (m, p), p = 10 links + effects.
        z: Whitened torque, shape (m,).
        prior: Standard parameters of the prior, consistent, shape (links, 10).
        effects: Prior and bounds of the p − 10 links effect coefficients.
        prior_sigma: Relative uncertainty σ of the prior, for all links or for each.
        metric: Bodies that σ is relative to, shape (links, 10); those of the prior if None.

    Raises:
        Infeasible: The solver did not converge.
    """
    links = len(prior)
    unit = _effect_units(R[:, 10 * links :], effects.std)
    T = link_coordinates(prior if metric is None else metric)
    scale = scipy.linalg.block_diag(T, np.diag(unit))
    A = R @ scale
    centre = np.concatenate([np.linalg.solve(T, prior.ravel()), effects.mean / unit])
    smallest = min(np.linalg.eigvalsh(Q)[0] for Q in _matrices(centre, links))
    margin = min(_MARGIN, 0.5 * float(smallest))
    weight = np.concatenate([link_weights(links, prior_sigma), unit / effects.std])
    lower = effects.lower / unit
    y, duals = _solve(A, z, centre, weight, lower, links, margin)
    kkt = _kkt(A, z, centre, weight, lower, y, duals, margin)
    precision = A.T @ A + np.diag(weight**2)
    covariance = scale @ np.linalg.inv(precision) @ scale.T
    prior_covariance = scale @ np.diag(weight**-2.0) @ scale.T
    share = np.sqrt(np.diag(covariance) / np.diag(prior_covariance))
    return PhysicalFit(scale @ y, covariance, np.clip(share, 0, 1), kkt)


def _effect_units(R: Array, std: Array) -> Array:
    """Units of the effect coefficients that make their columns alike, shape (e,)."""
    norms = np.sqrt((R**2).sum(axis=0) + std**-2.0)
    return np.asarray(np.sqrt(len(R)) / norms, float)


def _svec_weights() -> Array:
    """Weights w with Σ (w · upper(Q))² = ‖Q‖_F²."""
    return np.where(_UPPER[0] == _UPPER[1], 1.0, np.sqrt(2.0))


def link_weights(links: int, sigma: float | Array) -> Array:
    """Square roots of the prior precision of the coordinates y, shape (10 links,)."""
    each = np.broadcast_to(np.asarray(sigma, float), (links,))
    return np.concatenate([_svec_weights() / s for s in each])


def link_coordinates(prior: Array) -> Array:
    """Map T from coordinates to standard parameters, φ = T y, shape (10 links, 10 links).

    The coordinates y are the upper triangles of all Q_k; the prior lies at Q = 1.

    Args:
        prior: Consistent standard parameters, shape (links, 10).
    """
    blocks = []
    for values in prior:
        L = np.linalg.cholesky(pseudo_inertia(values))
        block = np.empty((10, 10))
        for k, (i, j) in enumerate(zip(*_UPPER, strict=True)):
            unit = np.zeros((4, 4))
            unit[i, j] = unit[j, i] = 1.0
            block[:, k] = from_pseudo_inertia(L @ unit @ L.T)
        blocks.append(block)
    return scipy.linalg.block_diag(*blocks)


def _solve(
    A: Array, z: Array, centre: Array, weight: Array, lower: Array, links: int, margin: float
) -> tuple[Array, list[Array]]:
    """Minimiser and multipliers.

    With U a QR factor of data and prior together and y₀ the minimum without constraints, the
    objective is ‖U (y − y₀)‖² plus a constant. It is solved for U (y − y₀), which no
    quality of data makes ill-conditioned.
    """
    stacked = np.column_stack([np.vstack([A, np.diag(weight)]), np.r_[z, weight * centre]])
    factor = np.asarray(np.linalg.qr(stacked, mode="r"), float)[: len(centre)]
    U, free = factor[:, :-1], scipy.linalg.solve_triangular(factor[:, :-1], factor[:, -1])
    size = max(1.0, float(np.linalg.norm(U @ (centre - free))))
    step = size * scipy.linalg.solve_triangular(U, np.eye(len(free)))
    v = cp.Variable(len(free))
    bounded = np.flatnonzero(np.isfinite(lower))
    maps = [_symmetric(10 * k, len(free)) for k in range(links)]
    constraints = [
        cp.reshape((M @ step) @ v + M @ free, (4, 4), order="C") >> margin * np.eye(4) for M in maps
    ]
    if len(bounded):
        rows = 10 * links + bounded
        constraints.append(step[rows] @ v + free[rows] >= lower[bounded])
    _solve_tightly(cp.Problem(cp.Minimize(cp.sum_squares(v)), constraints))
    multipliers = [np.asarray(c.dual_value, float) * size**2 for c in constraints]
    if len(multipliers) == links:
        multipliers.append(np.zeros(0))
    return free + step @ np.asarray(v.value, float), multipliers


def _matrices(y: Array, links: int) -> Array:
    """The matrices Q_k of the coordinates, shape (links, 4, 4)."""
    Q = np.zeros((links, 4, 4))
    Q[:, *_UPPER] = y[: 10 * links].reshape(links, 10)
    return Q + np.triu(Q, 1).transpose(0, 2, 1)


def _symmetric(start: int, size: int) -> Array:
    """Map from all coordinates to the 16 entries of one Q, shape (16, size)."""
    selection = np.zeros((4, 4, size))
    for k, (i, j) in enumerate(zip(*_UPPER, strict=True)):
        selection[i, j, start + k] = selection[j, i, start + k] = 1.0
    return selection.reshape(16, size)


def _solve_tightly(problem: cp.Problem) -> None:
    """Solve to the tightest tolerance that rounding allows."""
    for tolerance in (1e-10, 1e-8, 1e-7):
        names = ("tol_gap_abs", "tol_gap_rel", "tol_feas")
        try:
            with warnings.catch_warnings(action="ignore"):  # the status says it
                problem.solve(solver=cp.CLARABEL, **dict.fromkeys(names, tolerance))
        except cp.SolverError:
            continue
        if problem.status == cp.OPTIMAL:
            return
    raise Infeasible(
        "physically consistent fit", f"the semidefinite solver ended '{problem.status}'"
    )


def _kkt(
    A: Array,
    z: Array,
    centre: Array,
    weight: Array,
    lower: Array,
    y: Array,
    duals: list[Array],
    margin: float,
) -> KktResiduals:
    *matrices, bounds = duals
    gradient = 2 * A.T @ (A @ y - z) + 2 * weight**2 * (y - centre)
    pull = np.zeros_like(y)
    slackness, violation = [], [0.0]
    for k, (Z, Q) in enumerate(zip(matrices, _matrices(y, len(matrices)), strict=True)):
        pull[10 * k : 10 * k + 10] = (_svec_weights() ** 2) * ((Z + Z.T) / 2)[_UPPER]
        slackness.append(abs(float(np.sum(Z * (Q - margin * np.eye(4))))))
        violation.append(margin - float(np.linalg.eigvalsh(Q)[0]))
    bounded = 10 * len(matrices) + np.flatnonzero(np.isfinite(lower))
    if len(bounded):
        gap = y[bounded] - lower[np.isfinite(lower)]
        pull[bounded] = bounds
        slackness.append(float(np.abs(bounds * gap).sum()))
        violation.append(float(-gap.min()))
    size = float(np.linalg.norm(2 * A.T @ z)) + 1.0
    return KktResiduals(
        float(np.linalg.norm(gradient - pull)) / size,
        float(sum(slackness)) / size,
        max(violation),
    )
