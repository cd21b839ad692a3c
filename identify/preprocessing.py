"""From a recording to rows of the identification problem.

Positions, refined by measured speeds (`signals`), pass a zero-phase Butterworth filter and are
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
import scipy

from excitant.exceptions import BadRecording
from excitant.identify.recording import (
    LEAST_RATE_HZ,
    MINIMUM_DURATION,
    Recording,
    shows_poses,
)
from excitant.identify.signals import (
    MEMORY_PERIODS,
    SensorNoise,
    differentiated,
    low_pass,
    samples_motion,
    smoothed,
)
from excitant.robots.effects import Effect
from excitant.robots.motion import (
    Array,
    Indices,
    Mask,
    Motion,
    Noun,
    interpolated,
    read_only,
    root_mean_square,
)

CUTOFF_HZ = 10.0  # above the motions of arms, below their structural resonances
POSITION_RATIO = 2.0  # positions keep what the torque filter will judge


@dataclass(frozen=True)
class Sampling:
    """How recordings become rows.

    Attributes:
        highest_share: Highest cut-off of positions over the sampling rate.
        chunk: Instants evaluated together, of a segment thrice as long.
        smooth_rate: Least sampling rate over the cut-off that keeps the position band, and
            products of positions, free of aliasing.
        largest_rows: Rows of a recording; a longer one gives every second, third, ...
        rounding: Share of a stride that rounding of time may lack: 1 kHz and 10 Hz give 25.
        regular: Samples at most this share of a step from regular time are taken as they are.
        gap_steps: A gap is longer than so many median steps, and than
        gap_s: so many seconds; see `longest_gap`.
        burst_steps: A mean step of more median steps than this has no regular rate.
    """

    highest_share: float = 0.4
    chunk: int = 10_000
    smooth_rate: float = 8.0
    largest_rows: int = 15_000
    rounding: float = 1e-6
    regular: float = 1e-5
    gap_steps: float = 3.0
    gap_s: float = 0.05
    burst_steps: float = 10.0


SAMPLING = Sampling()


@dataclass(frozen=True)
class Rest:
    """When a joint rests, and when it takes part in a motion.

    Attributes:
        speed_share: At rest a joint is slower than this share of its top speed,
        duration_s: for so long; a reversal without a rest is quicker.
        reach: Reach of a rest in filtered torque, in periods of the filter's cut-off.
        travel: A joint that moves travels farther than this over a segment [rad or m].
        moving_share: Between poses it is faster than this share of its velocity limit,
        free_speed: which is this where there is none [rad/s].
        creep_share: A joint that is held creeps no faster than this share of that speed.
    """

    speed_share: float = 0.015
    duration_s: float = 0.04
    reach: float = 0.5
    travel: float = 1e-2
    moving_share: float = 0.02
    free_speed: float = 3.0
    creep_share: float = 2e-3


REST = Rest()


@dataclass(frozen=True, eq=False)
class Segment(Noun):
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
        start, stop, step = self.keep.indices(len(self.motion))
        factor = _decimation(self.rate_hz, self.cutoff_hz)
        if factor == 1 or step % factor or self.whole:
            return self
        part = slice(start % factor, None, factor)
        first = start // factor
        keep = slice(first, first + -(-(stop - start) // factor), step // factor)
        return replace(
            self,
            motion=self.motion[part],
            tau=self.tau[part],
            tau_raw=self.tau_raw[part],
            keep=keep,
        )

    def rows(self, columns: Callable[[Motion], Array]) -> Array:
        """Filtered and decimated columns of the motion, shape (rows, ...)."""
        return self.rows_of([columns])[0]

    def rows_of(self, kinds: Sequence[Callable[[Motion], Array]]) -> list[Array]:
        """Rows of several kinds of columns, each of shape (rows, ...).

        Long segments are evaluated in parts that overlap by what the filter remembers, each part
        for all kinds: what they share of a motion is computed once.
        """
        start, stop, step = self.keep.indices(len(self.motion))
        reach = int(MEMORY_PERIODS * self.rate_hz / self.cutoff_hz)
        size = -(-SAMPLING.chunk // step) * step
        if len(self.motion) <= 3 * size + 2 * reach:
            return [
                self.filtered(columns(self.motion), self.keep) for columns in kinds
            ]
        parts: list[list[Array]] = []
        for first in range(start, stop, size):
            part = slice(max(0, first - reach), first + size + reach)
            inner = slice(
                first - part.start, min(first + size, stop) - part.start, step
            )
            motion = self.motion[part]
            parts.append(
                [self.filtered(columns(motion), inner) for columns in kinds]
            )
        return [np.concatenate(chunks) for chunks in zip(*parts, strict=True)]

    @property
    def of_poses(self) -> bool:
        """Whether rows are poses of an arm at rest, of which nothing is filtered."""
        return self.cutoff_hz == np.inf

    def filtered(self, values: Array, rows: slice = slice(None)) -> Array:
        """Columns, shape (n, ...), through the torque filter at some instants."""
        if self.of_poses:
            return values[rows]
        return low_pass(values, self.cutoff_hz, self.rate_hz, rows)

    @property
    def t(self) -> Array:
        """Times of the rows [s]."""
        return self.motion.t[self.keep]


def _decimation(rate_hz: float, cutoff_hz: float) -> int:
    """Decimation factor that keeps the position band and its products free of aliasing."""
    most = rate_hz / (SAMPLING.smooth_rate * cutoff_hz)
    return max(1, int(most + SAMPLING.rounding))


def prepare(
    recording: Recording,
    cutoff_hz: float | None = None,
    band_hz: float | None = None,
) -> list[Segment]:
    """Segments of a recording, split at gaps, filtered and differentiated.

    Args:
        recording: What was logged.
        cutoff_hz: Cut-off of the torque filter; 10 Hz, or 0.2 times the sampling rate when that
            is lower, so that the filter of positions, twice as high, still filters.
        band_hz: Cut-off of the filter of positions; see `position_cutoff`.

    Raises:
        BadRecording: The cut-off is not below half the sampling rate, or no uninterrupted
            part is long enough.
    """
    t = recording.t
    step = _step(recording)
    if shows_poses(recording):
        why = (
            f"{len(t)} rows {step:.4g} s apart show poses and no motion: record one at "
            f"{LEAST_RATE_HZ:g} Hz or more, or say the unit of time in a file for --map, such as "
            "{units: {t: ms}}; from poses alone, hold-out too, `identify` reads gravity"
        )
        raise BadRecording(recording.file, why, column="t")
    if cutoff_hz is None:
        cutoff_hz = min(CUTOFF_HZ, default_cutoff(recording))
    highest = SAMPLING.highest_share / step
    if not 0 < cutoff_hz <= highest * (1 + 1e-9):
        raise BadRecording(
            recording.file,
            f"cut-off {cutoff_hz:g} Hz does not fit its rate of {1 / step:.4g} Hz; "
            f"choose one up to {highest:.3g} Hz",
        )
    band_hz = band_hz or position_cutoff(cutoff_hz, 1 / step)
    parts = uninterrupted(t, recording.q)
    # what the filter distorts at both ends is left out
    least = max(MINIMUM_DURATION, 2 / cutoff_hz + 2 * step)
    segments = [
        _segment(recording, part, step, cutoff_hz, band_hz)
        for part in parts
        if len(part) > 20 and t[part[-1]] - t[part[0]] >= least
    ]
    if not segments:
        needed = f"{least:.3g} s without interruption are needed"
        if least > MINIMUM_DURATION:
            needed += f" at a cut-off of {cutoff_hz:.3g} Hz"
        if len(parts) > 1:
            after = t[parts[0][-1]]
            longest = longest_gap(t, recording.q)
            why = f"time jumps {len(parts) - 1} times, first after {after:.4g} s; {needed}: log "
            why += f"every sample, or move more slowly (so fast, gaps up to {longest:.2g} s do)"
        elif recording.duration < least:
            why = f"'{recording.name}' lasts {recording.duration:.3g} s; {needed}: "
            why += "record longer or name a hold-out of its own"
        else:
            why = f"'{recording.name}' holds {len(t)} samples {step:.3g} s apart; more than 20 are "
            why += f"needed, at {LEAST_RATE_HZ:g} Hz or more"
        raise BadRecording(recording.file, why, column="t")
    return segments


def position_cutoff(cutoff_hz: float, rate_hz: float) -> float:
    """Cut-off of the filter of positions beside that of torque, at a sampling rate [Hz]."""
    return min(POSITION_RATIO * cutoff_hz, SAMPLING.highest_share * rate_hz)


def _segment(
    recording: Recording,
    part: Indices,
    step: float,
    cutoff_hz: float,
    band_hz: float,
) -> Segment:
    grid, measured, tau, dq = resampled(recording, part)
    q, sensors = smoothed(grid, measured, dq, position_cutoff(cutoff_hz, 1 / step))
    motion = differentiated(grid, q, band_hz)
    edge = round(1 / (cutoff_hz * step))
    rows_apart = int(1 / (4 * cutoff_hz * step) + SAMPLING.rounding)
    stride = max(rows_apart, -(-len(recording) // SAMPLING.largest_rows), 1)
    stride -= stride % _decimation(1 / step, cutoff_hz)
    inner = slice(edge, len(grid) - edge)
    segment = Segment(
        name=recording.name,
        motion=motion,
        tau=low_pass(tau, cutoff_hz, 1 / step),
        tau_raw=tau,
        cutoff_hz=cutoff_hz,
        keep=slice(inner.start, inner.stop, stride),
        sensors=sensors,
    )
    fast = (np.abs(motion.dq[inner]) > segment.least_speed).any(axis=0)
    moves = fast | (np.ptp(q, axis=0) > sensors.span)
    # the spline of a constant is one but for rounding, which has signs
    return stilled(segment, moves & (np.ptp(recording.q[part], axis=0) > 0))


def default_cutoff(recording: Recording) -> float:
    """Highest cut-off of torque at which positions, at twice that, are still filtered [Hz]."""
    return SAMPLING.highest_share / (POSITION_RATIO * _step(recording))


def _step(recording: Recording) -> float:
    if len(recording) < 2:
        why = f"'{recording.name}' holds {len(recording)} samples; cut the recording at its gap"
        raise BadRecording(
            recording.file, f"{why}, or name a hold-out of its own", column="t"
        )
    return recording.step


def uninterrupted(t: Array, q: Array) -> list[Indices]:
    """Indices of the parts of a motion between gaps, in which it is not determined.

    Args:
        t: Times, shape (n,) [s].
        q: Positions, shape (n, nv).
    """
    breaks = np.flatnonzero(np.diff(t) > longest_gap(t, q)) + 1
    return np.split(np.arange(len(t)), breaks)


def longest_gap(t: Array, q: Array) -> float:
    """Longest time between two samples over which neighbours determine the motion [s].

    `longest_step`, or where no joint moves fast `Sampling.smooth_rate` gaps fit into a period of
    its torque, of twice its frequency; that is its rms speed over 2π times its spread. Joints whose
    positions are not samples of a motion do not count.
    """
    steps = np.diff(t)
    longest = longest_step(np.median(steps))
    if steps.max(initial=0.0) <= longest:
        return longest
    near = steps <= longest
    moving = (x for x in q.T if np.ptp(x) > 0 and samples_motion(x[:, None]))
    periods = [
        2 * np.pi * x.std() / root_mean_square((np.diff(x) / steps)[near])
        for x in moving
    ]
    return max(longest, min(periods, default=0.0) / (2 * SAMPLING.smooth_rate))


def longest_step(step: float) -> float:
    """Longest time between two samples that is no gap, given the usual one [s]."""
    return max(SAMPLING.gap_steps * step, SAMPLING.gap_s)


def resampled(
    recording: Recording, part: Indices
) -> tuple[Array, Array, Array, Array | None]:
    """Time, positions, torque and speeds of a part at a regular rate, that of the median step.

    Positions and speeds by a cubic spline, torque linearly.

    Raises:
        BadRecording: Samples in bursts, which have no regular rate.
    """
    rows = slice(int(part[0]), int(part[-1]) + 1)  # no copy of a long recording
    t = recording.t[rows]
    q = recording.q[rows]
    tau = recording.tau[rows]
    dq = None if recording.dq is None else recording.dq[rows]
    step = recording.step
    mean = (t[-1] - t[0]) / len(t)
    if mean > SAMPLING.burst_steps * step:
        why = (
            f"samples come in bursts: half of them are at most {step:.3g} s apart, in the mean "
            f"{mean:.3g} s; log the time of measurement, not that of arrival"
        )
        raise BadRecording(recording.file, why, column="t")
    tolerance = SAMPLING.regular * step
    grid = np.arange(t[0], t[-1] + tolerance, step)
    if len(t) == len(grid) and np.abs(t - grid).max() <= tolerance:
        return grid, q, tau, dq
    linear = interpolated(grid, t, tau)

    def cubic(values: Array) -> Array:
        return scipy.interpolate.make_interp_spline(t, values, k=3)(grid)

    return grid, cubic(q), linear, None if dq is None else cubic(dq)


def dry_joints(effects: Sequence[Effect], joints: Sequence[str]) -> Mask:
    """Joints that dry friction of some effect holds at rest, shape (nv,)."""
    dry = {joint for e in effects if e.physics.dry for joint in e.joints}
    return np.array([joint in dry for joint in joints])


def top_speed(segments: Sequence[Segment]) -> Array:
    """Highest speed of each joint, shape (nv,) [rad/s or m/s]."""
    return np.max([np.abs(s.motion.dq).max(axis=0) for s in segments], axis=0)


def away_from_rest(
    segments: Sequence[Segment], fastest: Array | float = 0.0
) -> Mask:
    """Rows that no rest of a joint affects through the filter, shape (rows, nv).

    A joint rests while slow relative to its top speed, here or, if given, elsewhere, or so slow
    that its sensors show no direction (`SensorNoise.least_speed`); reversals without a rest count.
    """
    fastest = np.maximum(fastest, top_speed(segments))
    masks = []
    for s in segments:
        if s.of_poses:  # rest is what they show
            masks.append(np.ones_like(s.motion.q[s.keep], dtype=bool))
            continue
        least = np.maximum(REST.speed_share * fastest, s.least_speed)
        slow = np.abs(s.motion.dq) <= least
        size = max(1, round(REST.duration_s * s.rate_hz))
        reach = max(1, round(REST.reach * s.rate_hz / s.cutoff_hz))
        # a rest is the union of windows of its least length in which a joint is slow throughout
        begins = scipy.ndimage.minimum_filter1d(
            slow, size, axis=0, mode="constant", cval=0
        )
        near = scipy.ndimage.maximum_filter1d(
            begins,
            size + 2 * reach,
            axis=0,
            mode="constant",
            cval=0,
            origin=-(1 - size % 2),
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
    q = np.array(motion.q)
    q[:, still] = q[:, still].mean(axis=0)
    dq = np.where(still, 0.0, motion.dq)
    ddq = np.where(still, 0.0, motion.ddq)
    return replace(segment, motion=Motion(motion.t, q, dq, ddq))
