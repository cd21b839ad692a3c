"""Values that cannot be: no numbers, outliers, positions that jump."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.ndimage

from excitant.identify.faults.fault import ALARM, Fault, Remedy, Rows
from excitant.identify.faults.log import Log, quantum
from excitant.identify.faults.statistics import local_scale, tail_bound
from excitant.robots.motion import Array

_PATTERN = np.array([1 / 6, -2 / 3, 1.0, -2 / 3, 1 / 6])  # residual around one outlier
_LIKE = 0.9  # cosine from which on a residual looks like that of one outlier
_WINDOW = 11  # samples of the running median
_JOLT = 5  # samples to either side that a jolt may disturb
_GAP = 1.75  # steps: the interpolation does not reach across
_MANY = 0.5  # of all channels: the row is at fault, not a channel


def missing_values(log: Log) -> Fault | None:
    """Rows with values that are no finite numbers."""
    rows, joints = missing_in(log)
    if not len(rows):
        return None
    return missing_fault(log.names(joints), len(log), rows, float(log.t[rows[0]]))


def missing_in(log: Log) -> tuple[Rows, Rows]:
    """Rows with values that are no finite numbers, and joints concerned."""
    bad = [~np.isfinite(x) for _, x in log.channels()]
    rows = np.flatnonzero(np.any([b.any(axis=1) for b in bad], axis=0))
    return rows, np.flatnonzero(np.any([b.any(axis=0) for b in bad], axis=0))


def missing_fault(joints: tuple[str, ...], n: int, rows: Rows, first: float) -> Fault:
    """The fault of such rows, the first at a time [s]."""
    return Fault(
        "corrupt_rows",
        joints,
        f"{len(rows)} of {n} rows hold values that are no finite numbers, first row "
        f"{rows[0]} at t = {first:.4g} s",
        {"rows": rows, "count": len(rows)},
        f"leaves these {len(rows)} rows out",
        (Remedy("drop", rows=rows),),
    )


Hits = dict[tuple[str, int], Rows]
"""Rows of values that cannot be, by channel and joint."""


def outliers(log: Log, jumps: Rows | None = None) -> list[Fault]:
    """Single values or short bursts far off their neighbours, and positions that jump."""
    whole, hits = apart(outlying(log, jumps), log)
    found = [rows_fault(log.joints, len(log), whole, float(log.t[whole[0]]))] if len(whole) else []
    for (name, j), rows in hits.items():
        found.append(values_fault(log.joints[j], j, len(log), rows, worst(log, name, j, rows)))
    return found


def outlying(log: Log, jumps: Rows | None = None, alarm: float = ALARM) -> Hits:
    """Values that cannot be.

    r is the distance of a value from the cubic through its four neighbours (their own times),
    over its local scale. Beyond what the largest of n such values reaches by chance
    (`tail_bound`) a value is an outlier only if nothing that happened explains it:

    * it stands apart from the running median, which a step does not;
    * a position is off by more than half its way from sample to sample (less is jitter of the
      stamp) and looks like a single wrong value, or jumps beyond all speeds of the joint;
    * a velocity is contradicted by the positions around it;
    * neither comes with a jolt: a velocity that the positions confirm, or those of several joints
      at once where the positions are in order, as a brake or an impact makes them.

    Args:
        log: The log, in the order of time.
        jumps: Rows before which samples are missing, where nothing is judged.
        alarm: Probability that anything is found in a log without outliers.
    """
    r = {name: _distance(log.t, x) for name, x in log.channels()}
    if jumps is not None:
        around = np.clip(np.asarray(jumps)[:, None] + np.arange(-2, 4), 0, len(log) - 1)
        for values in r.values():
            values[around] = 0.0
    alarm = alarm / (log.nv * len(r))
    far = {name: _far_of(x, r[name], alarm) for name, x in log.channels()}
    far["q"] &= _each(log, lambda j: _impossible(log, j, r["q"][:, j]))
    for name, x in log.channels():
        if name != "q":
            far[name] &= np.column_stack([_apart(x[:, j], r[name][:, j]) for j in range(log.nv)])
    if "dq" in far:
        real = far["dq"] & ~_each(log, lambda j: _contradicted(log, j, r["dq"][:, j]))
        shared = (_near(far["dq"]).sum(axis=1) > 1) & ~_near(far["q"]).any(axis=1)
        jolts = _near((real.any(axis=1) | shared)[:, None], _JOLT)
        far["dq"] &= ~jolts
        far["tau"] &= ~jolts
    return {
        (name, j): np.flatnonzero(mask[:, j])
        for name, mask in far.items()
        for j in range(log.nv)
        if mask[:, j].any()
    }


_Mask = npt.NDArray[np.bool_]


def _each(log: Log, judge: Callable[[int], _Mask]) -> _Mask:
    """A verdict joint by joint, shape (n, nv)."""
    return np.column_stack([judge(j) for j in range(log.nv)])


def _near(mask: _Mask, reach: int = 1) -> _Mask:
    """A mask widened along the rows."""
    wide = scipy.ndimage.maximum_filter1d(mask.astype(np.uint8), 2 * reach + 1, axis=0)
    return np.asarray(wide, bool)


def _far_of(x: Array, r: Array, alarm: float) -> _Mask:
    return np.column_stack([_far(x[:, j], r[:, j], alarm) for j in range(x.shape[1])])


def _far(x: Array, r: Array, alarm: float) -> _Mask:
    z = np.abs(r) / np.maximum(local_scale(r), 1e-12 * (np.ptp(x) or 1.0))
    floor = max(quantum(x), 1e-9 * float(np.ptp(x)))
    return np.asarray((z > tail_bound(z[z > 0], alarm)) & (np.abs(r) > 3 * floor), bool)


def _apart(x: Array, r: Array) -> _Mask:
    """Whether values stand apart from the running median; unknown, so no, at the ends."""
    median = scipy.ndimage.median_filter(x, size=min(_WINDOW, len(x)), mode="nearest")
    apart = np.abs(x - median) > 0.5 * np.abs(r)
    reach = _WINDOW // 2
    apart[:reach], apart[len(x) - reach :] = False, False
    return np.asarray(apart, bool)


def _impossible(log: Log, j: int, r: Array) -> _Mask:
    """Whether a position cannot have been where it was logged."""
    change = np.abs(np.diff(log.q[:, j], prepend=log.q[:1, j]))
    jump = change > 3 * np.quantile(change, 0.99)
    jump[:-1] |= jump[1:]
    off = np.abs(r) > 0.5 * np.abs(log.travel[:, j])
    return np.asarray(off & ((_alike(r) > _LIKE) | jump), bool)


def _contradicted(log: Log, j: int, r: Array) -> _Mask:
    """Whether the positions around a velocity speak against it."""
    way = np.zeros(len(log))
    way[1:-1] = (log.q[2:, j] - log.q[:-2, j]) / (log.t[2:] - log.t[:-2])
    speed = np.asarray(log.dq)[:, j]
    steps = 3 * max(log.resolution[j], log.quantum[j]) / log.step
    return np.asarray(np.abs(speed - way) > 0.5 * np.abs(r) + steps, bool)


def _distance(t: Array, x: Array) -> Array:
    """Distance of each value from the cubic through two neighbours on either side, (n, nv)."""
    n = len(t)
    r = np.zeros_like(x)
    if n < 11:
        return r
    k = np.arange(2, n - 2)
    around = [k - 2, k - 1, k + 1, k + 2]
    guess = np.zeros_like(x[k])
    for i in around:
        others = [m for m in around if m is not i]
        weight = np.prod([(t[k] - t[m]) / (t[i] - t[m]) for m in others], axis=0)
        guess += weight[:, None] * x[i]
    r[k] = x[k] - guess
    steps = np.diff(t)
    wide = steps > _GAP * np.median(steps)
    for shift in range(-2, 2):
        rows = np.flatnonzero(wide) - shift
        r[np.clip(rows, 0, n - 1)] = 0.0
    return r


def _alike(r: Array) -> Array:
    """Cosine between the distances around each value and those around one outlier, (n,)."""
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(r, 2), 5)
    size = np.linalg.norm(windows, axis=1) * np.linalg.norm(_PATTERN)
    return np.asarray(np.abs(windows @ _PATTERN) / np.maximum(size, 1e-300), float)


def apart(hits: Hits, log: Log) -> tuple[Rows, Hits]:
    """Rows that are wrong in most channels, and what else is wrong in single ones."""
    count = np.zeros(len(log), int)
    for rows in hits.values():
        count[rows] += 1
    total = log.nv * len(log.channels())
    whole = np.flatnonzero(count > _MANY * total) if total > 1 else np.zeros(0, np.intp)
    left = {key: np.setdiff1d(rows, whole) for key, rows in hits.items()}
    return whole, {key: rows for key, rows in left.items() if len(rows)}


def rows_fault(joints: tuple[str, ...], n: int, rows: Rows, first: float) -> Fault:
    """The fault of rows that are wrong in most columns, the first at a time [s]."""
    return Fault(
        "corrupt_rows",
        joints,
        f"{len(rows)} of {n} rows are far from their neighbours in most columns, as rows with "
        f"shifted columns are; first row {rows[0]} at t = {first:.4g} s",
        {"rows": rows, "count": len(rows)},
        f"leaves these {len(rows)} rows out",
        (Remedy("drop", rows=rows),),
    )


@dataclass(frozen=True)
class Worst:
    """The value of a channel that is farthest from its neighbours.

    Attributes:
        channel: Its name.
        row: Its row.
        t: Its time [s].
        value: What was logged.
        around: What its neighbours have.
    """

    channel: str
    row: int
    t: float
    value: float
    around: float

    @property
    def distance(self) -> float:
        """How far it is off."""
        return abs(self.value - self.around)


def worst(log: Log, name: str, j: int, rows: Rows) -> Worst:
    """The worst value of a channel among some rows."""
    x = getattr(log, name)[:, j]
    median = scipy.ndimage.median_filter(x, size=min(_WINDOW, len(x)), mode="nearest")
    k = int(rows[np.argmax(np.abs(x - median)[rows])])
    return Worst(name, k, float(log.t[k]), float(x[k]), float(median[k]))


def values_fault(joint: str, j: int, n: int, rows: Rows, bad: Worst) -> Fault:
    """The fault of single values of one channel of joint j, of a log of n rows."""
    return Fault(
        "corrupt_rows",
        (joint,),
        f"{bad.channel} of {joint} is far from its neighbours in {len(rows)} of {n} rows; worst "
        f"row {bad.row} at t = {bad.t:.4g} s: {bad.value:.5g} where those around have "
        f"{bad.around:.5g}",
        {"channel": bad.channel, "rows": rows, "count": len(rows), "value": bad.value,
         "around": bad.around},
        f"interpolates {bad.channel} of {joint} over these {len(rows)} rows",
        (Remedy("interpolate", bad.channel, (j,), rows),),
    )  # fmt: skip
