"""States (q, q̇, q̈) that a motion within a robot's limits can pass, as a cube."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from excitant.design.constraints import position_range
from excitant.exceptions import BadInput
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot
from excitant.robots.torque import torque

_TINY = 1e-9  # keeps the slope of an arc finite at its end
_POSES = 500
_SHRINKS = 25


@dataclass(frozen=True, eq=False)
class StateSpace:
    """The image of the cube u = (u₁, u₂, u₃) ∈ [−1, 1]^{3 nv}, less what torque forbids.

    q = middle + half u₁, q̇ = b(q) u₂ and q̈ = c(q̇) u₃ joint by joint, where

        b = min(speed, Ω √(half² − (q − middle)²)),   c = min(acceleration, Ω √(speed² − q̇²)).

    For a finite Fourier series with harmonics up to Ω = Hω these are the inequalities of
    Bernstein and Szegő; for any other motion Ω = ∞.

    Attributes:
        robot: The arm.
        middle: Middle of each joint's range, shape (nv,).
        half: Half the range; π for a joint that turns freely, shape (nv,).
        bounded: Whether the joint has position limits, shape (nv,).
        speed: Highest speed, shape (nv,).
        acceleration: Highest acceleration, shape (nv,).
        top: Ω, the highest angular frequency [rad/s].
    """

    robot: Robot
    middle: Array
    half: Array
    bounded: Array
    speed: Array
    acceleration: Array
    top: float

    def motion(self, u: Array) -> Motion:
        """States of points of the cube, shape (n, 3 nv), numbered instead of timed."""
        u1, u2, u3 = np.split(u, 3, axis=1)
        dq = self._speeds(u1)[0] * u2
        return numbered(self.middle + self.half * u1, dq, self._accelerations(dq)[0] * u3)

    def cube(self, motion: Motion) -> Array:
        """Points of the cube for states, the nearest where a state is outside."""
        u1 = (motion.q - self.middle) / self.half
        u1 = np.where(self.bounded, np.clip(u1, -1, 1), np.mod(u1 + 1, 2) - 1)
        u2 = np.clip(motion.dq / self._speeds(u1)[0], -1, 1)
        u3 = np.clip(motion.ddq / self._accelerations(motion.dq)[0], -1, 1)
        return np.concatenate([u1, u2, u3], axis=1)

    def pull(self, u: Array, by_q: Array, by_dq: Array, by_ddq: Array) -> Array:
        """Gradient by u from the gradients by q, q̇ and q̈."""
        u1, u2, u3 = np.split(u, 3, axis=1)
        b, db = self._speeds(u1)
        c, dc = self._accelerations(b * u2)
        by_dq = by_dq + by_ddq * u3 * dc
        return np.concatenate([by_q * self.half + by_dq * u2 * db, by_dq * b, by_ddq * c], axis=1)

    def excess(self, motion: Motion) -> Array:
        """Largest torque over its limit at each state, shape (n,)."""
        worst: Array = self.use(motion)[0].max(axis=1)
        return worst

    def use(self, motion: Motion) -> tuple[Array, Array]:
        """Size of each torque over its limit, and its sign, both (n, nv)."""
        tau = torque(self.robot, motion)
        return np.abs(tau) / self.robot.limits.torque, np.sign(tau)

    def slowed(self, motion: Motion) -> Motion:
        """The states, time stretched until torque holds; those that gravity forbids left out."""
        share = np.full(len(motion), np.nan)
        share[self.excess(motion) <= 1] = 1.0
        for factor in np.linspace(0.99, 0.0, _SHRINKS):
            rest = np.flatnonzero(np.isnan(share))
            if not len(rest):
                break
            slower = numbered(
                motion.q[rest], factor * motion.dq[rest], factor**2 * motion.ddq[rest]
            )
            share[rest[self.excess(slower) <= 1]] = factor
        keep, s = ~np.isnan(share), share[:, None]
        return numbered(motion.q[keep], (s * motion.dq)[keep], (s**2 * motion.ddq)[keep])

    def _speeds(self, u1: Array) -> tuple[Array, Array]:
        """Limit b and its derivative by u₁."""
        return _arc(u1, np.where(self.bounded, self.top * self.half, np.inf), self.speed)

    def _accelerations(self, dq: Array) -> tuple[Array, Array]:
        """Limit c and its derivative by q̇."""
        c, dc = _arc(dq / self.speed, self.top * self.speed, self.acceleration)
        return c, dc / self.speed


def numbered(q: Array, dq: Array, ddq: Array) -> Motion:
    """States that follow no time."""
    return Motion(np.arange(len(q), dtype=float), q, dq, ddq)


def state_space(robot: Robot, top: float) -> StateSpace:
    """Feasible states of motions without angular frequencies above ``top`` [rad/s].

    Raises:
        BadInput: A joint's speed or acceleration, or a sliding joint's position, is unlimited.
    """
    middle, half = position_range(robot.limits)
    bounded = np.isfinite(half)
    _refuse(robot, ~bounded & ~robot.revolute, "slides without position limits")
    half = np.where(bounded, half, np.pi)
    speed = np.minimum(robot.limits.velocity, np.where(bounded, top * half, np.inf))
    _refuse(robot, np.isinf(speed), "has no velocity limit")
    acceleration = np.minimum(robot.limits.acceleration, top * speed)
    if np.isinf(acceleration).any():
        acceleration = np.minimum(acceleration, _torque_reach(robot, middle, half, speed))
    _refuse(robot, np.isinf(acceleration), "has neither an acceleration nor torque limits")
    return StateSpace(robot, middle, half, bounded, speed, acceleration, top)


def _arc(x: Array, radius: Array, cap: Array) -> tuple[Array, Array]:
    """min(radius √(1 − x²), cap) and its derivative by x."""
    root = np.sqrt(np.maximum(1 - x**2, _TINY))
    with np.errstate(invalid="ignore"):
        arc, slope = radius * root, -radius * x / root
    flat = ~(arc < cap)
    return np.where(flat, cap, arc), np.where(flat, 0.0, slope)


def _torque_reach(robot: Robot, middle: Array, half: Array, speed: Array) -> Array:
    """Twice the largest acceleration that torque limits leave at random states, shape (nv,)."""
    rng = np.random.default_rng(0)
    q = middle + half * rng.uniform(-1, 1, (_POSES, robot.nv))
    dq = speed * rng.uniform(-1, 1, q.shape)
    at_rest = torque(robot, numbered(q, dq, np.zeros_like(q)))
    columns = []
    for unit in np.eye(robot.nv):
        unit_torque = torque(robot, numbered(q, dq, np.broadcast_to(unit, q.shape)))
        columns.append(unit_torque - at_rest)
    inverse = np.linalg.inv(np.stack(columns, axis=2))
    room = robot.limits.torque + np.abs(at_rest)
    with np.errstate(invalid="ignore"):
        reach = np.einsum("nij,nj->ni", np.abs(inverse), room)
    most: Array = 2 * reach.max(axis=0)
    return np.where(np.isnan(most), np.inf, most)


def _refuse(robot: Robot, culprits: npt.NDArray[np.bool_], why: str) -> None:
    if np.any(culprits):
        joint = robot.joints[int(np.flatnonzero(culprits)[0])]
        raise BadInput(
            f"no lower bound for {robot.name}: joint {joint} {why}, so that the states it can "
            "pass are unlimited; give the limit"
        )
