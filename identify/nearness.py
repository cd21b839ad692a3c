"""What the data say that the bodies of no arm can have, and which change of a link is large."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

from excitant.identify.least_squares import LeastSquares
from excitant.robots.base_parameters import BaseParameters, categories
from excitant.robots.effects import Effect
from excitant.robots.motion import Array
from excitant.robots.parameters import inertia
from excitant.robots.robot import Robot

LARGE_CHANGE = 0.5
"""Of a nominal mass or of a link's length: it is named."""
IMPOSSIBLE_BY_CHANCE = 0.05
"""Probability that any possible coefficient is said to be none, of all of them; convention."""


def impossible_values(
    robot: Robot, effects: Sequence[Effect], base: BaseParameters, fit: LeastSquares
) -> tuple[int, ...]:
    """Base parameters that are a coefficient alone, estimated below its least value beyond chance.

    A rotor inertia, say, that is negative: the model lacks what the data hold in its place, as a
    spring or hysteresis, and the physically consistent fit keeps to the least value.
    """
    lower = np.full(len(base.names), -np.inf)
    lower[10 * robot.nv :] = [p.lower for e in effects for p in e.parameters(robot)]
    category = categories(base)
    alone = [category[k] == "unique" for k in base.columns]
    least = np.where(alone, lower[list(base.columns)], -np.inf)
    tried = max(np.isfinite(least).sum(), 1)
    beyond = fit.beta - scipy.special.ndtri(IMPOSSIBLE_BY_CHANCE / tried) * fit.std
    return tuple(np.flatnonzero(beyond < least).tolist())


def link_lengths(robot: Robot, bodies: Array) -> Array:
    """Lengths of links with these bodies, shape (nv, 10), each the longest of three, (nv,) [m].

    From the joint to the next one, to the centre of mass, or the radius of gyration.
    """
    places = list(robot.model.jointPlacements)
    lengths = []
    for k, phi in enumerate(bodies):
        body = inertia(phi)
        next_joint = [place.translation for place in places[k + 2 : k + 3]]
        radius = np.sqrt(np.trace(body.inertia) / 2 / body.mass)
        ends = (np.linalg.norm(end) for end in (body.lever, *next_joint))
        lengths.append(max(radius, *ends))
    return np.array(lengths)
