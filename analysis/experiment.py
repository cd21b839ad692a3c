"""A planned or recorded experiment, and the influence of the prior on its result.

The prior is perturbed along the null space of the observation matrix, along its weakest directions
and in random ones, always to physically consistent bodies; the fit is repeated, and the change of
each parameter divided by that of its prior: 1, the prior alone decides; 0, the data do.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy

from excitant.analysis.thresholds import RESOLUTION
from excitant.analysis.uncertainty import (
    PAYLOAD_KG,
    MotionInformation,
    known_values,
    motion_information,
    scale_deviation,
    torque_noise,
    without_rounding,
)
from excitant.exceptions import BadRobot
from excitant.identify.physical import fit_physical
from excitant.identify.prior import (
    KINDS,
    PRIOR_SIGMA,
    UNSEEN,
    WEAKEST,
    BodyPrior,
    EffectPrior,
    decided_by,
    follows,
    prior_parameters,
    reached,
    silent_columns,
)
from excitant.identify.regression import dense
from excitant.identify.rows import FitRows, fit_rows, implausible_size, units_of
from excitant.robots.base_parameters import BaseParameters
from excitant.robots.effects import Effect
from excitant.robots.motion import Array, Motion
from excitant.robots.parameters import from_pseudo_inertia, pseudo_inertia
from excitant.robots.robot import Robot
from excitant.robots.torque import observation_columns, torque

if TYPE_CHECKING:
    from excitant.identify.estimate import Estimate

_IGNORED_REACH = (
    0.01  # of a parameter's uncertainty: a kind that reaches less is ignored
)
_PERTURBATIONS = 8  # in the null space, and random ones

Response = Callable[[Array], Array]
"""Change of the estimate, shape (p,), when the prior is changed by δ, shape (p,)."""


@dataclass(frozen=True, eq=False)
class Prior:
    """Prior of all parameters x, as x = mean + L w with w of unit variance."""

    mean: Array  # shape (p,)
    L: Array  # blocks of ten by ten for each link and a diagonal for effects, shape (p, p)
    links: int  # number of links

    def directions(self, R: Array) -> tuple[Array, Array]:
        """Information per unit of w: singular values of R L, and its right vectors as rows."""
        _, s, Vt = np.linalg.svd(R @ self.L)
        return np.pad(s, (0, len(Vt) - len(s))), Vt

    def posterior_std(self, R: Array) -> Array:
        """Standard deviation of each parameter after data, constraints ignored, shape (p,)."""
        s, Vt = self.directions(R)
        return np.asarray(
            np.linalg.norm(self.L @ Vt.T / np.sqrt(1 + s**2), axis=1), float
        )

    def stretches(self, w: Array) -> Array:
        """Eigenvalues of P̄⁻¹ P − 1 of each link, P̄ that of the prior, ascending, (links, 4)."""
        change = pseudo_inertia((self.L @ w)[: 10 * self.links].reshape(-1, 10))
        roots = np.linalg.inv(np.linalg.cholesky(self.bodies))
        return np.asarray(
            np.linalg.eigvalsh(roots @ change @ roots.swapaxes(1, 2)), float
        )

    @property
    def bodies(self) -> Array:
        """Pseudo-inertias of the given links, shape (links, 4, 4)."""
        return pseudo_inertia(self.mean[: 10 * self.links].reshape(-1, 10))

    def size(self, w: Array) -> float:
        """Largest relative change of any link in any direction, or of an effect in its std."""
        return float(
            np.abs(np.append(self.stretches(w), w[10 * self.links :])).max(
                initial=0.0
            )
        )

    def at_limit(self, x: Array) -> tuple[int, ...]:
        """Links of x, shape (p,), at the limit of physical consistency: almost flat or thin."""
        w = np.asarray(np.linalg.solve(self.L, x - self.mean), float)
        smallest = 1 + self.stretches(w)[:, 0]
        return tuple(int(k) for k in np.flatnonzero(smallest < RESOLUTION.flat))


def prior_of(
    phi: Array, effects: EffectPrior, sigma: float | Array = PRIOR_SIGMA
) -> Prior:
    """The prior of `fit_physical`, of consistent standard parameters, shape (links, 10)."""
    _, J = BodyPrior(phi, sigma).quadratic(phi.ravel())
    root = np.linalg.inv(np.linalg.qr(J, mode="r"))
    L = scipy.linalg.block_diag(root, np.diag(effects.std))
    return Prior(np.concatenate([phi.ravel(), effects.mean]), L, len(phi))


@dataclass(frozen=True, eq=False)
class PriorInfluence:
    """Sensitivity of each parameter to the prior, by kind of perturbation (`KINDS`)."""

    ratio: Array  # change of each parameter over that of its prior, (3, p); NaN where that is 0
    reach: Array  # share of each parameter's prior uncertainty that a kind reaches, (3, p)
    linear: (
        Array  # ratio without the constraints of physical consistency, shape (3, p)
    )
    base_move: (
        Array  # largest change of each base parameter, in standard deviations, (r,)
    )
    refits: int  # number of refits; 0 where the change follows from linear theory

    @property
    def overall(self) -> Array:
        """Largest ratio of the kinds with a material reach, shape (p,)."""
        return follows(self.ratio, self.reach)

    @property
    def decided_by(self) -> tuple[str, ...]:
        """Source of each parameter: ``data``, ``prior``, ``both``, or ``physics`` for the prior.

        There the body is at the limit of what is possible, and stays so for any prior.
        """
        free = decided_by(follows(self.linear, self.reach))
        return tuple(
            "physics" if loose == "prior" != bound else bound
            for bound, loose in zip(decided_by(self.overall), free, strict=True)
        )


def prior_influence(
    information: MotionInformation,
    regrouping: Array,
    prior: Prior,
    x: Array,
    rng: np.random.Generator,
    response: Response | None = None,
) -> PriorInfluence:
    """Change of the estimate x (p,) when the prior is perturbed in directions of each kind.

    Regrouping (r, p) gives base parameters; without a response by refits, linear theory is used.
    """
    s, Vt = prior.directions(information.R)
    silent = s <= UNSEEN * s.max(initial=0.0)
    null = Vt[silent]
    weak = Vt[~silent][-WEAKEST:]
    p = len(prior.mean)
    steps = {  # projected, so that they do not depend on the basis of the null space
        "null space": [
            rng.normal(size=p) @ null.T @ null
            for _ in range(_PERTURBATIONS)
            if len(null)
        ],
        "weakly seen": list(weak),
        "random": [_random_bodies(prior, rng) for _ in range(_PERTURBATIONS)],
    }
    ratio, linear, reach = (np.full((len(KINDS), p), np.nan) for _ in range(3))
    base_move = np.zeros(len(regrouping))
    base_std = information.std(np.eye(len(regrouping)))
    for k, kind in enumerate(KINDS):
        w = np.array(
            [RESOLUTION.prior_step * w / prior.size(w) for w in steps[kind]]
        ).reshape(-1, p)
        steps_of_prior = w @ prior.L.T
        free = (w @ Vt.T / (1 + s**2)) @ Vt @ prior.L.T
        moves = (
            free
            if response is None
            else np.array([response(delta) for delta in steps_of_prior])
        )
        moves = moves.reshape(-1, p)
        ratio[k], linear[k] = (
            _ratio(each, steps_of_prior, prior) for each in (moves, free)
        )
        relative = np.abs(moves @ regrouping.T) / np.where(
            base_std > 0, base_std, np.inf
        )
        base_move = np.maximum(base_move, relative.max(axis=0, initial=0.0))
    reach[:2] = [reached(prior.L, part, x, prior.links) for part in (null, weak)]
    reach[0, silent_columns(information.R)] = 1.0
    reach[2] = np.arange(p) < 10 * prior.links
    ratio[reach < _IGNORED_REACH] = linear[reach < _IGNORED_REACH] = np.nan
    fits = 0 if response is None else sum(map(len, steps.values()))
    return PriorInfluence(ratio, reach, linear, base_move, fits)


def _ratio(moves: Array, steps: Array, prior: Prior) -> Array:
    """Change of parameters over that of their prior; NaN where that is unchanged, (p,)."""
    moved, size = (np.sqrt((values**2).sum(axis=0)) for values in (moves, steps))
    unmoved = np.full(len(size), np.nan)
    std = np.linalg.norm(prior.L, axis=1)
    return np.asarray(
        np.divide(moved, size, out=unmoved, where=size > 1e-9 * std), float
    )


def _random_bodies(prior: Prior, rng: np.random.Generator) -> Array:
    w = np.zeros(len(prior.mean))
    A = rng.normal(size=(prior.links, 4, 4))
    A = A + A.transpose(0, 2, 1)
    A /= np.abs(np.linalg.eigvalsh(A)).max(axis=1)[:, None, None]
    root = np.linalg.cholesky(prior.bodies)
    change = from_pseudo_inertia(root @ A @ root.swapaxes(1, 2)).ravel()
    w[: len(change)] = np.linalg.solve(
        prior.L[: len(change), : len(change)], change
    )
    return w


def refits(estimate: Estimate, rows: FitRows) -> Response:
    """Response of an estimate to another prior by a refit, in the metric of the original one."""
    R, z = rows.regression.factor(estimate.least_squares.weight)
    phi = estimate.physical.prior.bodies
    effects = rows.open_prior
    links = phi.size
    body_prior = estimate.physical.prior

    def moved(delta: Array) -> Array:
        other = replace(effects, mean=effects.mean + delta[links:])
        prior = replace(
            body_prior, bodies=phi + delta[:links].reshape(-1, 10), metric=phi
        )
        fit = fit_physical(
            R, z, prior, other, estimate.knowledge, estimate.given.links
        )
        return np.asarray(fit.x - estimate.physical.x, float)

    return moved


@dataclass(frozen=True, eq=False)
class Experiment:
    """A motion with its noise, and what is known of the p parameters."""

    sigma: Array  # noise of the measured joints' torque, per independent row, shape (rows,) [N·m]
    information: MotionInformation
    x: Array  # values of all parameters, zero where unknown, shape (p,)
    known: tuple[bool, ...]  # which of them are known
    beta: Array  # values of the base parameters, shape (r,)
    prior: Prior | None  # knowledge without data; None where a link has no mass
    # standard deviation of each parameter as told, prior included, shape (p,)
    std: Array | None
    influence: PriorInfluence | None
    motion: Motion  # or the longest stretch of a recording
    q: Array  # positions at all rows, shape (n, nv) [rad or m]
    basis: str  # where the standard deviations come from, as a sentence
    notes: Sequence[str] = ()
    # factor and unit of each parameter, if not its own
    told: Sequence[tuple[float, str]] = ()

    @property
    def resting(self) -> tuple[int, ...]:
        """Joints that do not move."""
        return tuple(
            int(j)
            for j in np.flatnonzero(np.ptp(self.q, axis=0) < RESOLUTION.rests)
        )


def planned_experiment(
    robot: Robot,
    base: BaseParameters,
    effects: Sequence[Effect],
    motion: Motion,
    noise: Sequence[float] | None,
    rows: list[int],
) -> Experiment:
    """A motion to judge before it is run, torque measured at the joints of ``rows``."""
    sigma = torque_noise(robot, noise)[rows]
    W = observation_columns(robot, effects, motion)[:, rows]
    information = motion_information(base, W, sigma)
    values = known_values(robot, effects)
    x = np.array([value or 0.0 for value in values])
    notes: list[str] = []
    prior = None
    influence = None
    try:
        size = implausible_size(
            W[:, :, 10 * robot.nv :], torque(robot, motion)[:, rows]
        )
        nothing = EffectPrior(
            np.zeros_like(size), size, np.full_like(size, -np.inf)
        )
        prior = prior_of(prior_parameters(robot), nothing)
        influence = prior_influence(
            information, base.regrouping, prior, x, np.random.default_rng(0)
        )
    except BadRobot as error:
        notes.append(f"the prior is left out: {error.why}")
    how = (
        "as given"
        if noise is not None
        else f"of {100 * RESOLUTION.torque_noise:g} % of each limit"
    )
    return Experiment(
        sigma=sigma,
        information=information,
        x=x,
        known=tuple(value is not None for value in values),
        beta=base.regrouping @ x,
        prior=prior,
        std=None if prior is None else prior.posterior_std(information.R),
        influence=influence,
        motion=motion,
        q=motion.q,
        basis=f"for torque noise {how}, independent at each of {len(motion)} instants",
        notes=notes,
    )


def recorded_experiment(
    robot: Robot,
    base: BaseParameters,
    estimate: Estimate,
    rng: np.random.Generator | None = None,
) -> Experiment:
    """Experiment of an estimate; with a generator, the prior's influence is from refits."""
    fit = estimate.least_squares
    effects = estimate.model.effects
    rows = cleaned(fit_rows(robot, effects, estimate.base, estimate.data))
    sigma = fit.sigma * np.sqrt(fit.inflation)
    complete = estimate.base.columns == base.columns
    information = motion_information(
        base, rows.W, sigma, fit.covariance if complete else None
    )
    prior = prior_of(
        estimate.physical.prior.bodies,
        rows.open_prior,
        estimate.physical.prior.sigma,
    )
    x = estimate.physical.x
    response = None if rng is None else refits(estimate, rows)
    draws = np.random.default_rng(0) if rng is None else rng
    influence = prior_influence(
        information, base.regrouping, prior, x, draws, response
    )
    notes = []
    if flat := prior.at_limit(x):
        names = ", ".join(robot.links[k] for k in flat)
        notes.append(
            f"at the limit of physical consistency: {names}; the data alone would go beyond"
        )
    if estimate.data.unit == "A":
        notes.append(
            "torque was recorded as current: all values share one scale that currents do not "
            f"show; a known payload of {PAYLOAD_KG:g} kg would determine it to "
            f"±{100 * scale_deviation(robot, effects, sigma):.2g} % in ten seconds of motion of "
            "all joints"
        )
    return Experiment(
        sigma=sigma,
        information=information,
        x=x,
        known=(True,) * len(base.names),
        beta=fit.beta if complete else base.regrouping @ x,
        prior=prior,
        std=estimate.std,
        told=units_of(estimate.given, effects, estimate.drive),
        influence=influence,
        motion=max((s.motion for s in estimate.data.train), key=len),
        q=np.concatenate([s.motion.q[s.keep] for s in estimate.data.train]),
        basis="from the residual of the recording, with its autocorrelation",
        notes=notes,
    )


def cleaned(rows: FitRows) -> FitRows:
    """The rows with columns that are rounding alone set to zero."""
    regression = rows.regression
    clean = dense(
        without_rounding(regression.W),
        regression.tau,
        regression.names,
        regression.used,
    )
    return replace(rows, regression=clean)
