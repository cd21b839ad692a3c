"""Effects whose columns rest on the torque of the arm, and what fits of all parameters share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.linalg

from excitant.identify.knowledge import Knowledge
from excitant.identify.least_squares import LeastSquares, weighted_least_squares
from excitant.identify.physical import fit_physical
from excitant.identify.rows import FitRows, observation, open_prior
from excitant.robots.base_parameters import base_parameters
from excitant.robots.effects import Effect
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

_ROUNDS = 2  # until the torque that columns hold is that of the identified arm


def resting(
    robot: Robot, rows: FitRows, prior: Array, knowledge: Knowledge
) -> tuple[Robot, FitRows]:
    """The arm that effects take their torque from, and the rows with columns for that arm.

    Columns of load, delay or elasticity hold the torque of the arm, from which that of the given
    one may be far off. The arm is identified without them first, then with those that it calls for
    itself.

    Args:
        robot: The arm as given.
        rows: What is fitted.
        prior: Standard parameters of the prior, shape (nv, 10).
        knowledge: What is known of the bodies.
    """
    if not any(effect.depends_on_model for effect in rows.effects):
        return robot, rows
    reference = _fitted(robot, _of_motion(robot, rows), prior, knowledge)
    for round_ in range(_ROUNDS):
        W = observation(reference, rows.effects, rows.data.to_fit)
        rows = replace(rows, W=W, open_prior=open_prior(robot, rows.effects, W, rows.tau))
        if round_ + 1 < _ROUNDS:
            reference = _fitted(robot, rows, prior, knowledge)
    return reference, rows


def _of_motion(robot: Robot, rows: FitRows) -> FitRows:
    """The rows without the columns of effects that rest on torque."""
    effects = tuple(e for e in rows.effects if not e.depends_on_model)
    kept = list(range(10 * robot.nv))
    at = len(kept)
    for effect in rows.effects:
        count = len(effect.parameters(robot))
        kept += range(at, at + count) if effect in effects else ()
        at += count
    W, base = rows.W[:, :, kept], base_parameters(robot, effects)
    prior = open_prior(robot, effects, W, rows.tau)
    return replace(rows, effects=effects, base=base, W=W, open_prior=prior)


def _fitted(robot: Robot, rows: FitRows, prior: Array, knowledge: Knowledge) -> Robot:
    """The arm that weighted least squares and the semidefinite fit come to."""
    fit = weighted_least_squares(rows.W[:, :, rows.base.columns], rows.tau, rows.base.expressions)
    R, z = whitened(rows.W, rows.tau, fit)
    found = fit_physical(R, z, prior, rows.open_prior, knowledge=knowledge, links=robot.links)
    return identified_robot(robot, rows.effects, found.x)


def whitened(W: Array, tau: Array, fit: LeastSquares) -> tuple[Array, Array]:
    """QR factor (R, z) of the weighted problem, so that ‖R x − z‖² is −2 log-likelihood.

    Autocorrelated residuals count by their number of independent samples.
    """
    weight = 1 / (fit.sigma * np.sqrt(fit.inflation))
    rows = np.concatenate([W, tau[:, :, None]], axis=2) * weight[:, None]
    flat = rows.reshape(-1, rows.shape[2])
    R = np.asarray(scipy.linalg.qr(flat, mode="r")[0], float)[: rows.shape[2]]
    return R[:, :-1], R[:, -1]


def identified_robot(robot: Robot, effects: Sequence[Effect], x: Array) -> Robot:
    """The robot with identified inertias and effects; x as in `PhysicalFit`."""
    valued, start = [], 10 * robot.nv
    for effect in effects:
        count = len(effect.parameters(robot))
        valued.append(effect.with_values(x[start : start + count]))
        start += count
    return robot.with_parameters(x[: 10 * robot.nv]).with_effects(valued)
