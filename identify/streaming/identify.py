"""`identify_streamed`: what `identify` does, of logs that are never in memory as a whole."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import scipy.linalg

from excitant.exceptions import BadInput, BadRecording
from excitant.identify.accuracy import Accuracy, Series
from excitant.identify.cutoff_study import Study
from excitant.identify.estimate import identified_robot, notes_on, whitened
from excitant.identify.faults.copies import same_digests
from excitant.identify.faults.fault import Fault
from excitant.identify.importers.mapping import ColumnMap
from excitant.identify.knowledge import Knowledge
from excitant.identify.least_squares import LeastSquares, reweighted, sandwiched
from excitant.identify.physical import fit_physical, prior_parameters
from excitant.identify.preprocessing import prepare, tuned
from excitant.identify.recording import MINIMUM_DURATION
from excitant.identify.rows import (
    Data,
    holdout_sentence,
    open_prior,
    refuse_mixed_units,
    torque_per_reading,
)
from excitant.identify.streaming.columns import Layout, layout, window_rows
from excitant.identify.streaming.condensed import Blocks, Condensed
from excitant.identify.streaming.estimate import StreamedEstimate
from excitant.identify.streaming.excerpt import Excerpt
from excitant.identify.streaming.filtering import Response, responses
from excitant.identify.streaming.logs import LogFiles, StreamedLog, mended_log, streamed_log
from excitant.identify.streaming.noise import block_scores
from excitant.identify.streaming.tuning import sentence, study_of_excerpts
from excitant.identify.streaming.windows import Span, windows
from excitant.robots.base_parameters import base_parameters
from excitant.robots.effects import Effect, standard_effects
from excitant.robots.motion import Array, read_only
from excitant.robots.robot import Robot

_ROWS = 50_000  # samples read at once, and instants that a window adds
_REACH = 2.0  # responses of the torque filter; that of positions is shorter than one
_OF_EXCERPTS = "figures of what was fitted are of these parts of the recordings"
NOTE = (
    "read piece by piece, as the recordings are larger than the memory set aside for them: "
    "weighted least squares, standard deviations from the spread of long blocks, and figures of "
    "the beginning of the hold-out; of the data faults, those of rows and dead or saturated "
    "channels were searched for in all rows, those of units, signs, rates and frames in an excerpt"
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
    tune: bool = False,
    repaired: bool = False,
) -> StreamedEstimate:
    """Identify a robot from logs of any length, in bounded memory.

    Every log is read twice: its time, then its samples in windows that overlap, while they are
    searched for faults (`excitant.identify.streaming.checks`). Their filtered rows are those of
    the whole log to 1e-8 of the largest entry, and to 2e-3 of what noise of positions adds to them
    (`excitant.identify.streaming.filtering`). Triangular factors of the rows of each joint stand
    for them, so that weighted least squares, the semidefinite fit and all accuracies are those of
    all rows. Standard deviations come from long blocks of rows
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
        tune: Choose cut-offs of joints and a velocity dead zone as `identify` does, on excerpts
            of what is fitted. A cut-off given is kept.
        repaired: Repair the faults of logs to fit that can be repaired.

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
    options: dict[str, Any] = {"split": not validate, "compared": len(logs) > 1}
    fit = [
        mended_log(robot, path, rows, given, **options)
        if repaired
        else streamed_log(robot, path, rows, given, held=False, **options)
        for path in logs
    ]
    held = [streamed_log(robot, x, rows, given, held=True, split=False) for x in validate]
    form = layout(robot, effects, base_parameters(robot, effects))
    taken = _Taken(form, fit, held, cutoff_hz, rows, progress, tune=tune)
    data = Data(
        taken.first[False].segments, taken.first[True].segments, fit[0].head.unit,
        taken.cutoff_hz, holdout_sentence([log.head.name for log in held]),
    )  # fmt: skip
    notes = (*_column_notes([*fit, *held]), NOTE, *taken.notes)
    notes += tuple(f"{log.head.name}: {said}" for log in fit for said in log.repaired or ())
    found = _estimate(form, taken, data, prior, knowledge or Knowledge(), notes)
    return replace(found, faults=_faults(fit))


def _faults(logs: Sequence[StreamedLog]) -> dict[str, tuple[Fault, ...]]:
    """Faults of each log that was fitted, by its name."""
    digests = {log.head.name: log.checks.digest for log in logs if log.checks is not None}
    copies = same_digests({name: made for name, made in digests.items() if made is not None})
    found = {}
    for log in logs:
        name = log.head.name
        found[name] = (*((copies[name],) if name in copies else ()), *log.faults)
    return found


def _column_notes(logs: Sequence[StreamedLog]) -> list[str]:
    return [f"{log.head.name}: {note}" for log in logs for note in log.head.notes]


class _Taken:
    """Rows of all logs, condensed.

    Attributes:
        cutoff_hz: Cut-off of the torque filter at which accuracy is judged [Hz].
        study: How rows are fitted, and why; None where not asked for.
        notes: What the user should know of that, as sentences.
        rows: What is fitted (False) and held out (True).
        first: Their first rows.
    """

    def __init__(
        self,
        form: Layout,
        fit: Sequence[StreamedLog],
        held: Sequence[StreamedLog],
        cutoff_hz: float | None,
        rows: int,
        progress: Callable[[float], None],
        *,
        tune: bool,
    ) -> None:
        logs = [*fit, *held]
        refuse_mixed_units([log.head for log in logs])
        self._form, self._window = form, rows
        self.cutoff_hz = cutoff_hz or min(prepare(log.head)[0].cutoff_hz for log in logs)
        self.study: Study | None = None
        self.notes: tuple[str, ...] = ()
        if tune:
            lively = [log.lively for log in fit]
            fixed = cutoff_hz is not None
            self.study = study_of_excerpts(form, lively, self.cutoff_hz, fixed=fixed)
            self.notes = (*self.study.choice.notes, sentence(lively))
        self.tuning = None if self.study is None else self.study.choice.tuning(self.cutoff_hz)
        if self.tuning is not None:
            self.notes += (_OF_EXCERPTS,)
        self.rows = {held: Blocks(form) for held in (False, True)}
        self.first = {held: Excerpt(form) for held in (False, True)}
        total, done = sum(log.survey.rows for log in logs), 0
        for log in logs:
            self._take(log, partial(_advance, progress, done, total))
            done += log.survey.rows
        for kind, blocks in self.rows.items():
            if not blocks.n:
                log = logs[-1 if kind else 0]
                raise BadRecording(log.head.file, _too_short(log.head.name, kind), column="t")

    def _take(self, log: StreamedLog, advance: Callable[[int], None]) -> None:
        known: dict[Span, tuple[Response, ...]] = {}
        [example] = prepare(log.head, self.cutoff_hz, tuning=self.tuning)[:1]
        reach = _REACH * responses(example)[0].half / example.rate_hz
        for window in windows(
            log.pieces(), log.spans, self.cutoff_hz, reach, self._window, advance
        ):
            held, as_fitted = window.span.held, window
            if not held and self.tuning is not None:
                as_fitted = replace(window, segment=tuned(window.segment, self.tuning))
            if window.span not in known:
                known[window.span] = responses(as_fitted.segment)
            rows = window_rows(self._form, as_fitted, known[window.span])
            self.rows[held].take(rows)
            self.first[held].take(window, rows, known[window.span][0].half)

    def train(self, predicted: Array, x: Array, gains: Array) -> Accuracy:
        """Accuracy on what was fitted; on the excerpts where rows were fitted otherwise.

        Args:
            predicted: Torque of the model at the condensed rows [torque unit].
            x: Parameters of links and effects.
            gains: Torque per reading, shape (nv,).
        """
        if self.tuning is None or self.study is None:
            return self.rows[False].whole().accuracy(predicted)
        judged = self.study.judged
        return judged.measured.accuracy(judged.W @ x / gains)


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
) -> StreamedEstimate:
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
    seen = 0 if taken.study is None else len(taken.study.rows.W)
    return StreamedEstimate(
        given=robot,
        model=identified_robot(robot, form.effects, physical.x),
        base=base,
        least_squares=fit,
        physical=physical,
        prior=read_only(prior.ravel()),
        gains=read_only(gains),
        data=data,
        train=taken.train(train.W @ identified / gains, physical.x, gains),
        validate=unseen.accuracy(unseen.W @ identified / gains),
        baseline=unseen.accuracy((unseen.W @ given + unseen.given) / gains),
        series=shown.series(),
        predicted=read_only(shown.predicted(identified) / gains),
        predicted_given=read_only(shown.predicted(given, own=1.0) / gains),
        notes=(*notes_on(robot, prior, data, gains), *notes),
        knowledge=knowledge,
        study=taken.study,
        share=min(seen / train.n, 1.0) if seen else 1.0,
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
