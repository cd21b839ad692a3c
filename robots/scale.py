"""Units of an arm: its length, and the powers of length in its parameters."""

from __future__ import annotations

import numpy as np

from excitant.robots.motion import read_only
from excitant.robots.robot import Robot

LENGTH_POWERS = read_only([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
"""Power of length in the unit of each standard parameter, shape (10,)."""


def arm_length(robot: Robot) -> float:
    """Length of an arm, from its first joint to its last along the links; 1 m when zero [m]."""
    steps = [np.linalg.norm(place.translation) for place in list(robot.model.jointPlacements)[2:]]
    return float(sum(steps)) or 1.0
