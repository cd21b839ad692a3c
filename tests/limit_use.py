"""Use of a robot's limits at the samples of a motion, by the definition of the limits alone."""

from __future__ import annotations

import numpy as np

from excitant.robots import Array, Motion, Robot, torque


def limit_shares(robot: Robot, motion: Motion) -> dict[str, Array]:
    """Largest share of each limit per joint; of position, the distance from the middle."""
    low, high = robot.limits.position.T
    sizes = {
        "position": np.abs(motion.q - (low + high) / 2) / ((high - low) / 2),
        "velocity": np.abs(motion.dq) / robot.limits.velocity,
        "acceleration": np.abs(motion.ddq) / robot.limits.acceleration,
        "torque": np.abs(torque(robot, motion)) / robot.limits.torque,
    }
    return {name: size.max(axis=0) for name, size in sizes.items()}
