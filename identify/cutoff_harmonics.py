"""Known harmonics: how far the motion's own torque goes, and no cut-off of a fit should reach.

A periodic excitation has its harmonics and nothing above them. They are known where the trajectory
is, or where the recording repeats: those that hold the velocity of the mean period (its
acceleration is mostly noise where encoders are coarse). Torque goes twice as far, because
centrifugal and Coriolis torque is a product of two speeds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.fft

from excitant.exceptions import BadInput, BadRecording
from excitant.identify.estimators.unfiltered import unfiltered_positions, with_recordings
from excitant.identify.periods import Periods, periods_of
from excitant.identify.preprocessing import Segment
from excitant.identify.recording import Recording
from excitant.robots.motion import Array, freeze

PRODUCTS = 2.0  # times the highest harmonic of the motion: that of centrifugal torque
_HELD = 0.99  # of the velocity's power, by the harmonics of a motion that repeats
_STILL = 1e-6  # of the largest velocity: a joint that does not move
_SAMPLES = 100_000  # of the recordings together, above which looking for a period takes long


@dataclass(frozen=True, eq=False)
class Harmonics:
    """How far a motion's harmonics go.

    Attributes:
        highest_hz: Highest harmonic of each joint, 0 for one that rests, shape (nv,) [Hz].
        source: How that is known, in words.
    """

    highest_hz: Array
    source: str

    def __post_init__(self) -> None:
        freeze(self, "highest_hz")

    @property
    def torque_hz(self) -> Array:
        """How far the torque goes that the bodies need, shape (nv,) [Hz]."""
        return np.asarray(PRODUCTS * self.highest_hz, float)

    def sentence(self, joints: Sequence[str], judge_hz: float) -> str:
        """What follows for the cut-offs."""
        each = ", ".join(f"{j} {f:.3g} Hz" for j, f in zip(joints, self.highest_hz, strict=True))
        start = f"known harmonics ({self.source}): up to {each}"
        if (self.torque_hz > judge_hz).any():
            return (
                f"{start}; a cut-off of {judge_hz:.3g} Hz takes part of their torque away, so that "
                f"no lower one is tried there; with --cutoff {self.torque_hz.max():.3g} it stays"
            )
        return f"{start}; no cut-off below {PRODUCTS:g} times these is tried"


def planned_harmonics(highest_hz: float | Array, nv: int) -> Harmonics:
    """Harmonics of a motion that was planned.

    Args:
        highest_hz: Number of harmonics over the period, for all joints or shape (nv,) [Hz].
        nv: Number of joints.

    Raises:
        BadInput: Frequencies that cannot be, or of another number of joints.
    """
    each = np.asarray(highest_hz, float)
    if each.shape not in ((), (nv,)) or not (np.isfinite(each) & (each >= 0)).all():
        raise BadInput(
            f"highest harmonic: {highest_hz}; give one frequency in Hz, or one for each of "
            f"{nv} joints"
        )
    return Harmonics(np.array(np.broadcast_to(each, nv)), "as planned")


def recorded_harmonics(
    segments: Sequence[Segment], recordings: Sequence[Recording]
) -> Harmonics | None:
    """Harmonics of the recordings that repeat; None where none does.

    Args:
        segments: Parts of the recordings.
        recordings: Behind these, in order.
    """
    if sum(len(r.t) for r in recordings) > _SAMPLES:
        return None
    found: list[Periods] = []
    for segment, recording in with_recordings(segments, recordings):
        q = unfiltered_positions(segment, recording)
        try:
            found.append(periods_of(segment.motion.t, q, segment.tau_raw, recording.name))
        except BadRecording:
            continue
    if not found:
        return None
    lengths = ", ".join(f"{p.period:.4g} s" for p in found)
    highest = np.max([highest_harmonic(p) for p in found], axis=0)
    return Harmonics(highest, f"the motion repeats every {lengths}")


def highest_harmonic(periods: Periods) -> Array:
    """Frequency up to which harmonics hold the velocity of the mean period, shape (nv,) [Hz]."""
    X = scipy.fft.rfft(periods.mean_q, axis=0)
    heard = periods.f[:, None] <= periods.bandwidth_hz * (1 + 1e-9)
    power = np.cumsum(periods.f[:, None] ** 2 * np.abs(X) ** 2 * heard, axis=0)
    total = power[-1]
    highest = periods.f[np.argmax(power >= _HELD * total, axis=0)]
    return np.where(total > _STILL**2 * total.max(), highest, 0.0)
