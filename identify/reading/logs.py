"""Logs as recordings: the one entry to the readers of files and tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from os.path import isdir
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from excitant.exceptions import BadInput, BadRecording
from excitant.files import size_of
from excitant.identify.reading import bags, cells, tables
from excitant.identify.reading.arrays import refuse_size
from excitant.identify.reading.columns import Channel, Columns, resolve
from excitant.identify.reading.mapping import ColumnMap
from excitant.identify.reading.names import meaning
from excitant.identify.reading.text import text_table
from excitant.identify.recording import (
    FASTEST,
    MINIMUM_DURATION,
    Recording,
    checked,
    refuse_bad_rows,
    refuse_constant_torque,
    with_finite_speeds,
)
from excitant.identify.signals import samples_motion
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

if TYPE_CHECKING:
    import pandas as pd

_LINES = {
    **dict.fromkeys((".csv", ".txt", ".tsv", ".dat", ".log", ".asc"), text_table),
    **dict.fromkeys((".json", ".jsonl", ".ndjson"), tables.json_table),
}
_READERS = {
    **dict.fromkeys((".parquet", ".pq"), tables.parquet_table),
    **_LINES,
    **{f"{suffix}.gz": reader for suffix, reader in _LINES.items()},
    ".npz": tables.npz_table,
    ".mat": tables.mat_table,
}
SUFFIXES = (
    *(s for s in _READERS if s.removesuffix(".gz") not in (".json", ".log")),
    *bags.SUFFIXES,
)
"""Ends of the names of recordings; what else is read may be something else in a folder."""
TEXTS = tuple(s for s in _READERS if s.removesuffix(".gz") in _LINES)
"""Ends of the names of recordings whose lines, where there are many, are samples."""
_TORQUES = {"tau", "i"}
_REMEMBERED = 100  # unreadable cells whose text is kept


def load_recording(
    path: str | Path, robot: Robot | int, *, mapping: ColumnMap | None = None
) -> Recording:
    """Recording from a log: Parquet, CSV, JSON, NPZ, MAT (up to version 7.2), ROS bag, MCAP.

    Args:
        path: File, or folder of a ROS 2 bag, with columns ``t, q1.., tau1..`` (or ``i1..``), or
            with names that say the same.
        robot: The arm (or its name or file), whose joints are matched by name, or their number.
        mapping: What the user says about the columns.

    Raises:
        BadRecording: Names the file, the row (from 0, after the header) and the column.
        BadInput: A map of columns that does not fit the robot.
    """
    return checked(raw_recording(path, robot, mapping))


def covers(
    source: Recording | pd.DataFrame | Path,
    robot: Robot,
    mapping: ColumnMap | None,
) -> bool:
    """Whether a log has columns of all joints of a robot, by their names or number."""
    if isinstance(source, Recording):
        return source.nv == robot.nv
    mapping = mapping or ColumnMap()
    try:
        table = (
            _open_log(source, mapping)
            if isinstance(source, Path)
            else tables.table_of_frame(source, "")
        )
        resolve(table, robot, mapping)
    except (BadRecording, BadInput):
        return False
    return True


def raw_recording(
    path: str | Path, robot: Robot | int, mapping: ColumnMap | None = None
) -> Recording:
    """A log as it is: columns understood, units converted, no row refused; see `load_recording`."""
    return next(_pieces(_open_log(path, mapping), robot, mapping))


def recording_from_table(
    table: pd.DataFrame,
    robot: Robot | int,
    *,
    file: str,
    name: str,
    mapping: ColumnMap | None = None,
) -> Recording:
    """Recording from a table in memory; see `load_recording`."""
    raw = next(_pieces(tables.table_of_frame(table, file), robot, mapping))
    return checked(replace(raw, name=name))


def read_chunks(
    path: str | Path,
    robot: Robot | int,
    rows: int = 100_000,
    *,
    mapping: ColumnMap | None = None,
) -> Iterator[Recording]:
    """A log larger than memory as recordings of some rows each, checked as `load_recording` does.

    What only the whole can show, a channel without signal or a log that is too short, is refused
    after the last piece.

    Args:
        path: The log; ``t`` counts from its first sample.
        robot: The arm, or its number of joints.
        rows: Most rows of a piece.
        mapping: What the user says about the columns.
    """
    if rows < 1:
        raise BadInput(f"rows is {rows}; a piece must hold at least one row")
    first_row = 0
    end = -np.inf
    extremes = np.zeros((0, 0))
    for raw in _pieces(_open_log(path, mapping), robot, mapping, rows):
        refuse_bad_rows(raw, first_row, end)
        tau = np.concatenate([extremes, raw.tau]) if len(extremes) else raw.tau
        extremes = np.array([tau.min(axis=0), tau.max(axis=0)])
        end = raw.t[-1]
        first_row += len(raw)
        yield with_finite_speeds(raw)
    if end < MINIMUM_DURATION:
        why = f"too short: {max(end, 0.0):.3g} s, at least {MINIMUM_DURATION:g} s are needed"
        raise BadRecording(path, why, column="t")
    refuse_constant_torque(extremes, raw)


def quantities_in(folder: Path) -> dict[str, tables.Table]:
    """Tables of a folder that hold one recording, by the quantity after which each is named.

    Empty where there are no such positions and torques, or one of them is a recording by itself.
    """
    if not isdir(folder) or bags.is_bag(folder):
        return {}
    files = [
        path for path in sorted(folder.iterdir()) if suffix_of(path) in _READERS
    ]
    named = [(meaning(path.name.partition(".")[0]), path) for path in files]
    named = [
        (said, path) for said, path in named if said.role and not said.commanded
    ]
    roles = [said.role for said, _ in named]
    if "q" not in roles or _TORQUES.isdisjoint(roles) or len({*roles}) < len(roles):
        return {}
    parts = {
        said.column: _read(path, _READERS[suffix_of(path)]) for said, path in named
    }
    for table in parts.values():
        held = {meaning(name).role for name in table.names}
        if "q" in held and held & _TORQUES:
            return {}
    return parts


def suffix_of(path: Path) -> str:
    """What the name of a file says of its format: its end, with that of what is packed in it."""
    ends = (
        path.suffixes[-2:] if path.suffix.lower() == ".gz" else path.suffixes[-1:]
    )
    return "".join(ends).lower()


def _open_log(path: str | Path, mapping: ColumnMap | None) -> tables.Table:
    """The table in a file, by its kind."""
    path = Path(path)
    suffix = suffix_of(path)
    try:
        if not isdir(path):
            size_of(path)
    except FileNotFoundError:
        raise BadRecording(path, "no such file") from None
    except OSError as error:
        why = f"cannot be read ({error.strerror}); give a file"
        raise BadRecording(path, why) from None
    is_bag = bags.is_bag(path)
    if parts := quantities_in(path):
        return tables.joined_table(path, parts)
    if isdir(path) and not is_bag:
        why = "is a folder without metadata.yaml of a ROS 2 bag; give a file, or a bag"
        raise BadRecording(path, why)
    if not is_bag and suffix not in _READERS:
        known = ".parquet or .csv, .json, .npz, .mat, .bag or .mcap"
        raise BadRecording(path, f"unknown format '{suffix}'; give {known}")
    if is_bag:
        topic = mapping.topic if mapping else None
        return _read(path, lambda bag: bags.bag_table(bag, topic))
    return _read(path, _READERS[suffix])


def _read(path: Path, reader: Callable[[Path], tables.Table]) -> tables.Table:
    """The table in a file; any error of its reader as the refusal of the file."""
    try:
        if suffix_of(path) in (".npz", ".mat"):  # which are read whole
            refuse_size(size_of(path))
        return reader(path)
    except (BadRecording, ModuleNotFoundError):
        raise
    except Exception as error:  # readers of others raise anything on a damaged file
        raise tables.unreadable(path, error) from None


def _pieces(
    table: tables.Table,
    robot: Robot | int,
    mapping: ColumnMap | None,
    rows: int | None = None,
) -> Iterator[Recording]:
    """A log in pieces of at most so many rows, or whole with its other columns; nothing refused.

    Its first time becomes 0.
    """
    origin: tuple[float, float] | None = None
    table, columns = resolve(table, robot, mapping or ColumnMap())
    narrow = columns.names if rows is not None or table.joined else None
    timed = columns.t_unit is not None or len(columns.t) > 1
    for frame in table.frames(rows, narrow):
        if rows is not None and not len(frame[columns.t[0]]):
            continue
        if not timed:
            names = columns.q.columns
            q = np.column_stack([cells.as_numbers(frame[name]) for name in names])
            possible = partial(_possible, q * columns.q.factors, robot)
            unit, what = cells.stamps_unit(frame[columns.t[0]], possible)
            said = (f"time: {columns.t[0]} holds {what}",) if unit else ()
            columns = replace(columns, t_unit=unit, notes=(*columns.notes, *said))
        timed = True
        raw, origin = _in_si_units(table, frame, columns, origin)
        if not rows:  # stamps may be those of arrival
            t, notes = cells.regular_clock(raw.t, raw.q, raw.columns[0])
            raw = replace(raw, t=t, notes=raw.notes + notes)
        yield raw


def _possible(q: Array, robot: Robot | int, step: float) -> bool:
    """Whether an arm can move as positions, shape (n, nv), say whose rows are a step apart [s].

    These are no poses in any order, and over a twentieth of the log the usual speed is within three
    times the limit at every joint whose positions may be radians or metres.
    """
    q = q[np.isfinite(q).all(axis=1)]
    if len(q) < 3:
        return True
    if not samples_motion(q):
        return False
    rows = max(1, len(q) // 20)
    speed = np.median(np.abs(q[rows:] - q[:-rows]), axis=0) / (rows * step)
    limit = np.inf if isinstance(robot, int) else robot.limits.velocity
    believed = np.abs(q).max(axis=0) <= 2 * np.pi
    return not (believed & (speed > FASTEST * limit)).any()


def _in_si_units(
    table: tables.Table,
    frame: cells.Frame,
    columns: Columns,
    origin: tuple[float, float] | None,
) -> tuple[Recording, tuple[float, float]]:
    """Some rows of a log in SI units, with the text of cells that are no numbers, and its origin.

    ``origin``, in whole and remaining seconds, becomes 0; the first time when None.
    """
    unreadable: dict[tuple[int, str], str] = {}

    def note_unreadable(column: str, values: Array) -> None:
        for row in np.flatnonzero(~np.isfinite(values))[:_REMEMBERED]:
            unreadable[int(row), column] = str(np.asarray(frame[column])[row])

    def values_of(channel: Channel) -> Array:
        values = [cells.as_numbers(frame[name]) for name in channel.columns]
        for name, column in zip(channel.columns, values, strict=True):
            note_unreadable(name, column)
        with np.errstate(over="ignore", invalid="ignore"):
            return channel.in_si_units(values)

    time = columns.t[0]
    whole, rest = cells.in_seconds(frame[time], columns.t_unit)
    if len(columns.t) == 2:
        rest = rest + 1e-9 * cells.as_numbers(frame[columns.t[1]])
    note_unreadable(time, whole + rest)
    if origin is None:
        usable = np.isfinite(whole + rest)
        times = zip(whole[usable], rest[usable], strict=True)
        origin = next(times, (0.0, 0.0))
    with np.errstate(invalid="ignore", over="ignore"):
        t = (whole - origin[0]) + (rest - origin[1])
    others = {name: x for name, x in frame.items() if name not in columns.names}
    recording = Recording(
        name=Path(table.file).stem,
        file=table.file,
        t=t,
        q=values_of(columns.q),
        tau=values_of(columns.tau),
        unit=columns.unit,
        dq=None if columns.dq is None else values_of(columns.dq),
        notes=(*table.notes, *columns.notes),
        extras={
            name: cells.as_numbers(x)
            for name, x in others.items()
            if x.dtype.kind in "iuf"
        },
        columns=(time, *columns.q.columns, *columns.tau.columns),
        read=columns,
        unreadable=unreadable,
    )
    return recording, origin
