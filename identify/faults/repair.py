"""Doing to a recording what its faults say, and only that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeVar, cast

import numpy as np
import numpy.typing as npt

from excitant.exceptions import BadInput
from excitant.identify.faults.counters import unwrap
from excitant.identify.faults.fault import Fault, Remedy, Rows
from excitant.identify.faults.log import CHANNELS, Raw
from excitant.robots.motion import Array

ACTIONS = ("unwrap", "interpolate", "scale")
"""What changes values and not rows, in the order in which it is done."""
RawT = TypeVar("RawT", bound=Raw)


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
    t, kept = _timed(raw.t, remedies)
    order = _in_order(t, remedies)
    place = np.argsort(order)
    values: dict[str, Any] = {"t": t[order]}
    values |= {c: np.array(x[order]) for c in CHANNELS if (x := getattr(raw, c)) is not None}
    kept = kept[order]
    for remedy in sorted((r for r in remedies if r.action in ACTIONS), key=_rank):
        apply(values, replace(remedy, rows=place[remedy.rows]), kept)
    if kept.sum() < 2:
        raise BadInput(f"repair leaves {int(kept.sum())} of {len(kept)} rows; record again")
    cut = {name: x[kept] for name, x in values.items()}
    if hasattr(raw, "extras"):
        extras = {k: np.asarray(x)[order][kept] for k, x in raw.extras.items()}
        cut["extras"] = extras
    notes = tuple(
        f"{fault.fault} ({', '.join(fault.joints)}): repaired, {_past(fault.repair)}"
        for fault in faults
        if fault.remedies and fault.repair
    )
    return cast(RawT, replace(cast(Any, raw), **cut)), notes


def left_rows(t: Array, remedies: Sequence[Remedy]) -> Rows:
    """Rows of a log that remedies leave, in the order that they bring them into.

    Args:
        t: Stamps as logged, shape (n,) [s].
        remedies: What is to be done.
    """
    t, kept = _timed(t, remedies)
    order = _in_order(t, remedies)
    return order[kept[order]]


def _timed(t: Array, remedies: Sequence[Remedy]) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Time with its shifts, and the rows that are not left out."""
    t, kept = np.array(t), np.ones(len(t), bool)
    for remedy in remedies:
        if remedy.action == "shift":
            t[int(remedy.rows[0]) :] += remedy.factor
        elif remedy.action == "drop":
            kept[remedy.rows] = False
    return t, kept


def _in_order(t: Array, remedies: Sequence[Remedy]) -> Rows:
    """Rows by time where that was asked for, else as they are."""
    if any(remedy.action == "sort" for remedy in remedies):
        return np.argsort(t, kind="stable")
    return np.arange(len(t))


def _rank(remedy: Remedy) -> int:
    return ACTIONS.index(remedy.action)


def _past(text: str) -> str:
    return f"which {text}"


def apply(values: dict[str, Any], remedy: Remedy, kept: np.ndarray) -> None:
    """Do what a remedy says to channels by name, in place; rows not kept do not count."""
    x = values.get(remedy.channel)
    if x is None:
        return
    if remedy.channel == "t":
        values["t"] = x[0] + (x - x[0]) * remedy.factor
        return
    for j in remedy.joints:
        if remedy.action == "scale":
            x[:, j] *= remedy.factor
        elif remedy.action == "unwrap":
            x[:, j] = unwrap(x[:, j], remedy.factor, remedy.channel == "q")
        else:
            good = kept.copy()
            good[remedy.rows] = False
            good &= np.isfinite(x[:, j]) & np.isfinite(values["t"])
            order = np.flatnonzero(good)
            x[remedy.rows, j] = np.interp(remedy.rows, order, x[order, j])
