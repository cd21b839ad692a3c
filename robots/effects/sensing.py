"""Sensing: how torque is read, and encoders that do not read the angle of their joint.

All are linear in their coefficients to first order, at the given model's torque.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from excitant.exceptions import BadInput
from excitant.robots.effects import experiments as by
from excitant.robots.effects.base import (
    Acts,
    Effect,
    JointwiseEffect,
    Parameter,
    Physics,
    Size,
    Words,
    registered,
    usual_sentence,
)
from excitant.robots.effects.search import Search, Shape
from excitant.robots.motion import Array, Motion
from excitant.robots.regressor import carried_torque, torque_along
from excitant.robots.robot import Robot

LEVELS = np.array((0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 1.0))  # of the largest torque
DELAYS = (-0.05, -0.02, -0.005, 0.002, 0.005, 0.01, 0.02, 0.04, 0.08)  # s
LONGEST_DELAY = 0.04  # s, of an alternative to another delay


def _each_then_all(joints: tuple[str, ...]) -> list[tuple[str, ...]]:
    return [*((joint,) for joint in joints), joints]


def _gain(
    effect: TorqueGain, robot: Robot, joints: Sequence[str], sizes: Sequence[Size]
) -> str:
    if len(joints) > 1:
        return usual_sentence(effect, robot, joints, sizes)
    gain = f"{100 * sizes[0].value:+.1f}{sizes[0].spread(100)} %"
    return f"{joints[0]}: torque reads {gain} against the model's"


@registered
class TorqueGain(Effect):
    """Reading = (1 + g) τ: the torque sensor's or the drive's constant is wrong."""

    name = "torque_gain"
    family = "reading"
    terms = (Parameter("gain", "1", typical=0.5),)
    physics = Physics("given torque")
    search = Search("diagnosis", places=_each_then_all)
    words = Words(
        "torque",
        {
            "inertial_parameters": f"{by.LOADS}: a gain scales its torque too",
            "payload": f"{by.LOADS} beside the unknown one",
            "gravity_direction": f"{by.LEVEL}; {by.LOADS}",
            "kinematic_error": f"{by.LOADS}; {by.KINEMATICS}",
            "encoder_scale": by.KINEMATICS,
            "encoder_offset": f"{by.ZERO}; {by.LOADS}",
        },
        sentence=_gain,
    )

    def columns(self, robot: Robot, motion: Motion) -> Array:
        columns = np.zeros((len(motion), robot.nv, 1))
        rows = self.rows(robot)
        columns[:, rows, 0] = carried_torque(robot, motion)[:, rows]
        return columns


def _between_samples(robot: Robot, motion: Motion, joints: list[int]) -> float:
    """Variance of a delay by steps of torque where dry friction turns [s²].

    A step shows at the next sample, whenever it was between the two: that is uniform, of variance
    T²/12. It has the weight of its square among the changes of torque.
    """
    tau = carried_torque(robot, motion)[:, joints]
    dq = motion.dq[:, joints]
    changes = np.diff(tau, axis=0) ** 2
    turns = dq[1:] * dq[:-1] < 0
    weight = (changes / np.maximum(changes.sum(axis=0), 1e-300))[turns]
    period = float(motion.t[1] - motion.t[0])
    return float(weight @ weight) * period**2 / 12 / len(joints) ** 2


@registered
class TimeDelay(Effect):
    """Reading(t) = τ(t − d), to first order in d around a trial delay.

    Positions that come late are a negative delay of the torque.
    """

    name = "time_delay"
    family = "reading"
    terms = (Parameter("delay", "s", typical=0.05),)
    physics = Physics("torque", between_samples=_between_samples)
    search = Search(
        shapes=(
            Shape(
                "trial",
                "s",
                positive=False,
                trial=True,
                grid=lambda facts: DELAYS,
                most=lambda facts: LONGEST_DELAY,
            ),
        ),
        places=_each_then_all,
    )
    words = Words(
        "torque rate",
        {
            "inertial_parameters encoder_scale": by.SPEEDS,
            "thermal_friction_drift": by.WARM,
        },
        sentence=lambda effect, robot, joints, sizes: (
            "The torque lags the motion by "
            f"{1e3 * sizes[0].value:.1f}{sizes[0].spread(1e3)} ms"
        ),
    )

    trial: float = 1e-3  # delay at which the column is the exact difference [s]

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.trial:
            raise BadInput(f"effect {self.name}: trial must not be zero")

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """(τ(t − d₀) − τ(t)) / d₀ at these joints."""
        tau = carried_torque(robot, motion)
        t = motion.t
        columns = np.zeros((len(motion), robot.nv, 1))
        for j in self.rows(robot):
            late = np.interp(t - self.trial, t, tau[:, j])
            columns[:, j, 0] = (late - tau[:, j]) / self.trial
        return columns


def _saturation(
    effect: MotorSaturation,
    robot: Robot,
    joints: Sequence[str],
    sizes: Sequence[Size],
) -> str:
    if len(joints) > 1:
        return usual_sentence(effect, robot, joints, sizes)
    unit = effect.shape_unit(robot, effect.search.shapes[0])
    read = f"{100 * (1 + sizes[0].value):.0f}{sizes[0].spread(100)} %"
    what = "the motor" if sizes[0].value > 0 else "the reading of torque"
    return (
        f"{joints[0]}: {what} saturates, of torque beyond {effect.level:.3g} {unit} "
        f"{read} is read"
    )


@registered
class MotorSaturation(JointwiseEffect):
    """Reading = τ + c sgn(τ) max(|τ| − L, 0): c = −1 where it stays at L.

    c < 0 where what is read ends at a limit that the torque of the motion exceeds, as that of a
    current or of a sensor; c > 0 where the iron of a motor saturates and its current grows faster
    than its torque.

    Attributes:
        level: L [N·m].
    """

    name = "motor_saturation"
    family = "reading"
    terms = (Parameter("beyond_level", "1", lower=-1.0, typical=1.0),)
    physics = Physics("torque")
    search = Search(
        shapes=(
            Shape(
                "level",
                "N·m",
                grid=lambda facts: (
                    LEVELS * facts.load if 0 < facts.load < np.inf else ()
                ),
                most=lambda facts: facts.load,
            ),
        ),
    )
    words = Words("torque", {"torque_gain": by.LOADS}, sentence=_saturation)

    level: float = 0.01

    def at(self, robot: Robot, motion: Motion, j: int) -> Sequence[Array]:
        tau = carried_torque(robot, motion)[:, j]
        return (tau - np.clip(tau, -self.level, self.level),)


class _EncoderError(Effect):
    """A joint is elsewhere than its encoder says."""

    family = "geometry"
    acts_on = Acts.ONE
    physics = Physics(smooth=True)
    search = Search("diagnosis")
    curve = "encoder"


@registered
class EncoderOffset(_EncoderError):
    """True angle = reading + δ."""

    name = "encoder_offset"
    terms = (Parameter("offset_angle", "rad", typical=0.3),)
    words = Words(
        separated_by={
            "inertial_parameters": f"{by.ZERO}; the last joint's offset is a turned last link",
            "payload": f"{by.ZERO}; or {by.UNLOADED}",
            "gravity_direction": f"{by.TURNED}: tilt's phase follows q1, "
            "an encoder's offset does not",
            "encoder_scale": f"{by.ZERO}, and at the far end of its range",
        }
    )

    def columns(self, robot: Robot, motion: Motion) -> Array:
        shift = np.ones(len(motion))
        return torque_along(robot, motion, self.rows(robot)[0], shift)


@registered
class EncoderScale(_EncoderError):
    """True angle = (1 + s) reading; speed and acceleration alike."""

    name = "encoder_scale"
    terms = (Parameter("scale", "1", typical=0.3),)
    words = Words(
        separated_by={
            "inertial_parameters": by.KINEMATICS,
        }
    )

    def columns(self, robot: Robot, motion: Motion) -> Array:
        j = self.rows(robot)[0]
        return torque_along(robot, motion, j, motion.q[:, j])


@registered
class EncoderEccentricity(_EncoderError):
    """True angle = reading + a cos q + b sin q: the encoder's disk turns about another centre."""

    name = "encoder_eccentricity"
    terms = (
        Parameter("eccentricity_cos", "rad", typical=0.1, vector="eccentricity"),
        Parameter("eccentricity_sin", "rad", typical=0.1, vector="eccentricity"),
    )
    words = Words(
        separated_by={
            "encoder_offset": f"{by.ZERO} at several angles",
            "encoder_scale": f"{by.ZERO} at several angles",
            "inertial_parameters": by.KINEMATICS,
        }
    )

    def columns(self, robot: Robot, motion: Motion) -> Array:
        j = self.rows(robot)[0]
        # a sliding joint has no turn
        q = motion.q[:, j]
        waves = robot.revolute[j] * np.array([np.cos(q), np.sin(q)])
        return torque_along(robot, motion, j, *waves)
