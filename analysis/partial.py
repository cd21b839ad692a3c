"""What a recording shows, when its motion does not show everything."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from excitant.analysis.practical import shown_base, without_rounding
from excitant.identify.estimate import Estimate, judged
from excitant.identify.least_squares import weighted_least_squares
from excitant.identify.physical import fit_physical, prior_parameters
from excitant.identify.recording import Recording
from excitant.identify.regression import dense, observation
from excitant.identify.rows import FitRows, fit_rows, split
from excitant.robots.effects import Effect, standard_effects
from excitant.robots.robot import Robot
from excitant.robots.torque import column_names


def identify_shown(
    robot: Robot,
    recordings: Sequence[Recording],
    effects: Sequence[Effect] | None = None,
    *,
    validate: Sequence[Recording] = (),
) -> Estimate:
    """Identify the base parameters that a recording's own motion has, be they few.

    Base parameters are taken from the recorded rows in place of random states, so that a motion
    that rests a joint is no error; what it leaves open stays at the prior.

    Args:
        robot: The arm; its inertias are the prior.
        recordings: What to fit.
        effects: Effects to estimate; friction, offset and rotor inertia when None.
        validate: What to judge on; the last 30 % of each recording when empty.

    Raises:
        BadRecording: Recordings that cannot be used.
        BadRobot: Links without mass, so no prior.
        Infeasible: The semidefinite solver failed.
    """
    prior = prior_parameters(robot)
    effects = standard_effects(robot.joints) if effects is None else tuple(effects)
    data = split(recordings, validate)
    W = without_rounding(observation(robot, effects, data.train))
    rows = clean_rows(fit_rows(robot, effects, shown_base(column_names(robot, effects), W), data))
    fit = weighted_least_squares(rows.reduced)
    R, z = rows.regression.factor(fit.weight)
    physical = fit_physical(R, z, prior, rows.open_prior)
    return judged(robot, rows, fit, physical, (data.holdout,))


def clean_rows(rows: FitRows) -> FitRows:
    """The rows without columns that are rounding alone, of which nothing is known beforehand."""
    known = rows.regression
    clean = dense(without_rounding(known.W), known.tau, known.names, known.starts)
    return replace(rows, regression=clean)
