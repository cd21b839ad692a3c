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
    digests = {}
    for name, raw in recordings.items():
        digest = Digest()
        digest.take(raw)
        digests[name] = digest
    return same_digests(digests)


class Digest:
    """What two recordings with the same values share, taken piece by piece.

    Attributes:
        rows: Rows taken in.
    """

    def __init__(self) -> None:
        self.rows = 0
        self._made = {name: hashlib.sha256() for name in CHANNELS}

    def take(self, piece: Raw) -> None:
        """Take in the next rows."""
        self.rows += len(piece.t)
        for name, made in self._made.items():
            x = getattr(piece, name)
            if x is not None:
                made.update(np.ascontiguousarray(x, dtype=float).tobytes())

    @property
    def key(self) -> str:
        """Equal for equal values."""
        return "".join(made.hexdigest() for made in self._made.values())


def same_digests(digests: Mapping[str, Digest]) -> dict[str, Fault]:
    """The fault of each recording that is a copy of an earlier one, by its name."""
    first: dict[str, str] = {}
    found = {}
    for name, digest in digests.items():
        if digest.key not in first:
            first[digest.key] = name
            continue
        found[name] = Fault(
            "duplicate_samples",
            (),
            f"{name} holds the same {digest.rows} rows as {first[digest.key]}: all positions, "
            "velocities and torques are equal, so it adds no evidence and is no hold-out",
            {"same_as": first[digest.key], "count": digest.rows},
        )
    return found
