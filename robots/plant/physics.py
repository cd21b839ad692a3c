"""Physics of the plant: everything that makes torque, and what its record shows of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any, Protocol

import numpy as np

from excitant.robots.motion import Array, freeze, read_only
from excitant.robots.plant.sensors import Encoder, Recorder


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
        freeze(self, *(field.name for field in fields(self)))

    def friction(self, dq: Array) -> Array:
        """Torque of sliding friction at some velocities, shape (n, nv) [N·m]."""
        return self.viscous * dq + self.level(dq) * np.sign(dq)

    def level(self, dq: Array) -> Array:
        """Torque that a joint at this velocity must overcome beside the viscous one [N·m]."""
        return self.coulomb + self.stribeck * np.exp(-((dq / self.stribeck_velocity) ** 2))


@dataclass(frozen=True)
class DryFriction:
    """Further friction of one joint, opposed to its motion.

    Attributes:
        joint: Index of the joint.
        level: Torque to overcome [N·m] at a velocity, signed, where ±0 tells the direction in
            which a joint would start [rad/s], a time since the arm was switched on [s], and a
            torque that the gear transmits [N·m].
        loaded: Whether it depends on the latter.
    """

    joint: int
    level: Callable[[float, float, float], float]
    loaded: bool = False


@dataclass(frozen=True)
class JointTorque:
    """Torque that one joint takes [N·m], at a position [rad] and a time [s].

    Attributes:
        joint: Index of the joint.
        torque: The torque.
        on_motor: Whether position and torque are the motor's, not the link's.
    """

    joint: int
    torque: Callable[[float, float], float]
    on_motor: bool = False


@dataclass(frozen=True)
class Telegraph:
    """Torque ±A of a joint that changes sign at random instants (a Poisson process).

    Attributes:
        joint: Index of the joint.
        amplitude: A [N·m].
        rate: Mean number of changes per second [1/s].
    """

    joint: int
    amplitude: float
    rate: float

    def drawn(self, rng: np.random.Generator, duration: float) -> JointTorque:
        """The torque of one run."""
        pauses = rng.exponential(1 / self.rate, int(2 * self.rate * duration) + 20)
        changes = np.cumsum(pauses)
        return JointTorque(
            self.joint,
            lambda q, t: self.amplitude * (-1.0) ** int(np.searchsorted(changes, t, "right")),
        )


@dataclass(frozen=True)
class Bristles:
    """Rate-independent hysteresis (Dahl 1968): dF/dx = (F_h − F sign ẋ) / x_h.

    Solved exactly over a displacement in one direction.

    Attributes:
        level: F_h, reached after a long slide [N·m or N].
        distance: x_h, over which the force forgets its past [rad or m].
        joint: Index of the joint whose friction it is.
    """

    level: float
    distance: float
    joint: int = 0

    def after(self, force: float, displacement: float) -> float:
        """Force once the surface has moved on."""
        end = math.copysign(self.level, displacement)
        return end + (force - end) * math.exp(-abs(displacement) / self.distance)

    def stiffness(self, force: float, speed: float) -> float:
        """dF/dx in the direction of motion."""
        sign = (speed > 0) - (speed < 0)
        return max(self.level - force * sign, 0.0) / self.distance


@dataclass(frozen=True)
class CoupledShaft:
    """A shaft turned at q̇_j + r q̇_k, with viscous and dry friction of its own.

    Its friction torque T acts on joint j as T and on joint k as r T, as the coupled motors of a
    wrist do (Stäubli TX40, Gautier and Janot).

    Attributes:
        joints: Indices j, k.
        ratio: r.
        viscous: [N·m·s/rad].
        coulomb: [N·m].
    """

    joints: tuple[int, int]
    ratio: float
    viscous: float
    coulomb: float


@dataclass(frozen=True)
class Gear:
    """Elastic gear between a motor and its link, with play: two masses instead of one.

    Attributes:
        joint: Index of the joint.
        stiffness: [N·m/rad].
        damping: [N·m·s/rad].
        gap: Play between the flanks, from one contact to the other [rad].
        inertia: What the motor has beside the rotor inertia of its drive [kg·m²].
    """

    joint: int
    stiffness: float
    damping: float
    gap: float = 0.0
    inertia: float = 0.0

    def torque(self, deflection: float, rate: float) -> tuple[float, float, float]:
        """Torque on the link, and its derivatives by deflection and rate.

        Args:
            deflection: Motor minus link angle, both at the joint side [rad].
            rate: Its derivative [rad/s].
        """
        beyond = deflection - max(-self.gap / 2, min(self.gap / 2, deflection))
        torque = self.stiffness * beyond + self.damping * rate
        if self.gap > 0 and torque * beyond <= 0:
            return 0.0, 0.0, 0.0
        return torque, self.stiffness, self.damping

    def deflection(self, torque: float) -> float:
        """Deflection at rest under a torque on the link [rad]."""
        return torque / self.stiffness + (self.gap / 2) * ((torque > 0) - (torque < 0))


class TipForce(Protocol):
    """Force of the surroundings on the tool."""

    def force(self, x: Array, dx: Array, memory: float) -> Array:
        """Force on the tip at a position [m] and velocity [m/s] in the base frame, (3,) [N]."""

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


@dataclass(frozen=True, eq=False)
class Truth:
    """The physics of an arm.

    Attributes:
        model: Pinocchio's model of the rigid bodies; never edited.
        drives: Friction and rotor inertia of the joints.
        rotors: What turning rotors couple, added to the mass matrix, shape (nv, nv) [kg·m²].
        encoder: What the controller reads and records.
        recorder: How the record differs from that.
        dry: Further friction of single joints.
        presliding: Friction of single joints that remembers displacement.
        shafts: Friction on the sum of two joints' speeds.
        loads: Torques on single joints.
        random: Torques on single joints that are drawn for each run.
        forces: Forces on the tip.
        tip: Pinocchio's frame of the tip.
        gears: Elastic gears, one per joint at most.
    """

    model: Any
    drives: Drives
    rotors: Array
    encoder: Encoder
    recorder: Recorder
    dry: tuple[DryFriction, ...] = ()
    presliding: tuple[Bristles, ...] = ()
    shafts: tuple[CoupledShaft, ...] = ()
    loads: tuple[JointTorque, ...] = ()
    random: tuple[Telegraph, ...] = ()
    forces: tuple[TipForce, ...] = ()
    tip: int = 0
    gears: tuple[Gear, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "rotors", read_only(self.rotors))

    @property
    def nv(self) -> int:
        """Number of joints."""
        return len(self.drives.rotor)

    @property
    def distorted(self) -> bool:
        """Whether the encoders lie."""
        return bool((self.encoder.scale != 1).any() or self.encoder.offset.any())

    def drawn(self, rng: np.random.Generator, duration: float) -> Truth:
        """The truth of one run: what is left to chance is drawn."""
        drawn = (torque.drawn(rng, duration) for torque in self.random)
        return replace(self, loads=(*self.loads, *drawn), random=())


def rigid_truth(model: Any, drives: Drives, tip: int) -> Truth:
    """Rigid bodies with drives and sensors that tell the truth."""
    n = len(drives.rotor)
    honest = Encoder(np.ones(n), np.zeros(n)), Recorder(np.eye(n), np.zeros(n))
    return Truth(model, drives, np.zeros((n, n)), *honest, tip=tip)
