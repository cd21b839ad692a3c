"""Identification of what a recorded motion excites, however little that is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from excitant.analysis.uncertainty import cleaned, shown_base, without_rounding
from excitant.identify.estimate import Estimate, judged
from excitant.identify.knowledge import Knowledge
from excitant.identify.least_squares import weighted_least_squares
from excitant.identify.physical import fit_physical
from excitant.identify.preprocessing import certain_rows
from excitant.identify.prior import prior_parameters
from excitant.identify.recording import Recording
from excitant.identify.regression import regression_of
from excitant.identify.rows import effects_of, fit_rows, split
from excitant.robots.effects import Effect
from excitant.robots.robot import Robot
from excitant.robots.torque import column_names


def identify_shown(
    robot: Robot,
    recordings: Sequence[Recording],
    effects: Sequence[Effect] | None = None,
    *,
    validate: Sequence[Recording] = (),
    cutoff_hz: float | None = None,
) -> Estimate:
    """Identify the base parameters that a recording's own motion excites, however few.

    Base parameters follow from the recorded rows in place of random states, so that a joint at
    rest is no error; what the motion does not determine stays at the prior.

    Arguments are those of `identify_robot`.

    Raises:
        BadRecording: Recordings that cannot be used.
        BadRobot: A link of negative mass.
    """
    prior = prior_parameters(robot)
    effects = effects_of(robot, effects)
    data = split(recordings, validate, cutoff_hz)
    used = certain_rows(effects, robot.joints, data.train)
    W = without_rounding(regression_of(robot, effects, data.train).counting(used).W)
    rows = cleaned(
        fit_rows(robot, effects, shown_base(column_names(robot, effects), W), data)
    )
    fit = weighted_least_squares(rows.reduced)
    R, z = rows.regression.factor(fit.weight)
    knowledge = Knowledge().of(robot)
    physical = fit_physical(R, z, prior, rows.open_prior, knowledge, robot.links)
    estimate = judged(robot, rows, fit, physical, (data.holdout,))
    return replace(estimate, knowledge=knowledge)
