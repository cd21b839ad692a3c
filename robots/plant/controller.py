"""The tracking controller of the plant, which believes a nominal arm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from excitant.robots.motion import Array
from excitant.robots.plant.physics import Drives
from excitant.robots.robot import Robot

Trajectory = Callable[[Array, int], Array]
"""Motion as a function of time, shape (n,) [s], and derivative order: shape (n, nv)."""

BANDWIDTH = 40.0
"""Of the closed position loop [rad/s]."""


@dataclass(frozen=True, eq=False)
class Controller:
    """Feed-forward of a model and a critically damped position loop.

    τ = τ_ff + B (ω² (q_d − q) + 2ω (q̇_d − q̇)), saturated at the torque limits.

    Attributes:
        position: Desired positions q_d, shape (n, nv).
        velocity: Desired velocities q̇_d, shape (n, nv).
        feedforward: Torque τ_ff of the model for the desired motion, shape (n, nv).
        gain: B, the mass matrix with a floor on its diagonal, shape (n, nv, nv).
        limit: Largest torque of each motor, shape (nv,).
    """

    position: Array
    velocity: Array
    feedforward: Array
    gain: Array
    limit: Array

    def __call__(self, k: int, q: Array, dq: Array) -> Array:
        """Torque at instant k in a state, shape (nv,)."""
        held: Array = np.minimum(np.maximum(self.wanted(k, q, dq), -self.limit), self.limit)
        return held

    def wanted(self, k: int, q: Array, dq: Array) -> Array:
        """Torque at instant k in a state before saturation, shape (nv,)."""
        position, velocity = self.position[k] - q, self.velocity[k] - dq
        correction: Array = self.gain[k] @ (BANDWIDTH**2 * position + 2 * BANDWIDTH * velocity)
        total: Array = self.feedforward[k] + correction
        return total


def tracking_controller(
    robot: Robot, model: pin.Model, drives: Drives, trajectory: Trajectory, t: Array
) -> Controller:
    """Controller that would follow a trajectory exactly if the model were the arm.

    A joint that moves little inertia still gets the stiffness to bear 5 % of its torque limit
    at 0.01 rad.

    Args:
        robot: The arm, for its torque limits.
        model: What the controller believes, rotor inertia as armature.
        drives: The friction it compensates.
        trajectory: Desired motion.
        t: Instants at which the controller will be asked, shape (n,) [s].
    """
    q, dq, ddq = (np.ascontiguousarray(trajectory(t, order), dtype=float) for order in range(3))
    data, limit = model.createData(), robot.limits.torque
    feedforward = drives.friction(dq)
    gain = np.empty((len(t), robot.nv, robot.nv))
    for k in range(len(t)):
        feedforward[k] += pin.rnea(model, data, q[k], dq[k], ddq[k])
        gain[k] = pin.crba(model, data, q[k])
    floor = np.where(np.isfinite(limit), 0.05 * limit / 0.01, 0.0) / BANDWIDTH**2
    diagonal = np.arange(robot.nv)
    gain[:, diagonal, diagonal] = np.maximum(gain[:, diagonal, diagonal], floor)
    return Controller(q, dq, feedforward, gain, limit)
