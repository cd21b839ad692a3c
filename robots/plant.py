"""The plant of the virtual arm: forward dynamics with stiction under a tracking controller.

Written apart from everything that is fitted: it shares no code with `excitant.robots.effects`,
so finding what it hides proves something.

Equation of motion, with M including the rotor inertia and b the Coriolis, centrifugal and gravity
torque:

    M(q) q̈ + b(q, q̇) + D q̇ + λ = τ,    λ_j ∈ L_j(q̇_j) · Sign(q̇_j),

where Sign is set-valued at zero, so that a joint at rest holds any torque up to L_j, and
L(v) = F_c + F_s exp(−(v / v_s)²). A step of length h is a midpoint rule, implicit in the velocity
for friction and controller (Moreau time stepping): no regularisation, hence neither creep nor
chatter, and no instability of light joints.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import pinocchio as pin

from excitant.exceptions import BadInput, BadRobot
from excitant.robots.motion import Array, read_only
from excitant.robots.robot import Robot

Trajectory = Callable[[Array, int], Array]
"""Motion as a function of time, shape (n,) [s], and derivative order: shape (n, nv)."""
Progress = Callable[[float], None]
"""Told from time to time which fraction is done."""

_STEP = 5e-4  # s: a hundredth of the controller's time constant
_BANDWIDTH = 40.0  # rad/s of the closed position loop
_CHUNK = 2000  # integration steps between two reports of progress
_STILL = 1e-3  # rad/s: what still counts as starting at rest


@dataclass(frozen=True, eq=False)
class Drives:
    """Friction and rotor inertia at the joints, each of shape (nv,).

    Attributes:
        viscous: D [N·m·s/rad].
        coulomb: F_c [N·m].
        stribeck: F_s, what sticking adds to F_c [N·m].
        stribeck_velocity: v_s [rad/s].
        rotor: Rotor and gear inertia at the joint side [kg·m²].
        offset: Constant that the torque sensor adds [N·m].
    """

    viscous: Array
    coulomb: Array
    stribeck: Array
    stribeck_velocity: Array
    rotor: Array
    offset: Array

    def __post_init__(self) -> None:
        for field in fields(self):
            object.__setattr__(self, field.name, read_only(getattr(self, field.name)))

    def friction(self, dq: Array) -> Array:
        """Torque of sliding friction at some velocities, shape (n, nv) [N·m]."""
        return self.viscous * dq + self.level(dq) * np.sign(dq)

    def level(self, dq: Array) -> Array:
        """Torque that a joint at this velocity must overcome beside the viscous one [N·m]."""
        return self.coulomb + self.stribeck * np.exp(-((dq / self.stribeck_velocity) ** 2))


@dataclass(frozen=True, eq=False)
class Run:
    """What happened, at ``n`` sampling instants.

    Attributes:
        t: Time, shape (n,) [s].
        q: Positions, shape (n, nv).
        dq: Velocities, shape (n, nv).
        tau: Torque that the motors gave, shape (n, nv).
    """

    t: Array
    q: Array
    dq: Array
    tau: Array


@dataclass(frozen=True, eq=False)
class Controller:
    """Feed-forward of a model and a critically damped position loop.

    τ = τ_ff + B (ω² (q_d − q) + 2ω (q̇_d − q̇)), saturated at the torque limits.

    Attributes:
        position: Desired positions q_d, shape (n, nv).
        velocity: Desired velocities q̇_d, shape (n, nv).
        feedforward: Torque τ_ff of the model for the desired motion, shape (n, nv).
        gain: B, the mass matrix with a floor on its diagonal, shape (n, nv, nv).
        limit: Largest torque of each motor, shape (nv,).
    """

    position: Array
    velocity: Array
    feedforward: Array
    gain: Array
    limit: Array

    def __call__(self, k: int, q: Array, dq: Array) -> Array:
        """Torque at instant k in a state, shape (nv,)."""
        held: Array = np.minimum(np.maximum(self.wanted(k, q, dq), -self.limit), self.limit)
        return held

    def wanted(self, k: int, q: Array, dq: Array) -> Array:
        """Torque at instant k in a state before saturation, shape (nv,)."""
        position, velocity = self.position[k] - q, self.velocity[k] - dq
        correction: Array = self.gain[k] @ (_BANDWIDTH**2 * position + 2 * _BANDWIDTH * velocity)
        total: Array = self.feedforward[k] + correction
        return total


def tracking_controller(
    robot: Robot, model: pin.Model, drives: Drives, trajectory: Trajectory, t: Array
) -> Controller:
    """Controller that would follow a trajectory exactly if the model were the arm.

    A joint that moves little inertia still gets the stiffness to bear 5 % of its torque limit
    at 0.01 rad.

    Args:
        robot: The arm, for its torque limits.
        model: What the controller believes, rotor inertia as armature.
        drives: The friction it compensates.
        trajectory: Desired motion.
        t: Instants at which the controller will be asked, shape (n,) [s].
    """
    q, dq, ddq = (np.ascontiguousarray(trajectory(t, order), dtype=float) for order in range(3))
    data, limit = model.createData(), robot.limits.torque
    feedforward = drives.friction(dq)
    gain = np.empty((len(t), robot.nv, robot.nv))
    for k in range(len(t)):
        feedforward[k] += pin.rnea(model, data, q[k], dq[k], ddq[k])
        gain[k] = pin.crba(model, data, q[k])
    floor = np.where(np.isfinite(limit), 0.05 * limit / 0.01, 0.0) / _BANDWIDTH**2
    diagonal = np.arange(robot.nv)
    gain[:, diagonal, diagonal] = np.maximum(gain[:, diagonal, diagonal], floor)
    return Controller(q, dq, feedforward, gain, limit)


def simulate(
    robot: Robot,
    believed: tuple[pin.Model, Drives],
    true: tuple[pin.Model, Drives],
    trajectory: Trajectory,
    duration: float,
    rate_hz: float,
    progress: Progress | None = None,
) -> Run:
    """Let the true arm follow a trajectory under a controller that believes another one.

    Args:
        robot: The arm, for its names and torque limits.
        believed: Model and friction of the controller.
        true: Model and friction of the arm; rotor inertia is the model's armature.
        trajectory: Desired motion; starts at rest, where the arm starts too.
        duration: Length of the run [s].
        rate_hz: Rate at which the state is kept [Hz].
        progress: Called with the fraction done.

    Raises:
        BadInput: The trajectory starts in motion, or the arm could not follow it at all.
        BadRobot: A joint moves nothing that has mass.
    """
    start = _start(robot, trajectory)
    substeps = int(np.ceil(1 / (rate_hz * _STEP) - 1e-9))
    steps = substeps * int(np.floor(duration * rate_hz + 1e-6))
    if not steps:
        raise BadInput(f"virtual arm: {duration:g} s is shorter than one sample")
    h = 1 / (rate_hz * substeps)
    model, drives = true
    arm = _Arm(model, model.createData(), drives, np.diag(h / 2 * drives.viscous), h)
    _require_mass(robot, pin.crba(arm.model, arm.data, start))
    state, kept = (start, np.zeros(robot.nv), np.zeros(robot.nv)), []
    for first in range(0, steps, _CHUNK):
        count = min(_CHUNK, steps - first)
        t = np.minimum((first + np.arange(2 * count + 1) / 2) * h, duration)
        control = tracking_controller(robot, *believed, trajectory, t)
        for k in range(count):
            if (first + k) % substeps == 0:
                kept.append((*state[:2], control(2 * k, *state[:2])))
            state = arm.step(*state, control, 2 * k + 1)
        if not np.isfinite(state[0]).all():
            raise BadInput(
                f"trajectory: {robot.name} went unstable before t = {t[-1]:.3g} s; "
                "the motion asks more than its torque limits"
            )
        if progress is not None:
            progress((first + count) / steps)
    kept.append((*state[:2], control(2 * count, *state[:2])))
    q, dq, tau = (np.array(values).reshape(-1, robot.nv) for values in zip(*kept, strict=True))
    return Run(np.arange(len(q)) / rate_hz, q, dq, tau)


def _start(robot: Robot, trajectory: Trajectory) -> Array:
    position, speed = (trajectory(np.zeros(1), order)[0] for order in (0, 1))
    if np.abs(speed).max() > _STILL:
        j = int(np.argmax(np.abs(speed)))
        raise BadInput(
            f"trajectory: joint {robot.joints[j]} starts at {speed[j]:.3g} rad/s; "
            "a virtual arm starts at rest, so lead in from rest"
        )
    return np.array(position, dtype=float)


def _require_mass(robot: Robot, M: Array) -> None:
    values, vectors = np.linalg.eigh(M)
    if values[0] <= 1e-12 * values[-1]:
        joint = robot.joints[int(np.argmax(np.abs(vectors[:, 0])))]
        raise BadRobot(
            robot.source, f"joint {joint} moves nothing that has inertia; give its link a mass"
        )


@dataclass(frozen=True, eq=False)
class _Arm:
    """The true arm with what its time step of length h needs."""

    model: Any
    data: Any
    drives: Drives
    damping: Array
    h: float

    def step(
        self, q: Array, v: Array, a: Array, control: Controller, k: int
    ) -> tuple[Array, Array, Array]:
        """Position, velocity and mean acceleration one step later."""
        h, drives = self.h, self.drives
        middle, speed = q + (h / 2) * v, v + (h / 2) * a
        wanted = control.wanted(k, middle, v)
        passive = drives.viscous * v + pin.nonLinearEffects(self.model, self.data, middle, speed)
        K = pin.crba(self.model, self.data, middle) + self.damping
        reaction: Array = (_BANDWIDTH + h / 4 * _BANDWIDTH**2) * control.gain[k]
        dry = h * drives.level(speed)
        dv = _velocity_change(K + h * reaction, h * (wanted - passive), dry, v)
        torque: Array = wanted - reaction @ dv
        saturated = np.abs(torque) > control.limit
        if saturated.any():
            reaction[saturated] = 0.0
            wanted[saturated] = np.copysign(control.limit, torque)[saturated]
            dv = _velocity_change(K + h * reaction, h * (wanted - passive), dry, v)
        return q + h * v + (h / 2) * dv, v + dv, dv / h


def _velocity_change(K: Array, impulse: Array, dry: Array, v: Array) -> Array:
    """Solution of K δ = impulse − λ, at once where no joint stops; see `stick_or_slip`."""
    sign = np.sign(v)
    delta = np.asarray(np.linalg.solve(K, impulse - dry * sign), dtype=np.float64)
    stops = (v + delta) * sign <= 0
    return stick_or_slip(K, impulse, dry, v) if stops.any() else delta


def stick_or_slip(K: Array, impulse: Array, level: Array, v: Array) -> Array:
    """Velocity change of one step with set-valued friction, by active sets.

    Solves K δ = impulse − λ with |λ_j| ≤ level_j, where λ_j = level_j sign(v_j + δ_j) for every
    joint that does not end at rest.

    Args:
        K: Mass matrix with implicit damping, shape (nv, nv) [kg·m²].
        impulse: Impulse of everything but dry friction, shape (nv,) [N·m·s].
        level: Largest impulse of dry friction, shape (nv,) [N·m·s].
        v: Velocity before, shape (nv,) [rad/s].

    Returns:
        δ, shape (nv,).
    """
    A = np.linalg.inv(K)
    slip = np.sign(v)
    stuck = (slip == 0) & (level > 0)
    delta = A @ (impulse - level * slip)
    for _ in range(4 * len(v)):
        friction = level * slip
        friction[stuck] = 0.0
        if stuck.any():
            free = A @ (impulse - friction)
            friction[stuck] = np.linalg.solve(A[np.ix_(stuck, stuck)], (free + v)[stuck])
        delta = A @ (impulse - friction)
        delta[stuck] = -v[stuck]
        excess = np.where(stuck, np.abs(friction) - level, -np.inf)
        worst = int(np.argmax(excess))
        if excess[worst] > 1e-12 * (1.0 + level[worst]):
            stuck[worst], slip[worst] = False, np.sign(friction[worst])
            continue
        reversed_ = ~stuck & (level > 0) & ((v + delta) * slip < 0)
        if not reversed_.any():
            break
        stuck |= reversed_
    return delta
