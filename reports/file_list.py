"""The files that a run has written, and what reads them."""

from __future__ import annotations

from excitant.reports.model import Notes
from excitant.reports.reading import Result, at, words

_FORMATS = {
    "urdf": "URDF",
    "xml": "MuJoCo (MJCF)",
    "sdf": "SDFormat, for Gazebo",
    "yaml": "all effects, which excitant reads as a robot",
    "json": "exact coefficients",
    "csv": "samples at the control rate",
}


def file_list(result: Result, *keys: str) -> Notes | None:
    """The artefact files of a run."""
    found = at(result, *keys, "files") if keys else at(result, "files")
    files = [str(f) for f in found.values()] if isinstance(found, dict) else words(found)
    if isinstance(found, list):
        files = [str(f) for f in found if f is not None]
    return Notes(tuple(f"{file}{_format(file)}" for file in files)) if files else None


def _format(file: str) -> str:
    """What reads a file of this ending, where that is not plain."""
    said = _FORMATS.get(file.rpartition(".")[2], "")
    return f": {said}" if said else ""
