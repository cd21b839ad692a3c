"""An arm as points, axes and solids in space, to be drawn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from excitant.robots.model_check_bodies import Body, bodies
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

_POSES = 300  # tried for one in which the arm does not hide itself
_BEND = 1.9  # rad, either way, of those
_BELOW = 0.5  # how strongly points under the base count against a pose


@dataclass(frozen=True, eq=False)
class Sketch:
    """An arm in one pose, in the base frame.

    Attributes:
        pose: Positions of the joints, shape (nv,) [rad or m].
        points: Base, joints and tool, shape (nv + 2, 3) [m].
        axes: Directions of the joints, shape (nv, 3).
        solids: Number of the joint that carries it (0 for the base), both ends of its axis and
            radius of each solid, shape (k, 8) [m].
    """

    pose: Array
    points: Array
    axes: Array
    solids: Array


def zero_pose(robot: Robot) -> Array:
    """Zero, or the end of a joint's range that is nearest to it, shape (nv,) [rad or m]."""
    return np.clip(np.zeros(robot.nv), *robot.limits.position.T)


def bent_pose(robot: Robot) -> Array:
    """A pose that keeps the joints apart in a picture, always the same, shape (nv,) [rad or m]."""
    low, high = np.clip(robot.limits.position, -_BEND, _BEND).T
    low, high = np.minimum(low, robot.limits.position[:, 1]), np.maximum(low, high)
    poses = np.random.default_rng(0).uniform(low, high, (_POSES, robot.nv))
    poses[:, 0] = np.clip(0.3, *robot.limits.position[0])
    best: Array = poses[int(np.argmax([_clarity(_points(robot, q)) for q in poses]))]
    return best


def _clarity(points: Array) -> float:
    """Least distance of joints that are not neighbours, relative to the arm, less what is low."""
    gaps = np.linalg.norm(points[:, None] - points[None], axis=2)[np.triu_indices(len(points), 2)]
    size = max(float(gaps.max(initial=0.0)), 1e-9)
    meant = gaps[gaps > 1e-3 * size]  # joints that meet in a point do so in every pose
    below = float(min(points[:, 2].min(), 0.0))
    return (float(meant.min(initial=size)) + _BELOW * below) / size


def _points(robot: Robot, q: Array) -> Array:
    model, data = robot.model, robot.model.createData()
    pin.framesForwardKinematics(model, data, q)
    joints = [data.oMi[j].translation.copy() for j in range(1, robot.nv + 1)]
    return np.array([np.zeros(3), *joints, data.oMf[robot.tip].translation.copy()])


def sketch(robot: Robot, q: Array) -> Sketch:
    """The arm in a pose, shape (nv,) [rad or m]."""
    model, data = robot.model, robot.model.createData()
    J = pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    axes = np.where(robot.revolute[:, None], J[3:].T, J[:3].T)
    rows = [row for body in bodies(robot) for row in _solids(robot, data, body)]
    solids = np.array(rows) if rows else np.empty((0, 8))
    return Sketch(np.asarray(q, float), _points(robot, q), axes, solids)


def _solids(robot: Robot, data: pin.Data, body: Body) -> list[Array]:
    frame = data.oMf[robot.model.getFrameId(body.link, pin.FrameType.BODY)]
    joint = robot.links.index(body.carrier) + 1 if body.carrier else 0
    return [
        np.array([joint, *frame.act(shape.start), *frame.act(shape.end), shape.radius])
        for shape in body.shapes
    ]
