"""Tables to corrupt, and recordings of a motion that is known exactly."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from known_arms import smooth_motion

from excitant.identify import Recording
from excitant.robots import Robot, torque


@pytest.fixture
def table() -> pd.DataFrame:
    """Three seconds of two joints, valid."""
    t = np.arange(300) / 100.0
    one, two = ((np.sin(k * t), 3 * np.cos(2 * k * t) + k) for k in (1, 2))
    return pd.DataFrame(dict(zip(["t", "q1", "tau1", "q2", "tau2"], [t, *one, *two], strict=True)))


@pytest.fixture
def save(tmp_path: Path) -> Callable[..., Path]:
    """``save(log, name)``: the file of a table or of a recording, in the form of its suffix."""

    def saved(log: pd.DataFrame | Recording, name: str, **options: Any) -> Path:
        path = tmp_path / name
        log = log.to_frame() if isinstance(log, Recording) else log
        if path.suffix == ".npz":
            np.savez(path, **{column: log[column] for column in log})
        elif path.suffix == ".parquet":
            log.to_parquet(path, row_group_size=70, **options)
        else:
            log.to_csv(path, index=False, **options)
        return path

    return saved


@pytest.fixture(scope="session")
def exact() -> Callable[..., Recording]:
    """``exact(robot, t)``: torque of the robot's own model on a smooth motion, by default exact."""

    def recorded(robot: Robot, t: np.ndarray, seed: int = 0, noise: float = 0.0) -> Recording:
        motion = smooth_motion(robot, t, seed)
        errors = noise * np.random.default_rng(seed).standard_normal(motion.q.shape)
        return Recording("exact", "exact.csv", t, motion.q, torque(robot, motion) + errors)

    return recorded
