"""Recording: what an arm logged, from a file to arrays in SI units, and checked."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt
import pandas as pd

from excitant.exceptions import BadInput, BadRecording
from excitant.identify.importers.columns import Channel, Columns, resolve
from excitant.identify.importers.mapping import ColumnMap
from excitant.identify.importers.tables import (
    ISO,
    Table,
    as_numbers,
    bag_table,
    in_seconds,
    mat_table,
    npz_table,
    parquet_table,
    stamps_unit,
    table_of_frame,
    unreadable,
)
from excitant.identify.importers.text import text_table
from excitant.robots.html_table import html_table
from excitant.robots.motion import Array, freeze, read_only
from excitant.robots.robot import Robot

MINIMUM_DURATION = 2.0  # s: less holds no motion to fit and to filter
CHANNELS = ("q", "dq", "tau")
_READERS: dict[str, Callable[[Path], Table]] = {
    **dict.fromkeys((".parquet", ".pq"), parquet_table),
    **dict.fromkeys((".csv", ".txt", ".tsv"), text_table),
    ".npz": npz_table,
    ".mat": mat_table,
}
_BAGS = (".bag", ".mcap", ".db3")
SUFFIXES = (*_READERS, *_BAGS)
_REMEMBERED = 100  # unreadable cells whose text is kept


@dataclass(frozen=True, eq=False)
class Recording:
    """Logged motion and torque (or motor current) of all joints.

    `load_recording` refuses time that does not rise and cells that are no finite number;
    `raw_recording` leaves them (cells that are no number are NaN).

    Attributes:
        name: Name for tables and figures.
        file: File it was read from.
        t: Time from the first row, not necessarily regular, shape (n,) [s].
        q: Measured positions, shape (n, nv) [rad or m].
        tau: Measured torque, shape (n, nv) [`unit`].
        unit: ``"N·m"`` or ``"A"``.
        dq: Measured speeds, shape (n, nv) [rad/s or m/s]; None where not logged for all joints.
        notes: How columns were understood and what was left out, one line each.
        extras: Other numeric columns by name, as logged, each shape (n,).
        columns: Names in the file of the columns of time, positions and torque.
        start: Time of the first row as logged, whole and remaining seconds [s].
        unreadable: Text of cells that are no number, by row and column.
    """

    name: str
    file: str
    t: Array
    q: Array
    tau: Array
    unit: str = "N·m"
    dq: Array | None = None
    notes: tuple[str, ...] = ()
    extras: Mapping[str, Array] = field(default_factory=dict)
    columns: tuple[str, ...] = ()
    start: tuple[float, float] = (0.0, 0.0)
    unreadable: Mapping[tuple[int, str], str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        freeze(self, "t", "q", "tau", *(("dq",) if self.dq is not None else ()))
        frozen = {name: read_only(values) for name, values in self.extras.items()}
        object.__setattr__(self, "extras", frozen)

    def __len__(self) -> int:
        return len(self.t)

    @property
    def nv(self) -> int:
        """Number of joints."""
        return int(self.q.shape[1])

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.t[-1] - self.t[0])

    def channels(self) -> list[tuple[str, Array]]:
        """Names and arrays, shape (n, nv), of positions, speeds where logged, and torque."""
        return [(name, x) for name in CHANNELS if (x := getattr(self, name)) is not None]

    def take(self, rows: npt.NDArray[Any] | slice) -> Self:
        """The recording at some of its rows."""
        arrays: dict[str, Any] = {n: x[rows] for n, x in (("t", self.t), *self.channels())}
        extras = {name: x[rows] for name, x in self.extras.items()}
        return replace(self, **arrays, extras=extras)

    def between(self, start: float, end: float, label: str) -> Recording:
        """The part between two fractions of its duration, 0 ≤ start < end ≤ 1."""
        low, high = self.t[0] + self.duration * start, self.t[0] + self.duration * end
        last = np.searchsorted(self.t, high, "right" if end >= 1 else "left")
        part = self.take(slice(int(np.searchsorted(self.t, low)), int(last)))
        return replace(part, name=f"{self.name} ({label})")

    def _repr_html_(self) -> str:
        ranges = (edge(x, axis=0).tolist() for x in (self.q, self.tau) for edge in (np.min, np.max))
        rows = zip(range(1, self.nv + 1), *ranges, strict=True)
        heads = ("joint", "q from", "q to", f"torque from [{self.unit}]", "torque to")
        title = f"Recording {self.name}: {len(self)} samples over {self.duration:.4g} s"
        return html_table(title, heads, rows)


def load_recording(
    path: str | Path,
    robot: Robot | int,
    *,
    mapping: ColumnMap | None = None,
    torque_column: str | None = None,
) -> Recording:
    """Recording from a log: Parquet, CSV, NPZ, MAT (up to version 7.2), ROS 1 or 2 bag, MCAP.

    Args:
        path: File, or folder of a ROS 2 bag, with columns ``t, q1.., tau1..`` (or ``i1..``), or
            with names that say the same.
        robot: The arm, whose joints are matched by name, or its number of joints.
        mapping: What the user says about the columns.
        torque_column: Prefix of the torque columns; ``tau`` or else ``i`` when not given.

    Raises:
        BadRecording: Names the file, the row (from 0, after the header) and the column.
        BadInput: A map of columns that does not fit the robot.
    """
    return checked(raw_recording(path, robot, mapping, torque_column=torque_column))


def raw_recording(
    path: str | Path,
    robot: Robot | int,
    mapping: ColumnMap | None = None,
    *,
    torque_column: str | None = None,
) -> Recording:
    """A log as it is: columns understood, units converted, no row refused; see `load_recording`."""
    return next(_pieces(_open_log(path, mapping), robot, mapping, torque_column))


def recording_from_table(
    table: pd.DataFrame,
    robot: Robot | int,
    *,
    file: str,
    name: str,
    mapping: ColumnMap | None = None,
    torque_column: str | None = None,
) -> Recording:
    """Recording from a table in memory; see `load_recording`."""
    raw = next(_pieces(table_of_frame(table, file), robot, mapping, torque_column))
    return checked(replace(raw, name=name))


def read_chunks(
    paths: str | Path | Sequence[str | Path],
    robot: Robot | int,
    rows: int = 100_000,
    *,
    mapping: ColumnMap | None = None,
    torque_column: str | None = None,
) -> Iterator[Recording]:
    """A log larger than memory as recordings of some rows each, checked as `load_recording` does.

    What only the whole can show, a channel without signal or a log that is too short, is refused
    after the last piece.

    Args:
        paths: A log, or the files it was split into, in order.
        robot: The arm, or its number of joints.
        rows: Most rows of a piece.
        mapping: What the user says about the columns.
        torque_column: Prefix of the torque columns.

    Yields:
        Pieces of at least one row; ``t`` counts from the first sample of the log.

    Raises:
        BadRecording: As `load_recording`, when the piece at fault is reached.
        BadInput: ``rows`` below 1, or a map that does not fit the robot.
    """
    if rows < 1:
        raise BadInput(f"rows is {rows}; a piece must hold at least one row")
    files = [paths] if isinstance(paths, str | Path) else list(paths)
    origin, end, extremes = None, None, np.zeros((0, 0))
    for file in files:
        table, first_row = _open_log(file, mapping), 0
        for raw in _pieces(table, robot, mapping, torque_column, rows, origin):
            refuse_bad_rows(raw, first_row, end)
            seen = raw.tau if end is None else np.concatenate([extremes, raw.tau])
            extremes = np.array([seen.min(axis=0), seen.max(axis=0)])
            origin, end, first_row = raw.start, float(raw.t[-1]), first_row + len(raw)
            yield _with_usable_speeds(raw)
    if end is None or end < MINIMUM_DURATION:
        raise BadRecording(
            files[0] if files else "",
            f"too short: {end or 0.0:.3g} s, at least {MINIMUM_DURATION:g} s are needed",
            column="t",
        )
    _refuse_dead(extremes, raw)


def _open_log(path: str | Path, mapping: ColumnMap | None) -> Table:
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


def _pieces(
    table: Table,
    robot: Robot | int,
    mapping: ColumnMap | None,
    torque_column: str | None,
    rows: int | None = None,
    origin: tuple[float, float] | None = None,
) -> Iterator[Recording]:
    """A log in pieces of at most so many rows, or whole with its other columns; nothing refused.

    ``origin`` is the time that becomes 0, that of the first row when None.
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
        yield Recording(
            name=Path(table.file).stem,
            file=table.file,
            t=t,
            q=_channel(frame, columns.q, texts),
            tau=_channel(frame, columns.tau, texts),
            unit=columns.unit,
            dq=None if columns.dq is None else _channel(frame, columns.dq, texts),
            notes=(*table.notes, *columns.notes),
            extras=_extras(frame, columns),
            columns=(columns.t[0], *columns.q.columns, *columns.tau.columns),
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


def checked(raw: Recording) -> Recording:
    """The recording, refused where a row cannot be used as it is.

    Speeds are left out, with a note, where some are no finite numbers; they are not needed.

    Raises:
        BadRecording: Cells that are no finite number, time that does not rise, a channel without
            signal, or less than `MINIMUM_DURATION`.
    """
    refuse_bad_rows(raw)
    if len(raw) < 2 or raw.duration < MINIMUM_DURATION:
        raise BadRecording(
            raw.file,
            f"too short: {len(raw)} samples over {raw.duration if len(raw) else 0.0:.3g} s, "
            f"at least {MINIMUM_DURATION:g} s are needed",
            column=raw.columns[0],
        )
    _refuse_dead(raw.tau, raw)
    return _with_usable_speeds(raw)


def refuse_bad_rows(raw: Recording, first_row: int = 0, before: float | None = None) -> None:
    """Refuse cells of time, position and torque that are no finite number, and time not rising.

    Args:
        raw: The log, or a part of it.
        first_row: Row of the log that its first row is.
        before: Time of the row before [s].
    """
    values = np.column_stack([raw.t, raw.q, raw.tau])
    bad = ~np.isfinite(values)
    if bad.any():
        row, k = np.argwhere(bad)[0].tolist()
        text = raw.unreadable.get((row, raw.columns[k]), f"{values[row, k]:g}")
        why = f"value '{text}' is not a finite number ({int(bad.any(axis=1).sum())} such rows)"
        why += "; remove or repair them"
        raise BadRecording(raw.file, why, row=row + first_row, column=raw.columns[k])
    steps = np.diff(raw.t, prepend=-np.inf if before is None else before)
    if (steps <= 0).any():
        k = int(np.argmax(steps <= 0))
        last = raw.t[k - 1] if k else before
        why = (
            f"time {'repeats' if steps[k] == 0 else 'goes back'} "
            f"({raw.t[k]:.6g} after {last:.6g} s); "
            f"sort or remove those rows, which --repair does where they fit"
        )
        raise BadRecording(raw.file, why, row=k + first_row, column=raw.columns[0])


def _refuse_dead(tau: Array, raw: Recording) -> None:
    """Refuse torque (or its extremes), shape (n, nv), of a joint that is the same in every row."""
    dead = np.flatnonzero(np.ptp(tau, axis=0) == 0)
    if len(dead):
        value, column = tau[0, dead[0]], raw.columns[1 + raw.nv + dead[0]]
        why = f"dead channel: {value:g} in every row; repair the sensor or lock this joint"
        raise BadRecording(raw.file, why, column=column)


def _with_usable_speeds(raw: Recording) -> Recording:
    if raw.dq is None or np.isfinite(raw.dq).all():
        return raw
    row = int(np.argmax(~np.isfinite(raw.dq).all(axis=1)))
    return replace(
        raw, dq=None, notes=(*raw.notes, f"speeds left out: row {row} holds no finite number")
    )
