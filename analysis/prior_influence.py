"""Which entries of an identified table the prior decides: perturb it and watch what moves.

Two sets of initial values that lead to the same table within a few per cent show nothing: both
may agree where the data are silent. So the prior is moved where the data are silent, along the
null space of the observation matrix and along what it shows worst, and in random directions as
well, always to bodies that can exist; the physically consistent fit is repeated, and each entry
compared with how far its prior was moved: 1, the prior alone decides; 0, the data do. When that
makes an entry the prior's is the rule of `excitant.identify.prior`, which `identify` applies
to linear theory.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy

from excitant.analysis.uncertainty import MotionInformation
from excitant.identify.estimate import Estimate
from excitant.identify.physical import fit_physical
from excitant.identify.prior import (
    DOMINATED,
    KINDS,
    PRIOR_SIGMA,
    UNSEEN,
    UPPER,
    WEAKEST,
    EffectPrior,
    follows,
    link_coordinates,
    link_weights,
    matrices,
    reached,
    silent_columns,
)
from excitant.identify.rows import FitRows
from excitant.robots.motion import Array, freeze

STEP = 0.2  # of a link's inertia in any direction, by which the prior is moved
_NOTHING = 0.01  # of an entry's uncertainty, below which a kind says nothing of it
_DRAWS = 8  # perturbations in the null space, and random ones
_FLAT = 1e-3  # of the prior's second moment in some direction: the body is at its limit

Response = Callable[[Array], Array]
"""How far the estimate moves, shape (p,), when the prior is moved by δ, shape (p,)."""


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known of all parameters x beforehand, as x = mean + L w with w of unit variance.

    Attributes:
        mean: Expected values, shape (p,).
        L: Blocks of ten by ten for each link and a diagonal for effects, shape (p, p).
        links: Number of links.
    """

    mean: Array
    L: Array
    links: int

    def __post_init__(self) -> None:
        freeze(self, "mean", "L")

    @property
    def std(self) -> Array:
        """Standard deviation of each parameter, shape (p,)."""
        return np.asarray(np.linalg.norm(self.L, axis=1), float)

    def directions(self, R: Array) -> tuple[Array, Array]:
        """What data say per unit of w: singular values of R L, and its right vectors as rows."""
        _, s, Vt = np.linalg.svd(R @ self.L)
        return np.pad(s, (0, len(Vt) - len(s))), Vt

    def posterior_std(self, R: Array) -> Array:
        """Standard deviation of each parameter after data, constraints ignored, shape (p,).

        Args:
            R: Factor of the whitened columns, shape (rows, p).
        """
        s, Vt = self.directions(R)
        return np.asarray(np.linalg.norm(self.L @ Vt.T / np.sqrt(1 + s**2), axis=1), float)

    def stretches(self, w: Array) -> Array:
        """Eigenvalues of Q − 1 of each link, as in `fit_physical`, ascending, shape (links, 4)."""
        y = w[: 10 * self.links] / link_weights(self.links, PRIOR_SIGMA)
        return np.asarray(np.linalg.eigvalsh(matrices(y, self.links)), float)

    def size(self, w: Array) -> float:
        """Largest relative change of any link in any direction, or of an effect in its std."""
        largest = np.abs(self.stretches(w)).max(initial=0.0)
        return float(max(largest, np.abs(w[10 * self.links :]).max(initial=0.0)))

    def at_limit(self, x: Array) -> tuple[int, ...]:
        """Links of x that are flat or thin beyond what a body can be, but for a hair.

        Args:
            x: Parameters, shape (p,).
        """
        w = np.asarray(np.linalg.solve(self.L, x - self.mean), float)
        smallest = 1 + self.stretches(w)[:, 0]
        return tuple(int(k) for k in np.flatnonzero(smallest < _FLAT))


def prior_of(phi: Array, effects: EffectPrior) -> Prior:
    """The prior of `fit_physical`.

    Args:
        phi: Consistent standard parameters, shape (links, 10).
        effects: What is known of effect coefficients.
    """
    links = len(phi)
    scale = link_coordinates(phi) / link_weights(links, PRIOR_SIGMA)
    L = scipy.linalg.block_diag(scale, np.diag(effects.std))
    return Prior(np.concatenate([phi.ravel(), effects.mean]), L, links)


@dataclass(frozen=True, eq=False)
class PriorInfluence:
    """How far each parameter follows the prior.

    Attributes:
        ratio: Move of each entry relative to the move of its prior, by kind of perturbation
            (`KINDS`), shape (3, p); NaN where a kind leaves the entry's prior as it is.
        reach: Share of each entry's prior uncertainty that a kind reaches, shape (3, p).
        linear: What the ratio would be without constraints of physics, shape (3, p).
        base_move: Largest move of each base parameter under any perturbation, in its standard
            deviations, shape (r,).
        refits: Number of fits behind it; 0 where the move follows from linear theory.
    """

    ratio: Array
    reach: Array
    linear: Array
    base_move: Array
    refits: int

    def __post_init__(self) -> None:
        freeze(self, "ratio", "reach", "linear", "base_move")

    @property
    def overall(self) -> Array:
        """Largest ratio of the kinds that reach a material part of the entry, shape (p,)."""
        return follows(self.ratio, self.reach)

    @property
    def decided_by(self) -> tuple[str, ...]:
        """Who decides each entry: ``data``, ``prior``, or ``physics``.

        Physics where the prior would decide but the body is at the limit of what can exist, and
        stays there wherever the prior is.
        """
        free = follows(self.linear, self.reach)
        return tuple(
            "prior" if bound > DOMINATED else "physics" if loose > DOMINATED else "data"
            for bound, loose in zip(self.overall, free, strict=True)
        )


def prior_influence(
    information: MotionInformation,
    regrouping: Array,
    prior: Prior,
    x: Array,
    rng: np.random.Generator,
    response: Response | None = None,
) -> PriorInfluence:
    """Move the prior in several directions of each kind and see what the estimate does.

    Args:
        information: What the motion shows.
        regrouping: Base parameters from parameters, shape (r, p).
        prior: What is known beforehand.
        x: Estimate, shape (p,); says what is material of an effect, which has no prior value.
        rng: Draws the directions.
        response: Moves of the estimate by refits; linear theory without constraints if None.
    """
    s, Vt = prior.directions(information.R)
    free = _linear(prior, s, Vt)
    silent = s <= UNSEEN * s.max(initial=0.0)
    null, weak = Vt[silent], Vt[~silent][-WEAKEST:]
    steps = {
        "null space": [rng.normal(size=len(null)) @ null for _ in range(_DRAWS) if len(null)],
        "weakly seen": list(weak),
        "random": [_random_bodies(prior, rng) for _ in range(_DRAWS)],
    }
    p = len(prior.mean)
    ratio, linear, reach = (np.full((len(KINDS), p), np.nan) for _ in range(3))
    base_move, base_std = np.zeros(len(regrouping)), information.std(np.eye(len(regrouping)))
    for k, kind in enumerate(KINDS):
        given = np.array([prior.L @ (STEP * w / prior.size(w)) for w in steps[kind]]).reshape(-1, p)
        moves = np.array([(response or free)(delta) for delta in given]).reshape(-1, p)
        ratio[k] = _ratio(moves, given, prior)
        linear[k] = _ratio(np.array([free(delta) for delta in given]).reshape(-1, p), given, prior)
        relative = np.abs(moves @ regrouping.T) / np.where(base_std > 0, base_std, np.inf)
        base_move = np.maximum(base_move, relative.max(axis=0, initial=0.0))
    reach[:2] = [reached(prior.L, part, x, prior.links) for part in (null, weak)]
    reach[0, silent_columns(information.R)] = 1.0
    reach[2] = np.arange(p) < 10 * prior.links
    ratio[reach < _NOTHING] = linear[reach < _NOTHING] = np.nan
    fits = 0 if response is None else sum(map(len, steps.values()))
    return PriorInfluence(ratio, reach, linear, base_move, fits)


def _ratio(moves: Array, given: Array, prior: Prior) -> Array:
    """How far entries move for how far their prior was moved; NaN where it was not, shape (p,)."""
    got, size = (np.sqrt((values**2).sum(axis=0)) for values in (moves, given))
    unmoved = np.full(len(size), np.nan)
    return np.asarray(np.divide(got, size, out=unmoved, where=size > 1e-9 * prior.std), float)


def _random_bodies(prior: Prior, rng: np.random.Generator) -> Array:
    """Every link changed by the same share in random directions, effects left, shape (p,)."""
    w = np.zeros(len(prior.mean))
    A = rng.normal(size=(prior.links, 4, 4))
    A = A + A.transpose(0, 2, 1)
    A /= np.abs(np.linalg.eigvalsh(A)).max(axis=1)[:, None, None]
    y = A[:, *UPPER].reshape(-1)
    w[: 10 * prior.links] = y * link_weights(prior.links, PRIOR_SIGMA)
    return w


def _linear(prior: Prior, s: Array, Vt: Array) -> Response:
    """Posterior mean of a linear problem: in w it moves by V (1 + s²)⁻¹ Vᵀ of the prior's move."""

    def moved(delta: Array) -> Array:
        w = np.linalg.solve(prior.L, delta)
        return np.asarray(prior.L @ (Vt.T @ ((Vt @ w) / (1 + s**2))), float)

    return moved


def refits(estimate: Estimate, rows: FitRows) -> Response:
    """Moves of an estimate by repeating its physically consistent fit from another prior.

    Distances are measured as around the original prior, so that only its place changes.

    Args:
        estimate: What was identified.
        rows: What it was fitted to.
    """
    R, z = rows.regression.factor(estimate.least_squares.weight)
    phi, effects = estimate.prior.reshape(-1, 10), rows.open_prior
    links = phi.size

    def moved(delta: Array) -> Array:
        other = replace(effects, mean=effects.mean + delta[links:])
        prior = phi + delta[:links].reshape(-1, 10)
        found = fit_physical(
            R, z, prior, other, metric=phi, knowledge=estimate.knowledge, links=estimate.given.links
        )
        return np.asarray(found.x - estimate.physical.x, float)

    return moved
