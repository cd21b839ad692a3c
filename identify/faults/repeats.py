"""Rows that were logged twice, channels that were held, and rows that are missing unseen."""

from __future__ import annotations

import numpy as np

from excitant.identify.faults.fault import ALARM, Fault, Remedy, Rows
from excitant.identify.faults.log import Log
from excitant.identify.faults.statistics import run_lengths, tail_bound
from excitant.robots.motion import Array

_FRESH = 0.2  # of the typical change: smaller counts as "hardly changed"
_HELD = 25  # samples
_WHOLE = 0.25  # how near to a whole number of samples a jump must be


def repeated_rows(log: Log) -> Fault | None:
    """Rows that repeat all values of the row before, with a stamp of their own.

    Counted only where some joint moves by several resolutions per sample, so that not one
    position would repeat by itself; three such rows are no accident.
    """
    rows, places, longest = repeats_in(log)
    first = float(log.t[rows[0]]) if len(rows) else 0.0
    return repeats_fault(log.joints, len(log), rows, places, longest, first)


def repeats_in(log: Log) -> tuple[Rows, int, int]:
    """Rows that repeat the one before while joints move, in how many places, the longest one."""
    same = np.all([(np.diff(x, axis=0) == 0).all(axis=1) for _, x in log.channels()], axis=0)
    if not same.any():
        return np.zeros(0, np.intp), 0, 0
    moved = np.asarray(log.moving.any(axis=1))
    rows = np.flatnonzero(same & (moved[1:] | moved[:-1])) + 1
    starts, lengths = run_lengths(same)
    return rows, int(np.isin(starts + 1, rows).sum()), int(lengths.max()) + 1


def repeats_fault(
    joints: tuple[str, ...], n: int, rows: Rows, places: int, longest: int, first: float
) -> Fault | None:
    """The fault of rows that repeat, from the first on at a time [s]; None for fewer than three."""
    if len(rows) < 3:
        return None
    return Fault(
        "duplicate_samples",
        joints,
        f"{len(rows)} of {n} rows ({len(rows) / n:.2%}) repeat every value of the row before while "
        f"joints move, in {places} places; first row {rows[0]} at t = {first:.4g} s",
        {"rows": rows, "count": len(rows), "longest": longest},
        f"leaves these {len(rows)} rows out",
        (Remedy("drop", rows=rows),),
    )


def held_channels(log: Log) -> list[Fault]:
    """Channels that are refreshed more seldom than they are logged.

    Changes of a measured channel are distributed without a peak at zero: no change at all is
    rarer than a small one. Where it is more frequent by far more than chance, values were held.
    """
    found = []
    for name, x in log.channels():
        held = {j: share for j in range(log.nv) if (share := _held_share(log, x[:, j], j)) > 0}
        if held:
            worst = max(held, key=lambda j: held[j])
            found.append(
                Fault(
                    "duplicate_samples",
                    log.names(held),
                    f"{name} of {', '.join(log.names(held))} is held: {held[worst]:.1%} of its "
                    f"samples at {log.joints[worst]} repeat the one before exactly while the "
                    f"joint moves, though the others change by many steps of its resolution",
                    {"channel": name, "share": [held[j] for j in held]},
                )
            )
    return found


def _held_share(log: Log, x: Array, j: int) -> float:
    starts, lengths = run_lengths(np.diff(x) == 0)
    fresh_rows = np.ones(len(x) - 1, bool)
    for start, length in zip(starts, lengths, strict=True):
        fresh_rows[start : start + length] = length < _HELD  # longer ones are dead, not held
    moved = log.moving[1:, j] & log.moving[:-1, j] & fresh_rows
    change = np.abs(np.diff(x))[moved]
    fresh = change[change > 0]
    if len(change) < 50 or len(fresh) < 25:
        return 0.0
    small = fresh <= _FRESH * np.median(fresh)
    if small.sum() < 5:
        return 0.0  # coarse steps: no change is as good as a small one
    none, few = len(change) - len(fresh), int(small.sum())
    excess = none - few - 5 * np.sqrt(none + few)
    return none / len(change) if excess > 0 and none > 0.02 * len(change) else 0.0


def hidden_gaps(log: Log) -> Fault | None:
    """Rows that are missing though the stamps run on."""
    rows, m = jumps_in(log)
    return jumps_fault(log.joints, rows, m, float(log.t[rows[0]])) if len(rows) else None


def jumps_in(log: Log, alarm: float = ALARM) -> tuple[Rows, Array]:
    """Rows after which all joints jump by a whole number of samples, and that number.

    m is that number from all joints by least squares, tested against its own scatter.
    """
    none = np.zeros(0, np.intp), np.zeros(0)
    rate = np.diff(log.q, axis=0) / np.diff(log.t)[:, None]
    n = len(rate)
    if n < 30:
        return none
    speed = _around(rate)
    scale = np.median(np.abs(rate - speed), axis=0) / 0.6745 + 1e-12 * np.abs(rate).max(axis=0)
    scale = np.maximum(scale, 2 * log.quantum / log.step / np.sqrt(12))
    used = scale > 0
    s, e = speed[:, used] / scale[used], (rate - speed)[:, used] / scale[used]
    power = (s**2).sum(axis=1)
    m = (s * e).sum(axis=1) / np.maximum(power, 1e-300)
    z = np.abs(m) * np.sqrt(power)
    shared = 1 - ((e - m[:, None] * s) ** 2).sum(axis=1) / np.maximum((e**2).sum(axis=1), 1e-300)
    whole = (np.round(m) >= 1) & (np.abs(m - np.round(m)) < _WHOLE)
    alone = np.abs(m) > 2 * np.maximum(np.abs(np.roll(m, 1)), np.abs(np.roll(m, -1)))
    several = ((np.abs(s) > 3).sum(axis=1) >= 2) if log.nv > 1 else np.zeros(n, bool)
    rows = np.flatnonzero((z > tail_bound(z, alarm)) & whole & alone & several & (shared > 0.95))
    rows = rows[(rows > 5) & (rows < n - 6)]
    return rows, m[rows]


def jumps_fault(joints: tuple[str, ...], rows: Rows, m: Array, first: float) -> Fault:
    """The fault of rows missing after some rows, m at each, the first at a time [s]."""
    missing = int(np.round(m).sum())
    return Fault(
        "dropped_samples",
        joints,
        f"all joints jump together in {len(rows)} places by whole numbers of samples, about "
        f"{missing} rows are missing though the stamps run on; first after "
        f"t = {first:.4g} s, where q moves {1 + m[0]:.2f} times as far as its speed allows",
        {"rows": rows, "missing": missing, "ratio": 1 + m},
    )


def _around(rate: Array, half: int = 4) -> Array:
    """Median of the neighbours of each value, itself left out, shape as given."""
    padded = np.pad(rate, ((half, half), (0, 0)), mode="edge")
    shifted = [padded[half + k : half + k + len(rate)] for k in range(-half, half + 1) if k]
    return np.asarray(np.median(shifted, axis=0), float)
