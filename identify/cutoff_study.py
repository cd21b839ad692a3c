"""Preprocessing as part of the result: cut-offs, dead zone, and what depends on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from excitant.exceptions import BadRecording
from excitant.identify.accuracy import series
from excitant.identify.cutoff import LOWEST, CutoffChoice, choose_cutoffs
from excitant.identify.cutoff_harmonics import Harmonics, recorded_harmonics
from excitant.identify.cutoff_rows import Bank, bank
from excitant.identify.preprocessing import (
    POSITION_RATIO,
    Segment,
    Tuning,
    prepare,
    slowest_known,
    tuned,
)
from excitant.identify.recording import Recording
from excitant.identify.rows import FitRows, observation
from excitant.identify.shapes import Shapes
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

_GIVEN = "given"
_WHOLE = "the default, for this estimator looks at the recordings themselves"

FACTORS = (0.5, 2**-0.5, 1.0, 2**0.5, 2.0)
"""Parts of the cut-offs chosen at which the fit is repeated."""


@dataclass(frozen=True, eq=False)
class Study:
    """Rows as they are to be fitted, and why so.

    Attributes:
        rows: What is fitted.
        judged: The same instants at the cut-off of judging.
        choice: Cut-offs and dead zone, with reasons.
        banks: Rows at any cut-off.
        shapes: Shapes of effects, as far as these were refined before; None where there are none.
    """

    rows: FitRows
    judged: FitRows
    choice: CutoffChoice
    banks: tuple[Bank, ...]
    shapes: Shapes | None = None


def study(
    robot: Robot,
    rows: FitRows,
    recordings: Sequence[Recording],
    *,
    fixed: bool = False,
    untouched: bool = False,
    harmonics: Harmonics | None = None,
) -> Study:
    """Choose cut-offs and dead zone for rows that were made with the default ones.

    Args:
        robot: The arm.
        rows: Rows with one cut-off for all joints.
        recordings: Behind these rows, in order.
        fixed: Keep that cut-off, because the user gave it.
        untouched: Keep the rows altogether, because the estimator looks at the recordings too.
        harmonics: Those of the motion as planned; looked for in the recordings when None.
    """
    data = rows.data
    judge = data.cutoff_hz
    slowest = np.max([slowest_known(r, POSITION_RATIO * judge) for r in recordings], axis=0)
    kept = _GIVEN if fixed else _WHOLE if untouched else ""
    if untouched:
        slowest = np.full_like(slowest, -1.0)
    narrow = _bank(robot, rows, data.train, judge, slowest)
    if harmonics is None and not kept:
        harmonics = recorded_harmonics(data.train, recordings)
    choice = choose_cutoffs(narrow, robot.joints, slowest, kept=kept, harmonics=harmonics)
    tuning = choice.tuning(judge)
    wide = _wide(robot, rows, recordings, slowest)
    to_fit = rows if tuning is None else _refiltered(robot, rows, tuning)
    return Study(to_fit, rows, choice, (narrow, *wide))


def _refiltered(robot: Robot, rows: FitRows, tuning: Tuning) -> FitRows:
    """The rows of the same instants as they are to be fitted; gains stay."""
    segments = tuple(tuned(segment, tuning) for segment in rows.data.train)
    W, measured = observation(robot, rows.effects, segments), series(segments)
    return replace(rows, data=replace(rows.data, tuned=segments), W=W, measured=measured)


def _bank(
    robot: Robot, rows: FitRows, segments: Sequence[Segment], highest_hz: float, slowest: Array
) -> Bank:
    judge = rows.data.cutoff_hz
    return bank(
        robot, rows.effects, rows.base, segments, rows.gains,
        judge_hz=judge, lowest_hz=LOWEST * judge, highest_hz=highest_hz, slowest=slowest,
    )  # fmt: skip


def _wide(
    robot: Robot, rows: FitRows, recordings: Sequence[Recording], slowest: Array
) -> tuple[Bank, ...]:
    """Rows above the cut-off of judging, of a motion less filtered; none where rates forbid it."""
    for factor in (FACTORS[-1], FACTORS[-2]):
        highest = factor * rows.data.cutoff_hz
        try:
            segments = [s for r in recordings for s in prepare(r, highest)]
        except BadRecording:
            continue
        return (_bank(robot, rows, segments, highest, slowest),)
    return ()
