"""Torques and forces that act on the plant beside gravity and friction."""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass, replace
from typing import ClassVar, Protocol

import numpy as np

from excitant.robots.motion import Array
from excitant.robots.plant.friction import Bristles


class JointLoad(Protocol):
    """Torque that the motor of one joint must give, a function of position and time."""

    on_motor: ClassVar[bool]

    @property
    def joint(self) -> int:
        """Index of the joint."""

    def torque(self, q: float, t: float) -> float:
        """Torque [N·m] at a position [rad] of the motor or the link, and a time [s]."""


@dataclass(frozen=True)
class Ripple:
    """Cogging: A sin(n q + p), n periods per revolution of the joint."""

    on_motor: ClassVar[bool] = True
    joint: int
    amplitude: float
    order: float
    phase: float

    def torque(self, q: float, t: float) -> float:
        """See `JointLoad`."""
        return self.amplitude * math.sin(self.order * q + self.phase)


@dataclass(frozen=True)
class Coil:
    """Spring between two links: k (q − q_0)."""

    on_motor: ClassVar[bool] = False
    joint: int
    stiffness: float
    rest: float

    def torque(self, q: float, t: float) -> float:
        """See `JointLoad`."""
        return self.stiffness * (q - self.rest)


@dataclass(frozen=True)
class Counterbalance:
    """Balancer on a crank: m sin(q − q_0)."""

    on_motor: ClassVar[bool] = False
    joint: int
    moment: float
    rest: float

    def torque(self, q: float, t: float) -> float:
        """See `JointLoad`."""
        return self.moment * math.sin(q - self.rest)


@dataclass(frozen=True)
class Telegraph:
    """Torque ±A that changes sign at random instants (a Poisson process).

    Attributes:
        joint: Index of the joint.
        amplitude: A [N·m].
        rate: Mean number of changes per second [1/s].
        changes: Instants of the changes [s]; drawn for each run.
    """

    on_motor: ClassVar[bool] = False
    joint: int
    amplitude: float
    rate: float
    changes: tuple[float, ...] = ()

    def drawn(self, rng: np.random.Generator, duration: float) -> Telegraph:
        """The same torque with its changes of one run."""
        pauses = rng.exponential(1 / self.rate, int(2 * self.rate * duration) + 20)
        return replace(self, changes=tuple(np.cumsum(pauses).tolist()))

    def torque(self, q: float, t: float) -> float:
        """See `JointLoad`."""
        return self.amplitude * (-1.0) ** bisect.bisect(self.changes, t)


class TipForce(Protocol):
    """Force of the surroundings on the tool."""

    def force(self, x: Array, dx: Array, memory: float) -> Array:
        """Force on the tip in the base frame, shape (3,) [N].

        Args:
            x: Position of the tip, shape (3,) [m].
            dx: Velocity of the tip, shape (3,) [m/s].
            memory: What `remember` gave.
        """

    def remember(self, memory: float, before: Array, after: Array) -> float:
        """State of the force once the tip has moved from one place to another."""


@dataclass(frozen=True, eq=False)
class Wall:
    """Elastic wall n·x ≥ d: it pushes back with k and c per depth and speed, never pulls.

    Attributes:
        normal: n, the direction into the wall, shape (3,).
        distance: d from the origin of the base frame [m].
        stiffness: k [N/m].
        damping: c [N·s/m].
    """

    normal: Array
    distance: float
    stiffness: float
    damping: float

    def force(self, x: Array, dx: Array, memory: float) -> Array:
        """See `TipForce`."""
        depth = float(self.normal @ x) - self.distance
        if depth <= 0:
            return np.zeros(3)
        push = self.stiffness * depth + self.damping * float(self.normal @ dx)
        return -max(push, 0.0) * self.normal

    def remember(self, memory: float, before: Array, after: Array) -> float:
        """Nothing."""
        return memory


@dataclass(frozen=True, eq=False)
class Cable:
    """Cable bundle that pulls the tip toward an anchor, with friction in its guide.

    Attributes:
        anchor: Place of the guide in the base frame, shape (3,) [m].
        tension: Pull without friction [N].
        guide: Friction of the cable against its own lengthening.
    """

    anchor: Array
    tension: float
    guide: Bristles

    def force(self, x: Array, dx: Array, memory: float) -> Array:
        """See `TipForce`."""
        away: Array = self.anchor - x
        pull: Array = (self.tension + memory) / max(float(np.linalg.norm(away)), 1e-6) * away
        return pull

    def remember(self, memory: float, before: Array, after: Array) -> float:
        """Friction force of the guide."""
        lengths = [float(np.linalg.norm(self.anchor - x)) for x in (before, after)]
        return self.guide.after(memory, lengths[1] - lengths[0])
