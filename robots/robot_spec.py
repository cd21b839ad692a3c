"""Which robot is meant, and which part of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from excitant.exceptions import BadRobot
from excitant.robots.yaml_entries import finite_numbers


@dataclass(frozen=True)
class RobotSpec:
    """Everything that says which robot is meant; `load_robot` takes it as one thing.

    Attributes:
        path: Built-in name, URDF, xacro, MJCF or ``robot.yaml``.
        joints: Joints to keep; all others are held.
        base: Link that the chain starts from.
        tip: Link that the chain ends at.
        lock: Joints to hold and their positions [rad or m].
        xacro_args: Values of the arguments of a xacro file.
        packages: Folders in which ``$(find name)`` of a xacro file looks.
    """

    path: str | Path
    joints: tuple[str, ...] | None = None
    base: str | None = None
    tip: str | None = None
    lock: Mapping[str, float] = field(default_factory=dict)
    xacro_args: Mapping[str, str] = field(default_factory=dict)
    packages: tuple[str | Path, ...] = ()

    def __fspath__(self) -> str:
        """The path, so that a spec stands where a path does."""
        return str(self.path)

    def __str__(self) -> str:
        return str(self.path)

    @property
    def chain(self) -> dict[str, Any]:
        """Which joints are kept, as `robot_from_urdf` takes it."""
        return {
            "joints": self.joints,
            "base": self.base,
            "tip": self.tip,
            "lock": dict(self.lock) or None,
        }

    @property
    def is_chosen(self) -> bool:
        """Whether a part of the robot is chosen."""
        return any(value is not None for value in (self.joints, self.base, self.tip))


def spec_of_entries(content: Mapping[str, Any], path: Path) -> RobotSpec:
    """What a robot.yaml says about the part of the model that is meant."""
    lock = content.get("lock") or {}
    if not isinstance(lock, dict) or finite_numbers(list(lock.values())).shape != (len(lock),):
        raise BadRobot(path, "'lock' must hold entries 'joint: position'")
    arguments = content.get("xacro_args") or {}
    if not isinstance(arguments, dict):
        raise BadRobot(path, "'xacro_args' must hold entries 'name: value'")
    lists = {key: content.get(key) for key in ("joints", "packages")}
    for key, value in lists.items():
        if value is not None and not isinstance(value, list):
            raise BadRobot(path, f"'{key}' must be a list, such as [one, two]")
    base, tip = (content.get(key) for key in ("base", "tip"))
    if "dh" in content:  # where the base is a pose
        base = tip = None
    return RobotSpec(
        path,
        None if lists["joints"] is None else tuple(map(str, lists["joints"])),
        None if base is None else str(base),
        None if tip is None else str(tip),
        lock={str(joint): float(value) for joint, value in lock.items()},
        xacro_args={str(name): _xacro_text(value) for name, value in arguments.items()},
        packages=tuple(map(str, lists["packages"] or ())),
    )


def _xacro_text(value: Any) -> str:
    """A value of YAML as the command line of xacro would have it."""
    return str(value).lower() if isinstance(value, bool) else str(value)
