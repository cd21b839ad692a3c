"""`identify_streamed`: what `identify` does, of logs that are never in memory as a whole."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import scipy.linalg

from excitant.exceptions import BadInput, BadRecording
from excitant.identify.accuracy import Series
from excitant.identify.estimate import Estimate, identified_robot, notes_on, whitened
from excitant.identify.importers.chunks import read_chunks, read_times
from excitant.identify.importers.mapping import ColumnMap
from excitant.identify.knowledge import Knowledge
from excitant.identify.least_squares import LeastSquares, reweighted, sandwiched
from excitant.identify.physical import fit_physical, prior_parameters
from excitant.identify.preprocessing import prepare
from excitant.identify.recording import MINIMUM_DURATION, Recording
from excitant.identify.rows import (
    FIT_SHARE,
    Data,
    holdout_sentence,
    open_prior,
    refuse_mixed_units,
    torque_per_reading,
)
from excitant.identify.streaming.columns import Layout, layout, window_rows
from excitant.identify.streaming.condensed import Blocks, Condensed
from excitant.identify.streaming.excerpt import Excerpt
from excitant.identify.streaming.filtering import Response, response
from excitant.identify.streaming.noise import block_scores
from excitant.identify.streaming.survey import Survey, survey
from excitant.identify.streaming.windows import Span, windows
from excitant.robots.base_parameters import base_parameters
from excitant.robots.effects import Effect, standard_effects
from excitant.robots.motion import Array, read_only
from excitant.robots.robot import Robot

_ROWS = 50_000  # samples read at once, and instants that a window adds
_HEAD = 100_000  # samples that a default cut-off is chosen from
_REACH = 2.0  # responses of the torque filter; that of positions is shorter than one
LogFiles = str | Path | Sequence[str | Path]
"""A log: a file, or the files that it was split into, in order."""
NOTE = (
    "read piece by piece, as the recordings are larger than the memory set aside for them: "
    "weighted least squares at one cut-off, no search for data faults, standard deviations from "
    "the spread of long blocks, and figures of the beginning of the hold-out"
)


def identify_streamed(
    robot: Robot,
    logs: Sequence[LogFiles],
    *,
    validate: Sequence[LogFiles] = (),
    effects: Sequence[Effect] | None = None,
    cutoff_hz: float | None = None,
    knowledge: Knowledge | None = None,
    mapping: ColumnMap | None = None,
    torque_column: str | None = None,
    rows: int = _ROWS,
    progress: Callable[[float], None] = lambda fraction: None,
) -> Estimate:
    """Identify a robot from logs of any length, in bounded memory.

    Every log is read twice: its time, then its samples in windows that overlap. Their filtered
    rows are those of the whole log to 1e-8 of the largest entry, and to 2e-3 of what noise of
    positions adds to them (`excitant.identify.streaming.filtering`). Triangular factors of the
    rows of each joint stand for them, so that weighted least squares, the semidefinite fit and
    all accuracies are those of all rows. Standard deviations come from long blocks of rows
    (`excitant.identify.streaming.noise`).

    Args:
        robot: The arm; its inertias are the prior.
        logs: What to fit, each a file or the files that one log was split into; Parquet and CSV
            are read piece by piece.
        validate: What to judge on; the last 30 % of each log when empty.
        effects: Effects to estimate; friction, offset and rotor inertia when None.
        cutoff_hz: Cut-off of the torque filter [Hz].
        knowledge: What is known of the bodies beforehand, and the kind of prior.
        mapping: What the user says about the columns.
        torque_column: Prefix of the torque columns.
        rows: Samples that are read at once.
        progress: Told which fraction of the samples has been read.

    Returns:
        As `identify`; ``data`` and ``series`` hold the first segments and rows only.

    Raises:
        BadInput: No log.
        BadRecording: As `read_chunks`, when the row at fault is reached; or nothing long enough.
        BadRobot: Links without mass, so no prior.
        RankDeficient: Motion that leaves base parameters undetermined.
        Infeasible: The semidefinite solver failed.
    """
    if not logs:
        raise BadInput("no recording given; name at least one file")
    prior = prior_parameters(robot)
    effects = standard_effects(robot.joints) if effects is None else tuple(effects)
    given: dict[str, Any] = {"mapping": mapping, "torque_column": torque_column}
    found = [_log(robot, path, rows, given, held=False, split=not validate) for path in logs]
    found += [_log(robot, path, rows, given, held=True, split=False) for path in validate]
    form = layout(robot, effects, base_parameters(robot, effects))
    taken = _Taken(form, found, cutoff_hz, rows, progress)
    data = Data(
        taken.first[False].segments, taken.first[True].segments, found[0].head.unit,
        taken.cutoff_hz, holdout_sentence([log.head.name for log in found if log.spans[0].held]),
    )  # fmt: skip
    notes = (*_column_notes(found), NOTE)
    return _estimate(form, taken, data, prior, knowledge or Knowledge(), notes)


@dataclass(frozen=True, eq=False)
class _Log:
    """A log that can be read again and again.

    Attributes:
        read: Reads its pieces.
        survey: Its time.
        head: Its first piece.
        spans: What of it is fitted and held out.
    """

    read: Callable[[], Iterator[Recording]]
    survey: Survey
    head: Recording
    spans: tuple[Span, ...]


def _log(
    robot: Robot, files: LogFiles, rows: int, given: dict[str, Any], *, held: bool, split: bool
) -> _Log:
    def read() -> Iterator[Recording]:
        return read_chunks(files, robot, rows, **given)

    head = next(read_chunks(files, robot, _HEAD, **given))
    seen = survey(read_times(files, robot, **given))
    if not len(seen.steps):
        raise BadRecording(head.file, "no two rows of rising time; record anew", column="t")
    bounds = [-np.inf, np.inf]
    if split:
        bounds.insert(1, seen.start + FIT_SHARE * (seen.end - seen.start))
    spans = tuple(
        Span(low, high, seen.step(low, high), held or bool(k))
        for k, (low, high) in enumerate(pairwise(bounds))
    )
    return _Log(read, seen, head, spans)


def _column_notes(logs: Sequence[_Log]) -> list[str]:
    return [f"{log.head.name}: {note}" for log in logs for note in log.head.notes]


class _Taken:
    """Rows of all logs, condensed.

    Attributes:
        cutoff_hz: Cut-off of the torque filter [Hz].
        rows: What is fitted (False) and held out (True).
        first: Their first rows.
    """

    def __init__(
        self,
        form: Layout,
        logs: Sequence[_Log],
        cutoff_hz: float | None,
        rows: int,
        progress: Callable[[float], None],
    ) -> None:
        refuse_mixed_units([log.head for log in logs])
        self._form, self._window = form, rows
        if cutoff_hz is None:
            cutoff_hz = min(prepare(log.head)[0].cutoff_hz for log in logs)
        self.cutoff_hz = cutoff_hz
        self.rows = {held: Blocks(form) for held in (False, True)}
        self.first = {held: Excerpt(form) for held in (False, True)}
        total, done = sum(log.survey.rows for log in logs), 0
        for log in logs:
            self._take(log, partial(_advance, progress, done, total))
            done += log.survey.rows
        for held, blocks in self.rows.items():
            if not blocks.n:
                log = logs[-1 if held else 0]
                raise BadRecording(log.head.file, _too_short(log.head.name, held), column="t")

    def _take(self, log: _Log, advance: Callable[[int], None]) -> None:
        responses: dict[Span, Response] = {}
        [example] = prepare(log.head, self.cutoff_hz)[:1]
        reach = _REACH * response(example).half / example.rate_hz
        for window in windows(log.read(), log.spans, self.cutoff_hz, reach, self._window, advance):
            if window.span not in responses:
                responses[window.span] = response(window.segment)
            rows = window_rows(self._form, window, responses[window.span])
            self.rows[window.span.held].take(rows)
            self.first[window.span.held].take(window, rows, responses[window.span].half)


def _advance(progress: Callable[[float], None], done: int, total: int, rows: int) -> None:
    progress((done + rows) / total)


def _too_short(name: str, held: bool) -> str:
    what = "held out" if held else "fitted"
    return (
        f"nothing of '{name}' can be {what}: {MINIMUM_DURATION:g} s without interruption are "
        "needed; record longer or name a hold-out of its own"
    )


def _estimate(
    form: Layout,
    taken: _Taken,
    data: Data,
    prior: Array,
    knowledge: Knowledge,
    notes: tuple[str, ...],
) -> Estimate:
    """Fit and judgement from condensed rows."""
    robot, base = form.robot, form.base
    gains = _gains(form, taken.first[False], data.unit)
    train, unseen = (taken.rows[held].whole() for held in (False, True))
    fit = _least_squares(form, train, taken.rows[False].each(), gains)
    W, tau = train.W @ base.regrouping, train.tau * gains
    R, z = whitened(W, tau, fit)
    open_effects = open_prior(robot, form.effects, W, tau)
    physical = fit_physical(R, z, prior, open_effects, knowledge=knowledge, links=robot.links)
    identified = base.regrouping @ physical.x
    given = base.regrouping[:, : 10 * robot.nv] @ robot.phi
    shown = taken.first[True]
    return Estimate(
        given=robot,
        model=identified_robot(robot, form.effects, physical.x),
        base=base,
        least_squares=fit,
        physical=physical,
        prior=read_only(prior.ravel()),
        gains=read_only(gains),
        data=data,
        train=train.accuracy(train.W @ identified / gains),
        validate=unseen.accuracy(unseen.W @ identified / gains),
        baseline=unseen.accuracy((unseen.W @ given + unseen.given) / gains),
        series=shown.series(),
        predicted=read_only(shown.predicted(identified) / gains),
        predicted_given=read_only(shown.predicted(given, own=1.0) / gains),
        notes=(*notes_on(robot, prior, data, gains), *notes),
        knowledge=knowledge,
    )


def _gains(form: Layout, first: Excerpt, unit: str) -> Array:
    """Drive gains where torque came as current, from the first rows alone."""
    if unit != "A":
        return np.ones(form.robot.nv)
    rows = first.observation()
    readings = Series(np.arange(float(rows.n)), rows.tau, rows.raw)
    return torque_per_reading(form.robot, form.base, rows.W @ form.base.regrouping, readings, unit)


def _least_squares(
    form: Layout, rows: Condensed, blocks: Sequence[Condensed], gains: Array
) -> LeastSquares:
    tau = rows.tau * gains
    settled = reweighted(rows.W, tau, form.base.expressions, rows.spread * gains, rows.n)
    factor = settled.factor
    inverse = scipy.linalg.solve_triangular(factor.R, np.eye(len(settled.beta)))
    scores, freedom = block_scores(blocks, gains, factor, inverse, settled.beta)
    fit = sandwiched(factor, settled.beta, scores, freedom, factor.weight)
    return LeastSquares(fit.beta, fit.covariance, settled.sigma, fit.inflation)
