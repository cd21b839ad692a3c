"""Values that cannot be: no numbers, outliers, positions that jump."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy

from excitant.identify.faults.fault import Fault, Remedy, dropped
from excitant.identify.faults.log import (
    ALARM,
    Log,
    Mask,
    Rows,
    local_scale,
    quantum,
    running_median,
    tail_bound,
)
from excitant.robots.motion import Array

_PATTERN = np.array([1 / 6, -2 / 3, 1.0, -2 / 3, 1 / 6])  # residual around one outlier
_LIKE = 0.9  # cosine from which on a residual looks like that of one outlier
_WINDOW = 11  # samples of the running median
_JOLT = 5  # samples to either side that a jolt may disturb
_GAP = 1.75  # steps: the interpolation does not reach across
_MANY = 0.5  # of all channels: the row is at fault, not a channel


def missing_values(log: Log) -> Iterator[Fault]:
    """Rows with values that are no finite numbers."""
    bad = [~np.isfinite(x) for _, x in log.channels()]
    rows = np.flatnonzero(np.any([b.any(axis=1) for b in bad], axis=0))
    if not len(rows):
        return
    yield dropped(
        log.names(np.flatnonzero(np.any([b.any(axis=0) for b in bad], axis=0))),
        rows,
        f"{len(rows)} of {len(log)} rows hold values that are no finite numbers, first row "
        f"{rows[0]} at t = {log.t[rows[0]]:.4g} s",
    )


def outliers(log: Log, jumps: Rows | None = None) -> Iterator[Fault]:
    """Single values or short bursts far off their neighbours, and positions that jump.

    Args:
        log: The log, in the order of time.
        jumps: Rows before which samples are missing, where nothing is judged.
    """
    far = _outlying(log, jumps)
    count, total = sum(mask.sum(axis=1) for mask in far.values()), log.nv * len(far)
    whole = np.flatnonzero(count > _MANY * total)
    if len(whole):
        yield dropped(
            log.joints,
            whole,
            f"{len(whole)} of {len(log)} rows are far from their neighbours in most columns, as "
            f"rows with shifted columns are; first row {whole[0]} at t = {log.t[whole[0]]:.4g} s",
        )
    for name, mask in far.items():
        mask[whole] = False
        for j in np.flatnonzero(mask.any(axis=0)):
            yield _of_channel(log, name, int(j), np.flatnonzero(mask[:, j]))


def _of_channel(log: Log, name: str, j: int, rows: Rows) -> Fault:
    """The fault of single values of one channel of joint j."""
    values, joint = getattr(log, name), log.joints[j]
    x, median = values[:, j], running_median(values, _WINDOW)[:, j]
    k = int(rows[np.argmax(np.abs(x - median)[rows])])
    return Fault(
        "corrupt_rows",
        (joint,),
        f"{name} of {joint} is far from its neighbours in {len(rows)} of {len(log)} rows; worst "
        f"row {k} at t = {log.t[k]:.4g} s: {x[k]:.5g} where those around have {median[k]:.5g}",
        {
            "channel": name,
            "rows": rows,
            "count": len(rows),
            "value": float(x[k]),
            "around": float(median[k]),
        },
        f"interpolates {name} of {joint} over these {len(rows)} rows",
        (Remedy("interpolate", name, (j,), rows),),
    )


def _outlying(log: Log, jumps: Rows | None) -> dict[str, Mask]:
    """Values that cannot be, by channel, each (n, nv).

    r is the distance of a value from the cubic through its four neighbours (their own times),
    over its local scale. Beyond what the largest of n such values reaches by chance
    (`tail_bound`) a value is an outlier only if nothing that happened explains it:

    * it stands apart from the running median, which a step does not;
    * a position is off by more than half its way from sample to sample (less is jitter of the
      stamp) and looks like a single wrong value, or jumps beyond all speeds of the joint;
    * a velocity is contradicted by the positions around it;
    * neither comes with a jolt: a velocity that the positions confirm, or those of several joints
      at once where the positions are in order, as a brake or an impact makes them.
    """
    r = {name: _distance(log.t, x) for name, x in log.channels()}
    if jumps is not None:
        around = np.clip(np.asarray(jumps)[:, None] + np.arange(-2, 4), 0, len(log) - 1)
        for values in r.values():
            values[around] = 0.0
    alarm = ALARM / (log.nv * len(r))
    far = {name: _far(x, r[name], alarm) for name, x in log.channels()}
    far["q"] &= _impossible(log, r["q"])
    for name, x in log.channels():
        if name != "q":
            far[name] &= _apart(x, r[name])
    if log.dq is not None:
        real = far["dq"] & ~_contradicted(log, log.dq, r["dq"])
        shared = (_near(far["dq"]).sum(axis=1) > 1) & ~_near(far["q"]).any(axis=1)
        jolts = _near((real.any(axis=1) | shared)[:, None], _JOLT)
        far["dq"] &= ~jolts
        far["tau"] &= ~jolts
    return far


def _near(mask: Mask, reach: int = 1) -> Mask:
    """A mask widened along the rows."""
    wide = scipy.ndimage.maximum_filter1d(mask.astype(np.uint8), 2 * reach + 1, axis=0)
    return np.asarray(wide, bool)


def _far(x: Array, r: Array, alarm: float) -> Mask:
    """Whether values are farther off than by chance, and by more than their resolution."""
    span = np.ptp(x, axis=0)
    z = np.abs(r) / np.maximum(local_scale(r), 1e-12 * np.where(span > 0, span, 1.0))
    bound = [tail_bound(column[column > 0], alarm) for column in z.T]
    floor = np.maximum([quantum(column) for column in x.T], 1e-9 * span)
    return np.asarray((z > bound) & (np.abs(r) > 3 * floor), bool)


def _apart(x: Array, r: Array) -> Mask:
    """Whether values stand apart from the running median; unknown, so no, at the ends."""
    apart = np.abs(x - running_median(x, _WINDOW)) > 0.5 * np.abs(r)
    reach = _WINDOW // 2
    apart[:reach], apart[len(x) - reach :] = False, False
    return np.asarray(apart, bool)


def _impossible(log: Log, r: Array) -> Mask:
    """Whether a position cannot have been where it was logged."""
    change = np.abs(np.diff(log.q, axis=0, prepend=log.q[:1]))
    jump = change > 3 * np.quantile(change, 0.99, axis=0)
    jump[:-1] |= jump[1:]
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(r, ((2, 2), (0, 0))), 5, axis=0)
    size = np.linalg.norm(windows, axis=-1) * np.linalg.norm(_PATTERN)
    alike = np.abs(windows @ _PATTERN) / np.maximum(size, 1e-300)
    return np.asarray((np.abs(r) > 0.5 * np.abs(log.travel)) & ((alike > _LIKE) | jump), bool)


def _contradicted(log: Log, dq: Array, r: Array) -> Mask:
    """Whether the positions around a velocity speak against it."""
    way = np.zeros_like(dq)
    way[1:-1] = (log.q[2:] - log.q[:-2]) / (log.t[2:] - log.t[:-2])[:, None]
    return np.asarray(np.abs(dq - way) > 0.5 * np.abs(r) + 3 * log.grain / log.step, bool)


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
