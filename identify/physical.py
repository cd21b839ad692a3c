"""Physically consistent identification: a semidefinite least-squares fit of all parameters.

With the pseudo-inertia of link k written P_k = L_k Q_k L_kᵀ, where L_k L_kᵀ is the prior's,

    minimise  ‖R x − z‖² + Σ_k ‖Q_k − 1‖_F² / σ_k² + Σ_i (θ_i − θ̄_i)² / s_i² + Σ_m (m − m̄)² / s_m²
    subject to  Q_k ⪰ ε 1,  θ ≥ bounds,  and what else is known of the bodies,

where ‖R x − z‖² is the whitened data (a QR factor, so the size of the problem does not grow with
the recording) and x holds the standard parameters φ and the effect coefficients θ. The distance to
the prior does not depend on coordinates (pull-back metric: Lee, Wensing, Park 2020). Consistent
parameters are fitted directly, never projected afterwards (Sousa and Cortesão 2014).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from excitant.exceptions import BadInput
from excitant.identify.knowledge import Knowledge, known_rows
from excitant.identify.prior import (
    PRIOR_SIGMA,
    EffectPrior,
    linear_influence,
    link_coordinates,
    link_weights,
    matrices,
)
from excitant.identify.semidefinite import (
    MARGIN,
    KktResiduals,
    Program,
    Restriction,
    contradiction,
    definite,
    solve,
)
from excitant.robots.motion import Array, freeze, read_only

_ROUNDING = 1e-10  # of a parameter's unit, up to which it is known exactly


@dataclass(frozen=True, eq=False)
class PhysicalFit:
    """Physically consistent estimate.

    Attributes:
        x: Standard parameters followed by effect coefficients, shape (p,).
        covariance: Posterior covariance, inequalities ignored, shape (p, p).
        kkt: Residuals of the optimality conditions.
        R: Factor of the whitened columns, shape (rows, p).
        root: L of the prior covariance L Lᵀ at the solution, shape (p, k); k < p with equalities.
        links: Number of links.
    """

    x: Array
    covariance: Array
    kkt: KktResiduals
    R: Array
    root: Array
    links: int

    def __post_init__(self) -> None:
        freeze(self, "x", "covariance", "R", "root")

    @property
    def prior_share(self) -> Array:
        """Part of each parameter's uncertainty that no data reduced, shape (p,)."""
        after, before = np.diag(self.covariance), (self.root**2).sum(axis=1)
        ratio = np.divide(after, before, out=np.ones_like(before), where=before > 0)
        return np.asarray(np.sqrt(np.clip(ratio, 0.0, 1.0)), float)

    @cached_property
    def influence(self) -> Array:
        """Sensitivity of each parameter to the prior in linear theory, 0 to 1, shape (p,)."""
        return read_only(linear_influence(self.R, self.root, self.x, self.links))


def fit_physical(
    R: Array,
    z: Array,
    prior: Array,
    effects: EffectPrior,
    prior_sigma: float | Array = PRIOR_SIGMA,
    metric: Array | None = None,
    knowledge: Knowledge | None = None,
    links: Sequence[str] | None = None,
) -> PhysicalFit:
    """Solve the semidefinite fit.

    Args:
        R: Whitened observation matrix or its QR factor, shape (m, p), p = 10 links + effects.
        z: Whitened torque, shape (m,).
        prior: Standard parameters of the prior, consistent, shape (links, 10).
        effects: Prior and bounds of the p − 10 links effect coefficients.
        prior_sigma: Relative uncertainty σ of the prior, for all links or for each.
        metric: Bodies that σ is relative to, shape (links, 10); those of the prior if None.
        knowledge: What is known of the bodies beforehand.
        links: Names of the links that knowledge is about, in order.

    Raises:
        BadInput: Knowledge that no body fulfils, or about other links.
        Infeasible: The solver did not converge.
    """
    knowledge = knowledge or Knowledge()
    names = links or [f"link {k + 1}" for k in range(len(prior))]
    sigma = np.broadcast_to(np.asarray(prior_sigma, float), (len(prior),))
    reference = prior if metric is None else metric
    # units of the effect coefficients that make their columns alike
    units = np.sqrt(len(R) / ((R[:, prior.size :] ** 2).sum(axis=0) + effects.std**-2.0))
    T = link_coordinates(reference)
    scale = scipy.linalg.block_diag(T, np.diag(units))
    centre = np.concatenate([np.linalg.solve(T, prior.ravel()), effects.mean / units])
    distance = np.diag(link_weights(len(reference), sigma))
    C, d, restrictions = _known(knowledge, names, T, effects.lower / units, centre)
    weight = units / effects.std
    program = Program(
        A=R @ scale,
        z=z,
        C=scipy.linalg.block_diag(np.vstack([distance, C]), np.diag(weight)),
        d=np.concatenate([distance @ centre[: len(T)], d, weight * centre[len(T) :]]),
        restrictions=restrictions,
    )
    found = solve(program, centre)
    covariance, root = _uncertainty(program, scale)
    return PhysicalFit(scale @ found.y, covariance, found.kkt(program), R, root, len(prior))


def _known(
    knowledge: Knowledge, links: Sequence[str], T: Array, lower: Array, centre: Array
) -> tuple[Array, Array, tuple[Restriction, ...]]:
    """Rows C y ≈ d of unit noise about the links' coordinates, and what all of y must satisfy."""
    C, d, known = known_rows(knowledge, links)
    p, bounded = len(centre), np.isfinite(lower)
    restrictions = [_scaled(restriction, T, p) for restriction in known]
    if bounded.any():
        signs = np.eye(p)[len(T) :][bounded]
        restrictions.insert(0, Restriction("nonnegative", signs, lower[bounded]))
    smallest = float(np.linalg.eigvalsh(matrices(centre, len(links))).min())
    bodies = definite(len(links), min(MARGIN, 0.5 * smallest), p)
    names = contradiction((*bodies, *restrictions)) if known else ()
    if names:
        what = " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
        together = "contradict each other" if len(names) > 1 else "cannot be"
        raise BadInput(
            f"{knowledge.source}: {what} {together}: no body near the given one fulfils "
            f"{'them together; correct one of them' if len(names) > 1 else 'it; correct it'}"
        )
    return C @ T, d, (*bodies, *restrictions)


def _scaled(restriction: Restriction, T: Array, p: int) -> Restriction:
    """A restriction of φ as one of y, its rows of about length one, which changes no cone."""
    G = np.zeros((len(restriction.h), p))
    G[:, : len(T)] = restriction.G @ T
    norms = np.linalg.norm(G, axis=1, keepdims=True)
    if restriction.cone == "second_order":
        norms = np.full_like(norms, norms.max())
    return Restriction(restriction.cone, G / norms, restriction.h / norms[:, 0], restriction.name)


def _uncertainty(program: Program, scale: Array) -> tuple[Array, Array]:
    """Posterior covariance of x, and root of the prior's."""
    exact = [r.G for r in program.restrictions if r.cone == "zero"]
    N = scipy.linalg.null_space(np.vstack(exact)) if exact else np.eye(len(scale))
    S = scale @ N
    both = np.vstack([program.A, program.C])
    factors = (np.linalg.qr(rows @ N, mode="r") for rows in (both, program.C))
    after, root = (scipy.linalg.solve_triangular(F, S.T, trans=1).T for F in factors)
    root[np.linalg.norm(root, axis=1) <= _ROUNDING * np.linalg.norm(scale, axis=1)] = 0.0
    return after @ after.T, root
