"""Where an error shows: what share of its power each quantity explains on its own.

The share of a quantity x is that of the means of the error over bins of x (the correlation ratio
of Pearson 1905), less what chance gives to as many bins, after the constant part is taken off.
Shares overlap: friction that grows with speed also differs by direction. The telling quantity is
therefore the simplest of those that explain nearly as much as the best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from excitant.identify.least_squares import autocorrelation_time
from excitant.identify.preprocessing import Segment
from excitant.robots.motion import Array, freeze

CONSTANT = "constant"
DOMAINS = (CONSTANT, "direction", "velocity", "position", "load", "reversal", "time")
"""Simplest first: offset, sign of velocity, velocity, position, torque by direction, distance
since the last reversal by direction, and time (a slow trend)."""
BANDS = ("slower", "motion", "faster")
"""Below the base harmonic of the motion, in the band of the motion, above it."""

LITTLE = 0.1  # of the error's power: with less, a quantity tells nothing

_Index = npt.NDArray[np.intp]
_BINS = 24
_HALF = _BINS // 2
_NEARLY = 0.05  # of the error's power: how much more a less simple quantity must explain
_RESTS = 0.005  # of a joint's fastest motion: slower is no motion to either side
_INSIDE = 0.02  # of the power on either side of a motion's band
_TREND = 2  # degree of what changes slowly over time
_PERIODS = 3.0  # of the motion: in a shorter time, a trend is not told from the motion


@dataclass(frozen=True, eq=False)
class Places:
    """What an error may vary with, at the rows of a hold-out; each array of shape (n, nv).

    Attributes:
        position: Joint positions [rad or m].
        velocity: Joint velocities [rad/s or m/s].
        load: Torque of a model [torque unit].
        reversal: Distance since the joint last turned back, with the sign of its velocity
            [rad or m].
        lengths: Rows of each uninterrupted part.
        steps: Time between the rows of each part [s].
        bands: Lowest and highest frequency of each joint's motion, shape (nv, 2) [Hz].
    """

    position: Array
    velocity: Array
    load: Array
    reversal: Array
    lengths: tuple[int, ...]
    steps: tuple[float, ...]
    bands: Array

    def __post_init__(self) -> None:
        freeze(self, "position", "velocity", "load", "reversal", "bands")


def places(segments: Sequence[Segment], load: Array) -> Places:
    """What an error at the rows of segments may vary with.

    Args:
        segments: The hold-out.
        load: Torque of a model at its rows, shape (n, nv) [torque unit].
    """
    q, dq = (
        np.concatenate([getattr(s.motion, name)[s.keep] for s in segments]) for name in ("q", "dq")
    )
    fastest = np.max([np.abs(s.motion.dq).max(axis=0) for s in segments], axis=0)
    since = [since_reversal(s.motion.q, s.motion.dq, _RESTS * fastest)[s.keep] for s in segments]
    return Places(
        position=q,
        velocity=dq,
        load=load,
        reversal=np.concatenate(since),
        lengths=tuple(len(s.t) for s in segments),
        steps=tuple(float(s.t[1] - s.t[0]) for s in segments),
        bands=_bands(segments),
    )


def since_reversal(q: Array, dq: Array, slowest: Array) -> Array:
    """Signed distance from where each joint last turned back, shape (n, nv).

    Before the first reversal it is counted from the first instant.

    Args:
        q: Positions, shape (n, nv).
        dq: Velocities, shape (n, nv).
        slowest: Speed up to which a joint has no direction, shape (nv,).
    """
    way = np.where(np.abs(dq) > slowest, np.sign(dq), 0.0)
    at = np.arange(len(q))[:, None]
    known = np.maximum.accumulate(np.where(way != 0, at, 0), axis=0)
    way = np.take_along_axis(way, known, axis=0)
    turned = np.vstack([np.ones((1, q.shape[1]), bool), way[1:] != way[:-1]])
    last = np.maximum.accumulate(np.where(turned, at, 0), axis=0)
    distance = np.abs(q - np.take_along_axis(q, last, axis=0))
    signed: Array = way * distance
    return signed


def shares(e: Array, where: Places, j: int, rows: npt.NDArray[np.bool_]) -> dict[str, float]:
    """Share of the power of one joint's error that each of `DOMAINS` explains.

    Time is left out where the motion repeats too little to tell a trend from it.

    Args:
        e: Error at the rows, shape (n,).
        where: What it may vary with.
        j: The joint.
        rows: Rows that count, shape (n,).
    """
    e, time = e[rows], np.flatnonzero(rows).astype(float)
    dq, load = where.velocity[rows, j], where.load[rows, j]
    constant = float(e.mean())
    rest, total = e - constant, max(float((e**2).sum()), 1e-300)
    independent = len(e) / autocorrelation_time(rest)
    held = len(e) * constant**2
    found = {CONSTANT: (held - float((rest**2).sum()) / max(independent, 1.0)) / total}
    ways = (dq > 0).astype(np.intp)
    bins = {
        "direction": ways,
        "velocity": _even(dq, _BINS),
        "position": _even(where.position[rows, j], _BINS),
        "load": 2 * _even(load, _HALF) + ways,
        "reversal": 2 * _rising(np.abs(where.reversal[rows, j])) + ways,
    }
    for name, each in bins.items():
        found[name] = _held(rest, _means(rest, each), len(np.unique(each)) - 1) / total
    if where.bands[j, 0] * np.dot(where.lengths, where.steps) >= _PERIODS:
        trend = np.polynomial.Polynomial.fit(time, rest, _TREND)(time)
        found["time"] = _held(rest, trend, _TREND) / total
    return {name: float(np.clip(found[name], 0.0, 1.0)) for name in DOMAINS if name in found}


def telling(found: dict[str, float]) -> str:
    """The simplest quantity that explains nearly as much as the best; none where all say little."""
    best = max(found.values())
    if best < LITTLE:
        return ""
    return next(name for name in DOMAINS if found.get(name, -1.0) >= best - _NEARLY)


def band_shares(e: Array, where: Places, j: int) -> dict[str, float]:
    """Share of the power of one joint's error, its mean left out, in each of `BANDS`.

    Args:
        e: Error at all rows, shape (n,).
        where: Rows and the motion's band.
        j: The joint.
    """
    power, start, (low, high) = np.zeros(3), 0, where.bands[j]
    centred = e - e.mean()
    for length, step in zip(where.lengths, where.steps, strict=True):
        part = centred[start : start + length]
        start += length
        f, density = _spectrum(part[:, None], step)
        at = np.searchsorted([low - f[1] / 2, high + f[1] / 2], f)
        power += np.bincount(at, density[:, 0], minlength=3)
    total = max(float(power.sum()), 1e-300)
    return {name: float(part / total) for name, part in zip(BANDS, power, strict=True)}


def _bands(segments: Sequence[Segment]) -> Array:
    """Lowest and highest frequency at which each joint moves, shape (nv, 2) [Hz].

    All but a fiftieth of the power of its positions lies above, of its velocities below.
    """
    longest = max(segments, key=lambda s: len(s.motion))
    step = 1 / longest.rate_hz
    f, positions = _spectrum(longest.motion.q - longest.motion.q.mean(axis=0), step)
    _, velocities = _spectrum(longest.motion.dq, step)
    edges = []
    for power, share in ((positions, _INSIDE), (velocities, 1 - _INSIDE)):
        reached = np.cumsum(power, axis=0) >= share * power.sum(axis=0)
        edges.append(f[np.argmax(reached, axis=0)])
    return np.column_stack([np.minimum(*edges), edges[1]])


def _spectrum(x: Array, step: float) -> tuple[Array, Array]:
    """Frequencies and power of columns under Hann's window, without the constant."""
    window = np.hanning(len(x))[:, None]
    power = np.abs(np.fft.rfft(x * window, axis=0)) ** 2
    power[0] = 0.0
    return np.asarray(np.fft.rfftfreq(len(x), step), float), np.asarray(power, float)


def _even(x: Array, bins: int) -> _Index:
    """Bins of as many rows each."""
    edges = np.quantile(x, np.linspace(0, 1, bins + 1)[1:-1])
    return np.asarray(np.searchsorted(edges, x), np.intp)


def _rising(x: Array) -> _Index:
    """Bins that double in size from the smallest values on."""
    edges = np.quantile(x, 0.5 ** np.arange(7, 0, -1))
    return np.asarray(np.searchsorted(edges, x), np.intp)


def _means(e: Array, bins: _Index) -> Array:
    count = np.maximum(np.bincount(bins), 1)
    means: Array = (np.bincount(bins, e) / count)[bins]
    return means


def _held(e: Array, fitted: Array, freedom: int) -> float:
    """Power that a fit with some coefficients takes off an error, less what chance gives it."""
    rest = e - fitted
    left = float((rest**2).sum())
    independent = max(len(e) / autocorrelation_time(rest), 1.0)
    return float((e**2).sum()) - left - left * freedom / independent
