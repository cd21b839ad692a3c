"""How nouns show themselves: three lines in a console, a small table in a notebook, data frames."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from excitant.names import printable
from excitant.robots.motion import Array

if TYPE_CHECKING:
    import pandas as pd

_LINES = 3
_LETTERS = 130

Table = tuple[Sequence[str], Iterable[Sequence[object]]]
"""Headings of columns, and the rows."""


class Shown:
    """A noun that shows itself in three lines, in a notebook as a table under the first of them."""

    def _lines(self) -> Sequence[str]:
        raise NotImplementedError

    def _table(self) -> Table:
        raise NotImplementedError

    def __repr__(self) -> str:
        lines = (
            printable(" ".join(line.split())) for line in self._lines() if line
        )
        return "\n  ".join(
            cut(line) for line, _ in zip(lines, range(_LINES), strict=False)
        )

    def _repr_html_(self) -> str:
        return html_table(self._lines()[0], *self._table())


def cut(line: str) -> str:
    """A line of which the end gives way to an ellipsis where it is too long."""
    return line if len(line) <= _LETTERS else line[: _LETTERS - 1] + "…"


def percent(share: float) -> str:
    """A share as a percentage, to two digits."""
    digits = ".0f" if share >= 0.1 else ".2g"
    return f"{100 * share:{digits}} %"


def worst_and_median(joints: Sequence[str], errors: Array) -> str:
    """Relative errors of joints in words, the worst before the median, NaN left out."""
    worst = int(np.nanargmax(errors))
    most = percent(float(errors[worst]))
    median = percent(float(np.nanmedian(errors)))
    return f"{most} ({joints[worst]}; median {median})" if len(joints) > 1 else most


def html_table(
    title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]
) -> str:
    """A table under a title, texts escaped, numbers with four digits, None as a dash."""
    heads = "".join(f"<th>{escape(column)}</th>" for column in columns)
    lines = "".join(
        f"<tr>{''.join(f'<td>{escape(_written(cell))}</td>' for cell in row)}</tr>"
        for row in rows
    )
    return (
        f"<table><caption>{escape(title)}</caption>"
        f"<thead><tr>{heads}</tr></thead><tbody>{lines}</tbody></table>"
    )


def _written(cell: object) -> str:
    if cell is None:
        return "–"
    return f"{cell:.4g}" if isinstance(cell, float) else str(cell)


def data_frame(
    records: Sequence[Mapping[str, Any]], index: str, columns: Sequence[str] = ()
) -> pd.DataFrame:
    """Records as rows under one of their entries; nested ones as columns ``outer.inner``.

    The columns named are there without any record, too.
    """
    import pandas as pd

    if not records:
        return pd.DataFrame(columns=[index, *columns]).set_index(index)
    return pd.json_normalize([dict(record) for record in records]).set_index(index)
