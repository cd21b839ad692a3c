"""From saved results to pages: of one run, of an examination, of several runs side by side."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from operator import attrgetter
from pathlib import PurePath
from typing import Any, NamedTuple

import msgspec
import numpy as np

from excitant.exceptions import BadInput
from excitant.names import printable
from excitant.reports import page as p
from excitant.reports import values as v
from excitant.reports.page import Cell, Page, Section
from excitant.reports.sections.analyze import analyze_section, links_folded
from excitant.reports.sections.design import (
    check_section,
    design_section,
    rehearse_section,
    show_section,
)
from excitant.reports.sections.diagnose import diagnose_section
from excitant.reports.sections.examination import examination_page
from excitant.reports.sections.fleet import fleet_section
from excitant.reports.sections.identify import identify_section
from excitant.reports.sections.robot import robot_section
from excitant.reports.values import NONE, Series
from excitant.results import (
    Analyze,
    Compare,
    ComparedFigure,
    Demo,
    Fleet,
    Go,
    Result,
    Robots,
    Simulate,
    plain_of,
    record_of,
    verb_of,
)

_SECTIONS: dict[str, Callable[[Any, Series], Section]] = {
    "robots": robot_section,
    "design": design_section,
    "check": check_section,
    "show": show_section,
    "identify": identify_section,
    "analyze": analyze_section,
    "diagnose": diagnose_section,
    "rehearse": rehearse_section,
    "fleet": fleet_section,
}
_LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
_APART = 2.0  # standard deviations of a difference from which on estimates disagree
_STD = "± std"  # in the heading of a column that belongs to the one before
_REMARKS = {
    "robot": "The runs are of different arms: {}.",
    "cutoff_hz": "Torque was filtered at different cut-offs, {} Hz: errors do not compare.",
    "unit": "Torques are in different units, {}: errors do not compare.",
    "columns": "The motions were judged by different columns, {}: condition numbers differ.",
}


def page_of(result: Mapping[str, Any] | Result, series: Series) -> Page:
    """The page of a result, as plain values or as a record, and of ``series.npz``.

    Raises:
        BadInput: The result is no record of a verb that has a page.
    """
    plain = result if isinstance(result, Mapping) else plain_of(result)
    try:
        record = record_of(_shown(plain))
    except msgspec.ValidationError as error:
        raise BadInput(f"result.json: {error}") from None
    return replace(_page(record, series), files=record.files)


def _page(record: Result, series: Series) -> Page:
    match record:
        case Go() | Demo():
            return _examination_page(record, series)
        case Compare():
            return _comparison_page(record)
        case Simulate():
            raise BadInput("result.json: verb 'simulate' has no report")
    section = _SECTIONS[verb_of(record)](record, series)
    title = section.title
    if not isinstance(record, Fleet):
        title = f"{title}: {record.robot}"
    return Page(title, section.lead, (), (section,))


def _shown(value: Any) -> Any:
    """Plain values whose texts a page can show."""
    if isinstance(value, str):
        return printable(value.replace("\n", " "))
    if isinstance(value, dict):
        return {_shown(key): _shown(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_shown(item) for item in value]
    return value


def _examination_page(result: Go | Demo, series: Series) -> Page:
    sections = {}
    for verb, build in _SECTIONS.items():
        record = getattr(result, verb, None)
        if record is None:
            continue
        arrays = {
            key.removeprefix(f"{verb}/"): values
            for key, values in series.items()
            if key.startswith(f"{verb}/")
        }
        section = build(record, arrays)
        if isinstance(record, Analyze):
            section = links_folded(section, record)
        # the verdict comes first, and what it rests on
        if isinstance(record, Robots):
            parts = [replace(part, closed=True) for part in section.parts]
            section = replace(section, parts=parts)
        sections[verb] = section
    return examination_page(result, sections)


@dataclass(frozen=True)
class SavedRun:
    """A run as it was saved: its folder, ``result.json`` and ``series.npz``."""

    folder: str
    result: Result
    series: Series


def compare(*runs: SavedRun) -> dict[str, Any]:
    """Figures of several runs of one command, with differences and ratios to the first.

    It is a result of its own (``verb`` is ``compare``).

    Raises:
        BadInput: Fewer than two runs, more than there are letters, or runs of different commands.
    """
    first = runs[0]
    verb = verb_of(first.result)
    if not 2 <= len(runs) <= len(_LETTERS):
        raise BadInput(f"{first.folder}: name 2 to {len(_LETTERS)} runs to compare")
    for run in runs[1:]:
        if (other := verb_of(run.result)) != verb:
            raise BadInput(
                f"{run.folder}: a run of '{other}', but {first.folder} is one of '{verb}'; "
                "compare runs of one command"
            )
    if isinstance(first.result, Compare):
        raise BadInput(
            f"{first.folder}: a comparison already; name the runs themselves"
        )
    pages = [page_of(run.result, {}) for run in runs]
    remarks = _remarks(runs)
    names = [PurePath(run.folder).name for run in runs]
    robots = [getattr(run.result, "robot", "") for run in runs]
    return {
        "verb": "compare",
        "of": verb,
        "robot": v.listing(list(dict.fromkeys(robots))),
        "runs": [
            {
                "name": run.folder if names.count(name) > 1 else name,
                "folder": run.folder,
                "leads": [s.lead for s in page.sections],
            }
            for run, name, page in zip(runs, names, pages, strict=True)
        ],
        "remarks": remarks,
        "figures": _compared(pages),
    }


def _remarks(runs: Sequence[SavedRun]) -> list[str]:
    remarks = []
    for field, remark in _REMARKS.items():
        for verb in ("", "design", "identify", "analyze", "diagnose"):  # of a demo
            parts = [getattr(run.result, verb, run.result) for run in runs]
            values = [getattr(part, field, None) for part in parts]
            texts = [x if isinstance(x, str) else v.number4(x) for x in values if x]
            if len(set(texts)) > 1:
                remarks.append(remark.format(" and ".join(dict.fromkeys(texts))))
                break
    if not _same_rows([run.series for run in runs]):
        remarks.append(
            "The runs were judged on different samples: a difference of errors may come from them."
        )
    return remarks


def _same_rows(series: Sequence[Series]) -> bool:
    """Whether all runs were judged on the same instants and readings, as far as is known."""
    for key in ("t", "measured"):
        first, *others = [
            np.asarray(each[key]) for each in series if key in each
        ] or [np.empty(0)]
        for other in others:
            if other.shape != first.shape or not np.allclose(
                first, other, 1e-5, 1e-9, True
            ):
                return False
    return True


class _Place(NamedTuple):
    """Where a figure stands on the pages of the runs."""

    section: str
    part: str
    of: str
    name: str
    figure: str


def _compared(pages: Sequence[Page]) -> list[dict[str, Any]]:
    """The figures of all runs; without words that all of them share."""
    walked = [_figures(page) for page in pages]
    places = dict.fromkeys(place for figures in walked for place in figures)
    rows = []
    for place in sorted(places, key=_order(places)):
        cells = [figures.get(place, (Cell(NONE), None)) for figures in walked]
        written = [cell.text for cell, _ in cells]
        values = [cell.value for cell, _ in cells]
        if len(set(written)) == 1 and all(value is None for value in values):
            continue
        first, *others = [(cell.value, std) for cell, std in cells]
        row = place._asdict() | {"written": written, "values": values}
        row["deviations"] = [deviations(*first, *other) for other in others]
        rows.append(row)
    return rows


def _order(places: Iterable[_Place]) -> Callable[[_Place], list[int]]:
    """Sort key that keeps tables, parts and sections together, as the first run has them."""
    ranks: dict[tuple[str, ...], int] = {}
    for place in places:
        for depth in (1, 2, 3):
            ranks.setdefault(place[:depth], len(ranks))
    return lambda place: [ranks[place[:depth]] for depth in (1, 2, 3)]


def _figures(page: Page) -> dict[_Place, tuple[Cell, float | None]]:
    """Cells by their places, with the std beside them; None where it is not judged."""
    figures: dict[_Place, tuple[Cell, float | None]] = {}
    for title, part, table in page.tables():
        heads = table.heads
        names = [
            k
            for k, (_, kind) in enumerate(table.columns)
            if kind in ("name", "expression")
        ]
        if not names:
            continue
        for row in table.rows:
            name = ", ".join(row[k].text for k in names if row[k].text != NONE)
            prior = any(cell.text in ("prior", "expectation") for cell in row)
            beside = [*zip(heads[1:], row[1:], strict=True), ("", Cell(NONE))]
            for k, (head, cell) in enumerate(zip(heads, row, strict=True)):
                if k in names or _STD in head:
                    continue
                place = _Place(title, part, heads[names[0]], name, head)
                following, std = beside[k]
                if _STD not in following or std.text == NONE:
                    figures.setdefault(place, (cell, None))
                    continue
                both = replace(cell, text=f"{cell.text} ± {std.text}")
                figures.setdefault(place, (both, None if prior else std.value))
    return figures


def deviations(
    a: float | None, std_a: float | None, b: float | None, std_b: float | None
) -> float | None:
    """Difference of two independent estimates in its standard deviations."""
    if a is None or b is None or not std_a or not std_b:
        return None
    return abs(b - a) / math.hypot(std_a, std_b)


def _comparison_page(result: Compare) -> Page:
    runs = result.runs
    letters = list(_LETTERS[: len(runs)])
    legend = [
        f"{letter}: {run.name}. {' '.join(run.leads)}"
        for letter, run in zip(letters, runs, strict=True)
    ]
    sections = [
        _compared_section(title, list(rows), letters)
        for title, rows in groupby(result.figures, attrgetter("section"))
    ]
    blocks = (
        p.notes(legend),
        p.sentences(result.remarks, p.POOR),
    )
    title = "Comparison of runs"
    return Page(
        f"{title}: {result.robot}" if result.robot else title,
        f"{len(runs)} runs of excitant {result.of}, compared with A; ○ marks estimates "
        f"that lie apart. {sections[0].lead if len(sections) == 1 else ''}",
        list(filter(None, blocks)),
        sections,
        [("note", remark) for remark in result.remarks],
    )


def _compared_section(
    title: str, rows: Sequence[ComparedFigure], letters: Sequence[str]
) -> Section:
    parts: p.Parts = [
        (
            part,
            [
                _table(of, list(group), letters)
                for of, group in groupby(inside, attrgetter("of"))
            ],
        )
        for part, inside in groupby(rows, attrgetter("part"))
    ]
    count = _count(rows)
    return p.section(title, count, parts[:1], ((title, count),), parts[1:])


def _count(rows: Sequence[ComparedFigure]) -> str:
    differ = sum(len(set(row.written)) > 1 for row in rows)
    apart = [x for row in rows for x in row.deviations if x is not None]
    sentence = f"{differ} of {len(rows)} figures differ."
    if apart:
        far = sum(x > _APART for x in apart)
        sentence += (
            f" {far} of {len(apart)} estimates lie more than two standard deviations of their "
            f"difference apart; of independent data, about {0.0455 * len(apart):.0f} would."
        )
    return sentence


def _table(
    of: str, rows: Sequence[ComparedFigure], letters: Sequence[str]
) -> p.Table | None:
    def column(k: int, letter: str) -> p.Column:
        def cell(row: ComparedFigure) -> Cell:
            far = k > 0 and (row.deviations[k - 1] or 0.0) > _APART
            return Cell(row.written[k], p.POOR if far else p.PLAIN)

        known = any(row.values[k] is not None for row in rows)
        return f"{'number' if known else 'text'}:{letter}", cell

    some = any(row.figure for row in rows)
    return p.table(
        rows,
        [
            (f"name:{of}", "name"),
            ("name:Quantity", "figure") if some else None,
            *(column(k, letter) for k, letter in enumerate(letters)),
        ],
    )
