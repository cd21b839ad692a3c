"""Mending: what repairs do to a log, done to its pieces as they come."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from excitant.exceptions import BadRecording
from excitant.identify.faults.fault import Fault, Remedy, Rows
from excitant.identify.faults.log import CHANNELS
from excitant.identify.faults.order import order_of, row_keys
from excitant.identify.faults.repair import ACTIONS, apply
from excitant.identify.faults.stamps import backward_faults, repeated_fault, untimed_fault
from excitant.identify.importers.raw import RawRecording
from excitant.robots.motion import Array

_GRID = 1000  # rows from one known time of all that is still to come to the next
_MOST_HELD = 500_000  # rows that wait for earlier ones


def time_faults(
    t: Array, pieces: Iterable[RawRecording], joints: tuple[str, ...]
) -> tuple[Fault, ...]:
    """Faults of the stamps of a log: no numbers, repeated, going back.

    Args:
        t: Time of all rows, shape (n,) [s].
        pieces: The log, read only where time does not rise.
        joints: All joints.
    """
    rows = np.flatnonzero(np.isfinite(t))
    if len(rows) == len(t) and (np.diff(t) > 0).all():
        return ()
    keys, ways, weights = [], [], np.sqrt(np.arange(2.0, 2.0 + len(joints)))
    for raw in pieces:
        keys.append(row_keys([x for x in (raw.q, raw.dq, raw.tau) if x is not None]))
        ways.append(raw.q @ weights)
    key, way = np.concatenate(keys), np.concatenate(ways)[:, None]
    order = order_of(t, key, way)
    still = np.flatnonzero(np.diff(t[rows]) == 0)
    same = int((key[rows[still]] == key[rows[still + 1]]).sum())
    again = np.union1d(rows[still + 1], order.again)
    found = [untimed_fault(joints, len(t), np.flatnonzero(~np.isfinite(t)))]
    if len(again):
        found.append(repeated_fault(joints, len(t), again, same, order.again, float(t[again[0]])))
    return (*(f for f in found if f is not None), *backward_faults(joints, t, order))


class Mending:
    """Repairs of a log.

    Args:
        faults: What is repaired; rows of remedies count rows of the log.
        t: Time of all rows, needed where rows are sorted [s].
        file: The log, for refusals.

    Raises:
        BadRecording: Rows so far out of order that too many would wait for earlier ones.
    """

    def __init__(self, faults: Sequence[Fault], t: Array | None = None, file: str = "") -> None:
        remedies = [remedy for fault in faults for remedy in fault.remedies]
        dropped = [r.rows for r in remedies if r.action == "drop"]
        self._dropped = np.unique(np.concatenate([np.zeros(0, np.intp), *dropped]))
        self._shifts = [(int(r.rows[0]), r.factor) for r in remedies if r.action == "shift"]
        changes = [r for r in remedies if r.action in ACTIONS and r.channel != "t"]
        self._changes = sorted(changes, key=lambda r: ACTIONS.index(r.action))
        self.pace = float(np.prod([r.factor for r in remedies if (r.action, r.channel) ==
                                   ("scale", "t")]))  # fmt: skip
        self._floor: Array | None = None
        if t is not None and any(r.action == "sort" for r in remedies):
            self._floor = self._floors(t, file)

    def _floors(self, t: Array, file: str) -> Array:
        """Earliest time from every thousandth row on."""
        t = self._shifted(t, np.arange(len(t)))
        t[self._dropped] = np.nan
        order = np.argsort(t[np.isfinite(t)], kind="stable")
        if len(order) and np.abs(order - np.arange(len(order))).max() > _MOST_HELD:
            raise BadRecording(
                file, f"rows are more than {_MOST_HELD} rows away from where their time puts them, "
                "too far for a log that is read piece by piece; sort the file by time first",
                column="t",
            )  # fmt: skip
        lowest = np.fmin.reduceat(t, np.arange(0, len(t), _GRID))
        return np.asarray(np.fmin.accumulate(lowest[::-1])[::-1], float)

    def _shifted(self, t: Array, rows: Rows) -> Array:
        t = np.array(t)
        for start, shift in self._shifts:
            t[rows >= start] += shift
        return t

    def pieces(self, raws: Iterable[RawRecording]) -> Iterator[tuple[RawRecording, Rows]]:
        """Mended pieces in the order of time, and the rows of the log that they are."""
        last: dict[int, Array] = {}
        for raw, rows in self._in_order(raws):
            values: dict[str, Any] = {"t": self.pace * raw.t}
            values |= {c: np.array(x) for c in CHANNELS if (x := getattr(raw, c)) is not None}
            kept = np.ones(len(rows), bool)
            for k, change in enumerate(self._changes):
                local = replace(change, rows=np.flatnonzero(np.isin(rows, change.rows)))
                if change.action != "interpolate" or len(local.rows):
                    apply(values, local, kept)
                if change.action == "unwrap" and change.channel == "q":
                    last[k] = _continued(values["q"], change, last.get(k))
            yield replace(raw, **values), rows

    def _in_order(self, raws: Iterable[RawRecording]) -> Iterator[tuple[RawRecording, Rows]]:
        """Pieces without rows that are left out, shifted and sorted."""
        waiting: tuple[RawRecording, Rows] | None = None
        count = 0
        for raw in raws:
            rows = np.arange(count, count + len(raw.t))
            count += len(rows)
            kept = np.flatnonzero(~np.isin(rows, self._dropped, assume_unique=True))
            piece = _taken(replace(raw, t=self._shifted(raw.t, rows)), kept), rows[kept]
            if self._floor is None:
                if len(kept):
                    yield piece
                continue
            piece = piece if waiting is None else _joined(waiting, piece)
            done = piece[0].t < self._floor[min(count // _GRID, len(self._floor) - 1)]
            yield from _by_time(piece, np.flatnonzero(done))
            rest = np.flatnonzero(~done)
            waiting = _taken(piece[0], rest), piece[1][rest]
        if waiting is not None:
            yield from _by_time(waiting, np.arange(len(waiting[1])))


def _by_time(piece: tuple[RawRecording, Rows], chosen: Rows) -> Iterator[tuple[RawRecording, Rows]]:
    """Some rows of a piece, sorted; nothing where there are none."""
    if len(chosen):
        order = chosen[np.argsort(piece[0].t[chosen], kind="stable")]
        yield _taken(piece[0], order), piece[1][order]


def _taken(raw: RawRecording, rows: Rows) -> RawRecording:
    dq = None if raw.dq is None else raw.dq[rows]
    return replace(raw, t=raw.t[rows], q=raw.q[rows], tau=raw.tau[rows], dq=dq, extras={})


def _joined(
    one: tuple[RawRecording, Rows], other: tuple[RawRecording, Rows]
) -> tuple[RawRecording, Rows]:
    (a, rows), (b, more) = one, other
    parts: dict[str, Any] = {
        c: np.concatenate([getattr(a, c), getattr(b, c)]) for c in ("t", "q", "tau")
    }
    dq = None if a.dq is None or b.dq is None else np.concatenate([a.dq, b.dq])
    return replace(b, **parts, dq=dq), np.concatenate([rows, more])


def _continued(q: Array, change: Remedy, last: Array | None) -> Array:
    """Positions by whole turns of a counter, so that they go on where the last piece ended."""
    joints = list(change.joints)
    if last is not None:
        q[:, joints] -= change.factor * np.round((q[0, joints] - last) / change.factor)
    return np.array(q[-1, joints])
