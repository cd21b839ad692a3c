"""Limits of joints in YAML or JSON files, those of MoveIt and ros2_control among them."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from excitant.exceptions import BadInput, UnknownName
from excitant.robots.limits import LEAST, LIMIT_NAMES, UNLIMITED, Limits
from excitant.robots.motion import Array
from excitant.robots.robot import Robot
from excitant.robots.schema import LimitsRecord, convert, read_yaml

_ROS = ("position", "velocity", "acceleration", "effort", "jerk")


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


def limits_from(
    content: Mapping[str, Any], robot: Robot, path: str | Path
) -> Limits:
    """Limits from the content of a file; see `load_limits`."""
    where = ""
    if (by_joint := _joint_limits(content)) is not None:
        content = _by_quantity(by_joint, robot, path)
        where = ".joint_limits"
    elif "limits" in content:
        content = content["limits"]
        where = ".limits"
    record = convert(content, LimitsRecord, path, where)
    return merge_limits(robot, record, str(path))


def _joint_limits(content: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """The entry ``joint_limits`` of MoveIt or ros2_control, under ``ros__parameters`` or not."""
    if isinstance(limits := content.get("joint_limits"), dict):
        return limits
    inner = (
        _joint_limits(value)
        for value in content.values()
        if isinstance(value, dict)
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
    limits: dict[str, Any] = {}
    for name, word in zip(LIMIT_NAMES, _ROS, strict=True):
        known = {j: row for j, row in rows.items() if row.get(f"has_{word}_limits")}
        limits[name] = {j: row.get(f"max_{word}") for j, row in known.items()}
        if name == "position":
            limits[name] = {
                j: [row.get("min_position"), limits[name][j]]
                for j, row in known.items()
            }
    return limits


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
        try:
            UnknownName.refuse("joint", value, robot.joints)
        except UnknownName as unknown:
            raise BadInput(f"{source}: {name} limits: {unknown}") from None
        own = getattr(robot.limits, name).tolist()
        value = [value.get(j, x) for j, x in zip(robot.joints, own, strict=True)]
    try:
        limit = np.broadcast_to(
            np.asarray(value, float), (robot.nv, 2)[: 1 + ranges]
        )
    except ValueError:
        raise BadInput(
            f"{source}: {name} limits: expected one {'pair of numbers' if ranges else 'number'}, "
            f"or one for each of the {robot.nv} joints of {robot.name}"
        ) from None
    good = limit[:, 0] < limit[:, 1] if ranges else limit >= LEAST
    if not good.all():
        joint = robot.joints[int(np.argmin(good))]
        rule = (
            "lower must be below upper"
            if ranges
            else f"must be positive, {LEAST:g} at least"
        )
        raise BadInput(f"{source}: {name} limit of joint {joint}: {rule}")
    beyond = np.abs(limit) >= UNLIMITED
    return np.where(beyond, [-np.inf, np.inf] if ranges else np.inf, limit)
