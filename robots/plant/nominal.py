"""The nominal arm as a truth of the plant, its typical torque, and sensors that suit it."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from excitant.robots.motion import Array, read_only
from excitant.robots.plant.friction import Drives
from excitant.robots.plant.known import described
from excitant.robots.plant.planting import plant
from excitant.robots.plant.sensors import Sensors
from excitant.robots.plant.truth import Truth, rigid_truth
from excitant.robots.robot import Robot


def nominal_truth(robot: Robot) -> Truth:
    """Rigid bodies and drives of the robot as described, with its effects.

    Raises:
        BadRobot: An effect without values.
        UnknownName: An effect that the virtual arm does not have.
    """
    known = [hidden for effect in robot.effects for hidden in described(robot, effect)]
    zeros = np.zeros(robot.nv)
    still = Drives(zeros, zeros, zeros, np.full(robot.nv, 0.1), zeros, zeros)
    return plant(rigid_truth(robot.model.copy(), still, robot.tip), robot.joints, known)


def industrial_sensors(robot: Robot, rate_hz: float = 250.0) -> Sensors:
    """17-bit encoders, and torque from motor current with a noise of 0.3 % of the limit."""
    typical = 4 * typical_torque(robot)
    scale = np.where(np.isfinite(robot.limits.torque), robot.limits.torque, typical)
    return Sensors(rate_hz, 2 * np.pi / 2**17, 2e-3, 3e-3 * scale, 3e-4 * scale)


def ideal_sensors(robot: Robot, rate_hz: float = 250.0) -> Sensors:
    """Sensors that tell the truth."""
    return Sensors(rate_hz, 0.0, 0.0, np.zeros(robot.nv), np.zeros(robot.nv))


def typical_torque(robot: Robot) -> Array:
    """Root mean square torque at moderate speeds, shape (nv,) [N·m]."""
    truth = nominal_truth(robot)
    model, drives = truth.model, truth.drives
    data, q, dq, ddq = model.createData(), *typical_motion(robot)
    tau = drives.friction(dq) + [pin.rnea(model, data, *x) for x in zip(q, dq, ddq, strict=True)]
    return read_only(np.sqrt(np.mean(tau**2, axis=0)))


def typical_motion(robot: Robot) -> tuple[Array, Array, Array]:
    """Random states at half the limits of velocity and acceleration, each (200, nv)."""
    q, dq, ddq = robot.random_motion(np.random.default_rng(0), 200)
    return q, dq / 2, ddq / 2
