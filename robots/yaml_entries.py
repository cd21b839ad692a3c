"""Entries of YAML and JSON files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from excitant.exceptions import BadInput
from excitant.robots.motion import Array


def finite_numbers(value: Any) -> Array:
    """Finite numbers of an entry; without shape when it is anything else."""
    try:
        numbers = np.asarray(value, float)
    except (TypeError, ValueError):
        return np.array(np.nan)
    return numbers if np.isfinite(numbers).all() else np.array(np.nan)


def entries_of(path: Path) -> dict[str, Any]:
    """Entries at the top of a file.

    Raises:
        BadInput: It is missing, unreadable, or holds no entries.
    """
    try:
        text = path.read_text(encoding="utf-8")
        content = json.loads(text) if path.suffix == ".json" else yaml.safe_load(text)
    except OSError:
        raise BadInput(f"{path}: no such file") from None
    except (ValueError, yaml.YAMLError) as error:
        raise BadInput(f"{path}: cannot be read ({str(error).splitlines()[0]})") from None
    if not isinstance(content, dict):
        raise BadInput(f"{path}: expected entries 'name: value', found something else")
    return content
