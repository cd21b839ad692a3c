"""Torque of the rigid bodies and its regressor Y(q, q̇, q̈): linear in the parameters, τ = Y φ.

Values come from Pinocchio's C++ regressor. The derivatives are exact, not approximations,
because of the form of Y:

* linear in q̈, so a unit difference is the derivative;
* quadratic in q̇, so a central difference of any step is the derivative;
* for a revolute joint a trigonometric polynomial of degree 2 in its angle (the kinetic and
  potential energy are), so differentiating the interpolant through five equidistant angles is
  the derivative; for a prismatic joint a polynomial of degree 2, so a central difference is.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pinocchio as pin

from excitant.robots.motion import Array, Motion, frozen, read_only
from excitant.robots.robot import Robot

CIRCLE = 0.4 * np.pi * np.arange(5)
"""Angles of a revolute joint [rad] whose torques give that at any other; see `circle_weights`."""
_TURNS = [(x, 0.5 * (-1) ** k / np.sin(x / 2)) for k, x in enumerate(CIRCLE[1:])]
_LINE = [(1.0, 0.5), (-1.0, -0.5)]  # steps of a derivative by position, weights

ROUNDING = 1e-12  # of the largest torque of a motion, up to which there is none
CACHED_MOTIONS = 8  # the segments of one diagnosis, fitted and held out


def regressor(robot: Robot, motion: Motion) -> Array:
    """Regressor at every instant of a motion.

    Returns:
        Shape (n, nv, 10 nv): torque of joint i at instant k is ``Y[k, i] @ robot.phi``.
    """
    return _evaluate(robot, motion.q, motion.dq, motion.ddq)


def _evaluate(robot: Robot, q: Array, dq: Array, ddq: Array) -> Array:
    model = robot.model
    data = model.createData()
    Y = np.empty((len(q), robot.nv, 10 * robot.nv))
    for k, state in enumerate(zip(q, dq, ddq, strict=True)):
        Y[k] = pin.computeJointTorqueRegressor(model, data, *state)
    return Y


@dataclass(frozen=True, eq=False)
class RegressorDerivatives:
    """Regressor with its derivatives by each joint's position, velocity and acceleration.

    ``Y`` has shape (n, nv, 10 nv), the others (nv, n, nv, 10 nv), the joint first.
    """

    Y: Array
    by_q: Array
    by_dq: Array
    by_ddq: Array


def regressor_derivatives(robot: Robot, motion: Motion) -> RegressorDerivatives:
    """Exact derivatives of the regressor at every instant of a motion."""
    q = motion.q
    dq = motion.dq
    ddq = motion.ddq
    Y = _evaluate(robot, q, dq, ddq)
    shape = (robot.nv, *Y.shape)
    by_q = np.zeros(shape)
    by_dq = np.empty(shape)
    by_ddq = np.empty(shape)
    for j, unit in enumerate(np.eye(robot.nv)):
        by_ddq[j] = _evaluate(robot, q, dq, ddq + unit) - Y
        ahead = _evaluate(robot, q, dq + unit, ddq)
        behind = _evaluate(robot, q, dq - unit, ddq)
        by_dq[j] = (ahead - behind) / 2
        for step, weight in _TURNS if robot.revolute[j] else _LINE:
            by_q[j] += weight * _evaluate(robot, q + step * unit, dq, ddq)
    return RegressorDerivatives(Y, by_q, by_dq, by_ddq)


def circle_weights(angle: Array) -> Array:
    """Weights of the values at `CIRCLE` in that at an angle [rad], shapes (1,) and (5,).

    They are those of the interpolating trigonometric polynomial of degree 2.
    """
    apart = angle - CIRCLE
    return (1 + 2 * np.cos(apart) + 2 * np.cos(2 * apart)) / 5


def rigid_body_torque(robot: Robot, motion: Motion) -> Array:
    """Torque of the rigid bodies alone by recursive Newton-Euler, shape (n, nv) [N·m]."""
    moved = (motion.q.T, motion.dq.T, motion.ddq.T)
    tau = pin.rneaInParallel(1, pin.ModelPool(robot.model, 1), *moved)
    # that of one joint comes without its dimension
    return np.reshape(tau.T, motion.q.shape)


@lru_cache(maxsize=CACHED_MOTIONS)
def rigid_torque(robot: Robot, motion: Motion) -> Array:
    """Torque of the rigid bodies, kept for the next effect that asks, shape (n, nv) [N·m]."""
    return _without_rounding(rigid_body_torque(robot, motion))


def _without_rounding(values: Array) -> Array:
    """Values just made, of which those that are only what rounding leaves of zero become zero."""
    size = np.abs(values)
    values[size <= ROUNDING * size.max(initial=0.0)] = 0.0
    return frozen(values)


@lru_cache(maxsize=CACHED_MOTIONS)
def carried_torque(robot: Robot, motion: Motion) -> Array:
    """Torque of the bodies and of all effects that do not depend on it, shape (n, nv) [N·m]."""
    total = np.array(rigid_torque(robot, motion))
    for effect in robot.effects:
        if effect.values is not None and not effect.physics.on_torque:
            total += effect.torque(robot, motion)
    return read_only(total)


@lru_cache(maxsize=CACHED_MOTIONS)
def torque_derivatives(robot: Robot, motion: Motion) -> tuple[Array, Array, Array]:
    """Derivatives of the rigid-body torque by q, q̇ and q̈, each of shape (n, nv, nv).

    Row i, column j: torque of joint i by motion of joint j (Carpentier and Mansard 2018).
    """
    model = robot.model
    data = model.createData()
    # what one joint does lies together
    by_joint = np.empty((3, robot.nv, len(motion), robot.nv))
    parts = by_joint.transpose(0, 2, 3, 1)
    for k in range(len(motion)):
        parts[:, k] = pin.computeRNEADerivatives(
            model, data, motion.q[k], motion.dq[k], motion.ddq[k]
        )
    by_q, by_dq, by_ddq = map(_without_rounding, parts)
    return by_q, by_dq, by_ddq


def torque_along(robot: Robot, motion: Motion, joint: int, *shifts: Array) -> Array:
    """Change of the torque when one joint's true angle differs from the measured one.

    Args:
        robot: The arm.
        motion: Measured motion.
        joint: Index of the joint.
        shifts: True less measured angle per unit of each coefficient, shape (n,).

    Returns:
        Shape (n, nv, k) [N·m per unit].
    """
    changed = np.zeros((*motion.q.shape, len(shifts)))
    lasts = np.ptp(motion.t) > 0  # else it is one instant, where nothing changes
    rate = np.column_stack(shifts)
    for order, by in enumerate(torque_derivatives(robot, motion)):
        if order:
            rate = np.gradient(rate, motion.t, axis=0) if lasts else 0 * rate
        changed += by[:, :, [joint]] * rate[:, None]
    return changed


def gravity_torque(robot: Robot, motion: Motion, gravity: Array) -> Array:
    """Static torque of the bodies under a gravity vector in the base frame, shape (n, nv) [N·m]."""
    model = robot.with_gravity(gravity).model
    data = model.createData()
    return np.array(
        [pin.computeGeneralizedGravity(model, data, q) for q in motion.q]
    )
