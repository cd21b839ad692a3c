"""Tables to corrupt, and recordings of a motion that is known exactly."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest

from excitant.identify import Recording
from excitant.robots import Motion, Robot, torque

HARMONICS = np.array([0.3, 0.5, 0.8, 1.3])  # Hz, far below the cut-off of the torque filter


@pytest.fixture
def table() -> pd.DataFrame:
    """Three seconds of two joints, valid."""
    t = np.arange(300) / 100.0
    columns = {"t": t}
    for k in (1, 2):
        columns[f"q{k}"] = np.sin(k * t)
        columns[f"tau{k}"] = 3 * np.cos(2 * k * t) + k
    return pd.DataFrame(columns)


def smooth_motion(robot: Robot, t: np.ndarray, seed: int = 0) -> Motion:
    """Sums of sines with random phases, differentiated on paper."""
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0, 2 * np.pi, (len(HARMONICS), robot.nv))
    omega = 2 * np.pi * HARMONICS[:, None]
    size = rng.uniform(0.5, 1.0, phase.shape) * np.array([0.8, 0.5, 0.3, 0.15])[:, None]
    angle = omega * t[:, None, None] + phase
    orders = ((size * omega**k * np.sin(angle + k * np.pi / 2)).sum(axis=1) for k in range(3))
    return Motion(t, *orders)


@pytest.fixture(scope="session")
def motion_of() -> Callable[..., Motion]:
    return smooth_motion


@pytest.fixture(scope="session")
def exact() -> Callable[..., Recording]:
    """``exact(robot, t)``: torque of the robot's own model on a smooth motion, no noise."""

    def recorded(robot: Robot, t: np.ndarray, seed: int = 0) -> Recording:
        motion = smooth_motion(robot, t, seed)
        return Recording("exact", "exact.csv", t, motion.q, torque(robot, motion))

    return recorded
