"""Recordings of the plant with true sensors, and what inverse dynamics says about them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from excitant.robots import Motion, Robot
from excitant.robots.plant.planting import STRUCTURES
from excitant.robots.virtual_arm import (
    HiddenEffect,
    Sensors,
    VirtualArm,
    ideal_sensors,
    virtual_arm,
)

Trajectory = Callable[[np.ndarray, int], np.ndarray]

RATE = 1000.0
STENCIL = np.array([-1 / 60, 3 / 20, -3 / 4, 0, 3 / 4, -3 / 20, 1 / 60]) * RATE
"""Central difference of sixth order."""
SMOOTH = 1e-4
"""Error of the midpoint rule relative to the largest torque: (ω h)² / 4, ω = 40 rad/s."""


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


def hidden(kind: str, *joints: str, **parameters: float) -> HiddenEffect:
    effect, structure = ("unknown", kind) if kind in STRUCTURES else (kind, "")
    several = joints if len(joints) > 1 else ()
    return HiddenEffect(effect, (*joints, "")[0], tuple(parameters.items()), several, structure)


def away_from_changes(flags: np.ndarray, width: int = 8) -> np.ndarray:
    """Rows around which a flag stays what it is."""
    same = np.ones(len(flags), dtype=bool)
    for shift in range(-width, width + 1):
        same &= np.roll(flags, shift) == flags
    return same


def hold(robot: Robot) -> Trajectory:
    """Standing still somewhere."""
    low, high = np.clip(robot.limits.position, -2.0, 2.0).T
    place = low + 0.4 * (high - low)
    return lambda t, order=0: np.ones((len(t), 1)) * place * (order == 0)


def true_arm(robot: Robot, *effects: HiddenEffect, sensors: Sensors | None = None) -> VirtualArm:
    """A virtual arm that is the nominal one but for the hidden effects."""
    sensors = sensors or ideal_sensors(robot, RATE)
    rng = np.random.default_rng(0)
    return virtual_arm(robot, rng, hidden=effects, sensors=sensors, tolerance=0.0)


class Recorded:
    """A recording with true sensors and what inverse dynamics says about it."""

    def __init__(
        self,
        robot: Robot,
        *effects: HiddenEffect,
        duration: float = 2.0,
        trajectory: Trajectory | None = None,
        sensors: Sensors | None = None,
    ) -> None:
        rng = np.random.default_rng(0)
        arm = true_arm(robot, *effects, sensors=sensors)
        table = arm.record(trajectory or swing(robot), duration, rng)
        self.robot, self.table = robot, table
        n = range(1, robot.nv + 1)
        q, dq, tau = (table[[f"{c}{j}" for j in n]].to_numpy() for c in ("q", "dq", "tau"))
        windows = np.lib.stride_tricks.sliding_window_view(dq, 7, axis=0)
        rows = slice(3, len(q) - 3)
        self.t, self.q, self.dq, self.tau = (
            table["t"].to_numpy()[rows],
            q[rows],
            dq[rows],
            tau[rows],
        )
        self.ddq = windows @ STENCIL

    @property
    def motion(self) -> Motion:
        """The recorded motion."""
        return Motion(self.t, self.q, self.dq, self.ddq)

    def rigid(self, robot: Robot | None = None) -> np.ndarray:
        """Pinocchio's torque for the motion, without friction and rotors."""
        model = (robot or self.robot).model
        data, states = model.createData(), zip(self.q, self.dq, self.ddq, strict=True)
        return np.array([pin.rnea(model, data, *state) for state in states])

    def drives(self) -> np.ndarray:
        """Torque of the nominal friction and rotors."""
        known = {e.name: np.array(e.values) for e in self.robot.effects[:3]}
        return (
            known["viscous_friction"] * self.dq
            + known["coulomb_friction"] * np.sign(self.dq)
            + known["rotor_inertia"] * self.ddq
        )

    @property
    def rest(self) -> np.ndarray:
        """Recorded torque beside the nominal arm's, shape (n, nv)."""
        return self.tau - self.rigid() - self.drives()

    @property
    def sliding(self) -> np.ndarray:
        """Rows where the acceleration has no jump, from reversals or from the controller."""
        calm = (np.abs(self.dq) > 1e-3).all(axis=1)
        for speed in (*self.dq.T, *swing(self.robot)(self.t, 1).T):
            calm &= away_from_changes(np.sign(speed))
        calm[:40] = False
        return calm

    def agree(
        self, expected: np.ndarray, share: float = 1e-3, where: np.ndarray | None = None
    ) -> None:
        """The rest is what is expected, wherever the arm slides."""
        rows = self.sliding if where is None else self.sliding & where
        assert rows.mean() > 0.4
        tolerance = share * np.abs(expected[rows]).max() + SMOOTH * np.abs(self.tau).max()
        assert np.abs((self.rest - expected)[rows]).max() <= tolerance


def at(robot: Robot, j: int, values: np.ndarray) -> np.ndarray:
    """These values in joint j, zero elsewhere."""
    full = np.zeros((len(values), robot.nv))
    full[:, j] = values
    return full
