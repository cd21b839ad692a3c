"""`identify --online`: a recording played through the estimator, as an `Estimate` and as JSON."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from excitant.identify.differentiator_table import (
    differentiator_result,
    differentiator_series,
    differentiator_table,
)
from excitant.identify.estimate import Estimate, judged
from excitant.identify.least_squares import LeastSquares
from excitant.identify.physical import fit_physical, prior_parameters
from excitant.identify.recording import Recording
from excitant.identify.replay import OnlineRun, joined, replay
from excitant.identify.result import identify_result
from excitant.identify.rows import fit_rows, fitted, split
from excitant.robots.base_parameters import base_parameters
from excitant.robots.effects import Effect, standard_effects
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

_KEPT = 100  # looks written to result.json


@dataclass(frozen=True, eq=False)
class OnlineIdentification:
    """What was identified on line, judged as an estimate from the whole recording is.

    Attributes:
        estimate: Physically consistent model and its accuracy.
        run: The estimator's way there.
    """

    estimate: Estimate
    run: OnlineRun


def identify_online(
    robot: Robot,
    recordings: Sequence[Recording],
    *,
    validate: Sequence[Recording] = (),
    effects: Sequence[Effect] | None = None,
    cutoff_hz: float | None = None,
    forgetting: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> OnlineIdentification:
    """Identify a robot as if the samples came one by one.

    Args:
        robot: The arm; its inertias are the prior.
        recordings: What to fit, one after the other.
        validate: What to judge on; the last 30 % of each recording when empty.
        effects: Effects to estimate; friction, offset and rotor inertia when None.
        cutoff_hz: Cut-off of the torque filter that accuracy is judged under [Hz].
        forgetting: Time constant of forgetting [s]; nothing is forgotten when None.
        progress: Told the fraction done.

    Raises:
        BadRecording: Recordings that cannot be used.
        BadRobot: Links without mass, so no prior.
        Infeasible: The semidefinite solver failed.
    """
    effects = standard_effects(robot.joints) if effects is None else tuple(effects)
    prior = prior_parameters(robot)
    data = split(recordings, validate, cutoff_hz)
    base = base_parameters(robot, effects)
    rows = fit_rows(robot, effects, base, data)
    run = replay(
        robot, joined(fitted(recordings, validate)), effects=effects, base=base,
        forgetting=forgetting, gains=rows.gains, progress=progress,
    )  # fmt: skip
    last, known = run.estimate, run.estimate.data
    physical = fit_physical(known.R @ base.regrouping, known.z, prior, rows.open_prior)
    fit = LeastSquares(last.beta, last.covariance, last.sigma, last.inflation)
    estimate = judged(robot, rows, fit, physical, (data.holdout, run.differentiator))
    return OnlineIdentification(estimate, run)


def online_result(found: OnlineIdentification) -> dict[str, Any]:
    """Machine-readable result: that of `identify` and the way there."""
    run, result = found.run, identify_result(found.estimate)
    looks = run.looks[:: max(1, -(-len(run.looks) // _KEPT))]
    if looks[-1] is not run.looks[-1]:
        looks = (*looks, run.looks[-1])
    result["estimator"] = (
        "recursive least squares in square-root information form, on line; "
        "then physically consistent semidefinite fit"
    )
    result["online"] = {
        "delay_s": run.delay,
        "differentiator": run.differentiator,
        "messages": [{"t": float(t), "text": text} for t, text in run.messages],
        "converged": run.looks[-1].converged,
        "history": {
            "t": [float(look.estimate.t) for look in looks],
            "value": [look.estimate.beta.tolist() for look in looks],
            "std": [look.estimate.std.tolist() for look in looks],
            "excitation_level": [
                None if look.excitation is None else look.excitation.level for look in looks
            ],
            "torque_uncertainty": [look.uncertainty.tolist() for look in looks],
            "noise": [look.estimate.sigma.tolist() for look in looks],
        },
    }
    table = differentiator_table(run.recording, run.differentiator)
    result["differentiators"] = differentiator_result(table)
    return result


def online_series(run: OnlineRun) -> dict[str, Array]:
    """For figures: estimates over time, ``online_t`` (k,), values and std (k, r); and more.

    What more: the curves of `excitant.identify.differentiator_table.differentiator_series`.
    """
    table = differentiator_table(run.recording, run.differentiator)
    return differentiator_series(table) | {
        "online_t": np.array([look.estimate.t for look in run.looks]),
        "online_value": np.array([look.estimate.beta for look in run.looks]),
        "online_std": np.array([look.estimate.std for look in run.looks]),
    }
