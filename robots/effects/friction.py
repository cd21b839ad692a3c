"""Friction at the joints."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from excitant.robots.effects.base import (
    JointEffect,
    JointFacts,
    JointwiseEffect,
    Shape,
    Term,
    effect_values,
    within,
)
from excitant.robots.effects.experiments import (
    AT_REST,
    CURRENT,
    HOLD_OTHER,
    KINEMATICS,
    LADDER,
    LOADS,
    REVERSALS,
    SPEEDS,
    WARM,
)
from excitant.robots.effects.reference import rigid_torque
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot

_SLOW = 0.4  # of a joint's highest speed: a Stribeck velocity beyond it is Coulomb friction


@dataclass(frozen=True)
class ViscousFriction(JointEffect):
    """τ = F_v q̇."""

    name: ClassVar[str] = "viscous_friction"
    family: ClassVar[str] = "friction"
    terms: ClassVar[tuple[Term, ...]] = (Term("Fv", "N·m·s/rad", 0.0),)
    standard: ClassVar[bool] = True
    usual: ClassVar[bool] = True
    further: ClassVar[bool] = False
    abscissa: ClassVar[str] = "velocity"
    joint_property: ClassVar[str] = "viscous"
    formats: ClassVar[tuple[str, ...]] = ("urdf", "mjcf", "sdf")
    told: ClassVar[Mapping[str, str]] = {
        "coulomb_friction": LADDER,
        "stribeck_friction": LADDER,
        "nonlinear_viscous_friction": LADDER,
        "time_delay": SPEEDS,
        "thermal_friction_drift": WARM,
        "asymmetric_friction": LADDER,
        "torque_gain": CURRENT,
        "load_dependent_friction": LOADS,
        "friction_coupling": HOLD_OTHER,
        "encoder_scale": KINEMATICS,
    }

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """Velocity."""
        return (dq,)


@dataclass(frozen=True)
class CoulombFriction(JointEffect):
    """τ = F_c sign(q̇)."""

    name: ClassVar[str] = "coulomb_friction"
    family: ClassVar[str] = "friction"
    terms: ClassVar[tuple[Term, ...]] = (Term("Fc", "N·m", 0.0),)
    standard: ClassVar[bool] = True
    usual: ClassVar[bool] = True
    further: ClassVar[bool] = False
    abscissa: ClassVar[str] = "velocity"
    joint_property: ClassVar[str] = "coulomb"
    formats: ClassVar[tuple[str, ...]] = ("urdf", "mjcf", "sdf")
    format_notes: ClassVar[Mapping[str, str]] = {
        "mjcf": "frictionloss is a soft constraint: it has its full value, against the motion, "
        "once a joint slides, and turns with the velocity within some milliseconds"
    }
    told: ClassVar[Mapping[str, str]] = {
        "stribeck_friction": LADDER,
        "torque_offset": AT_REST,
        "asymmetric_friction": AT_REST,
        "presliding_hysteresis": REVERSALS,
        "load_dependent_friction": LOADS,
        "backlash": REVERSALS,
        "friction_coupling": HOLD_OTHER,
        "thermal_friction_drift": WARM,
        "nonlinear_viscous_friction": LADDER,
    }

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """Sign of the velocity."""
        return (np.sign(dq),)


@dataclass(frozen=True)
class StribeckFriction(JointEffect):
    """τ = F_s exp(−|q̇ / v_s|²) sign(q̇), on top of Coulomb friction (Armstrong-Hélouvry 1991).

    Attributes:
        velocity: Stribeck velocity v_s [rad/s].
    """

    name: ClassVar[str] = "stribeck_friction"
    family: ClassVar[str] = "friction"
    terms: ClassVar[tuple[Term, ...]] = (Term("Fs", "N·m", 0.0),)
    shapes: ClassVar[tuple[Shape, ...]] = (
        Shape("velocity", "rad/s", most=lambda facts: _SLOW * facts.speed),
    )
    shared: ClassVar[bool] = True
    abscissa: ClassVar[str] = "velocity"
    told: ClassVar[Mapping[str, str]] = {
        "nonlinear_viscous_friction": LADDER,
        "presliding_hysteresis": REVERSALS,
        "load_dependent_friction": f"{LADDER}, at two payloads",
        "backlash": REVERSALS,
        "time_delay": SPEEDS,
        "torque_offset": AT_REST,
        "friction_coupling": HOLD_OTHER,
        "thermal_friction_drift": WARM,
    }

    velocity: float = 0.1

    @classmethod
    def candidates(cls, joint: str, facts: JointFacts) -> Iterable[Self]:
        """Stribeck speeds of 1 to 40 % of the highest speed."""
        speeds = facts.speed * np.geomspace(0.01, _SLOW, 8)
        return [cls((joint,), velocity=float(speed)) for speed in speeds]

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """Bell around zero velocity with the velocity's sign."""
        return (np.sign(dq) * np.exp(-((dq / self.velocity) ** 2)),)


@dataclass(frozen=True)
class AsymmetricFriction(JointEffect):
    """τ = F_c± sign(q̇) + F_v± q̇: friction that differs with the direction.

    Attributes:
        viscous: Whether viscous friction differs too.
    """

    name: ClassVar[str] = "asymmetric_friction"
    family: ClassVar[str] = "friction"
    contains: ClassVar[tuple[str, ...]] = ("torque_offset", "coulomb_friction", "viscous_friction")
    imitates: ClassVar[tuple[str, ...]] = ("torque_offset",)
    terms: ClassVar[tuple[Term, ...]] = (
        Term("Fc_plus", "N·m"),
        Term("Fc_minus", "N·m"),
        Term("Fv_plus", "N·m·s/rad"),
        Term("Fv_minus", "N·m·s/rad"),
    )
    abscissa: ClassVar[str] = "velocity"
    told: ClassVar[Mapping[str, str]] = {
        "torque_offset": f"{AT_REST}, and once with the motor unpowered",
        "stribeck_friction": LADDER,
        "nonlinear_viscous_friction": LADDER,
        "load_dependent_friction": LOADS,
        "thermal_friction_drift": WARM,
        "friction_coupling": HOLD_OTHER,
    }

    viscous: bool = True

    @classmethod
    def candidates(cls, joint: str, facts: JointFacts) -> Iterable[Self]:
        """Coulomb friction alone, or both."""
        return cls((joint,), viscous=False), cls((joint,))

    @property
    def own_terms(self) -> tuple[Term, ...]:
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

    name: ClassVar[str] = "nonlinear_viscous_friction"
    family: ClassVar[str] = "friction"
    contains: ClassVar[tuple[str, ...]] = ("viscous_friction",)  # exponent one
    exponents: ClassVar[tuple[float, ...]] = (0.3, 0.5, 0.7, 1.5, 2.0, 3.0)  # to try
    terms: ClassVar[tuple[Term, ...]] = (Term("Fn", "N·m·(s/rad)^a"),)
    shapes: ClassVar[tuple[Shape, ...]] = (Shape("exponent", "1"),)
    shared: ClassVar[bool] = True
    abscissa: ClassVar[str] = "velocity"

    exponent: float = 2.0

    @classmethod
    def candidates(cls, joint: str, facts: JointFacts) -> Iterable[Self]:
        """Roots and powers."""
        return [cls((joint,), exponent=a) for a in cls.exponents]

    def alternatives(self, facts: JointFacts) -> list[Self]:
        """Its own exponent, then all others to try."""
        others = (a for a in self.exponents if a != self.exponent)
        return [self.bare(), *(self.bare().reshaped("exponent", a) for a in others)]

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        """Power of the speed with the velocity's sign."""
        return (np.sign(dq) * np.abs(dq) ** self.exponent,)


@dataclass(frozen=True)
class LoadDependentFriction(JointwiseEffect):
    """τ = F_l |τ_load| sign(q̇) with the torque of the bodies as load."""

    name: ClassVar[str] = "load_dependent_friction"
    family: ClassVar[str] = "friction"
    terms: ClassVar[tuple[Term, ...]] = (Term("Fl", "1", 0.0),)
    shared: ClassVar[bool] = True
    abscissa: ClassVar[str] = "load"
    told: ClassVar[Mapping[str, str]] = {
        "torque_gain": "repeat the motion backwards in time: friction turns its sign, a gain does "
        "not; then with a known payload",
        "presliding_hysteresis": f"{REVERSALS}, at two payloads",
        "backlash": REVERSALS,
        "nonlinear_viscous_friction": f"{LADDER}, at two payloads",
        "friction_coupling": HOLD_OTHER,
    }

    def at(self, robot: Robot, motion: Motion, j: int) -> Sequence[Array]:
        """Load with the velocity's sign."""
        return (np.abs(rigid_torque(robot, motion)[:, j]) * np.sign(motion.dq[:, j]),)
