"""How an arm moves typically, and the torque it needs for that: the measure of drawn effects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from excitant.robots.motion import Array, freeze
from excitant.robots.plant.controller import Trajectory
from excitant.robots.plant.nominal import nominal_truth
from excitant.robots.robot import Robot

_HARMONICS = 5
_SHARE = 0.7  # of the limits of velocity and acceleration, used at most
_REACH = 0.8  # of the range of position
_TORQUE = 0.7  # of the limits of torque


def typical_trajectory(robot: Robot, rng: np.random.Generator, duration: float) -> Trajectory:
    """A random periodic motion from rest to rest, within the limits of the nominal arm.

    q(t) = q_0 + Σ a_k (cos ω_k t − 1) with random a_k; drawn again, and smaller, while it asks
    for more than 70 % of a torque limit.

    Args:
        robot: The arm.
        rng: Source of randomness.
        duration: Period [s].
    """
    omega: Array = 2 * np.pi * np.arange(1.0, _HARMONICS + 1.0) / duration
    low, high = np.clip(robot.limits.position, -np.pi, np.pi).T
    speed = np.where(np.isfinite(robot.limits.velocity), robot.limits.velocity, 3.0)
    acceleration = np.where(np.isfinite(robot.limits.acceleration), robot.limits.acceleration, 20.0)
    t: Array = np.linspace(0.0, duration, 400)
    share = _SHARE
    for _ in range(40):
        a = rng.standard_normal((_HARMONICS, robot.nv)) / np.arange(1, _HARMONICS + 1)[:, None]
        spread = np.ptp(_cosines(omega, a, t, 0), axis=0)
        fastest, hardest = (np.abs(_cosines(omega, a, t, n)).max(axis=0) for n in (1, 2))
        a *= np.minimum.reduce(
            [_REACH * (high - low) / spread, share * np.minimum(speed, 4.0) / fastest,
             share * np.minimum(acceleration, 20.0) / hardest]
        )  # fmt: skip
        swing = _cosines(omega, a, t, 0)
        start = rng.uniform(low - swing.min(axis=0), high - swing.max(axis=0))
        trajectory = _path(start, omega, a)
        if _torque_share(robot, trajectory, t) <= _TORQUE:
            break
        share *= 0.93
    return trajectory


def _cosines(omega: Array, a: Array, t: Array, order: int) -> Array:
    phase = np.outer(t, omega) + order * np.pi / 2
    values: Array = (np.cos(phase) - (order == 0)) @ (omega[:, None] ** order * a)
    return values


def _path(start: Array, omega: Array, a: Array) -> Trajectory:
    def trajectory(t: Array, order: int = 0) -> Array:
        moved = _cosines(omega, a, np.asarray(t, dtype=float), order)
        return start + moved if order == 0 else moved

    return trajectory


def _torque_share(robot: Robot, trajectory: Trajectory, t: Array) -> float:
    truth = nominal_truth(robot)
    data, states = truth.model.createData(), [trajectory(t[::4], order) for order in range(3)]
    tau = truth.drives.friction(states[1])
    tau = tau + [pin.rnea(truth.model, data, *x) for x in zip(*states, strict=True)]
    return float(np.max(np.abs(tau) / robot.limits.torque))


@dataclass(frozen=True, eq=False)
class Habits:
    """A typical motion of an arm; arrays of samples have shape (n, nv).

    Attributes:
        robot: The nominal arm.
        q: Positions.
        dq: Velocities.
        ddq: Accelerations.
        tau: Torque of the nominal arm [N·m].
        load: The same without friction and rotors [N·m].
        tip: Positions of the tip in the base frame, shape (n, 3) [m].
        coulomb: Dry friction of the nominal arm, shape (nv,) [N·m].
        inertia: Mean of each joint's own entry of the mass matrix, shape (nv,) [kg·m²].
        rotor: Rotor inertia of the nominal arm, shape (nv,) [kg·m²].
        wanted: Torque that an effect should make, shape (nv,) [N·m].
    """

    robot: Robot
    q: Array
    dq: Array
    ddq: Array
    tau: Array
    load: Array
    tip: Array
    coulomb: Array
    inertia: Array
    rotor: Array
    wanted: Array

    def __post_init__(self) -> None:
        freeze(self, "q", "dq", "ddq", "tau", "load", "tip", "coulomb", "inertia", "rotor")
        freeze(self, "wanted")

    @property
    def nv(self) -> int:
        """Number of joints."""
        return self.robot.nv

    @property
    def size(self) -> float:
        """Longest distance of the tip from the origin on the motion, at least 0.1 m."""
        return max(float(np.linalg.norm(self.tip, axis=1).max()), 0.1)


def habits(robot: Robot, trajectory: Trajectory, duration: float, wanted: Array) -> Habits:
    """What an arm does on a motion.

    Args:
        robot: The nominal arm.
        trajectory: Its motion.
        duration: Length of the motion [s].
        wanted: Torque that an effect should make, shape (nv,) [N·m].
    """
    truth = nominal_truth(robot)
    model, bare, t = truth.model, truth.model.copy(), np.linspace(0.0, duration, 300)
    bare.armature = np.zeros(robot.nv)
    data, q, dq, ddq = model.createData(), *(trajectory(t, order) for order in range(3))
    tau, load, tip, inertia = (np.zeros((len(t), k)) for k in (robot.nv, robot.nv, 3, robot.nv))
    for k, state in enumerate(zip(q, dq, ddq, strict=True)):
        tau[k] = pin.rnea(model, data, *state) + truth.drives.friction(dq[k])
        load[k] = pin.rnea(bare, data, *state)
        inertia[k] = np.diag(pin.crba(bare, data, q[k]))
        pin.forwardKinematics(model, data, q[k])
        tip[k] = pin.updateFramePlacement(model, data, robot.tip).translation
    coulomb, rotor = truth.drives.coulomb, truth.drives.rotor
    mean = inertia.mean(axis=0)
    return Habits(robot, q, dq, ddq, tau, load, tip, coulomb, mean, rotor, wanted)
