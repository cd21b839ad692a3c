"""Time: stamps that repeat or go back, samples missing or there twice, clocks.

A row is *late* where its stamp puts it between two others that are as far apart as if it were
missing there, and where no position then jumps: sorting restores the log. A short run of stamps
that fit nowhere is left out. Anything else has several meanings; nothing is done.

Over windows, ∫ q̇ dt must be Δq. The slope b of one against the other is 1; it is −1 where a sign is
flipped, 180/π or 30/π where the velocity is in degrees or revolutions per minute, and c for all
joints at once where the time runs c times too fast. No model is needed to see that.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy

from excitant.identify.faults.fault import (
    NO_ROWS,
    Fault,
    Log,
    Mask,
    Remedy,
    Rows,
    dropped,
    normal_bound,
    run_lengths,
    tail_bound,
)
from excitant.identify.preprocessing import longest_step
from excitant.identify.recording import FASTEST
from excitant.robots.motion import Array

FROZEN_ROWS = 20
"""Rows alike, from which on a log is taken to have stopped, not to repeat."""
_WINDOW_S = 0.2  # of a window, at least `_WINDOW_ROWS` rows
_WINDOW_ROWS = 8
_MOVING_WINDOWS = 8  # in which a joint must move before its slope counts
_MARGIN = 0.05  # of a slope: less changes inertial torque by less than a tenth
_UNIT_MARGIN = 0.03  # of a slope that a unit explains
_UNITS = {
    180 / np.pi: ("dq", ": dq is in degrees per second"),
    30 / np.pi: ("dq", ": dq is in revolutions per minute"),
    1 / (2 * np.pi): ("dq", ": dq is in revolutions per second"),
    np.pi / 180: ("q", ", as with q in degrees and dq in rad/s"),
    2 * np.pi: ("q", ", as with q in turns and dq in rad/s"),
}
"""Slopes of ∫q̇ dt against Δq that a unit explains, the channel in that unit, and words."""
RATES = (0.5, 2.0, 0.25, 4.0, 1e-3, 1e3, 1e-6, 1e6, 1e-9, 1e9)
"""Factors by which a clock may be off for a reason."""


@dataclass(frozen=True)
class Repairable:
    """What a log that is out of order may show so that its repair is no guess."""

    run: int = 5
    "Rows of a run of stamps that may be wrong."
    stray: float = 8.0
    "Steps from the running median of 2 run + 1 stamps from which on a stamp is out of order."
    room: float = 0.75
    "Steps per row that a late row finds between the rows where it belongs."
    jump: float = 3.0
    "Change of a position, in its usual (99 %) change per step, up to which rows are neighbours."
    rough: float = 1.5
    "Ratio of changes over one row to those over two, beyond which two motions take turns."
    lost: float = 0.01
    "Share of the rows that may be left out."


REPAIRABLE = Repairable()


def stamp_faults(log: Log) -> tuple[list[Fault], bool]:
    """Stamps that are no numbers, repeat or go back; and whether a repair makes time rise."""
    faults = []
    timed = np.flatnonzero(np.isfinite(log.t))
    if len(rows := np.flatnonzero(~np.isfinite(log.t))):
        detail = f"{len(rows)} of {len(log)} time stamps are no numbers, first in row {rows[0]}"
        faults.append(dropped(log.joints, rows, detail, channel="t"))
    again = _logged_again(log, timed)
    settled = _settled(log, np.setdiff1d(timed, again))
    faults += _repeated(log, timed, again)
    faults += _backward(log, timed, settled)
    return faults, settled is not None


def gap_faults(log: Log, starts: Array) -> Iterator[Fault]:
    """Samples that are missing between stamps; none before ``starts`` of other parts [s].

    A stamp that came late is made up for by the next, a sample that is missing is not. Where steps
    differ by habit, a gap is longer than they are by chance.
    """
    steps = np.diff(log.t) / log.step
    steps[np.searchsorted(log.t, starts) - 1] = 1.0
    padded = np.pad(steps, 1, constant_values=1.0)
    pairs = np.minimum(padded[:-2], padded[2:]) + steps
    habit = np.median(np.abs(steps - 1)) / 0.6745
    longest = max(1.5, 1 + normal_bound(len(steps)) * habit)  # nearer to two
    at = np.flatnonzero((steps > longest) & (pairs > longest + 1))
    if not len(at):
        return
    missing = int(np.round(steps[at] - 1).sum())
    k = at[np.argmax(steps[at])]
    detail = (
        f"{len(at)} gap{'s' * (len(at) > 1)} in time, about {missing} sample{'s' * (missing > 1)} "
        f"missing of {len(log) + missing}; the "
        f"longest, {steps[k] * log.step:.4g} s after t = {log.t[k]:.4g} s, is {steps[k]:.3g} times "
        f"the median step of {log.step:.4g} s"
    )
    evidence = {"gaps": len(at), "rows": at}
    yield Fault("dropped_samples", log.joints, detail, evidence)


def repeated_rows(log: Log) -> Iterator[Fault]:
    """Rows that repeat all values of the row before, with a stamp of their own, in motion.

    A long run of them that begins in motion is a logger that stopped: no arm stops at once. So is
    one of the torques of several joints alone, while a joint moves.
    """
    repeats = {
        name: np.all(np.diff(x, axis=0) == 0, axis=1) for name, x in log.channels()
    }
    same = np.all([*repeats.values()], axis=0)
    moved = np.asarray(log.moving.any(axis=1), bool)
    rows = np.flatnonzero(same & (moved[1:] | moved[:-1])) + 1
    starts, lengths = run_lengths(same)
    ends = starts + lengths
    stopped = (lengths >= FROZEN_ROWS) & moved[starts]
    frozen = [*zip(starts[stopped], ends[stopped], strict=True)]
    frozen += [
        span
        for span in _held_torque(log, repeats["tau"])
        if span[0] not in starts[stopped]
    ]
    for start, end in frozen:
        rows = np.union1d(rows, np.arange(start, end) + 1)
    if len(rows) < 3:
        return
    detail = (
        f"{len(rows)} of {len(log)} rows ({100 * len(rows) / len(log):.2f} %) repeat every "
        f"{'value' if same.any() else 'torque'} of the row before while joints move, in "
        f"{(np.diff(rows) > 1).sum() + 1} places; "
        f"{log.first(rows)}"
    )
    if frozen:
        spans = (f"{log.t[i]:.4g} to {log.t[k]:.4g} s" for i, k in frozen)
        detail += f"; frozen from t = {', '.join(spans)}"
    yield dropped(log.joints, rows, detail, "duplicate_samples")


def _held_torque(log: Log, repeats: Mask) -> Iterator[tuple[int, int]]:
    """First and last rows over which all of several joints keep their torque while one moves.

    It is not that of drives at their limits, which stay there too.
    """
    starts, lengths = run_lengths(repeats)
    longer = lengths >= max(10, 0.1 / log.step)
    by_chance = lengths[~longer].sum() > 0.01 * len(log)
    if log.nv == 1 or by_chance:
        return
    for start, end in zip(starts[longer], (starts + lengths)[longer], strict=True):
        held = log.tau[start]
        limited = (held == log.tau.min(axis=0)) | (held == log.tau.max(axis=0))
        moved = np.ptp(log.q[start:end], axis=0) > 20 * log.grain
        if moved.any() and not limited.all():
            yield start, end


def hidden_gaps(log: Log) -> Iterator[Fault]:
    """Rows that are missing though the stamps run on: all joints jump by m whole samples."""
    rate = np.diff(log.q, axis=0) / np.diff(log.t)[:, None]
    speed = _median_around(rate)
    rounding = 1e-12 * np.abs(rate).max(axis=0)
    scatter = np.median(np.abs(rate - speed), axis=0) / 0.6745 + rounding
    scale = np.maximum(scatter, 2 * log.quanta["q"] / log.step / np.sqrt(12))
    used = scale > 0
    s = speed[:, used] / scale[used]
    e = (rate - speed)[:, used] / scale[used]
    # e = m s by least squares over the joints
    power = (s**2).sum(axis=1)
    m = (s * e).sum(axis=1) / np.maximum(power, 1e-300)
    z = np.abs(m) * np.sqrt(power)
    left = ((e - m[:, None] * s) ** 2).sum(axis=1)
    shared = 1 - left / np.maximum((e**2).sum(axis=1), 1e-300)
    samples = np.round(m)
    whole = (samples >= 1) & (np.abs(m - samples) < 0.25)
    beside = np.maximum(np.abs(np.roll(m, 1)), np.abs(np.roll(m, -1)))
    alone = np.abs(m) > 2 * beside
    several = (np.abs(s) > 3).sum(axis=1) >= 2
    clear = (z > tail_bound(z)) & (shared > 0.95)
    rows = np.flatnonzero(clear & whole & alone & several)
    rows = rows[(rows > 5) & (rows < len(rate) - 6)]
    if not len(rows):
        return
    missing = int(samples[rows].sum())
    k = rows[0]
    detail = (
        f"all joints jump together in {len(rows)} places by whole numbers of samples, about "
        f"{missing} rows are missing though the stamps run on; first after t = {log.t[k]:.4g} s, "
        f"where q moves {1 + m[k]:.2f} times as far as its speed allows"
    )
    yield Fault("dropped_samples", log.joints, detail, {"rows": rows})


def _median_around(x: Array) -> Array:
    """Median of the four values on either side of each one, by column."""
    medians = np.empty_like(x)
    for j, padded in enumerate(np.pad(x, ((4, 4), (0, 0)), "edge").T):
        windows = np.lib.stride_tricks.sliding_window_view(padded, 9)
        around = np.sort(np.delete(windows, 4, axis=1), axis=1)
        medians[:, j] = around[:, 3:5].mean(axis=1)
    return medians


def _logged_again(log: Log, timed: Rows) -> Rows:
    """Rows that repeat an earlier one, not the row before, with its stamp and values."""
    rows = timed[np.diff(log.t[timed], prepend=-np.inf) != 0]
    if (np.diff(log.t[rows]) > 0).all():
        return NO_ROWS
    import pandas as pd

    channels = [x for _, x in log.channels()]
    values = pd.DataFrame(np.column_stack([log.t, *channels])[rows])
    return rows[values.duplicated()]


def _settled(log: Log, rows: Rows) -> tuple[Rows, Rows] | None:
    """Of some rows those that sorting puts right, and few to leave out; None when that fails."""
    rows = rows[np.diff(log.t[rows], prepend=-np.inf) != 0]
    t = log.t[rows]
    if (np.diff(t) > 0).all():
        return NO_ROWS, NO_ROWS
    step = np.median(np.abs(np.diff(t)))
    moved = np.abs(t - _smoothed(t)) > REPAIRABLE.stray * step
    near = t[~moved]
    behind = near < np.maximum.accumulate(near)
    ahead = near > np.minimum.accumulate(near[::-1])[::-1]
    moved[~moved] = behind if behind.sum() <= ahead.sum() else ahead
    order = np.argsort(t, kind="stable")
    unfit = np.zeros(len(t), bool)
    unfit[order] = _unfit(t[order], log.q[rows[order]], order, moved[order], step)
    many = unfit.sum() > max(REPAIRABLE.lost * len(t), 1)
    long = run_lengths(unfit)[1].max(initial=0) > REPAIRABLE.run
    return None if many or long else (rows[moved & ~unfit], rows[unfit])


def _smoothed(t: Array) -> Array:
    return scipy.ndimage.median_filter(t, 2 * REPAIRABLE.run + 1, mode="nearest")


def _unfit(t: Array, q: Array, order: Rows, moved: Mask, step: float) -> Mask:
    """Reordered rows whose positions do not fit between their new neighbours."""
    steps = np.diff(t)
    change = np.abs(np.diff(q, axis=0))
    gap = steps > longest_step(step)
    usual = np.quantile(change[~gap] if (~gap).any() else change, 0.99, axis=0)
    allowed = REPAIRABLE.jump * usual * np.maximum(steps / step, 1.0)[:, None]
    smooth = (change <= allowed).all(axis=1)
    joined = (np.diff(order) == 1) | gap | smooth
    over_one = np.median(change, axis=0)
    over_two = np.median(np.abs(q[2:] - q[:-2]), axis=0)
    take_turns = (over_one > REPAIRABLE.rough * over_two).any()
    unfit = moved & take_turns
    for start, count in zip(*run_lengths(moved), strict=True):
        end = start + count
        first = start == 0
        last = end == len(t)
        needed = REPAIRABLE.room * step * (count + 1)
        room = first or last or t[end] - t[start - 1] >= needed
        beside = (not first and not gap[start - 1]) or (
            not last and not gap[end - 1]
        )
        near = count > REPAIRABLE.run or beside
        fits = room and near and joined[max(start - 1, 0) : end].all()
        unfit[start:end] |= not fits
    unfit[1:] |= (steps == 0) & moved[1:]
    unfit[:-1] |= (steps == 0) & ~moved[1:]
    return unfit


def _repeated(log: Log, timed: Rows, again: Rows) -> Iterator[Fault]:
    """Rows with the stamp of an earlier row: the one before, or any that has all its values."""
    still = np.flatnonzero(np.diff(log.t[timed]) == 0)
    before = timed[still]
    beside = timed[still + 1]
    rows = np.union1d(beside, again)
    if not len(rows):
        return
    equal = [(x[beside] == x[before]).all(axis=1) for _, x in log.channels()]
    identical = np.all(equal, axis=0).sum() + len(again)
    share = f"{100 * len(rows) / len(log):.2f} %"
    detail = (
        f"{len(rows)} of {len(log)} rows ({share}) repeat the time of an earlier one, {identical} "
        f"of them all its values too; {log.first(rows)}"
    )
    fault = dropped(log.joints, rows, detail, "duplicate_samples")
    done = f"keeps the first of each and leaves {len(rows)} rows out"
    yield replace(fault, repair=done)


def _backward(
    log: Log, timed: Rows, settled: tuple[Rows, Rows] | None
) -> Iterator[Fault]:
    """Rows that are earlier than one before them, sorted or left out as `_settled`."""
    rows = timed[1:][np.diff(log.t[timed]) < 0]
    if not len(rows):
        return
    first = rows[0]
    before = log.t[timed[timed < first][-1]]
    where = f"first from {before:.6g} to {log.t[first]:.6g} s in row {first}"
    if settled is None:
        detail = (
            f"time goes back in {len(rows)} of {len(log)} rows, {where}, and no order fits all "
            f"rows: cut the file by hand in row {first}, or correct its time"
        )
        evidence = {"rows": rows, "channel": "t", "unclear": True}
        yield Fault("corrupt_rows", log.joints, detail, evidence)
        return
    late, lost = settled
    moved = np.union1d(late, lost)
    if not len(moved):
        return
    words = []
    remedies = []
    if len(late):
        words.append(f"sorts {_listed(late)} by time, where they fit")
        remedies.append(Remedy("sort", "t", rows=late))
    if len(lost):
        words.append(f"leaves {_listed(lost)} out")
        remedies.append(Remedy("drop", rows=lost))
    detail = (
        f"time goes back: {len(moved)} of {len(log)} rows are out of order, {where}"
    )
    evidence = {"rows": moved, "channel": "t"}
    done = " and ".join(words)
    yield Fault("corrupt_rows", log.joints, detail, evidence, done, tuple(remedies))


def _listed(rows: Rows) -> str:
    """The first five runs of rows in words."""
    runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    first = runs[:5]
    words = [str(r[0]) if len(r) == 1 else f"{r[0]} to {r[-1]}" for r in first]
    more = len(rows) - sum(map(len, first))
    rest = f" and {more} more" if more else ""
    return f"row{'s' if len(rows) > 1 else ''} {', '.join(words)}{rest}"


def velocity_faults(log: Log, limits: Array) -> list[Fault]:
    """Faults that show in the velocity against the position; no clock makes dq exceed its limits.

    These, (nv,), are those of speed.
    """
    b, error, follows = _slopes(log)
    tolerance = np.maximum(_MARGIN, normal_bound(log.nv) * error)
    wrong = [j for j in follows if abs(b[j] - 1) > tolerance[j]]
    peaks = np.zeros(log.nv) if log.dq is None else np.abs(log.dq).max(axis=0)
    possible = np.median(peaks / limits) < FASTEST
    shared = _shared_slope(b[follows]) if wrong == follows and possible else None
    if len(log) > 3 and (np.diff(log.t) == 1.0).all():
        first, last = log.t[[0, -1]]
        detail = f"every time step is exactly 1, so t counts samples ({first:g} to {last:g})"
        if shared is None:
            return [
                Fault("wrong_sample_rate", log.joints, detail, {"counts": True})
            ]
        detail += (
            f"; q and dq agree at a step of {1 / shared:.4g} s ({shared:.4g} Hz)"
        )
        return [slow_clock(log.joints, shared, detail)]
    if wrong and (change := _rate_change(log)) is not None:
        return [change]
    if shared is None or _unit_slope(shared):
        return [_joint_fault(log, j, b[j], error[j]) for j in wrong]
    near = [rate for rate in RATES if abs(shared / rate - 1) < _UNIT_MARGIN]
    factor = near[0] if near else shared
    detail = (
        f"the time runs {shared:.4g} times too {'slow' if shared > 1 else 'fast'} for the motion: "
        f"∫dq dt is {shared:.4g} ± {np.nanmedian(error):.2g} times the change of q at all "
        f"{len(follows)} moving joints; the median step is {log.step:.4g} s, "
        f"{log.step / factor:.4g} s would fit"
    )
    return [slow_clock(log.joints, factor, detail)]


def _shared_slope(slopes: Array) -> float | None:
    """The positive slope that all moving joints share, when more than one moves."""
    if len(slopes) < 2 or (shared := float(np.median(slopes))) <= 0:
        return None
    return shared if (np.abs(slopes / shared - 1) < _MARGIN).all() else None


def _windows(log: Log, dq: Array) -> tuple[Rows, Array, Array]:
    """First rows of windows without a gap, Δq and ∫q̇ dt over them, each of shape (windows, nv)."""
    rows = min(max(_WINDOW_ROWS, round(_WINDOW_S / log.step)), len(log) // 20)
    steps = np.diff(log.t)[:, None]
    way = np.cumsum(steps * (dq[1:] + dq[:-1]) / 2, axis=0)
    gaps = np.cumsum(steps > longest_step(log.step), axis=0)
    change = np.diff(log.q[::rows], axis=0)
    ways, broken = (
        np.diff(x[rows - 1 :: rows], axis=0, prepend=0) for x in (way, gaps)
    )
    whole = broken[:, 0] == 0
    return rows * np.flatnonzero(whole), change[whole], ways[whole]


def _slopes(log: Log) -> tuple[Array, Array, list[int]]:
    """Slopes of ∫q̇ dt on Δq (NaN without motion), their standard errors, joints in proportion."""
    b, error = np.full((2, log.nv), np.nan)
    follows: list[int] = []
    if log.dq is None or len(log) < 5 * _WINDOW_ROWS:
        return b, error, follows
    _, changes, ways = _windows(log, log.dq)
    for j, (x, y) in enumerate(zip(changes.T, ways.T, strict=True)):
        clear = np.abs(x) > 20 * log.grain[j]
        if clear.sum() < _MOVING_WINDOWS or np.ptp(y) == 0:
            continue
        b[j] = x @ y / (x @ x)
        error[j] = np.sqrt(((y - b[j] * x) ** 2 * x**2).sum()) / (x @ x)
        correlation = abs(x @ y) / np.sqrt((x @ x) * (y @ y))
        if correlation > 0.9:  # one channel is the other's integral
            follows.append(j)
    return b, error, follows


def clock_confirmed(log: Log) -> bool:
    """Whether measured velocities are the derivatives of positions, so that time is right."""
    slopes, _, follows = _slopes(log)
    return bool(follows) and bool((np.abs(slopes[follows] - 1) < _MARGIN).all())


def _rate_change(log: Log) -> Fault | None:
    """A rate that changes once, all joints alike, while the stamps run on as before."""
    rows, x, y = _windows(log, np.asarray(log.dq))
    unit = np.maximum(np.abs(x).max(axis=0), 1e-12)
    x = x / unit
    y = y / unit
    xx = (x * x).sum(axis=1).cumsum()
    xy = (x * y).sum(axis=1).cumsum()
    yy = (y * y).sum(axis=1).cumsum()
    k = np.arange(_MOVING_WINDOWS, len(x) - _MOVING_WINDOWS)
    if not len(k) or (xx[k] <= 0).any() or (xx[-1] - xx[k] <= 0).any():
        return None
    first = xy[k] / xx[k]
    second = (xy[-1] - xy[k]) / (xx[-1] - xx[k])
    with_two = yy[-1] - first * xy[k] - second * (xy[-1] - xy[k])
    with_one = yy[-1] - xy[-1] ** 2 / xx[-1]
    best = np.argmin(with_two)
    before = float(first[best])
    after = float(second[best])
    clear = with_two[best] <= 0.1 * with_one
    if not clear or not any(abs(after / before / r - 1) < _MARGIN for r in RATES):
        return None
    at = float(log.t[rows[k[best] + 1]])
    detail = (
        f"the sample rate changes near t = {at:.4g} s though the stamps run on: ∫dq dt is "
        f"{before:.4g} times the change of q before and {after:.4g} times after, at all moving "
        f"joints alike; cut the recording there and stretch the time of one part"
    )
    evidence = {"at": at, "before": before, "after": after}
    return Fault("wrong_sample_rate", log.joints, detail, evidence)


def _unit_slope(slope: float) -> float | None:
    """The slope of the unit that explains a slope, whatever its sign."""
    near = (s for s in _UNITS if abs(abs(slope) / s - 1) < _UNIT_MARGIN)
    return next(near, None)


def slow_clock(joints: tuple[str, ...], factor: float, detail: str) -> Fault:
    """The fault of a clock that runs so many times too slow."""
    done = f"divides the time by {factor:.5g}"
    remedy = Remedy("scale", "t", factor=1 / factor)
    return Fault(
        "wrong_sample_rate", joints, detail, {"factor": factor}, done, (remedy,)
    )


def _joint_fault(log: Log, j: int, slope: float, error: float) -> Fault:
    """The wrong unit or sign of one joint's velocity or position."""
    joint = log.joints[j]
    unit = _unit_slope(slope)
    sign = np.sign(slope)
    size = unit or abs(slope)
    channel = "dq"
    if abs(slope + 1) <= _MARGIN:
        fault = "wrong_sign"
        what = ": dq has the opposite sign of q"
        done = f"negates dq of {joint}"
        factor = -1.0
    else:
        fault = "wrong_unit"
        what = ": no unit that is known, a scale is wrong"
        done = f"divides dq of {joint} by {sign * size:.6g}"
        factor = sign / size
        if unit is not None:
            channel, what = _UNITS[unit]
        if channel == "q":
            done = f"multiplies q of {joint} by {size:.6g}"
            factor = sign * size
        what += ", and its sign is flipped" if slope < 0 else ""
    remedy = Remedy("scale", channel, (j,), factor=factor)
    detail = f"∫dq dt of {joint} is {slope:.4g} ± {error:.2g} times the change of its q{what}"
    return Fault(fault, (joint,), detail, {"channel": channel}, done, (remedy,))
