"""Physically consistent identification: a semidefinite least-squares fit of all parameters.

With the pseudo-inertia P_k of link k,

    minimise  ‖R x − z‖² − 2 log p(P) + Σ_i (θ_i − θ̄_i)² / s_i² + Σ_m (m − m̄)² / s_m²
    subject to  P_k ≻ 0,  θ ≥ bounds,  and what else is known of the bodies,

with the prior density p of `excitant.identify.prior`; it is convex. ‖R x − z‖² is the whitened data
(a QR factor, so the size of the problem does not grow with the recording), and x holds the standard
parameters φ and the effect coefficients θ. Consistent parameters are fitted directly, never
projected afterwards (Sousa and Cortesão 2014).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from excitant.exceptions import BadInput
from excitant.identify.knowledge import Knowledge, known_rows
from excitant.identify.prior import (
    BodyPrior,
    EffectPrior,
    linear_influence,
    link_coordinates,
    link_weights,
)
from excitant.identify.semidefinite import (
    KktResiduals,
    Program,
    Restriction,
    contradiction,
    possible,
    solve,
)
from excitant.robots.motion import Array, freeze, read_only

SIGMAS = 0.05, 10.0
"""Least and largest relative uncertainty of given bodies; ±100 kg for 10 kg is as good as none."""
_GRID = 40  # values of σ, evenly spread by logarithm
_ALTERNATIONS = 3  # between the σ of links that have their own and that of the others
_CHANCE = 0.05
_MARGIN = 1e-4  # least part of a given body in any direction
_ROUNDING = 1e-10  # of a parameter's unit, up to which it is known exactly
_UNSETTLED = (
    "the physically consistent fit ends {:.2g} standard deviations from its optimum, for the data "
    "fit only bodies far from any that can exist: look for wrong units or signs of torque"
)


@dataclass(frozen=True, eq=False)
class PhysicalFit:
    """Physically consistent estimate.

    Attributes:
        x: Standard parameters followed by effect coefficients, shape (p,).
        covariance: Posterior covariance, inequalities ignored, shape (p, p).
        kkt: Residuals of the optimality conditions.
        note: That floating point ended before the optimum, as a sentence; else empty.
        R: Factor of the whitened columns, shape (rows, p).
        root: L of the prior covariance L Lᵀ at the solution, shape (p, k); k < p with equalities.
        prior: Prior of the bodies.
    """

    x: Array
    covariance: Array
    kkt: KktResiduals
    R: Array
    root: Array
    prior: BodyPrior
    note: str = ""

    def __post_init__(self) -> None:
        freeze(self, "x", "covariance", "R", "root")

    @property
    def prior_share(self) -> Array:
        """Part of each parameter's uncertainty that no data reduced, shape (p,)."""
        after = np.diag(self.covariance)
        before = (self.root**2).sum(axis=1)
        ratio = np.divide(after, before, out=np.ones_like(before), where=before > 0)
        return np.asarray(np.sqrt(np.clip(ratio, 0.0, 1.0)), float)

    @cached_property
    def influence(self) -> Array:
        """Sensitivity of each parameter to the prior in linear theory, 0 to 1, shape (p,)."""
        return read_only(
            linear_influence(self.R, self.root, self.x, len(self.prior.bodies))
        )


def centre_of_mass(phi: Array, covariance: Array) -> tuple[Array, Array]:
    """Centre of mass of a link and its standard deviation, both (3,) [m]; φ (10,), C (10, 10)."""
    centre = phi[1:4] / phi[0]
    J = np.column_stack([-centre, np.eye(3)]) / phi[0]
    return centre, np.sqrt(np.diag(J @ covariance[:4, :4] @ J.T))


def fit_physical(
    R: Array,
    z: Array,
    prior: Array | BodyPrior,
    effects: EffectPrior,
    knowledge: Knowledge | None = None,
    links: Sequence[str] | None = None,
) -> PhysicalFit:
    """Solve the semidefinite fit.

    Args:
        R: Whitened observation matrix or its QR factor, shape (m, p), p = 10 links + effects.
        z: Whitened torque, shape (m,).
        prior: Prior of the bodies, or consistent standard parameters, shape (links, 10), which
            are then taken to be as uncertain as the data say (`agreement`).
        effects: Prior and bounds of the p − 10 links effect coefficients.
        knowledge: What is known of the bodies beforehand.
        links: Names of the links that knowledge is about, in order.

    Raises:
        BadInput: Knowledge that no body fulfils, or about other links.
        Infeasible: Knowledge leaves no room.
    """
    knowledge = knowledge or Knowledge()
    if not isinstance(prior, BodyPrior):
        prior = BodyPrior(prior, agreement(R, z, prior))
    given = prior.bodies.ravel()
    names = links or [f"link {k + 1}" for k in range(len(prior.bodies))]
    # units of the effect coefficients that make their columns alike
    units = np.sqrt(
        len(R) / ((R[:, len(given) :] ** 2).sum(axis=0) + effects.std**-2.0)
    )
    scale = scipy.linalg.block_diag(prior.T, np.diag(units))
    centre = np.concatenate([np.linalg.solve(prior.T, given), effects.mean / units])
    known, about, restrictions = _known(
        knowledge, names, prior, effects.lower / units, centre
    )
    weight = units / effects.std
    C = scipy.linalg.block_diag(known, np.diag(weight))
    d = np.concatenate([about, effects.mean / effects.std])
    program = Program(R @ scale, z, C, d, prior, restrictions)
    found = solve(program, centre)
    covariance, root = _uncertainty(program, found.y, scale)
    note = "" if found.settled else _UNSETTLED.format(found.error)
    return PhysicalFit(
        scale @ found.y, covariance, found.kkt(program), R, root, prior, note
    )


def agreement(R: Array, z: Array, prior: Array) -> Array:
    """Relative uncertainty σ of each given body under which the data are most likely, (links,).

    Data z = R x + ε, ε of unit variance, with bodies normal around the prior and nothing known of
    effects, have the covariance 1 + Σ_k σ_k² K_k in what no effect explains; σ maximises their
    likelihood (type II maximum likelihood, MacKay 1992): it is how far off the given bodies are
    where the data see them. All links have one σ, but for those that are significantly further
    off: the last, which carries tools that descriptions lack, and others, one by one, counted
    against chance among as many links. No description is taken to be right to better than
    `SIGMAS[0]`. Shapes as in `fit_physical`.
    """
    p = R.shape[1]
    T = link_coordinates(prior)
    links = len(prior)
    both = np.asarray(np.linalg.qr(np.column_stack([R, z]), mode="r"), float)[:p]
    free = scipy.linalg.null_space(both[:, len(T) : p].T).T
    columns = free @ both[:, : len(T)] @ T / link_weights(links, 1.0)
    left = free @ (both[:, p] - both[:, : len(T)] @ prior.ravel())
    seen, size, _ = np.linalg.svd(columns, full_matrices=False)
    seen = seen[
        :, size > _ROUNDING * max(size[:1], default=1.0)
    ]  # σ is of no account elsewhere
    columns = seen.T @ columns
    left = seen.T @ left

    def most_likely(block: Array, others: Array) -> tuple[float, float]:
        """σ of a block of columns beside others of unit variance, and −2 log likelihood."""
        both = np.vstack([np.eye(len(left)), others.T])
        root = np.asarray(np.linalg.qr(both, mode="r"), float).T
        U, s, _ = np.linalg.svd(scipy.linalg.solve_triangular(root, block, lower=True))
        power = np.pad(s, (0, len(U) - len(s)))
        seen = (U.T @ scipy.linalg.solve_triangular(root, left, lower=True)) ** 2

        def surprise(log_sigma: Any) -> Any:
            variance = 1 + np.multiply.outer(np.exp(log_sigma), power) ** 2
            return (np.log(variance) + seen / variance).sum(axis=-1)

        grid = np.log(np.geomspace(*SIGMAS, _GRID))
        k = int(np.argmin(surprise(grid)))
        ends = grid[max(k - 1, 0)], grid[min(k + 1, _GRID - 1)]
        found = scipy.optimize.minimize_scalar(surprise, bounds=ends, method="bounded")
        return float(np.exp(found.x)), float(found.fun) + 2 * float(
            np.log(np.abs(np.diag(root))).sum()
        )

    blocks = columns.reshape(len(left), links, 10).swapaxes(0, 1)

    def with_own(own: Sequence[int], sigma: Array) -> tuple[float, Array]:
        """The surprise, and σ of every link: those of some, and that of all others."""
        others = [k for k in range(links) if k not in own]
        sigma = sigma.copy()
        least = np.inf
        for group in [*([k] for k in reversed(own)), others] * (
            _ALTERNATIONS if own else 1
        ):
            sigma[group] = 0.0
            joined = np.concatenate(blocks[group], axis=1)
            beside = np.concatenate(blocks * sigma[:, None, None], axis=1)
            sigma[group], least = most_likely(joined, beside)
        return least, sigma

    own = list[int]()
    chance = np.append(np.full(links - 1, _CHANCE / links), _CHANCE)
    least, sigma = with_own(own, np.zeros(links))
    while len(own) < links - 1:
        others = [k for k in range(links) if k not in own]
        trials = [(*with_own([*own, k], sigma), k) for k in others]
        further = [
            (value, trial, k)
            for value, trial, k in trials
            if least - value > scipy.special.chdtri(1, chance[k])
            and trial[k] > trial[[j for j in others if j != k]].max()
        ]
        if not further:
            break
        least, sigma, k = min(further, key=lambda trial: trial[0])
        own.append(k)
    return sigma


def _known(
    knowledge: Knowledge,
    links: Sequence[str],
    prior: BodyPrior,
    lower: Array,
    centre: Array,
) -> tuple[Array, Array, tuple[Restriction, ...]]:
    """Rows C y ≈ d of unit noise about the links' coordinates, and what all of y must satisfy."""
    C, d, known = known_rows(knowledge, links)
    T = prior.T
    p = len(T) + len(lower)
    bounded = np.isfinite(lower)
    restrictions = [_scaled(restriction, T, p) for restriction in known]
    if bounded.any():
        signs = np.eye(p)[len(T) :][bounded]
        restrictions.insert(0, Restriction("nonnegative", signs, lower[bounded]))
    names: tuple[str, ...] = ()
    if known and any(each.violation(centre) > 0 for each in restrictions):
        names = contradiction((*possible(prior, p, _MARGIN), *restrictions))
    if names:
        what = " and ".join(
            [", ".join(names[:-1]), names[-1]] if len(names) > 1 else names
        )
        together = "contradict each other" if len(names) > 1 else "cannot be"
        raise BadInput(
            f"{knowledge.source}: {what} {together}: no body near the given one fulfils "
            f"{'them together; correct one of them' if len(names) > 1 else 'it; correct it'}"
        )
    return C @ T, d, tuple(restrictions)


def _scaled(restriction: Restriction, T: Array, p: int) -> Restriction:
    """A restriction of φ as one of y, its rows of about length one, which changes no cone."""
    G = np.zeros((len(restriction.h), p))
    G[:, : len(T)] = restriction.G @ T
    norms = np.linalg.norm(G, axis=1, keepdims=True)
    if restriction.cone == "second_order":
        norms = np.full_like(norms, norms.max())
    return Restriction(
        restriction.cone, G / norms, restriction.h / norms[:, 0], restriction.name
    )


def _uncertainty(program: Program, y: Array, scale: Array) -> tuple[Array, Array]:
    """Posterior covariance of x at y, and root of the prior's."""
    exact = [r.G for r in program.restrictions if r.cone == "zero"]
    N = scipy.linalg.null_space(np.vstack(exact)) if exact else np.eye(len(scale))
    S = scale @ N
    prior, _ = program.prior(y)
    both = np.vstack([program.A, prior])
    factors = (np.linalg.qr(rows @ N, mode="r") for rows in (both, prior))
    after, root = (scipy.linalg.solve_triangular(F, S.T, trans=1).T for F in factors)
    root[np.linalg.norm(root, axis=1) <= _ROUNDING * np.linalg.norm(scale, axis=1)] = (
        0.0
    )
    return after @ after.T, root
