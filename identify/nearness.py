"""What the data alone say: of a mass that the fit moved by half, of values that none can have.

Torque shows sums of masses and first moments along an arm, which the prior shares out: a link that
it moved far is further off than the others are likely to be, and not always one that the data ask
to move. The mass nearest to the given one is looked for at which the data are fitted as well,

    ‖R x − z‖² ≤ minimum + χ²   subject to   |m_k c − m_k c̄| ≤ m_k L / 2,

the centre of mass within half of the link's length L of the given one along each axis, without a
prior of the bodies. It is a conic programme in the standard parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from excitant.exceptions import BadInput
from excitant.identify.knowledge import Box, Knowledge, LinkKnowledge
from excitant.identify.least_squares import LeastSquares
from excitant.identify.physical import PhysicalFit, fit_program
from excitant.identify.prior import EffectPrior
from excitant.identify.semidefinite import Program, least_misfit, least_value
from excitant.robots.base_parameters import BaseParameters, categories
from excitant.robots.effects import Effect
from excitant.robots.motion import Array
from excitant.robots.parameters import inertia
from excitant.robots.robot import Robot

LARGE_CHANGE = 0.5
"""Of a nominal mass or of a link's length: it is named."""
CHANCE = 3.84
"""Growth of ‖R x − z‖² that is chance: the 95 % quantile of chi-square, one parameter."""
SHORT = 1 / 16
"""Of the logarithm of a mass between half off and fitted: 2.0 kg for 0.2 is told to 13 %."""
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


def needed_masses(
    fit: PhysicalFit,
    R: Array,
    z: Array,
    effects: EffectPrior,
    knowledge: Knowledge,
    robot: Robot,
) -> dict[str, float]:
    """Masses [kg], nearest to the given ones that the data allow, of links that moved by half.

    By name of the link; those are left out of which the data allow that they stay within half. A
    mass is told just short of the fitted one where the data exclude all before it, as where they
    ask for another centre of mass. Arguments as in `fit_physical`.
    """
    bodies = fit.prior.bodies
    nominal = bodies[:, 0]
    mass = fit.x[: bodies.size : 10]
    moved = np.abs(mass - nominal) >= LARGE_CHANGE * nominal
    moved &= [link not in knowledge.links for link in robot.links]
    if not moved.any():
        return {}
    centres = bodies[:, 1:4] / bodies[:, :1]
    reach = LARGE_CHANGE * link_lengths(robot, bodies)

    def program(known: Knowledge) -> tuple[Program, Array, Array]:
        return fit_program(R, z, fit.prior, effects, known, robot.links)

    whole, scale, centre = program(knowledge)
    misfit = least_misfit(whole, centre) + CHANCE
    if np.isnan(misfit):
        return {}
    found = {}
    for k in np.flatnonzero(moved).tolist():
        link = robot.links[k]
        low = centres[k] - reach[k]
        high = centres[k] + reach[k]
        if (region := knowledge.regions.get(link)) is not None:
            low = np.maximum(low, region.low)
            high = np.minimum(high, region.high)
        if (low > high).any():
            continue
        box = Box(tuple(low.tolist()), tuple(high.tolist()))
        near = LinkKnowledge(com_box=box)
        try:
            stays, _, _ = program(
                replace(knowledge, links={**knowledge.links, link: near})
            )
        except BadInput:
            continue
        sign = np.sign(mass[k] - nominal[k])
        # of a mass that rose; of one that fell, minus the largest
        least = least_value(stays, sign * scale[10 * k], misfit, centre)
        nearest = (1 + sign * LARGE_CHANGE) * nominal[k]
        if least > sign * nearest:
            last = mass[k] * (nearest / mass[k]) ** SHORT
            found[link] = float(sign * min(least, sign * last))
    return found
