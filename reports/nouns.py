"""Folders and pages of nouns: a design, an estimate, an identifiability, a diagnosis, ..."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from excitant.analysis.publication import publication_of
from excitant.exceptions import BadInput
from excitant.files import write_file
from excitant.identify.estimate import Estimate
from excitant.identify.export import MODEL_SUFFIXES, save_model
from excitant.reports.pages import page_of
from excitant.reports.render import html
from excitant.reports.run import as_saved, save_run
from excitant.robots.motion import Array

_HEIGHT = 640  # pixels of a report's frame in a notebook


@runtime_checkable
class Reportable(Protocol):
    """A result that describes itself: a design, an identifiability, a diagnosis, ..."""

    def result(self) -> Mapping[str, Any]:
        """Entries of ``result.json``."""

    def series(self) -> Mapping[str, Array]:
        """The arrays that its figures draw."""


@dataclass(frozen=True)
class Report:
    """A page with all figures as HTML, which needs no network; it shows itself in a notebook."""

    html: str

    def save(self, path: str | Path) -> Path:
        """Write the page to a file."""
        write_file(path, self.html)
        return Path(path)

    def _repr_html_(self) -> str:
        frame = f"width:100%;height:{_HEIGHT}px;border:0"
        return f'<iframe srcdoc="{escape(self.html)}" style="{frame}"></iframe>'


def save(
    noun: Reportable, folder: str | Path, *, force: bool = False
) -> list[Path]:
    """Write a folder as the command does that makes such a noun.

    A model is left out, with a warning, where the hold-out speaks against it, unless by ``force``.

    An estimate is saved as a model alone where a file is named, such as arm.urdf (`save_model`).

    Args:
        noun: A design, estimate, identifiability, diagnosis, ...
        folder: Made when missing; files of an old run there go, what others put there stays.
        force: Write the model all the same.

    Returns:
        The paths written: files of the model or motion, then those that every run has.

    Raises:
        BadInput: Anything else, or a folder that cannot be written.
    """
    _require_reportable(noun)
    if isinstance(noun, Estimate) and Path(folder).suffix in MODEL_SUFFIXES:
        return save_model(noun, folder)
    result = dict(noun.result())
    files = dict[str, str | bytes]()
    if model := publication_of(noun, force=force):
        files |= model.files
        model.note_in(result)
        if model.note:
            warnings.warn(model.note, stacklevel=2)
    elif own := getattr(noun, "files", None):
        files |= own()
    result["files"] = [str(Path(folder) / name) for name in files]
    return save_run(folder, result, noun.series(), files)[0]


def _require_reportable(noun: object) -> None:
    if not isinstance(noun, Reportable):
        raise BadInput(
            f"a {type(noun).__name__} has no report; give what a verb returned"
        )


def report(noun: Reportable) -> Report:
    """The page of a design, estimate, identifiability, ...; BadInput for anything else."""
    _require_reportable(noun)
    return Report(
        html(page_of(*as_saved(noun.result(), noun.series())), saved=False)
    )
