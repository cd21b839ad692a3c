"""An arm whose outer joints are held, and its motions as motions of the whole arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from excitant.design.constraints import position_range
from excitant.design.trajectory import Trajectory
from excitant.exceptions import Infeasible
from excitant.robots import Array, Robot
from excitant.robots.effects import Effect
from excitant.robots.geometry import Scene
from excitant.robots.motion import read_only

_POSES = 200  # drawn for one that keeps clear


def resting_pose(robot: Robot, scene: Scene | None, clearance: float) -> Array:
    """Where outer joints are held: zero or the middle of their ranges, unless that collides."""
    low, high = robot.limits.position.T
    middle = position_range(robot.limits)[0]
    pose = np.where((low <= 0) & (high >= 0), 0.0, middle)
    if scene is None:
        return read_only(pose)
    drawn = robot.random_motion(np.random.default_rng(0), _POSES)[0]
    for candidate in (pose, *drawn):
        if scene.distances(candidate[None]).min(initial=np.inf) > 2 * clearance:
            return read_only(candidate)
    raise Infeasible("link-by-link design", "no pose keeps the arm clear; give it more room")


def held(robot: Robot, joint: int, pose: Array) -> Robot:
    """The arm with the joints after one locked, whose links that one then carries."""
    kept, names = joint + 1, robot.joints
    if kept == robot.nv:
        return robot
    reference = pin.neutral(robot.model)
    for k, value in enumerate(pose):
        reference[robot.model.joints[k + 1].idx_q] = value
    model = pin.buildReducedModel(robot.model, list(range(kept + 1, robot.nv + 1)), reference)
    limits = {
        name: getattr(robot.limits, name)[:kept]
        for name in ("position", "velocity", "acceleration", "torque", "jerk")
    }
    locked = dict(robot.locked) | dict(zip(names[kept:], pose[kept:].tolist(), strict=True))
    return replace(
        robot,
        model=model,
        links=robot.links[:kept],
        revolute=robot.revolute[:kept],
        limits=replace(robot.limits, **limits),
        locked=tuple(sorted(locked.items())),
        effects=tuple(_kept(effect, names[:kept]) for effect in robot.effects),
    )


def _kept(effect: Effect, joints: Sequence[str]) -> Effect:
    """An effect on those of its joints that are left."""
    rows = [k for k, joint in enumerate(effect.joints) if joint in joints]
    values = effect.values
    if values is not None:
        each = np.reshape(values, (len(effect.joints), -1))
        values = tuple(each[rows].ravel().tolist())
    return replace(effect, joints=tuple(effect.joints[k] for k in rows), values=values)


def whole(trajectory: Trajectory, pose: Array) -> Trajectory:
    """A motion of the first joints as one of the arm, the other joints at their pose."""
    X = trajectory.series.constant(pose)
    X[:, : trajectory.nv] = trajectory.coefficients
    return trajectory.series.trajectory(X)
