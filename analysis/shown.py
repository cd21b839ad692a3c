"""Identification of what a recorded motion excites, however little that is."""

from collections.abc import Sequence
from dataclasses import replace

from excitant.analysis.uncertainty import cleaned, shown_base
from excitant.identify.estimate import Estimate, estimate_by
from excitant.identify.least_squares import weighted_least_squares
from excitant.identify.recording import Recording
from excitant.identify.rows import effects_of, fit_rows, split
from excitant.robots.base_parameters import base_parameters
from excitant.robots.effects import Effect
from excitant.robots.robot import Robot


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
    effects = effects_of(robot, effects)
    data = split(recordings, validate, cutoff_hz)
    rows = fit_rows(robot, effects, base_parameters(robot, effects), data)
    rows = cleaned(rows)
    rows = replace(rows, base=shown_base(rows.regression.names, rows.W))
    fit = weighted_least_squares(rows.reduced)
    whitened = rows.regression.factor(fit.weight)
    return estimate_by(robot, rows, fit, whitened, (data.holdout,))
