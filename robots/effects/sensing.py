"""Effects of sensors and of what is believed about the arm's geometry and mounting.

All are linear in their coefficients to first order, at the given model's torque.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from excitant.exceptions import BadInput
from excitant.robots.effects import experiments as by
from excitant.robots.effects.base import (
    SIGN_DEVIATIONS,
    Effect,
    JointFacts,
    Parameter,
    Shape,
)
from excitant.robots.motion import Array, Motion
from excitant.robots.regressor import (
    carried_torque,
    gravity_torque,
    rigid_body_torque,
    torque_along,
)
from excitant.robots.robot import Robot

_DELAYS = (-0.05, -0.02, -0.005, 0.002, 0.005, 0.01, 0.02, 0.04, 0.08)  # s
_LONGEST = 0.04  # s, of a delay where another is at work
_TURNED = 0.05  # of 9.81 m/s², by which a turned gravity may differ in size
_METRE = 1e-3  # of the central difference; torque is quadratic in a placement, so any would do


@dataclass(frozen=True)
class _GeometryEffect(Effect):
    """A joint is elsewhere than its encoder or the model says."""

    family = "geometry"
    arity = 1
    of_state_alone = False
    further = False


@dataclass(frozen=True)
class _ReadingEffect(Effect):
    """One coefficient of the torque readings of one joint, or of all."""

    family = "reading"
    acts_on_torque = True
    of_state_alone = False

    @classmethod
    def proposed(cls, robot: Robot, facts: Sequence[JointFacts]) -> list[tuple[Self, int]]:
        """Of each joint, then of all."""
        of_all = cls.candidates(robot.joints[0], facts[0])
        everywhere = [(replace(effect, joints=robot.joints), 1) for effect in of_all]
        return super().proposed(robot, facts) + everywhere


@dataclass(frozen=True)
class TorqueGain(_ReadingEffect):
    """Reading = (1 + g) τ: the torque sensor's or the drive's constant is wrong."""

    name = "torque_gain"
    further = False
    of_given_torque = True
    terms = (Parameter("gain", "1", typical=0.5),)
    abscissa = "torque"
    told = (
        (f"{by.LOADS}: a gain scales its torque too", "inertial_parameters"),
        (f"{by.LOADS} beside the unknown one", "payload"),
        (f"{by.LEVEL}; {by.LOADS}", "gravity_direction"),
        (f"{by.LOADS}; {by.KINEMATICS}", "kinematic_error"),
        (by.KINEMATICS, "encoder_scale"),
        (f"{by.ZERO}; {by.LOADS}", "encoder_offset"),
    )

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """Torque of the model at these joints."""
        columns, rows = np.zeros((len(motion), robot.nv, 1)), self.rows(robot)
        columns[:, rows, 0] = carried_torque(robot, motion)[:, rows]
        return columns

    def sentence(self, robot: Robot, joints: Sequence[str], given: Sequence[float]) -> str:
        """By how much readings of one joint are off."""
        if len(joints) > 1:
            return super().sentence(robot, joints, given)
        return f"{joints[0]}: torque reads {100 * self._known()[0]:+.1f} % against the model's"


@dataclass(frozen=True)
class TimeDelay(_ReadingEffect):
    """Reading(t) = τ(t − d), to first order in d around a trial delay.

    Positions that come late are a negative delay of the torque.

    Attributes:
        trial: Delay at which the column is the exact difference [s].
    """

    name = "time_delay"
    terms = (Parameter("delay", "s", typical=0.05),)
    shapes = (
        Shape(
            "trial",
            "s",
            positive=False,
            trial=True,
            grid=lambda facts: _DELAYS,
            most=lambda facts: _LONGEST,
        ),
    )
    abscissa = "torque rate"
    told = (
        (by.SPEEDS, "inertial_parameters encoder_scale"),
        (by.WARM, "thermal_friction_drift"),
    )

    trial: float = 1e-3

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.trial:
            raise BadInput(f"effect {self.name}: trial must not be zero")

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """(τ(t − d₀) − τ(t)) / d₀ at these joints."""
        tau, t = carried_torque(robot, motion), motion.t
        columns = np.zeros((len(motion), robot.nv, 1))
        for j in self.rows(robot):
            late = np.interp(t - self.trial, t, tau[:, j])
            columns[:, j, 0] = (late - tau[:, j]) / self.trial
        return columns

    def sentence(self, robot: Robot, joints: Sequence[str], given: Sequence[float]) -> str:
        """How late it is."""
        return f"The torque lags the motion by {1e3 * self._known()[0]:.1f} ms"


@dataclass(frozen=True)
class EncoderOffset(_GeometryEffect):
    """True angle = reading + δ."""

    name = "encoder_offset"
    terms = (Parameter("offset_angle", "rad", typical=0.3),)
    told = (
        (f"{by.ZERO}; the last joint's offset is a turned last link", "inertial_parameters"),
        (f"{by.ZERO}; or {by.UNLOADED}", "payload"),
        (
            f"{by.TURNED}: tilt's phase follows q1, an encoder's offset does not",
            "gravity_direction",
        ),
        (f"{by.ZERO}, and at the far end of its range", "encoder_scale"),
    )

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """Derivative of the torque by the angle."""
        shift = np.ones(len(motion))
        return torque_along(robot, motion, self.rows(robot)[0], shift)[:, :, None]


@dataclass(frozen=True)
class EncoderScale(_GeometryEffect):
    """True angle = (1 + s) reading."""

    name = "encoder_scale"
    terms = (Parameter("scale", "1", typical=0.3),)
    told = ((by.KINEMATICS, "inertial_parameters"),)

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """Derivative of the torque by the scale of angle, speed and acceleration."""
        j = self.rows(robot)[0]
        return torque_along(robot, motion, j, motion.q[:, j])[:, :, None]


@dataclass(frozen=True)
class KinematicError(_GeometryEffect):
    """The joint sits elsewhere in its parent link than the model says."""

    name = "kinematic_error"
    terms = tuple(Parameter(f"d{axis}", "m", typical=0.1) for axis in "xyz")
    told = (
        (f"{by.KINEMATICS}; or repeat the motion in another pose region", "inertial_parameters"),
        (by.UNLOADED, "payload"),
        (f"{by.LEVEL}; {by.KINEMATICS}", "gravity_direction"),
    )

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """Central differences by the translation."""
        j = self.rows(robot)[0]
        parts = []
        for step in _METRE * np.eye(3):
            ahead, behind = (rigid_body_torque(_moved(robot, j, s * step), motion) for s in (1, -1))
            parts.append((ahead - behind) / (2 * _METRE))
        return np.stack(parts, axis=2)

    def sentence(self, robot: Robot, joints: Sequence[str], given: Sequence[float]) -> str:
        """How far off it is."""
        far = 1e3 * float(np.linalg.norm(self._known()))
        return f"The axis of {joints[0]} seems {far:.0f} mm off where the model has it"


def _moved(robot: Robot, j: int, step: Array) -> Robot:
    model = robot.model.copy()
    model.jointPlacements[j + 1].translation = model.jointPlacements[j + 1].translation + step
    return robot.with_model(model)


@dataclass(frozen=True)
class GravityDirection(Effect):
    """Gravity points elsewhere in the base frame: the arm is mounted otherwise, or tilted."""

    name = "gravity_direction"
    terms = tuple(Parameter(f"d{axis}", "m/s²", typical=10.0) for axis in "xyz")
    family = "static"
    further = False
    told = (
        (
            f"{by.LEVEL}; or turn the first joint slowly with the arm stretched",
            "inertial_parameters",
        ),
        (f"{by.UNLOADED}; {by.LEVEL}", "payload"),
    )

    @classmethod
    def proposed(cls, robot: Robot, facts: Sequence[JointFacts]) -> list[tuple[Self, int]]:
        """One for the arm."""
        return [(cls(robot.joints), 1)]

    def owners(self, robot: Robot) -> tuple[str, ...]:
        """The arm's one gravity."""
        return ("gravity",)

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """Static torque under unit gravity along each axis."""
        return np.stack([gravity_torque(robot, motion, unit) for unit in np.eye(3)], axis=2)

    def plausible(self, robot: Robot, values: Array, std: Array) -> bool:
        """Whether the changed vector is still as long as gravity."""
        size = float(np.linalg.norm(robot.gravity))
        off = abs(float(np.linalg.norm(robot.gravity + values)) - size)
        unsure = SIGN_DEVIATIONS * float(np.linalg.norm(std))
        return off < _TURNED * size + min(unsure, _TURNED * size)

    def applied(self, robot: Robot) -> Robot:
        """The robot under the changed vector."""
        return robot.with_gravity(robot.gravity + self._known())

    def sentence(self, robot: Robot, joints: Sequence[str], given: Sequence[float]) -> str:
        """The vector."""
        true = ", ".join(f"{x:.2f}" for x in robot.gravity + self._known())
        return f"Gravity points along ({true}) m/s² in the base frame"
