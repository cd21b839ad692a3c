"""Tallies: what pieces of a log say of one thing, put together."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from excitant.identify.faults.channels import (
    Extreme,
    band_below,
    constant_detail,
    extreme_fault,
    limit_fault,
    limit_is_near,
    stretch,
    stretch_fault,
    white,
)
from excitant.identify.faults.fault import Fault, Rows
from excitant.identify.faults.log import Log, noise
from excitant.identify.faults.stamps import dropped_fault, gaps_in
from excitant.identify.faults.statistics import run_lengths
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

_TRAVELLED = 20.0  # resolutions that a joint must move where a channel is dead
_VALUES = 5000  # different values near the extreme one that are counted apart
_HAIR = 1e-9  # of the band below the extreme value: at it
_LIVELY = 5.0  # noises of a velocity that is more than noise


class RowTally:
    """Rows, and when the first of them was.

    Attributes:
        first: Time of the first row [s].
    """

    def __init__(self) -> None:
        self._parts: list[Rows] = []
        self.first = np.nan

    def take(self, rows: Rows, t: Array) -> None:
        """Add rows at their times [s]."""
        if not len(rows):
            return
        if not self._parts:
            self.first = float(t[0])
        self._parts.append(rows)

    @property
    def rows(self) -> Rows:
        """All rows."""
        return np.concatenate([np.zeros(0, np.intp), *self._parts])


class Gaps:
    """Samples that are missing between stamps, in steps of the first piece."""

    def __init__(self) -> None:
        self._t, self._rows = np.zeros(0), np.zeros(0, np.intp)
        self._found, self._steps = RowTally(), list[Array]()
        self._step, self._longest = 0.0, (0.0, 0.0)

    def take(self, t: Array, rows: Rows) -> None:
        """Add stamps that rise, shape (n,) [s], and the rows they are of."""
        begun = len(self._t) > 0
        t, rows = np.concatenate([self._t, t]), np.concatenate([self._rows, rows])
        self._step = self._step or (float(np.median(np.diff(t))) if len(t) > 1 else 0.0)
        self._t, self._rows = t[-3:], rows[-3:]
        if len(t) > 3:
            self._count(t, rows, int(begun), len(t) - 2)

    def _count(self, t: Array, rows: Rows, low: int, high: int) -> None:
        at, steps = gaps_in(t, self._step)
        inside = (at >= low) & (at < high)
        at, steps = at[inside], steps[inside]
        if len(at):
            self._found.take(rows[at], t[at])
            self._steps.append(steps)
            k = int(np.argmax(steps))
            self._longest = max(self._longest, (float(steps[k]), float(t[at[k]])))

    def faults(self, joints: tuple[str, ...], n: int) -> list[Fault]:
        """The fault, if any, of a log of n rows."""
        if len(self._t) > 2:
            self._count(self._t, self._rows, len(self._t) - 2, len(self._t))
        if not self._steps:
            return []
        missing = int(np.round(np.concatenate(self._steps) - 1).sum())
        return [dropped_fault(joints, n, self._found.rows, missing, *self._longest, self._step)]


@dataclass
class _Life:
    """What one channel of one joint has shown.

    Attributes:
        low: Its lowest value.
        high: Its highest one.
        moved: Whether the joint, or for a position the measured velocity, has moved.
        quiet: Evidence that it is only noise, of every piece with motion; None once it is not.
        longest: The longest stretch at one value: seconds, start, value.
    """

    low: float = np.inf
    high: float = -np.inf
    moved: bool = False
    quiet: list[tuple[str, dict[str, object]]] | None = field(default_factory=list)
    longest: tuple[float, float, float] = (0.0, 0.0, 0.0)


class Lives:
    """Channels that say nothing: constant, only noise, or silent for a while."""

    def __init__(self) -> None:
        self._seen: dict[tuple[str, int], _Life] = {}
        self._way: dict[tuple[str, int], tuple[float, float]] = {}

    def take(self, log: Log, alarm: float) -> None:
        """Add a piece; a stretch is found in a living one with probability ``alarm``."""
        for name, x in log.channels():
            low, high = x.min(axis=0).tolist(), x.max(axis=0).tolist()
            held = (x[1:] == x[:-1]).any(axis=0)
            for j in range(log.nv):
                life = self._seen.setdefault((name, j), _Life())
                life.low, life.high = min(life.low, low[j]), max(life.high, high[j])
                life.moved = life.moved or _moved(log, name, j)
                if not held[j] and life.quiet is None:
                    continue
                self._listen(life, log, name, j, alarm)

    def _listen(self, life: _Life, log: Log, name: str, j: int, alarm: float) -> None:
        x = getattr(log, name)[:, j]
        if np.ptp(x) == 0:
            clear = _TRAVELLED * max(log.resolution[j], log.quantum[j])
            if name != "q" and np.ptp(log.q[:, j]) > clear:
                whole = (float(log.t[-1] - log.t[0]), float(log.t[0]), float(x[0]))
                life.longest = max(life.longest, whole)
            return
        if life.quiet is not None and name != "q" and log.moving[:, j].mean() >= 0.5:
            noisy = white(log, name, x, j)
            life.quiet = None if noisy is None else [*life.quiet, noisy]
        held = stretch(log, name, x, j, alarm)
        if held is not None:
            seconds, start, value = (float(held.evidence[k]) for k in ("seconds", "start", "value"))
            life.longest = max(life.longest, (seconds, start, value))

    def span(self, name: str) -> Array:
        """Lowest and highest value of a channel, shape (2, nv)."""
        lives = [life for (other, _), life in sorted(self._seen.items()) if other == name]
        return np.array([[life.low for life in lives], [life.high for life in lives]])

    def faults(self, joints: tuple[str, ...]) -> list[Fault]:
        """Dead channels."""
        found = []
        for (name, j), life in self._seen.items():
            if life.low == life.high:
                detail = self._constant(name, joints[j], j, life)
                if detail is not None:
                    found.append(Fault("dead_channel", (joints[j],), *detail))
            elif life.quiet:
                found.append(Fault("dead_channel", (joints[j],), *life.quiet[0]))
            elif life.longest[0] > 0:
                seconds, start, value = life.longest
                found.append(stretch_fault(joints[j], name, value, start, seconds))
        return found

    def _constant(
        self, name: str, joint: str, j: int, life: _Life
    ) -> tuple[str, dict[str, object]] | None:
        if name != "tau" and not life.moved:
            return None
        of, verb = ("dq", "varies") if name == "q" else ("q", "moves")
        other = self._seen.get((of, j))
        against = ""
        if life.moved and other is not None:
            against = f", while {of} of the joint {verb} over {other.high - other.low:.4g}"
        return constant_detail(name, joint, life.low, against)


def _moved(log: Log, name: str, j: int) -> bool:
    """Whether a joint moves, as its velocity says of its position, and its position of others."""
    if name != "q":
        return bool(log.moving[:, j].any())
    speed = np.zeros(10) if log.dq is None else log.dq[:, j]
    return bool(np.abs(speed).mean() > _LIVELY * noise(speed))


@dataclass
class _Edge:
    """The values of a torque near its largest one, the sign taken off."""

    band: float
    scatter: float
    top: float = -np.inf
    values: Array = field(default_factory=lambda: np.zeros(0))
    counts: Array = field(default_factory=lambda: np.zeros(0, int))
    rest: int = 0
    longest: int = 0
    at_limit: int = 0
    longest_at_limit: int = 0


class Extremes:
    """Torque that stays at its extreme value, or at the limit of its motor."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._edges: dict[tuple[int, float], _Edge] = {}
        self._grain: Array | None = None

    def take(self, log: Log) -> None:
        """Add a piece; the widths of bands are those of the first one that is not constant."""
        if self._grain is None:
            self._grain = np.maximum(log.resolution, log.quantum)
        for j in range(log.nv):
            for sign in (1.0, -1.0):
                x = sign * log.tau[:, j]
                if (j, sign) not in self._edges:
                    if np.ptp(x) == 0:
                        continue
                    self._edges[j, sign] = _Edge(band_below(x), noise(x))
                edge = self._edges[j, sign]
                top, limit = float(x.max()), float(self._robot.limits.torque[j])
                if top > edge.top - edge.band:
                    self._near(edge, x, top, log, self._grain)
                if top > limit - 2 * edge.scatter:
                    at = x > limit - 2 * edge.scatter
                    edge.at_limit += int(at.sum())
                    edge.longest_at_limit = max(edge.longest_at_limit, _longest(at))

    @staticmethod
    def _near(edge: _Edge, x: Array, top: float, log: Log, grain: Array) -> None:
        hair = _HAIR * edge.band
        if top > edge.top:
            edge.top, edge.longest = top, 0 if top > edge.top + hair else edge.longest
        rows = np.flatnonzero(x > edge.top - edge.band)
        rows = rows[log.moves_at(rows, grain)]
        values, place = np.unique(np.concatenate([edge.values, x[rows]]), return_inverse=True)
        weights = np.concatenate([edge.counts, np.ones(len(rows), int)])
        counts = np.bincount(place, weights, len(values)).astype(int)
        kept = values > edge.top - edge.band
        values, counts = values[kept], counts[kept]
        edge.rest += int(counts[:-_VALUES].sum())
        edge.values, edge.counts = values[-_VALUES:], counts[-_VALUES:]
        at = rows[x[rows] > edge.top - hair]
        together = int(run_lengths(np.diff(at) == 1)[1].max(initial=0)) + 1
        edge.longest = max(edge.longest, together if len(at) else 0)

    def faults(self, joints: tuple[str, ...], unit: str, n: int) -> list[Fault]:
        """Saturated torques of a log of n rows."""
        found = []
        for (j, sign), edge in self._edges.items():
            at = edge.values > edge.top - _HAIR * edge.band
            below, count = int(edge.counts[~at].sum()) + edge.rest, int(edge.counts[at].sum())
            extreme = Extreme(sign * edge.top, count, edge.longest, below, edge.band)
            word = "largest" if sign > 0 else "smallest"
            fault = extreme_fault(joints[j], unit, n, len(joints), word, extreme)
            limit = float(self._robot.limits.torque[j])
            if fault is None and limit_is_near(unit, limit, edge.scatter, edge.top):
                fault = limit_fault(
                    joints[j], unit, n, sign * limit, edge.at_limit, edge.longest_at_limit
                )
            if fault is not None:
                found.append(fault)
        return found


def _longest(at: np.ndarray) -> int:
    return int(run_lengths(at)[1].max(initial=0)) if at.any() else 0
