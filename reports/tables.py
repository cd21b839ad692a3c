"""Tables of a page as files, for spreadsheets and papers."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Literal

from excitant.reports.page import Page, Table
from excitant.reports.render import plain
from excitant.reports.values import NONE

if TYPE_CHECKING:
    import pandas as pd

Format = Literal["csv", "latex"]
FOLDER = "tables"
_SIGNS = {
    "±": r"\pm",
    "→": r"\to",
    "·": r"\cdot",
    "×": r"\times",
    "√": r"\surd",
    "°": r"^\circ",
}
_SIGNS |= {
    "≤": r"\leq",
    "≥": r"\geq",
    "φ": r"\varphi",
    "σ": r"\sigma",
    "τ": r"\tau",
    "π": r"\pi",
    "β": r"\beta",
    "μ": r"\mu",
    "α": r"\alpha",
}
_SIGNS |= {
    raised: f"^{plain}"
    for raised, plain in zip("⁰¹²³⁴⁵⁶⁷⁸⁹⁻ᵃ", "0123456789-a", strict=True)
}
_TEX = {sign: f"${command}$" for sign, command in _SIGNS.items()} | {
    "–": "--",
    "…": r"\ldots{}",
}
_TEX |= {"“": "``", "”": "''", "✓": "yes", "✗": "no"}


def table_files(page: Page, form: Format) -> dict[str, str]:
    """Every table of a page as a file, by its name: that of its section and part."""
    write, suffix = _FORMATS[form]
    several = len(page.sections) > 1
    files: dict[str, str] = {}
    for section, part, table in page.tables():
        name = _name(f"{section} {part}" if several else part)
        k = sum(
            bool(re.fullmatch(rf"{FOLDER}/{name}(-\d+)?\.\w+", each))
            for each in files
        )
        files[f"{FOLDER}/{name}{f'-{k + 1}' if k else ''}.{suffix}"] = write(table)
    return files


def _name(title: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")


def csv_table(table: Table) -> str:
    """A table as CSV: numbers as the page rounds them, per cent as numbers."""
    return _frame(table).to_csv(index=False, lineterminator="\n")


def latex_table(table: Table) -> str:
    r"""A table as a LaTeX ``tabular``; it needs ``\usepackage{booktabs}``."""
    aligned = "".join("r" if kind == "number" else "l" for _, kind in table.columns)
    written = _frame(table).to_latex(
        index=False, escape=True, column_format=aligned
    )
    written = re.sub(
        r"(?<=\d)e(-?\d+)", lambda e: rf"$\cdot 10^{{{int(e[1])}}}$", written
    )
    written = re.sub(r"(?<![\w.{$-])-(?=\d)", "$-$", written)
    return "".join(_TEX.get(letter, letter) for letter in written)


_FORMATS: dict[Format, tuple[Callable[[Table], str], str]] = {
    "csv": (csv_table, "csv"),
    "latex": (latex_table, "tex"),
}


def _frame(table: Table) -> pd.DataFrame:
    import pandas as pd

    heads = []
    columns = []
    for k, head in enumerate(map(plain, table.heads)):
        cells = [
            plain(row[k].text) if row[k].text != NONE else "" for row in table.rows
        ]
        if any(cells) and all(
            re.fullmatch(r"([<>]? ?-?[\d.e-]+ %)?", cell) for cell in cells
        ):
            head = f"{head} [%]"
            cells = [cell.removesuffix(" %") for cell in cells]
        heads.append(head or "Value")
        columns.append(cells)
    frame = pd.DataFrame(dict(enumerate(columns)))
    return frame.set_axis(heads, axis=1)
