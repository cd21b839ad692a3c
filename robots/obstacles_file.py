"""Obstacles in YAML or JSON files."""

from pathlib import Path
from typing import Any

from excitant.robots.geometry import Obstacle
from excitant.robots.schema import (
    OBSTACLE_SHAPES,
    ObstacleRecord,
    convert,
    read_yaml,
)


def load_obstacles(path: str | Path) -> tuple[Obstacle, ...]:
    """Obstacles from a YAML file: a list of ``{name, box|sphere|half_space|workspace: {...}}``.

    A workspace, ``{low: [x, y, z], high: [x, y, z]}`` [m], is a box that the tool point stays in.

    Raises:
        BadInput: Unreadable, an unknown shape, or values that do not fit; names the entry.
    """
    content = read_yaml(path, Any, "obstacles")
    listed = content.get("obstacles") if isinstance(content, dict) else content
    records = convert(listed, list[ObstacleRecord], path, ".obstacles")
    obstacles = []
    for k, record in enumerate(records, start=1):
        shape = next(s for s in OBSTACLE_SHAPES if getattr(record, s) is not None)
        obstacles.append(
            Obstacle(record.name or f"{shape} {k}", shape, getattr(record, shape))
        )
    return tuple(obstacles)
