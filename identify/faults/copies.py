"""The same recording under two names."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

import numpy as np

from excitant.identify.faults.fault import Fault
from excitant.identify.faults.log import CHANNELS, Raw


def find_copies(recordings: Mapping[str, Raw]) -> dict[str, Fault]:
    """Recordings whose values are all those of an earlier one, whatever their time starts at.

    Args:
        recordings: By name.

    Returns:
        The fault of each copy, by its name.
    """
    first: dict[str, str] = {}
    found = {}
    for name, raw in recordings.items():
        key = _digest(raw)
        if key not in first:
            first[key] = name
            continue
        found[name] = Fault(
            "duplicate_samples",
            (),
            f"{name} holds the same {len(raw.t)} rows as {first[key]}: all positions, velocities "
            f"and torques are equal, so it adds no evidence and is no hold-out",
            {"same_as": first[key], "count": len(raw.t)},
        )
    return found


def _digest(raw: Raw) -> str:
    made = hashlib.sha256()
    for name in CHANNELS:
        x = getattr(raw, name)
        if x is not None:
            made.update(name.encode())
            made.update(np.ascontiguousarray(x, dtype=float).tobytes())
    return made.hexdigest()
