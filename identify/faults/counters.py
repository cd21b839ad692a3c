"""Channels that were logged as counters that wrap."""

from __future__ import annotations

import numpy as np

from excitant.identify.faults.fault import Fault, Remedy
from excitant.identify.faults.log import Log, quantum
from excitant.robots.motion import Array

_COUNTERS = (2.0**8, 2.0**10, 2.0**12, 2.0**16, 2.0**32)


def wrapped_counters(log: Log) -> list[Fault]:
    """Channels whose negative values were logged as a counter's upper half, or that wrap.

    A wrapped channel jumps by the full range of the counter, a power of two of its steps (a full
    turn for positions), leaves the middle of its range empty, and is smooth without the jumps.
    """
    found = []
    for name, x in log.channels():
        for j in range(log.nv):
            size = _wrap(x[:, j], name == "q")
            if size is None:
                continue
            jumps = int((np.abs(np.diff(x[:, j])) > size / 2).sum())
            high = int((x[:, j] > x[:, j].min() + size / 2).sum())
            found.append(wrapped_fault(log.joints[j], j, name, len(log), size, jumps, high))
    return found


def wrapped_fault(
    joint: str, j: int, name: str, n: int, size: float, jumps: int, high: int
) -> Fault:
    """The fault of a channel of joint j, of n rows.

    Args:
        joint: Its name.
        j: Its index.
        name: The channel.
        n: Rows of the log.
        size: Range of the counter.
        jumps: How often it wraps.
        high: Values in its upper half.
    """
    return Fault(
        "corrupt_rows",
        (joint,),
        f"{name} of {joint} jumps {jumps} times by {size:.6g}, the range of a counter: {high} of "
        f"{n} values " + ("are a turn off" if name == "q" else "are negative ones logged unsigned"),
        {"channel": name, "range": size, "jumps": jumps, "count": high},
        f"takes {size:.6g} off where the counter wrapped",
        (Remedy("unwrap", name, (j,), factor=size),),
    )


def _wrap(x: Array, position: bool) -> float | None:
    change = np.abs(np.diff(x))
    span = float(np.ptp(x))
    jumps = change > 0.5 * span
    if span == 0 or jumps.sum() < 2 or jumps.mean() > 0.2:
        return None
    if not position and x.min() < 0:
        return None
    middle = (x - x.min()) / span
    if np.mean((middle > 0.35) & (middle < 0.65)) > 0.01:
        return None
    size, typical = float(np.median(change[jumps])), float(np.quantile(change[~jumps], 0.9))
    step = quantum(x)
    known = [2 * np.pi, 360.0] if position else [65536.0 * 10.0**k for k in range(-6, 1)]
    known += [] if position else [step * c for c in _COUNTERS]
    near = [k for k in known if abs(k - size) <= 3 * typical + 2 * step]
    if not near:
        return None
    best = min(near, key=lambda k: abs(k - size))
    unwrapped = unwrap(x, best, position)
    smooth = np.abs(np.diff(unwrapped)).max() < 0.5 * best
    return best if smooth and (position or np.ptp(unwrapped) < 0.9 * span) else None


def unwrap(x: Array, size: float, position: bool) -> Array:
    """A channel without the jumps of its counter: continuous, or signed."""
    if position:
        return np.asarray(np.unwrap(x, period=size), float)
    return np.asarray(np.where(x > size / 2, x - size, x), float)
