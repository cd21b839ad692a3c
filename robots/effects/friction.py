"""Friction at the joints, of shafts that turn with two of them, and with a memory."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from excitant.robots.effects import experiments as by
from excitant.robots.effects.base import (
    SIGN_DEVIATIONS,
    JointEffect,
    JointFacts,
    JointwiseEffect,
    PairEffect,
    Parameter,
    Shape,
    StandardEffect,
    effect_values,
    registered,
    within,
)
from excitant.robots.motion import Array, Motion
from excitant.robots.regressor import rigid_torque
from excitant.robots.robot import Robot

# of a joint's highest speed: a Stribeck velocity beyond it is Coulomb friction
_SLOW = 0.4
_SHORT = 0.1  # of a joint's range: friction that builds up over more is a spring
_PART = 0.25  # of dry friction that builds up, at least
_REACH = 8.0  # break-away distances from a reversal that show hysteresis


class _Friction:
    family: ClassVar[str] = "friction"
    abscissa: ClassVar[str] = "velocity"


@registered
class ViscousFriction(_Friction, StandardEffect):
    """τ = F_v q̇."""

    name = "viscous_friction"
    terms = (Parameter("Fv", "N·m·s/rad", 0.0),)
    joint_property = "viscous"
    formats = ("urdf", "mjcf", "sdf", "ros2_control")
    told = (
        (by.LADDER, "coulomb_friction stribeck_friction"),
        (by.LADDER, "nonlinear_viscous_friction asymmetric_friction"),
        (by.WARM, "thermal_friction_drift"),
        (by.CURRENT, "torque_gain"),
        (by.LOADS, "load_dependent_friction"),
        (by.HOLD_OTHER, "friction_coupling"),
        (by.KINEMATICS, "encoder_scale"),
    )

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        return (dq,)


@registered
class CoulombFriction(_Friction, StandardEffect):
    """τ = F_c sign(q̇)."""

    name = "coulomb_friction"
    terms = (Parameter("Fc", "N·m", 0.0),)
    joint_property = "coulomb"
    formats = ("urdf", "mjcf", "sdf", "ros2_control")
    format_notes: ClassVar[Mapping[str, str]] = {
        "mjcf": "frictionloss is a constraint, as stiff as a step of 2 ms allows: it has its full "
        "value, against the motion, once a joint slides, and turns with the velocity within 2 ms"
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
        return (np.sign(dq),)


@registered
class AsymmetricFriction(_Friction, JointEffect):
    """τ = F_c± sign(q̇) + F_v± q̇: friction that differs with the direction."""

    name = "asymmetric_friction"
    contains = ("torque_offset", "coulomb_friction", "viscous_friction")
    imitates = ("torque_offset",)
    terms = (
        Parameter("Fc_plus", "N·m"),
        Parameter("Fc_minus", "N·m"),
        Parameter("Fv_plus", "N·m·s/rad"),
        Parameter("Fv_minus", "N·m·s/rad"),
    )
    told = (
        (f"{by.AT_REST}, and once with the motor unpowered", "torque_offset"),
        (by.LADDER, "stribeck_friction nonlinear_viscous_friction"),
        (by.LOADS, "load_dependent_friction"),
        (by.WARM, "thermal_friction_drift"),
        (by.HOLD_OTHER, "friction_coupling"),
    )

    viscous: bool = True  # whether viscous friction differs too

    @classmethod
    def candidates(cls, joint: str, facts: JointFacts) -> Iterable[Self]:
        return cls((joint,), viscous=False), cls((joint,))

    @property
    def own_terms(self) -> tuple[Parameter, ...]:
        return self.terms[: 2 + 2 * self.viscous]

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        ahead = np.maximum(dq, 0.0)
        back = np.minimum(dq, 0.0)
        return (np.sign(ahead), np.sign(back), ahead, back)[: 2 + 2 * self.viscous]

    def plausible(self, robot: Robot, values: Array, std: Array) -> bool:
        """Whether friction, with what is given, brakes in both directions."""
        known = effect_values(robot)
        given = [
            known.get(f"{self.joints[0]}.{symbol}", 0.0) for symbol in ("Fc", "Fv")
        ]
        return within(values + np.repeat(given, 2)[: len(values)], 0.0, std)


@registered
class StribeckFriction(_Friction, JointEffect):
    """τ = F_s exp(−|q̇ / v_s|²) sign(q̇), on top of Coulomb friction (Armstrong-Hélouvry 1991)."""

    name = "stribeck_friction"
    terms = (Parameter("Fs", "N·m", 0.0),)
    shapes = (
        Shape(
            "velocity",
            "rad/s",
            grid=lambda facts: facts.speed * np.geomspace(0.01, _SLOW, 8),
            most=lambda facts: _SLOW * facts.speed,
        ),
    )
    told = (
        (by.LADDER, "nonlinear_viscous_friction"),
        (by.REVERSALS, "presliding_hysteresis backlash"),
        (f"{by.LADDER}, at two payloads", "load_dependent_friction"),
        (by.HOLD_OTHER, "friction_coupling"),
        (by.WARM, "thermal_friction_drift"),
    )

    velocity: float = 0.1  # v_s [rad/s]

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        return (np.sign(dq) * np.exp(-((dq / self.velocity) ** 2)),)


@registered
class NonlinearViscousFriction(_Friction, JointEffect):
    """τ = F_n |q̇|^a sign(q̇), on top of viscous friction."""

    name = "nonlinear_viscous_friction"
    contains = ("viscous_friction",)  # exponent one
    terms = (Parameter("Fn", "N·m·(s/rad)^a"),)
    shapes = (
        Shape("exponent", "1", grid=lambda facts: (0.3, 0.5, 0.7, 1.5, 2.0, 3.0)),
    )

    exponent: float = 2.0  # a, not one

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        return (np.sign(dq) * np.abs(dq) ** self.exponent,)


@registered
class LoadDependentFriction(_Friction, JointwiseEffect):
    """τ = F_l |τ_load| sign(q̇) with the torque of the bodies as load."""

    name = "load_dependent_friction"
    terms = (Parameter("Fl", "1", 0.0),)
    abscissa = "load"
    told = (
        (f"{by.BACKWARDS}, a gain does not; then with a known payload", "torque_gain"),
        (f"{by.REVERSALS}, at two payloads", "presliding_hysteresis"),
        (by.REVERSALS, "backlash"),
        (f"{by.LADDER}, at two payloads", "nonlinear_viscous_friction"),
        (by.HOLD_OTHER, "friction_coupling"),
    )

    def at(self, robot: Robot, motion: Motion, j: int) -> Sequence[Array]:
        return (np.abs(rigid_torque(robot, motion)[:, j]) * np.sign(motion.dq[:, j]),)


@registered
class PreslidingHysteresis(_Friction, JointwiseEffect):
    """τ = F_h (z − sign q̇): dry friction that builds up over a distance instead of at once.

    z follows Dahl's law dz/dq = (1 − z sign q̇) / δ (Dahl 1968), so that Coulomb friction F_c
    with F_h = F_c is F_c z; its motion must come in the order of time.
    """

    name = "presliding_hysteresis"
    depends_on_model = False
    terms = (Parameter("Fh", "N·m", 0.0),)
    shapes = (
        Shape(
            "distance",
            "rad",
            grid=lambda facts: facts.reach * np.geomspace(3e-4, _SHORT, 8),
            most=lambda facts: _SHORT * facts.reach,
            least=lambda facts: facts.blur,
        ),
    )
    abscissa = "reversal"
    told = ((by.REVERSALS, "backlash"),)

    distance: float = 0.01  # δ, over which friction builds up [rad]

    def at(self, robot: Robot, motion: Motion, j: int) -> Sequence[Array]:
        return (bristles(motion.q[:, j], self.distance) - np.sign(motion.dq[:, j]),)

    def plausible(self, robot: Robot, values: Array, std: Array) -> bool:
        """Whether it is a good part of the joint's dry friction; less is a blurred reversal."""
        given = effect_values(robot).get(f"{self.joints[0]}.Fc", 0.0)
        enough = values[0] + SIGN_DEVIATIONS * std[0] > _PART * given
        return bool(enough) and super().plausible(robot, values, std)

    def stepper(self, robot: Robot) -> Bristles:
        force = np.zeros(robot.nv)
        force[self.rows(robot)] = self._known()
        return Bristles(
            self.distance, force, np.zeros(robot.nv), np.full(robot.nv, np.nan)
        )

    def drawn(self, label: str, x: Array) -> tuple[str, Array]:
        """Near reversals only, where any of it is."""
        far = np.abs(x) > _REACH * self.distance
        return label, np.where(far & (far.mean() < 1), np.nan, x)


@dataclass(frozen=True, eq=False)
class Bristles:
    """Dahl's state of each joint, carried from step to step of a simulation; shapes (nv,)."""

    distance: float  # δ [rad]
    force: Array  # F_h, zero for joints without it [N·m]
    z: Array  # after the last step
    q: Array  # positions then, NaN before the first

    def __call__(self, t: float, q: Array, dq: Array, ddq: Array) -> Array:
        return self.force * (self._state(q) - np.sign(dq))

    def _state(self, q: Array) -> Array:
        moved = np.where(np.isnan(self.q), 0.0, q - self.q)
        sign = np.sign(moved)
        kept = np.exp(-np.abs(moved) / self.distance)
        return np.where(sign != 0, sign + (self.z - sign) * kept, self.z)

    def advance(self, q: Array) -> None:
        self.z[:] = self._state(q)
        self.q[:] = q


def bristles(q: Array, distance: float) -> Array:
    """Dahl's state z along a motion, from z = 0, shape (n,).

    In each run of one direction z decays towards it: only runs are gone through one by one.
    """
    steps = np.diff(q)
    moves = np.flatnonzero(steps)
    way = np.append(0.0, np.cumsum(np.abs(steps))) / distance
    first = moves[np.flatnonzero(np.diff(np.sign(steps[moves]), prepend=0.0))]
    signs = np.append(0.0, np.sign(steps[first]))
    starts = np.append(0.0, way[first])
    kept = np.exp(-np.diff(starts)).tolist()
    states = [0.0]  # at the start of each run, the first of which is before any motion
    for sign, keeps in zip(signs[:-1].tolist(), kept, strict=True):
        states.append(sign + (states[-1] - sign) * keeps)
    run = np.append(0, np.searchsorted(first, np.arange(len(steps)), "right"))
    z = signs[run] + (np.array(states)[run] - signs[run]) * np.exp(starts[run] - way)
    return np.asarray(z, float)


@registered
class FrictionCoupling(_Friction, PairEffect):
    """Friction of a shaft that turns with both joints, at speed w = q̇_i + ρ q̇_k.

    τ_i = F_v w + F_c sign(w), τ_k = ρ τ_i, as in wrists whose motors sit in the forearm
    (Gautier, Janot, Vandanjon 2013, Stäubli TX40).
    """

    name = "friction_coupling"
    terms = (Parameter("Fv", "N·m·s/rad", 0.0), Parameter("Fc", "N·m", 0.0))
    shapes = (Shape("ratio", "1", positive=False),)
    abscissa = "other velocity"
    told = ((by.HOLD_OTHER, "inertia_coupling"),)

    ratio: float = 1.0  # ρ

    @classmethod
    def proposed(
        cls, robot: Robot, facts: Sequence[JointFacts]
    ) -> list[tuple[Self, int]]:
        """Shafts that turn with the sum or the difference of a joint and the next."""
        usual = super().proposed(robot, facts)
        return [
            (e.reshaped("ratio", ratio), 1) for e, _ in usual for ratio in (1.0, -1.0)
        ]

    def columns(self, robot: Robot, motion: Motion) -> Array:
        i, k = self.rows(robot)
        speed = motion.dq[:, i] + self.ratio * motion.dq[:, k]
        columns = np.zeros((len(motion), robot.nv, 2))
        for row, lever in ((i, 1.0), (k, self.ratio)):
            columns[:, row, 0], columns[:, row, 1] = (
                lever * speed,
                lever * np.sign(speed),
            )
        return columns


@registered
class ThermalFrictionDrift(_Friction, JointwiseEffect):
    """τ = e^{−(t − t_0)/T} (F_v q̇ + F_c sign q̇): what friction loses while the joint warms up."""

    name = "thermal_friction_drift"
    depends_on_model = False
    shapes = (Shape("time", "s", most=lambda facts: facts.duration),)
    abscissa = "time"
    contains = ("viscous_friction", "coulomb_friction")
    terms = (Parameter("Fv_cold", "N·m·s/rad"), Parameter("Fc_cold", "N·m"))

    time: float = 60.0  # T [s]
    start: float = 0.0  # t_0, when the arm was cold [s]

    @classmethod
    def candidates(cls, joint: str, facts: JointFacts) -> Iterable[Self]:
        """Time constants up to the recording's length; longer ones look like a ramp."""
        times = facts.duration * np.array([0.15, 0.4, 1.0])
        return [cls((joint,), time=float(time), start=facts.start) for time in times]

    def at(self, robot: Robot, motion: Motion, j: int) -> Sequence[Array]:
        fading = np.exp(-np.maximum(motion.t - self.start, 0.0) / self.time)
        return fading * motion.dq[:, j], fading * np.sign(motion.dq[:, j])
