"""Reports of nouns, with their figures, for a notebook or a file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from excitant.analysis import (
    Diagnosis,
    Identifiability,
)
from excitant.analysis.rehearsal import Rehearsal
from excitant.design import Design
from excitant.exceptions import BadInput
from excitant.identify import Estimate
from excitant.reports.run import REPORT, save_run

Reportable = Design | Estimate | Identifiability | Diagnosis | Rehearsal

_CONTENTS: dict[type, tuple[Callable[[Any], Any], Callable[[Any], Any]]] = {
    Design: (Design.result, Design.series),
    Estimate: (Estimate.result, Estimate.series),
    Identifiability: (Identifiability.result, Identifiability.series),
    Diagnosis: (Diagnosis.result, Diagnosis.series),
    Rehearsal: (Rehearsal.result, Rehearsal.series),
}
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
    if type(noun) not in _CONTENTS:
        known = ", ".join(kind.__name__ for kind in _CONTENTS)
        raise BadInput(f"a {type(noun).__name__} has no report; known: {known}")
    result, series = _CONTENTS[type(noun)]
    with TemporaryDirectory() as folder:
        save_run(folder, result(noun), series(noun))
        return Report((Path(folder) / REPORT).read_text(encoding="utf-8"))
