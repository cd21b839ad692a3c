"""RawRecording: a log as it is, its columns understood and in SI units, nothing refused yet."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd

from excitant.exceptions import BadRecording
from excitant.identify.importers.bags import bag_table
from excitant.identify.importers.columns import Channel, Columns, resolve
from excitant.identify.importers.mapping import ColumnMap
from excitant.identify.importers.tables import (
    Table,
    mat_table,
    npz_table,
    parquet_table,
    unreadable,
)
from excitant.identify.importers.text import text_table
from excitant.identify.importers.units import ISO, as_numbers, in_seconds, stamps_unit
from excitant.robots.motion import Array, freeze, read_only
from excitant.robots.robot import Robot

_READERS: dict[str, Callable[[Path], Table]] = {
    **dict.fromkeys((".parquet", ".pq"), parquet_table),
    **dict.fromkeys((".csv", ".txt", ".tsv"), text_table),
    ".npz": npz_table,
    ".mat": mat_table,
}
_BAGS = (".bag", ".mcap", ".db3")
SUFFIXES = (*_READERS, *_BAGS)
_REMEMBERED = 100  # unreadable cells whose text is kept
_NUMBERED = re.compile(r"(.*?)(\d+)(\.[^.]*)?", re.ASCII)  # run_, 12, .csv
_LONGEST_STEP = 10.0  # median steps between the last row of a part and the first of the next


@dataclass(frozen=True, eq=False)
class RawRecording:
    """What a log holds, row by row; cells that are no number are NaN.

    Attributes:
        name: Name for tables and figures.
        file: File it was read from.
        t: Time from the first row, as logged: not sorted, possibly repeated, shape (n,) [s].
        q: Positions, shape (n, nv) [rad or m].
        tau: Torques or motor currents, shape (n, nv) [`unit`].
        unit: ``"N·m"`` or ``"A"``.
        dq: Speeds, shape (n, nv) [rad/s or m/s]; None where not logged for all joints.
        extras: Other numeric columns by name, as logged, each shape (n,).
        columns: Which columns these are and how they were converted.
        notes: How columns were understood and what was left out, one line each.
        start: Time of the first row as logged, whole and remaining seconds [s].
        unreadable: Text of cells that are no number, by row and column.
    """

    name: str
    file: str
    t: Array
    q: Array
    tau: Array
    unit: str
    dq: Array | None
    extras: Mapping[str, Array]
    columns: Columns
    notes: tuple[str, ...] = ()
    start: tuple[float, float] = (0.0, 0.0)
    unreadable: Mapping[tuple[int, str], str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        freeze(self, "t", "q", "tau", *(("dq",) if self.dq is not None else ()))
        frozen = {name: read_only(values) for name, values in self.extras.items()}
        object.__setattr__(self, "extras", frozen)


def raw_recording(
    path: str | Path,
    robot: Robot | int,
    mapping: ColumnMap | None = None,
    *,
    torque_column: str | None = None,
) -> RawRecording:
    """A log as it is: columns found by name or by a map, units converted, rows untouched.

    Args:
        path: Any format of `open_log`.
        robot: The arm, or how many joints it has.
        mapping: What the user says about the columns.
        torque_column: Prefix of the torque columns, ``tau`` for ``tau1, tau2, ...``.

    Raises:
        BadRecording: A file that cannot be read, or columns that could mean several things.
        BadInput: A map that does not fit the robot.
    """
    return next(raw_pieces(open_log(path, mapping), robot, mapping, torque_column))


def open_log(path: str | Path, mapping: ColumnMap | None = None) -> Table:
    """The log in a file, or in the folder of a ROS 2 bag, by its suffix.

    Args:
        path: Parquet, CSV, NPZ, MAT (up to version 7.2), ROS 1 or 2 bag, MCAP.
        mapping: What the user says, such as the topic of a bag that has several.

    Raises:
        BadRecording: No such file, an unknown format, or not readable as what it claims to be.
    """
    path = Path(path)
    is_bag_folder = (path / "metadata.yaml").is_file()
    if path.is_dir() and not is_bag_folder:
        why = "is a folder without metadata.yaml of a ROS 2 bag; give a file, or a bag"
        raise BadRecording(path, why)
    if not path.exists():
        raise BadRecording(path, "no such file")
    suffix = ".bag" if is_bag_folder else path.suffix.lower()
    if suffix not in SUFFIXES:
        why = f"unknown format '{path.suffix}'; give .parquet or .csv, .npz, .mat, .bag or .mcap"
        raise BadRecording(path, why)
    try:
        if suffix in _BAGS:
            return bag_table(path, mapping.topic if mapping else None)
        return _READERS[suffix](path)
    except (BadRecording, ModuleNotFoundError):
        raise
    except Exception as error:  # readers of others raise anything on a damaged file
        raise unreadable(path, error) from None


def raw_pieces(
    table: Table,
    robot: Robot | int,
    mapping: ColumnMap | None = None,
    torque_column: str | None = None,
    rows: int | None = None,
    origin: tuple[float, float] | None = None,
) -> Iterator[RawRecording]:
    """A log in pieces with rows, or whole with its other columns when ``rows`` is None.

    Args:
        table: The log.
        robot: The arm, or how many joints it has.
        mapping: What the user says about the columns.
        torque_column: Prefix of the torque columns.
        rows: Most rows of a piece.
        origin: Time that becomes 0, whole and remaining seconds; that of the first row when None.

    Raises:
        BadRecording: Columns that could mean several things, or a row that cannot be read.
        BadInput: A map that does not fit the robot.
    """
    logged = resolve(table, robot, mapping, torque_column)
    columns: Columns | None = None
    narrow = logged.names if rows is not None or table.joined else None
    for frame in table.frames(rows, narrow):
        if rows is not None and frame.empty:
            continue
        columns = columns or _timed(logged, frame)
        texts: dict[tuple[int, str], str] = {}
        whole, rest = in_seconds(frame[columns.t[0]], columns.t_unit)
        if len(columns.t) == 2:
            rest = rest + 1e-9 * as_numbers(frame[columns.t[1]])
        _remember(texts, frame, columns.t[0], whole + rest)
        if origin is None:
            usable = np.flatnonzero(np.isfinite(whole + rest))[:1]
            origin = (
                (float(whole[usable[0]]), float(rest[usable[0]])) if len(usable) else (0.0, 0.0)
            )
        with np.errstate(invalid="ignore", over="ignore"):
            t = (whole - origin[0]) + (rest - origin[1])
        yield RawRecording(
            name=Path(table.file).stem,
            file=table.file,
            t=t,
            q=_channel(frame, columns.q, texts),
            tau=_channel(frame, columns.tau, texts),
            unit=columns.unit,
            dq=None if columns.dq is None else _channel(frame, columns.dq, texts),
            extras=_extras(frame, columns),
            columns=columns,
            notes=(*table.notes, *columns.notes),
            start=origin,
            unreadable=texts,
        )


def _timed(columns: Columns, frame: pd.DataFrame) -> Columns:
    """The columns with the unit of time that the values show, where names say none."""
    if columns.t_unit is not None or len(columns.t) > 1:
        return columns
    unit = stamps_unit(frame[columns.t[0]])
    if unit is None or unit == "s":
        return columns
    what = "dates" if unit == ISO else f"stamps since 1970 [{unit}]"
    notes = (*columns.notes, f"time: {columns.t[0]} holds {what}")
    return replace(columns, t_unit=unit, notes=notes)


def _extras(frame: pd.DataFrame, columns: Columns) -> dict[str, Array]:
    """The other columns of numbers."""
    names = [str(name) for name in frame.columns]
    return {
        name: as_numbers(frame[name])
        for name in names
        if name not in columns.names
        and names.count(name) == 1
        and pd.api.types.is_numeric_dtype(frame[name])
    }


def _channel(frame: pd.DataFrame, channel: Channel, texts: dict[tuple[int, str], str]) -> Array:
    values = np.empty((len(frame), len(channel.columns)))
    for k, column in enumerate(channel.columns):
        values[:, k] = as_numbers(frame[column])
        _remember(texts, frame, column, values[:, k])
    with np.errstate(over="ignore", invalid="ignore"):
        return values * channel.factors


def _remember(
    texts: dict[tuple[int, str], str], frame: pd.DataFrame, column: str, values: Array
) -> None:
    for row in np.flatnonzero(~np.isfinite(values))[:_REMEMBERED]:
        texts[int(row), column] = str(frame[column].iloc[row])


def runs_of_parts(raws: Sequence[RawRecording]) -> Iterator[list[RawRecording]]:
    """Recordings as they are, those that are parts of one together.

    The next part has the same name with the next number, the same columns, and time that goes
    on where the last one ended: recordings that each start at 0 are never parts of one.
    """
    run: list[RawRecording] = []
    for raw in raws:
        if run and not _continues(run[-1], raw):
            yield run
            run = []
        run.append(raw)
    if run:
        yield run


def put_together(parts: Sequence[RawRecording]) -> RawRecording:
    """One recording of its parts, in order."""
    first, last = parts[0], parts[-1]
    speeds = [raw.dq for raw in parts if raw.dq is not None]
    common = [name for name in first.extras if all(name in raw.extras for raw in parts)]
    return replace(
        first,
        name=f"{first.name}..{last.name}",
        t=np.concatenate([raw.t + _between(first, raw) for raw in parts]),
        q=np.concatenate([raw.q for raw in parts]),
        tau=np.concatenate([raw.tau for raw in parts]),
        dq=np.concatenate(speeds) if len(speeds) == len(parts) else None,
        extras={name: np.concatenate([raw.extras[name] for raw in parts]) for name in common},
        notes=(*first.notes, f"parts of one recording: {', '.join(raw.name for raw in parts)}"),
        unreadable={},
    )


def _continues(before: RawRecording, raw: RawRecording) -> bool:
    """Whether a log is the next part of the one before."""
    one, other = Path(before.file), Path(raw.file)
    first, second = _NUMBERED.fullmatch(one.name), _NUMBERED.fullmatch(other.name)
    alike = before.columns.names == raw.columns.names and before.unit == raw.unit
    if not alike or one.parent != other.parent or first is None or second is None:
        return False
    next_name = first[1], first[3], int(first[2]) + 1
    if (second[1], second[3], int(second[2])) != next_name or len(before.t) < 3 or not len(raw.t):
        return False
    gap = _between(before, raw) - float(before.t[-1])
    return 0 < gap <= _LONGEST_STEP * float(np.median(np.diff(before.t)))


def _between(one: RawRecording, other: RawRecording) -> float:
    """Time from the first row of one to that of another [s]."""
    return (other.start[0] - one.start[0]) + (other.start[1] - one.start[1])
