"""Channels that say nothing: dead ones, and those cut off at their limit."""

from __future__ import annotations

import numpy as np
import scipy.stats

from excitant.identify.faults.fault import ALARM, Fault
from excitant.identify.faults.log import Log, noise, quantum
from excitant.identify.faults.statistics import run_lengths, tail_bound
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

_BLOCKS = 100  # of a channel, whose means white noise keeps small
_STRETCH_S = 0.1  # s: shorter repetitions are samples that were held
_TRAVELLED = 20.0  # resolutions that a joint must move during a dead stretch
_SAME = 0.01  # share of pairs that far apart that may be equal by chance
_LEVELS, _SIGMAS = 4, 3.0  # width of the band below the extreme value
_AT_LEAST = 5  # samples at the extreme value


def dead_channels(log: Log) -> list[Fault]:
    """Channels that are constant, only noise, or stop for a while, though the joint moves."""
    found = []
    for name, x in log.channels():
        for j in range(log.nv):
            detail = _constant(log, name, x[:, j], j) or _white(log, name, x[:, j], j)
            if detail is not None:
                found.append(Fault("dead_channel", log.names([j]), *detail))
            elif (stretch := _stretch(log, name, x[:, j], j)) is not None:
                found.append(stretch)
    return found


_Detail = tuple[str, dict[str, object]]


def _constant(log: Log, name: str, x: Array, j: int) -> _Detail | None:
    if np.ptp(x) > 0:
        return None
    if name == "dq" and not log.moving[:, j].any():
        return None
    if name == "q" and (log.dq is None or np.ptp(log.dq[:, j]) == 0):
        return None
    against = ""
    if name == "q":
        speed = np.asarray(log.dq)[:, j]
        if np.abs(speed).mean() < 5 * noise(speed):
            return None
        against = f", while dq of the joint varies over {np.ptp(speed):.4g}"
    elif log.moving[:, j].any():
        against = f", while q of the joint moves over {np.ptp(log.q[:, j]):.4g}"
    detail = f"{name} of {log.joints[j]} is {x[0]:.6g} in every row{against}"
    return detail, {"channel": name, "value": x[0]}


def _white(log: Log, name: str, x: Array, j: int) -> _Detail | None:
    """Whether block means of a channel scatter no more than those of white noise."""
    moved = log.moving[:, j]
    block = len(x) // _BLOCKS
    if name == "q" or block < 5 or moved.mean() < 0.5:
        return None
    means = x[: block * _BLOCKS].reshape(_BLOCKS, block).mean(axis=1)
    ratio = block * means.var(ddof=1) / x.var()
    alarm = ALARM / log.nv
    bound = scipy.stats.chi2.isf(alarm, _BLOCKS - 1) / (_BLOCKS - 1)
    if ratio > bound:
        return None
    return (
        f"{name} of {log.joints[j]} is only noise of {x.std():.3g} while the joint moves: means "
        f"of {block} samples vary {ratio:.2f} times as much as those of white noise (by chance "
        f"up to {bound:.2f})",
        {"channel": name, "ratio": ratio, "bound": bound, "std": x.std()},
    )


def _stretch(log: Log, name: str, x: Array, j: int) -> Fault | None:
    """The longest run of one value, if the channel never else keeps a value that long."""
    starts, lengths = run_lengths(np.diff(x) == 0)
    if not len(lengths):
        return None
    k = int(np.argmax(lengths))
    start, length = int(starts[k]), int(lengths[k])
    seconds = log.t[start + length] - log.t[start]
    if seconds < _STRETCH_S or length < 10 or length <= tail_bound(lengths, ALARM / log.nv):
        return None
    if name == "q":
        if log.dq is None:
            return None
        speed = log.dq[start : start + length + 1, j]
        driven = abs(np.trapezoid(speed, log.t[start : start + length + 1]))
        if (
            driven
            < _TRAVELLED * max(log.resolution[j], log.quantum[j])
            + 5 * noise(log.dq[:, j]) * np.sqrt(length) * log.step
        ):
            return None
    else:
        way = np.ptp(log.q[start : start + length + 1, j])
        if way < _TRAVELLED * max(log.resolution[j], log.quantum[j]):
            return None
    apart = x[length:] == x[:-length]
    apart[max(0, start - length) : start + length + 1] = False
    if apart.mean() > _SAME or x[start] in (x.max(), x.min()):
        return None
    return Fault(
        "dead_channel",
        log.names([j]),
        f"{name} of {log.joints[j]} stays at {x[start]:.6g} for {seconds:.3g} s from "
        f"t = {log.t[start]:.4g} s while the joint moves; else it keeps no value for that long",
        {"channel": name, "value": x[start], "start": log.t[start], "seconds": seconds},
    )


def saturation(log: Log, robot: Robot) -> list[Fault]:
    """Torque that stays at its extreme value while the motion goes on.

    Of a channel that is not cut off no more samples lie exactly at the extreme value than in the
    band below it, four steps of resolution or three standard deviations of noise wide: even a
    smooth peak spends longer there. The excess is tested as a Poisson count.
    """
    found = []
    for j in range(log.nv):
        x = log.tau[:, j]
        moved = np.asarray(log.moving.any(axis=1))
        for sign, word in ((1.0, "largest"), (-1.0, "smallest")):
            fault = _at_extreme(log, sign * x, j, moved, sign, word) or _at_limit(
                log, robot, sign * x, j, sign
            )
            if fault is not None:
                found.append(fault)
    return found


def _at_extreme(
    log: Log, x: Array, j: int, moved: np.ndarray, sign: float, word: str
) -> Fault | None:
    top, step = float(x.max()), quantum(x)
    band = max(_LEVELS * step, _SIGMAS * noise(x), 1e-6 * float(np.ptp(x)))
    at = moved & (x > top - min(step / 2, 1e-9 * float(np.ptp(x))))
    below = int((moved & ~at & (x > top - band)).sum())
    count = int(at.sum())
    if np.ptp(x) == 0 or count < _AT_LEAST:
        return None
    if scipy.stats.poisson.sf(count - 1, below + 1) > ALARM / (2 * log.nv):
        return None
    longest = int(run_lengths(at)[1].max())
    return Fault(
        "saturation",
        log.names([j]),
        f"tau of {log.joints[j]} is at its {word} value {sign * top:.6g} {log.unit} in {count} of "
        f"{len(log)} rows, up to {longest} in a row, while joints move; only {below} lie within "
        f"{band:.3g} of it",
        {"value": sign * top, "count": count, "longest": longest, "near": below},
    )


def _at_limit(log: Log, robot: Robot, x: Array, j: int, sign: float) -> Fault | None:
    """Torque that noise alone makes leave the given limit of its motor."""
    limit, scatter = float(robot.limits.torque[j]), noise(x)
    if log.unit != "N·m" or not np.isfinite(limit) or scatter > 0.05 * limit:
        return None
    at = x > limit - 2 * scatter
    lengths = run_lengths(at)[1]
    if not at.any() or x.max() > limit + 6 * scatter or lengths.max() < _AT_LEAST:
        return None
    return Fault(
        "saturation",
        log.names([j]),
        f"tau of {log.joints[j]} is within its noise of the limit {sign * limit:.6g} {log.unit} "
        f"in {int(at.sum())} of {len(log)} rows, up to {int(lengths.max())} in a row",
        {"value": sign * limit, "count": int(at.sum()), "longest": int(lengths.max())},
    )
