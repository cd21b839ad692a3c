"""Content of YAML files without a type; use `excitant.robots.schema.read_yaml`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from excitant.robots.motion import Array
from excitant.robots.schema import read_yaml


def yaml_content(path: str | Path, holds: str) -> Any:
    """Content of a YAML or JSON file."""
    return read_yaml(path, Any, holds)


def entries_of(path: str | Path, holds: str) -> dict[str, Any]:
    """Entries at the top of a file."""
    return read_yaml(path, dict[str, Any], holds)


def finite_numbers(value: Any) -> Array:
    """Finite numbers of an entry; without shape when it is anything else."""
    try:
        numbers = np.asarray(value, float)
    except (TypeError, ValueError):
        return np.array(np.nan)
    return numbers if np.isfinite(numbers).all() else np.array(np.nan)
