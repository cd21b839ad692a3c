"""Prior knowledge of an arm, and the identified entries that follow it.

The bodies of the given arm are known to a relative σ. With the pseudo-inertia of link k written
P_k = L_k Q_k L_kᵀ, L_k L_kᵀ that of the given body made `isotropic` (the same mass, centre of mass
and radius of gyration), the coordinates y are the upper triangles of all Q_k: they have no units,
‖Q − Q̄‖_F is a distance to the given body Q̄ that depends on no frame (constant pull-back of the
affine-invariant metric: Lee, Wensing, Park 2020), and an error of the centre of mass counts alike
along a thin link and across it. The density of the prior is

    −2 log p(P) = Σ_k ‖Q_k − Q̄_k‖_F² / σ² + 2 n KL(P_k ‖ P̄_k),

with the entropic distance 2 KL = tr(P̄⁻¹ P) − log det(P̄⁻¹ P) − 4 (of normal distributions), by which
no body collapses: it grows without bound as P becomes singular. Its weight is that of one draw,
n = 1, for n draws from P̄ look like draws from P with probability exp(−n KL) (Sanov's theorem); or
n = 1 / σ² where σ > 1, so that it never says more than σ does.

Rule for entries: the prior x = x̄ + L w, w of unit variance, is moved where the data are silent (the
null space of R L), along what they show worst, and at random. An entry is the prior's when it
follows by more than half in any of these ways that reaches at least a quarter of its uncertainty.
In linear theory the estimate moves by L V (1 + s²)⁻¹ Vᵀ w, where R L = U diag(s) Vᵀ;
`excitant.analysis` repeats the fit instead.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from excitant.exceptions import BadRobot
from excitant.identify.information import Information, gaussian
from excitant.robots.base_parameters import BaseParameters
from excitant.robots.effects import Effect
from excitant.robots.motion import (
    Array,
    Mask,
    Motion,
    Noun,
    quotient,
    root_mean_square,
)
from excitant.robots.parameters import (
    PLACEHOLDER,
    PSEUDO_INERTIA_BASIS,
    from_pseudo_inertia,
    isotropic,
    nearest_consistent,
    pseudo_inertia,
)
from excitant.robots.robot import Robot
from excitant.robots.torque import effect_values, observation_columns, torque

PRIOR_SIGMA = (
    1.0  # relative std of nominal bodies; decides only what the data leave open
)
LARGEST_SIGMA = 10.0  # ±100 kg for 10 kg is as good as no nominal body
UPPER = np.triu_indices(4)  # of Q: its coordinates
NORMS = np.where(UPPER[0] == UPPER[1], 1.0, np.sqrt(2.0))  # Σ (norm · y)² = ‖Q‖_F²
SYMMETRIC = np.zeros((10, 4, 4))  # Q = Σ_k y_k · SYMMETRIC[k]
for _k, (_i, _j) in enumerate(zip(*UPPER, strict=True)):
    SYMMETRIC[_k, _i, _j] = SYMMETRIC[_k, _j, _i] = 1.0


@dataclass(frozen=True)
class ReferenceMotion:
    """What an arm is assumed to move like where no motion is given.

    Attributes:
        harmonics: Sines in the position of each joint.
        limit_share: Share of the limits on speed and acceleration that is used,
        range_share: and of the position limits.
        idle: Torque of a joint without load, as a share of the largest torque needed and of its
            own limit.
        rows: Rows at most; of a motion of more, 2000 per harmonic stand for all.
    """

    harmonics: int = 5
    limit_share: float = 0.5
    range_share: float = 0.9
    idle: float = 1e-2
    rows: int = 10_000


REFERENCE = ReferenceMotion()

DOMINATED = 0.5  # influence from which an entry counts as the prior's
SHARED = 0.1  # from which it lies between data and prior
WEAKEST = 4  # directions seen worst, of all seen
# singular value relative to the largest, up to which a direction is not seen
UNSEEN = 1e-9
# of an entry's uncertainty: less means a move of less than 5 % of the entry
_MATERIAL = 0.25


def placeholder_links(robot: Robot) -> Mask:
    """Links of whose bodies the robot says nothing, shape (nv,): those of no mass worth the name.

    All of them where none has a mass, or three or more have the same, as in no real arm.
    """
    mass = robot.phi[::10]
    if np.allclose(mass, mass[0], rtol=1e-6) and (len(mass) > 2 or not mass.any()):
        return np.ones(len(mass), bool)
    return mass < PLACEHOLDER * mass.sum()


def prior_parameters(robot: Robot) -> Array:
    """The robot's standard parameters, shape (nv, 10), impossible bodies moved to possible ones.

    A link that is lighter than a `PLACEHOLDER` is as heavy as that, with its own shape or, without
    any mass, as a ball around its joint; where no link has a mass worth the name, each has 1 kg.

    Raises:
        BadRobot: A link of negative mass.
    """
    phi = np.array(robot.phi.reshape(robot.nv, 10))
    mass = phi[:, 0].copy()
    for link, value in zip(robot.links, mass, strict=True):
        if value < 0:
            raise BadRobot(
                robot.source, f"link '{link}' has mass {value:g} kg; correct it"
            )
    total = mass.sum()
    described = total > 1e-3 * robot.nv  # kg
    least = PLACEHOLDER * total if described else 1.0
    # radius of gyration about an axis [m]
    ball = np.diag([0.1**2, 0.1**2, 0.1**2, 1.0])
    phi[mass == 0] = from_pseudo_inertia(least * ball)
    phi *= np.maximum(1.0, least / phi[:, 0])[:, None]
    return np.array([nearest_consistent(body) for body in phi])


def largest_uncertainty(bodies: Array) -> Array:
    """Largest relative uncertainty of each given body, (links, 10), shape (links,).

    A lighter link than the mean may be off by as much as that one, for it may carry a tool.
    """
    return LARGEST_SIGMA * np.maximum(1.0, bodies[:, 0].mean() / bodies[:, 0])


def link_weights(links: int, sigma: float | Array) -> Array:
    """Square roots of the precision 1/σ² of the coordinates y, shape (10 links,)."""
    return np.outer(1 / np.broadcast_to(sigma, links), NORMS).ravel()


def link_coordinates(reference: Array) -> Array:
    """Map T, φ = T y, to standard parameters; y is relative to consistent ones, (links, 10)."""
    bodies = [pseudo_inertia(isotropic(body)) for body in reference]
    roots = np.linalg.cholesky(bodies)
    blocks = [from_pseudo_inertia(L @ SYMMETRIC @ L.T).T for L in roots]
    return scipy.linalg.block_diag(*blocks)


def matrices(y: Array, links: int) -> Array:
    """The matrices Q_k of the coordinates that y begins with, shape (links, 4, 4)."""
    Q = y[: 10 * links].reshape(links, 10) @ SYMMETRIC.reshape(10, 16)
    return Q.reshape(links, 4, 4)


def relative_rows(C: Array) -> Array:
    """Rows R_k of bodies relative to those of pseudo-inertia C Cᵀ, shape (links, 10, 10).

    R_k φ_k is the upper triangle of C⁻¹ P C⁻ᵀ times `NORMS`; C is triangular, (links, 4, 4).
    """
    inverse = np.linalg.inv(C)[:, None]
    basis = inverse @ PSEUDO_INERTIA_BASIS @ inverse.swapaxes(2, 3)
    relative = basis[..., *UPPER]
    return NORMS[:, None] * relative.swapaxes(1, 2)


@dataclass(frozen=True, eq=False)
class BodyPrior:
    """Density of bodies around given ones, as squares of residuals (module docstring).

    Attributes:
        bodies: Standard parameters P̄ of the given bodies, consistent, shape (links, 10).
        sigma: Relative uncertainty σ, for all links or for each.
        metric: Bodies that σ is relative to, shape (links, 10); the given ones if None.
    """

    bodies: Array
    sigma: float | Array = PRIOR_SIGMA
    metric: Array | None = None

    @cached_property
    def T(self) -> Array:
        """Map of coordinates, φ = T y, shape (10 links, 10 links)."""
        return link_coordinates(self.bodies if self.metric is None else self.metric)

    @cached_property
    def draws(self) -> Array:
        """Weight n of the entropic distance, shape (links,)."""
        sigma = np.broadcast_to(self.sigma, len(self.bodies))
        return np.minimum(1.0, sigma**-2.0)

    @cached_property
    def _distance(self) -> Array:
        weights = link_weights(len(self.bodies), self.sigma)
        return weights[:, None] * np.linalg.inv(self.T)

    @cached_property
    def _roots(self) -> Array:
        return np.linalg.inv(np.linalg.cholesky(pseudo_inertia(self.bodies)))

    def surprise(self, phi: Array) -> float:
        """−2 log p at consistent φ, shape (10 links,)."""
        distance = self._distance @ (phi - self.bodies.ravel())
        P = pseudo_inertia(phi.reshape(-1, 10))
        roots = np.linalg.cholesky(self._roots @ P @ self._roots.swapaxes(1, 2))
        trace = (roots**2).sum(axis=(1, 2))
        log_det = 2 * np.log(np.diagonal(roots, axis1=1, axis2=2)).sum(axis=1)
        return float(distance @ distance + self.draws @ (trace - log_det - 4))

    def quadratic(self, phi: Array) -> tuple[Array, Array]:
        """Rows J and r, ‖r + J dφ‖² + constant being −2 log p to second order."""
        distance = self._distance @ (phi - self.bodies.ravel())
        entropic, rows = self.entropic(phi)
        J = np.vstack([self._distance, scipy.linalg.block_diag(*rows)])
        return np.concatenate([distance, entropic]), J

    def entropic(self, phi: Array, barrier: float = 0.0) -> tuple[Array, Array]:
        """Those of the entropic distance, and of so many times −log det P of every link.

        Rows of each link stand by themselves, shape (links, 10, 10).
        """
        draws = self.draws[:, None]
        weight = draws + barrier
        scale = np.sqrt(weight / 2)
        P = pseudo_inertia(phi.reshape(-1, 10))
        C = np.asarray(np.linalg.cholesky(P), float)
        roots = self._roots @ C
        # the nominal body relative to φ
        Q = (roots.swapaxes(1, 2) @ roots)[:, *UPPER]
        residual = scale * NORMS * (draws / weight * Q - np.eye(4)[UPPER])
        return residual.ravel(), scale[:, :, None] * relative_rows(C)


@dataclass(frozen=True, eq=False)
class EffectPrior:
    """Expected values of effect coefficients, standard deviations and least values, each (e,)."""

    mean: Array
    std: Array
    lower: Array


@dataclass(frozen=True, eq=False)
class BasePrior(Noun):
    """Normal distribution of the base parameters: mean, shape (r,), covariance (regular)."""

    mean: Array
    covariance: Array

    def information(self) -> Information:
        """The same in square-root form."""
        return gaussian(self.mean, self.covariance)


def base_prior(
    robot: Robot,
    effects: Sequence[Effect],
    base: BaseParameters,
) -> BasePrior:
    """The given robot as a prior of its base parameters.

    Coefficients of effects are those of the robot where it has them, else zero, give or take one
    that makes all torque of its joint.

    Raises:
        BadRobot: A link of negative mass.
    """
    phi = prior_parameters(robot)
    T = link_coordinates(phi)
    links = T @ np.diag(link_weights(robot.nv, PRIOR_SIGMA) ** -2.0) @ T.T
    nominal = effect_values(robot)
    names = base.names[10 * robot.nv :]
    mean = np.concatenate([phi.ravel(), [nominal.get(name, 0.0) for name in names]])
    variances = _effect_sizes(robot, effects) ** 2
    covariance = scipy.linalg.block_diag(links, np.diag(variances))
    B = base.regrouping
    total = B @ covariance @ B.T
    return BasePrior(B @ mean, (total + total.T) / 2)


def needed_torque(robot: Robot, motion: Motion) -> Array:
    """Rms torque that an arm such as this needs for a motion, shape (nv,) [N·m or N].

    Its bodies are those of the prior, made `isotropic`: no description is sure of an inertia so
    small that it needs no torque. A joint without load still has friction, and a strong drive.
    """
    bodies = [isotropic(body) for body in prior_parameters(robot)]
    tau = torque(robot.with_parameters(bodies), motion)
    limit = robot.limits.torque
    needed = root_mean_square(tau)
    strong = np.maximum(needed.max(), np.where(np.isfinite(limit), limit, 0.0))
    return np.maximum(needed, REFERENCE.idle * strong)


def _effect_sizes(robot: Robot, effects: Sequence[Effect]) -> Array:
    """Coefficients that would make as much torque as a reference motion needs, shape (e,)."""
    motion = reference_motion(robot, 10.0, 20.0)
    columns = observation_columns(robot, effects, motion)[:, :, 10 * robot.nv :]
    size = root_mean_square(columns)
    needed = needed_torque(robot, motion)[:, None]
    coefficients = quotient(needed, size, otherwise=np.inf)
    smallest = coefficients.min(axis=0, initial=np.inf)
    return np.where(np.isfinite(smallest), smallest, 1.0)


def reference_motion(robot: Robot, duration: float, rate_hz: float) -> Motion:
    """All joints moving at once at half their limits: what a motion of this length can show.

    Sums of five harmonics around the middle of the position limits, always the same for an arm.
    """
    rng = np.random.default_rng(0)
    t = np.arange(0, duration, 1 / rate_hz)
    harmonics = np.arange(1, REFERENCE.harmonics + 1)
    omega = (2 * np.pi / duration * harmonics)[:, None]
    phase = rng.uniform(0, 2 * np.pi, (len(omega), robot.nv))
    size = rng.uniform(0.5, 1.0, phase.shape) / omega
    angle = omega * t[:, None, None] + phase
    q, dq, ddq = (
        (size * omega**k * np.sin(angle + k * np.pi / 2)).sum(axis=1)
        for k in range(3)
    )
    limits = robot.limits
    low, high = np.clip(limits.position, -np.pi, np.pi).T
    scale = np.min(
        [
            REFERENCE.range_share * (high - low) / 2 / np.abs(q).max(axis=0),
            REFERENCE.limit_share * limits.usual_speed / np.abs(dq).max(axis=0),
            REFERENCE.limit_share
            * limits.usual_acceleration
            / np.abs(ddq).max(axis=0),
        ],
        axis=0,
    )
    return Motion(t, (low + high) / 2 + scale * q, scale * dq, scale * ddq)


def follows(ratio: Array, reach: Array) -> Array:
    """Largest ratio of the kinds that reach a material part of an entry, at most 1, shape (p,).

    Ratios compare the move of an entry with that of its prior; NaN where a kind leaves it. Reach
    is the share of its uncertainty that a kind reaches. Both have shape (kinds, p).
    """
    counted = np.where((reach >= _MATERIAL) & np.isfinite(ratio), ratio, 0.0)
    return np.clip(counted.max(axis=0), 0.0, 1.0)


def decided_by(influence: Array, category: Sequence[str]) -> tuple[str, ...]:
    """Who decided entries that follow the prior by 0 to 1: data, prior, or both together, (p,).

    Torque shows a `combined` parameter only together with others, so that the prior shares it out
    however little the entry follows, and an `unidentifiable` one not at all.
    """

    def who(value: float, category: str) -> str:
        if value > DOMINATED or category == "unidentifiable":
            return "prior"
        return "both" if value > SHARED or category == "combined" else "data"

    return tuple(map(who, influence.tolist(), category))


def reached(L: Array, directions: Array, x: Array, links: int) -> Array:
    """Share of each entry's uncertainty in some directions of w, at most 1, shape (p,).

    An effect has no prior value; its estimate x, after those of links, is what a share of it is
    compared with. L is a root of the prior covariance, (p, k); directions are rows, (d, k).
    """
    spread = np.linalg.norm(L @ directions.T, axis=1)
    size = np.linalg.norm(L, axis=1)
    effects = slice(10 * links, None)
    size[effects] = np.minimum(
        size[effects], np.abs(x[effects]) + 1e-6 * size[effects]
    )
    return np.minimum(quotient(spread, size), 1.0)


def all_directions(A: Array) -> tuple[Array, Array]:
    """Singular values, (p,), zero where A has fewer than p, and all right vectors, (p, p)."""
    _, s, Vt = np.linalg.svd(A)
    return np.pad(s, (0, len(Vt) - len(s))), Vt


def silent_columns(R: Array) -> Mask:
    """Columns that make no torque, shape (p,)."""
    norms = np.linalg.norm(R, axis=0)
    return norms <= 1e-11 * norms.max(initial=0.0)  # rounding


def linear_influence(R: Array, L: Array, x: Array, links: int) -> Array:
    """Sensitivity of each entry to the prior in linear theory, 0 to 1, shape (p,).

    An entry that is known exactly beforehand follows by 1. R is a factor of the whitened columns,
    shape (rows, p); the rest as in `reached`.
    """
    s, Vt = all_directions(R @ L)
    seen = s > UNSEEN * s.max(initial=0.0)
    directions = L @ Vt.T
    moves = directions / (1 + s**2)
    weak = np.flatnonzero(seen)[-WEAKEST:]
    unseen = reached(L, Vt[~seen], x, links)
    unseen[silent_columns(R)] = 1.0
    random = np.arange(len(x)) < 10 * links
    reach = np.array([unseen, reached(L, Vt[weak], x, links), random])
    sizes = np.linalg.norm(L, axis=1)
    total = quotient(np.linalg.norm(moves, axis=1), sizes)
    weak_sizes = np.linalg.norm(directions[:, weak], axis=1)
    weakly = quotient(np.linalg.norm(moves[:, weak], axis=1), weak_sizes)
    ratio = np.array([np.ones(len(x)), weakly, total])
    return np.where(sizes > 0, follows(ratio, reach), 1.0)
