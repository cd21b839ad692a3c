"""Values that cannot be: no numbers, wrapped counters, outliers, positions that jump."""

from __future__ import annotations

from collections.abc import Callable

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
_COUNTERS = (2.0**8, 2.0**10, 2.0**12, 2.0**16, 2.0**32)


def missing_values(log: Log) -> Fault | None:
    """Rows with values that are no finite numbers."""
    bad = [~np.isfinite(x) for _, x in log.channels()]
    rows = np.flatnonzero(np.any([b.any(axis=1) for b in bad], axis=0))
    if not len(rows):
        return None
    joints = np.flatnonzero(np.any([b.any(axis=0) for b in bad], axis=0))
    return Fault(
        "corrupt_rows",
        log.names(joints),
        f"{len(rows)} of {len(log)} rows hold values that are no finite numbers, first row "
        f"{rows[0]} at t = {log.t[rows[0]]:.4g} s",
        {"rows": rows, "count": len(rows)},
        f"leaves these {len(rows)} rows out",
        (Remedy("drop", rows=rows),),
    )


def wrapped_counters(log: Log) -> list[Fault]:
    """Channels whose negative values were logged as a counter's upper half, or that wrap.

    A wrapped channel jumps by the full range of the counter, a power of two of its steps (a full
    turn for positions), leaves the middle of its range empty, and is smooth without the jumps.
    """
    found = []
    for name, x in log.channels():
        for j in range(log.nv):
            size = _wrap(x[:, j], name == "q")
            if size is None:
                continue
            jumps = int((np.abs(np.diff(x[:, j])) > size / 2).sum())
            high = int((x[:, j] > x[:, j].min() + size / 2).sum())
            found.append(
                Fault(
                    "corrupt_rows",
                    log.names([j]),
                    f"{name} of {log.joints[j]} jumps {jumps} times by {size:.6g}, the range of "
                    f"a counter: {high} of {len(log)} values "
                    + ("are a turn off" if name == "q" else "are negative ones logged unsigned"),
                    {"channel": name, "range": size, "jumps": jumps, "count": high},
                    f"takes {size:.6g} off where the counter wrapped",
                    (Remedy("unwrap", name, (j,), factor=size),),
                )
            )
    return found


def _wrap(x: Array, position: bool) -> float | None:
    change = np.abs(np.diff(x))
    span = float(np.ptp(x))
    jumps = change > 0.5 * span
    if span == 0 or jumps.sum() < 2 or jumps.mean() > 0.2:
        return None
    if not position and x.min() < 0:
        return None
    middle = (x - x.min()) / span
    if np.mean((middle > 0.35) & (middle < 0.65)) > 0.01:
        return None
    size, typical = float(np.median(change[jumps])), float(np.quantile(change[~jumps], 0.9))
    step = quantum(x)
    known = [2 * np.pi, 360.0] if position else [65536.0 * 10.0**k for k in range(-6, 1)]
    known += [] if position else [step * c for c in _COUNTERS]
    near = [k for k in known if abs(k - size) <= 3 * typical + 2 * step]
    if not near:
        return None
    best = min(near, key=lambda k: abs(k - size))
    unwrapped = unwrap(x, best, position)
    smooth = np.abs(np.diff(unwrapped)).max() < 0.5 * best
    return best if smooth and (position or np.ptp(unwrapped) < 0.9 * span) else None


def unwrap(x: Array, size: float, position: bool) -> Array:
    """A channel without the jumps of its counter: continuous, or signed."""
    if position:
        return np.asarray(np.unwrap(x, period=size), float)
    return np.asarray(np.where(x > size / 2, x - size, x), float)


def outliers(log: Log, jumps: Rows | None = None) -> list[Fault]:
    """Single values or short bursts far off their neighbours, and positions that jump.

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
    """
    r = {name: _distance(log.t, x) for name, x in log.channels()}
    if jumps is not None:
        around = np.clip(np.asarray(jumps)[:, None] + np.arange(-2, 4), 0, len(log) - 1)
        for values in r.values():
            values[around] = 0.0
    alarm = ALARM / (log.nv * len(r))
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
    hits = {
        (name, j): np.flatnonzero(mask[:, j])
        for name, mask in far.items()
        for j in range(log.nv)
        if mask[:, j].any()
    }
    return _as_faults(log, hits) if hits else []


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


def _as_faults(log: Log, hits: dict[tuple[str, int], Rows]) -> list[Fault]:
    """One fault for rows that are wrong in most channels, one for each wrong channel."""
    count = np.zeros(len(log), int)
    for rows in hits.values():
        count[rows] += 1
    total = log.nv * len(log.channels())
    whole = np.flatnonzero(count > _MANY * total) if total > 1 else np.zeros(0, np.intp)
    found = []
    if len(whole):
        found.append(
            Fault(
                "corrupt_rows",
                log.joints,
                f"{len(whole)} of {len(log)} rows are far from their neighbours in most columns, "
                f"as rows with shifted columns are; first row {whole[0]} at "
                f"t = {log.t[whole[0]]:.4g} s",
                {"rows": whole, "count": len(whole)},
                f"leaves these {len(whole)} rows out",
                (Remedy("drop", rows=whole),),
            )
        )
    for (name, j), rows in hits.items():
        left = np.setdiff1d(rows, whole)
        if len(left):
            found.append(_of_channel(log, name, j, left))
    return found


def _of_channel(log: Log, name: str, j: int, rows: Rows) -> Fault:
    x = getattr(log, name)[:, j]
    median = scipy.ndimage.median_filter(x, size=min(_WINDOW, len(x)), mode="nearest")
    k = int(rows[np.argmax(np.abs(x - median)[rows])])
    return Fault(
        "corrupt_rows",
        log.names([j]),
        f"{name} of {log.joints[j]} is far from its neighbours in {len(rows)} of {len(log)} rows; "
        f"worst row {k} at t = {log.t[k]:.4g} s: {x[k]:.5g} where those around have "
        f"{median[k]:.5g}",
        {"channel": name, "rows": rows, "count": len(rows), "value": x[k], "around": median[k]},
        f"interpolates {name} of {log.joints[j]} over these {len(rows)} rows",
        (Remedy("interpolate", name, (j,), rows),),
    )
