"""How well a model predicts the torque of a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from excitant.identify.preprocessing import Segment
from excitant.robots.motion import Array, read_only
from excitant.robots.robot import Robot
from excitant.robots.torque import torque


@dataclass(frozen=True, eq=False)
class Accuracy:
    """Prediction errors per joint, each of shape (nv,).

    Attributes:
        rms: Root mean square of measured − predicted, both filtered [torque unit].
        rms_raw: The same with the measured torque unfiltered [torque unit].
        nrmse: rms / standard deviation of the filtered measured torque.
        r2: 1 − nrmse².
    """

    rms: Array
    rms_raw: Array
    nrmse: Array
    r2: Array

    def entry(self, joint: int) -> dict[str, Any]:
        """Figures of one joint under their JSON names."""
        return {
            name: float(getattr(self, name)[joint]) for name in ("rms", "rms_raw", "nrmse", "r2")
        }


@dataclass(frozen=True, eq=False)
class Series:
    """Rows of the hold-out (or of the fit): time, measured torque filtered and raw.

    Attributes:
        t: Time; parts follow each other without gaps, shape (n,) [s].
        measured: Filtered torque, shape (n, nv) [torque unit].
        raw: Unfiltered torque at the same instants, shape (n, nv) [torque unit].
    """

    t: Array
    measured: Array
    raw: Array

    def accuracy(self, predicted: Array) -> Accuracy:
        """Accuracy of a prediction at these rows, shape (n, nv)."""
        rms = np.sqrt(np.mean((self.measured - predicted) ** 2, axis=0))
        raw = np.sqrt(np.mean((self.raw - predicted) ** 2, axis=0))
        spread = self.measured.std(axis=0)
        nrmse = np.divide(rms, spread, out=np.full_like(rms, np.nan), where=spread > 0)
        return Accuracy(*(read_only(v) for v in (rms, raw, nrmse, 1 - nrmse**2)))


def series(segments: Sequence[Segment]) -> Series:
    """Rows of all segments, one after the other."""
    times, start = [], 0.0
    for segment in segments:
        times.append(segment.t - segment.t[0] + start)
        start = times[-1][-1] + (segment.t[1] - segment.t[0])
    return Series(
        read_only(np.concatenate(times)),
        read_only(np.concatenate([s.tau[s.keep] for s in segments])),
        read_only(np.concatenate([s.tau_raw[s.keep] for s in segments])),
    )


def predicted_torque(robot: Robot, segments: Sequence[Segment]) -> Array:
    """Torque of the robot with its effects at the rows, filtered alike, shape (n, nv) [N·m]."""
    return np.concatenate([s.rows(lambda motion: torque(robot, motion)) for s in segments])
