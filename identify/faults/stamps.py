"""Faults of the time stamps: repeated, going back, counted instead of timed, with gaps."""

from __future__ import annotations

import numpy as np

from excitant.identify.faults.fault import Fault, Remedy
from excitant.identify.faults.log import Log

_BACK = 1.5  # of a step: nearer to two steps than to one


def stamp_faults(log: Log) -> list[Fault]:
    """Stamps that are missing, repeat, go back, or leave samples out."""
    found = [_not_finite(log), _repeated(log), _backward(log)]
    return [fault for fault in found if fault is not None]


def gap_fault(log: Log) -> Fault | None:
    """Samples that are missing between stamps, for a log in the order of time.

    A step counts as a gap when it is nearer to a whole number ≥ 2 of median steps than to one,
    and when together with either neighbour it is nearer to three than to two: a stamp that came
    late is made up for by the next, a sample that is missing is not.
    """
    steps = np.diff(log.t) / log.step
    if len(steps) < 3:
        return None
    padded = np.concatenate([[1.0], steps, [1.0]])
    pairs = np.minimum(padded[:-2], padded[2:]) + steps
    gaps = (steps > _BACK) & (pairs > _BACK + 1)
    if not gaps.any():
        return None
    missing = np.round(steps[gaps] - 1).astype(int)
    at = np.flatnonzero(gaps)
    k = int(at[np.argmax(steps[gaps])])
    return Fault(
        "dropped_samples",
        log.joints,
        f"{len(at)} gaps in time, about {missing.sum()} samples missing of "
        f"{len(log) + missing.sum()}; the longest, {steps[k] * log.step:.4g} s after "
        f"t = {log.t[k]:.4g} s, is {steps[k]:.3g} times the median step of {log.step:.4g} s",
        {"gaps": len(at), "missing": int(missing.sum()), "rows": at, "longest": steps[k]},
    )


def _not_finite(log: Log) -> Fault | None:
    rows = np.flatnonzero(~np.isfinite(log.t))
    if not len(rows):
        return None
    return Fault(
        "corrupt_rows",
        log.joints,
        f"{len(rows)} of {len(log)} time stamps are no numbers, first in row {rows[0]}",
        {"rows": rows, "count": len(rows), "channel": "t"},
        f"leaves these {len(rows)} rows out",
        (Remedy("drop", rows=rows),),
    )


def _repeated(log: Log) -> Fault | None:
    """Rows with the stamp of an earlier row at which time stood still."""
    rows = np.flatnonzero(np.diff(log.t) == 0) + 1
    if not len(rows):
        return None
    same = np.all([(x[rows] == x[rows - 1]).all(axis=1) for _, x in log.channels()], axis=0)
    return Fault(
        "duplicate_samples",
        log.joints,
        f"{len(rows)} of {len(log)} rows ({len(rows) / len(log):.2%}) repeat the time of the row "
        f"before, {int(same.sum())} of them all its values too; first row {rows[0]} at "
        f"t = {log.t[rows[0]]:.4g} s",
        {"rows": rows, "count": len(rows), "identical": int(same.sum())},
        f"keeps the first of each and leaves {len(rows)} rows out",
        (Remedy("drop", rows=rows),),
    )


def _backward(log: Log) -> Fault | None:
    """Rows that are earlier than one before them."""
    t = np.where(np.isfinite(log.t), log.t, -np.inf)
    latest = np.maximum.accumulate(t)
    rows = np.flatnonzero((t[1:] < latest[:-1]) & np.isfinite(log.t[1:])) + 1
    if not len(rows):
        return None
    k = int(rows[0])
    if len(rows) > len(log) // 2:  # one stamp too late, not all others too early
        ahead = np.minimum.accumulate(t[::-1])[::-1]
        rows = np.flatnonzero(t[:-1] > ahead[1:])
    return Fault(
        "corrupt_rows",
        log.joints,
        f"time goes back in {len(rows)} of {len(log)} rows, first from {log.t[k - 1]:.6g} to "
        f"{log.t[k]:.6g} s in row {k}",
        {"rows": rows, "count": len(rows), "channel": "t"},
        f"leaves these {len(rows)} rows out",
        (Remedy("drop", rows=rows),),
    )


def counted(log: Log) -> bool:
    """Whether the time is the number of the sample: every step exactly one."""
    return bool(len(log) > 3 and (np.diff(log.t) == 1.0).all())
