"""Effects of sensors and of what is believed about the arm's geometry and mounting.

All are linear in their coefficients to first order, at the given model's torque.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from excitant.exceptions import BadInput
from excitant.robots.effects.base import Effect, Parameter, near_trial
from excitant.robots.effects.reference import (
    carried_torque,
    gravity_torque,
    torque_along,
)
from excitant.robots.motion import Array, Motion
from excitant.robots.regressor import rigid_body_torque
from excitant.robots.robot import Robot

_METRE = 1e-3  # of the central difference; torque is quadratic in a placement, so any would do


@dataclass(frozen=True)
class _SharedEffect(Effect):
    """One coefficient for all joints it acts on."""

    symbol: ClassVar[str]
    unit: ClassVar[str]
    typical: ClassVar[float]

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """One coefficient, named after the joint, or after none where it is common."""
        owner = self.joints[0] if len(self.joints) == 1 else "common"
        return (Parameter(f"{owner}.{self.symbol}", self.unit, typical=self.typical),)

    def rows(self, robot: Robot) -> list[int]:
        """Indices of the joints."""
        return [robot.joint_index(joint) for joint in self.joints]


@dataclass(frozen=True)
class TorqueGain(_SharedEffect):
    """Reading = (1 + g) τ: the torque sensor's or the drive's constant is wrong."""

    name: ClassVar[str] = "torque_gain"
    acts_on_torque: ClassVar[bool] = True
    symbol: ClassVar[str] = "gain"
    unit: ClassVar[str] = "1"
    typical: ClassVar[float] = 0.5

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """Torque of the model at these joints."""
        columns, rows = np.zeros((len(motion), robot.nv, 1)), self.rows(robot)
        columns[:, rows, 0] = carried_torque(robot, motion)[:, rows]
        return columns


@dataclass(frozen=True)
class TimeDelay(_SharedEffect):
    """Reading(t) = τ(t − d), to first order in d around a trial delay.

    Positions that come late are a negative delay of the torque.

    Attributes:
        trial: Delay at which the column is the exact difference [s].
    """

    name: ClassVar[str] = "time_delay"
    acts_on_torque: ClassVar[bool] = True
    symbol: ClassVar[str] = "delay"
    unit: ClassVar[str] = "s"
    typical: ClassVar[float] = 0.05

    trial: float = 1e-3

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.trial:
            raise BadInput(f"effect {self.name}: trial must not be zero")

    def credible(self, robot: Robot, values: Array) -> bool:
        """Whether the delay is one that the trial delay's column is right for."""
        return near_trial(float(values[0]), self.trial)

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """(τ(t − d₀) − τ(t)) / d₀ at these joints."""
        tau, t = carried_torque(robot, motion), motion.t
        columns = np.zeros((len(motion), robot.nv, 1))
        for j in self.rows(robot):
            late = np.interp(t - self.trial, t, tau[:, j])
            columns[:, j, 0] = (late - tau[:, j]) / self.trial
        return columns


@dataclass(frozen=True)
class EncoderOffset(_SharedEffect):
    """True angle = reading + δ."""

    name: ClassVar[str] = "encoder_offset"
    arity: ClassVar[int] = 1
    symbol: ClassVar[str] = "offset_angle"
    unit: ClassVar[str] = "rad"
    typical: ClassVar[float] = 0.3

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """Derivative of the torque by the angle."""
        shift = np.ones(len(motion))
        return torque_along(robot, motion, self.rows(robot)[0], shift)[:, :, None]


@dataclass(frozen=True)
class EncoderScale(_SharedEffect):
    """True angle = (1 + s) reading."""

    name: ClassVar[str] = "encoder_scale"
    arity: ClassVar[int] = 1
    symbol: ClassVar[str] = "scale"
    unit: ClassVar[str] = "1"
    typical: ClassVar[float] = 0.3

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """Derivative of the torque by the scale of angle, speed and acceleration."""
        j = self.rows(robot)[0]
        return torque_along(robot, motion, j, motion.q[:, j])[:, :, None]


@dataclass(frozen=True)
class KinematicError(Effect):
    """The joint sits elsewhere in its parent link than the model says."""

    name: ClassVar[str] = "kinematic_error"
    arity: ClassVar[int] = 1

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Translation in the parent's joint frame."""
        return tuple(Parameter(f"{self.joints[0]}.d{axis}", "m", typical=0.1) for axis in "xyz")

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """Central differences by the translation."""
        j = robot.joint_index(self.joints[0])
        parts = []
        for step in _METRE * np.eye(3):
            ahead, behind = (rigid_body_torque(_moved(robot, j, s * step), motion) for s in (1, -1))
            parts.append((ahead - behind) / (2 * _METRE))
        return np.stack(parts, axis=2)


def _moved(robot: Robot, j: int, step: Array) -> Robot:
    model = robot.model.copy()
    model.jointPlacements[j + 1].translation = model.jointPlacements[j + 1].translation + step
    return robot.with_model(model)


@dataclass(frozen=True)
class GravityDirection(Effect):
    """Gravity points elsewhere in the base frame: the arm is mounted otherwise, or tilted."""

    name: ClassVar[str] = "gravity_direction"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Change of the gravity vector in the base frame."""
        return tuple(Parameter(f"gravity.d{axis}", "m/s²", typical=10.0) for axis in "xyz")

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """Static torque under unit gravity along each axis."""
        return np.stack([gravity_torque(robot, motion, unit) for unit in np.eye(3)], axis=2)
