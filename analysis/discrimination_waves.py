"""Movements of one joint that discriminating motions are made of, and limits to keep."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from excitant.design.trajectory import FourierSeries
from excitant.robots.limits import Limits
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot


def envelope(series: FourierSeries, rng: np.random.Generator) -> Array:
    """((1 − cos ωt) / 2)^p cos(kωt + φ): reversals that swell and fade, shape (c,), norm 1.

    With p ≥ 2 it is at rest at both ends; its peak speeds range from nothing to the highest.
    """
    p = int(rng.integers(2, 5))
    top = max(series.harmonics - p, 1)
    k = min(round(float(np.exp(rng.uniform(np.log(2), np.log(max(top, 3)))))), top)
    n = 4 * series.harmonics + 4
    angle = 2 * np.pi * np.arange(n) / n
    values = ((1 - np.cos(angle)) / 2) ** p * np.cos(k * angle + rng.uniform(0, 2 * np.pi))
    spectrum = np.fft.rfft(values)[1 : series.harmonics + 1] * 2 / n
    return _at_rest(series, np.concatenate([[0.0], spectrum.real, -spectrum.imag]))


def wave(series: FourierSeries, rng: np.random.Generator) -> Array:
    """A few random harmonics, low ones mostly, shape (c,), norm 1."""
    h = np.arange(1, series.harmonics + 1)
    top = np.exp(rng.uniform(np.log(2), np.log(series.harmonics)))
    size = np.where(h <= max(top, 3), 1 / h ** rng.uniform(0, 2), 0.0)
    x = rng.normal(size=2 * series.harmonics) * np.concatenate([size, size])
    return _at_rest(series, np.concatenate([[0.0], x]))


def _at_rest(series: FourierSeries, x: Array) -> Array:
    x = series.rest @ (series.rest.T @ x)
    x[0] = 0.0
    norm = np.linalg.norm(x)
    return np.asarray(x / norm if norm > 0 else x, float)


def within_recording(robot: Robot, recorded: Sequence[Motion]) -> Robot:
    """The arm, limits that it does not state set to what the recording reached."""
    limits = robot.limits
    if not recorded:
        return robot
    q = np.concatenate([m.q for m in recorded])
    speed, push = (
        np.max([np.abs(getattr(m, name)).max(axis=0) for m in recorded], axis=0)
        for name in ("dq", "ddq")
    )
    reached = np.column_stack([q.min(axis=0), q.max(axis=0)])
    unbounded = ~np.isfinite(limits.position).all(axis=1, keepdims=True)
    known: Limits = replace(
        limits,
        position=np.where(unbounded, reached, limits.position),
        velocity=np.where(np.isfinite(limits.velocity), limits.velocity, speed),
        acceleration=np.where(np.isfinite(limits.acceleration), limits.acceleration, push),
    )
    return robot.with_limits(known)
