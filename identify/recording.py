"""Recording: what an arm logged, from a file to arrays in SI units, and checked."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from os.path import isdir
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeAlias

import numpy as np
import numpy.typing as npt

from excitant.exceptions import BadInput, BadRecording
from excitant.files import size_of
from excitant.identify.importers import bags, cells, tables
from excitant.identify.importers.arrays import refuse_size
from excitant.identify.importers.columns import Channel, Columns, resolve, with_names_of
from excitant.identify.importers.names import ColumnMap
from excitant.identify.importers.text import text_table
from excitant.robots.loading import RobotLike, as_robot
from excitant.robots.motion import Array, freeze, read_only
from excitant.robots.robot import Robot
from excitant.robots.shown import Shown, Table

if TYPE_CHECKING:
    import pandas as pd

    from excitant.identify.drive_gains import DriveGains

MINIMUM_DURATION = 2.0  # s: less holds no motion to fit and to filter
_RAREST = 1.0  # s between samples
CHANNELS = ("q", "dq", "tau")
_LINES: dict[str, Callable[[Path], tables.Table]] = {
    **dict.fromkeys((".csv", ".txt", ".tsv", ".dat", ".log", ".asc"), text_table),
    **dict.fromkeys((".json", ".jsonl", ".ndjson"), tables.json_table),
}
_READERS: dict[str, Callable[[Path], tables.Table]] = {
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
_REMEMBERED = 100  # unreadable cells whose text is kept


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Shown):
    """Logged motion and torque (or motor current) of all joints.

    `load_recording` refuses time that does not rise and cells that are no finite number;
    `raw_recording` leaves them (cells that are no number are NaN).

    Attributes:
        t: Time from the first row, not necessarily regular, shape (n,) [s].
        q: Measured positions, shape (n, nv) [rad or m].
        tau: Measured torque, shape (n, nv) [`unit`, ``"N·m"`` or ``"A"``].
        dq: Measured speeds, shape (n, nv) [rad/s or m/s]; None where not logged for all joints.
        notes: How columns were understood and what was left out, one line each.
        extras: Other numeric columns by name, as logged, each shape (n,).
        drive: Drive gains on which the torque rests, where it was recorded as current.
        starts: Times at which further windows of a longer log begin [s]; nothing is lost before.
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
    columns: tuple[str, ...] = ()  # names in the file, of time, positions and torque
    # of time as logged, whole and remaining seconds
    start: tuple[float, float] = (0.0, 0.0)
    unreadable: Mapping[tuple[int, str], str] = field(
        default_factory=dict
    )  # by row and column
    drive: DriveGains | None = None
    starts: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        freeze(self, "t", *(name for name, _ in self.channels()))
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
        return [
            (name, x) for name in CHANNELS if (x := getattr(self, name)) is not None
        ]

    def take(self, rows: npt.NDArray[Any] | slice) -> Self:
        """The recording at some of its rows."""
        arrays: dict[str, Any] = {
            n: x[rows] for n, x in (("t", self.t), *self.channels())
        }
        return replace(
            self, **arrays, extras={n: x[rows] for n, x in self.extras.items()}
        )

    def between(self, start: float, end: float, label: str) -> Recording:
        """The part between two fractions of its duration, 0 ≤ start < end ≤ 1."""
        low = self.t[0] + self.duration * start
        high = self.t[0] + self.duration * end
        last = np.searchsorted(self.t, high, "right" if end >= 1 else "left")
        part = self.take(slice(int(np.searchsorted(self.t, low)), int(last)))
        return replace(part, name=f"{self.name} ({label})")

    def to_frame(self) -> pd.DataFrame:
        """The recording as a table ``t, q1.., dq1.., tau1..`` (or ``i1..``) and other columns."""
        import pandas as pd

        said = {"tau": "i"} if self.unit == "A" else {}
        columns = {
            f"{said.get(name, name)}{j + 1}": values[:, j]
            for name, values in self.channels()
            for j in range(self.nv)
        }
        return pd.DataFrame({"t": self.t, **columns, **self.extras})

    def _lines(self) -> list[str]:
        rate = (len(self) - 1) / self.duration if self.duration > 0 else 0.0
        logged = [name for name, _ in self.channels()]
        return [
            f"Recording {self.name}: {len(self)} samples over {self.duration:.4g} s",
            f"{self.nv} joints at {rate:.4g} Hz: {', '.join(logged)} [{self.unit}]"
            + f"; also {', '.join(self.extras)}" * bool(self.extras),
            f"from {self.file}",
        ]

    def _table(self) -> Table:
        ranges = (
            edge(x, axis=0).tolist()
            for x in (self.q, self.tau)
            for edge in (np.min, np.max)
        )
        rows = zip(range(1, self.nv + 1), *ranges, strict=True)
        heads = ("joint", "q from", "q to", f"torque from [{self.unit}]", "torque to")
        return heads, rows


RecordingLike: TypeAlias = "Recording | pd.DataFrame | str | Path"
"""A recording, a table in memory, or a file."""
Recordings: TypeAlias = "RecordingLike | Sequence[RecordingLike]"


def as_recordings(given: Recordings, robot: Robot) -> list[Recording]:
    """Recordings themselves, and those of tables and files; see `load_recording`.

    Raises:
        BadRecording: One that cannot be used, or of another number of joints than the robot's.
    """
    # recordings and data frames have columns, which tells them without importing pandas
    some: Any = given
    one = isinstance(given, str | Path) or hasattr(given, "columns")
    several = [some] if one else list(some)
    read = iter(list[Recording]())
    found = list[Recording]()
    if paths := [each for each in several if isinstance(each, str | Path)]:
        from excitant.identify.dataset import read_recordings

        read = iter(read_recordings(paths, robot))
    for k, each in enumerate(several, start=1):
        if isinstance(each, str | Path):
            each = next(read)
        elif not isinstance(each, Recording):
            each = recording_from_table(
                each, robot, file=f"table {k}", name=f"table {k}"
            )
        found.append(each)
        if found[-1].nv != robot.nv:
            why = f"has {found[-1].nv} joints, but {robot.name} has {robot.nv}"
            raise BadRecording(found[-1].file, f"{why}; load it for this robot")
    return found


def load_recording(
    path: str | Path, robot: RobotLike | int, *, mapping: ColumnMap | None = None
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


def raw_recording(
    path: str | Path, robot: RobotLike | int, mapping: ColumnMap | None = None
) -> Recording:
    """A log as it is: columns understood, units converted, no row refused; see `load_recording`."""
    return next(_pieces(_open_log(path, mapping), robot, mapping))


def recording_from_table(
    table: pd.DataFrame,
    robot: RobotLike | int,
    *,
    file: str,
    name: str,
    mapping: ColumnMap | None = None,
) -> Recording:
    """Recording from a table in memory; see `load_recording`."""
    raw = next(_pieces(tables.table_of_frame(table, file), robot, mapping))
    return checked(replace(raw, name=name))


def read_chunks(
    paths: str | Path | Sequence[str | Path],
    robot: RobotLike | int,
    rows: int = 100_000,
    *,
    mapping: ColumnMap | None = None,
) -> Iterator[Recording]:
    """A log larger than memory as recordings of some rows each, checked as `load_recording` does.

    What only the whole can show, a channel without signal or a log that is too short, is refused
    after the last piece.

    Args:
        paths: A log, or the files it was split into, in order; ``t`` counts from its first sample.
        robot: The arm, or its number of joints.
        rows: Most rows of a piece.
        mapping: What the user says about the columns.
    """
    if rows < 1:
        raise BadInput(f"rows is {rows}; a piece must hold at least one row")
    files = [paths] if isinstance(paths, str | Path) else list(paths)
    origin = None
    end = -np.inf
    extremes = np.zeros((0, 0))
    for file in files:
        first_row = 0
        for raw in _pieces(_open_log(file, mapping), robot, mapping, rows, origin):
            _refuse_bad_rows(raw, first_row, end)
            seen = np.concatenate([extremes, raw.tau]) if len(extremes) else raw.tau
            extremes = np.array([seen.min(axis=0), seen.max(axis=0)])
            origin = raw.start
            end = float(raw.t[-1])
            first_row = first_row + len(raw)
            yield _with_usable_speeds(raw)
    if end < MINIMUM_DURATION:
        why = f"too short: {max(end, 0.0):.3g} s, at least {MINIMUM_DURATION:g} s are needed"
        raise BadRecording(files[0] if files else "", why, column="t")
    _refuse_dead(extremes, raw)


def suffix_of(path: Path) -> str:
    """What the name of a file says of its format: its end, with that of what is packed in it."""
    ends = path.suffixes[-2:] if path.suffix.lower() == ".gz" else path.suffixes[-1:]
    return "".join(ends).lower()


def _open_log(path: str | Path, mapping: ColumnMap | None) -> tables.Table:
    path = Path(path)
    is_bag = bags.is_bag(path)
    suffix = suffix_of(path)
    why = f"unknown format '{suffix}'; give .parquet or .csv, .json, .npz, .mat, .bag or .mcap"
    try:
        size = 0 if isdir(path) else size_of(path)
    except FileNotFoundError:
        raise BadRecording(path, "no such file") from None
    except OSError as error:
        why = f"cannot be read ({error.strerror}); give a file"
        raise BadRecording(path, why) from None
    if isdir(path) and not is_bag:
        why = "is a folder without metadata.yaml of a ROS 2 bag; give a file, or a bag"
    elif is_bag or suffix in _READERS:
        try:
            if suffix in (".npz", ".mat"):  # which are read whole
                refuse_size(size)
            if is_bag:
                return bags.bag_table(path, mapping.topic if mapping else None)
            return _READERS[suffix](path)
        except (BadRecording, ModuleNotFoundError):
            raise
        except Exception as error:  # readers of others raise anything on a damaged file
            raise tables.unreadable(path, error) from None
    raise BadRecording(path, why)


def _pieces(
    table: tables.Table,
    robot: RobotLike | int,
    mapping: ColumnMap | None,
    rows: int | None = None,
    origin: tuple[float, float] | None = None,
) -> Iterator[Recording]:
    """A log in pieces of at most so many rows, or whole with its other columns; nothing refused.

    ``origin`` is the time that becomes 0, that of the first row when None.
    """
    if not isinstance(robot, int):
        robot = as_robot(robot)
        table = with_names_of(table, robot.joints)
    columns = resolve(table, robot, mapping or ColumnMap())
    narrow = columns.names if rows is not None or table.joined else None
    timed = columns.t_unit is not None or len(columns.t) > 1
    for frame in table.frames(rows, narrow):
        if rows is not None and not len(frame[columns.t[0]]):
            continue
        if not timed:
            unit, what = cells.stamps_unit(frame[columns.t[0]])
            notes = (f"time: {columns.t[0]} holds {what}",) if unit else ()
            columns = replace(columns, t_unit=unit, notes=(*columns.notes, *notes))
        timed = True
        raw = _in_si_units(table, frame, columns, origin)
        origin = raw.start
        yield raw


def _in_si_units(
    table: tables.Table,
    frame: cells.Frame,
    columns: Columns,
    origin: tuple[float, float] | None,
) -> Recording:
    texts: dict[tuple[int, str], str] = {}

    def remembered(column: str, values: Array) -> Array:
        for row in np.flatnonzero(~np.isfinite(values))[:_REMEMBERED]:
            texts[int(row), column] = str(np.asarray(frame[column])[row])
        return values

    def channel(found: Channel) -> Array:
        values = [
            remembered(name, cells.as_numbers(frame[name])) for name in found.columns
        ]
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray(np.column_stack(values) * found.factors)

    whole, rest = cells.in_seconds(frame[columns.t[0]], columns.t_unit)
    if len(columns.t) == 2:
        rest = rest + 1e-9 * cells.as_numbers(frame[columns.t[1]])
    usable = np.flatnonzero(np.isfinite(remembered(columns.t[0], whole + rest)))
    if origin is None:
        origin = (
            (float(whole[usable[0]]), float(rest[usable[0]]))
            if len(usable)
            else (0.0, 0.0)
        )
    with np.errstate(invalid="ignore", over="ignore"):
        t = (whole - origin[0]) + (rest - origin[1])
    return Recording(
        name=Path(table.file).stem,
        file=table.file,
        t=t,
        q=channel(columns.q),
        tau=channel(columns.tau),
        unit=columns.unit,
        dq=None if columns.dq is None else channel(columns.dq),
        notes=(*table.notes, *columns.notes),
        extras={
            name: cells.as_numbers(values)
            for name, values in frame.items()
            if name not in columns.names and values.dtype.kind in "iuf"
        },
        columns=(columns.t[0], *columns.q.columns, *columns.tau.columns),
        start=origin,
        unreadable=texts,
    )


def checked(raw: Recording) -> Recording:
    """The recording, refused where a row cannot be used; speeds with holes are left out.

    Raises:
        BadRecording: Cells that are no finite number, time that does not rise, a channel without
            signal, or less than `MINIMUM_DURATION`.
    """
    _refuse_bad_rows(raw)
    duration = raw.duration if len(raw) else 0.0
    if duration < MINIMUM_DURATION:
        why = f"too short: {len(raw)} samples over {duration:.3g} s, at least"
        why = f"{why} {MINIMUM_DURATION:g} s are needed"
        raise BadRecording(raw.file, why, column=raw.columns[0])
    _refuse_dead(raw.tau, raw)
    return _with_usable_speeds(raw)


def _refuse_bad_rows(
    raw: Recording, first_row: int = 0, before: float = -np.inf
) -> None:
    """Refuse cells of time, position and torque that are no finite number, and time not rising.

    Of a part of a log, ``first_row`` is its first row's, ``before`` the time of the row before [s].
    """
    values = np.column_stack([raw.t, raw.q, raw.tau])
    bad = ~np.isfinite(values)
    with np.errstate(invalid="ignore"):  # between times that are not finite
        steps = np.diff(raw.t, prepend=before)
    if bad.any():
        row, k = np.argwhere(bad)[0].tolist()
        text = raw.unreadable.get((row, raw.columns[k]), f"{values[row, k]:g}")
        why = f"value '{text}' is not a finite number ({int(bad.any(axis=1).sum())} such rows)"
        why += "; remove or repair them"
    elif (steps <= 0).any():
        row = int(np.argmax(steps <= 0))
        k = 0
        why = (
            f"time {'repeats' if steps[row] == 0 else 'goes back'} "
            f"({raw.t[row]:.6g} after {raw.t[row] - steps[row]:.6g} s); "
            f"sort or remove those rows, which --repair does where they fit"
        )
    elif len(raw) > 2 and (step := float(np.median(steps[1:]))) > _RAREST:
        row = 0
        k = 0
        why = (
            f"samples are {step:.4g} s apart, which shows no motion; say the unit of time in a "
            "file for --map, such as {units: {t: ms}}"
        )
    else:
        return
    raise BadRecording(raw.file, why, row=row + first_row, column=raw.columns[k])


def _refuse_dead(tau: Array, raw: Recording) -> None:
    """Refuse torque (or its extremes), shape (n, nv), of a joint that is the same in every row."""
    dead = np.flatnonzero(np.ptp(tau, axis=0) == 0)
    if len(dead):
        value = tau[0, dead[0]]
        column = raw.columns[1 + raw.nv + dead[0]]
        why = f"dead channel: {value:g} in every row; repair the sensor or lock this joint"
        raise BadRecording(raw.file, why, column=column)


def _with_usable_speeds(raw: Recording) -> Recording:
    if raw.dq is None or np.isfinite(raw.dq).all():
        return raw
    row = int(np.argmax(~np.isfinite(raw.dq).all(axis=1)))
    note = f"speeds left out: row {row} holds no finite number"
    return replace(raw, dq=None, notes=(*raw.notes, note))
