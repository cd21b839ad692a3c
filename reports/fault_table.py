"""Table of what is wrong with the recordings themselves."""

from __future__ import annotations

from excitant.reports.model import POOR, Cell, Table, table
from excitant.reports.reading import Result, records, text, words
from excitant.reports.wording import listing, plain


def fault_table(result: Result) -> Table | None:
    """Data faults with their evidence; None without any."""
    rows: list[list[Cell | str]] = [
        [
            text(f, "recording"),
            Cell(plain(text(f, "fault")), POOR),
            listing(words(f, "joints")),
            text(f, "detail"),
        ]
        for f in records(result, "faults")
    ]
    caption = "Faults of the data, found before any model was judged by them."
    columns = "name:Recording | text:Data fault | name:Joints | text:Detail"
    return table(columns, rows, caption) if rows else None
