"""Physically consistent identification: a semidefinite least-squares fit of all parameters.

With the pseudo-inertia of link k written P_k = L_k Q_k L_kᵀ, where L_k L_kᵀ is the prior's,

    minimise  ‖R x − z‖² + Σ_k D(Q_k) / σ_k² + Σ_i (θ_i − θ̄_i)² / s_i² + Σ_m (m − m̄)² / s_m²
    subject to  Q_k ⪰ ε 1,  θ ≥ bounds,  and what else is known of the bodies,

where ‖R x − z‖² is the whitened data (a QR factor of it, so the size of the problem does not
grow with the recording) and x holds the standard parameters φ and the effect coefficients θ.
Distance D to the prior is one of

    pullback   ‖Q − 1‖_F², coordinate-invariant (the constant pull-back of the affine-invariant
               metric: Lee, Wensing, Park 2020),
    entropic   2 (tr Q − log det Q − 4), the relative entropy of the bodies' densities, alike to
               second order (Lee and Park 2018); it needs no ε,
    euclidean  Σ_i (φ_i − φ̄_i)² / u_i², u the units by each link's mass and radius of gyration.

The consistent parameters are fitted directly, never projected afterwards. Sousa and Cortesão 2014
for the fit itself; `excitant.identify.physical_knowledge` for what is known of bodies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg

from excitant.exceptions import BadInput, BadRobot
from excitant.identify.knowledge import Knowledge
from excitant.identify.physical_coordinates import (
    link_coordinates,
    link_weights,
    matrices,
    plain_units,
)
from excitant.identify.physical_entropy import local, solve_entropic
from excitant.identify.physical_knowledge import known_rows
from excitant.identify.physical_program import (
    KktResiduals,
    Program,
    Restriction,
    Solution,
    contradiction,
    kkt,
    solve,
)
from excitant.identify.prior_rule import DOMINATED, linear_influence
from excitant.robots.motion import Array, freeze, read_only
from excitant.robots.parameters import nearest_consistent
from excitant.robots.robot import Robot

__all__ = [
    "PRIOR_SIGMA",
    "EffectPrior",
    "KktResiduals",
    "PhysicalFit",
    "fit_physical",
    "link_coordinates",
    "link_weights",
    "prior_parameters",
]

PRIOR_SIGMA = 1.0  # links are known to about ±100 %; decides only what the data leave open
_ROUNDING = 1e-10  # of a parameter's unit, up to which it is known exactly
_MARGIN = 1e-4  # smallest eigenvalue of Q: no link shrinks below this part of its prior


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
        covariance: Posterior covariance (data, prior and equalities; inequalities ignored),
            shape (p, p).
        prior_share: Part of each parameter's uncertainty that no data reduced, shape (p,).
        kkt: Residuals of the optimality conditions.
        R: Factor of the whitened columns, shape (rows, p).
        root: L of the prior covariance L Lᵀ at the solution, shape (p, k); k < p with equalities.
        links: Number of links.
    """

    x: Array
    covariance: Array
    prior_share: Array
    kkt: KktResiduals
    R: Array
    root: Array
    links: int

    def __post_init__(self) -> None:
        freeze(self, "x", "covariance", "prior_share", "R", "root")

    @cached_property
    def influence(self) -> Array:
        """How far each parameter follows the prior in linear theory, 0 to 1, shape (p,)."""
        return read_only(linear_influence(self.R, self.root, self.x, self.links))

    @property
    def prior_dominated(self) -> tuple[bool, ...]:
        """Whether the prior rather than the data decides each parameter."""
        return tuple(bool(each > DOMINATED) for each in self.influence)


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
        metric: Bodies that σ is relative to, shape (links, 10); those of the prior if None. Of
            no account to an entropic prior.
        knowledge: What is known of the bodies beforehand, and the kind of prior.
        links: Names of the links that knowledge is about, in order.

    Raises:
        BadInput: Knowledge that no body fulfils, or about other links.
        Infeasible: The solver did not converge.
    """
    knowledge = knowledge or Knowledge()
    entropic = knowledge.prior == "entropic"
    unit = _effect_units(R[:, 10 * len(prior) :], effects.std)
    reference = prior if metric is None or entropic else metric
    T = link_coordinates(reference)
    scale = scipy.linalg.block_diag(T, np.diag(unit))
    centre = np.concatenate([np.linalg.solve(T, prior.ravel()), effects.mean / unit])
    names = links or [f"link {k + 1}" for k in range(len(prior))]
    program = _program(
        R @ scale, z, reference, prior_sigma, effects, centre, scale, knowledge, names
    )
    _refuse_contradiction(program, knowledge)
    solution = (solve_entropic if entropic else solve)(program, centre)
    covariance, share, root = _uncertainty(program, solution, scale)
    return PhysicalFit(
        scale @ solution.y, covariance, share, kkt(program, solution), R, root, len(prior)
    )


def _program(
    A: Array,
    z: Array,
    reference: Array,
    sigma: float | Array,
    effects: EffectPrior,
    centre: Array,
    scale: Array,
    knowledge: Knowledge,
    names: Sequence[str],
) -> Program:
    """The fit in coordinates y, x = scale · y, where the prior lies at the centre."""
    links, p, size = len(reference), len(centre), 10 * len(reference)
    unit, T = np.diag(scale)[size:], scale[:size, :size]
    known = known_rows(knowledge, names)
    each = np.broadcast_to(np.asarray(sigma, float), (links,))
    if knowledge.prior == "euclidean":
        spread = (plain_units(reference) * each[:, None]).ravel()
        C = T / spread[:, None]
    else:
        C = np.diag(link_weights(links, each))[: 0 if knowledge.prior == "entropic" else size]
    d = C @ centre[:size]
    weight = unit / effects.std
    rows = scipy.linalg.block_diag(np.vstack([C, known.C @ T]), np.diag(weight))
    bounded = np.isfinite(effects.lower)
    signs = Restriction("nonnegative", np.eye(p)[size:][bounded], (effects.lower / unit)[bounded])
    smallest = min(np.linalg.eigvalsh(Q)[0] for Q in matrices(centre, links))
    return Program(
        A=A,
        z=z,
        C=rows,
        d=np.concatenate([d, known.d, weight * centre[size:]]),
        links=links,
        margin=min(_MARGIN, 0.5 * float(smallest)),
        restrictions=(
            *((signs,) if bounded.any() else ()),
            *(_scaled(restriction, T, p) for restriction in known.restrictions),
        ),
        entropy=2 / each**2 if knowledge.prior == "entropic" else None,
    )


def _scaled(restriction: Restriction, T: Array, p: int) -> Restriction:
    """A restriction of φ as one of y, its rows of about length one, which changes no cone."""
    G = np.zeros((len(restriction.h), p))
    G[:, : len(T)] = restriction.G @ T
    norms = np.linalg.norm(G, axis=1, keepdims=True)
    if restriction.cone == "second_order":
        norms = np.full_like(norms, norms.max())
    return Restriction(restriction.cone, G / norms, restriction.h / norms[:, 0], restriction.name)


def _effect_units(R: Array, std: Array) -> Array:
    """Units of the effect coefficients that make their columns alike, shape (e,)."""
    norms = np.sqrt((R**2).sum(axis=0) + std**-2.0)
    return np.asarray(np.sqrt(len(R)) / norms, float)


def _refuse_contradiction(program: Program, knowledge: Knowledge) -> None:
    if not any(restriction.name for restriction in program.restrictions):
        return
    names = contradiction(program)
    if not names:
        return
    what = " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
    together = "contradict each other" if len(names) > 1 else "cannot be"
    raise BadInput(
        f"{knowledge.source}: {what} {together}: no body near the given one fulfils "
        f"{'them together; correct one of them' if len(names) > 1 else 'it; correct it'}"
    )


def _uncertainty(program: Program, solution: Solution, scale: Array) -> tuple[Array, Array, Array]:
    """Posterior covariance, the share of the prior's std that is left, root of the prior's."""
    curved = local(program, solution.y)
    exact = [r.G for r in program.restrictions if r.cone == "zero"]
    N = scipy.linalg.null_space(np.vstack(exact)) if exact else np.eye(len(solution.y))
    before = N.T @ (curved.C.T @ curved.C) @ N
    after = N.T @ (program.A.T @ program.A) @ N + before
    S = scale @ N
    covariance = S @ np.linalg.inv(after) @ S.T
    unit = np.sqrt(np.diag(before))
    K = np.linalg.cholesky(before / np.outer(unit, unit))
    root = scipy.linalg.solve_triangular(K, (S / unit).T, lower=True).T
    root[np.linalg.norm(root, axis=1) <= _ROUNDING * np.linalg.norm(scale, axis=1)] = 0.0
    prior = (root**2).sum(axis=1)
    variance = np.diag(covariance)
    ratio = np.divide(variance, prior, out=np.ones_like(prior), where=prior > 0)
    return covariance, np.asarray(np.clip(np.sqrt(np.maximum(ratio, 0)), 0, 1), float), root
