"""Recording: what an arm logged, checked before anything is computed from it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from excitant.exceptions import BadInput, BadRecording
from excitant.identify.importers.mapping import ColumnMap
from excitant.identify.importers.raw import RawRecording, open_log, raw_pieces, raw_recording
from excitant.identify.importers.tables import table_of_frame
from excitant.robots.html_table import html_table
from excitant.robots.motion import Array, freeze
from excitant.robots.robot import Robot

MINIMUM_DURATION = 2.0  # s: less holds no motion to fit and to filter


@dataclass(frozen=True, eq=False)
class Recording:
    """Logged motion and torque (or motor current) of all joints.

    Attributes:
        name: Name for tables and figures.
        file: File it was read from.
        t: Time, strictly increasing, not necessarily regular, shape (n,) [s].
        q: Measured positions, shape (n, nv) [rad or m].
        tau: Measured torque, shape (n, nv) [`unit`].
        unit: ``"N·m"`` or ``"A"``.
        dq: Measured speeds, shape (n, nv) [rad/s or m/s]; None where not logged.
        notes: How columns were understood and what was left out, one line each.
    """

    name: str
    file: str
    t: Array
    q: Array
    tau: Array
    unit: str = "N·m"
    dq: Array | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        freeze(self, "t", "q", "tau", *(("dq",) if self.dq is not None else ()))

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.t[-1] - self.t[0])

    def between(self, start: float, end: float, label: str) -> Recording:
        """The part between two fractions of its duration, 0 ≤ start < end ≤ 1."""
        low, high = self.t[0] + self.duration * start, self.t[0] + self.duration * end
        rows = (self.t >= low) & ((self.t <= high) if end >= 1 else (self.t < high))
        return replace(
            self,
            name=f"{self.name} ({label})",
            t=self.t[rows],
            q=self.q[rows],
            tau=self.tau[rows],
            dq=None if self.dq is None else self.dq[rows],
        )

    def _repr_html_(self) -> str:
        ranges = (edge(x, axis=0).tolist() for x in (self.q, self.tau) for edge in (np.min, np.max))
        rows = zip(range(1, self.q.shape[1] + 1), *ranges, strict=True)
        heads = ("joint", "q from", "q to", f"torque from [{self.unit}]", "torque to")
        title = f"Recording {self.name}: {len(self.t)} samples over {self.duration:.4g} s"
        return html_table(title, heads, rows)


def load_recording(
    path: str | Path,
    robot: Robot | int,
    *,
    mapping: ColumnMap | None = None,
    torque_column: str | None = None,
) -> Recording:
    """Recording from a log in any format of `excitant.identify.importers`.

    Args:
        path: Parquet, CSV, NPZ, MAT, bag or MCAP with columns ``t, q1.., tau1..`` (or ``i1..``),
            or with names that say the same.
        robot: The arm, whose joints are matched by name, or its number of joints.
        mapping: What the user says about the columns.
        torque_column: Prefix of the torque columns; ``tau`` or else ``i`` when not given.

    Raises:
        BadRecording: Names the file, the row (from 0, after the header) and the column.
        BadInput: A map of columns that does not fit the robot.
    """
    return recording_from_raw(raw_recording(path, robot, mapping, torque_column=torque_column))


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
    raw = next(raw_pieces(table_of_frame(table, file), robot, mapping, torque_column))
    return recording_from_raw(replace(raw, name=name))


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
    raw: RawRecording | None = None
    origin, end, extremes = None, None, np.zeros((0, 0))
    for file in files:
        table, first_row = open_log(file, mapping), 0
        for raw in raw_pieces(table, robot, mapping, torque_column, rows, origin):
            check_finite(raw, first_row)
            check_time(raw, first_row, end)
            seen = raw.tau if end is None else np.concatenate([extremes, raw.tau])
            extremes = np.array([seen.min(axis=0), seen.max(axis=0)])
            origin, end, first_row = raw.start, float(raw.t[-1]), first_row + len(raw.t)
            yield unchecked(raw)
    if raw is None or end is None or end < MINIMUM_DURATION:
        raise BadRecording(
            files[0] if files else "",
            f"too short: {end or 0.0:.3g} s, at least {MINIMUM_DURATION:g} s are needed",
            column="t",
        )
    check_alive(extremes, raw)


def recording_from_raw(raw: RawRecording) -> Recording:
    """The recording of a log, refused where a row cannot be used as it is.

    Speeds are left out, with a note, where some are no finite numbers; they are not needed.

    Raises:
        BadRecording: Cells that are no finite number, time that does not rise, a channel without
            signal, or less than `MINIMUM_DURATION`.
    """
    check_finite(raw)
    check_time(raw)
    if len(raw.t) < 2 or np.ptp(raw.t) < MINIMUM_DURATION:
        duration = float(np.ptp(raw.t)) if len(raw.t) else 0.0
        raise BadRecording(
            raw.file,
            f"too short: {len(raw.t)} samples over {duration:.3g} s, "
            f"at least {MINIMUM_DURATION:g} s are needed",
            column=raw.columns.t[0],
        )
    check_alive(raw.tau, raw)
    return unchecked(raw)


def unchecked(raw: RawRecording) -> Recording:
    """The recording of a log or piece whose rows have been checked."""
    dq, notes = raw.dq, raw.notes
    if dq is not None and not np.isfinite(dq).all():
        row = int(np.argmax(~np.isfinite(dq).all(axis=1)))
        dq, notes = None, (*notes, f"speeds left out: row {row} holds no finite number")
    return Recording(raw.name, raw.file, raw.t, raw.q, raw.tau, raw.unit, dq, notes)


def check_finite(raw: RawRecording, first_row: int = 0) -> None:
    """Refuse cells of time, position and torque that are no finite number.

    Args:
        raw: The log, or a part of it.
        first_row: Row of the log that its first row is.
    """
    values = np.column_stack([raw.t, raw.q, raw.tau])
    bad = ~np.isfinite(values)
    if not bad.any():
        return
    columns = [raw.columns.t[0], *raw.columns.q.columns, *raw.columns.tau.columns]
    row, k = np.argwhere(bad)[0].tolist()
    text = raw.unreadable.get((row, columns[k]), f"{values[row, k]:g}")
    why = f"value '{text}' is not a finite number ({int(bad.any(axis=1).sum())} such rows)"
    why += "; remove or repair them"
    raise BadRecording(raw.file, why, row=row + first_row, column=columns[k])


def check_time(raw: RawRecording, first_row: int = 0, before: float | None = None) -> None:
    """Refuse time that repeats or goes back.

    Args:
        raw: The log, or a part of it.
        first_row: Row of the log that its first row is.
        before: Time of the row before [s].
    """
    steps = np.diff(raw.t, prepend=-np.inf if before is None else before)
    if (steps > 0).all():
        return
    k = int(np.argmax(steps <= 0))
    last = raw.t[k - 1] if k else before
    why = (
        f"time {'repeats' if steps[k] == 0 else 'goes back'} ({raw.t[k]:.6g} after {last:.6g} s); "
        f"sort or remove those rows, which --repair does where they fit"
    )
    raise BadRecording(raw.file, why, row=k + first_row, column=raw.columns.t[0])


def check_alive(tau: Array, raw: RawRecording) -> None:
    """Refuse torque of a joint that is the same in every row.

    Args:
        tau: Torque, or the extremes of it, shape (n, nv).
        raw: The log that it comes from.
    """
    dead = np.flatnonzero(np.ptp(tau, axis=0) == 0)
    if len(dead):
        why = (
            f"dead channel: {tau[0, dead[0]]:g} in every row; repair the sensor or lock this joint"
        )
        raise BadRecording(raw.file, why, column=raw.columns.tau.columns[dead[0]])
