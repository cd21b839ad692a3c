"""From a recording to rows of the identification problem.

Positions, refined by measured speeds (`smoother`), pass a zero-phase Butterworth filter and are
differentiated through a quintic spline. Every column of the regressor and the torque then pass one
and the same zero-phase filter ("parallel filtering", Gautier 1997), friction columns too, and are
decimated.

A joint at rest with dry friction holds any torque near what motion would need, so its row counts
only where no rest is within the reach of the torque filter (`certain_rows`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy

from excitant.exceptions import BadInput, BadRecording
from excitant.identify.differentiators import Differentiator, ZeroPhaseButterworth
from excitant.identify.recording import MINIMUM_DURATION, Recording
from excitant.identify.smoother import SensorNoise, smoothed
from excitant.identify.spectra import low_pass
from excitant.robots.effects import Effect
from excitant.robots.motion import Array, Motion, freeze, read_only
from excitant.robots.robot import Robot

CUTOFF_HZ = 10.0  # above the motions of arms, below their structural resonances
POSITION_RATIO = 2.0  # positions keep what the torque filter will judge
_NYQUIST_SHARE = 0.8
# instants whose columns are evaluated together, of a segment thrice as long
_AT_ONCE = 10_000
_HELD = 8.0  # times the cut-off: sampling rate at which positions and their products are held
_REMEMBERED = 6.0  # periods of its cut-off, after which a filter has forgotten
_MOST_ROWS = 15_000  # of a recording: evenly taken of a longer one
_TIE = 1e-6  # of a stride: 1 kHz and 10 Hz give 25 whatever the rounding of time
_SAME = 1e-5  # of a step: samples at regular time
_GAP_STEPS = 3.0  # a gap is longer than both [median steps
_GAP_TIME = 0.05  # s]
_BURSTS = 10.0  # times the median step: a mean step beyond it has no regular rate
_TINY = 1e-12  # rad/s: either side of standstill
# of a joint's fastest motion in all recordings, below which it stands still
_SHARE = 0.02
# of its velocity limit, likewise: what a controller lets a held joint creep
_LEAST = 2e-3
_TRAVEL = 1e-2  # rad or m, over a segment, likewise
_FREE_SPEED = 3.0  # rad/s, where there is no limit
_SLOW = 0.015  # of a joint's top speed: slower is at rest
_RESTS_S = 0.04  # s, at least; a reversal without a rest is quicker
# of the period of the filter's cut-off: how far a rest affects filtered torque
_REACH = 0.5

Mask = npt.NDArray[np.bool_]
Index = npt.NDArray[np.intp]


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
        sensors: Noise of the positions and speeds behind the motion; None of a motion as planned.
        whole: Smooth columns are evaluated at every sample, too.
    """

    name: str
    motion: Motion
    tau: Array
    tau_raw: Array
    cutoff_hz: float
    keep: slice
    sensors: SensorNoise | None = None
    whole: bool = False

    def __post_init__(self) -> None:
        freeze(self, "tau", "tau_raw")

    @property
    def rate_hz(self) -> float:
        """Sampling rate of the motion [Hz]."""
        return float(1 / (self.motion.t[1] - self.motion.t[0]))

    @cached_property
    def least_speed(self) -> Array:
        """Speed up to which a joint may as well be at rest, for all its sensor says, (nv,)."""
        if self.sensors is None:
            return read_only(np.zeros(self.tau.shape[1]))
        band = position_cutoff(self.cutoff_hz, self.sensors.rate_hz)
        return read_only(self.sensors.least_speed(band))

    @cached_property
    def thin(self) -> Segment:
        """The segment at the lowest rate that holds all that positions pass, rows as they are."""
        start = self.keep.start
        stop = self.keep.stop
        step = self.keep.step or 1
        every = _every(self.rate_hz, self.cutoff_hz)
        if every == 1 or step % every or self.whole:
            return self
        part = slice(start % every, None, every)
        first = start // every
        keep = slice(first, first + -(-(stop - start) // every), step // every)
        known = (self.motion[part], self.tau[part], self.tau_raw[part])
        return Segment(self.name, *known, self.cutoff_hz, keep, self.sensors)

    def rows(self, columns: Callable[[Motion], Array]) -> Array:
        """Filtered and decimated columns of the motion, shape (rows, ...).

        Long segments are evaluated in parts that overlap by what the filter remembers.
        """
        start = self.keep.start
        stop = self.keep.stop
        step = self.keep.step or 1
        reach = int(_REMEMBERED * self.rate_hz / self.cutoff_hz)
        own = -(-_AT_ONCE // step) * step
        if len(self.motion) <= 3 * own + 2 * reach:
            return self.filtered(columns(self.motion), self.keep)
        found = []
        for first in range(start, stop, own):
            part = slice(max(0, first - reach), first + own + reach)
            kept = slice(first - part.start, min(first + own, stop) - part.start, step)
            found.append(self.filtered(columns(self.motion[part]), kept))
        return np.concatenate(found)

    def filtered(self, values: Array, kept: slice = slice(None)) -> Array:
        """Columns, shape (n, ...), through the torque filter at some instants."""
        return low_pass(values, self.cutoff_hz, self.rate_hz, kept)

    @property
    def t(self) -> Array:
        """Times of the rows [s]."""
        return self.motion.t[self.keep]


def _every(rate_hz: float, cutoff_hz: float) -> int:
    """Of how many samples one suffices for what positions pass and its products."""
    return max(1, int(rate_hz / (_HELD * cutoff_hz) + _TIE))


def prepare(
    recording: Recording,
    cutoff_hz: float | None = None,
    differentiator: Differentiator | None = None,
) -> list[Segment]:
    """Segments of a recording, split at gaps, filtered and differentiated.

    Args:
        recording: What was logged.
        cutoff_hz: Cut-off of the torque filter; 10 Hz, or 0.2 times the sampling rate when that
            is lower, so that the filter of positions, twice as high, still filters.
        differentiator: In place of the Butterworth filter with a quintic spline; without delay.

    Raises:
        BadRecording: The cut-off is not below half the sampling rate, or no uninterrupted
            part is long enough.
    """
    t = recording.t
    step = _step(recording)
    if cutoff_hz is None:
        cutoff_hz = min(CUTOFF_HZ, default_cutoff(recording))
    highest = 0.5 * _NYQUIST_SHARE / step
    if not 0 < cutoff_hz <= highest * (1 + 1e-9):
        raise BadRecording(
            recording.file,
            f"cut-off {cutoff_hz:g} Hz does not fit its rate of {1 / step:.4g} Hz; "
            f"choose one up to {highest:.3g} Hz",
        )
    band = position_cutoff(cutoff_hz, 1 / step)
    differentiator = differentiator or ZeroPhaseButterworth(band)
    parts = uninterrupted(t)
    segments = [
        _segment(recording, part, step, cutoff_hz, band, differentiator)
        for part in parts
        if len(part) > 20 and t[part[-1]] - t[part[0]] >= MINIMUM_DURATION
    ]
    if not segments:
        needed = f"{MINIMUM_DURATION:g} s without interruption are needed"
        why = (
            f"time jumps {len(parts) - 1} times, first after {t[parts[0][-1]]:.4g} s; {needed}"
            if len(parts) > 1
            else f"'{recording.name}' lasts {recording.duration:.3g} s; {needed}: "
            "record longer or name a hold-out of its own"
        )
        raise BadRecording(recording.file, why, column="t")
    return segments


def position_cutoff(cutoff_hz: float, rate_hz: float) -> float:
    """Cut-off of the filter of positions beside that of torque, at a sampling rate [Hz]."""
    return min(POSITION_RATIO * cutoff_hz, 0.5 * _NYQUIST_SHARE * rate_hz)


def _segment(
    recording: Recording,
    part: Index,
    step: float,
    cutoff_hz: float,
    band_hz: float,
    differentiator: Differentiator,
) -> Segment:
    grid, q, tau, dq = resampled(recording, part)
    q, sensors = smoothed(grid, q, dq, band_hz)
    motion = differentiator(grid, q)
    if len(motion) < len(grid):
        raise BadInput("a causal differentiator is for loops; give one without delay")
    edge = round(1 / (cutoff_hz * step))
    stride = max(
        int(1 / (4 * cutoff_hz * step) + _TIE), -(-len(recording) // _MOST_ROWS), 1
    )
    stride -= stride % _every(1 / step, cutoff_hz)
    keep = slice(edge, len(grid) - edge, stride)
    passed = low_pass(tau, cutoff_hz, 1 / step)
    segment = Segment(recording.name, motion, passed, tau, cutoff_hz, keep, sensors)
    inner = slice(edge, len(grid) - edge)
    fast = (np.abs(motion.dq[inner]) > segment.least_speed).any(axis=0)
    return stilled(segment, fast | (np.ptp(q, axis=0) > sensors.span))


def default_cutoff(recording: Recording) -> float:
    """Highest cut-off of torque at which positions, at twice that, are still filtered [Hz]."""
    return 0.5 * _NYQUIST_SHARE / (POSITION_RATIO * _step(recording))


def _step(recording: Recording) -> float:
    if len(recording) < 2:
        why = f"'{recording.name}' holds {len(recording)} samples; cut the recording at its gap"
        raise BadRecording(
            recording.file, f"{why}, or name a hold-out of its own", column="t"
        )
    return float(np.median(np.diff(recording.t)))


def uninterrupted(t: Array) -> list[Index]:
    """Indices of the parts of a time series, shape (n,) [s], between its gaps."""
    steps = np.diff(t)
    breaks = np.flatnonzero(steps > longest_step(float(np.median(steps)))) + 1
    return np.split(np.arange(len(t)), breaks)


def longest_step(step: float) -> float:
    """Longest time between two samples that is no gap, given the usual one [s]."""
    return max(_GAP_STEPS * step, _GAP_TIME)


def resampled(
    recording: Recording, part: Index
) -> tuple[Array, Array, Array, Array | None]:
    """Time, positions, torque and speeds of a part at a regular rate, that of the median step."""
    rows = slice(int(part[0]), int(part[-1]) + 1)  # no copy of a long recording
    t = recording.t[rows]
    step = float(np.median(np.diff(recording.t)))
    refuse_bursts(t, step, recording.file)
    grid = np.arange(t[0], t[-1] + _SAME * step, step)
    q, tau = at_instants(t, recording.q[rows], recording.tau[rows], grid)
    if recording.dq is None:
        return grid, q, tau, None
    dq, _ = at_instants(t, recording.dq[rows], recording.tau[rows], grid)
    return grid, q, tau, dq


def refuse_bursts(t: Array, step: float, file: str) -> None:
    """Refuse times, shape (n,) [s], that are much farther apart than a rate of this step says."""
    mean = float(t[-1] - t[0]) / len(t)
    if mean > _BURSTS * step:
        why = (
            f"samples come in bursts: half of them are at most {step:.3g} s apart, in the mean "
            f"{mean:.3g} s; log the time of measurement, not that of arrival"
        )
        raise BadRecording(file, why, column="t")


def at_instants(t: Array, q: Array, tau: Array, grid: Array) -> tuple[Array, Array]:
    """Positions (cubic spline) and torque (linear) of samples at instants, shape (m,) [s].

    Samples at these very instants, to a hundred-thousandth of a step, are left as they are.
    """
    if len(t) == len(grid) and np.abs(t - grid).max() <= _SAME * (grid[1] - grid[0]):
        return q, tau
    q = scipy.interpolate.make_interp_spline(t, q, k=3)(grid)
    return q, np.column_stack([np.interp(grid, t, column) for column in tau.T])


def dry_joints(effects: Sequence[Effect], joints: Sequence[str]) -> Mask:
    """Joints on which some effect jumps where the velocity changes sign, shape (nv,)."""
    dry = set[str]()
    zero = np.zeros(1)
    for effect in effects:
        if effect.law is not None:
            ahead, behind = (effect.law(zero, zero + v, zero) for v in (_TINY, -_TINY))
            if any(abs(a[0] - b[0]) > 1e-6 for a, b in zip(ahead, behind, strict=True)):
                dry |= set(effect.joints)
    return np.array([joint in dry for joint in joints])


def moving(robot: Robot, segments: Sequence[Segment]) -> list[Mask]:
    """Instants at which each joint moves, one mask of shape (n, nv) per segment.

    A joint moves where, within half a period of the filter's cut-off, it is faster than 2 % of
    its fastest and than 0.2 % of its velocity limit, in segments in which it travels at all.
    """
    speeds = [np.abs(segment.motion.dq) for segment in segments]
    fastest = np.max([speed.max(axis=0) for speed in speeds], axis=0)
    limit = robot.limits.velocity
    slow = np.maximum(
        _SHARE * fastest, _LEAST * np.where(limit < 1e3, limit, _FREE_SPEED)
    )
    masks = []
    for segment, speed in zip(segments, speeds, strict=True):
        width = 2 * round(segment.rate_hz / (2 * segment.cutoff_hz)) + 1
        near = scipy.ndimage.maximum_filter1d(speed, width, axis=0)
        travels = np.ptp(segment.motion.q, axis=0) > _TRAVEL
        shown = near > np.maximum(slow, segment.least_speed)
        masks.append(np.asarray(shown & travels, bool))
    return masks


def top_speed(segments: Sequence[Segment]) -> Array:
    """Highest speed of each joint, shape (nv,) [rad/s or m/s]."""
    return np.asarray(
        np.max([np.abs(s.motion.dq).max(axis=0) for s in segments], axis=0), float
    )


def away_from_rest(segments: Sequence[Segment], fastest: Array | float = 0.0) -> Mask:
    """Rows that no rest of a joint affects through the filter, shape (rows, nv).

    A joint rests while slow relative to its top speed, here or, if given, elsewhere, or so slow
    that its sensors show no direction (`SensorNoise.least_speed`); reversals without a rest count.
    `moving` marks where a joint takes part in a motion.
    """
    fastest = np.maximum(fastest, top_speed(segments))
    masks = []
    for s in segments:
        slow = np.abs(s.motion.dq) <= np.maximum(_SLOW * fastest, s.least_speed)
        least = max(1, round(_RESTS_S * s.rate_hz))
        reach = max(1, round(_REACH * s.rate_hz / s.cutoff_hz))
        # a rest is the union of windows of its least length in which a joint is slow throughout
        whole = scipy.ndimage.minimum_filter1d(
            slow, least, axis=0, mode="constant", cval=0
        )
        size = least + 2 * reach
        middle = -(1 - least % 2)
        near = scipy.ndimage.maximum_filter1d(
            whole, size, axis=0, mode="constant", cval=0, origin=middle
        )
        masks.append(~near[s.keep])
    return np.concatenate(masks)


def certain_rows(
    effects: Sequence[Effect], joints: Sequence[str], segments: Sequence[Segment]
) -> Mask:
    """Rows that can be fitted: the direction of a joint with dry friction is certain, (rows, nv).

    At rest dry friction holds any torque within its breakaway torque, which is more than Coulomb's
    and not known, so that not even bounds on the torque follow from a model of sliding friction.
    """
    return away_from_rest(segments) | ~dry_joints(effects, joints)


def stilled(segment: Segment, moves: Mask) -> Segment:
    """The segment with joints that do not move, (nv,), held exactly, at their mean position."""
    motion = segment.motion
    still = ~moves
    if not still.any():
        return segment
    q, dq, ddq = (np.array(values) for values in (motion.q, motion.dq, motion.ddq))
    q[:, still] = q[:, still].mean(axis=0)
    dq[:, still] = ddq[:, still] = 0.0
    return replace(segment, motion=Motion(motion.t, q, dq, ddq))
