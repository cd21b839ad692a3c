"""Faults of the time stamps: repeated, going back, counted instead of timed, with gaps."""

from __future__ import annotations

import numpy as np

from excitant.identify.faults.fault import Fault, Remedy, Rows
from excitant.identify.faults.log import Log
from excitant.identify.faults.order import Order
from excitant.robots.motion import Array

_BACK = 1.5  # of a step: nearer to two steps than to one
_LISTED = 5  # runs of rows that are spelt out


def stamp_faults(log: Log, order: Order) -> list[Fault]:
    """Stamps that are missing, repeat or go back.

    Args:
        log: The log as it came.
        order: How its rows come into the order of time.
    """
    found = [_not_finite(log), _repeated(log, order), *backward_faults(log.joints, log.t, order)]
    return [fault for fault in found if fault is not None]


def gap_fault(log: Log, starts: Array | None = None) -> Fault | None:
    """Samples that are missing between stamps, for a log in the order of time.

    A step counts as a gap when it is nearer to a whole number ≥ 2 of median steps than to one,
    and when together with either neighbour it is nearer to three than to two: a stamp that came
    late is made up for by the next, a sample that is missing is not.

    Args:
        log: The log.
        starts: Times from which on it is another part, before which nothing is missing [s].
    """
    at, steps = gaps_in(log.t, log.step, starts)
    if not len(at):
        return None
    missing = int(np.round(steps - 1).sum())
    k = int(np.argmax(steps))
    return dropped_fault(log.joints, len(log), at, missing, float(steps[k]), log.t[at[k]], log.step)


def gaps_in(t: Array, step: float, starts: Array | None = None) -> tuple[Rows, Array]:
    """Rows after which samples are missing, and the steps from there in median steps."""
    steps = np.diff(t) / step
    if len(steps) < 3:
        return np.zeros(0, np.intp), np.zeros(0)
    if starts is not None:
        steps[np.searchsorted(t, starts) - 1] = 1.0
    padded = np.concatenate([[1.0], steps, [1.0]])
    pairs = np.minimum(padded[:-2], padded[2:]) + steps
    at = np.flatnonzero((steps > _BACK) & (pairs > _BACK + 1))
    return at, steps[at]


def dropped_fault(
    joints: tuple[str, ...], n: int, rows: Rows, missing: int, longest: float, t: float, step: float
) -> Fault:
    """The fault of samples that are missing between stamps.

    Args:
        joints: All joints.
        n: Rows of the log.
        rows: Rows after which samples are missing.
        missing: How many are.
        longest: The longest gap [steps].
        t: When it begins [s].
        step: Median step [s].
    """
    return Fault(
        "dropped_samples",
        joints,
        f"{len(rows)} gaps in time, about {missing} samples missing of {n + missing}; the longest, "
        f"{longest * step:.4g} s after t = {t:.4g} s, is {longest:.3g} times the median step of "
        f"{step:.4g} s",
        {"gaps": len(rows), "missing": missing, "rows": rows, "longest": longest},
    )


def _not_finite(log: Log) -> Fault | None:
    return untimed_fault(log.joints, len(log), np.flatnonzero(~np.isfinite(log.t)))


def untimed_fault(joints: tuple[str, ...], n: int, rows: Rows) -> Fault | None:
    """The fault of rows, of n, without a time; None where there are none."""
    if not len(rows):
        return None
    return Fault(
        "corrupt_rows",
        joints,
        f"{len(rows)} of {n} time stamps are no numbers, first in row {rows[0]}",
        {"rows": rows, "count": len(rows), "channel": "t"},
        f"leaves these {len(rows)} rows out",
        (Remedy("drop", rows=rows),),
    )


def _repeated(log: Log, order: Order) -> Fault | None:
    """Rows with the stamp of an earlier row: the one before, or any that has all its values."""
    timed = np.flatnonzero(np.isfinite(log.t))
    still = np.flatnonzero(np.diff(log.t[timed]) == 0)
    before, beside = timed[still], timed[still + 1]
    rows = np.union1d(beside, order.again)
    if not len(rows):
        return None
    same = np.all([(x[beside] == x[before]).all(axis=1) for _, x in log.channels()], axis=0)
    return repeated_fault(log.joints, len(log), rows, int(same.sum()), order.again, log.t[rows[0]])


def repeated_fault(
    joints: tuple[str, ...], n: int, rows: Rows, same: int, again: Rows, first: float
) -> Fault:
    """The fault of rows that repeat a stamp.

    Args:
        joints: All joints.
        n: Rows of the log.
        rows: Rows that repeat the stamp of an earlier one.
        same: How many of them repeat all values of the row before.
        again: Those that repeat stamp and values of an earlier row that is not the one before.
        first: Time of the first of them [s].
    """
    beside = len(rows) - len(again)
    parts = [f"{beside} of {n} rows ({beside / n:.2%}) repeat the time of the row before, {same} "
             "of them all its values too"] if beside else []  # fmt: skip
    if len(again):
        parts.append(f"{len(again)} of {n} rows repeat time and values of earlier ones")
    return Fault(
        "duplicate_samples",
        joints,
        f"{'; '.join(parts)}; first row {rows[0]} at t = {first:.4g} s",
        {"rows": rows, "count": len(rows), "identical": same + len(again)},
        f"keeps the first of each and leaves {len(rows)} rows out",
        (Remedy("drop", rows=rows),),
    )


def backward_faults(joints: tuple[str, ...], t: Array, order: Order) -> list[Fault]:
    """Faults of rows that are earlier than one before them, from how they come into order.

    Args:
        joints: All joints.
        t: Stamps as logged, shape (n,) [s].
        order: What can be done.
    """
    rows = np.flatnonzero(np.isfinite(t))
    back = rows[np.flatnonzero(np.diff(t[rows]) < 0) + 1]
    if not len(back):
        return []
    k = int(back[0])
    where = f"from {t[rows[rows < k][-1]]:.6g} to {t[k]:.6g} s in row {k}"
    if order.doubt:
        return [_unordered(joints, len(t), back, where, order.doubt)]
    found = []
    if len(order.starts):
        found.append(_anew(joints, t, order))
    misplaced = np.union1d(order.late, order.lost)
    if len(misplaced):
        found.append(_misplaced(joints, len(t), misplaced, where, order))
    return found


def _unordered(joints: tuple[str, ...], n: int, back: Rows, where: str, doubt: str) -> Fault:
    return Fault(
        "corrupt_rows",
        joints,
        f"time goes back in {len(back)} of {n} rows, first {where}; {doubt}, so that sorting or "
        f"cutting would be a guess: cut the file by hand in row {back[0]}, or mend its time",
        {"rows": back, "count": len(back), "channel": "t", "doubt": doubt},
    )


def _anew(joints: tuple[str, ...], t: Array, order: Order) -> Fault:
    starts = order.starts
    return Fault(
        "corrupt_rows",
        joints,
        f"the clock starts anew in {_listed(starts)}, first from {_before(t, int(starts[0])):.6g} "
        f"to {t[starts[0]]:.6g} s, and runs on at the same rate, as in recordings written one "
        "after the other",
        {"rows": starts, "count": len(starts), "channel": "t", "shifts": order.shifts},
        f"cuts the recording into {len(starts) + 1} parts at {_listed(starts)}",
        tuple(
            Remedy("shift", "t", rows=starts[k : k + 1], factor=shift)
            for k, shift in enumerate(order.shifts)
        ),
    )


def _misplaced(joints: tuple[str, ...], n: int, rows: Rows, where: str, order: Order) -> Fault:
    did, remedies = [], []
    if len(order.late):
        did.append(f"sorts {_listed(order.late)} by time, where they fit")
        remedies.append(Remedy("sort", "t", rows=order.late))
    if len(order.lost):
        did.append(f"leaves {_listed(order.lost)} out")
        remedies.append(Remedy("drop", rows=order.lost))
    return Fault(
        "corrupt_rows",
        joints,
        f"time goes back: {len(rows)} of {n} rows are out of order, first {where}",
        {"rows": rows, "count": len(rows), "channel": "t", "late": len(order.late)},
        " and ".join(did),
        tuple(remedies),
    )


def _before(t: Array, row: int) -> float:
    finite = t[:row][np.isfinite(t[:row])]
    return float(finite[-1])


def _listed(rows: Rows) -> str:
    """Rows in words; of many the first ones."""
    runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    shown = [str(r[0]) if len(r) == 1 else f"{r[0]} to {r[-1]}" for r in runs[:_LISTED]]
    more = f" and {len(rows) - sum(map(len, runs[:_LISTED]))} more" if len(runs) > _LISTED else ""
    return f"row{'s' if len(rows) > 1 else ''} {', '.join(shown)}{more}"


def counted(log: Log) -> bool:
    """Whether the time is the number of the sample: every step exactly one."""
    return bool(len(log) > 3 and (np.diff(log.t) == 1.0).all())
