"""Logs larger than memory, piece by piece."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from excitant.exceptions import BadInput, BadRecording
from excitant.identify.importers.columns import resolve
from excitant.identify.importers.groups import Joints
from excitant.identify.importers.mapping import ColumnMap
from excitant.identify.importers.raw import (
    RawRecording,
    first_of,
    raw_from_frame,
    seconds_of,
    timed,
)
from excitant.identify.importers.sources import Source, open_source
from excitant.identify.recording import (
    MINIMUM_DURATION,
    Recording,
    check_alive,
    check_finite,
    check_time,
)
from excitant.robots.motion import Array
from excitant.robots.robot import Robot


def read_chunks(
    paths: str | Path | Sequence[str | Path],
    robot: Robot | int,
    rows: int = 100_000,
    *,
    mapping: ColumnMap | None = None,
    torque_column: str | None = None,
) -> Iterator[Recording]:
    """Consecutive pieces of one log, whose time goes on from one to the next.

    Parquet, CSV and bags are read piece by piece, so that memory is that of one piece (and of one
    row group of a Parquet file, compressed); NPZ and MAT are read whole. Every piece is checked
    as it comes; what only the whole can show, a channel without signal or a log that is too
    short, is refused after the last piece.

    Args:
        paths: A log, or the files it was split into, in order.
        robot: The arm, or its number of joints.
        rows: Most rows of a piece.
        mapping: What the user says about the columns.
        torque_column: Prefix of the torque columns.

    Yields:
        Pieces of at most ``rows`` samples; ``t`` counts from the first sample of the log.

    Raises:
        BadRecording: As `read_recording`, when the piece at fault is reached.
        BadInput: ``rows`` below 1, or a map that does not fit the robot.
    """
    files = [paths] if isinstance(paths, str | Path) else list(paths)
    so_far: _SoFar | None = None
    first_row = 0
    for raw in read_raw_chunks(files, robot, rows, mapping=mapping, torque_column=torque_column):
        first_row = 0 if so_far is None or so_far.last.file != raw.file else first_row
        check_finite(raw, first_row)
        check_time(raw, first_row, so_far.end if so_far else None)
        so_far = _SoFar.after(so_far, raw)
        first_row += len(raw.t)
        yield piece_of(raw)
    if so_far is None or so_far.end < MINIMUM_DURATION:
        duration = so_far.end if so_far else 0.0
        raise BadRecording(
            files[0] if files else "", f"too short: {duration:.3g} s, at least "
            f"{MINIMUM_DURATION:g} s are needed", column="t",
        )  # fmt: skip
    check_alive(np.array([so_far.low, so_far.high]), so_far.last)


def read_raw_chunks(
    paths: str | Path | Sequence[str | Path],
    robot: Robot | int,
    rows: int = 100_000,
    *,
    mapping: ColumnMap | None = None,
    torque_column: str | None = None,
) -> Iterator[RawRecording]:
    """Pieces as those of `read_chunks`, as they are: nothing is checked.

    Raises:
        BadRecording: A file that cannot be read, or columns that could mean several things.
        BadInput: ``rows`` below 1, or a map that does not fit the robot.
    """
    if rows < 1:
        raise BadInput(f"rows is {rows}; a piece must hold at least one row")
    origin: tuple[float, float] | None = None
    for path in [paths] if isinstance(paths, str | Path) else paths:
        source = open_source(path, topic=mapping.topic if mapping else None)
        for raw in _pieces(source, Path(path), robot, rows, mapping, torque_column, origin):
            origin = origin or raw.start
            yield raw


def read_times(
    paths: str | Path | Sequence[str | Path],
    robot: Robot | int,
    rows: int = 100_000,
    *,
    mapping: ColumnMap | None = None,
    torque_column: str | None = None,
) -> Iterator[Array]:
    """Time of one log alone, unchecked, in pieces as those of `read_chunks`, each (n,) [s]."""
    origin: tuple[float, float] | None = None
    for path in [paths] if isinstance(paths, str | Path) else paths:
        source = open_source(path, topic=mapping.topic if mapping else None)
        columns = resolve(source, Joints.of(robot), mapping=mapping, torque_column=torque_column)
        settled = False
        for frame in source.frames(rows, columns.names if source.joined else columns.t):
            if frame.empty:
                continue
            if not settled:
                columns, settled = timed(columns, frame), True
            whole, rest = seconds_of(frame, columns)
            origin = origin or first_of(whole, rest)
            yield (whole - origin[0]) + (rest - origin[1])


@dataclass(frozen=True, eq=False)
class _SoFar:
    """What the pieces read so far leave to check.

    Attributes:
        origin: Time of the first sample as logged, whole and remaining seconds.
        end: Time of the last sample [s].
        low: Lowest torque per joint.
        high: Highest torque per joint.
        last: The last piece.
    """

    origin: tuple[float, float]
    end: float
    low: Array
    high: Array
    last: RawRecording

    @classmethod
    def after(cls, before: _SoFar | None, raw: RawRecording) -> _SoFar:
        low, high = raw.tau.min(axis=0), raw.tau.max(axis=0)
        if before is not None:
            low, high = np.minimum(low, before.low), np.maximum(high, before.high)
        return cls(raw.start if before is None else before.origin, raw.t[-1], low, high, raw)


def _pieces(
    source: Source,
    path: Path,
    robot: Robot | int,
    rows: int,
    mapping: ColumnMap | None,
    torque_column: str | None,
    origin: tuple[float, float] | None,
) -> Iterator[RawRecording]:
    columns = resolve(source, Joints.of(robot), mapping=mapping, torque_column=torque_column)
    settled = False
    for frame in source.frames(rows, columns.names):
        if frame.empty:
            continue
        if not settled:
            columns, settled = timed(columns, frame), True
        raw = raw_from_frame(frame, source, path.stem, columns, origin)
        origin = origin or raw.start
        yield raw


def piece_of(raw: RawRecording) -> Recording:
    """A piece of a log as a recording; its rows have been checked."""
    fine = raw.dq is not None and bool(np.isfinite(raw.dq).all())
    return Recording(
        raw.name, raw.file, raw.t, raw.q, raw.tau, raw.unit, raw.dq if fine else None, raw.notes
    )
