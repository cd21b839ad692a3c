"""Two looks at one motion with independent noise: even and odd samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.interpolate

from excitant.exceptions import BadInput
from excitant.identify.differentiators import Differentiator, ZeroPhaseButterworth
from excitant.identify.preprocessing import POSITION_RATIO, Segment, prepare
from excitant.identify.recording import Recording
from excitant.identify.rows import FitRows, observation
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot

_RATE_SHARE = 0.2  # of the rate of all samples: 0.8 of what every second one can show


@dataclass(frozen=True)
class EverySecond:
    """A differentiator that sees every second sample, and speaks about all instants.

    Attributes:
        first: 0 for even samples, 1 for odd ones.
        inner: What differentiates; samples left out are interpolated by a quintic spline before.
    """

    first: int
    inner: Differentiator

    @property
    def name(self) -> str:
        """Name with its settings."""
        return f"{('even', 'odd')[self.first]} samples, {self.inner.name}"

    def delay(self, rate_hz: float) -> float:
        """That of the inner one [s]."""
        return self.inner.delay(rate_hz)

    def gain(self, f: Array, rate_hz: float, order: int = 1) -> Array:
        """That of the inner one: a quintic spline passes what half the samples can show."""
        return self.inner.gain(f, rate_hz, order)

    def noise_gain(self, rate_hz: float, order: int = 1) -> float:
        """√2 times that of the inner one: half the samples, twice the density."""
        return float(np.sqrt(2) * self.inner.noise_gain(rate_hz, order))

    def __call__(self, t: Array, q: Array) -> Motion:
        """Motion at all samples; q has shape (n, nv)."""
        seen = slice(self.first, None, 2)
        return self.inner(t, scipy.interpolate.make_interp_spline(t[seen], q[seen], k=5)(t))


def half_columns(
    robot: Robot,
    rows: FitRows,
    recordings: Sequence[Recording],
    position_hz: float | None = None,
) -> tuple[Array, Array]:
    """Base columns from even and from odd samples at the rows of a fit, each (n, nv, r).

    Their errors are independent where the noise of a position sensor is so from sample to sample
    at regular time: not for a sensor that low-passes before it logs, nor for errors that depend
    on the position (scale, eccentricity), for which every sample is wrong alike.

    Args:
        robot: The arm.
        rows: What is fitted.
        recordings: Behind these rows, in order.
        position_hz: Cut-off of the filter of positions [Hz]; as for the rows when None, or where
            that is lower.

    Raises:
        BadInput: A rate below five times the cut-off.
    """
    cutoff_hz = rows.data.cutoff_hz
    even, odd = (
        observation(robot, rows.effects, _segments(recordings, cutoff_hz, first, position_hz))
        for first in (0, 1)
    )
    columns = list(rows.base.columns)
    return even[:, :, columns], odd[:, :, columns]


def _segments(
    recordings: Sequence[Recording], cutoff_hz: float, first: int, position_hz: float | None
) -> list[Segment]:
    found = []
    for recording in recordings:
        rate_hz = 1 / float(np.median(np.diff(recording.t)))
        highest = _RATE_SHARE * rate_hz
        if cutoff_hz > highest * (1 + 1e-6):
            raise BadInput(
                f"{recording.name}: every second sample at {rate_hz:.4g} Hz does not show motion "
                f"up to the cut-off of {cutoff_hz:g} Hz; choose one up to {highest:.3g} Hz"
            )
        widest = POSITION_RATIO * cutoff_hz
        position_cutoff = min(widest, highest, position_hz or widest)
        half = EverySecond(first, ZeroPhaseButterworth(position_cutoff))
        found += prepare(recording, cutoff_hz, half)
    return found
