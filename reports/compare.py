"""Runs of one command side by side: a walk over what their pages have in common."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

import numpy as np

from excitant.exceptions import BadInput
from excitant.reports import values as v
from excitant.reports.page import Cell, Facts, Folded, Page, Table
from excitant.reports.sections import COMPARE, NAMES, page_of
from excitant.reports.values import NONE, Result, Series

_ERROR = re.compile(r"\b(rms|nrmse)\b|r²|error")  # what depends on the filter and on the rows


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
    first = runs[0]
    verb = v.text(first.result, "verb")
    if not 2 <= len(runs) <= len(NAMES):
        raise BadInput(f"{first.folder}: name 2 to {len(NAMES)} runs to compare")
    for run in runs[1:]:
        if (other := v.text(run.result, "verb")) != verb:
            raise BadInput(
                f"{run.folder}: a run of '{other}', but {first.folder} is one of '{verb}'; "
                "compare runs of one command"
            )
    if verb == COMPARE:
        raise BadInput(f"{first.folder}: a comparison already; name the runs themselves")
    pages = [page_of(run.result, {}) for run in runs]
    remarks = _remarks(runs)
    judged = not any("error" in remark for remark in remarks)
    names = [PurePath(run.folder).name for run in runs]
    return {
        "verb": COMPARE,
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
    """Figures by section and table, each with what every page says and how far that differs."""
    walked = [_figures(page) for page in pages]
    sections: dict[str, dict[tuple[str, str], list[dict[str, Any]]]] = {}
    for key in dict.fromkeys(key for figures in walked for key in figures):
        title, part, of, name, heading = key
        tables = sections.setdefault(title, {})
        cells = [figures.get(key, (Cell(NONE), None)) for figures in walked]
        written, values = ([getattr(cell, k) for cell, _ in cells] for k in ("text", "value"))
        row: dict[str, Any] = {"name": name, "figure": heading, "written": written}
        if all(value is None for value in values):
            if len(set(written)) == 1:
                continue  # words that all runs share
        elif judged or not _ERROR.search(f"{name} {heading}".lower()):
            first, *others = [(cell.value, std) for cell, std in cells]
            pairs = [(first[0], value) for value, _ in others]
            row["difference"] = [None if x is None or y is None else y - x for x, y in pairs]
            row["ratio"] = [None if not x or y is None else y / x for x, y in pairs]
            row["deviations"] = [deviations(*first, *other) for other in others]
        tables.setdefault((part, of), []).append(row | {"values": values})
    return [
        {"title": title, "tables": [{"part": p, "of": o, "rows": r} for (p, o), r in found.items()]}
        for title, found in sections.items()
    ]


def _figures(page: Page) -> dict[tuple[str, ...], tuple[Cell, float | None]]:
    """Cells by section, part, kind of row, row and column, with the std beside them."""
    figures: dict[tuple[str, ...], tuple[Cell, float | None]] = {}
    blocks = [
        (s.title, part.title, b) for s in page.sections for part in s.parts for b in part.blocks
    ]
    while blocks:
        title, part, block = blocks.pop(0)
        if isinstance(block, Folded):
            blocks = [*((title, part, each) for each in block.blocks), *blocks]
        elif isinstance(block, Facts):
            known = [fact for fact in block.facts if not fact.timing]
            rows = tuple((Cell(x.label), Cell(x.value, value=x.number)) for x in known)
            block = Table((("Figure", "name"), ("", "number")), rows)
        if not isinstance(block, Table):
            continue
        heads, kinds = [head for head, _ in block.columns], [kind for _, kind in block.columns]
        names = [k for k, kind in enumerate(kinds) if kind in ("name", "expression")]
        for row in block.rows if names else ():
            name = ", ".join(row[k].text for k in names if row[k].text != NONE)
            prior = any(cell.text in ("prior", "expectation") for cell in row)
            beside = [*(None if prior else cell.value for cell in row[1:]), None]
            for head, nearby, cell, std in zip(heads, [*heads[1:], ""], row, beside, strict=True):
                if head not in [heads[k] for k in names]:
                    found = (cell, std if nearby.startswith("± std") else None)
                    figures.setdefault((title, part, heads[names[0]], name, head), found)
    return figures


def deviations(
    a: float | None, std_a: float | None, b: float | None, std_b: float | None
) -> float | None:
    """How many standard deviations of their difference two independent estimates lie apart."""
    if a is None or b is None or not std_a or not std_b:
        return None
    return abs(b - a) / math.hypot(std_a, std_b)
