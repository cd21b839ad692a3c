"""Rows that are not in the order of time: late ones, wrong stamps, clocks that start anew.

A row is *late* where its stamp puts it between two others that are as far apart as if it were
missing there, and where no position then jumps: sorting restores the log. A short run of stamps
that fit nowhere is wrong and is left out. A clock *starts anew* where time goes back and runs on
at the same rate for long enough to be a recording of its own: the log is cut there, which changes
no row. Anything else could mean several things, and nothing is done.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import scipy.ndimage

from excitant.identify.faults.fault import Rows
from excitant.identify.faults.statistics import run_lengths
from excitant.identify.preprocessing import longest_step
from excitant.identify.recording import MINIMUM_DURATION
from excitant.robots.motion import Array

Mask = npt.NDArray[np.bool_]
Keys = npt.NDArray[np.uint64]

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
_PRIME = np.uint64(0x9E3779B97F4A7C15)


@dataclass(frozen=True, eq=False)
class Order:
    """How rows come into the order of time. Rows count those of the log.

    Attributes:
        again: Rows that repeat an earlier one, not the row before, with its stamp and values.
        late: Rows that belong between earlier ones, where sorting puts them.
        lost: Rows whose stamps fit nowhere.
        starts: Rows at which the clock starts anew.
        shifts: What is added to time from each of these rows on [s].
        doubt: Why nothing can be done; empty where the above makes time rise.
    """

    again: Rows = field(default_factory=lambda: np.zeros(0, np.intp))
    late: Rows = field(default_factory=lambda: np.zeros(0, np.intp))
    lost: Rows = field(default_factory=lambda: np.zeros(0, np.intp))
    starts: Rows = field(default_factory=lambda: np.zeros(0, np.intp))
    shifts: tuple[float, ...] = ()
    doubt: str = ""


def row_keys(channels: Sequence[Array]) -> Keys:
    """A number per row that rows share whose values are all equal, shape (n,).

    Args:
        channels: Arrays of shape (n, nv).
    """
    found = np.zeros(len(channels[0]), np.uint64)
    for x in channels:
        for column in x.T:
            found = (found ^ np.ascontiguousarray(column, float).view(np.uint64)) * _PRIME
            found ^= found >> np.uint64(29)
    return found


def order_of(t: Array, keys: Keys, q: Array) -> Order:
    """How the rows of a log come into the order of time.

    Args:
        t: Stamps as logged, shape (n,) [s].
        keys: `row_keys` of the other channels, shape (n,).
        q: Positions, or any combinations of them, shape (n, k).
    """
    rows = np.flatnonzero(np.isfinite(t))
    rows = rows[np.diff(t[rows], prepend=-np.inf) != 0]
    if (np.diff(t[rows]) > 0).all():
        return Order()
    again = rows[_again(t[rows], keys[rows])]
    rows = np.setdiff1d(rows, again)
    if len(rows) < 2:
        return Order(again)
    step = float(np.median(np.abs(np.diff(t[rows]))))
    whole = _settled(t[rows], q[rows], step)
    if whole is not None:
        late, lost = whole
        return Order(again, rows[late], rows[lost])
    return _cut(t, q, rows, again, step)


def _again(t: Array, keys: Keys) -> Mask:
    """Rows whose stamp and values are those of an earlier one."""
    order = np.lexsort((keys, t))
    same = (np.diff(t[order]) == 0) & (keys[order][1:] == keys[order][:-1])
    found = np.zeros(len(t), bool)
    found[order[1:][same]] = True
    return found


def _settled(t: Array, q: Array, step: float) -> tuple[Rows, Rows] | None:
    """Rows that sorting puts right, and few rows to leave out; None when that is not all.

    Args:
        t: Finite stamps, shape (n,) [s].
        q: Positions, shape (n, k).
        step: Usual step [s].
    """
    if (np.diff(t) > 0).all():
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    moved = _stray(t, step)
    moved[~moved] = _misplaced(t[~moved])
    order = np.argsort(t, kind="stable")
    unfit = np.zeros(len(t), bool)
    unfit[order] = _unfit(t[order], q[order], order, moved[order], step)
    if unfit.sum() > max(_WRONG * len(t), 1) or run_lengths(unfit)[1].max(initial=0) > _SHORT:
        return None
    return np.flatnonzero(moved & ~unfit), np.flatnonzero(unfit)


def _stray(t: Array, step: float) -> Mask:
    """Short runs of stamps far from those around them."""
    around = scipy.ndimage.median_filter(t, 2 * _SHORT + 1, mode="nearest")
    return np.asarray(np.abs(t - around) > _STRAY * step, bool)


def _misplaced(t: Array) -> Mask:
    """Rows earlier than one before them, or later than one behind them if these are fewer."""
    behind = t < np.maximum.accumulate(t)
    ahead = t > np.minimum.accumulate(t[::-1])[::-1]
    return np.asarray(behind if behind.sum() <= ahead.sum() else ahead, bool)


def _unfit(t: Array, q: Array, order: Rows, moved: Mask, step: float) -> Mask:
    """Of rows sorted by time, the moved ones that do not belong where sorting puts them.

    Args:
        t: Sorted stamps, shape (n,) [s].
        q: Positions in that order, shape (n, k).
        order: Rows of the log in that order, shape (n,).
        moved: Which of them were out of order, shape (n,).
        step: Usual step [s].
    """
    steps, change = np.diff(t), np.abs(np.diff(q, axis=0))
    gap = steps > longest_step(step)
    usual = np.quantile(change[~gap] if (~gap).any() else change, 0.99, axis=0)
    smooth = (change <= _JUMP * usual * np.maximum(steps / step, 1.0)[:, None]).all(axis=1)
    joined = (np.diff(order) == 1) | gap | smooth
    unfit = np.full(len(t), _rough(q)) & moved
    for a, count in zip(*run_lengths(moved), strict=True):
        b = a + count
        inside = a > 0 and b < len(t)
        room = not inside or t[b] - t[a - 1] >= _ROOM * step * (count + 1)
        near = count > _SHORT or (a > 0 and not gap[a - 1]) or (b < len(t) and not gap[b - 1])
        unfit[a:b] |= not (room and near and joined[max(a - 1, 0) : b].all())
    unfit[1:] |= (steps == 0) & moved[1:]
    unfit[:-1] |= (steps == 0) & ~moved[1:]
    return unfit


def _rough(q: Array) -> bool:
    """Whether some joint is farther from its place one row ago than from that two rows ago."""
    one, two = (np.median(np.abs(q[k:] - q[:-k]), axis=0) for k in (1, 2))
    return bool((one > _ROUGH * two).any())


def _cut(t: Array, q: Array, rows: Rows, again: Rows, step: float) -> Order:
    """The order of a log whose clock starts anew, if that is what it did."""
    clear = rows[~_stray(t[rows], step)]
    middle = scipy.ndimage.median_filter(t[clear], 2 * _SHORT + 1, mode="nearest")
    falls = np.flatnonzero(np.diff(middle) < 0) + 1
    if not len(falls):
        return Order(again, doubt="its rows fit nowhere else")
    reach = np.arange(-2 * _SHORT, 2 * _SHORT + 1)
    near = np.clip(falls[:, None] + reach, 1, len(clear) - 1)
    drops = np.diff(t[clear])[near - 1]
    starts = np.unique(clear[near[np.arange(len(falls)), drops.argmin(axis=1)]])
    parts = [rows[(rows >= a) & (rows < b)] for a, b in pairwise([0, *starts.tolist(), len(t)])]
    late, lost, shifts, end, brief = [], [], [0.0], -np.inf, 0
    for own in parts if len(starts) * _OFTEN < len(rows) else []:
        settled = _settled(t[own], q[own], step)
        if settled is None:
            return Order(again, doubt=f"from row {own[0]} on its rows fit nowhere else")
        late.append(own[settled[0]])
        lost.append(own[settled[1]])
        stamps = np.sort(t[np.delete(own, settled[1])])
        rate = float(np.median(np.diff(stamps))) if len(stamps) > _SHORT else step
        if abs(rate / step - 1) > _RATE:
            return Order(again, doubt=f"from row {own[0]} on it takes other steps, {rate:.4g} s")
        brief += len(own) if stamps[-1] - stamps[0] < MINIMUM_DURATION else 0
        shifts.append(max(shifts[-1], end + _PAUSE * longest_step(step) - float(stamps[0])))
        end = float(stamps[-1]) + shifts[-1]
    if not late or brief > _BRIEF * len(rows):
        return Order(again, doubt=f"it does so {len(starts)} times, mostly within "
                     f"{MINIMUM_DURATION:g} s")  # fmt: skip
    return Order(
        again,
        np.concatenate(late),
        np.concatenate(lost),
        starts,
        tuple(np.diff(shifts)[1:].tolist()),
    )
