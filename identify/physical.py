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

The consistent parameters are fitted directly, never projected afterwards (Sousa and Cortesão 2014).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from excitant.exceptions import BadInput, BadRobot
from excitant.identify.knowledge import Knowledge, LinkKnowledge
from excitant.identify.prior_rule import DOMINATED, linear_influence
from excitant.identify.semidefinite import (
    MARGIN,
    KktResiduals,
    Program,
    Restriction,
    Solution,
    contradiction,
    definite,
    link_coordinates,
    link_weights,
    matrices,
    solve,
)
from excitant.robots.motion import Array, freeze, read_only
from excitant.robots.parameters import (
    PSEUDO_INERTIA_BASIS,
    nearest_consistent,
    pseudo_inertia,
)
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
    names = links or [f"link {k + 1}" for k in range(len(prior))]
    sigma = np.broadcast_to(np.asarray(prior_sigma, float), (len(prior),))
    reference = prior if metric is None or knowledge.prior == "entropic" else metric
    units = _effect_units(R[:, prior.size :], effects.std)
    T = link_coordinates(reference)
    scale = scipy.linalg.block_diag(T, np.diag(units))
    centre = np.concatenate([np.linalg.solve(T, prior.ravel()), effects.mean / units])
    distance = _distance_rows(reference, T, sigma, knowledge.prior)
    C, d, restrictions = _known(knowledge, names, T, effects.lower / units, centre)
    weight = units / effects.std
    program = Program(
        A=R @ scale,
        z=z,
        C=scipy.linalg.block_diag(np.vstack([distance, C]), np.diag(weight)),
        d=np.concatenate([distance @ centre[: len(T)], d, weight * centre[len(T) :]]),
        restrictions=restrictions,
        entropy=2 / sigma**2 if knowledge.prior == "entropic" else np.zeros(0),
    )
    solution = solve(program, centre)
    covariance, share, root = _uncertainty(program, solution, scale)
    kkt = solution.kkt(program)
    return PhysicalFit(scale @ solution.y, covariance, share, kkt, R, root, len(prior))


def _known(
    knowledge: Knowledge, links: Sequence[str], T: Array, lower: Array, centre: Array
) -> tuple[Array, Array, tuple[Restriction, ...]]:
    """Rows C y ≈ d of unit noise about the links' coordinates, and what all of y must satisfy.

    Raises:
        BadInput: Knowledge that no body fulfils, or about other links.
    """
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
    entropic = knowledge.prior == "entropic"
    return C @ T, d, (*(() if entropic else bodies), *restrictions)


def _distance_rows(reference: Array, T: Array, sigma: Array, distance: str) -> Array:
    """Rows whose squares are the distance to the prior over σ², about the links' coordinates."""
    if distance == "euclidean":
        # m, m r and m r², r the radius of gyration about the joint's frame
        mass = reference[:, :1]
        second = np.trace(pseudo_inertia(reference)[:, :3, :3], axis1=1, axis2=2)[:, None]
        units = mass * np.sqrt(second / mass) ** np.array([0, 1, 1, 1, *(2,) * 6])
        return np.asarray(T / (units * sigma[:, None]).ravel()[:, None], float)
    return np.diag(link_weights(len(reference), sigma))[: 0 if distance == "entropic" else None]


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


def _uncertainty(program: Program, solution: Solution, scale: Array) -> tuple[Array, Array, Array]:
    """Posterior covariance, the share of the prior's std that is left, root of the prior's."""
    curved = program.local(solution.y)
    exact = [r.G for r in program.restrictions if r.cone == "zero"]
    N = scipy.linalg.null_space(np.vstack(exact)) if exact else np.eye(len(solution.y))
    S = scale @ N
    data = np.linalg.qr(np.vstack([program.A, curved.C]) @ N, mode="r")
    after = scipy.linalg.solve_triangular(data, S.T, trans=1)
    covariance = after.T @ after
    before = np.linalg.qr(curved.C @ N, mode="r")
    root = scipy.linalg.solve_triangular(before, S.T, trans=1).T
    root[np.linalg.norm(root, axis=1) <= _ROUNDING * np.linalg.norm(scale, axis=1)] = 0.0
    prior = (root**2).sum(axis=1)
    variance = np.diag(covariance)
    ratio = np.divide(variance, prior, out=np.ones_like(prior), where=prior > 0)
    return covariance, np.asarray(np.clip(np.sqrt(np.maximum(ratio, 0)), 0, 1), float), root


def known_rows(
    knowledge: Knowledge, links: Sequence[str]
) -> tuple[Array, Array, list[Restriction]]:
    """Knowledge about the links of an arm: rows C φ ≈ d of unit noise, and what holds exactly.

    All of it is convex in the standard parameters: masses and their sum are linear; a centre of
    mass c in a box is m c_lo ≤ m c ≤ m c_hi; in an ellipsoid of radii r around c₀ it is the
    second-order cone ‖(m c − m c₀) / r‖ ≤ m; and a body of positive density inside an ellipsoid
    exists for P ≻ 0 exactly when tr(P E) ≥ 0, the mean of 1 − ‖(x − c₀) / r‖² over its mass
    (Wensing, Kim, Slotine 2018).

    Raises:
        BadInput: Knowledge of a link that the arm does not have.
    """
    for name in knowledge.links:
        if name not in links:
            raise BadInput(f"{knowledge.source}: links: the arm has no link '{name}'")
    p = 10 * len(links)
    of_link = {f"mass of {name}": row for name, row in zip(links, np.eye(p)[::10], strict=True)}
    mass_rows = {"total_mass": np.sum(list(of_link.values()), axis=0)} | of_link
    rows, values = [np.zeros((0, p))], [np.zeros(0)]
    restrictions: list[Restriction] = []
    for name, mass in knowledge.masses.items():
        row = mass_rows[name][None]
        if mass.std:
            rows.append(row / mass.std)
            values.append(np.array([mass.value / mass.std]))
        else:
            what = f"{name} = {mass.value:g} kg"
            restrictions.append(Restriction("zero", row, np.array([mass.value]), what))
    for name, known in knowledge.links.items():
        own = slice(10 * links.index(name), 10 * links.index(name) + 10)
        for each in _regions(known, name):
            G = np.zeros((len(each.h), p))
            G[:, own] = each.G
            restrictions.append(replace(each, G=G))
    return np.vstack(rows), np.concatenate(values), restrictions


def _regions(known: LinkKnowledge, name: str) -> Iterator[Restriction]:
    """Restrictions of one link's ten parameters."""
    mass, first = np.eye(10)[0], np.eye(10)[1:4]
    if known.com_box is not None:
        # where the box has no width, a coordinate is known
        low, high = np.array(known.com_box.low), np.array(known.com_box.high)
        flat = low == high
        G = np.array([first - np.outer(low, mass), np.outer(high, mass) - first])
        for cone, rows in (("nonnegative", G[:, ~flat].reshape(-1, 10)), ("zero", G[0, flat])):
            if len(rows):
                yield Restriction(cone, rows, np.zeros(len(rows)), f"com_box of {name}")
    if known.com_ellipsoid is not None:
        centre, radii = np.array(known.com_ellipsoid.centre), np.array(known.com_ellipsoid.radii)
        offset = (first - np.outer(centre, mass)) / radii[:, None]
        G = np.vstack([mass, offset])
        yield Restriction("second_order", G, np.zeros(4), f"com_ellipsoid of {name}")
    if known.body_ellipsoid is not None:
        centre, radii = np.array(known.body_ellipsoid.centre), np.array(known.body_ellipsoid.radii)
        to_unit = np.column_stack([np.diag(1 / radii), -centre / radii])
        E = np.diag([0.0, 0.0, 0.0, 1.0]) - to_unit.T @ to_unit
        row = np.einsum("kij,ij->k", PSEUDO_INERTIA_BASIS, E)
        yield Restriction("nonnegative", row[None], np.zeros(1), f"body_ellipsoid of {name}")
