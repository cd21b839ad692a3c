"""Time: stamps that repeat, go back or start anew, and samples that are missing or there twice.

A row is *late* where its stamp puts it between two others that are as far apart as if it were
missing there, and where no position then jumps: sorting restores the log. A short run of stamps
that fit nowhere is left out. A clock *starts anew* where time goes back and runs on at the same
rate for long enough: the log is cut there. Anything else has several meanings; nothing is done.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import scipy

from excitant.identify.faults.fault import (
    Fault,
    Log,
    Mask,
    Remedy,
    Rows,
    dropped,
    run_lengths,
    tail_bound,
)
from excitant.identify.preprocessing import longest_step
from excitant.identify.recording import MINIMUM_DURATION
from excitant.robots.motion import Array

_SHORT = 5  # rows of a run of stamps that may be wrong
_STRAY = 8.0  # steps from the running median of twice that many stamps and one
_ROOM = 0.75  # of a step per row: what a late row finds where it belongs
_JUMP = 3.0  # of the 99 % quantile of steps of a position
_ROUGH = 1.5  # times farther after one row than after two: two motions take turns
_WRONG = 0.01  # of the rows may be left out
_RATE = 0.05  # by which the rate of a clock that started anew may differ
_BRIEF = 0.1  # of the rows may be in parts too short to be of use
_OFTEN = 50  # rows: a clock that starts anew more often than that does something else
_PAUSE = 10.0  # of the longest step that is no gap: what is put between parts
_BACK = 1.5  # of a step: nearer to two steps than to one
_WHOLE = 0.25  # how near to a whole number of samples a jump must be
_NONE: Rows = np.zeros(0, np.intp)
_LISTED = 5  # runs of rows that are spelt out


def stamp_faults(log: Log) -> tuple[list[Fault], Rows | None]:
    """Stamps that are no numbers, repeat or go back, and rows where the clock starts anew.

    None for those where no repair brings the rows into the order of time.
    """
    order = _order_of(log)
    found = []
    timed = np.flatnonzero(np.isfinite(log.t))
    if len(rows := np.flatnonzero(~np.isfinite(log.t))):
        detail = f"{len(rows)} of {len(log)} time stamps are no numbers, first in row {rows[0]}"
        found.append(dropped(log.joints, rows, detail, channel="t"))
    found += [*_repeated(log, timed, order.again), *_backward(log, timed, order)]
    return found, None if order.unclear else order.starts


def gap_faults(log: Log, starts: Array) -> Iterator[Fault]:
    """Samples that are missing between stamps; none before ``starts`` of other parts [s].

    A stamp that came late is made up for by the next, a sample that is missing is not.
    """
    steps = np.diff(log.t) / log.step
    if len(steps) < 3:
        return
    steps[np.searchsorted(log.t, starts) - 1] = 1.0
    padded = np.pad(steps, 1, constant_values=1.0)
    pairs = np.minimum(padded[:-2], padded[2:]) + steps
    at = np.flatnonzero((steps > _BACK) & (pairs > _BACK + 1))
    if not len(at):
        return
    missing = int(np.round(steps[at] - 1).sum())
    k = int(at[np.argmax(steps[at])])
    detail = (
        f"{len(at)} gaps in time, about {missing} samples missing of {len(log) + missing}; the "
        f"longest, {steps[k] * log.step:.4g} s after t = {log.t[k]:.4g} s, is {steps[k]:.3g} times "
        f"the median step of {log.step:.4g} s"
    )
    evidence = {
        "gaps": len(at),
        "missing": missing,
        "rows": at,
        "longest": float(steps[k]),
    }
    yield Fault("dropped_samples", log.joints, detail, evidence)


def repeated_rows(log: Log) -> Iterator[Fault]:
    """Rows that repeat all values of the row before, with a stamp of their own, in motion."""
    same = np.all(
        [(np.diff(x, axis=0) == 0).all(axis=1) for _, x in log.channels()], axis=0
    )
    moved = np.asarray(log.moving.any(axis=1), bool)
    rows = np.flatnonzero(same & (moved[1:] | moved[:-1])) + 1
    if len(rows) < 3:
        return
    starts, lengths = run_lengths(same)
    detail = (
        f"{len(rows)} of {len(log)} rows ({100 * len(rows) / len(log):.2f} %) repeat every value "
        f"of the row before while joints move, in {np.isin(starts + 1, rows).sum()} places; "
        f"{log.first(rows)}"
    )
    longest = int(lengths.max()) + 1
    yield dropped(log.joints, rows, detail, "duplicate_samples", longest=longest)


def hidden_gaps(log: Log) -> Iterator[Fault]:
    """Rows that are missing though the stamps run on: all joints jump by m whole samples."""
    rate = np.diff(log.q, axis=0) / np.diff(log.t)[:, None]
    n = len(rate)
    if n < 30:
        return
    speed = np.empty_like(rate)  # median of the four samples on either side
    for j, padded in enumerate(np.pad(rate, ((4, 4), (0, 0)), "edge").T):
        around = np.delete(
            np.lib.stride_tricks.sliding_window_view(padded, 9), 4, axis=1
        )
        speed[:, j] = np.sort(around, axis=1)[:, 3:5].mean(axis=1)
    scale = np.median(np.abs(rate - speed), axis=0) / 0.6745 + 1e-12 * np.abs(rate).max(
        axis=0
    )
    scale = np.maximum(scale, 2 * log.quanta["q"] / log.step / np.sqrt(12))
    used = scale > 0
    s = speed[:, used] / scale[used]
    e = (rate - speed)[:, used] / scale[used]
    power = (s**2).sum(axis=1)
    m = (s * e).sum(axis=1) / np.maximum(power, 1e-300)
    z = np.abs(m) * np.sqrt(power)
    shared = 1 - ((e - m[:, None] * s) ** 2).sum(axis=1) / np.maximum(
        (e**2).sum(axis=1), 1e-300
    )
    whole = (np.round(m) >= 1) & (np.abs(m - np.round(m)) < _WHOLE)
    alone = np.abs(m) > 2 * np.maximum(np.abs(np.roll(m, 1)), np.abs(np.roll(m, -1)))
    several = ((np.abs(s) > 3).sum(axis=1) >= 2) if log.nv > 1 else np.zeros(n, bool)
    rows = np.flatnonzero(
        (z > tail_bound(z)) & whole & alone & several & (shared > 0.95)
    )
    rows = rows[(rows > 5) & (rows < n - 6)]
    if not len(rows):
        return
    missing = int(np.round(m[rows]).sum())
    k = rows[0]
    detail = (
        f"all joints jump together in {len(rows)} places by whole numbers of samples, about "
        f"{missing} rows are missing though the stamps run on; first after t = {log.t[k]:.4g} s, "
        f"where q moves {1 + m[k]:.2f} times as far as its speed allows"
    )
    evidence = {"rows": rows, "missing": missing, "ratio": 1 + m[rows]}
    yield Fault("dropped_samples", log.joints, detail, evidence)


class _Order(NamedTuple):
    # repeat an earlier one, not the row before, with its stamp and values
    again: Rows = _NONE
    late: Rows = _NONE  # belong between earlier ones, where sorting puts them
    lost: Rows = _NONE  # their stamps fit nowhere
    starts: Rows = _NONE  # the clock starts anew
    shifts: tuple[float, ...] = ()  # added to time from each of these on [s]
    unclear: str = ""  # why nothing can be done; empty where the above makes time rise


def _order_of(log: Log) -> _Order:
    t = log.t
    rows = np.flatnonzero(np.isfinite(t))
    rows = rows[np.diff(t[rows], prepend=-np.inf) != 0]
    if (np.diff(t[rows]) > 0).all():
        return _Order()
    import pandas as pd

    values = pd.DataFrame(np.column_stack([t, *(x for _, x in log.channels())])[rows])
    again = rows[values.duplicated()]
    rows = np.setdiff1d(rows, again)
    if len(rows) < 2:
        return _Order(again)
    step = float(np.median(np.abs(np.diff(t[rows]))))
    settled = _settled(log, rows, step)
    return _cut(log, rows, again, step) if settled is None else _Order(again, *settled)


def _settled(log: Log, rows: Rows, step: float) -> tuple[Rows, Rows] | None:
    """Of some rows those that sorting puts right, and few to leave out; None when that fails."""
    t = log.t[rows]
    if (np.diff(t) > 0).all():
        return _NONE, _NONE
    moved = np.abs(t - _smoothed(t)) > _STRAY * step
    near = t[~moved]
    behind = near < np.maximum.accumulate(near)
    ahead = near > np.minimum.accumulate(near[::-1])[::-1]
    moved[~moved] = behind if behind.sum() <= ahead.sum() else ahead
    order = np.argsort(t, kind="stable")
    unfit = np.zeros(len(t), bool)
    unfit[order] = _unfit(t[order], log.q[rows[order]], order, moved[order], step)
    if (
        unfit.sum() > max(_WRONG * len(t), 1)
        or run_lengths(unfit)[1].max(initial=0) > _SHORT
    ):
        return None
    return rows[moved & ~unfit], rows[unfit]


def _smoothed(t: Array) -> Array:
    return np.asarray(scipy.ndimage.median_filter(t, 2 * _SHORT + 1, mode="nearest"))


def _unfit(t: Array, q: Array, order: Rows, moved: Mask, step: float) -> Mask:
    """Of rows sorted by time, the moved ones that do not belong where sorting puts them."""
    one, two = (np.median(np.abs(q[k:] - q[:-k]), axis=0) for k in (1, 2))
    steps = np.diff(t)
    change = np.abs(np.diff(q, axis=0))
    gap = steps > longest_step(step)
    usual = np.quantile(change[~gap] if (~gap).any() else change, 0.99, axis=0)
    smooth = (change <= _JUMP * usual * np.maximum(steps / step, 1.0)[:, None]).all(
        axis=1
    )
    joined = (np.diff(order) == 1) | gap | smooth
    unfit = moved & bool((one > _ROUGH * two).any())
    for a, count in zip(*run_lengths(moved), strict=True):
        b = a + count
        inside = a > 0 and b < len(t)
        room = not inside or t[b] - t[a - 1] >= _ROOM * step * (count + 1)
        near = (
            count > _SHORT
            or (a > 0 and not gap[a - 1])
            or (b < len(t) and not gap[b - 1])
        )
        unfit[a:b] |= not (room and near and joined[max(a - 1, 0) : b].all())
    unfit[1:] |= (steps == 0) & moved[1:]
    unfit[:-1] |= (steps == 0) & ~moved[1:]
    return unfit


def _cut(log: Log, rows: Rows, again: Rows, step: float) -> _Order:
    """The order of a log whose clock starts anew, if that is what it did."""
    t = log.t
    clear = rows[np.abs(t[rows] - _smoothed(t[rows])) <= _STRAY * step]
    falls = np.flatnonzero(np.diff(_smoothed(t[clear])) < 0) + 1
    if not len(falls):
        return _Order(again, unclear="its rows fit nowhere else")
    reach = np.arange(-2 * _SHORT, 2 * _SHORT + 1)
    near = np.clip(falls[:, None] + reach, 1, len(clear) - 1)
    drops = np.diff(t[clear])[near - 1]
    starts = np.unique(clear[near[np.arange(len(falls)), drops.argmin(axis=1)]])
    often = f"it does so {len(starts)} times, mostly within {MINIMUM_DURATION:g} s"
    if len(starts) * _OFTEN >= len(rows):
        return _Order(again, unclear=often)
    late = []
    lost = []
    shifts = [0.0]
    end = -np.inf
    brief = 0
    for own in np.split(rows, np.searchsorted(rows, starts)):
        settled = _settled(log, own, step)
        if settled is None:
            return _Order(
                again, unclear=f"from row {own[0]} on its rows fit nowhere else"
            )
        late.append(settled[0])
        lost.append(settled[1])
        stamps = np.sort(t[np.setdiff1d(own, settled[1])])
        rate = float(np.median(np.diff(stamps))) if len(stamps) > _SHORT else step
        if abs(rate / step - 1) > _RATE:
            return _Order(
                again,
                unclear=f"from row {own[0]} on it takes other steps, {rate:.4g} s",
            )
        brief += len(own) if stamps[-1] - stamps[0] < MINIMUM_DURATION else 0
        shifts.append(
            max(shifts[-1], end + _PAUSE * longest_step(step) - float(stamps[0]))
        )
        end = float(stamps[-1]) + shifts[-1]
    if brief > _BRIEF * len(rows):
        return _Order(again, unclear=often)
    added = tuple(np.diff(shifts)[1:].tolist())
    return _Order(again, np.concatenate(late), np.concatenate(lost), starts, added)


def _repeated(log: Log, timed: Rows, again: Rows) -> Iterator[Fault]:
    """Rows with the stamp of an earlier row: the one before, or any that has all its values."""
    still = np.flatnonzero(np.diff(log.t[timed]) == 0)
    before = timed[still]
    beside = timed[still + 1]
    rows = np.union1d(beside, again)
    if not len(rows):
        return
    same = np.all(
        [(x[beside] == x[before]).all(axis=1) for _, x in log.channels()], axis=0
    ).sum()
    n = len(log)
    found = len(rows) - len(again)
    parts = []
    if found:
        said = f"{found} of {n} rows ({100 * found / n:.2f} %) repeat the time of the row before"
        parts.append(f"{said}, {same} of them all its values too")
    if len(again):
        parts.append(f"{len(again)} of {n} rows repeat time and values of earlier ones")
    detail = f"{'; '.join(parts)}; {log.first(rows)}"
    fault = dropped(
        log.joints, rows, detail, "duplicate_samples", identical=int(same) + len(again)
    )
    yield replace(
        fault, repair=f"keeps the first of each and leaves {len(rows)} rows out"
    )


def _backward(log: Log, timed: Rows, order: _Order) -> Iterator[Fault]:
    """Faults of rows that are earlier than one before them, from how they come into order."""
    rows = timed[1:][np.diff(log.t[timed]) < 0]
    if not len(rows):
        return

    def fault(
        rows: Rows,
        detail: str,
        done: str | None = None,
        *remedies: Remedy,
        **evidence: Any,
    ) -> Fault:
        evidence = {"rows": rows, "count": len(rows), "channel": "t", **evidence}
        return Fault("corrupt_rows", log.joints, detail, evidence, done, remedies)

    def fall(row: int) -> str:
        return f"first from {log.t[timed[timed < row][-1]]:.6g} to {log.t[row]:.6g} s"

    first = int(rows[0])
    n = len(log)
    if order.unclear:
        detail = (
            f"time goes back in {len(rows)} of {n} rows, {fall(first)} in row {first}; "
            f"{order.unclear}, so that sorting or cutting would be a guess: cut the file by hand "
            f"in row {first}, or correct its time"
        )
        yield fault(rows, detail, unclear=order.unclear)
        return
    if len(starts := order.starts):
        detail = (
            f"the clock starts anew in {_listed(starts)}, {fall(int(starts[0]))}, and runs "
            f"on at the same rate, as in recordings written one after the other"
        )
        done = f"cuts the recording into {len(starts) + 1} parts at {_listed(starts)}"
        remedies = [
            Remedy("shift", "t", rows=starts[k : k + 1], factor=shift)
            for k, shift in enumerate(order.shifts)
        ]
        yield fault(starts, detail, done, *remedies, shifts=order.shifts)
    steps = [
        (said.format(_listed(some)), Remedy(action, channel, rows=some))
        for said, action, channel, some in (
            ("sorts {} by time, where they fit", "sort", "t", order.late),
            ("leaves {} out", "drop", "", order.lost),
        )
        if len(some)
    ]
    if steps:
        moved = np.union1d(order.late, order.lost)
        (said, actions) = zip(*steps, strict=True)
        where = f"{fall(first)} in row {first}"
        detail = f"time goes back: {len(moved)} of {n} rows are out of order, {where}"
        yield fault(moved, detail, " and ".join(said), *actions, late=len(order.late))


def _listed(rows: Rows) -> str:
    runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    shown = [str(r[0]) if len(r) == 1 else f"{r[0]} to {r[-1]}" for r in runs[:_LISTED]]
    more = (
        f" and {len(rows) - sum(map(len, runs[:_LISTED]))} more"
        if len(runs) > _LISTED
        else ""
    )
    return f"row{'s' if len(rows) > 1 else ''} {', '.join(shown)}{more}"
