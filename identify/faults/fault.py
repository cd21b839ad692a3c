"""Fault: what is wrong with a recording as a recording, with its evidence and its remedy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

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

FALSE_ALARMS = 0.02
"""Share of faultless recordings in which all tests together may raise a fault."""
ALARM = FALSE_ALARMS / 20
"""Share that one family of tests may raise; there are fewer than twenty of them."""

Rows = npt.NDArray[np.intp]
_SHOWN = 10


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


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | list | tuple):
        return [_plain(v) for v in list(value)[:_SHOWN]]
    if isinstance(value, np.generic):
        value = value.item()
    return value if not isinstance(value, float) or np.isfinite(value) else None
