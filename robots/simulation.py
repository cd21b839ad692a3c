"""Forward dynamics of a model: what a robot with its effects does under a joint controller.

    M(q) q̈ + b(q, q̇) + τ_e(t, q, q̇) = τ,    τ = τ_ff + B (ω² (q_d − q) + 2 ω (q̇_d − q̇))

with the rotors in M and the torque τ_e of the effects. Friction jumps where a joint reverses;
within ± v₀ of rest, torque is interpolated between those at −v₀ and at v₀, so that a joint at rest
creeps with up to v₀ instead of sticking. A step is one of the Rosenbrock method ROS2 (Verwer,
Spee, Blom, Hundsdorfer 1999): of second order whatever stands in for the Jacobian, here controller
and friction, so that neither stiff gains nor the dry friction of light joints limit its length.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
import scipy
from scipy.linalg.lapack import dgesv

from excitant.exceptions import BadInput, ExcitantError
from excitant.robots.effects.base import Effect, Stepper, turning_speed
from excitant.robots.motion import Array, Indices, Motion, Noun
from excitant.robots.robot import Robot
from excitant.robots.torque import torque

REST = 1e-3  # rad/s or m/s: v₀
# s: longest of integration, a twenty-fifth of the time constant of the default controller
STEP = 1e-3
ROUNDING = 1e-9  # of the largest torque
PROBES = (
    6  # states in which an effect is evaluated by acceleration and in another order
)
REVERSAL_STEPS = 4.0  # steps within which a reversal is near
REFINEMENT = 8  # most parts of a step near a reversal
MOST_STEPS = 2.0  # in all, relative to those without refinement
# of the two that make ROS2 L-stable, that without overshoot
GAMMA = 1 + np.sqrt(0.5)
DIVERGED = 2 * np.pi  # rad or m beyond the range of the commanded motion
DIVERGENCE_STEPS = 16  # between two checks for divergence

Torque = Callable[[float, Array, Array, Array], Array]


class Diverged(ExcitantError):
    """A simulated robot that left its commanded motion for good: its joint, and when [s]."""

    def __init__(self, robot: str, joint: str, t: float) -> None:
        self.joint = joint
        self.t = t
        super().__init__(
            f"simulation of {robot}: joint {joint} diverges at t = {t:.4g} s; its parameters may "
            "leave it without inertia or with driving friction, or the controller is too weak or "
            "too fast for the step"
        )


@dataclass(frozen=True, eq=False)
class StateTorque(Noun):
    """Torque of a robot's effects in a state, without terms proportional to acceleration.

    Arguments are time [s], positions and velocities, and the accelerations of the step before,
    for effects on which they act other than through the mass matrix, each of shape (nv,). The
    other effects are asked for several velocities at once, shape (k, nv).
    """

    viscous: Array  # shape (nv,) [N·m·s/rad]
    coulomb: Array  # shape (nv,) [N·m]
    offset: Array  # shape (nv,) [N·m]
    others: tuple[Torque, ...]  # torque of all other effects
    # effects among these that have a state of their own
    steppers: tuple[Stepper, ...]

    def __call__(
        self, t: float, q: Array, dq: Array, ddq: Array
    ) -> tuple[Array, Array]:
        """Torque in a state and its slope, both of shape (nv,) [N·m, N·m·s/rad].

        The slope is the damping that makes as much torque as friction does: the odd part of torque
        over speed, where that is not negative.
        """
        speed = np.maximum(np.abs(dq), REST)
        slow = np.abs(dq) < REST
        share = np.where(slow, (1 + dq / REST) / 2, 1.0)
        ahead = np.where(slow, REST, dq)
        back = np.where(slow, -REST, dq)
        speeds = np.array([speed, -speed, ahead, back])
        tau = self.viscous * speeds + self.coulomb * np.sign(speeds) + self.offset
        for effect in self.others:
            tau += effect(t, q, speeds, ddq)
        slope = np.maximum((tau[0] - tau[1]) / (2 * speed), 0.0)
        return share * tau[2] + (1 - share) * tau[3], slope


def forward_model(robot: Robot) -> tuple[Any, Array, StateTorque]:
    """A robot as forward dynamics needs it.

    Pinocchio's model with the bodies that effects add; the constant part of the mass matrix
    beside it, rotors and their coupling, shape (nv, nv) [kg·m²]; and the rest of the effects, but
    for those of the torque sensor (a wrong gain, a delay), which do not move the arm.

    Raises:
        BadInput: An effect without values, or one that depends on the past but has no stepper.
    """
    drives = {
        name: np.zeros(robot.nv)
        for name in ("rotor", "viscous", "coulomb", "offset")
    }
    loaded = robot
    inertia = np.zeros((robot.nv, robot.nv))
    others: list[Torque] = []
    steppers: list[Stepper] = []
    for effect in robot.effects:
        if effect.values is None:
            raise BadInput(
                f"{robot.name}: effect {effect.name} has no values; give them"
            )
        changed = effect.applied(loaded)
        if changed is not loaded:
            loaded = changed
        elif effect.physics.on_torque:
            continue
        elif effect.export.joint_property and not turning_speed(effect):
            drives[effect.export.joint_property][effect.rows(robot)] += (
                effect.values
            )
        elif (stepper := effect.stepper(robot)) is not None:
            steppers.append(stepper)
            others.append(stepper)
        else:
            part = _inertia(robot, effect)
            inertia += part
            others.append(_at_an_instant(robot, effect, part))
    inertia += np.diag(drives.pop("rotor"))
    state = StateTorque(**drives, others=tuple(others), steppers=tuple(steppers))
    return loaded.model, inertia, state


def _at_an_instant(robot: Robot, effect: Effect, inertia: Array) -> Torque:
    """Torque of any effect of the state, as if at instants of a motion, less its inertia's."""

    def torque(t: float, q: Array, speeds: Array, ddq: Array) -> Array:
        once = np.ones((len(speeds), 1))
        motion = Motion(t * once[:, 0], once * q, speeds, once * ddq)
        return effect.torque(robot, motion) - inertia @ ddq

    return torque


def _inertia(robot: Robot, effect: Effect) -> Array:
    """Torque per acceleration where that is constant, else zeros, shape (nv, nv)."""
    rng = np.random.default_rng(0)
    unit = np.eye(robot.nv)
    natural = np.arange(PROBES)
    q, dq, _ = robot.random_motion(rng, PROBES)

    def probed(ddq: Array, order: Indices = natural) -> Array:
        """Torque in the probed states, whose times are in some order."""
        accelerations = np.tile(ddq, (PROBES, 1))
        t = 0.01 * np.asarray(order, float)
        motion = Motion(t, q[order], dq[order], accelerations)
        return effect.torque(robot, motion)

    rest = np.zeros(robot.nv)
    base = probed(rest)
    order = rng.permutation(PROBES)
    largest = np.abs(base).max()
    if np.abs(probed(rest, order) - base[order]).max() > ROUNDING * largest:
        raise BadInput(
            f"{robot.name}: effect {effect.name} depends on the past, which a simulation from "
            "state to state does not know; simulate without it"
        )
    once = np.array([probed(e) - base for e in unit])
    twice = np.array([probed(-2.0 * e) - base for e in unit])
    rounding = ROUNDING * (largest + max(np.abs(once).max(), np.abs(twice).max()))
    varies = np.abs(once - once[:, :1]).max() > rounding
    if varies or np.abs(twice + 2 * once).max() > rounding:
        return np.zeros_like(unit)
    return once[:, 0].T


@dataclass(frozen=True, eq=False)
class Controller:
    """Feed-forward of a model, and a position loop in terms of its inertia."""

    omega: Array | float = 40.0  # ω, one for all joints or shape (nv,) [rad/s]
    # gives τ_ff and B; the simulated one itself when None
    believed: Robot | None = None

    def gains(self, robot: Robot, q: Array) -> tuple[Array, Array]:
        """B ω² and 2 B ω at commanded positions, each (n, nv, nv) [N·m/rad, N·m·s/rad]."""
        model, rotors, _ = forward_model(self.believed or robot)
        data = model.createData()
        B = np.array([pin.crba(model, data, pose) + rotors for pose in q])
        return B * self.omega**2, 2 * B * self.omega


def simulate(
    robot: Robot, command: Motion, controller: Controller | None = None
) -> Motion:
    """Let a model with its effects follow a motion, from that motion's first state.

    Args:
        robot: The model; effects need values.
        command: The motion; quintic polynomials between its instants.
        controller: None lets the robot move without torque.

    Returns:
        The response at the instants of the motion; accelerations are means over one step on either
        side.

    Raises:
        BadInput: Effects that cannot be simulated, or shapes and times that do not fit.
        Diverged: The simulation left the commanded motion for good, or holds no numbers any more.
    """
    _check(robot, command)
    counts = _steps(command)
    inner = _between(command, counts)
    forward = np.zeros_like(inner.q)
    gains = None
    if controller is not None:
        forward = torque(controller.believed or robot, inner)
        gains = controller.gains(robot, inner.q)
    # a diverging simulation is refused
    with np.errstate(over="ignore", invalid="ignore"):
        q, dq = _integrated(robot, inner, forward, gains)
    ddq = np.gradient(dq, inner.t, axis=0)
    at = np.append(0, np.cumsum(counts))
    return Motion(command.t, q[at], dq[at], ddq[at])


def _check(robot: Robot, command: Motion) -> None:
    if command.nv != robot.nv or len(command) < 2:
        raise BadInput(
            f"simulation: a motion of {command.nv} joints at {len(command)} instants for "
            f"{robot.name} with {robot.nv}; give two instants or more of its joints"
        )
    if not (np.diff(command.t) > 0).all():
        raise BadInput("simulation: time of the motion must rise")


def _steps(command: Motion) -> Indices:
    """Steps between each two instants, more where a joint turns back: dry friction jumps there."""
    dt = np.diff(command.t)
    counts = np.maximum(1, np.ceil(dt / STEP - 1e-9)).astype(np.intp)
    reach = REVERSAL_STEPS * (dt / counts)[:, None] * np.abs(command.ddq)[1:]
    turns = (np.abs(command.dq[1:]) < reach) | (
        command.dq[1:] * command.dq[:-1] < 0
    )
    near = scipy.ndimage.maximum_filter1d(turns.any(axis=1), 3)
    finer = np.clip(MOST_STEPS / max(float(near.mean()), 1e-9), 1, REFINEMENT)
    return np.where(near, counts * int(finer), counts)


def _between(motion: Motion, counts: Indices) -> Motion:
    """The motion with each of its steps divided into as many as counted."""
    if (counts == 1).all():
        return motion
    at = np.repeat(np.arange(len(counts)), counts)
    first = np.concatenate([[0], np.cumsum(counts)[:-1]])
    share = (np.arange(len(at)) - first[at]) / counts[at]
    t = np.append(motion.t[at] + share * np.diff(motion.t)[at], motion.t[-1])
    derivatives = np.stack([motion.q, motion.dq, motion.ddq], axis=1)
    path = scipy.interpolate.BPoly.from_derivatives(motion.t, derivatives)
    return Motion(t, *(path(t, nu=order) for order in range(3)))


def _integrated(
    robot: Robot, command: Motion, forward: Array, gains: tuple[Array, Array] | None
) -> tuple[Array, Array]:
    """Positions and velocities at every instant, each of shape (n, nv)."""
    model, rotors, effects = forward_model(robot)
    data = model.createData()
    n = len(command)
    nv = robot.nv
    zero = np.zeros((n, nv, nv))
    K, C = (zero, zero) if gains is None else gains
    t = command.t.tolist()
    target = command.q
    speed = command.dq
    allowed = np.inf if gains is None else DIVERGED + np.ptp(target, axis=0)
    positions = np.empty((n, nv))
    velocities = np.empty((n, nv))
    q = target[0].copy()
    v = speed[0].copy()
    a = np.zeros(nv)
    for stepper in effects.steppers:
        stepper.advance(q)
    crba = pin.crba
    bias = pin.nonLinearEffects
    diagonal = np.arange(nv) * (nv + 1)
    for k in range(n):
        positions[k] = q
        velocities[k] = v
        if k % DIVERGENCE_STEPS == 0 or k == n - 1:
            _refuse_divergence(robot, t[k], target[k] - q, v, allowed)
        if k == n - 1:
            break
        Kk = K[k]
        Ck = C[k]
        u = forward[k] + Kk @ (target[k] - q) + Ck @ (speed[k] - v)
        h = t[k + 1] - t[k]
        gh = GAMMA * h
        damping = gh * Ck + (gh * gh) * Kk
        friction, slope = effects(t[k], q, v, a)
        damping.flat[diagonal] += gh * slope
        ahead = gh * (Kk @ speed[k] + Ck @ command.ddq[k])
        M = crba(model, data, q) + rotors
        F = u - bias(model, data, q, v) - friction
        a1 = dgesv(M + damping, F + ahead - gh * (Kk @ v))[2]
        v1 = v + gh * a1
        end = q + h * v1
        fast = v + h * a1
        u = forward[k + 1] + K[k + 1] @ (target[k + 1] - end)
        u += C[k + 1] @ (speed[k + 1] - fast)
        M = crba(model, data, end) + rotors
        friction, _ = effects(t[k + 1], end, fast, a)
        F = u - bias(model, data, end, fast) - friction
        rest = fast - 2 * v1
        a2 = dgesv(M + damping, F - ahead - 2 * (M @ a1) - gh * (Kk @ rest))[2]
        q = q + (1.5 * h) * v1 + (0.5 * h) * (rest + gh * a2)
        a = 1.5 * a1 + 0.5 * a2
        v = v + h * a
        for stepper in effects.steppers:
            stepper.advance(q)
    return positions, velocities


def _refuse_divergence(
    robot: Robot, t: float, error: Array, v: Array, allowed: Array | float
) -> None:
    wrong = ~(np.abs(error) <= allowed) | ~np.isfinite(v)
    if wrong.any():
        size = np.where(np.isfinite(error), np.abs(error), np.inf)
        raise Diverged(
            robot.name, robot.joints[int(np.argmax(np.where(wrong, size, -1)))], t
        )
