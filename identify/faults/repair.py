"""Doing to a recording what its faults say, and only that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeVar, cast

import numpy as np

from excitant.exceptions import BadInput
from excitant.identify.faults.fault import Fault, Remedy
from excitant.identify.faults.log import CHANNELS, Raw
from excitant.identify.faults.outliers import unwrap

_ORDER = ("drop", "unwrap", "interpolate", "scale")
RawT = TypeVar("RawT", bound=Raw)


def repair(raw: RawT, faults: Sequence[Fault]) -> tuple[RawT, tuple[str, ...]]:
    """The recording with its repairable faults repaired, and what was done, a sentence each.

    Rows of remedies count rows of this recording. Values that are interpolated or rescaled keep
    their rows; rows are left out last, so that all remedies may name them.

    Args:
        raw: The recording as logged; a dataclass with arrays ``t``, ``q``, ``dq``, ``tau``.
        faults: What `find_faults` found in it.

    Raises:
        BadInput: The repairs leave no two samples.
    """
    values: dict[str, Any] = {"t": np.array(raw.t)}
    values |= {c: np.array(x) for c in CHANNELS if (x := getattr(raw, c)) is not None}
    remedies = [r for fault in faults for r in fault.remedies]
    kept = np.ones(len(values["t"]), bool)
    for remedy in sorted(remedies, key=lambda r: _ORDER.index(r.action)):
        if remedy.action == "drop":
            kept[remedy.rows] = False
        else:
            _apply(values, remedy, kept)
    if kept.sum() < 2:
        raise BadInput(f"repair leaves {int(kept.sum())} of {len(kept)} rows; record again")
    cut = {name: x[kept] for name, x in values.items()}
    if hasattr(raw, "extras"):
        extras = {k: np.asarray(x)[kept] for k, x in raw.extras.items()}
        cut["extras"] = extras
    notes = tuple(
        f"{fault.fault} ({', '.join(fault.joints)}): repaired, {_past(fault.repair)}"
        for fault in faults
        if fault.remedies and fault.repair
    )
    return cast(RawT, replace(cast(Any, raw), **cut)), notes


def _past(text: str) -> str:
    return f"which {text}"


def _apply(values: dict[str, Any], remedy: Remedy, kept: np.ndarray) -> None:
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
