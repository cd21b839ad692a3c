"""Motions and arms to judge the plant by, and what its recordings show beside the nominal arm."""

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
import pinocchio as pin
import scipy

from excitant.robots import Motion, Robot, torque
from excitant.robots import virtual_arm as va
from excitant.robots.urdf import robot_from_urdf

Trajectory = Callable[[np.ndarray, int], np.ndarray]

RATE = 1000.0
SMOOTH = 1e-4
"""Error of the midpoint rule relative to the largest torque: (ω h)² / 4, ω = 40 rad/s."""
PENDULUM = robot_from_urdf(
    """<robot name="pendulum"><link name="base"/>
  <link name="link"><inertial><origin xyz="0 0 -0.5"/><mass value="4"/><inertia ixx="0.1" ixy="0"
    ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
  <joint name="joint" type="revolute"><parent link="base"/><child link="link"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" velocity="10" effort="200"/></joint></robot>""",
    source="pendulum.urdf",
)


def swing(robot: Robot) -> Trajectory:
    """Out and back with other periods for each joint, from rest, within limits."""
    low, high = np.clip(robot.limits.position, -2.0, 2.0).T
    omega = 2 * np.pi * (0.35 + 0.07 * np.arange(robot.nv))
    speed = np.minimum(robot.limits.velocity, 3.0)
    amplitude = np.minimum(0.35 * (high - low) / 2, 0.35 * speed / omega)

    def trajectory(t: np.ndarray, order: int = 0) -> np.ndarray:
        phase = np.outer(t, omega) + np.pi + order * np.pi / 2
        position = (low + high) / 2 if order == 0 else 0.0
        return position + amplitude * omega**order * np.cos(phase)

    return trajectory


def swinging(robot: Robot, t: np.ndarray) -> Motion:
    return Motion(t, *(swing(robot)(t, order) for order in range(3)))


def displaced(robot: Robot, j: int, d: np.ndarray) -> Robot:
    """The robot with one joint moved in its parent's frame."""
    model = robot.model.copy()
    place = model.jointPlacements[j + 1]
    model.jointPlacements[j + 1] = pin.SE3(place.rotation, place.translation + d)
    return replace(robot, model=model)


def energy(robot: Robot, rotor: np.ndarray, motion: Motion) -> np.ndarray:
    """Potential and kinetic energy, with that of the rotors, by Pinocchio, shape (n,)."""
    model, data = robot.model, robot.model.createData()
    bodies = [
        pin.computeKineticEnergy(model, data, q, v) + pin.computePotentialEnergy(model, data, q)
        for q, v in zip(motion.q, motion.dq, strict=True)
    ]
    return motion.dq**2 @ rotor / 2 + bodies


def mujoco_model(robot: Robot) -> mujoco.MjModel:
    """MuJoCo's model of the bodies alone, without contacts and limits."""
    spec, without = mujoco.MjSpec.from_string(robot.description), mujoco.mjtDisableBit
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    spec.option.timestep, spec.option.gravity = 1e-3, robot.gravity
    spec.option.disableflags = without.mjDSBL_CONTACT | without.mjDSBL_LIMIT
    return spec.compile()


def inverse_dynamics(model: mujoco.MjModel, joints: tuple[str, ...], motion: Motion) -> np.ndarray:
    """Torque of some joints at every instant by MuJoCo, all others at their reference."""
    data, tau = mujoco.MjData(model), []
    at, rows = np.array([(model.joint(j).qposadr[0], model.joint(j).dofadr[0]) for j in joints]).T
    for q, dq, ddq in zip(motion.q, motion.dq, motion.ddq, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = model.qpos0, 0, 0
        data.qpos[at], data.qvel[rows], data.qacc[rows] = q, dq, ddq
        mujoco.mj_inverse(model, data)
        tau.append(data.qfrc_inverse[rows])
    return np.array(tau)


def true_arm(
    robot: Robot, *effects: va.HiddenEffect, rate: float = RATE, sensors: va.Sensors | None = None
) -> va.VirtualArm:
    """A virtual arm that is the nominal one but for the hidden effects, by default truly seen."""
    rng, sensors = np.random.default_rng(0), sensors or va.ideal_sensors(robot, rate)
    return va.virtual_arm(robot, rng, hidden=effects, sensors=sensors, tolerance=0.0)


def steady(values: np.ndarray) -> np.ndarray:
    """Rows around which no sign changes."""
    filters = (scipy.ndimage.minimum_filter1d, scipy.ndimage.maximum_filter1d)
    low, high = (limit(np.sign(values), 17, axis=0) for limit in filters)
    return (low == high).reshape(len(values), -1).all(axis=1)


class Recorded:
    """A recording with true sensors, and what it shows beside the nominal arm."""

    def __init__(
        self, robot: Robot, *effects: va.HiddenEffect, duration: float = 2.0, rate: float = RATE
    ) -> None:
        arm = true_arm(robot, *effects, rate=rate)
        table = arm.record(swing(robot), duration, np.random.default_rng(0))
        q, dq, tau = (table.filter(regex=rf"^{c}\d").to_numpy() for c in ("q", "dq", "tau"))
        ddq = scipy.signal.savgol_filter(dq, 7, 6, deriv=1, delta=1 / rate, axis=0)
        self.robot, self.table, inner = robot, table, slice(3, -3)
        self.motion, self.tau = Motion(table["t"].to_numpy(), q, dq, ddq)[inner], tau[inner]

    @property
    def rest(self) -> np.ndarray:
        """Recorded torque beside the nominal arm's, shape (n, nv)."""
        return self.tau - torque(self.robot, self.motion)

    @property
    def sliding(self) -> np.ndarray:
        """Rows where the acceleration has no jump, from reversals or from the controller."""
        t, dq = self.motion.t, self.motion.dq
        calm = steady(np.hstack([dq, swing(self.robot)(t, 1)])) & (np.abs(dq) > 1e-3).all(axis=1)
        calm[:40] = False
        return calm

    def agree(
        self, expected: np.ndarray, share: float = 1e-3, where: np.ndarray | bool = True
    ) -> None:
        """The rest is what is expected, wherever the arm slides."""
        rows = self.sliding & where
        assert rows.mean() > 0.4
        tolerance = share * np.abs(expected[rows]).max() + SMOOTH * np.abs(self.tau).max()
        assert np.abs((self.rest - expected)[rows]).max() <= tolerance
