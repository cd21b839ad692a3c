"""Recording: what an arm logged, checked before anything is computed from it."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from excitant.exceptions import BadRecording
from excitant.robots.motion import Array, freeze

MINIMUM_DURATION = 2.0  # s: less holds no motion to fit and to filter
TORQUE_COLUMNS = ("tau", "i")
UNITS = {"tau": "N·m", "i": "A"}


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
    """

    name: str
    file: str
    t: Array
    q: Array
    tau: Array
    unit: str = "N·m"

    def __post_init__(self) -> None:
        freeze(self, "t", "q", "tau")

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
        )


def read_recording(path: str | Path, joints: int, *, torque_column: str | None = None) -> Recording:
    """Recording from Parquet or CSV with columns ``t, q1.., tau1..`` (or ``i1..``).

    Args:
        path: File.
        joints: Number of joints of the arm.
        torque_column: Prefix of the torque columns; ``tau`` or else ``i`` when not given.

    Raises:
        BadRecording: Names the file, the row (from 0, after the header) and the column.
    """
    path = Path(path)
    table = _read_table(path)
    return recording_from_table(
        table, joints, file=str(path), name=path.stem, torque_column=torque_column
    )


def recording_from_table(
    table: pd.DataFrame,
    joints: int,
    *,
    file: str,
    name: str,
    torque_column: str | None = None,
) -> Recording:
    """Recording from a table in memory; see `read_recording`."""
    prefix = torque_column or _torque_prefix(table, file)
    _check_joint_count(table, "q", joints, file)
    _check_columns(table, prefix, joints, file)
    columns = ["t", *_names("q", joints), *_names(prefix, joints)]
    values = _numbers(table, columns, file)
    _check_time(values[:, 0], file)
    _check_alive(values[:, 1 + joints :], columns[1 + joints :], file)
    return Recording(
        name=name,
        file=file,
        t=values[:, 0] - values[0, 0],
        q=values[:, 1 : 1 + joints],
        tau=values[:, 1 + joints :],
        unit=UNITS.get(prefix, "N·m"),
    )


def _read_table(path: Path) -> pd.DataFrame:
    if not path.is_file():
        raise BadRecording(path, "no such file")
    try:
        if path.suffix.lower() in (".parquet", ".pq"):
            return pd.read_parquet(path)
        if path.suffix.lower() in (".csv", ".txt"):
            return pd.read_csv(path, skipinitialspace=True)
    except Exception as error:
        raise BadRecording(path, f"cannot be read ({str(error).splitlines()[0]})") from None
    raise BadRecording(path, f"unknown format '{path.suffix}'; give .parquet or .csv")


def _names(prefix: str, joints: int) -> list[str]:
    return [f"{prefix}{k + 1}" for k in range(joints)]


def _torque_prefix(table: pd.DataFrame, file: str) -> str:
    for prefix in TORQUE_COLUMNS:
        if f"{prefix}1" in table.columns:
            return prefix
    raise BadRecording(
        file,
        f"no torque: there is neither 'tau1' [N·m] nor 'i1' [A]; columns are "
        f"{', '.join(map(str, table.columns[:12]))}",
    )


def _numbered(table: pd.DataFrame, prefix: str) -> list[int]:
    pattern = re.compile(rf"{re.escape(prefix)}([1-9]\d*)$")
    return sorted(int(m.group(1)) for c in table.columns if (m := pattern.match(str(c))))


def _check_joint_count(table: pd.DataFrame, prefix: str, joints: int, file: str) -> None:
    found = _numbered(table, prefix)
    if found and found == list(range(1, len(found) + 1)) and len(found) != joints:
        span = f"{prefix}1" + (f"..{prefix}{len(found)}" if len(found) > 1 else "")
        plural = "s" if len(found) > 1 else ""
        raise BadRecording(
            file,
            f"has {len(found)} joint{plural} ({span}), the robot has {joints}; "
            "give the recording of this robot, or lock the joints that it leaves out",
        )
    _check_columns(table, prefix, joints, file)


def _check_columns(table: pd.DataFrame, prefix: str, joints: int, file: str) -> None:
    found = _numbered(table, prefix)
    for k in range(1, joints + 1):
        if k not in found:
            raise BadRecording(file, "is missing; rename or add it", column=f"{prefix}{k}")
    if len(found) > joints:
        raise BadRecording(
            file,
            f"belongs to no joint: the robot has {joints}; remove it or give the right robot",
            column=f"{prefix}{found[-1]}",
        )


def _numbers(table: pd.DataFrame, columns: list[str], file: str) -> Array:
    for column in columns:
        if column not in table.columns:
            raise BadRecording(file, "is missing; rename or add it", column=column)
    values = np.empty((len(table), len(columns)))
    for k, column in enumerate(columns):
        series = pd.to_numeric(table[column], errors="coerce")
        values[:, k] = series.to_numpy(float)
    bad = ~np.isfinite(values)
    if bad.any():
        row = int(np.argmax(bad.any(axis=1)))
        column = columns[int(np.argmax(bad[row]))]
        raise BadRecording(
            file,
            f"value '{table[column].iloc[row]}' is not a finite number "
            f"({int(bad.any(axis=1).sum())} such rows); remove or repair them",
            row=row,
            column=column,
        )
    return values


def _check_alive(tau: Array, columns: list[str], file: str) -> None:
    dead = np.ptp(tau, axis=0) == 0
    if dead.any():
        k = int(np.argmax(dead))
        raise BadRecording(
            file,
            f"dead channel: {tau[0, k]:g} in every row; repair the sensor or lock this joint",
            column=columns[k],
        )


def _check_time(t: Array, file: str) -> None:
    if len(t) < 2 or t[-1] - t[0] < MINIMUM_DURATION:
        duration = t[-1] - t[0] if len(t) else 0.0
        raise BadRecording(
            file,
            f"too short: {len(t)} samples over {duration:.3g} s, "
            f"at least {MINIMUM_DURATION:g} s are needed",
            column="t",
        )
    steps = np.diff(t)
    if (steps <= 0).any():
        row = int(np.argmax(steps <= 0)) + 1
        what = "repeats" if steps[row - 1] == 0 else "goes back"
        raise BadRecording(
            file,
            f"time {what} ({t[row]:.6g} after {t[row - 1]:.6g} s); sort or remove those rows",
            row=row,
            column="t",
        )
