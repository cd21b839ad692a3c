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
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg

from excitant.exceptions import BadInput, BadRobot
from excitant.identify.knowledge import Box, Ellipsoid, Knowledge, LinkKnowledge, Quantity
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
    knowledge, link_count = knowledge or Knowledge(), len(prior)
    entropic = knowledge.prior == "entropic"
    unit = _effect_units(R[:, 10 * link_count :], effects.std)
    reference = prior if metric is None or entropic else metric
    T = link_coordinates(reference)
    scale = scipy.linalg.block_diag(T, np.diag(unit))
    centre = np.concatenate([np.linalg.solve(T, prior.ravel()), effects.mean / unit])
    C, d, known = known_rows(knowledge, links or [f"link {k + 1}" for k in range(link_count)])
    sigma = np.broadcast_to(np.asarray(prior_sigma, float), (link_count,))
    spread = np.vstack([_prior_rows(reference, T, sigma, knowledge.prior), C @ T])
    weight = unit / effects.std
    bounded, p = np.isfinite(effects.lower), len(centre)
    signs = Restriction(
        "nonnegative", np.eye(p)[T.shape[0] :][bounded], (effects.lower / unit)[bounded]
    )
    restrictions = [signs] if bounded.any() else []
    restrictions += [_scaled(restriction, T, p) for restriction in known]
    smallest = float(np.linalg.eigvalsh(matrices(centre, link_count)).min())
    bodies = definite(link_count, min(MARGIN, 0.5 * smallest), p)
    if known:
        _refuse_contradiction((*bodies, *restrictions), knowledge)
    own = spread[: len(spread) - len(C)] @ centre[: len(T)]
    program = Program(
        A=R @ scale,
        z=z,
        C=scipy.linalg.block_diag(spread, np.diag(weight)),
        d=np.concatenate([own, d, weight * centre[len(T) :]]),
        restrictions=(*(() if entropic else bodies), *restrictions),
        entropy=2 / sigma**2 if entropic else np.zeros(0),
    )
    solution = solve(program, centre)
    covariance, share, root = _uncertainty(program, solution, scale)
    return PhysicalFit(
        scale @ solution.y, covariance, share, solution.kkt(program), R, root, link_count
    )


def _prior_rows(reference: Array, T: Array, sigma: Array, distance: str) -> Array:
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


def _refuse_contradiction(restrictions: Sequence[Restriction], knowledge: Knowledge) -> None:
    names = contradiction(restrictions)
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
    p, masses = 10 * len(links), np.zeros(10 * len(links))
    masses[::10] = 1.0
    about: list[tuple[str, Array, Quantity | None]] = [("total_mass", masses, knowledge.total_mass)]
    restrictions: list[Restriction] = []
    for k, name in enumerate(links):
        known = knowledge.links.get(name, LinkKnowledge())
        about.append((f"mass of {name}", np.eye(p)[10 * k], known.mass))
        for each in _regions(known, name):
            G = np.zeros((len(each.h), p))
            G[:, 10 * k : 10 * k + 10] = each.G
            restrictions.append(Restriction(each.cone, G, each.h, each.name))
    rows, values = [np.zeros((0, p))], [np.zeros(0)]
    for name, row, quantity in about:
        if quantity is None:
            continue
        if quantity.std:
            rows.append(row[None] / quantity.std)
            values.append(np.array([quantity.value / quantity.std]))
        else:
            what, h = f"{name} = {quantity.value:g} kg", np.array([quantity.value])
            restrictions.append(Restriction("zero", row[None], h, what))
    return np.vstack(rows), np.concatenate(values), restrictions


def _regions(known: LinkKnowledge, name: str) -> Iterator[Restriction]:
    """Restrictions of one link's ten parameters."""
    if known.com_box is not None:
        yield from _in_box(known.com_box, f"com_box of {name}")
    if known.com_ellipsoid is not None:
        yield _in_ellipsoid(known.com_ellipsoid, f"com_ellipsoid of {name}")
    if known.body_ellipsoid is not None:
        yield _body_within(known.body_ellipsoid, f"body_ellipsoid of {name}")


def _in_box(box: Box, name: str) -> Iterator[Restriction]:
    """Centre of mass in a box; where it has no width, a coordinate is known."""
    first, mass = np.eye(10)[1:4], np.eye(10)[0]
    low, high = np.array(box.low), np.array(box.high)
    flat = low == high
    G = np.vstack([first - np.outer(low, mass), np.outer(high, mass) - first])
    wide = np.concatenate([~flat, ~flat])
    if wide.any():
        yield Restriction("nonnegative", G[wide], np.zeros(int(wide.sum())), name)
    if flat.any():
        yield Restriction("zero", G[:3][flat], np.zeros(int(flat.sum())), name)


def _in_ellipsoid(ellipsoid: Ellipsoid, name: str) -> Restriction:
    first, mass = np.eye(10)[1:4], np.eye(10)[0]
    centre, radii = np.array(ellipsoid.centre), np.array(ellipsoid.radii)
    offset = (first - np.outer(centre, mass)) / radii[:, None]
    return Restriction("second_order", np.vstack([mass, offset]), np.zeros(4), name)


def _body_within(ellipsoid: Ellipsoid, name: str) -> Restriction:
    centre, weight = np.array(ellipsoid.centre), np.array(ellipsoid.radii) ** -2.0
    E = np.zeros((4, 4))
    E[:3, :3] = -np.diag(weight)
    E[:3, 3] = E[3, :3] = weight * centre
    E[3, 3] = 1 - weight @ centre**2
    row = np.einsum("kij,ij->k", PSEUDO_INERTIA_BASIS, E)
    return Restriction("nonnegative", row[None], np.zeros(1), name)
