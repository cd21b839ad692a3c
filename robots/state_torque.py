"""Effects at one instant: torque and mass of a robot's effects as forward dynamics needs them.

Inertia goes into the mass matrix, everything else into a torque of the state (t, q, q̇). Friction
jumps where a joint reverses; within ± v₀ of rest, torque is interpolated between those at −v₀ and
at v₀, whatever the effect, so that a joint at rest creeps with up to v₀ instead of sticking.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from excitant.exceptions import BadInput
from excitant.robots.effects.base import Effect, Stepper
from excitant.robots.motion import Array, Motion, freeze
from excitant.robots.robot import Robot

REST = 1e-3  # rad/s or m/s: v₀
_PLAIN = ("rotor", "viscous", "coulomb", "offset")  # one number per joint
_PROBES = 6  # states at which an effect is asked how it depends on acceleration and on the past
_SAME = 1e-9  # of the largest torque: rounding

Torque = Callable[[float, Array, Array, Array], Array]


@dataclass(frozen=True, eq=False)
class StateTorque:
    """What the drives of a robot must give beside its rigid bodies, but for what acceleration asks.

    Attributes:
        viscous: Viscous friction, shape (nv,) [N·m·s/rad].
        coulomb: Dry friction, shape (nv,) [N·m].
        offset: Constant torque, shape (nv,) [N·m].
        others: Torque of everything else by time, position, speed and acceleration.
        steppers: Those of them that have a state of their own.
    """

    viscous: Array
    coulomb: Array
    offset: Array
    others: tuple[Torque, ...]
    steppers: tuple[Stepper, ...]

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
        if self.others:
            slope += (self._rest(t, q, speed, ddq) - self._rest(t, q, -speed, ddq)) / (2 * speed)
        return np.maximum(slope, 0.0)

    def advance(self, q: Array) -> None:
        """End a step at some positions, shape (nv,)."""
        for stepper in self.steppers:
            stepper.advance(q)

    def _rest(self, t: float, q: Array, dq: Array, ddq: Array) -> Array:
        tau = np.zeros_like(q)
        for effect in self.others:
            tau += effect(t, q, dq, ddq)
        return tau

    def _smoothed(self, t: float, q: Array, dq: Array, ddq: Array, sign: Array) -> Array:
        slow = np.abs(dq) < REST
        if not slow.any():
            return self._rest(t, q, dq, ddq)
        ahead, back = np.where(slow, REST, dq), np.where(slow, -REST, dq)
        share = np.where(slow, (1 + sign) / 2, 1.0)
        tau: Array = share * self._rest(t, q, ahead, ddq)
        return tau + (1 - share) * self._rest(t, q, back, ddq)


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
    plain = {kind: np.zeros(robot.nv) for kind in _PLAIN}
    carrying, inertia = robot, np.zeros((robot.nv, robot.nv))
    others: list[Torque] = []
    steppers: list[Stepper] = []
    for effect in robot.effects:
        if effect.values is None:
            raise BadInput(f"{robot.name}: effect {effect.name} has no values; give them")
        carrying, before = effect.applied(carrying), carrying
        if effect.acts_on_torque or carrying is not before:
            continue
        if effect.joint_property:
            plain[effect.joint_property][effect.rows(robot)] += effect.values
        elif (stepper := effect.stepper(robot)) is not None:
            steppers.append(stepper)
            others.append(stepper)
        else:
            own = _inertia(robot, effect)
            inertia += own
            others.append(_by_law(robot, effect) or _at_an_instant(robot, effect, own))
    inertia += np.diag(plain["rotor"])
    viscous, coulomb, offset = (plain[kind] for kind in _PLAIN[1:])
    state = StateTorque(viscous, coulomb, offset, tuple(others), tuple(steppers))
    return carrying.model, inertia, state


def _by_law(robot: Robot, effect: Effect) -> Torque | None:
    """Torque of an effect that has a law: its joints at once, as if instants of one joint."""
    law, at = effect.law, np.array(effect.rows(robot), np.intp)
    if law is None:
        return None
    values, still = np.reshape(effect.values or (), (len(at), -1)).T, np.zeros(len(at))

    def torque(t: float, q: Array, dq: Array, ddq: Array) -> Array:
        tau = np.zeros_like(q)
        for value, column in zip(values, law(q[at], dq[at], still), strict=True):
            tau[at] += value * column
        return tau

    return torque


def _at_an_instant(robot: Robot, effect: Effect, inertia: Array) -> Torque:
    """Torque of any effect of the state, as on a motion that stays there.

    Args:
        robot: The robot that has it.
        effect: The effect.
        inertia: What it asks per acceleration, which the mass matrix has, shape (nv, nv).
    """

    def torque(t: float, q: Array, dq: Array, ddq: Array) -> Array:
        state = (np.stack([values, values]) for values in (q, dq, ddq))
        motion = Motion(np.array([t, t + 1.0]), *state)
        tau: Array = effect.torque(robot, motion)[0] - inertia @ ddq
        return tau

    return torque


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
