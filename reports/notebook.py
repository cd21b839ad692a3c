"""Reports of nouns, with their figures, for a notebook or a file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from excitant.exceptions import BadInput
from excitant.reports.render import html
from excitant.reports.run import as_saved
from excitant.reports.sections import page_of
from excitant.robots.motion import Array


@runtime_checkable
class Reportable(Protocol):
    """What says of itself what a report shows: a design, an identifiability, a diagnosis, ..."""

    def result(self) -> Mapping[str, Any]:
        """What ``result.json`` says."""

    def series(self) -> Mapping[str, Array]:
        """The arrays that its figures draw."""


_HEIGHT = 640  # pixels of the frame in a notebook


@dataclass(frozen=True)
class Report:
    """A page with all figures; it shows itself in a notebook.

    Attributes:
        html: The page, which needs no network.
    """

    html: str

    def save(self, path: str | Path) -> Path:
        """Write the page to a file."""
        path = Path(path)
        path.write_text(self.html, encoding="utf-8")
        return path

    def _repr_html_(self) -> str:
        frame = f"width:100%;height:{_HEIGHT}px;border:0"
        return f'<iframe srcdoc="{escape(self.html)}" style="{frame}"></iframe>'


def report(noun: Reportable) -> Report:
    """The page that the command line would write of a result, figures included.

    Args:
        noun: A design, an estimate, an identifiability, a diagnosis or a rehearsal.

    Raises:
        BadInput: Something else.
    """
    if not isinstance(noun, Reportable):
        raise BadInput(f"a {type(noun).__name__} has no report; give what a verb returned")
    return Report(html(page_of(*as_saved(noun.result(), noun.series()))))
