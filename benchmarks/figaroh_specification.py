"""What FIGAROH is asked for; imports nothing, so that both Pythons can."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Specification:
    """What FIGAROH is asked for.

    Attributes:
        urdf: File of the robot.
        limits: ``position`` (nv, 2), and ``velocity`` and ``torque`` (nv,), SI units.
        segment_s: Duration of each segment [s].
        segments: Number of segments, stacked in the regressor of the next one.
        moves: Rest-to-rest moves per segment.
        rate_hz: Rate of the trajectory written [Hz].
        frequency_hz: Lowest rate of the regressor and constraints inside the optimiser [Hz].
        iterations: Limit on IPOPT's iterations per segment.
        attempts: New initial guesses for a segment that fails.
        seed: Seed of NumPy's global generator, which FIGAROH draws from.
        csv: File to write the trajectory to.
    """

    urdf: str
    limits: dict[str, Any]
    segment_s: float
    segments: int
    moves: int
    rate_hz: float
    frequency_hz: int
    iterations: int
    attempts: int
    seed: int
    csv: str

    @property
    def inner_hz(self) -> int:
        """Lowest rate whose samples hit every waypoint exactly, as FIGAROH presumes."""
        move = self.segment_s / self.moves
        for rate in range(self.frequency_hz, 10 * self.frequency_hz):
            samples = {k * (1 / rate) for k in range(round(self.segment_s * rate) + 1)}
            if all(move * k in samples for k in range(self.moves + 1)):
                return rate
        raise SystemExit(f"no sampling rate meets {self.moves} moves in {self.segment_s} s")

    def configuration(self, joints: list[str]) -> dict[str, Any]:
        """FIGAROH's unified configuration: rigid bodies only, no margin inside the limits."""
        components = ("friction", "joint_offset", "actuator_inertia")
        mechanics = {
            "reduction_ratios": [1.0] * len(joints),
            "friction_coefficients": {k: [0.0] * len(joints) for k in ("viscous", "static")},
            "actuator_inertias": [0.0] * len(joints),
            "joint_offsets": [0.0] * len(joints),
        }
        identification = {
            "problem": {
                "include_external_forces": False,
                "use_joint_torques": True,
                "model_components": {
                    **dict.fromkeys(components, False),
                    "static_regressor": True,
                    "inertia_regressor": True,
                },
            },
            "signal_processing": {
                "sampling_frequency": self.rate_hz,
                "cutoff_frequency": 0.1 * self.rate_hz,
            },
        }
        optimal = {
            "problem": {
                "soft_lim": 0.0,
                "max_attempts": 500,
                "max_iterations": self.iterations,
                "segment_attempts": self.attempts,
            },
            "trajectory": {
                "waypoints": self.moves + 1,
                "frequency": self.inner_hz,
                "segment_duration": self.segment_s / self.moves,
            },
        }
        return {
            "robot": {
                "name": "arm",
                "properties": {"joints": {"active_joints": joints}, "mechanics": mechanics},
            },
            "tasks": {"identification": identification, "optimal_trajectory": optimal},
        }
