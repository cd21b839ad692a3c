"""Channels that say nothing or something else: dead, held, cut off, wrapped, with outliers."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np
import scipy

from excitant.identify.faults.fault import (
    ALARM,
    Fault,
    Log,
    Mask,
    Remedy,
    Rows,
    dropped,
    run_lengths,
    tail_bound,
    unwrap,
)
from excitant.identify.faults.time import hidden_gaps
from excitant.identify.smoother import noise, quantum
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

_BLOCKS = 100  # of a channel, whose means white noise keeps small
_STRETCH_S = 0.1  # s: shorter repetitions are samples that were held
_TRAVELLED = 20.0  # resolutions that a joint must move during a dead stretch
_SAME = 0.01  # share of pairs that far apart that may be equal by chance
_LEVELS = 4
_SIGMAS = 3.0  # width of the band below the extreme value
_AT_LEAST = 5  # samples at the extreme value
_FRESH = 0.2  # of the typical change: smaller counts as "hardly changed"
_HELD = 25  # samples
_COUNTERS = (2.0**8, 2.0**10, 2.0**12, 2.0**16, 2.0**32)
_PATTERN = np.array([1 / 6, -2 / 3, 1.0, -2 / 3, 1 / 6])  # residual around one outlier
_LIKE = 0.9  # cosine from which on a residual looks like that of one outlier
_AROUND = 101  # samples that say what is usual around one
_WINDOW = 11  # samples of the running median
_JOLT = 5  # samples to either side that a jolt may disturb
_GAP = 1.75  # steps: the interpolation does not reach across
_SINGLE = float(
    np.finfo(np.float32).eps
)  # of a value: rounding of a log in single precision
_MANY = 0.5  # of all channels: the row is at fault, not a channel


def dead_channels(log: Log) -> Iterator[Fault]:
    """Channels that are constant, only noise, or stop for a while, though the joint moves."""
    for (name, x), j in product(log.channels(), range(log.nv)):
        found = (test(log, name, x[:, j], j) for test in (_constant, _white, _stretch))
        for detail, evidence in filter(None, found):
            sentence = f"{name} of {log.joints[j]} {detail}"
            yield Fault(
                "dead_channel", (log.joints[j],), sentence, {"channel": name} | evidence
            )
            break


_Found = tuple[str, dict[str, Any]] | None
"""Detail and evidence."""


def _constant(log: Log, name: str, x: Array, j: int) -> _Found:
    """A channel with one value, of which a position or velocity counts where the other moves."""
    moves = log.moving[:, j].any()
    if np.ptp(x) > 0 or (name == "dq" and not moves):
        return None
    against = (
        f", while q of the joint moves over {np.ptp(log.q[:, j]):.4g}" if moves else ""
    )
    if name == "q":
        speed = np.zeros(1) if log.dq is None else log.dq[:, j]
        if np.ptp(speed) == 0 or np.abs(speed).mean() < 5 * noise(speed):
            return None
        against = f", while dq of the joint varies over {np.ptp(speed):.4g}"
    return f"is {x[0]:.6g} in every row{against}", {"value": float(x[0])}


def _white(log: Log, name: str, x: Array, j: int) -> _Found:
    """A channel whose block means scatter no more than those of white noise, as χ² with B − 1."""
    block = len(x) // _BLOCKS
    if name == "q" or block < 5 or log.moving[:, j].mean() < 0.5:
        return None
    means = x[: block * _BLOCKS].reshape(_BLOCKS, block).mean(axis=1)
    ratio = block * means.var(ddof=1) / x.var()
    bound = float(scipy.special.chdtri(_BLOCKS - 1, ALARM / log.nv)) / (_BLOCKS - 1)
    if ratio > bound:
        return None
    detail = (
        f"is only noise of {x.std():.3g} while the joint moves: means of {block} samples vary "
        f"{ratio:.2f} times as much as those of white noise (by chance up to {bound:.2f})"
    )
    return detail, {"ratio": ratio, "bound": bound, "std": x.std()}


def _stretch(log: Log, name: str, x: Array, j: int) -> _Found:
    """The longest run of one value, if the channel never else keeps a value that long."""
    starts, lengths = run_lengths(np.diff(x) == 0)
    length = int(lengths.max(initial=0))
    if length < 10 or length <= tail_bound(lengths, ALARM / log.nv):
        return None
    start = int(starts[np.argmax(lengths)])
    rows = slice(start, start + length + 1)
    seconds = float(np.ptp(log.t[rows]))
    if seconds < _STRETCH_S:
        return None
    way = float(np.ptp(log.q[rows, j]))
    clear = float(_TRAVELLED * log.grain[j])
    if name == "q":
        if log.dq is None:
            return None
        way = abs(float(np.trapezoid(log.dq[rows, j], log.t[rows])))
        clear += 5 * noise(log.dq[:, j]) * np.sqrt(length) * log.step
    apart = x[length:] == x[:-length]
    apart[max(0, start - length) : start + length + 1] = False
    if way < clear or apart.mean() > _SAME or x[start] in (x.max(), x.min()):
        return None
    value = float(x[start])
    t = float(log.t[start])
    detail = (
        f"stays at {value:.6g} for {seconds:.3g} s from t = {t:.4g} s while the "
        f"joint moves; else it keeps no value for that long"
    )
    return detail, {"value": value, "start": t, "seconds": seconds}


def saturation(log: Log, robot: Robot) -> Iterator[Fault]:
    """Torque that stays at its extreme value, or at its limit but for noise, while joints move.

    Of a channel that is not cut off no more samples lie exactly at the extreme value than in a
    narrow band below it, where even a smooth peak spends longer; the excess is a Poisson count.
    """
    moved = np.asarray(log.moving.any(axis=1), bool)
    for j, sign in product(range(log.nv), (1.0, -1.0)):
        x = sign * log.tau[:, j]
        limit = float(robot.limits.torque[j])
        top = float(x.max())
        step = float(log.quanta["tau"][j])
        span = float(np.ptp(x))
        scatter = noise(x)
        band = max(_LEVELS * step, _SIGMAS * scatter, 1e-6 * span)
        at = moved & (x > top - min(step / 2, 1e-9 * span))
        near = int((moved & ~at & (x > top - band)).sum())
        many = int(at.sum()) >= _AT_LEAST
        evidence = {"value": sign * top, "near": near}
        if (
            many
            and band > 0
            and scipy.special.pdtrc(at.sum() - 1, near + 1) <= ALARM / (2 * log.nv)
        ):
            where = f"at its {'largest' if sign > 0 else 'smallest'} value"
            more = f", while joints move; only {near} lie within {band:.3g} of it"
        else:
            at = x > limit - 2 * scatter
            known = log.unit == "N·m" and np.isfinite(limit) and scatter <= 0.05 * limit
            long = run_lengths(at)[1].max(initial=0) >= _AT_LEAST
            if not (known and long and top <= limit + 6 * scatter):
                continue
            where = "within its noise of the limit"
            more = ""
            evidence = {"value": sign * limit}
        joint = log.joints[j]
        count = int(at.sum())
        longest = int(run_lengths(at)[1].max())
        detail = (
            f"tau of {joint} is {where} {evidence['value']:.6g} {log.unit} in {count} of "
            f"{len(log)} rows, up to {longest} in a row{more}"
        )
        evidence |= {"count": count, "longest": longest}
        yield Fault("saturation", (joint,), detail, evidence)


def held_channels(log: Log) -> Iterator[Fault]:
    """Channels refreshed more seldom than logged: no change is more frequent than a small one."""
    for name, x in log.channels():
        columns = zip(x.T, log.moving.T, log.quanta[name], strict=True)
        held = {
            j: share
            for j, each in enumerate(columns)
            if (share := _held_share(*each)) > 0
        }
        if held:
            worst = max(held, key=lambda j: held[j])
            joints = log.names(held)
            detail = (
                f"{name} of {', '.join(joints)} is held: {100 * held[worst]:.1f} % of its samples "
                f"at {log.joints[worst]} repeat the one before exactly while the joint moves, "
                f"though the others change by many steps of its resolution"
            )
            evidence = {"channel": name, "share": list(held.values())}
            yield Fault("duplicate_samples", joints, detail, evidence)


def _held_share(x: Array, moving: Mask, step: float) -> float:
    moved = moving[1:] & moving[:-1]
    for start, length in zip(*run_lengths(np.diff(x) == 0), strict=True):
        if length >= _HELD:  # dead, not held
            moved[start : start + length] = False
    change = np.abs(np.diff(x))[moved]
    fresh = change[change > 0]
    if len(change) < 50 or len(fresh) < 25:
        return 0.0
    small = _FRESH * float(np.median(fresh))
    few = int((fresh <= small).sum())
    if few < 5:
        return 0.0  # coarse steps: no change is as good as a small one
    # a torque that friction rules stays for a while too, between small changes or few large ones
    starts, lengths = run_lengths(change == 0)
    inner = (starts > 0) & (starts + lengths < len(change))
    starts, ends = starts[inner], (starts + lengths)[inner]
    large = max(small, _LEVELS * step)
    held = int(((change[starts - 1] > large) & (change[ends] > large)).sum())
    excess = held - few - 5 * np.sqrt(held + few)
    beyond = excess > 0 and held > 0.02 * len(change)
    return 1 - len(fresh) / len(change) if beyond else 0.0


def wrapped_counters(log: Log) -> Iterator[Fault]:
    """Channels that wrap, or whose negative values were logged as a counter's upper half.

    They jump by its range, leave the middle of it empty, and are smooth without the jumps.
    """
    for (name, values), j in product(log.channels(), range(log.nv)):
        x = values[:, j]
        if (size := _wrap(x, name == "q")) is None:
            continue
        jumps = int((np.abs(np.diff(x)) > size / 2).sum())
        high = int((x > x.min() + size / 2).sum())
        what = "are a turn off" if name == "q" else "are negative ones logged unsigned"
        detail = (
            f"{name} of {log.joints[j]} jumps {jumps} times by {size:.6g}, the range of a counter: "
            f"{high} of {len(log)} values {what}"
        )
        evidence = {"channel": name, "range": size, "jumps": jumps, "count": high}
        done = f"takes {size:.6g} off where the counter wrapped"
        remedy = Remedy("unwrap", name, (j,), factor=size)
        yield Fault("corrupt_rows", log.names([j]), detail, evidence, done, (remedy,))


def _wrap(x: Array, position: bool) -> float | None:
    """Range of the counter that a channel wraps at; None when it does not."""
    change = np.abs(np.diff(x))
    span = float(np.ptp(x))
    jumps = change > 0.5 * span
    if (
        span == 0
        or jumps.sum() < 2
        or jumps.mean() > 0.2
        or (not position and x.min() < 0)
    ):
        return None
    middle = (x - x.min()) / span
    if np.mean((middle > 0.35) & (middle < 0.65)) > 0.01:
        return None
    size = float(np.median(change[jumps]))
    typical = float(np.quantile(change[~jumps], 0.9))
    step = quantum(x)
    known = [2 * np.pi, 360.0]
    if not position:
        known = [65536.0 * 10.0**k for k in range(-6, 1)] + [
            step * c for c in _COUNTERS
        ]
    near = [k for k in known if abs(k - size) <= 3 * typical + 2 * step]
    if not near:
        return None
    best = min(near, key=lambda k: abs(k - size))
    unwrapped = unwrap(x, best, position)
    smooth = np.abs(np.diff(unwrapped)).max() < 0.5 * best
    return best if smooth and (position or np.ptp(unwrapped) < 0.9 * span) else None


def missing_values(log: Log) -> Iterator[Fault]:
    """Rows with values that are no finite numbers."""
    bad = np.any([~np.isfinite(x) for _, x in log.channels()], axis=0)
    if len(rows := np.flatnonzero(bad.any(axis=1))):
        what = f"{len(rows)} of {len(log)} rows hold values that are no finite numbers"
        joints = log.names(np.flatnonzero(bad.any(axis=0)))
        yield dropped(joints, rows, f"{what}, {log.first(rows)}")


def jumps_and_outliers(log: Log) -> Iterator[Fault]:
    """Rows that are missing unseen, single values or short bursts far off, positions that jump."""
    hidden = list(hidden_gaps(log))
    yield from hidden
    far = _outlying(log, hidden[0].evidence["rows"] if hidden else None)
    count = sum(mask.sum(axis=1) for mask in far.values())
    total = log.nv * len(far)
    whole = np.flatnonzero(count > _MANY * total)
    if len(whole):
        what = "are far from their neighbours in most columns, as rows with shifted columns are"
        detail = f"{len(whole)} of {len(log)} rows {what}; {log.first(whole)}"
        yield dropped(log.joints, whole, detail)
    for name, x in log.channels():
        far[name][whole] = False
        median = _running_median(x, _WINDOW)
        for j in np.flatnonzero(far[name].any(axis=0)):
            rows = np.flatnonzero(far[name][:, j])
            joint = log.joints[j]
            k = int(rows[np.argmax(np.abs(x - median)[rows, j])])
            value = float(x[k, j])
            around = float(median[k, j])
            evidence = {"channel": name, "rows": rows, "count": len(rows)}
            detail = (
                f"{name} of {joint} is far from its neighbours in {len(rows)} of {len(log)} rows; "
                f"worst row {k} at t = {log.t[k]:.4g} s: {value:.5g} where those around have "
                f"{around:.5g}"
            )
            evidence |= {"value": value, "around": around}
            done = f"interpolates {name} of {joint} over these {len(rows)} rows"
            remedy = Remedy("interpolate", name, (int(j),), rows)
            yield Fault("corrupt_rows", (joint,), detail, evidence, done, (remedy,))


def _outlying(log: Log, jumps: Rows | None) -> dict[str, Mask]:
    """Values that cannot be, by channel, each (n, nv); none around rows before missing ones.

    r is the distance of a value from the cubic through its four neighbours, over its local scale.
    Beyond chance a value is an outlier only if nothing that happened explains it: a step (it would
    not stand apart from the running median), jitter of the stamp (a position off by less than half
    its way per sample), a velocity that the positions confirm, or a jolt of several joints at once.
    """
    r = {name: _distance(log.t, x) for name, x in log.channels()}
    if jumps is not None:
        around = np.clip(np.asarray(jumps)[:, None] + np.arange(-2, 4), 0, len(log) - 1)
        for values in r.values():
            values[around] = 0.0
    alarm = ALARM / (log.nv * len(r))
    far = {
        name: _far(x, r[name], log.quanta[name], alarm, name != "tau")
        for name, x in log.channels()
    }
    far["q"] &= _impossible(log, r["q"]) & log.moving.any(
        axis=0
    )  # a held joint's grain is none
    for name, x in log.channels()[1:]:
        apart = np.abs(x - _running_median(x, _WINDOW)) > 0.5 * np.abs(r[name])
        reach = _WINDOW // 2
        apart[:reach] = False
        apart[len(x) - reach :] = False  # unknown at the ends
        far[name] &= apart
    if log.dq is not None:
        way = np.zeros_like(log.dq)
        way[1:-1] = (log.q[2:] - log.q[:-2]) / (log.t[2:] - log.t[:-2])[:, None]
        contradicted = (
            np.abs(log.dq - way) > 0.5 * np.abs(r["dq"]) + 3 * log.grain / log.step
        )
        real = far["dq"] & ~contradicted
        shared = (_near(far["dq"]).sum(axis=1) > 1) & ~_near(far["q"]).any(axis=1)
        jolts = _near((real.any(axis=1) | shared)[:, None], _JOLT)
        far["dq"] &= ~jolts
        far["tau"] &= ~jolts
    return far


def _near(mask: Mask, reach: int = 1) -> Mask:
    wide = scipy.ndimage.maximum_filter1d(mask.astype(np.uint8), 2 * reach + 1, axis=0)
    return np.asarray(wide, bool)


def _running_median(x: Array, window: int) -> Array:
    size = min(window, len(x))
    columns = [
        scipy.ndimage.median_filter(column, size, mode="nearest") for column in x.T
    ]
    return np.column_stack(columns)


def _far(x: Array, r: Array, step: Array, alarm: float, alike: bool) -> Mask:
    """Whether values are farther off than by chance, and by more than their resolution.

    Of sensors that are alike, that of a joint at rest, which may show no noise at all, is not taken
    for finer than the finest of the others.
    """
    span = np.ptp(x, axis=0)
    size = np.abs(r)
    usual = np.maximum(
        _running_median(size, _AROUND), 0.2 * np.quantile(size, 0.75, axis=0)
    )
    z = size / np.maximum(usual, 1e-12 * np.where(span > 0, span, 1.0))
    bound = [tail_bound(column[column > 0], alarm) for column in z.T]
    floor = np.maximum(step, _SINGLE * np.abs(x).max(axis=0))
    if alike:
        seen = np.quantile(size, 0.75, axis=0)
        floor = np.maximum(
            floor, seen[seen > 0].min(initial=np.inf) if seen.any() else 0.0
        )
    return np.asarray((z > bound) & (size > 3 * floor), bool)


def _impossible(log: Log, r: Array) -> Mask:
    """Whether a position cannot have been where it was logged."""
    change = np.abs(np.diff(log.q, axis=0, prepend=log.q[:1]))
    jump = change > 3 * np.quantile(change, 0.99, axis=0)
    jump[:-1] |= jump[1:]
    windows = np.lib.stride_tricks.sliding_window_view(
        np.pad(r, ((2, 2), (0, 0))), 5, axis=0
    )
    size = np.linalg.norm(windows, axis=-1) * np.linalg.norm(_PATTERN)
    alike = np.abs(windows @ _PATTERN) / np.maximum(size, 1e-300)
    return np.asarray(
        (np.abs(r) > 0.5 * np.abs(log.travel)) & ((alike > _LIKE) | jump), bool
    )


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
    wide = np.flatnonzero(np.diff(t) > _GAP * np.median(np.diff(t)))
    for shift in range(-2, 2):
        r[np.clip(wide - shift, 0, n - 1)] = 0.0
    return r
