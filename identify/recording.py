"""Recording: measured motion and torque of an arm in SI units, and the checks it must pass."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NoReturn, Self, TypeAlias

import numpy as np
import numpy.typing as npt

from excitant.exceptions import BadRecording
from excitant.identify.signals import samples_motion
from excitant.robots.motion import Array, freeze, read_only
from excitant.robots.robot import Robot
from excitant.robots.shown import Shown, Table

if TYPE_CHECKING:
    import pandas as pd

    from excitant.identify.drive_gains import DriveGains
    from excitant.identify.reading.columns import Columns

MINIMUM_DURATION = 2.0  # s: less holds no motion to fit and to filter
LONGEST_STEP_S = 1.0  # median sample step: a slower log shows no motion of an arm
LONGEST_POSE_S = 86_400.0  # between two poses: more is no time in seconds
LEAST_RATE_HZ = 10.0  # of a motion: torque is filtered at a fifth of it
FASTEST = 3.0  # times the velocity limits: no arm moves so at most joints
CHANNELS = ("q", "dq", "tau")


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
    # names in the file, of time, positions and torque
    columns: tuple[str, ...] = ()
    # where they were read from a file
    read: Columns | None = None
    # by row and column
    unreadable: Mapping[tuple[int, str], str] = field(default_factory=dict)
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

    @cached_property
    def step(self) -> float:
        """Median time step [s]."""
        steps = np.diff(self.t)
        forward = steps[steps > 0]
        return float(np.median(forward)) if len(forward) else 1.0

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

        prefixes = {"tau": "i"} if self.unit == "A" else {}
        columns = {
            f"{prefixes.get(name, name)}{j + 1}": values[:, j]
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
        heads = (
            "joint",
            "q from",
            "q to",
            f"torque from [{self.unit}]",
            "torque to",
        )
        return heads, rows


Recordings: TypeAlias = Recording | Sequence[Recording]


def recordings_of(recordings: Recordings, robot: Robot) -> list[Recording]:
    """One recording or several of a robot by name: results are functions of the set.

    Raises:
        BadRecording: One of another number of joints than the robot's.
    """
    several = (
        [recordings] if isinstance(recordings, Recording) else list(recordings)
    )
    for recording in several:
        if recording.nv != robot.nv:
            why = f"has {recording.nv} joints, but {robot.name} has {robot.nv}"
            raise BadRecording(recording.file, f"{why}; load it for this robot")
    return sorted(several, key=lambda r: (r.name, r.tau.tobytes()))


def checked(raw: Recording) -> Recording:
    """The recording, refused where a row cannot be used; speeds with holes are left out.

    Raises:
        BadRecording: Cells that are no finite number, time that does not rise, a channel without
            signal, or less than `MINIMUM_DURATION`.
    """
    refuse_bad_rows(raw)
    duration = raw.duration if len(raw) else 0.0
    if duration < MINIMUM_DURATION:
        why = (
            f"too short: {len(raw)} samples over {duration:.3g} s, at least "
            f"{MINIMUM_DURATION:g} s are needed; leave it out or record longer"
        )
        raise BadRecording(raw.file, why, column=raw.columns[0])
    refuse_constant_torque(raw.tau, raw, np.ptp(raw.q, axis=0) > 0)
    return with_finite_speeds(raw)


def refuse_bad_rows(
    raw: Recording, first_row: int = 0, before: float = -np.inf
) -> None:
    """Refuse cells of time, position and torque that are not finite, and time not rising.

    Args:
        raw: A log, or a part of one.
        first_row: Row of the log at which the part begins.
        before: Time of the row before the part [s].

    Raises:
        BadRecording: Names the row of the log and the column.
    """

    def refuse(row: int, column: str, why: str) -> NoReturn:
        raise BadRecording(raw.file, why, row=row + first_row, column=column)

    values = np.column_stack([raw.t, raw.q, raw.tau])
    bad = ~np.isfinite(values)
    if bad.any():
        row, k = np.argwhere(bad)[0].tolist()
        column = raw.columns[k]
        text = raw.unreadable.get((row, column), f"{values[row, k]:g}")
        rows = int(bad.any(axis=1).sum())
        why = f"value '{text}' is not a finite number ({rows} such rows)"
        refuse(row, column, f"{why}; remove or repair them")
    steps = np.diff(raw.t, prepend=before)
    time = raw.columns[0]
    if (steps <= 0).any():
        row = int(np.argmax(steps <= 0))
        why = (
            f"time {'repeats' if steps[row] == 0 else 'goes back'} "
            f"({raw.t[row]:.6g} after {raw.t[row] - steps[row]:.6g} s); "
            f"sort or remove those rows, which --repair does where they fit"
        )
        refuse(row, time, why)
    step = float(np.median(steps[1:])) if len(raw) > 2 else 0.0
    if step > LONGEST_POSE_S:
        why = (
            f"rows are {step:.4g} s apart, more than a day: say the unit of time in a file for "
            "--map, such as {units: {t: ms}}"
        )
        refuse(0, time, why)


def shows_poses(raw: Recording) -> bool:
    """Whether rows are too far apart to show a motion: they are poses.

    Steps of 1 count samples or seconds: positions are then no samples of a motion, or no joint has
    speed, or they change by what speeds say of a second; between samples at `LEAST_RATE_HZ` by a
    tenth of it.
    """
    step = float(np.median(np.diff(raw.t))) if len(raw) > 2 else 0.0
    if step != LONGEST_STEP_S:
        return step > LONGEST_STEP_S
    if not samples_motion(raw.q):
        return True
    if raw.dq is None or not np.isfinite(raw.dq).all():
        return False
    way = (raw.dq[1:] + raw.dq[:-1]) / 2
    if not way.any():
        return True
    seconds = (np.diff(raw.q, axis=0) * way).sum() / max((way**2).sum(), 1e-300)
    return bool(seconds > 0.5)


def refuse_constant_torque(
    tau: Array, raw: Recording, moves: npt.ArrayLike = True
) -> None:
    """Refuse torque, shape (n, nv), or its extremes, that is constant while its joint moves."""
    dead = np.flatnonzero((np.ptp(tau, axis=0) == 0) & moves)
    if len(dead):
        joint = int(dead[0])
        why = f"dead channel: {tau[0, joint]:g} in every row; repair the sensor or lock this joint"
        raise BadRecording(raw.file, why, column=raw.columns[1 + raw.nv + joint])


def with_finite_speeds(raw: Recording) -> Recording:
    """The recording without its speeds where any of them is no finite number."""
    if raw.dq is None or np.isfinite(raw.dq).all():
        return raw
    row = int(np.argmax(~np.isfinite(raw.dq).all(axis=1)))
    note = f"speeds left out: row {row} holds no finite number"
    return replace(raw, dq=None, notes=(*raw.notes, note))
