"""YAML and JSON files that users write."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from excitant.exceptions import BadInput
from excitant.robots.motion import Array


def yaml_content(path: str | Path, holds: str) -> Any:
    """Content of a YAML file, or of a JSON file where its name ends so.

    Args:
        path: The file.
        holds: What such a file holds, for messages, such as ``limits``.

    Raises:
        BadInput: Missing, unreadable, or neither YAML nor JSON; says in which line.
    """
    path = Path(path)
    language = "JSON" if path.suffix == ".json" else "YAML"
    try:
        text = path.read_text(encoding="utf-8")
        return json.loads(text) if language == "JSON" else yaml.safe_load(text)
    except FileNotFoundError:
        why = f"no such file; give a {language} file of {holds}"
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8"
        why = f"cannot be read ({reason}); give a {language} file of {holds}"
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        why = f"not valid {language} ({_fault(error)}); correct it there"
    raise BadInput(f"{path}: {why}")


def _fault(error: Exception) -> str:
    """What is wrong in a text, and in which line where that is known."""
    if isinstance(error, json.JSONDecodeError):
        return f"line {error.lineno}: {error.msg}"
    if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark is not None:
        return f"line {error.problem_mark.line + 1}: {error.problem or error.context}"
    return str(error).splitlines()[0] if str(error) else type(error).__name__


def entries_of(path: str | Path, holds: str) -> dict[str, Any]:
    """Entries at the top of a file; see `yaml_content`.

    Raises:
        BadInput: Missing, unreadable, or it holds no entries.
    """
    content = yaml_content(path, holds)
    if not isinstance(content, dict):
        raise BadInput(f"{path}: expected entries 'name: value' of {holds}, found something else")
    return content


def finite_numbers(value: Any) -> Array:
    """Finite numbers of an entry; without shape when it is anything else."""
    try:
        numbers = np.asarray(value, float)
    except (TypeError, ValueError):
        return np.array(np.nan)
    return numbers if np.isfinite(numbers).all() else np.array(np.nan)
