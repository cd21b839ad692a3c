"""Friction at the joints, and of shafts that turn with two of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from excitant.robots.effects import experiments as by
from excitant.robots.effects.base import (
    JointEffect,
    JointFacts,
    JointwiseEffect,
    PairEffect,
    Parameter,
    Shape,
    StandardEffect,
    effect_values,
    within,
)
from excitant.robots.motion import Array, Motion
from excitant.robots.regressor import rigid_torque
from excitant.robots.robot import Robot

_SLOW = 0.4  # of a joint's highest speed: a Stribeck velocity beyond it is Coulomb friction


@dataclass(frozen=True)
class ViscousFriction(StandardEffect):
    """τ = F_v q̇."""

    name = "viscous_friction"
    family = "friction"
    terms = (Parameter("Fv", "N·m·s/rad", 0.0),)
    abscissa = "velocity"
    joint_property = "viscous"
    formats = ("urdf", "mjcf", "sdf")
    told = (
        (
            by.LADDER,
            "coulomb_friction stribeck_friction nonlinear_viscous_friction asymmetric_friction",
        ),
        (by.WARM, "thermal_friction_drift"),
        (by.CURRENT, "torque_gain"),
        (by.LOADS, "load_dependent_friction"),
        (by.HOLD_OTHER, "friction_coupling"),
        (by.KINEMATICS, "encoder_scale"),
    )

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """Velocity."""
        return (dq,)


@dataclass(frozen=True)
class CoulombFriction(StandardEffect):
    """τ = F_c sign(q̇)."""

    name = "coulomb_friction"
    family = "friction"
    terms = (Parameter("Fc", "N·m", 0.0),)
    abscissa = "velocity"
    joint_property = "coulomb"
    formats = ("urdf", "mjcf", "sdf")
    format_notes: ClassVar[Mapping[str, str]] = {
        "mjcf": "frictionloss is a soft constraint: it has its full value, against the motion, "
        "once a joint slides, and turns with the velocity within some milliseconds"
    }
    told = (
        (by.LADDER, "stribeck_friction nonlinear_viscous_friction"),
        (by.AT_REST, "asymmetric_friction"),
        (by.REVERSALS, "presliding_hysteresis backlash"),
        (by.LOADS, "load_dependent_friction"),
        (by.HOLD_OTHER, "friction_coupling"),
        (by.WARM, "thermal_friction_drift"),
    )

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """Sign of the velocity."""
        return (np.sign(dq),)


@dataclass(frozen=True)
class StribeckFriction(JointEffect):
    """τ = F_s exp(−|q̇ / v_s|²) sign(q̇), on top of Coulomb friction (Armstrong-Hélouvry 1991).

    Attributes:
        velocity: Stribeck velocity v_s [rad/s].
    """

    name = "stribeck_friction"
    family = "friction"
    terms = (Parameter("Fs", "N·m", 0.0),)
    shapes = (
        Shape(
            "velocity",
            "rad/s",
            grid=lambda facts: facts.speed * np.geomspace(0.01, _SLOW, 8),
            most=lambda facts: _SLOW * facts.speed,
        ),
    )
    abscissa = "velocity"
    told = (
        (by.LADDER, "nonlinear_viscous_friction"),
        (by.REVERSALS, "presliding_hysteresis backlash"),
        (f"{by.LADDER}, at two payloads", "load_dependent_friction"),
        (by.HOLD_OTHER, "friction_coupling"),
        (by.WARM, "thermal_friction_drift"),
    )

    velocity: float = 0.1

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """Bell around zero velocity with the velocity's sign."""
        return (np.sign(dq) * np.exp(-((dq / self.velocity) ** 2)),)


@dataclass(frozen=True)
class AsymmetricFriction(JointEffect):
    """τ = F_c± sign(q̇) + F_v± q̇: friction that differs with the direction.

    Attributes:
        viscous: Whether viscous friction differs too.
    """

    name = "asymmetric_friction"
    family = "friction"
    contains = ("torque_offset", "coulomb_friction", "viscous_friction")
    imitates = ("torque_offset",)
    terms = (
        Parameter("Fc_plus", "N·m"),
        Parameter("Fc_minus", "N·m"),
        Parameter("Fv_plus", "N·m·s/rad"),
        Parameter("Fv_minus", "N·m·s/rad"),
    )
    abscissa = "velocity"
    told = (
        (f"{by.AT_REST}, and once with the motor unpowered", "torque_offset"),
        (by.LADDER, "stribeck_friction nonlinear_viscous_friction"),
        (by.LOADS, "load_dependent_friction"),
        (by.WARM, "thermal_friction_drift"),
        (by.HOLD_OTHER, "friction_coupling"),
    )

    viscous: bool = True

    @classmethod
    def candidates(cls, joint: str, facts: JointFacts) -> Iterable[Self]:
        """Coulomb friction alone, or both."""
        return cls((joint,), viscous=False), cls((joint,))

    @property
    def own_terms(self) -> tuple[Parameter, ...]:
        """Coulomb and, where asked for, viscous friction forward and backward."""
        return self.terms[: 2 + 2 * self.viscous]

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """Sign and velocity, forward and backward."""
        ahead, back = np.maximum(dq, 0.0), np.minimum(dq, 0.0)
        return (np.sign(ahead), np.sign(back), ahead, back)[: 2 + 2 * self.viscous]

    def plausible(self, robot: Robot, values: Array, std: Array) -> bool:
        """Whether friction that differs by direction, with what is given, brakes in both."""
        known = effect_values(robot)
        given = [known.get(f"{self.joints[0]}.{symbol}", 0.0) for symbol in ("Fc", "Fv")]
        return within(values + np.repeat(given, 2)[: len(values)], 0.0, std)


@dataclass(frozen=True)
class NonlinearViscousFriction(JointEffect):
    """τ = F_n |q̇|^a sign(q̇), on top of viscous friction.

    Attributes:
        exponent: a, not one.
    """

    name = "nonlinear_viscous_friction"
    family = "friction"
    contains = ("viscous_friction",)  # exponent one
    terms = (Parameter("Fn", "N·m·(s/rad)^a"),)
    shapes = (Shape("exponent", "1", grid=lambda facts: (0.3, 0.5, 0.7, 1.5, 2.0, 3.0)),)
    abscissa = "velocity"

    exponent: float = 2.0

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """Power of the speed with the velocity's sign."""
        return (np.sign(dq) * np.abs(dq) ** self.exponent,)


@dataclass(frozen=True)
class LoadDependentFriction(JointwiseEffect):
    """τ = F_l |τ_load| sign(q̇) with the torque of the bodies as load."""

    name = "load_dependent_friction"
    family = "friction"
    terms = (Parameter("Fl", "1", 0.0),)
    abscissa = "load"
    told = (
        (
            "repeat the motion backwards in time: friction turns its sign, a gain does "
            "not; then with a known payload",
            "torque_gain",
        ),
        (f"{by.REVERSALS}, at two payloads", "presliding_hysteresis"),
        (by.REVERSALS, "backlash"),
        (f"{by.LADDER}, at two payloads", "nonlinear_viscous_friction"),
        (by.HOLD_OTHER, "friction_coupling"),
    )

    def at(self, robot: Robot, motion: Motion, j: int) -> Sequence[Array]:
        """Load with the velocity's sign."""
        return (np.abs(rigid_torque(robot, motion)[:, j]) * np.sign(motion.dq[:, j]),)


@dataclass(frozen=True)
class FrictionCoupling(PairEffect):
    """Friction of a shaft that turns with both joints, at speed w = q̇_i + ρ q̇_k.

    τ_i = F_v w + F_c sign(w), τ_k = ρ τ_i, as in wrists whose motors sit in the forearm
    (Gautier, Janot, Vandanjon 2013, Stäubli TX40).

    Attributes:
        ratio: ρ.
    """

    name = "friction_coupling"
    family = "friction"
    terms = (Parameter("Fv", "N·m·s/rad", 0.0), Parameter("Fc", "N·m", 0.0))
    shapes = (Shape("ratio", "1", positive=False),)
    abscissa = "other velocity"
    told = ((by.HOLD_OTHER, "inertia_coupling"),)

    ratio: float = 1.0

    @classmethod
    def between(cls, pair: tuple[str, str]) -> Sequence[Self]:
        """Shafts that turn with the sum or the difference of both."""
        return cls(pair), cls(pair, ratio=-1.0)

    def columns(self, robot: Robot, motion: Motion) -> Array:
        """Speed and its sign in both rows."""
        i, k = self.rows(robot)
        speed = motion.dq[:, i] + self.ratio * motion.dq[:, k]
        columns = np.zeros((len(motion), robot.nv, 2))
        for row, lever in ((i, 1.0), (k, self.ratio)):
            columns[:, row, 0], columns[:, row, 1] = lever * speed, lever * np.sign(speed)
        return columns
