"""Physics of the plant: all sources of torque, and the errors of its record."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, replace
from typing import Any

import numpy as np

from excitant.robots.motion import Array, Noun
from excitant.robots.plant.sensors import Encoder, Recorder

ROUNDED_SPEED = 1e-12  # rad/s or m/s: a planned velocity is 0 but for rounding


@dataclass(frozen=True, eq=False)
class Drives(Noun):
    """Friction and rotor inertia at the joints, each of shape (nv,)."""

    viscous: Array  # D [N·m·s/rad]
    coulomb: Array  # F_c [N·m]
    stribeck: Array  # F_s, what sticking adds to F_c [N·m]
    stribeck_velocity: Array  # v_s [rad/s]
    rotor: Array  # rotor and gear inertia at the joint side [kg·m²]
    offset: Array  # constant that the torque sensor adds [N·m]

    def friction(self, dq: Array) -> Array:
        """Torque of sliding friction at some velocities, shape (n, nv) [N·m]; none at rest."""
        direction = np.where(np.abs(dq) > ROUNDED_SPEED, np.sign(dq), 0.0)
        return self.viscous * dq + self.level(dq) * direction

    def level(self, dq: Array) -> Array:
        """Torque that a joint at this velocity must overcome beside the viscous one [N·m]."""
        return self.coulomb + self.stribeck * np.exp(
            -((dq / self.stribeck_velocity) ** 2)
        )


@dataclass(frozen=True)
class DryFriction:
    """Further friction of one joint, opposed to its motion.

    ``level`` is the torque to overcome [N·m] at a velocity, signed, where ±0 tells the direction
    in which a joint would start [rad/s], a time [s], and a torque that the gear transmits [N·m].
    """

    joint: int
    level: Callable[[float, float, float], float]


@dataclass(frozen=True)
class JointTorque:
    """Torque that one joint takes [N·m], at a position [rad] and a time [s]."""

    joint: int
    torque: Callable[[float, float], float]
    # whether position and torque are the motor's, not the link's
    on_motor: bool = False


@dataclass(frozen=True)
class Telegraph:
    """Torque ±A of a joint that changes sign at random instants (a Poisson process)."""

    joint: int
    _: KW_ONLY
    amplitude: float  # A [N·m]
    rate: float  # mean number of changes per second [1/s]

    def drawn(self, rng: np.random.Generator, duration: float) -> JointTorque:
        """The torque of one run."""
        pauses = rng.exponential(1 / self.rate, int(2 * self.rate * duration) + 20)
        changes = np.cumsum(pauses)
        return JointTorque(
            self.joint,
            lambda q, t: (
                self.amplitude * (-1.0) ** int(np.searchsorted(changes, t, "right"))
            ),
        )


@dataclass(frozen=True)
class Bristles:
    """Rate-independent hysteresis (Dahl 1968): dF/dx = (F_h − F sign ẋ) / x_h."""

    joint: int
    level: float  # F_h, reached after a long slide [N·m]
    distance: float  # x_h, over which the force forgets its past [rad]

    def after(self, force: float, displacement: float) -> float:
        """Force once the joint has moved on in one direction, solved exactly."""
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
    """

    joints: tuple[int, int]  # indices j, k
    ratio: float  # r
    viscous: float  # [N·m·s/rad]
    coulomb: float  # [N·m]


@dataclass(frozen=True)
class Gear:
    """Elastic gear between a motor and its link, with play: two masses instead of one."""

    joint: int
    stiffness: float  # [N·m/rad]
    damping: float  # [N·m·s/rad]
    gap: float  # play between the flanks, from one contact to the other [rad]
    inertia: (
        float  # what the motor has beside the rotor inertia of its drive [kg·m²]
    )

    def torque(self, deflection: float, rate: float) -> tuple[float, float, float]:
        """Torque on the link, and its derivatives by motor minus link angle and its rate."""
        beyond = deflection - max(-self.gap / 2, min(self.gap / 2, deflection))
        torque = self.stiffness * beyond + self.damping * rate
        if self.gap > 0 and torque * beyond <= 0:
            return 0.0, 0.0, 0.0
        return torque, self.stiffness, self.damping

    def deflection(self, torque: float) -> float:
        """Deflection at rest under a torque on the link [rad]."""
        slack = self.gap / 2 * ((torque > 0) - (torque < 0))
        return torque / self.stiffness + slack


@dataclass(frozen=True, eq=False)
class Truth(Noun):
    """The physics of an arm."""

    model: Any  # Pinocchio's, of the rigid bodies; never edited
    drives: Drives
    rotors: Array  # what turning rotors couple, added to the mass matrix, shape (nv, nv) [kg·m²]
    encoder: Encoder  # what the controller reads and records
    recorder: Recorder  # how the record differs from that
    dry: tuple[DryFriction, ...] = ()
    presliding: tuple[Bristles, ...] = ()
    shafts: tuple[CoupledShaft, ...] = ()
    loads: tuple[JointTorque, ...] = ()
    random: tuple[Telegraph, ...] = ()  # drawn for each run
    gears: tuple[Gear, ...] = ()  # one per joint at most

    @property
    def nv(self) -> int:
        """Number of joints."""
        return len(self.drives.rotor)

    def drawn(self, rng: np.random.Generator, duration: float) -> Truth:
        """The truth of one run: what is left to chance is drawn."""
        drawn = (torque.drawn(rng, duration) for torque in self.random)
        return replace(self, loads=(*self.loads, *drawn), random=())
