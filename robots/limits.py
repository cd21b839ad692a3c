"""Limits of an arm's joints."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from excitant.exceptions import BadInput
from excitant.robots.motion import Array, freeze

if TYPE_CHECKING:
    from excitant.robots.robot import Robot

LIMIT_NAMES = ("position", "velocity", "acceleration", "torque", "jerk")
UNLIMITED = 1e9  # kg, m, rad, kg·m², N·m: beyond any arm's size; of a limit, that there is none
LEAST = 1e-12  # kg: a cube of steel of 5 µm; rad/s, N·m or the like: nothing moves
# of a joint's range: wrists turn up to 5 or without end, a limit of 30° read as 30 rad 10
MOST_TURNS = 6.0
TOUCHED = 0.99  # share of a limit from which on it counts as touched


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of the joints; ``inf`` where there is none.

    Attributes:
        position: Lowest and highest position, shape (nv, 2) [rad or m].
        velocity: Highest speed, shape (nv,) [rad/s or m/s].
        acceleration: Highest acceleration, shape (nv,) [rad/s² or m/s²].
        torque: Highest torque, shape (nv,) [N·m or N].
        jerk: Highest jerk, shape (nv,) [rad/s³ or m/s³]; none by default.
        mass_uncertainty: Share by which the inertial parameters of each link may be larger or
            smaller than the model's, for all of which the torque limits must hold.
    """

    position: Array
    velocity: Array
    acceleration: Array
    torque: Array
    jerk: Array = field(default_factory=lambda: np.array(np.inf))
    mass_uncertainty: float = 0.0

    def __post_init__(self) -> None:
        jerk = np.broadcast_to(self.jerk, np.shape(self.velocity))
        object.__setattr__(self, "jerk", jerk)
        freeze(self, *LIMIT_NAMES)

    @property
    def orders(self) -> int:
        """Number of limited derivatives of q, q included: 3, or 4 with limits on jerk."""
        return 4 if np.isfinite(self.jerk).any() else 3

    @property
    def usual_speed(self) -> Array:
        """Highest speed, 3 where there is none, shape (nv,) [rad/s or m/s]."""
        return np.where(self.velocity < 1e3, self.velocity, 3.0)

    @property
    def usual_acceleration(self) -> Array:
        """Highest acceleration, 10 where there is none, shape (nv,) [rad/s² or m/s²]."""
        return np.where(self.acceleration < 1e4, self.acceleration, 10.0)

    def of(self, joints: list[int]) -> Limits:
        """Limits of some of the joints, by index."""
        return replace(
            self, **{name: getattr(self, name)[joints] for name in LIMIT_NAMES}
        )

    def used(self, share: float) -> Limits:
        """Limits of which velocity, acceleration, torque and jerk are a share of these (of 1)."""
        if not 0 < share <= 1:
            raise BadInput(
                f"use of {share:g}: give the share of the limits, above 0 and up to 1"
            )
        return replace(
            self, **{name: share * getattr(self, name) for name in LIMIT_NAMES[1:]}
        )


def endless_ranges(robot: Robot) -> tuple[tuple[str, ...], str]:
    """Joints that turn farther than most do, and how it is said; none and nothing otherwise."""
    span = np.ptp(robot.limits.position, axis=1)
    wide = robot.revolute & np.isfinite(span) & (span > 2 * np.pi * MOST_TURNS)
    if not wide.any():
        return (), ""
    low, high = robot.limits.position[int(np.argmax(wide))]
    sentence = (
        f"its range of {low:.4g} to {high:.4g} rad is over {MOST_TURNS:g} turns, perhaps of "
        "degrees; give radians in the <limit>, or with --limits"
    )
    return tuple(np.array(robot.joints)[wide].tolist()), sentence


def unlimited(robot: Robot) -> str:
    """Joints whose torque no limit bounds, in words; empty without any."""
    free = np.array(robot.joints)[np.isinf(robot.limits.torque)]
    return f"torque of {', '.join(free)}, no limit is given" if len(free) else ""


def require_limits(robot: Robot) -> str | None:
    """A sentence about ranges that may be in degrees, or acceleration limits that are missing.

    Raises:
        BadInput: Limits of speed are missing, or of both acceleration and torque; says which file
            to write.
    """
    limits = robot.limits
    joints = np.array(robot.joints)
    free = np.isinf(limits.acceleration)
    unbounded = free & np.isinf(limits.torque)
    missing = {
        "velocity": ("velocity limits", joints[np.isinf(limits.velocity)]),
        "acceleration": ("limits on acceleration or torque", joints[unbounded]),
    }
    lacking = {name: found for name, found in missing.items() if len(found[1])}
    if lacking:
        what = " and no ".join(kind for kind, _ in lacking.values())
        entries = " and ".join(
            f"'{name}: {{{', '.join(f'{j}: ..' for j in names)}}}'"
            for name, (_, names) in lacking.items()
        )
        raise BadInput(
            f"{robot.source or robot.name} gives no {what} of some joints; write limits.yaml with "
            f"{entries} [rad or m, s] and pass --limits limits.yaml"
        )
    wide, why = endless_ranges(robot)
    notes = [f"{', '.join(wide)}: {why}"] * bool(wide)
    if free.any():
        notes.append(
            f"no acceleration limits of {', '.join(joints[free])}: torque limits bound the "
            "motion; pass --limits with 'acceleration: ..' where drives allow less"
        )
    return "; ".join(notes) or None
