"""Blocks of a report, which the writers of HTML and text walk through."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from excitant.reports import values as v
from excitant.reports.values import NONE, Result

GOOD, FAIR, POOR, PLAIN = "good", "fair", "poor", ""
_FORMATS = {
    "urdf": "URDF",
    "xml": "MuJoCo (MJCF)",
    "sdf": "SDFormat, for Gazebo",
    "yaml": "all effects, which excitant reads as a robot",
    "json": "exact coefficients",
    "csv": "samples at the control rate",
}
LONG = 12  # rows from which on a table of estimates is folded


@dataclass(frozen=True)
class Cell:
    """One table cell: its text, its judgement, and the number written (None for words)."""

    text: str
    tone: str = PLAIN
    value: float | None = None


@dataclass(frozen=True)
class Table:
    """A table with columns of a heading and a kind: ``number``, ``name``, ``text``, ``expression``.

    It may be ``folded`` behind a line until opened. Under the label ``brief``, its first cell when
    empty, the terminal shows every row as a line; none where it is None.
    """

    columns: tuple[tuple[str, str], ...]
    rows: tuple[tuple[Cell, ...], ...]
    caption: str = ""
    folded: str = ""
    brief: str | None = None


@dataclass(frozen=True)
class Panel:
    """One drawing of a figure: its SVG element, what it shows in words, and its title."""

    svg: str
    label: str
    title: str = ""


@dataclass(frozen=True)
class Key:
    """One item of a legend: a mark (``line``, ``dash``, ``box``, ``dot``, ``ring``) in a colour."""

    mark: str
    colour: str
    label: str


@dataclass(frozen=True)
class Figure:
    """Small multiples that share a legend; the caption says what to see."""

    panels: tuple[Panel, ...]
    caption: str
    legend: tuple[Key, ...] = ()


@dataclass(frozen=True)
class Matrix:
    """Categories by row and column, e.g. parameters by link; legend: category and its meaning."""

    corner: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[str, ...]], ...]
    caption: str
    legend: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Fact:
    """One figure of merit in words, and the number by which runs are compared, if it is one.

    Texts leave out a ``timing``, which changes from run to run of the same data.
    """

    label: str
    value: str
    remark: str = ""
    tone: str = PLAIN
    number: float | None = None
    timing: bool = False


@dataclass(frozen=True)
class Facts:
    """Figures of merit side by side."""

    facts: tuple[Fact, ...]


@dataclass(frozen=True)
class Notes:
    """Sentences, as a list when there are several; the tone of a page's headline is ``lead``.

    Under the label ``brief`` the terminal shows them too; texts leave out ``paths`` of files.
    """

    sentences: tuple[str, ...]
    tone: str = PLAIN
    brief: str | None = None
    paths: bool = False


@dataclass(frozen=True)
class Folded:
    """Titled blocks: a part of a section or, within one, behind their title until opened."""

    title: str
    blocks: tuple[Block, ...]


Block = Table | Figure | Matrix | Facts | Notes | Folded
Blocks = list[Block | None]
Parts = list[tuple[str, Blocks]]
Brief = tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Section:
    """One verb's result: the lead says it, the parts support it, the terminal shows the brief."""

    title: str
    lead: str
    parts: tuple[Folded, ...]
    brief: Brief = ()


@dataclass(frozen=True)
class Page:
    """A whole report: title, subtitle, what comes first, the sections, and last words.

    With a table, the terminal shows it and the page's own brief, and none of the sections'.
    """

    title: str
    subtitle: str
    summary: tuple[Block, ...]
    sections: tuple[Section, ...]
    brief: Brief = ()
    table: Table | None = None


Write = Callable[[Any], str]
Source = str | Callable[[Result], Cell | str]
Column = tuple[str, Source] | tuple[str, Source, Write]


def table(
    rows: Sequence[Result],
    columns: Sequence[Column | None],
    caption: str = "",
    folded: str = "",
    *,
    brief: str | None = None,
) -> Table | None:
    """A table of records, one a row; None without any.

    A column is its heading as ``kind:heading``, then where the cell comes from: a path of keys with
    dots, or a function of the record; a third item writes what the path leads to. Columns that are
    None are left out.
    """
    if not rows:
        return None
    kept = [column for column in columns if column is not None]
    heads = tuple((column[0].partition(":")[2], column[0].partition(":")[0]) for column in kept)
    cells = tuple(tuple(_cell(row, *column) for column in kept) for row in rows)
    return Table(heads, cells, caption, folded, brief)


def _cell(row: Result, head: str, source: Source, write: Write | None = None) -> Cell:
    if not isinstance(source, str):
        found = source(row)
        return found if isinstance(found, Cell) else Cell(found)
    keys = source.split(".")
    value = v.at(row, *keys)
    if write is None and head.startswith("number:"):
        write = v.number
    written = write(value) if write else v.listing(v.words(row, *keys), v.text(row, *keys))
    return Cell(written or NONE, PLAIN, v.real(value))


def estimates(value: str = "number:Value", std: str = "number:± std") -> tuple[Column, Column]:
    """Columns of a value and its standard deviation, both to the digits that the latter allows."""

    def written(row: Result, which: int) -> Cell:
        pair = (v.at(row, "value"), v.at(row, "std"))
        return Cell(v.value_and_std(*pair)[which], PLAIN, v.real(pair[which]))

    return (value, lambda row: written(row, 0)), (std, lambda row: written(row, 1))


_DECIDED = {
    "data": Cell("data", GOOD),
    "both": Cell("data and prior", FAIR),
    "prior": Cell("prior", POOR),
    "physics": Cell("limit of physics", FAIR),
}


def decided(who: str) -> Cell:
    """Who decided an estimate."""
    return _DECIDED.get(who, Cell(v.NONE))


def relative(row: Result) -> Cell:
    """Relative standard deviation of an estimate, with its tone."""
    rel, value, std = (v.real(row, key) for key in ("rel_std", "value", "std"))
    if rel is None and std is not None and value:
        rel = abs(std / value)
    return Cell(v.percent(rel), quality(rel), rel)


def quality(rel_std: float | None) -> str:
    """Tone of a relative standard deviation: below 5 % good, below 30 % fair, else poor."""
    if rel_std is None:
        return PLAIN
    return GOOD if abs(rel_std) < 0.05 else FAIR if abs(rel_std) < 0.3 else POOR


def numbered(rows: Sequence[Result]) -> list[Result]:
    """Records with their number, from 1, under the key ``k``."""
    return [{**row, "k": str(k)} for k, row in enumerate(rows, start=1)]


def folded(title: str, count: int, most: int = LONG) -> str:
    """A line to fold a long table behind; empty for a short one."""
    return title if count > most else ""


def fact(label: str, value: object, write: Write, remark: str = "", tone: str = PLAIN) -> Fact:
    """A figure of merit that is a number."""
    known = v.real(value)
    return Fact(label, NONE if known is None else write(known), remark, tone, known)


def facts(*found: Fact | None) -> Facts | None:
    """The facts that have a value."""
    known = tuple(fact for fact in found if fact is not None and fact.value not in (NONE, ""))
    return Facts(known) if known else None


def notes(
    sentences: Sequence[str], tone: str = PLAIN, *, brief: str | None = None, paths: bool = False
) -> Notes | None:
    """Sentences, or None without any."""
    return Notes(tuple(sentences), tone, brief, paths) if sentences else None


def figure(
    panels: Sequence[Panel | None], caption: str, legend: Sequence[Key] = ()
) -> Figure | None:
    """A figure of the panels that have data; None without any."""
    present = tuple(panel for panel in panels if panel is not None)
    return Figure(present, caption, tuple(legend)) if present else None


def files(names: Sequence[str]) -> Notes | None:
    """The files that a run has written, and what reads them."""
    said = ((name, _FORMATS.get(name.rpartition(".")[2])) for name in names)
    own = [(name, "" if name.endswith("estimate.csv") else use) for name, use in said]
    return notes([f"{name}: {use}" if use else name for name, use in own], paths=True)


def section(title: str, lead: str, parts: Parts, brief: Brief = ()) -> Section:
    """A section without the blocks that are None and the parts that are left empty."""
    kept = (Folded(heading, tuple(b for b in blocks if b is not None)) for heading, blocks in parts)
    return Section(title, lead, tuple(part for part in kept if part.blocks), brief)
