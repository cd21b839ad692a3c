"""Forward dynamics of a model: what a robot with its effects does under a joint controller.

    M(q) q̈ + b(q, q̇) + τ_e(t, q, q̇) = τ,    τ = τ_ff + B (ω² (q_d − q) + 2 ω (q̇_d − q̇))

with the rotors in M, Coriolis, centrifugal and gravity torque b, and the torque τ_e of the effects
(`excitant.robots.state_torque`, which says how dry friction is smoothed near rest). A step is one
of the Rosenbrock method ROS2 (Verwer, Spee, Blom, Hundsdorfer 1999): of second order whatever
stands in for the Jacobian, here controller and friction, so that neither stiff gains nor the dry
friction of light joints limit its length.

The plant of the virtual arm (`excitant.robots.plant`) shares no code with this.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pinocchio as pin
import scipy
from scipy.linalg.lapack import dgesv

from excitant.exceptions import BadInput, ExcitantError
from excitant.robots.motion import Array, Motion, freeze, read_only
from excitant.robots.robot import Robot
from excitant.robots.state_torque import forward_model
from excitant.robots.torque import torque

STEP = 1e-3  # s: a twenty-fifth of the time constant of the default controller
LOOP_HZ = 4.0  # Hz: holds a model on a recorded motion, slower than the arm's own controller
_NEAR, _FINER = 4.0, 8  # steps from where a joint turns back, and how much finer they are there
_LONGER = 2.0  # times as many steps in all, at most
_GAMMA = 1 + np.sqrt(0.5)  # of the two that make ROS2 L-stable, the one that does not overshoot
_ASTRAY = 2 * np.pi  # rad or m beyond the range of the commanded motion: diverged
_LOOK = 16  # steps between two looks at that


class Diverged(ExcitantError):
    """A simulated robot that left its commanded motion for good.

    Args:
        robot: Name of the robot.
        joint: The joint that is farthest off.
        t: When that was seen [s].
    """

    def __init__(self, robot: str, joint: str, t: float) -> None:
        self.joint, self.t = joint, t
        super().__init__(
            f"simulation of {robot}: joint {joint} diverges at t = {t:.4g} s; its parameters may "
            "leave it without inertia or with driving friction, or the controller is too weak or "
            "too fast for the step"
        )


@dataclass(frozen=True, eq=False)
class Controller:
    """Feed-forward of a model, and a position loop in terms of its inertia.

    Attributes:
        omega: ω, natural frequency of the error, one for all joints or shape (nv,) [rad/s].
        believed: The robot whose inverse dynamics on the commanded motion gives τ_ff, and whose
            mass matrix at the commanded positions is B; the simulated one itself when None.
        floor: Smallest diagonal of B, for joints that move little, 0 or shape (nv,) [kg·m²].
    """

    omega: Array | float = 40.0
    believed: Robot | None = None
    floor: Array | float = 0.0

    def gains(self, robot: Robot, q: Array) -> tuple[Array, Array]:
        """B ω² and 2 B ω at commanded positions, each (n, nv, nv) [N·m/rad, N·m·s/rad]."""
        model, rotors, _ = forward_model(self.believed or robot)
        data, B = model.createData(), np.empty((len(q), robot.nv, robot.nv))
        for k, pose in enumerate(q):
            B[k] = pin.crba(model, data, pose)
        B += rotors
        j = np.arange(robot.nv)
        B[:, j, j] = np.maximum(B[:, j, j], self.floor)
        omega = np.broadcast_to(np.asarray(self.omega, float), robot.nv)
        return B * omega**2, 2 * B * omega


@dataclass(frozen=True, eq=False)
class Simulation:
    """What a simulated robot did.

    Attributes:
        command: The commanded motion.
        motion: The motion at the same instants; accelerations are means over one step on either
            side.
        tau: Torque of the controller at these instants, shape (n, nv) [N·m].
    """

    command: Motion
    motion: Motion
    tau: Array

    def __post_init__(self) -> None:
        freeze(self, "tau")

    @property
    def error(self) -> Array:
        """Commanded minus simulated positions, shape (n, nv) [rad or m]."""
        return read_only(self.command.q - self.motion.q)

    @property
    def rms(self) -> Array:
        """Root mean square error of position per joint, shape (nv,) [rad or m]."""
        return read_only(np.sqrt((self.error**2).mean(axis=0)))


def simulate(
    robot: Robot,
    command: Motion,
    controller: Controller | None = None,
    *,
    applied: Array | None = None,
    step: float = STEP,
) -> Simulation:
    """Let a model with its effects follow a motion, from that motion's first state.

    Between its instants the commanded motion is the quintic polynomial through position, velocity
    and acceleration at both; torque given is linear.

    Args:
        robot: The model; effects need values.
        command: Desired motion; its time may be irregular, but must rise.
        controller: What closes the loop; without one, the command gives instants and start only.
        applied: Torque in place of the controller's feed-forward, shape (n, nv) [N·m].
        step: Longest step of integration [s]; an eighth of it where joints turn back.

    Raises:
        BadInput: Effects that cannot be simulated, or shapes and times that do not fit.
        Diverged: The simulation left the commanded motion for good, or holds no numbers any more.
    """
    _check(robot, command, applied, step)
    counts = _steps(command, step)
    inner = _between(command, counts)
    if applied is not None:
        columns = [np.interp(inner.t, command.t, column) for column in np.asarray(applied).T]
        forward = np.column_stack(columns)
    elif controller is None:
        forward = np.zeros_like(inner.q)
    else:
        forward = torque(controller.believed or robot, inner)
    gains = None if controller is None else controller.gains(robot, inner.q)
    with np.errstate(over="ignore", invalid="ignore"):  # a diverging simulation is refused
        q, dq, tau = _integrated(robot, inner, forward, gains)
    ddq = np.gradient(dq, inner.t, axis=0)
    keep = np.concatenate([[0], np.cumsum(counts)])
    return Simulation(command, Motion(command.t, q[keep], dq[keep], ddq[keep]), tau[keep])


def forward_error(
    robot: Robot,
    motion: Motion,
    tau: Array,
    *,
    bandwidth_hz: float = LOOP_HZ,
    step: float = STEP,
) -> Simulation:
    """Drive the model with recorded torque, held on the recorded motion by a slow loop.

    Torque that the model does not need, or lacks, δτ, moves it by about δτ / (B ω²) below the
    bandwidth and by δτ / (M (2πf)²) at frequencies f above. Without the loop any model drifts
    away, and in a slow one a joint that sticks for too much dry friction is left behind; compare
    models in one and the same loop. A joint that moves so little inertia that its rms torque would
    turn it by more than a radian gets the stiffness for that.

    Args:
        robot: The model; effects need values.
        motion: Recorded motion, filtered, as of `excitant.identify.preprocessing.Segment`.
        tau: Recorded torque at its instants, shape (n, nv) [N·m].
        bandwidth_hz: ω / 2π of the loop, critically damped [Hz].
        step: Longest step of integration [s].

    Raises:
        BadInput: Effects that cannot be simulated, or shapes and times that do not fit.
        Diverged: The model left the motion for good.
    """
    if not bandwidth_hz > 0:
        raise BadInput(f"forward error: bandwidth {bandwidth_hz:g} Hz; give a positive one")
    omega = 2 * np.pi * bandwidth_hz
    floor = np.sqrt((np.asarray(tau, float) ** 2).mean(axis=0)) / omega**2
    loop = Controller(omega, believed=robot, floor=floor)
    return simulate(robot, motion, loop, applied=tau, step=step)


def _check(robot: Robot, command: Motion, applied: Array | None, step: float) -> None:
    if command.nv != robot.nv or len(command) < 2:
        raise BadInput(
            f"simulation: a motion of {command.nv} joints at {len(command)} instants for "
            f"{robot.name} with {robot.nv}; give two instants or more of its joints"
        )
    if not (np.diff(command.t) > 0).all() or not step > 0:
        raise BadInput(
            f"simulation: time of the motion must rise, and the step be positive ({step})"
        )
    if applied is not None and applied.shape != command.q.shape:
        raise BadInput(
            f"simulation: torque of shape {applied.shape} on a motion of shape "
            f"{command.q.shape}; give one row per instant"
        )


def _steps(command: Motion, step: float) -> npt.NDArray[np.intp]:
    """Steps of integration between each two instants, more where a joint turns back.

    Dry friction jumps there, and a method that steps over the jump is of first order only.
    """
    dt = np.diff(command.t)
    counts = np.maximum(1, np.ceil(dt / step - 1e-9)).astype(np.intp)
    reach = _NEAR * (dt / counts)[:, None] * np.abs(command.ddq)[1:]
    turns = (np.abs(command.dq[1:]) < reach) | (command.dq[1:] * command.dq[:-1] < 0)
    near = scipy.ndimage.maximum_filter1d(turns.any(axis=1), 3)
    finer = np.clip(_LONGER / max(float(near.mean()), 1e-9), 1, _FINER)
    return np.where(near, counts * int(finer), counts)


def _between(motion: Motion, counts: npt.NDArray[np.intp]) -> Motion:
    """The motion with instants put in between its own, so that steps are as many as said."""
    if (counts == 1).all():
        return motion
    at = np.repeat(np.arange(len(counts)), counts)
    first = np.concatenate([[0], np.cumsum(counts)[:-1]])
    s = ((np.arange(len(at)) - first[at]) / counts[at])[:, None]
    h = np.diff(motion.t)[at][:, None]
    p0, p1 = motion.q[at], motion.q[at + 1]
    v0, v1, a0, a1 = (
        size * values
        for size, x in ((h, motion.dq), (h**2, motion.ddq))
        for values in (x[at], x[at + 1])
    )
    c3 = 10 * (p1 - p0) - 6 * v0 - 4 * v1 - 1.5 * a0 + 0.5 * a1
    c4 = -15 * (p1 - p0) + 8 * v0 + 7 * v1 + 1.5 * a0 - a1
    c5 = 6 * (p1 - p0) - 3 * (v0 + v1) - 0.5 * a0 + 0.5 * a1
    q = p0 + s * (v0 + s * (a0 / 2 + s * (c3 + s * (c4 + s * c5))))
    dq = (v0 + s * (a0 + s * (3 * c3 + s * (4 * c4 + s * 5 * c5)))) / h
    ddq = (a0 + s * (6 * c3 + s * (12 * c4 + s * 20 * c5))) / h**2
    last = motion[-1:]
    t = np.append(motion.t[at] + s[:, 0] * h[:, 0], last.t)
    return Motion(t, *(np.vstack(pair) for pair in ((q, last.q), (dq, last.dq), (ddq, last.ddq))))


def _integrated(
    robot: Robot, command: Motion, forward: Array, gains: tuple[Array, Array] | None
) -> tuple[Array, Array, Array]:
    """Positions, velocities and torque at every instant, each of shape (n, nv)."""
    model, rotors, effects = forward_model(robot)
    data, n, nv = model.createData(), len(command), robot.nv
    K, C = (np.zeros((1, nv, nv)),) * 2 if gains is None else gains
    stay = 0 if gains is None else 1
    t, target, speed = command.t.tolist(), command.q, command.dq
    allowed = np.inf if gains is None else _ASTRAY + np.ptp(target, axis=0)
    kept_q, kept_v, tau = (np.empty((n, nv)) for _ in range(3))
    q, v, a = target[0].copy(), speed[0].copy(), np.zeros(nv)
    effects.advance(q)
    crba, bias, mass = pin.crba, pin.nonLinearEffects, rotors.any()
    diagonal = np.arange(nv) * (nv + 1)
    for k in range(n):
        Kk, Ck = K[k * stay], C[k * stay]
        u = forward[k] + Kk @ (target[k] - q) + Ck @ (speed[k] - v)
        kept_q[k], kept_v[k], tau[k] = q, v, u
        if k % _LOOK == 0 or k == n - 1:
            _look(robot, t[k], target[k] - q, v, allowed)
        if k == n - 1:
            break
        h = t[k + 1] - t[k]
        gh = _GAMMA * h
        damping = gh * Ck + (gh * gh) * Kk
        damping.flat[diagonal] += gh * effects.slope(t[k], q, v, a)
        ahead = gh * (Kk @ speed[k] + Ck @ command.ddq[k])
        M = crba(model, data, q) + rotors if mass else crba(model, data, q)
        F = u - bias(model, data, q, v) - effects(t[k], q, v, a)
        a1 = dgesv(M + damping, F + ahead - gh * (Kk @ v))[2]
        v1 = v + gh * a1
        end, fast = q + h * v1, v + h * a1
        Kn, Cn = K[(k + 1) * stay], C[(k + 1) * stay]
        u = forward[k + 1] + Kn @ (target[k + 1] - end) + Cn @ (speed[k + 1] - fast)
        M = crba(model, data, end) + rotors if mass else crba(model, data, end)
        F = u - bias(model, data, end, fast) - effects(t[k + 1], end, fast, a)
        rest = fast - 2 * v1
        a2 = dgesv(M + damping, F - ahead - 2 * (M @ a1) - gh * (Kk @ rest))[2]
        q = q + (1.5 * h) * v1 + (0.5 * h) * (rest + gh * a2)
        a = 1.5 * a1 + 0.5 * a2
        v = v + h * a
        effects.advance(q)
    return kept_q, kept_v, tau


def _look(robot: Robot, t: float, error: Array, v: Array, allowed: Array | float) -> None:
    wrong = ~(np.abs(error) <= allowed) | ~np.isfinite(v)
    if wrong.any():
        size = np.where(np.isfinite(error), np.abs(error), np.inf)
        raise Diverged(robot.name, robot.joints[int(np.argmax(np.where(wrong, size, -1)))], t)
