"""Physically consistent identification: a semidefinite least-squares fit of all parameters.

With the pseudo-inertia P_k of link k,

    minimise  ‖R x − z‖² − 2 log p(P) + Σ_i (θ_i − θ̄_i)² / s_i² + Σ_m (m − m̄)² / s_m²
    subject to  P_k ≻ 0,  θ ≥ bounds,  and what else is known of the bodies,

with the prior density p of `excitant.identify.prior`; it is convex. ‖R x − z‖² is the whitened data
(a QR factor, so the size of the problem does not grow with the recording), and x holds the standard
parameters φ and the effect coefficients θ. Consistent parameters are fitted directly, never
projected afterwards (Sousa and Cortesão 2014).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
import scipy

from excitant.exceptions import BadInput
from excitant.identify.knowledge import Knowledge, known_rows
from excitant.identify.prior import (
    LARGEST_SIGMA,
    BodyPrior,
    EffectPrior,
    all_directions,
    largest_uncertainty,
    linear_influence,
    link_coordinates,
    link_weights,
)
from excitant.identify.regression import triangle
from excitant.identify.semidefinite import (
    Program,
    Restriction,
    contradiction,
    free_directions,
    possible,
    solve,
)
from excitant.identify.signals import grid_minimum
from excitant.robots.effects import Effect
from excitant.robots.motion import Array, Noun, quotient, read_only

_UNSETTLED = (
    "the physically consistent fit ends {:.2g} standard deviations from its optimum, for the data "
    "fit only bodies far from any that can exist: look for wrong units or signs of torque"
)
_ROUNDING = 1e-10  # of a parameter's unit, up to which it is known exactly
_MARGIN = 1e-4  # least share of a nominal body in any direction, for contradictions


@dataclass(frozen=True)
class Agreement:
    """Settings of the relative uncertainty σ of nominal bodies.

    Attributes:
        least: Least σ: no description is right to better than that.
        grid: Values of σ tried, evenly spread by logarithm.
        alternations: Rounds between the σ of links that have their own and that of the others.
        false_alarm: Probability that a link has its own σ by chance, among all links.
    """

    least: float = 0.05
    grid: int = 40
    alternations: int = 3
    false_alarm: float = 0.05


AGREEMENT = Agreement()


@dataclass(frozen=True, eq=False)
class PhysicalFit(Noun):
    """Physically consistent estimate.

    Attributes:
        x: Standard parameters followed by effect coefficients, shape (p,).
        covariance: Posterior covariance, inequalities ignored, shape (p, p).
        note: That floating point ended before the optimum, as a sentence; else empty.
        R: Factor of the whitened columns, shape (rows, p).
        root: L of the prior covariance L Lᵀ at the solution, shape (p, k); k < p with equalities.
        prior: Prior of the bodies.
        undecided: Links that would be far from nominal without `springs`.
        springs: Springs that the data show beside the estimated effects, with values.
    """

    x: Array
    covariance: Array
    R: Array
    root: Array
    prior: BodyPrior
    note: str = ""
    undecided: tuple[str, ...] = ()
    springs: tuple[Effect, ...] = ()

    def estimated(self, effects: Sequence[Effect]) -> tuple[Effect, ...]:
        """Those effects of the model that were estimated; springs come after them."""
        return tuple(effects[: len(effects) - len(self.springs)])

    @property
    def prior_share(self) -> Array:
        """Part of each parameter's uncertainty that no data reduced, shape (p,)."""
        before = (self.root**2).sum(axis=1)
        ratio = quotient(np.diag(self.covariance), before, otherwise=1.0)
        return np.sqrt(np.clip(ratio, 0.0, 1.0))

    @property
    def followed(self) -> float:
        """Directions of the data that the fit follows, each counted by how far it does.

        Coefficients at zero, their least value, follow none.
        """
        free = self.x != 0
        seen = np.linalg.svd(self.R[:, free] @ self.root[free], compute_uv=False)
        return float((seen**2 / (1 + seen**2)).sum())

    def widened(self, times: float) -> Self:
        """The fit with the uncertainty of data that are so many times less certain."""
        R = self.R / times
        seen, Vt = all_directions(R @ self.root)
        after = self.root @ Vt.T / np.hypot(1, seen)
        return replace(self, R=R, covariance=after @ after.T)

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
    if not isinstance(prior, BodyPrior):
        prior = BodyPrior(prior, agreement(R, z, prior))
    names = links or [f"link {k + 1}" for k in range(len(prior.bodies))]
    program, scale, centre = fit_program(
        R, z, prior, effects, knowledge or Knowledge(), names
    )
    solution = solve(program, centre)
    covariance, root = _uncertainty(program, solution.y, scale)
    x = scale @ solution.y
    given = np.concatenate([prior.bodies.ravel(), effects.mean])
    lower = np.concatenate([np.full(prior.bodies.size, -np.inf), effects.lower])
    rounding = _ROUNDING * np.linalg.norm(scale, axis=1)
    x = np.where(np.abs(x - given) < rounding, given, x)
    x = np.where(x - lower < rounding, lower, x)
    return PhysicalFit(
        x=x,
        covariance=covariance,
        R=R,
        root=root,
        prior=prior,
        note="" if solution.settled else _UNSETTLED.format(solution.error),
    )


def fit_program(
    R: Array,
    z: Array,
    prior: BodyPrior,
    effects: EffectPrior,
    knowledge: Knowledge,
    links: Sequence[str],
) -> tuple[Program, Array, Array]:
    """Programme of the fit, x by its unknowns, shape (p, p), and the given arm in them, (p,).

    Arguments and errors as in `fit_physical`.
    """
    nominal = prior.bodies.ravel()
    # units of the effect coefficients that make their columns alike
    squares = (R[:, len(nominal) :] ** 2).sum(axis=0)
    units = np.sqrt(len(R) / (squares + effects.std**-2.0))
    scale = scipy.linalg.block_diag(prior.T, np.diag(units))
    centre = np.concatenate(
        [np.linalg.solve(prior.T, nominal), effects.mean / units]
    )
    C, d, restrictions = _known(
        knowledge, links, prior, effects.lower / units, centre
    )
    program = Program(
        A=R @ scale,
        z=z,
        C=scipy.linalg.block_diag(C, np.diag(units / effects.std)),
        d=np.concatenate([d, effects.mean / effects.std]),
        bodies=prior,
        restrictions=restrictions,
    )
    return program, scale, centre


def agreement(
    R: Array, z: Array, prior: Array, terms: int = 0, own: Sequence[int] = ()
) -> Array:
    """Relative uncertainty σ of each given body under which the data are most likely, (links,).

    Data z = R x + ε, ε of unit variance, with bodies normal around the prior and nothing known of
    effects, have the covariance 1 + Σ_k σ_k² K_k in what no effect explains; σ maximises their
    likelihood (type II maximum likelihood, MacKay 1992): it is how far off the given bodies are
    where the data see them. All links have one σ, but for those that are significantly further
    off: the last, which carries tools that descriptions lack, and others, one by one, counted
    against chance among as many links. No description is taken to be right to better than
    `Agreement.least`. Shapes as in `fit_physical`.

    With the last columns of R, terms for each joint, a torque may act there beside the bodies: σ of
    joints, its size in units of the columns, follow those of the links, 0 where the data call for
    none. Some links, or joints counted after them, may have their own σ from the start.
    """
    links = len(prior)
    blocks, residual = _deviations(R, z, prior, terms)
    most = np.full(links, LARGEST_SIGMA / AGREEMENT.least)
    largest = np.append(largest_uncertainty(prior), most)

    def most_likely(
        block: Array, others: Array, largest: float
    ) -> tuple[float, float]:
        """σ of a block of columns beside others of unit variance, and −2 log likelihood."""
        both = np.vstack([np.eye(len(residual)), others.T])
        root = triangle(both).T
        whitened = scipy.linalg.solve_triangular(root, block, lower=True)
        U, s, _ = np.linalg.svd(whitened)
        power = np.pad(s, (0, len(U) - len(s)))
        seen = (
            U.T @ scipy.linalg.solve_triangular(root, residual, lower=True)
        ) ** 2

        def surprise(log_sigma: float) -> float:
            variance = 1 + (np.exp(log_sigma) * power) ** 2
            return float((np.log(variance) + seen / variance).sum())

        grid = np.log(np.geomspace(AGREEMENT.least, largest, AGREEMENT.grid))
        log_sigma, least = grid_minimum(surprise, grid)
        log_det = np.log(np.abs(np.diag(root))).sum()
        return float(np.exp(log_sigma)), least + 2 * log_det

    def with_own(own: Sequence[int], sigma: Array) -> tuple[float, Array]:
        """The surprise, and σ of every link: those of some, and that of all others."""
        common = [k for k in range(links) if k not in own]
        groups = [*([k] for k in reversed(own)), common]
        sigma = sigma.copy()
        least = np.inf
        for group in groups * (AGREEMENT.alternations if own else 1):
            sigma[group] = 0.0
            beside = np.concatenate(blocks * sigma[:, None, None], axis=1)
            block = np.concatenate(blocks[group], axis=1)
            sigma[group], least = most_likely(block, beside, largest[group].min())
        return least, sigma

    chance = np.full(len(blocks), AGREEMENT.false_alarm / links)
    chance[links - 1] = AGREEMENT.false_alarm
    own = [*own]
    least, sigma = with_own(own, np.zeros(len(blocks)))
    while len(common := [k for k in range(links) if k not in own]) > 1:
        better = []
        for k in range(len(blocks)):
            if k in own:
                continue
            value, trial = with_own([*own, k], sigma)
            significant = least - value > scipy.special.chdtri(1, chance[k])
            others = [j for j in common if j != k]
            if significant and (k >= links or trial[k] > trial[others].max()):
                better.append((value, k, trial))
        if not better:
            break
        least, k, sigma = min(better, key=lambda candidate: candidate[0])
        own.append(k)
    return sigma


def _deviations(
    R: Array, z: Array, prior: Array, terms: int
) -> tuple[Array, Array]:
    """Columns of the links' coordinates and residual of nominal bodies, beyond all effects.

    Those of joints follow, the last columns of R, terms each. Shapes (links, rows, 10) or, with
    joints, (2 links, rows, 10), and (rows,); without rows that no body moves, which tell no σ.
    """
    p = R.shape[1]
    T = link_coordinates(prior)
    size = len(T)
    joints = p - terms * len(prior)
    factor = triangle(np.column_stack([R, z]))[:p]
    free = scipy.linalg.null_space(factor[:, size:joints].T).T
    columns = free @ factor[:, :size] @ T / link_weights(len(prior), 1.0)
    residual = free @ (factor[:, p] - factor[:, :size] @ prior.ravel())
    if terms:
        more = (free @ factor[:, joints:p]).reshape(len(free), -1, terms)
        padded = np.pad(more, ((0, 0), (0, 0), (0, 10 - terms)))
        columns = np.column_stack([columns, padded.reshape(len(free), -1)])
    U, s, _ = np.linalg.svd(columns, full_matrices=False)
    U = U[:, s > _ROUNDING * max(s[:1], default=1.0)]
    blocks = (U.T @ columns).reshape(U.shape[1], columns.shape[1] // 10, 10)
    return blocks.swapaxes(0, 1), U.T @ residual


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
    if known and any(r.violation(centre) > 0 for r in restrictions):
        names = contradiction((*possible(prior, p, _MARGIN), *restrictions))
        if names:
            raise BadInput(f"{knowledge.source}: {_contradictory(names)}")
    return C @ T, d, tuple(restrictions)


def _contradictory(names: Sequence[str]) -> str:
    """What is wrong with these restrictions, and what to do."""
    *most, last = names
    if not most:
        return (
            f"{last} cannot be: no body near the given one fulfils it; correct it"
        )
    return (
        f"{', '.join(most)} and {last} contradict each other: no body near the given one "
        "fulfils them together; correct one of them"
    )


def _scaled(restriction: Restriction, T: Array, p: int) -> Restriction:
    """A restriction of φ as one of y, its rows of about length one, which changes no cone."""
    G = np.zeros((len(restriction.h), p))
    G[:, : len(T)] = restriction.G @ T
    norms = np.linalg.norm(G, axis=1)
    return replace(restriction, G=G / norms[:, None], h=restriction.h / norms)


def _uncertainty(program: Program, y: Array, scale: Array) -> tuple[Array, Array]:
    """Posterior covariance of x at y, and root of the prior's."""
    N = free_directions(program.restrictions, len(scale))
    S = scale @ N
    prior, _ = program.prior(y)
    both = np.vstack([program.A, prior])
    factors = (triangle(rows @ N) for rows in (both, prior))
    after, root = (
        scipy.linalg.solve_triangular(F, S.T, trans=1).T for F in factors
    )
    exactly = _ROUNDING * np.linalg.norm(scale, axis=1)
    root[np.linalg.norm(root, axis=1) <= exactly] = 0.0
    return after @ after.T, root
