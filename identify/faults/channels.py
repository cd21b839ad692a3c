"""Channels that say nothing or something else: dead, held, cut off, wrapped, with outliers.

A torque computed from planned or smoothed motion has no noise of its own, and rigid bodies with
plain friction explain nearly all of it, which they do for no drive. One computed from measured
motion has the noise of the differentiated positions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np
import scipy

from excitant.exceptions import ExcitantError
from excitant.identify.excitation import ROWS_PER_SECOND, persistency
from excitant.identify.faults.fault import (
    ALARM,
    DECODED,
    NO_ROWS,
    Fault,
    Log,
    Mask,
    Remedy,
    Rows,
    dropped,
    run_lengths,
    tail_bound,
)
from excitant.identify.faults.time import hidden_gaps
from excitant.identify.faults.torque_fit import Smooth, TorqueFit, smooth
from excitant.identify.signals import noise, quantum
from excitant.robots.effects.sensing import LONGEST_DELAY
from excitant.robots.motion import Array, root_mean_square, together
from excitant.robots.robot import Robot

_WORTH = 0.1
"""Of the prior's information: less makes nothing more certain by even 5 %."""
_OUTLIER = np.array([1 / 6, -2 / 3, 1.0, -2 / 3, 1 / 6])
"""Distances from the cubic through the four neighbours, around one outlier."""
_AT_EXTREME = 5
"""Samples at an extreme value, from which on a channel may be cut off."""
_MOST_JOINTS = 0.5  # of the joints: one that bears mainly weight proves nothing
_EXPLAINED = 0.5  # of the variance of a torque's noise: it is that of the motion
_MOST_JUMPS = 0.2  # of the samples, of a channel that wraps
_FEW_STEPS = 128  # of its resolution: a code has more of them
_PASSING = 0.02  # of the range: a change that is as large is no small one
_MEDIAN_ROWS = 11  # of the running median that a value is compared with


def dead_channels(log: Log) -> Iterator[Fault]:
    """Channels that are constant, only noise, or stop for a while, though the joint moves."""
    for (name, x), j in product(log.channels(), range(log.nv)):
        for test in (_constant, _white, _stretch):
            if shown := test(log, name, x[:, j], j):
                detail = f"{name} of {log.joints[j]} {shown}"
                evidence = {"channel": name}
                yield Fault("dead_channel", (log.joints[j],), detail, evidence)
                break


def _constant(log: Log, name: str, x: Array, j: int) -> str | None:
    """A channel with one value, of which a position or velocity counts where the other moves."""
    if np.ptp(x) > 0 or (name != "q" and not log.moving[:, j].any()):
        return None
    if name == "q":
        speed = np.zeros(1) if log.dq is None else log.dq[:, j]
        if np.ptp(speed) == 0 or np.abs(speed).mean() < 5 * noise(speed):
            return None
        against = f", while dq of the joint varies over {np.ptp(speed):.4g}"
    else:
        against = f", while q of the joint moves over {np.ptp(log.q[:, j]):.4g}"
    return f"is {x[0]:.6g} in every row{against}"


def _white(log: Log, name: str, x: Array, j: int) -> str | None:
    """A channel whose block means scatter no more than those of white noise, as χ² with B − 1."""
    blocks = 100
    rows = len(x) // blocks
    if name == "q" or rows < 5 or log.moving[:, j].mean() < 0.5:
        return None
    means = x[: rows * blocks].reshape(blocks, rows).mean(axis=1)
    ratio = rows * means.var(ddof=1) / x.var()
    bound = scipy.special.chdtri(blocks - 1, ALARM / log.nv) / (blocks - 1)
    if ratio > bound:
        return None
    return (
        f"is only noise of {x.std():.3g} while the joint moves: means of {rows} samples vary "
        f"{ratio:.2f} times as much as those of white noise (by chance up to {bound:.2f})"
    )


def _stretch(log: Log, name: str, x: Array, j: int) -> str | None:
    """The longest run of one value, if the channel never else keeps a value that long."""
    starts, lengths = run_lengths(np.diff(x) == 0)
    length = lengths.max(initial=0)
    if length < 10 or length <= tail_bound(lengths, ALARM / log.nv):
        return None
    start = starts[np.argmax(lengths)]
    rows = slice(start, start + length + 1)
    seconds = np.ptp(log.t[rows])
    if seconds < 0.1:
        return None  # so short a repetition is a sample that was held
    way = float(np.ptp(log.q[rows, j]))
    clear = 20 * log.grain[j]
    if name == "q":
        if log.dq is None:
            return None
        way = abs(float(np.trapezoid(log.dq[rows, j], log.t[rows])))
        clear += 5 * noise(log.dq[:, j]) * np.sqrt(length) * log.step
    equal = x[length:] == x[:-length]
    equal[max(0, start - length) : start + length + 1] = False
    by_chance = equal.mean() > 0.01  # pairs that far apart are often equal
    if way <= clear or by_chance or x[start] in (x.max(), x.min()):
        return None
    return (
        f"stays at {x[start]:.6g} for {seconds:.3g} s from t = {log.t[start]:.4g} s while the "
        f"joint moves; else it keeps no value for that long"
    )


def saturation(log: Log, robot: Robot) -> Iterator[Fault]:
    """Torque that stays at its extreme value, or at its limit but for noise, while its joint moves.

    Of a channel that is not cut off no more samples lie exactly at the extreme value than in a
    narrow band below it, where even a smooth peak spends longer; the excess is a Poisson count. One
    of few levels has no narrow band. Limits that some torque exceeds are no drive's.
    """
    scatters = np.array([noise(x) for x in log.tau.T])
    highest = np.abs(log.tau).max(axis=0) - 6 * scatters
    kept = log.unit == "N·m" and (highest <= robot.limits.torque).all()
    for j, sign in product(range(log.nv), (1.0, -1.0)):
        moved = log.moving[:, j]
        x = sign * log.tau[:, j]
        top = x.max()
        step = log.quanta["tau"][j]
        span = np.ptp(x)
        scatter = scatters[j]
        band = max(4 * step, 3 * scatter, 1e-6 * span)  # below the extreme value
        at = moved & (x > top - min(step / 2, 1e-9 * span))
        near = (moved & ~at & (x > top - band)).sum()
        count = at.sum()
        value = sign * top
        many = count >= _AT_EXTREME and 0 < band < span / 2
        chance = scipy.special.pdtrc(count - 1, near + 1) if many else 1.0
        evidence: dict[str, object] = {"channel": "tau"}
        if chance <= ALARM / (2 * log.nv):
            where = f"at its {'largest' if sign > 0 else 'smallest'} value"
            more = f", while it moves; only {near} lie within {band:.3g} of it"
        else:
            limit = float(robot.limits.torque[j])
            at = np.abs(x - limit) < 2 * scatter
            if not (kept and np.isfinite(limit) and scatter <= 0.05 * limit):
                continue
            if run_lengths(at)[1].max(initial=0) < _AT_EXTREME:
                continue
            if _passes(x, at, scatter):
                continue
            where = "within its noise of the limit"
            more = ""
            value = sign * limit
            evidence["limit"] = limit
        joint = log.joints[j]
        longest = run_lengths(at)[1].max()
        detail = (
            f"tau of {joint} is {where} {value:.6g} {log.unit} in {at.sum()} of "
            f"{len(log)} rows, up to {longest} in a row{more}"
        )
        yield Fault("saturation", (joint,), detail, evidence)


def torque_without_sign(log: Log) -> Iterator[Fault]:
    """Torque that is never negative, and at several moving joints yet comes to zero.

    A torque that comes to zero passes through it, but where its sign was lost.
    """
    touching = log.tau.min(axis=0) < 0.01 * log.tau.max(axis=0)
    touching &= log.moving.any(axis=0)
    if (log.tau < 0).any() or touching.sum() < 2:
        return
    names = log.names(np.flatnonzero(touching))
    detail = (
        f"tau of {', '.join(names)} comes to zero and never goes below, as that of no joint does: "
        "its sign was lost; record torque with its sign"
    )
    yield Fault("wrong_sign", names, detail, {"channel": "tau"})


def _passes(x: Array, near: Mask, scatter: float) -> bool:
    """Whether values slope or bend beyond noise over the longest run near a limit."""
    starts, lengths = run_lengths(near)
    longest = np.argmax(lengths)
    rows = slice(starts[longest], starts[longest] + lengths[longest])
    place = np.linspace(-1, 1, lengths[longest])
    shapes = np.polynomial.legendre.legvander(place, 2)[:, 1:]
    explained = np.linalg.qr(shapes)[0].T @ x[rows] / scatter
    return bool(explained @ explained > scipy.special.chdtri(2, ALARM))


def held_channels(log: Log) -> Iterator[Fault]:
    """Channels refreshed more seldom than logged: no change is more frequent than a small one."""
    for name, x in log.channels():
        # held positions look as noisy as they move
        moving = log.travel != 0 if name == "q" else log.moving
        columns = zip(x.T, moving.T, log.quanta[name], strict=True)
        shares = np.array([_held_share(*column) for column in columns])
        if not shares.any():
            continue
        worst = np.argmax(shares)
        joints = log.names(np.flatnonzero(shares))
        detail = (
            f"{name} of {', '.join(joints)} is held: {100 * shares[worst]:.1f} % of its samples "
            f"at {log.joints[worst]} repeat the one before exactly while the joint moves, "
            f"though the others change by many steps of its resolution"
        )
        yield Fault("duplicate_samples", joints, detail, {"channel": name})


def _held_share(x: Array, moving: Mask, step: float) -> float:
    """Share of samples of a moving joint that repeat the one before; 0 where by chance."""
    moved = moving[1:] & moving[:-1]
    for start, length in zip(*run_lengths(np.diff(x) == 0), strict=True):
        if length >= 25:  # dead, not held
            moved[start : start + length] = False
    change = np.abs(np.diff(x))[moved]
    fresh = change[change > 0]
    if len(change) < 50 or len(fresh) < 25:
        return 0.0
    small = 0.2 * np.median(fresh)
    few = (fresh <= small).sum()
    if few < 5:
        return 0.0  # coarse steps: no change is as good as a small one
    # a torque that friction rules stays for a while too, between small changes or few large ones
    starts, lengths = run_lengths(change == 0)
    ends = starts + lengths
    inner = (starts > 0) & (ends < len(change))
    large = change > max(small, 4 * step)
    held = (large[starts[inner] - 1] & large[ends[inner]]).sum()
    excess = held - few - 5 * np.sqrt(held + few)
    beyond = excess > 0 and held > 0.02 * len(change)
    return 1 - len(fresh) / len(change) if beyond else 0.0


def wrapped_counters(log: Log) -> Iterator[Fault]:
    """Positions that jump by a turn, and channels whose negative values were logged unsigned.

    One joint shows by its jumps how all joints are coded whose values go as far.
    """
    for name, values in log.channels():
        steps = log.quanta[name]
        columns = list(values.T)
        codes = [_turns(x) if name == "q" else _unsigned(x) for x in columns]
        most = np.broadcast_to(log.most if name == "tau" else np.inf, log.nv)
        clear = (
            (code, step)
            for code, x, step, limit in zip(
                codes, columns, steps, most, strict=True
            )
            if code and (code.smooth or code.allows(x, limit))
        )
        shown, shown_step = next(clear, (None, 1.0))
        if shown is None:
            continue
        for j, (x, code) in enumerate(zip(columns, codes, strict=True)):
            if code is None and name != "q":
                size = shown.size * steps[j] / shown_step
                alike = _Code(shown.action, size, NO_ROWS)
                way = np.sign(size)
                coded = (way * x).min() >= 0 and (way * alike.decode(x)).min() < 0
                code = alike if coded else None
            if code is not None:
                yield _coded(log, name, j, code)


def _coded(log: Log, name: str, j: int, code: _Code) -> Fault:
    """The fault of a channel that is coded so."""
    x = np.copysign(1, code.size) * getattr(log, name)[:, j]
    size = abs(code.size)
    jumps = int((np.abs(np.diff(x)) > size / 2).sum())
    high = (x > x.min() + size / 2).sum() if jumps else len(x)
    way = f"jumps {jumps} times by" if jumps else "is beyond"
    share = f"{high} of {len(log)} values"
    what, done = {
        "unwrap": (f"a turn: {share} are a turn off", "continues over the jumps"),
        "signed": (
            f"the range of a counter: {share} are negative ones logged unsigned",
            f"takes {size:.6g} off where the counter wrapped",
        ),
        "sign_bit": (
            f"a sign bit: {share} are negative ones logged as {size:.6g} and their magnitude",
            f"takes {size:.6g} for the sign bit",
        ),
    }[code.action]
    detail = f"{name} of {log.joints[j]} {way} {size:.6g}, {what}"
    evidence = {"channel": name, "range": size, "jumps": jumps}
    remedies = [Remedy(code.action, name, (j,), factor=code.size)]
    if len(code.between):
        remedies.append(Remedy("interpolate", name, (j,), code.between))
    return Fault(
        "corrupt_rows", log.names([j]), detail, evidence, done, tuple(remedies)
    )


class _Code(NamedTuple):
    """How the values of a channel are coded, as the remedy that decodes them."""

    action: str
    size: float  # of the turn, the counter's range or the sign bit
    between: Rows  # that a logger interpolated over a jump
    smooth: bool = True  # a quarter of its sign changes are no larger than others

    def decode(self, x: Array) -> Array:
        """The values that were coded so."""
        return DECODED[self.action](x, self.size)

    def allows(self, x: Array, limit: float) -> bool:
        """Whether a torque is beyond what its drive can give but for this code.

        Friction at a reversal makes torque jump as well, but within that limit.
        """
        decoded = np.delete(self.decode(x), self.between)
        return bool(np.abs(decoded).max() <= limit < np.abs(x).max())


def _turns(x: Array) -> _Code | None:
    """A position that jumps by a turn, of radians or degrees, and else by far less."""
    change = np.abs(np.diff(x))
    for turn in (2 * np.pi, 360.0):
        jumps = change > turn / 2
        if not jumps.any() or jumps.mean() > _MOST_JUMPS:
            continue
        usual = np.quantile(change[~jumps], 0.99)
        if usual < turn / 8 and abs(np.median(change[jumps]) - turn) < turn / 4:
            return _Code("unwrap", turn, NO_ROWS)
    return None


def _unsigned(x: Array) -> _Code | None:
    """Negative values logged unsigned: with a sign bit, or in two's complement of twice that bit.

    Where their sign changes all of them jump by more than half the bit, decoded ones by less than
    half as much. A logger that interpolates leaves rows on the way of a jump.
    """
    # a map may turn the sign of all
    way = -1.0 if x.max() <= 0 else 1.0
    x = way * x
    change = np.diff(x)
    steep = np.abs(change) > _PASSING * np.ptp(x)
    onward = steep[1:] & steep[:-1] & (change[1:] * change[:-1] > 0)
    passing = 1 + np.flatnonzero(onward)
    kept = np.delete(x, passing)
    step = quantum(kept)
    highest = kept.max()
    if kept.min() < 0 or highest < _FEW_STEPS * step or step == 0:
        return None
    bit = step * 2.0 ** np.floor(np.log2(highest / step) + 1e-9)
    upper = kept >= (1 - 1e-9) * bit
    at = np.flatnonzero(np.diff(upper))
    jumps = np.abs(np.diff(kept)[at])
    if not 2 <= len(at) <= _MOST_JUMPS * len(x) or jumps.min() <= bit / 2:
        return None
    low = kept[~upper].max()
    high = kept[upper].min()
    between = passing[(x[passing] > low) & (x[passing] < high)]
    for action, size in (("signed", 2 * bit), ("sign_bit", bit)):
        code = _Code(action, float(size), between)
        change = np.abs(np.diff(code.decode(kept)))
        if np.median(change[at]) < np.median(jumps) / 2:
            usual = np.quantile(np.delete(change, at), 0.99)
            smooth = bool(np.quantile(change[at], 0.25) <= usual)
            return code._replace(size=way * code.size, smooth=smooth)
    return None


def missing_values(log: Log) -> Iterator[Fault]:
    """Rows with values that are no finite numbers."""
    bad = np.any([~np.isfinite(x) for _, x in log.channels()], axis=0)
    if len(rows := np.flatnonzero(bad.any(axis=1))):
        what = (
            f"{len(rows)} of {len(log)} rows hold values that are no finite numbers"
        )
        joints = log.names(np.flatnonzero(bad.any(axis=0)))
        yield dropped(joints, rows, f"{what}, {log.first(rows)}")


def jumps_and_outliers(log: Log) -> Iterator[Fault]:
    """Rows that are missing unseen, single values or short bursts far off, positions that jump."""
    hidden = list(hidden_gaps(log))
    yield from hidden
    far = _outlying(log, hidden[0].evidence["rows"] if hidden else NO_ROWS)
    count = sum(mask.sum(axis=1) for mask in far.values())
    whole = np.flatnonzero(count > 0.5 * log.nv * len(far))
    if len(whole):
        what = "are far from their neighbours in most columns, as rows with shifted columns are"
        detail = f"{len(whole)} of {len(log)} rows {what}; {log.first(whole)}"
        yield dropped(log.joints, whole, detail)
    for name, x in log.channels():
        far[name][whole] = False
        # a moving joint passes its running median
        smooth = (
            x - _distance(log.t, x)
            if name == "q"
            else _running_median(x, _MEDIAN_ROWS)
        )
        for j in np.flatnonzero(far[name].any(axis=0)):
            rows = np.flatnonzero(far[name][:, j])
            joint = log.joints[j]
            away = np.abs(x - smooth)[rows, j]
            k = rows[np.argmax(away)]
            size = away.max()
            least = max(noise(x[:, j]), log.quanta[name][j])
            times = f", {size / least:.0f} times the noise" if least > 0 else ""
            detail = (
                f"{name} of {joint} is far from its neighbours in {len(rows)} of {len(log)} rows; "
                f"worst row {k} at t = {log.t[k]:.4g} s: {x[k, j]:.5g}, which is {size:.4g} from "
                f"those around{times}"
            )
            evidence = {"channel": name, "rows": rows}
            remedies = (Remedy("interpolate", name, (int(j),), rows),)
            repair = f"interpolates {name} of {joint} there"
            yield Fault(
                "corrupt_rows", (joint,), detail, evidence, repair, remedies
            )


def _outlying(log: Log, jumps: Rows) -> dict[str, Mask]:
    """Values that cannot be, by channel, each (n, nv); none around rows before missing ones.

    r is the distance of a value from the cubic through its four neighbours, over its local scale.
    Beyond chance a value is an outlier only if nothing that happened explains it: a step (it would
    not stand apart from the running median), jitter of the stamp (a position off by less than half
    its way per sample), a velocity that the positions confirm, or a jolt of several joints at once.
    """
    r = {name: _distance(log.t, x) for name, x in log.channels()}
    around = np.clip(jumps[:, None] + np.arange(-2, 4), 0, len(log) - 1)
    for values in r.values():
        values[around] = 0.0
    alarm = ALARM / (log.nv * len(r))
    far = dict[str, Mask]()
    for name, x in log.channels():
        # a joint at rest has no grain
        cannot_be = (
            _impossible(log, r[name]) & log.moving.any(axis=0)
            if name == "q"
            else _apart(x, r[name])
        )
        beyond = _far(x, r[name], log.quanta[name], alarm, name != "tau")
        far[name] = beyond & cannot_be
    far["tau"] &= ~_by_friction(log)
    if log.dq is not None:
        jolts = _jolts(log, log.dq, r["dq"], far)
        far["dq"] &= ~jolts
        far["tau"] &= ~jolts
    return far


def _apart(x: Array, r: Array) -> Mask:
    """Whether values stand apart from the running median, which is unknown at the ends.

    Friction at a reversal makes none: a value between those of two rows before and two rows after
    is on its way, one on the line through two neighbours on a side is beside a step, and a kink
    leaves the cubic by less than a step of the values beside it.
    """
    apart = np.abs(x - _running_median(x, _MEDIAN_ROWS)) > 0.5 * np.abs(r)
    step = np.abs(np.diff(x, axis=0))
    slope = np.minimum(step[1:], step[:-1])
    apart[3:-3] &= np.abs(r[3:-3]) > np.maximum(slope[:-4], slope[4:])
    apart[2:-2] &= (x[2:-2] - x[:-4]) * (x[2:-2] - x[4:]) > 0
    lines = 2 * x[1:-3] - x[:-4], 2 * x[3:-1] - x[4:]
    off = np.minimum(*(np.abs(x[2:-2] - line) for line in lines))
    apart[2:-2] &= off > 0.5 * np.abs(r[2:-2])
    reach = _MEDIAN_ROWS // 2
    apart[:reach] = False
    apart[len(x) - reach :] = False
    return apart


def _by_friction(log: Log) -> Mask:
    """Torques, (n, nv), where the joint stops or turns, of a size that it has elsewhere as well.

    Dry friction falls for a moment where a joint stops and goes on, and rises where brakes close.
    """
    stops = 2 * np.abs(log.travel) <= log.grain
    stops[1:] |= log.travel[1:] * log.travel[:-1] < 0
    median = _running_median(log.tau, _MEDIAN_ROWS)
    usual = (log.tau >= median.min(axis=0)) & (log.tau <= median.max(axis=0))
    reach = len(_OUTLIER) // 2 + round(LONGEST_DELAY / log.step)
    return usual & _near(stops, reach)


def _jolts(log: Log, dq: Array, r: Array, far: dict[str, Mask]) -> Mask:
    """Rows near a velocity that the positions confirm, or that several joints share, (n, 1)."""
    way = np.zeros_like(dq)
    way[1:-1] = (log.q[2:] - log.q[:-2]) / (log.t[2:] - log.t[:-2])[:, None]
    tolerance = 0.5 * np.abs(r) + 3 * log.grain / log.step
    contradicted = np.abs(dq - way) > tolerance
    confirmed = far["dq"] & ~contradicted
    several = _near(far["dq"]).sum(axis=1) > 1
    shared = several & ~_near(far["q"]).any(axis=1)
    return _near((confirmed.any(axis=1) | shared)[:, None], 5)


def _near(mask: Mask, reach: int = 1) -> Mask:
    """Whether a mask, shape (n, k), is true within so many rows."""
    wide = scipy.ndimage.maximum_filter1d(
        mask.astype(np.uint8), 2 * reach + 1, axis=0
    )
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
    typical = np.quantile(size, 0.75, axis=0)
    usual = np.maximum(_running_median(size, 101), 0.2 * typical)
    z = size / np.maximum(usual, 1e-12 * np.where(span > 0, span, 1.0))
    bound = [tail_bound(column[column > 0], alarm) for column in z.T]
    # rounding of a log in single precision
    floor = np.maximum(step, np.finfo(np.float32).eps * np.abs(x).max(axis=0))
    if alike and typical.any():
        floor = np.maximum(floor, typical[typical > 0].min())
    return (z > bound) & (size > 3 * floor)


def _impossible(log: Log, r: Array) -> Mask:
    """Whether a position cannot have been where it was logged."""
    change = np.abs(np.diff(log.q, axis=0, prepend=log.q[:1]))
    jump = change > 3 * np.quantile(change, 0.99, axis=0)
    jump[:-1] |= jump[1:]
    padded = np.pad(r, ((2, 2), (0, 0)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, 5, axis=0)
    size = np.linalg.norm(windows, axis=-1) * np.linalg.norm(_OUTLIER)
    cosine = np.abs(windows @ _OUTLIER) / np.maximum(size, 1e-300)
    beyond_jitter = np.abs(r) > 0.5 * np.abs(log.travel)
    return beyond_jitter & ((cosine > 0.9) | jump)


def _distance(t: Array, x: Array) -> Array:
    """Distance of each value from the cubic through two neighbours on either side, (n, nv)."""
    n = len(t)
    r = np.zeros_like(x)
    k = np.arange(2, n - 2)
    around = [k - 2, k - 1, k + 1, k + 2]
    cubic = np.zeros_like(x[k])
    for i in around:
        others = [m for m in around if m is not i]
        weight = np.prod([(t[k] - t[m]) / (t[i] - t[m]) for m in others], axis=0)
        cubic += weight[:, None] * x[i]
    r[k] = x[k] - cubic
    steps = np.diff(t)
    gaps = np.flatnonzero(steps > 1.75 * np.median(steps))  # too wide for the cubic
    for shift in range(-2, 2):
        r[np.clip(gaps - shift, 0, n - 1)] = 0.0
    return r


def not_measured(case: TorqueFit) -> Iterator[Fault]:
    """Joints whose torque has no error of its own, and those whose noise is that of the motion."""
    log = case.log
    span = np.ptp(log.tau, axis=0)
    missed = np.sqrt(case.power) / np.maximum(case.tau.std(axis=0), 1e-100)
    # no drive is known to a hundredth of its torque, or as free of noise as to a thousandth
    ideal = {
        j: missed[j]
        for j in case.joints
        if missed[j] < 0.01 and _own_noise(log.tau[:, j]) < 1e-3 * span[j]
    }
    computed = (
        (
            ideal,
            "the output of a model, not a measurement: rigid bodies with viscous and Coulomb "
            "friction miss it by at most {:.2f} % of its spread, and its own noise is less than "
            "a thousandth of its range",
        ),
        (
            _derived(log, case.joints),
            "computed from the logged motion, not measured: up to {:.1f} % of the variance of its "
            "noise is that of the differentiated positions and velocities",
        ),
    )
    for shares, how in computed:
        if len(shares) > _MOST_JOINTS * len(case.joints):
            names = log.names(shares)
            what = how.format(100 * max(shares.values()))
            detail = f"tau of {', '.join(names)} is {what}"
            yield Fault("not_measured", names, detail, {"channel": "tau"})


def _own_noise(x: Array) -> float:
    """White noise of a channel: what differences of rising order do not make smaller."""
    differences = [
        np.median(np.abs(np.diff(x, k)))
        / 0.6745
        / np.sqrt(scipy.special.comb(2 * k, k))
        for k in (4, 6, 8)
    ]
    return float(max(0.0, min(differences) - quantum(x) / np.sqrt(12)))


def _derived(log: Log, joints: Sequence[int]) -> dict[int, float]:
    """Joints whose noise, away from gaps, that of the accelerations explains, and its share."""
    accelerations = [np.gradient(np.gradient(log.q, log.t, axis=0), log.t, axis=0)]
    if log.dq is not None:
        accelerations.append(np.gradient(log.dq, log.t, axis=0))
    gaps = np.append(np.diff(log.t) > 1.5 * log.step, False)
    # six rows of two gradients and four differences on either side
    near = scipy.ndimage.binary_dilation(gaps, np.ones(13, bool))
    regular = ~near[2 : len(log.t) - 2]
    rough = np.diff(np.column_stack(accelerations), 4, axis=0)[regular]
    if not len(rough):
        return {}
    size = root_mean_square(rough)
    rough = rough[:, size > 0] / size[size > 0]
    shares = {}
    for j in joints:
        y = np.diff(log.tau[:, j], 4)[regular]
        if len(y) < 20 * rough.shape[1] or not y.any():
            continue
        residual = y - rough @ np.linalg.lstsq(rough, y, rcond=None)[0]
        share = 1 - (residual**2).sum() / (y**2).sum()
        if share > _EXPLAINED:
            shares[j] = share
    return shares


def poor_excitation(robot: Robot, log: Log, data: Smooth | None) -> Iterator[Fault]:
    """Directions of the base parameters that the motion shows worse than they are known."""
    span = np.ptp(log.q, axis=0)
    still = span <= 50 * log.grain
    if data is None:
        if still.all() or not span.any():
            detail = f"no joint moves: positions vary by at most {span.max():.3g}"
            yield Fault("poor_excitation", log.joints, detail, {})
        return
    try:
        window = persistency(robot, data.motion)
    except ExcitantError:
        return  # the arm has no inertia to compare with
    missing = (window.levels < _WORTH).sum()
    if not missing:
        return
    lacking = tuple(j for j in log.joints if j in window.joints)
    names = lacking or log.names(np.flatnonzero(still)) or log.joints
    detail = (
        f"says less than {_WORTH:g} of what the given model does on {missing} of "
        f"{len(window.levels)} directions of the parameters, least on "
        f"{', '.join(window.weakest) or 'all'}; move {', '.join(names)}"
    )
    yield Fault("poor_excitation", names, detail, {})


def excited_together(robot: Robot, logs: Sequence[Log]) -> bool:
    """Whether several logs together excite what each alone does not."""
    step = 1 / (2 * ROWS_PER_SECOND)
    parts = []
    for log in logs:
        if data := smooth(log):
            t = data.motion.t
            instants = np.arange(t[0], t[-1], step)
            parts.append(data.motion[np.searchsorted(t, instants)])
    if len(parts) < 2:
        return False
    every = together(parts)
    whole = replace(every, t=step * every.t)
    return bool((persistency(robot, whole).levels >= _WORTH).all())
