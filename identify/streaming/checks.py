"""Faults of a log that is never in memory as a whole.

What needs every row (missing and repeated ones, gaps, outliers, dead and saturated channels) is
counted piece by piece, with the tests of `excitant.identify.faults` and what a false alarm may
cost shared out among the pieces, however many there are. What needs motion (units, signs, rates,
frames, torque that is no measurement, held and wrapped channels) is looked for in an excerpt: the
first piece in which as many joints move as in any.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from excitant.identify.faults.copies import Digest
from excitant.identify.faults.counters import wrapped_counters, wrapped_fault
from excitant.identify.faults.fault import ALARM, Fault, Remedy, Rows
from excitant.identify.faults.find import motion_faults
from excitant.identify.faults.log import Log, Raw, log_of, noise, quantum
from excitant.identify.faults.outliers import (
    Worst,
    apart,
    missing_fault,
    missing_in,
    outlying,
    rows_fault,
    values_fault,
    worst,
)
from excitant.identify.faults.repair import repair
from excitant.identify.faults.repeats import (
    held_channels,
    jumps_fault,
    jumps_in,
    repeats_fault,
    repeats_in,
)
from excitant.identify.recording import Recording
from excitant.identify.streaming.tallies import Extremes, Gaps, Lives, RowTally
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

_SHORTEST = 50  # rows: fewer prove nothing
_MOVES = 50.0  # resolutions over which a joint moves
_CALM = 6.0  # upper quartiles of fourth differences: white noise never is so far off
_THINNED = 16  # rows, of which one tells how large differences usually are
_SUDDEN = 100.0  # mean squares of a change of speed: white noise never is so large
_WIDER = 1.5  # times the way of the excerpt: the rest of the log then shows more than it


class Checks:
    """Faults of a log, piece by piece.

    Args:
        robot: The arm.
        excerpt: Rows in which most joints move; sought among the pieces when None.
        compared: Whether other logs may be copies of it.

    Attributes:
        excerpt: Rows without faults in which most joints move; None before there are any.
        digest: What other logs are compared by; None where that is not asked for.
    """

    def __init__(self, robot: Robot, *, excerpt: Raw | None = None, compared: bool = False) -> None:
        self.digest = Digest() if compared else None
        self._robot, self._n, self._pieces, self._unit = robot, 0, 0, "N·m"
        self.excerpt: Log | None = None
        self._best = -1
        if excerpt is not None:
            alone = Checks(robot)
            alone.take(excerpt)
            self.excerpt, self._best = alone.excerpt, robot.nv
        self._quantum: Array | None = None
        self._gaps, self._lives, self._extremes = Gaps(), Lives(), Extremes(robot)
        self._missing, self._repeated, self._jumps, self._whole = (RowTally() for _ in range(4))
        self._without: set[int] = set()
        self._places, self._longest, self._ratios = 0, 0, list[Array]()
        self._wrapped: dict[tuple[str, int], tuple[float, int, int]] = {}
        self._single: dict[tuple[str, int], RowTally] = {}
        self._worst: dict[tuple[str, int], Worst] = {}

    def watch(self, pieces: Iterable[tuple[Raw, Rows]]) -> Iterator[Array]:
        """Check pieces in the order of time and pass on their stamps, shape (n,) [s].

        Args:
            pieces: Pieces and the rows of the log that they are.
        """
        for piece, rows in pieces:
            self.take(piece, rows)
            yield piece.t

    def passing(self, pieces: Iterable[Recording]) -> Iterator[Recording]:
        """Check pieces on their way."""
        for piece in pieces:
            self.take(piece)
            yield piece

    def take(self, piece: Raw, rows: Rows | None = None) -> None:
        """Check one piece."""
        if self.digest is not None:
            self.digest.take(piece)
        log = _by_columns(log_of(piece, self._robot.joints))
        rows = self._n + np.arange(len(log)) if rows is None else rows
        self._n, self._unit = self._n + len(log), log.unit
        bad, joints = missing_in(log)
        if len(bad):
            self._missing.take(rows[bad], log.t[bad])
            self._without |= set(joints.tolist())
            log, rows = log.take(np.delete(np.arange(len(log)), bad)), np.delete(rows, bad)
        self._gaps.take(log.t, rows)
        if len(log) < _SHORTEST:
            return
        self._pieces += 1
        alarm = ALARM / (self._pieces * (self._pieces + 1))  # all of them together: ALARM
        log = self._without_bad_rows(log, rows, alarm)
        self._lives.take(log, alarm)
        self._extremes.take(log)
        if self._best < log.nv:
            moving = moving_joints(log.q)
            if moving > self._best:
                self.excerpt, self._best = log, moving

    def _without_bad_rows(self, log: Log, rows: Rows, alarm: float) -> Log:
        """The piece as repairs would leave it; what is wrong with it is taken down."""
        repeats, places, longest = repeats_in(log)
        self._repeated.take(rows[repeats], log.t[repeats])
        self._places, self._longest = self._places + places, max(self._longest, longest)
        if len(repeats):
            log, rows = log.take(np.delete(np.arange(len(log)), repeats)), np.delete(rows, repeats)
        log = self._unwrapped(log)
        jumps: Rows | None = None
        self._quantum = log.quantum if self._quantum is None else self._quantum
        if _sudden(log.q, self._quantum):
            jumps, m = jumps_in(log, alarm)
            self._jumps.take(rows[jumps], log.t[jumps])
            self._ratios.append(m)
        whole, single = apart({} if _calm(log) else outlying(log, jumps, alarm), log)
        self._whole.take(rows[whole], log.t[whole])
        remedies = [Remedy("drop", rows=whole)]
        for (name, j), own in single.items():
            self._single.setdefault((name, j), RowTally()).take(rows[own], log.t[own])
            found = worst(log, name, j, own)
            found = Worst(name, int(rows[found.row]), found.t, found.value, found.around)
            before = self._worst.get((name, j), found)
            self._worst[name, j] = max(before, found, key=lambda one: one.distance)
            remedies.append(Remedy("interpolate", name, (j,), own))
        if not len(whole) and not single:
            return log
        return repair(log, [Fault("corrupt_rows", log.joints, "", {}, "", tuple(remedies))])[0]

    def _unwrapped(self, log: Log) -> Log:
        """The piece with counters unwrapped, those of earlier pieces too."""
        found = wrapped_counters(log)
        for fault in found:
            (remedy,) = fault.remedies
            key, more = (remedy.channel, remedy.joints[0]), fault.evidence
            _, jumps, high = self._wrapped.get(key, (0.0, 0, 0))
            self._wrapped[key] = remedy.factor, jumps + more["jumps"], high + more["count"]
        seen = {(r.channel, r.joints[0]) for fault in found for r in fault.remedies}
        further = [
            Remedy("unwrap", name, (j,), factor=size)
            for (name, j), (size, _, _) in self._wrapped.items()
            if name != "q" and (name, j) not in seen
        ]
        if not found and not further:
            return log
        known = Fault("corrupt_rows", log.joints, "", {}, "", tuple(further))
        return repair(log, [*found, known])[0]

    @property
    def extremes_of_torque(self) -> Array:
        """Lowest and highest torque of each joint, shape (2, nv)."""
        return self._lives.span("tau")

    def faults(self, rows: int | None = None) -> tuple[Fault, ...]:
        """All faults of a log of so many rows; of those that were checked when None."""
        n, joints = rows or self._n, self._robot.joints
        found = self._gaps.faults(joints, n)
        if len(self._missing.rows):
            names = tuple(joints[j] for j in sorted(self._without))
            found.append(missing_fault(names, n, self._missing.rows, self._missing.first))
        repeated = repeats_fault(
            joints, n, self._repeated.rows, self._places, self._longest, self._repeated.first
        )
        found += [] if repeated is None else [repeated]
        for (name, j), (size, jumps, high) in self._wrapped.items():
            found.append(wrapped_fault(joints[j], j, name, n, size, jumps, high))
        found += [] if self.excerpt is None else held_channels(self.excerpt)
        if len(self._jumps.rows):
            m = np.concatenate(self._ratios)
            found.append(jumps_fault(joints, self._jumps.rows, m, self._jumps.first))
        if len(self._whole.rows):
            found.append(rows_fault(joints, n, self._whole.rows, self._whole.first))
        for (name, j), tally in self._single.items():
            found.append(values_fault(joints[j], j, n, tally.rows, self._worst[name, j]))
        channels = self._lives.faults(joints) + self._extremes.faults(joints, self._unit, n)
        found += channels
        if self.excerpt is not None:
            moved = motion_faults(self._robot, self.excerpt, channels)
            found += [fault for fault in moved if self._of_all(fault)]
        return tuple(found)

    def _of_all(self, fault: Fault) -> bool:
        """Whether what the excerpt lacks is lacking in the rest of the log too."""
        if fault.fault != "poor_excitation" or self.excerpt is None:
            return True
        low, high = self._lives.span("q")
        least = np.maximum(np.ptp(self.excerpt.q, axis=0), _MOVES * _grain(self.excerpt.q))
        return bool((high - low <= _WIDER * least).all())


def moving_joints(q: Array) -> int:
    """How many joints move at positions, shape (n, nv)."""
    return int((np.ptp(q, axis=0) > _MOVES * _grain(q)).sum()) if len(q) else 0


def _grain(q: Array) -> Array:
    """Noise or step of positions, whichever is larger, shape (nv,)."""
    return np.array([max(noise(column), quantum(column)) for column in q.T])


def _by_columns(log: Log) -> Log:
    """The same log with columns that lie together in memory, over which tests run faster."""
    turned: dict[str, Any] = {name: np.asfortranarray(x) for name, x in log.channels()}
    for x in turned.values():
        x.setflags(write=False)  # it need not be copied again
    return replace(log, **turned)


def _calm(log: Log) -> bool:
    """Whether no value is far from its neighbours; other pieces are looked at closely."""
    for _, x in log.channels():
        size = np.abs(6 * x[2:-2] - 4 * (x[1:-3] + x[3:-1]) + x[:-4] + x[4:])
        if (size.max(axis=0) > _CALM * np.quantile(size[::_THINNED], 0.75, axis=0)).any():
            return False
    return True


def _sudden(q: Array, quantum: Array) -> bool:
    """Whether positions, shape (n, nv), jump somewhere as if samples were missing there."""
    way = np.diff(q, axis=0)
    change = way[2:-2] - (way[4:] + way[:-4]) / 2
    scale = np.median(np.abs(change[::_THINNED]), axis=0) / 0.6745 + quantum / 2
    used = scale > 0
    change = change[:, used] / scale[used]
    return bool((np.einsum("nj,nj->n", change, change) > _SUDDEN).any())
