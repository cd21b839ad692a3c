"""Bias of least squares by noise in the motion.

Least squares of columns W + E, with errors E that do not depend on the torque's, has the bias
−(WᵀW)⁻¹ E[EᵀE] β to first order (Fuller 1987). Of all that positions give, accelerations are the
noisiest: noise δ as large as sensors leave it behind the filters makes E = W(q, q̇, q̈ + δ) −
W(q, q̇, q̈), and rows enough average EᵀE.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from excitant.exceptions import BadInput
from excitant.identify.preprocessing import (
    POSITION_RATIO,
    Segment,
    position_cutoff,
    prepare,
    uninterrupted,
)
from excitant.identify.prior import silent_columns
from excitant.identify.recording import Recording
from excitant.identify.regression import DEPENDENT
from excitant.identify.rows import Data, states
from excitant.identify.signals import mean_noise
from excitant.robots.effects import Effect
from excitant.robots.motion import (
    Array,
    Mask,
    numbered,
    quotient,
    read_only,
    root_mean_square,
)
from excitant.robots.robot import Robot
from excitant.robots.torque import observation_columns

ROWS = 1000  # over which EᵀE is averaged: to some per cent

RATE_SHARE = 0.2
"""Highest cut-off over the rate: 0.8 of what every second sample can show."""

ATTENUATION = 0.02
"""Noise of a joint's acceleration over its rms from which on instruments are tried.

Least squares loses its square of an inertia, the noise's share of the power: 4e-4, which is the
standard deviation that torque noise of 1 % leaves of it after 600 independent rows.
"""

NOISE_UNSURE = 0.3
"""Relative std of the power of noise by half the difference of even and odd samples.

Errors of steps that a joint passes at about one a sample are correlated from sample to sample: 24 %
rms over 18 joints of virtual arms at 0.3 to 4 steps a sample.
"""


def acceleration_noise(segments: Sequence[Segment]) -> Array:
    """Noise of accelerations behind the filters of positions and of torque, (nv,) [rad/s²]."""
    known = [(s.sensors, len(s.motion)) for s in segments if s.sensors is not None]
    if not known:
        return np.zeros(segments[0].motion.q.shape[1])
    sensors, samples = zip(*known, strict=True)
    noise = mean_noise(sensors, samples)
    cutoff_hz = segments[0].cutoff_hz
    return noise.acceleration(position_cutoff(cutoff_hz, noise.rate_hz), cutoff_hz)


def coarseness(segments: Sequence[Segment]) -> Array:
    """That noise over the rms of each joint's acceleration, filtered as torque, shape (nv,)."""
    filtered = [s.filtered(s.motion.ddq, s.keep) for s in segments]
    size = root_mean_square(np.concatenate(filtered))
    return quotient(acceleration_noise(segments), size)


def attenuation(
    robot: Robot,
    effects: Sequence[Effect],
    segments: Sequence[Segment],
    used: Mask,
    weight: Array,
    columns: Sequence[int],
    x: Array,
) -> Array:
    """E[EᵀE] x of the rows of segments, weights of joints squared, shape (r,).

    Args:
        robot: The arm.
        effects: Effects that are estimated.
        segments: What is fitted.
        used: Rows that count, shape (n, nv).
        weight: Weights of the rows of each joint, shape (nv,).
        columns: Those of all columns that are fitted.
        x: Their coefficients, shape (r,).
    """
    noise = acceleration_noise(segments)
    shown = states(segments)
    n = len(shown)
    some = np.linspace(0, n - 1, min(n, ROWS)).astype(int)
    shown = shown[some]
    delta = np.random.default_rng(0).standard_normal((len(some), robot.nv)) * noise
    noisy, exact = (
        observation_columns(robot, effects, numbered(shown.q, shown.dq, a))
        for a in (shown.ddq + delta, shown.ddq)
    )
    E = (noisy - exact)[:, :, list(columns)] * used[some][:, :, None]
    score = np.einsum("njr,nj->r", E, E @ x * weight**2, optimize=True)
    return read_only(score * n / len(some))


def without_noise(R: Array, errors: Array) -> Array:
    """Whitened columns that fit x without the bias by errors of these, shape (m, p).

    With G = RᵀR − EᵀE the information of exact columns, Rᵀ(z − R x) + EᵀE x has the mean zero, and
    the covariance RᵀR where errors are those of z: likewise z − R⁻ᵀ G x, that of 1 (Fuller 1987).
    The mean of columns of two halves of the samples has the errors of half their difference.

    Args:
        R: Whitened columns or their QR factor, shape (m, p).
        errors: EᵀE of their errors, whitened alike, shape (p, p).
    """
    norms = np.linalg.norm(R, axis=0)
    size = np.where(silent_columns(R), norms.max(initial=0.0) or 1.0, norms)
    inverse = np.linalg.pinv(R / size, rcond=DEPENDENT) / size[:, None]
    return R - inverse.T @ errors


def every_second(recording: Recording, first: int) -> Recording:
    """The motion as its even samples (0) show it, or its odd ones (1), at all instants."""
    t = recording.t
    parts = [
        part for part in uninterrupted(t, recording.q) if len(part[first::2]) > 5
    ]

    def interpolated(channel: Array) -> Array:
        values = np.array(channel)
        for part in parts:
            half = part[first::2]
            spline = scipy.interpolate.make_interp_spline(
                t[half], values[half], k=5
            )
            values[part] = spline(t[part])
        return values

    dq = None if recording.dq is None else interpolated(recording.dq)
    return replace(recording, q=interpolated(recording.q), dq=dq)


def half_segments(
    recordings: Sequence[Recording], data: Data
) -> tuple[list[Segment], list[Segment]]:
    """The fitted segments as even and as odd samples of their recordings show them, in order.

    Their errors are independent where the noise of a position sensor is so from sample to sample:
    not for a sensor that low-passes before it logs, nor for errors that depend on the position
    (scale, eccentricity), for which every sample is wrong alike.

    Raises:
        BadInput: A rate below five times the cut-off.
    """
    cutoff_hz = data.cutoff_hz
    whole = data.train[0].whole
    halves: tuple[list[Segment], list[Segment]] = ([], [])
    for recording in recordings:
        rate_hz = 1 / recording.step
        highest = RATE_SHARE * rate_hz
        if cutoff_hz > highest * (1 + 1e-6):
            raise BadInput(
                f"{recording.name}: every second sample at {rate_hz:.4g} Hz does not show "
                f"motion up to the cut-off of {cutoff_hz:g} Hz; choose one up to "
                f"{highest:.3g} Hz"
            )
        band_hz = min(POSITION_RATIO * cutoff_hz, highest)
        for first, segments in enumerate(halves):
            half = prepare(every_second(recording, first), cutoff_hz, band_hz)
            segments += [replace(segment, whole=whole) for segment in half]
    return halves
