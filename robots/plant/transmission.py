"""Elastic transmission of the plant, with play: two masses instead of one."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Transmission:
    """Elastic gear between a motor and its link, with play.

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
