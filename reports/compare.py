"""Runs of one command side by side: a walk over what their pages have in common."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

import numpy as np

from excitant.exceptions import BadInput
from excitant.reports import page as p
from excitant.reports import values as v
from excitant.reports.page import Block, Cell, Column, Facts, Folded, Notes, Page, Table
from excitant.reports.values import NONE, Result, Series

VERB = "compare"
APART = 2.0  # standard deviations of a difference from which on estimates disagree
_ERROR = re.compile(r"\b(rms|nrmse)\b|r²|error")  # what depends on the filter and on the rows
_LONG = 60  # rows from which on a table is folded
_NAMES = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"


@dataclass(frozen=True)
class SavedRun:
    """A run as it was saved.

    Attributes:
        folder: Where.
        result: Content of its ``result.json``.
        series: Content of its ``series.npz``.
    """

    folder: str
    result: Result
    series: Series


def compare(*runs: SavedRun) -> dict[str, Any]:
    """What runs of one command have in common and where they differ.

    Their pages are walked: facts and the tables of the same heading, row by row. Differences and
    ratios are those to the first run.

    Returns:
        A result of its own (``verb`` is ``compare``).

    Raises:
        BadInput: Fewer than two runs, more than there are letters, or runs of different commands.
    """
    from excitant.reports.sections import page_of

    first = runs[0]
    verb = v.text(first.result, "verb")
    if not 2 <= len(runs) <= len(_NAMES):
        raise BadInput(f"{first.folder}: name 2 to {len(_NAMES)} runs to compare")
    for run in runs[1:]:
        if (other := v.text(run.result, "verb")) != verb:
            raise BadInput(
                f"{run.folder}: a run of '{other}', but {first.folder} is one of '{verb}'; "
                "compare runs of one command"
            )
    if verb == VERB:
        raise BadInput(f"{first.folder}: a comparison already; name the runs themselves")
    pages = [page_of(run.result, {}) for run in runs]
    remarks = _remarks(runs)
    judged = not any("error" in remark for remark in remarks)
    names = [PurePath(run.folder).name for run in runs]
    return {
        "verb": VERB,
        "of": verb,
        "robot": v.listing(list(dict.fromkeys(v.text(run.result, "robot") for run in runs))),
        "runs": [
            {
                "name": run.folder if names.count(name) > 1 else name,
                "folder": run.folder,
                "leads": [s.lead for s in page.sections],
            }
            for run, name, page in zip(runs, names, pages, strict=True)
        ],
        "remarks": remarks,
        "sections": _compared(pages, judged),
    }


def _remarks(runs: Sequence[SavedRun]) -> list[str]:
    """What keeps the figures of the runs from being compared one to one."""
    found = []
    for key, said in (
        ("robot", "The runs are of different arms: {}."),
        ("cutoff_hz", "Torque was filtered at different cut-offs, {} Hz: errors do not compare."),
        ("unit", "Torques are in different units, {}: errors do not compare."),
        ("columns", "The motions were judged by different columns, {}: condition numbers differ."),
    ):
        for part in (None, "design", "identify", "analyze", "diagnose"):  # a demo has all four
            values = [v.text(run.result, *([part] if part else []), key) for run in runs]
            if len(set(filter(None, values))) > 1:
                found.append(said.format(" and ".join(dict.fromkeys(values))))
                break
    if not _same_rows([run.series for run in runs]):
        found.append(
            "The runs were judged on different samples: a difference of errors may come from them."
        )
    return found


def _same_rows(series: Sequence[Series]) -> bool:
    """Whether all runs were judged on the same instants and readings, as far as is known."""

    def rows(each: Series) -> list[Any]:
        joints = range(np.asarray(each.get("measured", np.empty((0, 0)))).shape[-1])
        return [v.times(each), *(v.curve(each, "measured", k) for k in joints)]

    first, *others = (rows(each) for each in series)
    return all(
        x is None or y is None or (x.shape == y.shape and np.allclose(x, y, 1e-5, 1e-9, True))
        for other in others
        for x, y in zip(first, other, strict=False)
    )


def _compared(pages: Sequence[Page], judged: bool) -> list[dict[str, Any]]:
    """Sections with those tables of theirs that more than one page has, compared."""
    found = []
    walked = [dict(_tables(page)) for page in pages]
    for title in dict.fromkeys(key[0] for tables in walked for key in tables):
        names = dict.fromkeys(key for tables in walked for key in tables if key[0] == title)
        parts = [
            {"part": key[1], "of": key[2], "rows": rows}
            for key in names
            if (rows := _rows([tables.get(key) for tables in walked], judged))
        ]
        found.append({"title": title, "tables": parts})
    return found


_TableKey = tuple[str, str, str]  # section, part, heading of the first column of names


def _tables(page: Page) -> Iterator[tuple[_TableKey, Table]]:
    """Every table of a page, facts written as one, under its section and part."""
    for each in page.sections:
        for part in each.parts:
            for block in _unfolded(part.blocks):
                if isinstance(block, Facts):
                    cells = tuple(
                        (Cell(fact.label), Cell(fact.value, value=fact.number))
                        for fact in block.facts
                        if not fact.timing
                    )
                    block = Table((("Figure", "name"), ("", "number")), cells)
                if isinstance(block, Table) and (names := _named(block)):
                    yield (each.title, part.title, block.columns[names[0]][0]), block


def _unfolded(blocks: Sequence[Block]) -> Iterator[Block]:
    for block in blocks:
        yield from _unfolded(block.blocks) if isinstance(block, Folded) else (block,)


def _named(found: Table) -> list[int]:
    """Columns that name a row."""
    return [k for k, (_, kind) in enumerate(found.columns) if kind in ("name", "expression")]


def _cells(found: Table | None) -> dict[tuple[str, str], tuple[Cell, float | None]]:
    """Cells by row and column, those of values with the standard deviation beside them."""
    cells: dict[tuple[str, str], tuple[Cell, float | None]] = {}
    for row in found.rows if found is not None else ():
        assert found is not None
        names = _named(found)
        name = ", ".join(row[k].text for k in names if row[k].text != NONE)
        prior = any(cell.text in ("prior", "expectation") for cell in row)
        for k, cell in enumerate(row):
            if k in names:
                continue
            beside = found.columns[k + 1][0] if k + 1 < len(row) else ""
            std = row[k + 1].value if beside.startswith("± std") and not prior else None
            cells.setdefault((name, found.columns[k][0]), (cell, std))
    return cells


def _rows(tables: Sequence[Table | None], judged: bool) -> list[dict[str, Any]]:
    """What the tables of some runs say of the same row and column."""
    walked = [_cells(each) for each in tables]
    rows = []
    for name, heading in dict.fromkeys(key for cells in walked for key in cells):
        found = [cells.get((name, heading), (None, None)) for cells in walked]
        written = [NONE if cell is None else cell.text for cell, _ in found]
        values = [None if cell is None else cell.value for cell, _ in found]
        row: dict[str, Any] = {"name": name, "figure": heading, "written": written}
        if all(value is None for value in values):
            if len(set(written)) == 1:
                continue  # words that all runs share
        elif judged or not _ERROR.search(f"{name} {heading}".lower()):
            row |= _differences(values, [std for _, std in found])
        rows.append(row | {"values": values})
    return rows


def _differences(
    values: Sequence[float | None], stds: Sequence[float | None]
) -> dict[str, list[float | None]]:
    """Differences and ratios to the first value, and differences in standard deviations."""
    first, *others = values
    pairs = [(first, other) for other in others]
    return {
        "difference": [None if a is None or b is None else b - a for a, b in pairs],
        "ratio": [None if not a or b is None else b / a for a, b in pairs],
        "deviations": [
            deviations(first, stds[0], b, std) for b, std in zip(others, stds[1:], strict=True)
        ],
    }


def deviations(
    a: float | None, std_a: float | None, b: float | None, std_b: float | None
) -> float | None:
    """How many standard deviations of their difference two independent estimates lie apart."""
    if a is None or b is None or not std_a or not std_b:
        return None
    return abs(b - a) / math.hypot(std_a, std_b)


def comparison_page(result: Result) -> Page:
    """Page of a comparison, from its saved result."""
    runs, remarks = v.records(result, "runs"), v.words(result, "remarks")
    letters = list(_NAMES[: len(runs)])
    legend = [
        f"{letter}: {v.text(run, 'name')}. {' '.join(v.words(run, 'leads'))}"
        for letter, run in zip(letters, runs, strict=True)
    ]
    sections = [
        p.section(
            v.text(each, "title"),
            _count(each),
            [(v.text(t, "part"), [_table(t, letters)]) for t in v.records(each, "tables")],
            ((v.text(each, "title"), _count(each)),),
        )
        for each in v.records(result, "sections")
    ]
    robot, name = v.text(result, "robot"), "Comparison of runs"
    blocks: list[Notes | None] = [
        p.notes(legend),
        p.notes([v.sentence(r) for r in remarks], "poor"),
    ]
    return Page(
        f"{name}: {robot}" if robot else name,
        f"{len(runs)} runs of excitant {v.text(result, 'of')}; differences and ratios are those to "
        f"A. {sections[0].lead if len(sections) == 1 else ''}",
        tuple(block for block in blocks if block is not None),
        tuple(sections),
        tuple(("note", remark) for remark in remarks),
    )


def _count(each: Result) -> str:
    rows = [row for part in v.records(each, "tables") for row in v.records(part, "rows")]
    differ = sum(len(set(v.words(row, "written"))) > 1 for row in rows)
    apart = [x for row in rows for x in v.at(row, "deviations") or () if v.real(x) is not None]
    said = f"{differ} of {len(rows)} figures differ."
    if apart:
        far = sum(x > APART for x in apart)
        said += (
            f" {far} of {len(apart)} estimates lie more than two standard deviations of their "
            f"difference apart; by chance about {0.0455 * len(apart):.0f} would, if the runs' data "
            "are independent."
        )
    return said


def _table(found: Result, letters: Sequence[str]) -> Block | None:
    rows = v.records(found, "rows")
    headings = list(dict.fromkeys(v.text(row, "figure") for row in rows))

    def picked(key: str, k: int) -> Any:
        def cell(row: Result) -> Cell:
            values = v.at(row, key) or []
            value = v.real(values[k]) if k < len(values) else None
            poor = key == "deviations" and value is not None and value > APART
            return Cell(v.number(value), "poor" if poor else "", value)

        return cell

    def written(k: int) -> Any:
        return lambda row: (v.words(row, "written") + [NONE] * len(letters))[k]

    columns: list[Column | None] = [
        (f"name:{v.text(found, 'of')}", "name"),
        ("name:Quantity", "figure") if headings != [""] else None,
        *((f"number:{letter}", written(k)) for k, letter in enumerate(letters)),
    ]
    for k, letter in enumerate(letters[1:]):
        for key, heading in (
            ("difference", f"{letter} − A"),
            ("ratio", f"{letter} / A"),
            ("deviations", f"{letter} − A [std]"),
        ):
            if any(
                v.real(x) is not None for row in rows for x in (v.at(row, key) or [])[k : k + 1]
            ):
                columns.append((f"number:{heading}", picked(key, k)))
    return p.table(rows, columns, "", p.folded(f"All {len(rows)} figures", len(rows), _LONG))
