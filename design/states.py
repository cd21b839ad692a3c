"""States (q, q̇, q̈) within a robot's limits, as a cube."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from excitant.design.constraints import position_range
from excitant.exceptions import BadInput
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot

_TINY = 1e-9


@dataclass(frozen=True, eq=False)
class StateSpace:
    """The states that a motion can pass, mapped from the cube u = (u₁, u₂, u₃) ∈ [−1, 1]^{3 nv}.

    q = middle + half u₁, q̇ = b(q) u₂, q̈ = c(q̇) u₃, with b = min(speed, Ω √(half² − (q −
    middle)²)) and c = min(acceleration, Ω √(speed² − q̇²)): for a periodic motion with harmonics
    up to Ω = H ω these are the inequalities of Bernstein and Szegő. Without a band Ω = ∞.
    """

    middle: Array
    half: Array
    speed: Array
    acceleration: Array
    top: float
    bounded: Array

    def states(self, u: Array):
        u1, u2, u3 = np.split(u, 3, axis=1)
        q = self.middle + self.half * u1
        dq = self._b(u1)[0] * u2
        ddq = self._c(dq)[0] * u3
        return q, dq, ddq

    def _b(self, u1):
        if not np.isfinite(self.top):
            return np.broadcast_to(self.speed, u1.shape), np.zeros_like(u1)
        root = np.sqrt(np.maximum(1 - u1**2, _TINY))
        arc = self.top * self.half * root
        active = self.bounded & (arc < self.speed)
        return np.where(active, arc, self.speed), np.where(
            active, -self.top * self.half * u1 / root, 0.0
        )

    def _c(self, dq):
        if not np.isfinite(self.top):
            return np.broadcast_to(self.acceleration, dq.shape), np.zeros_like(dq)
        root = np.sqrt(np.maximum(self.speed**2 - dq**2, _TINY * self.speed**2))
        arc = self.top * root
        active = arc < self.acceleration
        return np.where(active, arc, self.acceleration), np.where(
            active, -self.top * dq / root, 0.0
        )

    def pull(self, u, gq, gdq, gddq):
        """Gradient by u."""
        u1, u2, u3 = np.split(u, 3, axis=1)
        b, db = self._b(u1)
        c, dc = self._c(b * u2)
        gdq = gdq + gddq * u3 * dc
        return np.concatenate([gq * self.half + gdq * u2 * db, gdq * b, gddq * c], axis=1)

    def cube(self, q, dq, ddq):
        u1 = np.clip((q - self.middle) / self.half, -1, 1)
        u2 = np.clip(dq / self._b(u1)[0], -1, 1)
        u3 = np.clip(ddq / self._c(dq)[0], -1, 1)
        return np.concatenate([u1, u2, u3], axis=1)


def state_space(robot: Robot, top: float) -> StateSpace:
    middle, half = position_range(robot.limits)
    bounded = np.isfinite(half)
    half = np.where(bounded, half, np.pi)
    speed = np.minimum(robot.limits.velocity, np.where(bounded, top * half, np.inf))
    if not np.isfinite(speed).all():
        raise BadInput("speed")
    acceleration = np.minimum(robot.limits.acceleration, top * speed)
    if not np.isfinite(acceleration).all():
        raise BadInput("acceleration")
    return StateSpace(middle, half, speed, acceleration, top, bounded)
