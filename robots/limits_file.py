"""Limits of a robot from a file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from excitant.exceptions import BadInput, UnknownName
from excitant.robots.motion import Array
from excitant.robots.robot import Limits, Robot
from excitant.robots.yaml_entries import entries_of

LIMIT_NAMES = ("position", "velocity", "acceleration", "torque", "jerk")


def load_limits(path: str | Path, robot: Robot) -> Limits:
    """Limits of a robot with some replaced by those of a YAML or JSON file.

    The file holds ``position: [[lo, hi], ...]``, ``velocity``, ``acceleration``, ``torque``
    and ``jerk`` (one number, one per joint, or ``{joint: number}``), at the top or under
    ``limits``. What it leaves out stays as the robot has it.

    Raises:
        BadInput: Unreadable, unknown names, wrong counts, or limits that exclude everything.
    """
    content = entries_of(path, "limits")
    return merge_limits(robot, content.get("limits", content), str(path))


def merge_limits(robot: Robot, values: object, source: str) -> Limits:
    """Limits of the robot with some replaced; see `load_limits`."""
    if not isinstance(values, dict):
        raise BadInput(f"{source}: limits: expected entries such as 'velocity: [..]'")
    for name in values:
        if name not in LIMIT_NAMES:
            raise BadInput(f"{source}: {UnknownName('limit', str(name), LIMIT_NAMES)}")
    merged: dict[str, Any] = {
        name: _limit(robot, name, values[name], source)
        if values.get(name) is not None
        else getattr(robot.limits, name)
        for name in LIMIT_NAMES
    }
    return replace(robot.limits, **merged)


def _limit(robot: Robot, name: str, value: Any, source: str) -> Array:
    shape = (robot.nv, 2) if name == "position" else (robot.nv,)
    if isinstance(value, dict):
        value = _by_joint(robot, name, value, source)
    try:
        limit = np.broadcast_to(np.asarray(value, float), shape)
    except (ValueError, TypeError):
        each = "pair of numbers" if name == "position" else "number"
        raise BadInput(
            f"{source}: {name} limits: expected one {each}, or one for each of the {robot.nv} "
            f"joints of {robot.name}"
        ) from None
    bad = limit[:, 0] >= limit[:, 1] if name == "position" else ~(limit > 0)
    bad |= np.isnan(limit).reshape(robot.nv, -1).any(axis=1)
    if bad.any():
        joint = robot.joints[int(np.argmax(bad))]
        rule = "lower must be below upper" if name == "position" else "must be positive"
        raise BadInput(f"{source}: {name} limit of joint {joint}: {rule}")
    return limit


def _by_joint(robot: Robot, name: str, values: Mapping[str, Any], source: str) -> list[Any]:
    """Limits of all joints, some of them given by the joint's name."""
    for joint in values:
        if joint not in robot.joints:
            unknown = UnknownName("joint", str(joint), robot.joints)
            raise BadInput(f"{source}: {name} limits: {unknown}")
    known = getattr(robot.limits, name).tolist()
    return [values.get(joint, known[j]) for j, joint in enumerate(robot.joints)]


def require_limits(robot: Robot) -> str | None:
    """Refuse a robot whose motion nothing bounds; say what bounds it instead of missing limits.

    Speed needs a limit of its own; acceleration may be bounded by torque.

    Returns:
        A sentence about acceleration limits that are missing without need, if any.

    Raises:
        BadInput: Limits are missing; says which file to write.
    """
    limits, source = robot.limits, robot.source or robot.name
    free = np.isinf(limits.acceleration)
    lacking = {
        "velocity": np.isinf(limits.velocity),
        "acceleration": free & np.isinf(limits.torque),
    }
    asked = [
        f"'{name}: {{{', '.join(f'{j}: ..' for j in np.array(robot.joints)[missing])}}}'"
        for name, missing in lacking.items()
        if missing.any()
    ]
    if asked:
        kinds = {
            "velocity": "velocity limits",
            "acceleration": "limits on acceleration or torque",
        }
        what = " and no ".join(kinds[name] for name, missing in lacking.items() if missing.any())
        raise BadInput(
            f"{source} gives no {what} of some joints; write limits.yaml with "
            f"{' and '.join(asked)} [rad or m, s] and pass --limits limits.yaml"
        )
    if not free.any():
        return None
    return (
        f"no acceleration limits of {', '.join(np.array(robot.joints)[free])}: torque limits "
        "bound the motion; pass --limits with 'acceleration: ..' where drives allow less"
    )
