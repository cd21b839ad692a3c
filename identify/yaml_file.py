"""YAML files that users write."""

from __future__ import annotations

from pathlib import Path

import yaml

from excitant.exceptions import BadInput


def yaml_content(path: str | Path) -> object:
    """Content of a YAML file.

    Raises:
        BadInput: Unreadable, or not YAML.
    """
    try:
        content: object = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8"
        raise BadInput(f"{path}: cannot be read ({reason})") from None
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise BadInput(f"{path}: not valid YAML ({str(error).splitlines()[0]})") from None
    return content
