"""Bias of least squares by noise in the motion.

Least squares of columns W + E, with errors E that do not depend on the torque's, has the bias
−(WᵀW)⁻¹ E[EᵀE] β to first order (Fuller 1987). Of all that positions give, accelerations are the
noisiest: noise δ as large as sensors leave it behind the filters makes E = W(q, q̇, q̈ + δ) −
W(q, q̇, q̈), and rows enough average EᵀE.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from excitant.identify.preprocessing import Mask, Segment, position_cutoff
from excitant.identify.signals import mean_noise
from excitant.robots.effects import Effect
from excitant.robots.motion import Array, Motion, read_only
from excitant.robots.robot import Robot
from excitant.robots.torque import observation_columns

ROWS = 1000  # over which EᵀE is averaged: to some per cent

ATTENUATION = 0.02
"""Noise of a joint's acceleration over its rms from which on instruments are tried.

Least squares loses its square of an inertia, the noise's share of the power: 4e-4, which is the
standard deviation that torque noise of 1 % leaves of it after 600 independent rows.
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
    size = np.sqrt((np.concatenate(filtered) ** 2).mean(axis=0))
    return np.divide(
        acceleration_noise(segments), size, out=np.zeros_like(size), where=size > 0
    )


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
    motions = [s.motion[s.keep] for s in segments]
    q, dq, ddq = (
        np.concatenate([getattr(motion, name) for motion in motions])
        for name in ("q", "dq", "ddq")
    )
    some = np.linspace(0, len(q) - 1, min(len(q), ROWS)).astype(int)
    t = np.arange(float(len(some)))
    delta = np.random.default_rng(0).standard_normal((len(some), robot.nv)) * noise
    noisy, exact = (
        observation_columns(robot, effects, Motion(t, q[some], dq[some], a))
        for a in (ddq[some] + delta, ddq[some])
    )
    E = (noisy - exact)[:, :, list(columns)] * used[some][:, :, None]
    score = np.einsum("njr,nj->r", E, E @ x * weight**2, optimize=True)
    return read_only(score * len(q) / len(some))
