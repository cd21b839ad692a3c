"""Effects of what lies between motor and link: springs, elasticity, play, ripple."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from excitant.robots.effects.base import (
    Effect,
    JointEffect,
    JointFacts,
    Parameter,
    Term,
    near_trial,
)
from excitant.robots.effects.reference import rigid_torque, torque_along, torque_derivatives
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot


@dataclass(frozen=True)
class TorqueRipple(JointEffect):
    """τ = a cos(N q) + b sin(N q): cogging, tooth mesh, eccentricity.

    Attributes:
        order: N, periods per turn of the joint.
    """

    name: ClassVar[str] = "torque_ripple"
    terms: ClassVar[tuple[Term, ...]] = (
        Term("ripple_cos", "N·m"),
        Term("ripple_sin", "N·m"),
    )

    order: float = 1.0

    @classmethod
    def candidates(cls, joint: str, facts: JointFacts) -> Iterable[Self]:
        """None: orders are looked for in the error."""
        return ()

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Amplitudes, named after the order."""
        symbols = (f"ripple_cos{self.order:.4g}", f"ripple_sin{self.order:.4g}")
        return tuple(Parameter(f"{j}.{symbol}", "N·m") for j in self.joints for symbol in symbols)

    def shape(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """Cosine and sine of the angle's multiple."""
        return np.cos(self.order * q), np.sin(self.order * q)


@dataclass(frozen=True)
class Spring(JointEffect):
    """A spring beside the joint: τ = k q − k q_0, or a cos q + b sin q where it pulls a lever.

    Attributes:
        lever: Whether it pulls a lever, as in counterbalanced shoulders.
    """

    name: ClassVar[str] = "spring"
    contains: ClassVar[tuple[str, ...]] = ("torque_offset",)
    terms: ClassVar[tuple[Term, ...]] = (Term("k", "N·m/rad"), Term("moment", "N·m"))

    lever: bool = False

    @classmethod
    def candidates(cls, joint: str, facts: JointFacts) -> Iterable[Self]:
        """Both forms."""
        return cls((joint,)), cls((joint,), lever=True)

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Stiffness and moment at zero, or amplitudes of cosine and sine."""
        if not self.lever:
            return super().parameters(robot)
        symbols = ("spring_cos", "spring_sin")
        return tuple(Parameter(f"{j}.{symbol}", "N·m") for j in self.joints for symbol in symbols)

    def shape(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """Angle and one, or cosine and sine of the angle."""
        return (np.cos(q), np.sin(q)) if self.lever else (q, np.ones_like(q))


@dataclass(frozen=True)
class _Lag(Effect):
    """The link lags behind the motor, on whose side the encoder sits."""

    arity: ClassVar[int] = 1
    symbol: ClassVar[str]
    unit: ClassVar[str]

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """One coefficient."""
        return (Parameter(f"{self.joints[0]}.{self.symbol}", self.unit, 0.0),)

    def _torque_along(self, robot: Robot, motion: Motion, lag: Array) -> Array:
        j = robot.joint_index(self.joints[0])
        return torque_along(robot, motion, j, -lag)[:, :, None]


@dataclass(frozen=True)
class JointElasticity(_Lag):
    """Link angle = motor angle − c τ with the compliance c = 1/k, to first order in c."""

    name: ClassVar[str] = "joint_elasticity"
    symbol: ClassVar[str] = "compliance"
    unit: ClassVar[str] = "rad/(N·m)"

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """Change of the torque by a link angle that yields to the torque."""
        j = robot.joint_index(self.joints[0])
        return self._torque_along(robot, motion, rigid_torque(robot, motion)[:, j])


@dataclass(frozen=True)
class Backlash(_Lag):
    """Link angle = motor angle − lag, the lag within ± g / 2.

    Where the load's sign changes the link flies from one end of the gap to the other, its
    acceleration less than the motor's by the torque that nothing gives it.

    Attributes:
        trial: Gap for which the flights are computed [rad].
    """

    name: ClassVar[str] = "backlash"
    positive: ClassVar[tuple[str, ...]] = ("trial",)
    symbol: ClassVar[str] = "gap"
    unit: ClassVar[str] = "rad"

    trial: float = 3e-3

    def credible(self, robot: Robot, values: Array) -> bool:
        """Whether the gap is one that the trial gap's flights are right for."""
        return near_trial(float(values[0]), self.trial)

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """Change of the torque by the lag, per gap."""
        j = robot.joint_index(self.joints[0])
        _, _, by_ddq = torque_derivatives(robot, motion)
        acceleration = rigid_torque(robot, motion)[:, j] / by_ddq[:, j, j]
        lag = play(motion.t, acceleration, self.trial)
        return self._torque_along(robot, motion, lag / self.trial)


def play(t: Array, acceleration: Array, gap: float) -> Array:
    """Lag of a link behind its motor over time, shape (n,), within ± gap / 2.

    Args:
        t: Time, shape (n,) [s].
        acceleration: What the motor would have to give the link to take it along, shape (n,).
        gap: Width of the play.
    """
    half, lag, speed = gap / 2, gap / 2 * float(np.sign(acceleration[0]) or 1.0), 0.0
    lags = [lag]
    for h, a in zip(np.diff(t).tolist(), acceleration[1:].tolist(), strict=True):
        speed += a * h
        lag += speed * h
        if abs(lag) >= half:
            lag, speed = (half if lag > 0 else -half), 0.0
        lags.append(lag)
    return np.array(lags)
