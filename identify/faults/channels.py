"""Channels that say nothing: dead ones, and those cut off at their limit."""

from __future__ import annotations

from dataclasses import dataclass

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
            detail = _constant(log, name, x[:, j], j) or white(log, name, x[:, j], j)
            if detail is not None:
                found.append(Fault("dead_channel", log.names([j]), *detail))
            elif (held := stretch(log, name, x[:, j], j)) is not None:
                found.append(held)
    return found


_Detail = tuple[str, dict[str, object]]


def _constant(log: Log, name: str, x: Array, j: int) -> _Detail | None:
    if np.ptp(x) > 0:
        return None
    if name == "dq" and not log.moving[:, j].any():
        return None
    against = ""
    if name == "q":
        speed = np.zeros(1) if log.dq is None else log.dq[:, j]
        if np.ptp(speed) == 0 or np.abs(speed).mean() < 5 * noise(speed):
            return None
        against = f", while dq of the joint varies over {np.ptp(speed):.4g}"
    elif log.moving[:, j].any():
        against = f", while q of the joint moves over {np.ptp(log.q[:, j]):.4g}"
    return constant_detail(name, log.joints[j], float(x[0]), against)


def constant_detail(name: str, joint: str, value: float, against: str) -> _Detail:
    """Evidence of a channel that never changes, with what speaks against it, if anything."""
    detail = f"{name} of {joint} is {value:.6g} in every row{against}"
    return detail, {"channel": name, "value": value}


def white(log: Log, name: str, x: Array, j: int) -> _Detail | None:
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


def stretch(log: Log, name: str, x: Array, j: int, alarm: float = ALARM) -> Fault | None:
    """The longest run of one value, if the channel never else keeps a value that long."""
    starts, lengths = run_lengths(np.diff(x) == 0)
    if not len(lengths):
        return None
    k = int(np.argmax(lengths))
    start, length = int(starts[k]), int(lengths[k])
    seconds = log.t[start + length] - log.t[start]
    if seconds < _STRETCH_S or length < 10 or length <= tail_bound(lengths, alarm / log.nv):
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
    return stretch_fault(log.joints[j], name, float(x[start]), float(log.t[start]), float(seconds))


def stretch_fault(joint: str, name: str, value: float, start: float, seconds: float) -> Fault:
    """The fault of a channel that keeps a value from a time on for some seconds."""
    return Fault(
        "dead_channel",
        (joint,),
        f"{name} of {joint} stays at {value:.6g} for {seconds:.3g} s from t = {start:.4g} s while "
        "the joint moves; else it keeps no value for that long",
        {"channel": name, "value": value, "start": start, "seconds": seconds},
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
    top = float(x.max())
    band = band_below(x)
    at = moved & (x > top - hair(x))
    below = int((moved & ~at & (x > top - band)).sum())
    longest = int(run_lengths(at)[1].max(initial=0))
    extreme = Extreme(sign * top, int(at.sum()), longest, below, band)
    return extreme_fault(log.joints[j], log.unit, len(log), log.nv, word, extreme)


def band_below(x: Array) -> float:
    """Width of the band below the extreme value that is compared with it."""
    return max(_LEVELS * quantum(x), _SIGMAS * noise(x), 1e-6 * float(np.ptp(x)))


def hair(x: Array) -> float:
    """How far below the extreme value is still at it."""
    return min(quantum(x) / 2, 1e-9 * float(np.ptp(x)))


@dataclass(frozen=True)
class Extreme:
    """How often a channel is at its extreme value and just below it.

    Attributes:
        value: The extreme value.
        count: Rows at it while joints move.
        longest: The most of them in a row.
        near: Rows in the band below it while joints move.
        band: Its width.
    """

    value: float
    count: int
    longest: int
    near: int
    band: float


def extreme_fault(
    joint: str, unit: str, n: int, nv: int, word: str, found: Extreme
) -> Fault | None:
    """The fault of a torque cut off at its ``largest`` or ``smallest`` value; None by chance."""
    if found.count < _AT_LEAST or found.band == 0:
        return None
    if scipy.stats.poisson.sf(found.count - 1, found.near + 1) > ALARM / (2 * nv):
        return None
    return Fault(
        "saturation",
        (joint,),
        f"tau of {joint} is at its {word} value {found.value:.6g} {unit} in {found.count} of "
        f"{n} rows, up to {found.longest} in a row, while joints move; only {found.near} lie "
        f"within {found.band:.3g} of it",
        {"value": found.value, "count": found.count, "longest": found.longest, "near": found.near},
    )


def _at_limit(log: Log, robot: Robot, x: Array, j: int, sign: float) -> Fault | None:
    """Torque that noise alone makes leave the given limit of its motor."""
    limit, scatter = float(robot.limits.torque[j]), noise(x)
    if not limit_is_near(log.unit, limit, scatter, float(x.max())):
        return None
    at = x > limit - 2 * scatter
    longest = int(run_lengths(at)[1].max(initial=0))
    return limit_fault(log.joints[j], log.unit, len(log), sign * limit, int(at.sum()), longest)


def limit_is_near(unit: str, limit: float, scatter: float, top: float) -> bool:
    """Whether a torque with noise reaches the limit of its motor and nothing beyond."""
    known = unit == "N·m" and np.isfinite(limit) and scatter <= 0.05 * limit
    return bool(known and limit - 2 * scatter < top <= limit + 6 * scatter)


def limit_fault(
    joint: str, unit: str, n: int, limit: float, count: int, longest: int
) -> Fault | None:
    """The fault of a torque at the limit of its motor; None where it is there by chance."""
    if longest < _AT_LEAST:
        return None
    return Fault(
        "saturation",
        (joint,),
        f"tau of {joint} is within its noise of the limit {limit:.6g} {unit} in {count} of {n} "
        f"rows, up to {longest} in a row",
        {"value": limit, "count": count, "longest": longest},
    )
