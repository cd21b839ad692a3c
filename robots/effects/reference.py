"""Torque of the given bodies along a motion and its derivatives: what sensing effects rest on."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pinocchio as pin

from excitant.robots.motion import Array, Motion, read_only
from excitant.robots.regressor import rigid_body_torque
from excitant.robots.robot import Robot

_KEPT = 8  # motions at a time: the segments of one diagnosis, fitted and held out


@lru_cache(maxsize=_KEPT)
def rigid_torque(robot: Robot, motion: Motion) -> Array:
    """Torque of the rigid bodies, kept for the next effect that asks, shape (n, nv) [N·m]."""
    return read_only(rigid_body_torque(robot, motion))


@lru_cache(maxsize=_KEPT)
def carried_torque(robot: Robot, motion: Motion) -> Array:
    """Torque of the bodies and of all effects that do not rest on it, shape (n, nv) [N·m]."""
    total = np.array(rigid_torque(robot, motion))
    for effect in robot.effects:
        if effect.values is not None and not effect.acts_on_torque:
            total += effect.torque(robot, motion)
    return read_only(total)


@lru_cache(maxsize=_KEPT)
def torque_derivatives(robot: Robot, motion: Motion) -> tuple[Array, Array, Array]:
    """Derivatives of the rigid-body torque by q, q̇ and q̈, each of shape (n, nv, nv).

    Row i, column j: torque of joint i by motion of joint j (Carpentier and Mansard 2018).
    """
    model, data = robot.model, robot.model.createData()
    parts = np.empty((3, len(motion), robot.nv, robot.nv))
    for k in range(len(motion)):
        parts[:, k] = pin.computeRNEADerivatives(
            model, data, motion.q[k], motion.dq[k], motion.ddq[k]
        )
    by_q, by_dq, by_ddq = (read_only(part) for part in parts)
    return by_q, by_dq, by_ddq


def torque_along(robot: Robot, motion: Motion, joint: int, shift: Array) -> Array:
    """Change of the torque per unit when one joint's true angle differs by ``shift(t)``.

    Args:
        robot: The arm.
        motion: Measured motion, its instants equidistant.
        joint: Index of the joint.
        shift: True less measured angle per unit of a coefficient, shape (n,).

    Returns:
        Shape (n, nv) [N·m per unit].
    """
    by_q, by_dq, by_ddq = torque_derivatives(robot, motion)
    rate = _rate(shift, motion.t)
    acceleration = _rate(rate, motion.t)
    changed: Array = (
        by_q[:, :, joint] * shift[:, None]
        + by_dq[:, :, joint] * rate[:, None]
        + by_ddq[:, :, joint] * acceleration[:, None]
    )
    return changed


def _rate(values: Array, t: Array) -> Array:
    """Derivative by time; zero for a single instant."""
    return np.asarray(np.gradient(values, t), float) if len(t) > 1 else np.zeros_like(values)


def gravity_torque(robot: Robot, motion: Motion, gravity: Array) -> Array:
    """Static torque of the bodies under a gravity vector in the base frame, shape (n, nv) [N·m]."""
    model = robot.with_gravity(gravity).model
    data = model.createData()
    return np.array([pin.computeGeneralizedGravity(model, data, q) for q in motion.q])
