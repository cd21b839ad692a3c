"""Which estimators can be compared on an inner hold-out, with the rows that each is fitted to.

Weighted least squares and robust regression need rows alone. Instrumental variables and output
error are for errors of the motion and take part where a test finds such; maximum likelihood
averages periods and takes part where the motion repeats. `ols` and `tls` assume more than `wls` and
gain nothing by it, and `gls` counts slow misfit for little, which is what most of a prediction's
error consists of (on seven hold-outs of real arms its error was 1.1 to 3.1 times that of `wls`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from excitant.exceptions import BadInput, BadRecording, ExcitantError, RankDeficient
from excitant.identify.estimators import ESTIMATORS, errors_in_variables, half_columns
from excitant.identify.estimators.closed_loop import closed_loop, motion_reach
from excitant.identify.estimators.of_rows import regression_of
from excitant.identify.estimators.output_error import output_error
from excitant.identify.estimators.periodic import AveragedRows, averaged_rows
from excitant.identify.estimators.regression import Regression
from excitant.identify.estimators.unfiltered import unfiltered_positions, with_recordings
from excitant.identify.inner_holdout import (
    Entrant,
    Indices,
    InnerHoldout,
    every,
    phases,
    stretches,
)
from excitant.identify.preprocessing import POSITION_RATIO
from excitant.identify.recording import Recording
from excitant.identify.rows import FitRows
from excitant.robots.motion import Array
from excitant.robots.robot import Robot
from excitant.robots.simulation import STEP

DEFAULT = "wls"
RIVALS = ("irls",)

_INSTANTS = 800  # at most, evenly taken: enough to tell estimators apart
_AVERAGED = 2400  # the same where periods are averaged, which uses all rows
_CERTAIN = 0.01  # chance of a false alarm of the test for errors in the motion
_SAMPLES = 30_000  # of the recordings together, above which looking at them again costs seconds
_STEPS = 25_000  # of a simulation, above which output error costs half a minute
_ROUNDING = 1e-6  # of a step


@dataclass(frozen=True, eq=False)
class Field:
    """Those that take part.

    Attributes:
        holdout: What is predicted.
        entrants: By name, the default first.
        absent: Names that do not take part, and why.
    """

    holdout: InnerHoldout
    entrants: Mapping[str, Entrant]
    absent: Mapping[str, str] = field(default_factory=dict)


def plain_field(problem: Regression, judged: tuple[Array, Array] | None = None) -> Field:
    """Estimators that need rows alone, on stretches of time.

    Args:
        problem: The training rows.
        judged: Columns (n, nv, r) and torque (n, nv) at the same instants, to be predicted; those
            of the problem when None.
    """
    W, tau = (problem.W, problem.tau) if judged is None else judged
    used, blocks = every(problem.segments, _INSTANTS), stretches(problem.segments)
    entrants = {name: each.thinned(used) for name, each in _of_rows(problem).items()}
    return Field(InnerHoldout(tau, (W,), blocks, used), entrants)


def field_of(
    robot: Robot, rows: FitRows, judged: FitRows, recordings: Sequence[Recording]
) -> Field:
    """All that can be compared on the rows of recordings.

    Args:
        robot: The arm.
        rows: What is fitted.
        judged: The same instants at the cut-off of judging.
        recordings: Behind these rows, in order.
    """
    problem, whole = regression_of(rows), regression_of(judged)
    if sum(len(r.t) for r in recordings) > _SAMPLES:
        why = f"of more than {_SAMPLES} samples"
        plain = plain_field(problem, (whole.W, whole.tau))
        return replace(plain, absent=dict.fromkeys(("iv", "oe", "ml"), why))
    absent: dict[str, str] = {}
    averaged = _averaged(robot, judged, recordings, absent)
    if averaged is None:
        used, blocks = every(whole.segments, _INSTANTS), stretches(whole.segments)
    else:
        used = every(whole.segments, _AVERAGED)
        times = [segment.t for segment in judged.data.to_fit]
        blocks = phases(whole.segments, times, averaged.periods)
    looks: tuple[Array, ...] = (whole.W,)
    halves = _halves(robot, judged, whole, recordings, absent)
    found = _of_rows(problem)
    if halves is not None:
        both = replace(whole, W=halves[0], instruments=halves[1])
        found["iv"] = Entrant(both, np.arange(len(whole.tau)), ESTIMATORS["iv"])
        reach = _reach(judged, recordings)
        looks = half_columns(robot, judged, recordings, float(reach.max()))
        found |= _simulated(robot, judged, recordings, reach, absent)
    found = {name: entrant.thinned(used) for name, entrant in found.items()}
    if averaged is not None:
        found["ml"] = Entrant(averaged.problem, _instants(judged, averaged), ESTIMATORS["ml"])
    return Field(InnerHoldout(whole.tau, looks, blocks, used), found, absent)


def _of_rows(problem: Regression) -> dict[str, Entrant]:
    at = np.arange(len(problem.tau))
    return {name: Entrant(problem, at, ESTIMATORS[name]) for name in (DEFAULT, *RIVALS)}


def _halves(
    robot: Robot,
    rows: FitRows,
    problem: Regression,
    recordings: Sequence[Recording],
    absent: dict[str, str],
) -> tuple[Array, Array] | None:
    """Columns of even and of odd samples where errors of the motion bias least squares."""
    at = np.flatnonzero(every(problem.segments, _INSTANTS))
    try:
        W, Z = half_columns(robot, rows, recordings)
        _, p = errors_in_variables(W[at], problem.tau[at], Z[at])
    except RankDeficient:
        why = "too few rows to test for errors of the motion"
    except BadInput:  # a rate too low for halves, or nothing to be tested
        why = "even and odd samples do not show errors of the motion"
    else:
        if p < _CERTAIN:
            return W, Z
        why = f"no errors of the motion are seen, p = {p:.2g}"
    absent |= {"iv": why, "oe": why}
    return None


def _reach(rows: FitRows, recordings: Sequence[Recording]) -> Array:
    """How far the motion goes in each segment, noise left aside, shape (segments, nv) [Hz]."""
    pairs = with_recordings(rows.data.to_fit, recordings)
    return np.array([motion_reach(unfiltered_positions(s, r), s.rate_hz) for s, r in pairs])


def _simulated(
    robot: Robot,
    rows: FitRows,
    recordings: Sequence[Recording],
    reach: Array,
    absent: dict[str, str],
) -> dict[str, Entrant]:
    """Output error: rows on the motion that the model makes, simulated once for all blocks.

    The controller holds the motion whatever the parameters are, so that it matters little that
    they were fitted to what is left out, too.
    """
    steps = _steps(rows)
    if reach.min() >= POSITION_RATIO * rows.data.cutoff_hz:
        absent["oe"] = f"positions show their motion up to {reach.min():.3g} Hz without noise"
        return {}
    if steps > _STEPS:
        absent["oe"] = f"its simulation of {steps} steps would take long"
        return {}
    try:
        loop = closed_loop(robot, rows, recordings)
        found = output_error(loop.problem)
    except ExcitantError as error:
        absent["oe"] = str(error).split(";")[0]
        return {}
    at = [
        first.start + (np.arange(len(s.motion.t))[kept] - s.keep.start) // s.keep.step
        for first, s, kept in zip(
            regression_of(rows).segments, rows.data.to_fit, loop.kept, strict=True
        )
    ]
    settled = replace(loop.problem, W=found.columns, simulated=None)
    return {"oe": Entrant(settled, np.concatenate(at), ESTIMATORS["wls"])}


def _steps(rows: FitRows) -> int:
    """Steps of simulating all segments once."""
    each = [(len(s.motion.t), 1 / s.rate_hz) for s in rows.data.to_fit]
    return sum(n * int(np.ceil(dt / STEP - _ROUNDING)) for n, dt in each)


def _averaged(
    robot: Robot, rows: FitRows, recordings: Sequence[Recording], absent: dict[str, str]
) -> AveragedRows | None:
    """Rows of averaged periods, where all recordings repeat."""
    try:
        return averaged_rows(robot, rows, recordings)
    except BadRecording:
        absent["ml"] = "the motion does not repeat"
    except RankDeficient:
        absent["ml"] = "averaged periods do not show all parameters"
    return None


def _instants(rows: FitRows, averaged: AveragedRows) -> Indices:
    """For each averaged row, the instant of the second period at the same phase."""
    found, parts = [], zip(regression_of(rows).segments, rows.data.to_fit, strict=True)
    for (part, segment), own in zip(parts, averaged.periods, strict=True):
        step = segment.t[1] - segment.t[0]
        target = own.start + own.period + own.t[:: segment.keep.step or 1]
        at = np.rint((target - segment.t[0]) / step).astype(int)
        found.append(part.start + np.clip(at, 0, len(segment.t) - 1))
    return np.concatenate(found)
