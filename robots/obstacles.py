"""What stands in an arm's cell, and the box that its tool stays in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from excitant.exceptions import BadInput
from excitant.robots.yaml_entries import yaml_content

_SHAPES = ("box", "sphere", "half_space", "workspace")
_KEYS = {
    "box": {"size": 3, "position": 3, "rpy": 3},
    "sphere": {"radius": 1, "position": 3},
    "half_space": {"normal": 3, "offset": 1},
    "workspace": {"low": 3, "high": 3},
}


@dataclass(frozen=True)
class Obstacle:
    """A body that stands in the cell, in the base frame of the URDF.

    Attributes:
        name: Name for messages.
        shape: ``"box"``, ``"sphere"``, ``"half_space"`` (all points x with n·x ≤ offset) or
            ``"workspace"``, the axis-aligned box that the tool point stays in.
        values: ``size`` [m], ``position`` [m], ``rpy`` [rad], ``radius`` [m], ``normal``,
            ``offset`` [m], ``low`` [m], ``high`` [m] as the shape needs.
    """

    name: str
    shape: str
    values: tuple[tuple[str, tuple[float, ...]], ...]

    @property
    def tool_only(self) -> bool:
        """Whether only the tool point must keep away from it."""
        return self.shape == "workspace"

    def bodies(self) -> list[tuple[str, Any, Any]]:
        """Name, shape and placement for Pinocchio; of a workspace, all that is outside it."""
        v = {key: np.array(x) for key, x in self.values}
        if self.shape == "workspace":
            return [
                (f"{self.name} {'xyz'[k]} {end}", coal.Halfspace(n, n @ v[end]), pin.SE3.Identity())
                for k, axis in enumerate(np.eye(3))
                for end, n in (("low", axis), ("high", -axis))
            ]
        if self.shape == "half_space":
            length = np.linalg.norm(v["normal"])
            plane = coal.Halfspace(v["normal"] / length, float(v["offset"][0] / length))
            return [(self.name, plane, pin.SE3.Identity())]
        turn = pin.rpy.rpyToMatrix(*v.get("rpy", np.zeros(3)))
        shape = coal.Box(*v["size"]) if self.shape == "box" else coal.Sphere(float(v["radius"][0]))
        return [(self.name, shape, pin.SE3(turn, v["position"]))]

    def plain(self) -> dict[str, Any]:
        """Name, shape and values for JSON, with the keys of an obstacle file."""
        values = {key: x[0] if _KEYS[self.shape][key] == 1 else list(x) for key, x in self.values}
        return {"name": self.name, "shape": self.shape, **values}


def load_obstacles(path: str | Path) -> tuple[Obstacle, ...]:
    """Obstacles from a YAML file: a list of ``{name, box|sphere|half_space|workspace: {...}}``.

    A workspace, ``{low: [x, y, z], high: [x, y, z]}`` [m], is a box that the tool point stays in.

    Raises:
        BadInput: Unreadable, an unknown shape, or values that do not fit; names the entry.
    """
    content = yaml_content(path, "obstacles")
    entries = content.get("obstacles") if isinstance(content, dict) else content
    if not isinstance(entries, list):
        raise BadInput(f"{path}: expected a list of obstacles, '- box: {{size: [..], ...}}'")
    return tuple(_obstacle(path, k, entry) for k, entry in enumerate(entries))


def _obstacle(path: str | Path, k: int, entry: object) -> Obstacle:
    where = f"{path}: obstacle {k + 1}"
    shapes = [s for s in _SHAPES if isinstance(entry, Mapping) and s in entry]
    if not isinstance(entry, Mapping) or len(shapes) != 1:
        raise BadInput(f"{where}: give exactly one of {', '.join(_SHAPES)}")
    shape, content = shapes[0], entry[shapes[0]]
    values: list[tuple[str, tuple[float, ...]]] = []
    for key, count in _KEYS[shape].items():
        if key == "rpy" and isinstance(content, Mapping) and key not in content:
            values.append((key, (0.0, 0.0, 0.0)))
            continue
        try:
            numbers = tuple(float(x) for x in np.ravel(content[key]))
        except (KeyError, TypeError, ValueError):
            raise BadInput(f"{where}: {shape} needs {', '.join(_KEYS[shape])} as numbers") from None
        positive = key in ("size", "radius")
        if (
            len(numbers) != count
            or not np.isfinite(numbers).all()
            or (positive and min(numbers) <= 0)
        ):
            raise BadInput(
                f"{where}: {key} must be {count} {'positive ' if positive else ''}numbers"
            )
        values.append((key, numbers))
    if shape == "half_space" and not any(values[0][1]):
        raise BadInput(f"{where}: normal must not be zero")
    if shape == "workspace":
        (_, low), (_, high) = values
        if not all(a < b for a, b in zip(low, high, strict=True)):
            raise BadInput(f"{where}: low must be below high in x, y and z")
    return Obstacle(str(entry.get("name", f"{shape} {k + 1}")), shape, tuple(values))
