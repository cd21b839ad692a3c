"""Logs that can be read again and again: surveyed, searched for faults, and repaired on demand."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from excitant.exceptions import BadInput, BadRecording
from excitant.identify.faults.fault import Fault
from excitant.identify.faults.reading import refuse_unordered
from excitant.identify.importers.raw import RawRecording, read_raw_chunks
from excitant.identify.recording import (
    MINIMUM_DURATION,
    Recording,
    check_alive,
    check_finite,
    check_time,
    read_chunks,
    unchecked,
)
from excitant.identify.rows import FIT_SHARE
from excitant.identify.streaming.checks import Checks, moving_joints
from excitant.identify.streaming.mending import Mending, time_faults
from excitant.identify.streaming.survey import Survey, survey
from excitant.identify.streaming.windows import Span
from excitant.robots.robot import Robot

_AT_ONCE = 100_000  # samples of an excerpt, and of a piece that is searched before a repair
_LOOKED_AT = 20  # pieces among which the excerpt is
LogFiles = str | Path | Sequence[str | Path]
"""A log: a file, or the files that it was split into, in order."""


@dataclass(frozen=True, eq=False)
class StreamedLog:
    """A log that can be read again and again.

    Attributes:
        read: Reads its pieces.
        survey: Its time.
        head: Its first piece.
        spans: What of it is fitted and held out.
        lively: Its first rows in which most joints move, of what is fitted.
        checks: Search for its faults; None where it is not searched.
        stamps: Faults of its time.
        repaired: What was repaired, a sentence each; None where its faults are still to be
            searched for, on the way.
    """

    read: Callable[[], Iterator[Recording]]
    survey: Survey
    head: Recording
    spans: tuple[Span, ...]
    lively: Recording
    checks: Checks | None = None
    stamps: tuple[Fault, ...] = ()
    repaired: tuple[str, ...] | None = None

    def pieces(self) -> Iterator[Recording]:
        """Its pieces, searched for faults on their way unless that has been done."""
        if self.checks is None or self.repaired is not None:
            return self.read()
        return self.checks.passing(self.read())

    @cached_property
    def faults(self) -> tuple[Fault, ...]:
        """Its faults, once all its pieces have been searched."""
        found = () if self.checks is None else self.checks.faults(self.survey.rows)
        return (*self.stamps, *found)


def streamed_log(
    robot: Robot,
    files: LogFiles,
    rows: int,
    given: dict[str, Any],
    *,
    held: bool,
    split: bool,
    compared: bool = False,
) -> StreamedLog:
    """A log as it was recorded.

    Args:
        robot: The arm.
        files: The log.
        rows: Samples that are read at once.
        given: What the user says about the columns.
        held: Whether it is held out as a whole; it is then not searched for faults.
        split: Whether its last part is held out.
        compared: Whether there are others that it may be a copy of.

    Raises:
        BadRecording: A log that cannot be used.
    """

    def read(at_once: int = rows) -> Iterator[Recording]:
        return read_chunks(files, robot, at_once, **given)

    head = next(read(_AT_ONCE))
    seen = survey(raw.t for raw in read_raw_chunks(files, robot, **given))
    spans = _spans(seen, head, held=held, split=split)
    lively = head if held else _lively(read(_AT_ONCE), spans[0].high)
    checks = None if held else Checks(robot, excerpt=lively, compared=compared)
    return StreamedLog(read, seen, head, spans, lively, checks)


def _lively(pieces: Iterable[Recording], high: float) -> Recording:
    """The first of some pieces in which most joints move, up to a time [s]."""
    best, most = None, -1
    for piece in itertools.islice(pieces, _LOOKED_AT):
        inside = piece.t < high
        if best is not None and (not inside.any() or np.ptp(piece.t[inside]) < MINIMUM_DURATION):
            break
        moving = moving_joints(piece.q[inside])
        if moving > most:
            best, most = _cut(piece, inside), moving
        if moving == piece.q.shape[1]:
            break
    if best is None:
        raise BadInput("no piece of a log given")
    return best


def _cut(piece: Recording, inside: np.ndarray) -> Recording:
    dq = None if piece.dq is None else piece.dq[inside]
    return replace(piece, t=piece.t[inside], q=piece.q[inside], tau=piece.tau[inside], dq=dq)


def mended_log(
    robot: Robot,
    files: LogFiles,
    rows: int,
    given: dict[str, Any],
    *,
    split: bool,
    compared: bool = False,
) -> StreamedLog:
    """A log whose faults are repaired as it is read; see `streamed_log`.

    It is read three times: its time, then to search it for faults, then to fit it; once more
    where time does not rise.

    Raises:
        BadRecording: A log that cannot be used after the repair either.
    """

    def raws(at_once: int = _AT_ONCE) -> Iterator[RawRecording]:
        return read_raw_chunks(files, robot, at_once, **given)

    t = np.concatenate([np.zeros(0), *(raw.t for raw in read_raw_chunks(files, robot, **given))])
    first = next(raws(1), None)
    if first is None:
        raise BadRecording(_name(files), "holds no rows; record anew", column="t")
    stamps = time_faults(t, raws(), robot.joints)
    refuse_unordered(first.file, first.columns.t[0], stamps)
    checks = Checks(robot, compared=compared)
    seen = survey(checks.watch(Mending(stamps, t, first.file).pieces(raws())))
    if seen.end - seen.start < MINIMUM_DURATION:
        raise BadRecording(first.file, f"too short: less than {MINIMUM_DURATION:g} s", column="t")
    check_alive(checks.extremes_of_torque, first)
    faults = (*stamps, *checks.faults(len(t)))
    mending = Mending(faults, t, first.file)

    def read(at_once: int = rows) -> Iterator[Recording]:
        return _checked(piece for piece, _ in mending.pieces(raws(at_once)))

    head, seen = next(read(_AT_ONCE)), replace(seen.scaled(mending.pace), rows=len(t))
    spans = _spans(seen, head, held=False, split=split)
    lively = _lively(read(_AT_ONCE), spans[0].high)
    done = tuple(
        f"{fault.fault} ({', '.join(fault.joints)}): repaired, which {fault.repair}"
        for fault in faults
        if fault.remedies and fault.repair
    )
    return StreamedLog(read, seen, head, spans, lively, checks, stamps, done)


def _checked(pieces: Iterable[RawRecording]) -> Iterator[Recording]:
    """Pieces after the repair, which what is left is refused in."""
    before: float | None = None
    for piece in pieces:
        check_finite(piece)
        check_time(piece, before=before)
        before = float(piece.t[-1])
        yield unchecked(piece)


def _spans(seen: Survey, head: Recording, *, held: bool, split: bool) -> tuple[Span, ...]:
    if not len(seen.steps):
        raise BadRecording(head.file, "no two rows of rising time; record anew", column="t")
    bounds = [-np.inf, np.inf]
    if split:
        bounds.insert(1, seen.start + FIT_SHARE * (seen.end - seen.start))
    return tuple(
        Span(low, high, seen.step(low, high), held or bool(k))
        for k, (low, high) in enumerate(pairwise(bounds))
    )


def _name(files: LogFiles) -> str:
    return str(files if isinstance(files, str | Path) else next(iter(files), ""))
