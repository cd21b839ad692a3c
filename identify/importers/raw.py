"""RawRecording: a log as it is, its columns understood and in SI units, nothing refused yet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd

from excitant.identify.importers.columns import Channel, Columns, resolve
from excitant.identify.importers.groups import Joints
from excitant.identify.importers.mapping import ColumnMap
from excitant.identify.importers.seconds import as_numbers, in_seconds, stamps_unit
from excitant.identify.importers.sources import Source, open_source
from excitant.robots.motion import Array, freeze, read_only
from excitant.robots.robot import Robot

_REMEMBERED = 100  # unreadable cells whose text is kept


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

    @property
    def channels(self) -> dict[str, Array]:
        """Motion and torque by quantity (``q``, ``dq``, ``tau`` or ``i``) and the extras."""
        moved = {} if self.dq is None else {"dq": self.dq}
        return {"q": self.q, **moved, "tau" if self.unit != "A" else "i": self.tau, **self.extras}


def raw_recording(
    path: str | Path,
    robot: Robot | int,
    mapping: ColumnMap | None = None,
    *,
    torque_column: str | None = None,
) -> RawRecording:
    """A log as it is: columns found by name or by a map, units converted, rows untouched.

    Args:
        path: Any format of `open_source`.
        robot: The arm, or how many joints it has.
        mapping: What the user says about the columns.
        torque_column: Prefix of the torque columns, ``tau`` for ``tau1, tau2, ...``.

    Raises:
        BadRecording: A file that cannot be read, or columns that could mean several things.
        BadInput: A map that does not fit the robot.
    """
    source = open_source(path, topic=mapping.topic if mapping else None)
    return raw_from_source(
        source, Path(path).stem, robot, mapping=mapping, torque_column=torque_column
    )


def raw_from_source(
    source: Source,
    name: str,
    robot: Robot | int,
    *,
    mapping: ColumnMap | None = None,
    torque_column: str | None = None,
) -> RawRecording:
    """The raw recording of an opened log; see `raw_recording`."""
    columns = resolve(source, Joints.of(robot), mapping=mapping, torque_column=torque_column)
    frame = next(source.frames(None, columns.names if source.joined else None))
    return raw_from_frame(frame, source, name, timed(columns, frame))


def timed(columns: Columns, frame: pd.DataFrame) -> Columns:
    """The columns with the unit of time that the values show, where names say none."""
    if columns.t_unit is not None or len(columns.t) > 1:
        return columns
    unit = stamps_unit(frame[columns.t[0]])
    if unit is None or unit == "s":
        return columns
    what = "dates" if unit == "ISO 8601" else f"stamps since 1970 [{unit}]"
    notes = (*columns.notes, f"time: {columns.t[0]} holds {what}")
    return replace(columns, t_unit=unit, notes=notes)


def raw_from_frame(
    frame: pd.DataFrame,
    source: Source,
    name: str,
    columns: Columns,
    origin: tuple[float, float] | None = None,
) -> RawRecording:
    """The raw recording of a table whose columns are understood.

    Args:
        frame: Table with at least ``columns.names``.
        source: Log it comes from.
        name: Name for tables and figures.
        columns: Which columns are which.
        origin: Time that becomes 0, whole and remaining seconds; that of the first row when None.
    """
    texts: dict[tuple[int, str], str] = {}
    whole, rest = seconds_of(frame, columns)
    _remember(texts, frame, columns.t[0], whole + rest)
    zero = origin or first_of(whole, rest)
    with np.errstate(invalid="ignore", over="ignore"):
        t = (whole - zero[0]) + (rest - zero[1])
    return RawRecording(
        name=name,
        file=source.file,
        t=t,
        q=_channel(frame, columns.q, texts),
        tau=_channel(frame, columns.tau, texts),
        unit=columns.unit,
        dq=None if columns.dq is None else _channel(frame, columns.dq, texts),
        extras=_extras(frame, columns),
        columns=columns,
        notes=(*source.notes, *columns.notes),
        start=zero,
        unreadable=texts,
    )


def seconds_of(frame: pd.DataFrame, columns: Columns) -> tuple[Array, Array]:
    """Whole and remaining seconds of each row."""
    whole, rest = in_seconds(frame[columns.t[0]], columns.t_unit)
    if len(columns.t) == 2:
        rest = rest + 1e-9 * as_numbers(frame[columns.t[1]])
    return whole, rest


def first_of(whole: Array, rest: Array) -> tuple[float, float]:
    """Whole and remaining seconds of the first row that has a time; zeros where none has."""
    usable = np.flatnonzero(np.isfinite(whole + rest))
    return (float(whole[usable[0]]), float(rest[usable[0]])) if len(usable) else (0.0, 0.0)


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
        return values if (channel.scale == 1).all() else values * channel.scale


def _remember(
    texts: dict[tuple[int, str], str], frame: pd.DataFrame, column: str, values: Array
) -> None:
    for row in np.flatnonzero(~np.isfinite(values))[:_REMEMBERED]:
        texts[int(row), column] = str(frame[column].iloc[row])
