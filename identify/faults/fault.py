"""Fault: what is wrong with a recording as a recording, its evidence, and its repair."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar, cast

import numpy as np

from excitant.exceptions import BadInput
from excitant.identify.faults.log import CHANNELS, Mask, Raw, Rows
from excitant.robots.motion import Array

FAULTS = (
    "dead_channel",
    "wrong_sign",
    "wrong_unit",
    "wrong_sample_rate",
    "duplicate_samples",
    "dropped_samples",
    "corrupt_rows",
    "saturation",
    "not_measured",
    "wrong_frame",
    "poor_excitation",
)
"""The vocabulary, the same in results, interface and documentation."""

_SHOWN = 10  # of many rows, in results
_ACTIONS = ("unwrap", "interpolate", "scale")
"""What changes values and not rows, in the order in which it is done."""
RawT = TypeVar("RawT", bound=Raw)


@dataclass(frozen=True, eq=False)
class Remedy:
    """What a repair does to the arrays.

    Attributes:
        action: ``drop`` rows, ``interpolate`` rows of a channel, ``scale`` a channel or the time,
            ``unwrap`` a counter, ``shift`` the time from a row on, ``sort`` all rows by time.
        channel: ``t``, ``q``, ``dq`` or ``tau``; empty for whole rows.
        joints: Columns concerned.
        rows: Rows concerned.
        factor: What values are multiplied with, the range of the counter, or what is added [s].
    """

    action: str
    channel: str = ""
    joints: tuple[int, ...] = ()
    rows: Rows = field(default_factory=lambda: np.zeros(0, np.intp))
    factor: float = 1.0


@dataclass(frozen=True, eq=False)
class Fault:
    """One fault of a recording.

    Attributes:
        fault: Its name, one of `FAULTS`.
        joints: Joints concerned; all of them when it concerns whole rows or the time.
        detail: The evidence in one sentence, with numbers.
        evidence: The same numbers by name.
        repair: What a repair would do; None when nothing can be done to the recording.
        remedies: The same for the machine.
    """

    fault: str
    joints: tuple[str, ...]
    detail: str
    evidence: Mapping[str, Any]
    repair: str | None = None
    remedies: tuple[Remedy, ...] = ()

    def entry(self) -> dict[str, Any]:
        """The fault under its JSON names; of many rows the first ten."""
        return {
            "fault": self.fault,
            "joints": list(self.joints),
            "detail": self.detail,
            "evidence": {name: _plain(value) for name, value in self.evidence.items()},
            "repair": self.repair,
        }

    def at(self, rows: Rows) -> Fault:
        """The fault with its rows counted in another log, of which these rows were seen."""
        evidence = dict(self.evidence)
        if "rows" in evidence:
            evidence["rows"] = rows[evidence["rows"]]
        remedies = tuple(replace(r, rows=rows[r.rows]) for r in self.remedies)
        return replace(self, evidence=evidence, remedies=remedies)


def dropped(
    joints: tuple[str, ...], rows: Rows, detail: str, fault: str = "corrupt_rows", **evidence: Any
) -> Fault:
    """A fault of rows that a repair leaves out."""
    return Fault(
        fault,
        joints,
        detail,
        {"rows": rows, "count": len(rows), **evidence},
        f"leaves these {len(rows)} rows out",
        (Remedy("drop", rows=rows),),
    )


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | list | tuple):
        return [_plain(v) for v in list(value)[:_SHOWN]]
    if isinstance(value, np.generic):
        value = value.item()
    return value if not isinstance(value, float) or np.isfinite(value) else None


def repair(raw: RawT, faults: Sequence[Fault]) -> tuple[RawT, tuple[str, ...]]:
    """The recording with its repairable faults repaired, and what was done, a sentence each.

    Rows of remedies count rows of this recording. Rows are sorted first, so that those beside each
    other are neighbours in time, and left out last, so that all remedies may name them.

    Args:
        raw: The recording as logged; a dataclass with arrays ``t``, ``q``, ``dq``, ``tau``.
        faults: What `find_faults` found in it.

    Raises:
        BadInput: The repairs leave no two samples.
    """
    remedies = [r for fault in faults for r in fault.remedies]
    t, order, kept = _arranged(raw.t, remedies)
    place = np.argsort(order)
    values: dict[str, Any] = {"t": t[order]}
    values |= {c: np.array(x[order]) for c in CHANNELS if (x := getattr(raw, c)) is not None}
    for action in _ACTIONS:
        for remedy in remedies:
            if remedy.action == action and remedy.channel in values:
                _apply(values, replace(remedy, rows=place[remedy.rows]), kept)
    if kept.sum() < 2:
        raise BadInput(f"repair leaves {int(kept.sum())} of {len(kept)} rows; record again")
    cut = {name: x[kept] for name, x in values.items()}
    if hasattr(raw, "extras"):
        cut["extras"] = {k: np.asarray(x)[order][kept] for k, x in raw.extras.items()}
    notes = tuple(
        f"{fault.fault} ({', '.join(fault.joints)}): repaired, which {fault.repair}"
        for fault in faults
        if fault.remedies and fault.repair
    )
    return cast(RawT, replace(cast(Any, raw), **cut)), notes


def left_rows(t: Array, faults: Sequence[Fault]) -> Rows:
    """Rows of a log that repairs leave, in the order that they bring them into.

    Args:
        t: Stamps as logged, shape (n,) [s].
        faults: What is to be repaired.
    """
    _, order, kept = _arranged(t, [r for fault in faults for r in fault.remedies])
    return order[kept]


def _arranged(t: Array, remedies: Sequence[Remedy]) -> tuple[Array, Rows, Mask]:
    """Time with its shifts, rows in the order asked for, and which of those are not left out."""
    t, kept = np.array(t), np.ones(len(t), bool)
    for remedy in remedies:
        if remedy.action == "shift":
            t[int(remedy.rows[0]) :] += remedy.factor
        elif remedy.action == "drop":
            kept[remedy.rows] = False
    by_time = any(remedy.action == "sort" for remedy in remedies)
    order = np.argsort(t, kind="stable") if by_time else np.arange(len(t))
    return t, order, kept[order]


def _apply(values: dict[str, Any], remedy: Remedy, kept: Mask) -> None:
    """Do what a remedy says to channels by name, in place; rows not kept do not count."""
    x = values[remedy.channel]
    if remedy.channel == "t":
        values["t"] = x[0] + (x - x[0]) * remedy.factor
        return
    for j in remedy.joints:
        if remedy.action == "scale":
            x[:, j] *= remedy.factor
        elif remedy.action == "unwrap":
            x[:, j] = unwrap(x[:, j], remedy.factor, remedy.channel == "q")
        else:
            good = kept & np.isfinite(x[:, j]) & np.isfinite(values["t"])
            good[remedy.rows] = False
            order = np.flatnonzero(good)
            x[remedy.rows, j] = np.interp(remedy.rows, order, x[order, j])


def unwrap(x: Array, size: float, position: bool) -> Array:
    """A channel without the jumps of its counter: continuous, or signed."""
    if position:
        return np.asarray(np.unwrap(x, period=size), float)
    return np.asarray(np.where(x > size / 2, x - size, x), float)
