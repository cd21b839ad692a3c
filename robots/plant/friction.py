"""Friction of the plant: laws of one joint, of a shaft that two joints turn, and of bristles."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Protocol

import numpy as np

from excitant.robots.motion import Array, read_only


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


class DryLaw(Protocol):
    """Further friction of one joint, opposed to its motion."""

    @property
    def joint(self) -> int:
        """Index of the joint."""

    def level(self, speed: float, t: float, load: float) -> float:
        """Torque to overcome [N·m].

        Args:
            speed: Velocity, signed; ±0 tells the direction in which a joint would start [rad/s].
            t: Time since the arm was switched on [s].
            load: Torque that the gear transmits [N·m].
        """


@dataclass(frozen=True)
class Asymmetric:
    """F_c± + F_v± |q̇|, with other numbers for each direction; they may be negative."""

    joint: int
    coulomb: tuple[float, float]
    viscous: tuple[float, float]

    def level(self, speed: float, t: float, load: float) -> float:
        """See `DryLaw`."""
        side = 0 if math.copysign(1.0, speed) > 0 else 1
        return self.coulomb[side] + self.viscous[side] * abs(speed)


@dataclass(frozen=True)
class PowerLaw:
    """F_n |q̇|^a: drag of grease."""

    joint: int
    coefficient: float
    exponent: float

    def level(self, speed: float, t: float, load: float) -> float:
        """See `DryLaw`."""
        return float(self.coefficient * abs(speed) ** self.exponent)


@dataclass(frozen=True)
class LoadDependent:
    """F_l |τ_transmitted|: tooth friction."""

    joint: int
    share: float

    def level(self, speed: float, t: float, load: float) -> float:
        """See `DryLaw`."""
        return self.share * abs(load)


@dataclass(frozen=True)
class Warming:
    """(F_c + F_v |q̇|) e^(−t/T): what cold grease adds until it is warm."""

    joint: int
    coulomb: float
    viscous: float
    time: float

    def level(self, speed: float, t: float, load: float) -> float:
        """See `DryLaw`."""
        return (self.coulomb + self.viscous * abs(speed)) * math.exp(-t / self.time)


@dataclass(frozen=True)
class Bristles:
    """Rate-independent hysteresis (Dahl 1968): dF/dx = (F_h − F sign ẋ) / x_h.

    Solved exactly over a displacement in one direction.

    Attributes:
        level: F_h, reached after a long slide [N·m or N].
        distance: x_h, over which the force forgets its past [rad or m].
    """

    level: float
    distance: float

    def after(self, force: float, displacement: float) -> float:
        """Force once the surface has moved on."""
        end = math.copysign(self.level, displacement)
        return end + (force - end) * math.exp(-abs(displacement) / self.distance)

    def stiffness(self, force: float, speed: float) -> float:
        """dF/dx in the direction of motion."""
        sign = (speed > 0) - (speed < 0)
        return max(self.level - force * sign, 0.0) / self.distance


@dataclass(frozen=True)
class Presliding:
    """Friction of one joint that follows displacement since the last reversal."""

    joint: int
    bristles: Bristles


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
