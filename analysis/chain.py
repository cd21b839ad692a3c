"""Where base, joints and tip of an arm are, in a pose that keeps them apart in a drawing."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from excitant.robots.motion import Array, read_only
from excitant.robots.robot import Robot

_POSES = 400  # tried
_BELOW = 0.3  # of the arm's size, how strongly points under the base count against a pose


def chain(robot: Robot) -> Array:
    """Base, joints in order, and tip of an arm in a clear pose, shape (nv + 2, 3) [m].

    Of random poses within the limits, always the same ones, the one whose joints are farthest
    from those that are not their neighbours, with the arm above its base.
    """
    rng = np.random.default_rng(0)
    q, _, _ = robot.random_motion(rng, _POSES)
    poses = np.array([_points(robot, each) for each in q])
    return read_only(poses[int(np.argmax([_clarity(points) for points in poses]))])


def _points(robot: Robot, q: Array) -> Array:
    model, data = robot.model, robot.model.createData()
    pin.framesForwardKinematics(model, data, np.asarray(q, float))
    joints = [data.oMi[j].translation.copy() for j in range(1, robot.nv + 1)]
    return np.array([np.zeros(3), *joints, data.oMf[robot.tip].translation.copy()])


def _clarity(points: Array) -> float:
    """Least distance of points that are two or more apart, from the side, relative to the arm."""
    distances = np.linalg.norm(points[:, None, [0, 2]] - points[None, :, [0, 2]], axis=2)
    apart = distances[np.triu_indices(len(points), 2)]
    true = np.linalg.norm(points[:, None] - points[None], axis=2)[np.triu_indices(len(points), 2)]
    size = max(float(true.max(initial=0.0)), 1e-9)
    meant = true > 1e-3 * size  # joints that meet in a point stay together in every pose
    least = float(apart[meant].min(initial=size)) / size
    return least + _BELOW * float(min(points[:, 2].min(), 0.0)) / size
