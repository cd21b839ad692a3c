"""Channels that say nothing or something else: dead, held, cut off, counters that wrap, copies."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from itertools import islice, product

import numpy as np
import scipy

from excitant.identify.faults.fault import Fault, Remedy, unwrap
from excitant.identify.faults.log import (
    ALARM,
    CHANNELS,
    Log,
    Mask,
    Raw,
    noise,
    quantum,
    run_lengths,
    tail_bound,
)
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

_BLOCKS = 100  # of a channel, whose means white noise keeps small
_STRETCH_S = 0.1  # s: shorter repetitions are samples that were held
_TRAVELLED = 20.0  # resolutions that a joint must move during a dead stretch
_SAME = 0.01  # share of pairs that far apart that may be equal by chance
_LEVELS, _SIGMAS = 4, 3.0  # width of the band below the extreme value
_AT_LEAST = 5  # samples at the extreme value
_FRESH = 0.2  # of the typical change: smaller counts as "hardly changed"
_HELD = 25  # samples
_COUNTERS = (2.0**8, 2.0**10, 2.0**12, 2.0**16, 2.0**32)


def dead_channels(log: Log) -> Iterator[Fault]:
    """Channels that are constant, only noise, or stop for a while, though the joint moves."""
    tests = (_constant, _white, _stretch)
    for (name, x), j in product(log.channels(), range(log.nv)):
        found = (fault for test in tests if (fault := test(log, name, x[:, j], j)) is not None)
        yield from islice(found, 1)


def _dead(log: Log, name: str, j: int, detail: str, **evidence: object) -> Fault:
    joint = log.joints[j]
    sentence = f"{name} of {joint} {detail}"
    return Fault("dead_channel", (joint,), sentence, {"channel": name, **evidence})


def _constant(log: Log, name: str, x: Array, j: int) -> Fault | None:
    """A channel with one value, of which a position or velocity counts where the other moves."""
    moves = log.moving[:, j].any()
    if np.ptp(x) > 0 or (name == "dq" and not moves):
        return None
    against = f", while q of the joint moves over {np.ptp(log.q[:, j]):.4g}" if moves else ""
    if name == "q":
        speed = np.zeros(1) if log.dq is None else log.dq[:, j]
        if np.ptp(speed) == 0 or np.abs(speed).mean() < 5 * noise(speed):
            return None
        against = f", while dq of the joint varies over {np.ptp(speed):.4g}"
    return _dead(log, name, j, f"is {x[0]:.6g} in every row{against}", value=float(x[0]))


def _white(log: Log, name: str, x: Array, j: int) -> Fault | None:
    """A channel whose block means scatter no more than those of white noise.

    Means of b samples of white noise have 1/b of its variance; b times the variance of B of them
    in parts of that of all samples is χ² with B − 1 degrees of freedom, over B − 1.
    """
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
    return _dead(log, name, j, detail, ratio=ratio, bound=bound, std=x.std())


def _stretch(log: Log, name: str, x: Array, j: int) -> Fault | None:
    """The longest run of one value, if the channel never else keeps a value that long."""
    starts, lengths = run_lengths(np.diff(x) == 0)
    if not len(lengths):
        return None
    k = int(np.argmax(lengths))
    start, length = int(starts[k]), int(lengths[k])
    rows = slice(start, start + length + 1)
    seconds = float(log.t[start + length] - log.t[start])
    if seconds < _STRETCH_S or length < 10 or length <= tail_bound(lengths, ALARM / log.nv):
        return None
    way, clear = float(np.ptp(log.q[rows, j])), float(_TRAVELLED * log.grain[j])
    if name == "q":
        if log.dq is None:
            return None
        way = abs(float(np.trapezoid(log.dq[rows, j], log.t[rows])))
        clear += 5 * noise(log.dq[:, j]) * np.sqrt(length) * log.step
    apart = x[length:] == x[:-length]
    apart[max(0, start - length) : start + length + 1] = False
    if way < clear or apart.mean() > _SAME or x[start] in (x.max(), x.min()):
        return None
    detail = (
        f"stays at {x[start]:.6g} for {seconds:.3g} s from t = {log.t[start]:.4g} s while the "
        f"joint moves; else it keeps no value for that long"
    )
    value, t = float(x[start]), float(log.t[start])
    return _dead(log, name, j, detail, value=value, start=t, seconds=seconds)


def saturation(log: Log, robot: Robot) -> Iterator[Fault]:
    """Torque that stays at its extreme value while the motion goes on.

    Of a channel that is not cut off no more samples lie exactly at the extreme value than in the
    band below it, four steps of resolution or three standard deviations of noise wide: even a
    smooth peak spends longer there. The excess is tested as a Poisson count.
    """
    moved = np.asarray(log.moving.any(axis=1), bool)
    for j, sign in product(range(log.nv), (1.0, -1.0)):
        fault = _at_extreme(log, j, sign, moved) or _at_limit(log, robot, j, sign)
        if fault is not None:
            yield fault


def _at_extreme(log: Log, j: int, sign: float, moved: Mask) -> Fault | None:
    x = sign * log.tau[:, j]
    top, step, span = float(x.max()), quantum(x), float(np.ptp(x))
    band = max(_LEVELS * step, _SIGMAS * noise(x), 1e-6 * span)
    at = moved & (x > top - min(step / 2, 1e-9 * span))
    count, near = int(at.sum()), int((moved & ~at & (x > top - band)).sum())
    if count < _AT_LEAST or band == 0:
        return None
    if scipy.special.pdtrc(count - 1, near + 1) > ALARM / (2 * log.nv):
        return None
    longest, joint = int(run_lengths(at)[1].max()), log.joints[j]
    return Fault(
        "saturation",
        (joint,),
        f"tau of {joint} is at its {'largest' if sign > 0 else 'smallest'} value {sign * top:.6g} "
        f"{log.unit} in {count} of {len(log)} rows, up to {longest} in a row, while joints move; "
        f"only {near} lie within {band:.3g} of it",
        {"value": sign * top, "count": count, "longest": longest, "near": near},
    )


def _at_limit(log: Log, robot: Robot, j: int, sign: float) -> Fault | None:
    """Torque that reaches the given limit of its motor, and leaves it by noise alone."""
    x, limit = sign * log.tau[:, j], float(robot.limits.torque[j])
    scatter, top = noise(x), float(x.max())
    if log.unit != "N·m" or not np.isfinite(limit) or scatter > 0.05 * limit:
        return None
    at = x > limit - 2 * scatter
    longest, joint = int(run_lengths(at)[1].max(initial=0)), log.joints[j]
    if top > limit + 6 * scatter or longest < _AT_LEAST:
        return None
    return Fault(
        "saturation",
        (joint,),
        f"tau of {joint} is within its noise of the limit {sign * limit:.6g} {log.unit} in "
        f"{at.sum()} of {len(log)} rows, up to {longest} in a row",
        {"value": sign * limit, "count": int(at.sum()), "longest": longest},
    )


def held_channels(log: Log) -> Iterator[Fault]:
    """Channels that are refreshed more seldom than they are logged.

    Changes of a measured channel are distributed without a peak at zero: no change at all is
    rarer than a small one. Where it is more frequent by far more than chance, values were held.
    """
    for name, x in log.channels():
        held = {j: share for j in range(log.nv) if (share := _held_share(log, x[:, j], j)) > 0}
        if held:
            worst, joints = max(held, key=lambda j: held[j]), log.names(held)
            yield Fault(
                "duplicate_samples",
                joints,
                f"{name} of {', '.join(joints)} is held: {held[worst]:.1%} of its samples at "
                f"{log.joints[worst]} repeat the one before exactly while the joint moves, though "
                f"the others change by many steps of its resolution",
                {"channel": name, "share": list(held.values())},
            )


def _held_share(log: Log, x: Array, j: int) -> float:
    starts, lengths = run_lengths(np.diff(x) == 0)
    moved = log.moving[1:, j] & log.moving[:-1, j]
    for start, length in zip(starts, lengths, strict=True):
        if length >= _HELD:  # dead, not held
            moved[start : start + length] = False
    change = np.abs(np.diff(x))[moved]
    fresh = change[change > 0]
    if len(change) < 50 or len(fresh) < 25:
        return 0.0
    none, few = len(change) - len(fresh), int((fresh <= _FRESH * np.median(fresh)).sum())
    if few < 5:
        return 0.0  # coarse steps: no change is as good as a small one
    excess = none - few - 5 * np.sqrt(none + few)
    return none / len(change) if excess > 0 and none > 0.02 * len(change) else 0.0


def wrapped_counters(log: Log) -> Iterator[Fault]:
    """Channels whose negative values were logged as a counter's upper half, or that wrap.

    A wrapped channel jumps by the full range of the counter, a power of two of its steps (a full
    turn for positions), leaves the middle of its range empty, and is smooth without the jumps.
    """
    for (name, values), j in product(log.channels(), range(log.nv)):
        x = values[:, j]
        size = _wrap(x, name == "q")
        if size is None:
            continue
        jumps = int((np.abs(np.diff(x)) > size / 2).sum())
        high = int((x > x.min() + size / 2).sum())
        what = "are a turn off" if name == "q" else "are negative ones logged unsigned"
        yield Fault(
            "corrupt_rows",
            log.names([j]),
            f"{name} of {log.joints[j]} jumps {jumps} times by {size:.6g}, the range of a counter: "
            f"{high} of {len(log)} values {what}",
            {"channel": name, "range": size, "jumps": jumps, "count": high},
            f"takes {size:.6g} off where the counter wrapped",
            (Remedy("unwrap", name, (j,), factor=size),),
        )


def _wrap(x: Array, position: bool) -> float | None:
    """Range of the counter that a channel wraps at; None when it does not."""
    change, span = np.abs(np.diff(x)), float(np.ptp(x))
    jumps = change > 0.5 * span
    if span == 0 or jumps.sum() < 2 or jumps.mean() > 0.2 or (not position and x.min() < 0):
        return None
    middle = (x - x.min()) / span
    if np.mean((middle > 0.35) & (middle < 0.65)) > 0.01:
        return None
    size, typical = float(np.median(change[jumps])), float(np.quantile(change[~jumps], 0.9))
    step = quantum(x)
    known = [2 * np.pi, 360.0]
    if not position:
        known = [65536.0 * 10.0**k for k in range(-6, 1)] + [step * c for c in _COUNTERS]
    near = [k for k in known if abs(k - size) <= 3 * typical + 2 * step]
    if not near:
        return None
    best = min(near, key=lambda k: abs(k - size))
    unwrapped = unwrap(x, best, position)
    smooth = np.abs(np.diff(unwrapped)).max() < 0.5 * best
    return best if smooth and (position or np.ptp(unwrapped) < 0.9 * span) else None


def find_copies(recordings: Mapping[str, Raw]) -> dict[str, Fault]:
    """Recordings whose values are all those of an earlier one, whatever their time starts at.

    Args:
        recordings: By name.

    Returns:
        The fault of each copy, by its name.
    """
    first: dict[bytes, str] = {}
    found = {}
    for name, raw in recordings.items():
        made = hashlib.sha256()
        for x in (getattr(raw, channel) for channel in CHANNELS):
            made.update(b"" if x is None else np.ascontiguousarray(x, dtype=float).tobytes())
        same = first.setdefault(made.digest(), name)
        if same != name:
            found[name] = Fault(
                "duplicate_samples",
                (),
                f"{name} holds the same {len(raw.t)} rows as {same}: all positions, velocities and "
                f"torques are equal, so it adds no evidence and is no hold-out",
                {"same_as": same, "count": len(raw.t)},
            )
    return found
