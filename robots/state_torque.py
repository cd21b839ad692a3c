"""Effects at one instant: torque and mass of a robot's effects as forward dynamics needs them.

Inertia goes into the mass matrix, everything else into a torque of the state (t, q, q̇). Friction
jumps where a joint reverses; within ± v₀ of rest, torque is interpolated between those at −v₀ and
at v₀, whatever the effect, so that a joint at rest creeps with up to v₀ instead of sticking.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from excitant.exceptions import BadInput
from excitant.robots.effects import (
    AddedInertia,
    CoulombFriction,
    Effect,
    GravityDirection,
    JointEffect,
    PreslidingHysteresis,
    RotorInertia,
    TorqueOffset,
    ViscousFriction,
)
from excitant.robots.motion import Array, Motion, freeze
from excitant.robots.robot import Robot

REST = 1e-3  # rad/s or m/s: v₀
_PLAIN = (RotorInertia, ViscousFriction, CoulombFriction, TorqueOffset)  # one number per joint
_PROBES = 6  # states at which an effect is asked how it depends on acceleration and on the past
_SAME = 1e-9  # of the largest torque: rounding


@dataclass(frozen=True, eq=False)
class JointTerms:
    """A `JointEffect` at one instant: its joints at once, as if they were instants of one joint.

    Attributes:
        effect: The effect.
        joints: Indices of its joints, shape (k,).
        values: Coefficients, one row per term, shape (terms, k).
    """

    effect: JointEffect
    joints: npt.NDArray[np.intp]
    values: Array

    def __call__(self, t: float, q: Array, dq: Array, ddq: Array) -> Array:
        """Torque, shape (nv,) [N·m]."""
        tau, at = np.zeros_like(q), self.joints
        shapes = self.effect.shape(q[at], dq[at], np.zeros(len(at)))
        for value, shape in zip(self.values, shapes, strict=True):
            tau[at] += value * shape
        return tau


@dataclass(frozen=True, eq=False)
class OtherEffect:
    """Any effect of the state at one instant, as a motion that stays there.

    Attributes:
        robot: The robot that has it.
        effect: The effect.
        inertia: What it asks per acceleration, which the mass matrix has, shape (nv, nv).
    """

    robot: Robot
    effect: Effect
    inertia: Array

    def __call__(self, t: float, q: Array, dq: Array, ddq: Array) -> Array:
        """Torque, shape (nv,) [N·m]."""
        state = (np.stack([values, values]) for values in (q, dq, ddq))
        motion = Motion(np.array([t, t + 1.0]), *state)
        tau: Array = self.effect.torque(self.robot, motion)[0] - self.inertia @ ddq
        return tau


@dataclass(frozen=True, eq=False)
class Bristles:
    """Presliding hysteresis: Dahl's state z of each joint, carried from step to step.

    Attributes:
        distance: δ [rad].
        force: F_h, zero for joints without it, shape (nv,) [N·m].
        z: State after the last step, shape (nv,).
        q: Positions then, shape (nv,).
    """

    distance: float
    force: Array
    z: Array
    q: Array

    def __call__(self, t: float, q: Array, dq: Array, ddq: Array) -> Array:
        """Torque, shape (nv,) [N·m]."""
        tau: Array = self.force * (self._state(q) - np.sign(dq))
        return tau

    def _state(self, q: Array) -> Array:
        moved = np.where(np.isnan(self.q), 0.0, q - self.q)
        sign = np.sign(moved)
        kept = np.exp(-np.abs(moved) / self.distance)
        state: Array = np.where(sign != 0, sign + (self.z - sign) * kept, self.z)
        return state

    def advance(self, q: Array) -> None:
        """End a step at some positions, shape (nv,)."""
        self.z[:] = self._state(q)
        self.q[:] = q


@dataclass(frozen=True, eq=False)
class StateTorque:
    """What the drives of a robot must give beside its rigid bodies, but for what acceleration asks.

    Attributes:
        viscous: Viscous friction, shape (nv,) [N·m·s/rad].
        coulomb: Dry friction, shape (nv,) [N·m].
        offset: Constant torque, shape (nv,) [N·m].
        others: Everything else.
    """

    viscous: Array
    coulomb: Array
    offset: Array
    others: tuple[JointTerms | OtherEffect | Bristles, ...]

    def __post_init__(self) -> None:
        freeze(self, "viscous", "coulomb", "offset")

    def __call__(self, t: float, q: Array, dq: Array, ddq: Array) -> Array:
        """Torque in a state, shape (nv,) [N·m].

        Args:
            t: Time [s].
            q: Positions, shape (nv,).
            dq: Velocities, shape (nv,).
            ddq: Accelerations of the step before, for effects on which they act other than
                through the mass matrix, shape (nv,).
        """
        sign = np.minimum(np.maximum(dq / REST, -1.0), 1.0)
        tau: Array = self.viscous * dq + self.coulomb * sign + self.offset
        if self.others:
            tau += self._smoothed(t, q, dq, ddq, sign)
        return tau

    def slope(self, t: float, q: Array, dq: Array, ddq: Array) -> Array:
        """Damping that makes as much torque as friction does, shape (nv,) [N·m·s/rad].

        The odd part of torque over speed, where that is not negative.
        """
        speed = np.maximum(np.abs(dq), REST)
        slope: Array = self.viscous + self.coulomb / speed
        for effect in self.others:
            slope += (effect(t, q, speed, ddq) - effect(t, q, -speed, ddq)) / (2 * speed)
        return np.maximum(slope, 0.0)

    def advance(self, q: Array) -> None:
        """End a step at some positions, shape (nv,)."""
        for effect in self.others:
            if isinstance(effect, Bristles):
                effect.advance(q)

    def _smoothed(self, t: float, q: Array, dq: Array, ddq: Array, sign: Array) -> Array:
        slow, tau = np.abs(dq) < REST, np.zeros_like(q)
        if not slow.any():
            for effect in self.others:
                tau += effect(t, q, dq, ddq)
            return tau
        ahead, back = np.where(slow, REST, dq), np.where(slow, -REST, dq)
        share = np.where(slow, (1 + sign) / 2, 1.0)
        for effect in self.others:
            tau += share * effect(t, q, ahead, ddq) + (1 - share) * effect(t, q, back, ddq)
        return tau


def forward_model(robot: Robot) -> tuple[Any, Array, StateTorque]:
    """A robot as forward dynamics needs it.

    Effects of the torque sensor (a wrong gain, a delay) do not move the arm and are left out.

    Returns:
        Pinocchio's model with the bodies that effects add; the constant part of the mass matrix
        beside it, rotors and their coupling, shape (nv, nv) [kg·m²]; and the rest of the effects.

    Raises:
        BadInput: An effect without values, or one that depends on the past otherwise than by
            presliding hysteresis.
    """
    for effect in robot.effects:
        if effect.values is None:
            raise BadInput(f"{robot.name}: effect {effect.name} has no values; give them")
    plain: dict[type[Effect], Array] = {kind: np.zeros(robot.nv) for kind in _PLAIN}
    inertia = np.zeros((robot.nv, robot.nv))
    others: list[JointTerms | OtherEffect | Bristles] = []
    for effect in robot.effects:
        if effect.acts_on_torque or isinstance(effect, AddedInertia | GravityDirection):
            continue
        if type(effect) in plain:
            np.add.at(plain[type(effect)], _at(robot, effect), np.array(effect.values))
        elif isinstance(effect, PreslidingHysteresis):
            others.append(_bristles(robot, effect))
        else:
            own = _inertia(robot, effect)
            inertia += own
            others.append(
                _joint_terms(robot, effect)
                if isinstance(effect, JointEffect)
                else OtherEffect(robot, effect, own)
            )
    inertia += np.diag(plain[RotorInertia])
    viscous, coulomb, offset = (plain[kind] for kind in _PLAIN[1:])
    state = StateTorque(viscous, coulomb, offset, tuple(others))
    return _carrying(robot).model, inertia, state


def _at(robot: Robot, effect: Effect) -> npt.NDArray[np.intp]:
    return np.array([robot.joint_index(joint) for joint in effect.joints], dtype=np.intp)


def _carrying(robot: Robot) -> Robot:
    """The robot with the bodies and the gravity of its effects, without changing the one given."""
    phi, gravity = robot.phi.reshape(-1, 10).copy(), np.array(robot.gravity)
    for effect in robot.effects:
        if isinstance(effect, AddedInertia):
            phi[_at(robot, effect)[0]] += np.array(effect.values)
        elif isinstance(effect, GravityDirection):
            gravity += np.array(effect.values)
    if (phi.ravel() != robot.phi).any():
        robot = robot.with_parameters(phi)
    return robot.with_gravity(gravity) if (gravity != robot.gravity).any() else robot


def _bristles(robot: Robot, effect: PreslidingHysteresis) -> Bristles:
    force = np.zeros(robot.nv)
    np.add.at(force, _at(robot, effect), np.array(effect.values))
    return Bristles(effect.distance, force, np.zeros(robot.nv), np.full(robot.nv, np.nan))


def _joint_terms(robot: Robot, effect: JointEffect) -> JointTerms:
    at = _at(robot, effect)
    return JointTerms(effect, at, np.array(effect.values).reshape(len(at), -1).T)


def _inertia(robot: Robot, effect: Effect) -> Array:
    """Torque per acceleration where that is constant, else zeros, shape (nv, nv)."""
    nv, rng = robot.nv, np.random.default_rng(0)
    q, dq, _ = robot.random_motion(rng, _PROBES)
    base = _asked(robot, effect, q, dq, np.zeros_like(q))
    order = rng.permutation(_PROBES)
    shuffled = _asked(robot, effect, q[order], dq[order], np.zeros_like(q), order)
    if not _equal(shuffled, base[order], base):
        raise BadInput(
            f"{robot.name}: effect {effect.name} depends on the past, which a simulation from "
            "state to state does not know; simulate without it"
        )
    columns = np.array(
        [
            _asked(robot, effect, q, dq, size * np.tile(unit, (_PROBES, 1))) - base
            for size in (1.0, -2.0)
            for unit in np.eye(nv)
        ]
    )
    once, back, size = columns[:nv], columns[nv:], np.abs(base).max() + np.abs(columns)
    constant = _equal(once, once[:, :1], size) and _equal(back, -2 * once, size)
    return np.asarray(once[:, 0].T if constant else np.zeros((nv, nv)), float)


def _asked(
    robot: Robot,
    effect: Effect,
    q: Array,
    dq: Array,
    ddq: Array,
    order: Sequence[int] | npt.NDArray[np.intp] = range(_PROBES),
) -> Array:
    """Torque of an effect in states whose times are in some order."""
    return effect.torque(robot, Motion(0.01 * np.asarray(order, float), q, dq, ddq))


def _equal(a: Array, b: Array, size: Array) -> bool:
    scale = float(np.abs(size).max(initial=0.0))
    return bool(np.abs(a - b).max(initial=0.0) <= _SAME * scale)
