"""From a recording to rows of the identification problem.

Positions pass a zero-phase Butterworth filter and are differentiated through a quintic spline.
Every column of the regressor and the torque then pass one and the same zero-phase filter
("parallel filtering", Gautier 1997), friction columns too, and are decimated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.interpolate

from excitant.exceptions import BadInput, BadRecording
from excitant.identify.differentiators import Differentiator, ZeroPhaseButterworth, low_pass
from excitant.identify.recording import MINIMUM_DURATION, Recording
from excitant.robots.motion import Array, Motion, freeze

CUTOFF_HZ = 10.0  # above the motions of arms, below their structural resonances
POSITION_RATIO = 2.0  # positions keep what the torque filter will judge
_NYQUIST_SHARE = 0.8
_GAP_STEPS, _GAP_TIME = 3.0, 0.05  # a gap is longer than both [median steps, s]


@dataclass(frozen=True, eq=False)
class Segment:
    """An uninterrupted part of a recording at a regular rate, ready for the regressor.

    Attributes:
        name: Name of the recording.
        motion: Filtered motion at the full rate, n instants.
        tau: Filtered torque, shape (n, nv).
        tau_raw: Unfiltered torque at the same instants, shape (n, nv).
        cutoff_hz: Cut-off of the torque filter [Hz].
        keep: Instants that become rows: edges of the filter left out, decimated.
    """

    name: str
    motion: Motion
    tau: Array
    tau_raw: Array
    cutoff_hz: float
    keep: slice

    def __post_init__(self) -> None:
        freeze(self, "tau", "tau_raw")

    @property
    def rate_hz(self) -> float:
        """Sampling rate of the motion [Hz]."""
        return float(1 / (self.motion.t[1] - self.motion.t[0]))

    def filtered(self, values: Array) -> Array:
        """Pass columns, shape (n, ...), through the torque filter."""
        return low_pass(values, self.cutoff_hz, self.rate_hz)

    def rows(self, columns: Callable[[Motion], Array]) -> Array:
        """Filtered and decimated columns of the motion, shape (rows, ...)."""
        return self.filtered(columns(self.motion))[self.keep]

    @property
    def t(self) -> Array:
        """Times of the rows [s]."""
        return self.motion.t[self.keep]


def prepare(
    recording: Recording,
    cutoff_hz: float | None = None,
    differentiator: Differentiator | None = None,
) -> list[Segment]:
    """Segments of a recording, split at gaps, filtered and differentiated.

    Args:
        recording: What was logged.
        cutoff_hz: Cut-off of the torque filter; 10 Hz, or 0.4 times the sampling rate when
            that is lower.
        differentiator: From positions to the motion, in place of the Butterworth filter with
            a quintic spline; it must have no delay.

    Raises:
        BadRecording: The cut-off is not below half the sampling rate, or no uninterrupted
            part is long enough.
    """
    step = float(np.median(np.diff(recording.t)))
    if cutoff_hz is None:
        cutoff_hz = min(CUTOFF_HZ, 0.5 * _NYQUIST_SHARE / step)
    if not 0 < cutoff_hz <= 0.5 * _NYQUIST_SHARE / step * (1 + 1e-9):
        raise BadRecording(
            recording.file,
            f"cut-off {cutoff_hz:g} Hz does not fit its rate of {1 / step:.4g} Hz; "
            f"choose one up to {0.5 * _NYQUIST_SHARE / step:.3g} Hz",
        )
    parts = uninterrupted(recording.t)
    segments = [
        _segment(recording, part, cutoff_hz, differentiator)
        for part in parts
        if len(part) > 20 and recording.t[part[-1]] - recording.t[part[0]] >= MINIMUM_DURATION
    ]
    if not segments:
        raise BadRecording(recording.file, _too_short(recording, parts), column="t")
    return segments


def uninterrupted(t: Array) -> list[npt.NDArray[np.intp]]:
    """Indices of the parts of a time series, shape (n,) [s], between its gaps."""
    steps = np.diff(t)
    breaks = np.flatnonzero(steps > max(_GAP_STEPS * float(np.median(steps)), _GAP_TIME)) + 1
    return np.split(np.arange(len(t)), breaks)


def resampled(recording: Recording, part: npt.NDArray[np.intp]) -> tuple[Array, Array, Array]:
    """Time, positions and torque of a part at a regular rate, the median of the recording's."""
    t = recording.t[part]
    grid = np.arange(t[0], t[-1] + 1e-9, float(np.median(np.diff(recording.t))))
    q = scipy.interpolate.make_interp_spline(t, recording.q[part], k=3)(grid)
    tau = [np.interp(grid, t, column) for column in recording.tau[part].T]
    return grid, q, np.column_stack(tau)


def _too_short(recording: Recording, parts: Sequence[npt.NDArray[np.intp]]) -> str:
    needed = f"{MINIMUM_DURATION:g} s without interruption are needed"
    if len(parts) > 1:
        first = recording.t[parts[0][-1]]
        return f"time jumps {len(parts) - 1} times, first after {first:.4g} s; {needed}"
    return (
        f"'{recording.name}' lasts {recording.duration:.3g} s; {needed}: "
        "record longer or name a hold-out of its own"
    )


def _segment(
    recording: Recording,
    part: npt.NDArray[np.intp],
    cutoff_hz: float,
    differentiator: Differentiator | None,
) -> Segment:
    grid, q, tau = resampled(recording, part)
    step = float(np.median(np.diff(recording.t)))
    if differentiator is None:
        position_cutoff = min(POSITION_RATIO * cutoff_hz, 0.5 * _NYQUIST_SHARE / step)
        differentiator = ZeroPhaseButterworth(position_cutoff)
    elif differentiator.delay(1 / step) > 0:
        raise BadInput(f"{differentiator.name}: a causal one is for loops; give one without delay")
    motion = differentiator(grid, q)
    edge = round(1 / (cutoff_hz * step))
    stride = max(1, int(1 / (4 * cutoff_hz * step)))
    return Segment(
        name=recording.name,
        motion=motion,
        tau=low_pass(tau, cutoff_hz, 1 / step),
        tau_raw=tau,
        cutoff_hz=cutoff_hz,
        keep=slice(edge, len(grid) - edge, stride),
    )
