"""Limits of an arm's joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from excitant.exceptions import BadInput, UnknownName
from excitant.robots.motion import Array, freeze
from excitant.robots.schema import LimitsRecord, convert, read_yaml

if TYPE_CHECKING:
    from excitant.robots.robot import Robot

LIMIT_NAMES = ("position", "velocity", "acceleration", "torque", "jerk")
TOUCHED = 0.99  # share of a limit from which on it counts as touched
_ROS = ("position", "velocity", "acceleration", "effort", "jerk")


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

    def of(self, joints: list[int]) -> Limits:
        """Limits of some of the joints, by index."""
        rows: dict[str, Any] = {
            name: getattr(self, name)[joints] for name in LIMIT_NAMES
        }
        return replace(self, **rows)

    def used(self, share: float) -> Limits:
        """Limits of which velocity, acceleration, torque and jerk are a share of these (of 1)."""
        if not 0 < share <= 1:
            raise BadInput(
                f"use of {share:g}: give the share of the limits, above 0 and up to 1"
            )
        return replace(
            self, **{name: share * getattr(self, name) for name in LIMIT_NAMES[1:]}
        )


def load_limits(path: str | Path, robot: Robot) -> Limits:
    """Limits of a robot with some replaced by those of a YAML or JSON file.

    The file holds ``position: [[lo, hi], ...]``, ``velocity``, ``acceleration``, ``torque``
    and ``jerk`` (one number, one per joint, or ``{joint: number}``), at the top or under
    ``limits``; or it is a ``joint_limits.yaml`` of MoveIt or ros2_control. What it leaves out
    stays as the robot has it.

    Raises:
        BadInput: Unreadable, unknown names, wrong counts, or limits that exclude everything.
    """
    return limits_from(read_yaml(path, dict[str, Any], "limits"), robot, path)


def limits_from(content: Mapping[str, Any], robot: Robot, path: str | Path) -> Limits:
    """Limits from the content of a file; see `load_limits`."""
    if (by_joint := _joint_limits(content)) is not None:
        record = convert(
            _by_quantity(by_joint, robot, path), LimitsRecord, path, ".joint_limits"
        )
        return merge_limits(robot, record, str(path))
    nested = "limits" in content
    record = convert(
        content.get("limits", content), LimitsRecord, path, ".limits" * nested
    )
    return merge_limits(robot, record, str(path))


def _joint_limits(content: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """The entry ``joint_limits`` of MoveIt or ros2_control, under ``ros__parameters`` or not."""
    if isinstance(found := content.get("joint_limits"), dict):
        return found
    inner = (
        _joint_limits(value) for value in content.values() if isinstance(value, dict)
    )
    return next((value for value in inner if value is not None), None)


def _by_quantity(
    by_joint: Mapping[str, Any], robot: Robot, path: str | Path
) -> dict[str, Any]:
    """Limits that are in force (``has_velocity_limits: true``), of the joints that the arm has."""
    rows = {
        j: row
        for j, row in by_joint.items()
        if j in robot.joints and isinstance(row, dict)
    }
    if not rows:
        raise BadInput(
            f"{path}: {UnknownName('joint', next(iter(by_joint), ''), robot.joints)}"
        )
    found: dict[str, Any] = {}
    for name, word in zip(LIMIT_NAMES, _ROS, strict=True):
        known = {j: row for j, row in rows.items() if row.get(f"has_{word}_limits")}
        found[name] = {j: row.get(f"max_{word}") for j, row in known.items()}
        if name == "position":
            found[name] = {
                j: [row.get("min_position"), found[name][j]] for j, row in known.items()
            }
    return found


def merge_limits(robot: Robot, record: LimitsRecord, source: str) -> Limits:
    """Limits of the robot with some replaced; see `load_limits`."""
    merged: dict[str, Any] = {
        name: _limit(robot, name, value, source)
        for name in LIMIT_NAMES
        if (value := getattr(record, name)) is not None
    }
    return replace(robot.limits, **merged)


def _limit(robot: Robot, name: str, value: Any, source: str) -> Array:
    ranges = name == "position"
    if isinstance(value, dict):
        for joint in value:
            if joint not in robot.joints:
                unknown = UnknownName("joint", joint, robot.joints)
                raise BadInput(f"{source}: {name} limits: {unknown}")
        own = dict(zip(robot.joints, getattr(robot.limits, name).tolist(), strict=True))
        value = list((own | value).values())
    try:
        limit = np.broadcast_to(np.asarray(value, float), (robot.nv, 2)[: 1 + ranges])
    except ValueError:
        raise BadInput(
            f"{source}: {name} limits: expected one {'pair of numbers' if ranges else 'number'}, "
            f"or one for each of the {robot.nv} joints of {robot.name}"
        ) from None
    good = limit[:, 0] < limit[:, 1] if ranges else limit > 0
    if not good.all():
        joint = robot.joints[int(np.argmin(good))]
        rule = "lower must be below upper" if ranges else "must be positive"
        raise BadInput(f"{source}: {name} limit of joint {joint}: {rule}")
    return limit


def require_limits(robot: Robot) -> str | None:
    """A sentence about acceleration limits that are missing without need, if any.

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
    if not free.any():
        return None
    return (
        f"no acceleration limits of {', '.join(joints[free])}: torque limits bound the motion; "
        "pass --limits with 'acceleration: ..' where drives allow less"
    )
