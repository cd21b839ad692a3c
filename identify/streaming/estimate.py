"""StreamedEstimate: an estimate with what was found in logs that were never in memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from excitant.identify.cutoff_sensitivity import Sensitivity, sensitivity
from excitant.identify.estimate import Estimate
from excitant.identify.faults.fault import Fault


@dataclass(frozen=True, eq=False)
class StreamedEstimate(Estimate):
    """What was identified from logs of any length.

    Attributes:
        faults: What was found in each log to be fitted, by its name.
        share: Share of the fitted rows that the study of cut-offs saw.
    """

    faults: Mapping[str, tuple[Fault, ...]] = field(default_factory=dict)
    share: float = 1.0

    def fault_entries(self) -> list[dict[str, Any]]:
        """The faults under their JSON names, each with its recording."""
        return [
            {"recording": name, **fault.entry()}
            for name, faults in self.faults.items()
            for fault in faults
        ]

    @cached_property
    def sensitivity(self) -> Sensitivity | None:
        """How a fit of the excerpts depends on the cut-off, in its own standard deviations."""
        if self.study is None:
            return None
        std = np.sqrt(np.diag(self.least_squares.covariance) / self.share)
        return sensitivity(self.study, self.holdout_columns, self.series, std)
