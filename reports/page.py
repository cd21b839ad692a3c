"""Blocks of a report, which the writers of HTML and text walk through."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from operator import attrgetter
from typing import Any

from excitant.reports import values as v
from excitant.reports.figure import Figure, Key
from excitant.reports.values import NONE

GOOD = "good"
FAIR = "fair"
POOR = "poor"
PLAIN = ""
_FORMATS = {  # by the end of the name
    "result.json": "every figure of this page, for programs",
    "npz": "the arrays that its figures draw",
    "txt": "this page as text",
    "approach.csv": "from the present pose to the first of the motion",
    "return.csv": "from the last pose of the motion back",
    "first_run.csv": "the same path, slower",
    "parquet": "recording",
    "model-estimate.csv": "estimates and standard deviations, which model.yaml refers to",
    "ros2_control.yaml": "parameters of controllers of ROS 2",
    "ros2_client.py": "program for ROS 2, which runs the motions at a fifth of the speed",
    "script": "URScript, at a fifth of the speed",
    "urdf": "URDF",
    "links": "links and joints, which the YAML refers to",
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

    A heading may be ``group|heading``: columns of one group stand under its name. The table may be
    ``folded`` behind a line until opened. Under the label ``brief``, its first cell when empty,
    the terminal shows every row as a line; none where it is None.
    """

    columns: Sequence[tuple[str, str]]
    rows: Sequence[Sequence[Cell]]
    caption: str = ""
    folded: str = ""
    brief: str | None = None

    @property
    def heads(self) -> list[str]:
        """Headings with the names of their groups."""
        return [head.replace("|", ", ") for head, _ in self.columns]

    @property
    def groups(self) -> list[tuple[str, int]]:
        """Names of groups and how many columns each has; empty where there is none."""
        names = [head.rpartition("|")[0] for head, _ in self.columns]
        spans = [(name, len(list(columns))) for name, columns in groupby(names)]
        return spans if any(names) else []


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

    facts: Sequence[Fact]


@dataclass(frozen=True)
class Notes:
    """Sentences, as a list when there are several; the tone of a page's headline is ``lead``.

    Under the label ``brief`` the terminal shows them too.
    """

    sentences: Sequence[str]
    tone: str
    brief: str | None


@dataclass(frozen=True)
class Moment:
    """An instant of a motion worth a look: when [s], and what happens then."""

    t: float
    words: str
    tone: str


@dataclass(frozen=True)
class Player:
    """An arm in motion, played by a script of the page from ``data``; moments stand without it."""

    data: dict[str, Any]
    joints: Sequence[tuple[str, str]]  # name, and unit of its position
    quantities: Sequence[str]  # whose share of the limit is shown
    moments: Sequence[Moment]
    caption: str
    legend: Sequence[Key]


@dataclass(frozen=True)
class Folded:
    """Titled blocks: a part of a section or, within one, behind their title until opened.

    A part may be ``closed``: it is behind its title, too.
    """

    title: str
    blocks: Sequence[Block]
    closed: bool = False


Block = Table | Figure | Player | Facts | Notes | Folded
Blocks = list["Block | tuple[str, Blocks] | None"]
"""What stands in a part; a title with blocks is a part within it."""
Parts = list[tuple[str, Blocks]]
Brief = Sequence[tuple[str, str]]


@dataclass(frozen=True)
class Section:
    """One verb's result: the lead says it, the parts support it, the terminal shows the brief."""

    title: str
    lead: str
    parts: Sequence[Folded]
    brief: Brief


@dataclass(frozen=True)
class Page:
    """A whole report: title, subtitle, what comes first, the sections, and last words.

    Files stand beside it, by name; texts leave them out. With a table, the terminal shows it and
    the page's own brief, and none of the sections'.
    """

    title: str
    subtitle: str
    summary: Sequence[Block]
    sections: Sequence[Section]
    brief: Brief = ()
    files: Sequence[str] = ()
    table: Table | None = None

    @property
    def uses(self) -> list[tuple[str, str]]:
        """The files, and what reads them or what they hold."""
        return [(name, _use(name)) for name in self.files]

    def tables(self) -> Iterator[tuple[str, str, Table]]:
        """All tables, key figures among them, with the titles of their section and part."""
        for section in self.sections:
            for part in section.parts:
                for table in _tables(part.blocks):
                    yield section.title, part.title, table


def _use(file: str) -> str:
    return next((use for end, use in _FORMATS.items() if file.endswith(end)), "")


def flat(blocks: Sequence[Block]) -> Iterator[Block]:
    """Blocks and those within them."""
    for block in blocks:
        yield block
        if isinstance(block, Folded):
            yield from flat(block.blocks)


def _tables(blocks: Sequence[Block]) -> Iterator[Table]:
    for block in flat(blocks):
        match block:
            case Facts():
                known = [fact for fact in block.facts if not fact.timing]
                rows = [
                    (Cell(x.label), Cell(x.value, value=x.number)) for x in known
                ]
                yield Table((("Figure", "name"), ("", "number")), rows)
            case Table():
                yield block


Write = Callable[[Any], str]
Source = str | Callable[[Any], Any]
Column = tuple[str, Source] | tuple[str, Source, Write]


def table(
    rows: Sequence[Any],
    columns: Sequence[Column | None],
    caption: str = "",
    folded: str = "",
    *,
    long: str = "",
    most: int = LONG,
    brief: str | None = None,
) -> Table | None:
    """A table of records, one a row; None without any.

    One of more rows than ``most`` is folded behind the line ``long``, in which ``{}`` counts them.

    A column is its heading as ``kind:heading``, then where its cells come from: a field, dots for
    one of a field, or a function of the record that gives a value or a cell; a third item writes
    the value. Columns that are None are left out.
    """
    if not rows:
        return None
    present = [column for column in columns if column is not None]
    heads = [column[0].partition(":")[::-2] for column in present]
    cells = [[_cell(row, *column) for column in present] for row in rows]
    if len(rows) > most:
        folded = folded or long.format(len(rows))
    return Table(heads, cells, caption, folded, brief)


def _cell(row: Any, head: str, source: Source, write: Write | None = None) -> Cell:
    value = attrgetter(source)(row) if isinstance(source, str) else source(row)
    if isinstance(value, Cell):
        return value
    if write is None:
        numeric = head.startswith("number:") and not isinstance(value, str)
        write = v.number if numeric else _words
    return cell(value, write)


def cell(value: Any, write: Write, tone: str = PLAIN) -> Cell:
    """A value as it is written, with a tone; a dash for none."""
    return Cell(write(value) or NONE, tone, v.real(value))


def _words(value: str | list[str] | None) -> str:
    return ", ".join(value) if isinstance(value, list) else value or ""


def estimates(
    value: str = "number:Value",
    std: str = "number:± std",
    of: Callable[[Any], Any] = lambda row: row,
) -> tuple[Column, Column]:
    """Columns of a value and its standard deviation, both to the digits that the latter allows.

    They are those of the record, or of what is picked ``of`` it: None for an empty cell.
    """

    def written(row: Any, which: int) -> Cell:
        estimate = of(row)
        if estimate is None:
            return Cell(NONE)
        pair = (estimate.value, estimate.std)
        return Cell(v.value_and_std(*pair)[which], PLAIN, v.real(pair[which]))

    return (value, lambda row: written(row, 0)), (std, lambda row: written(row, 1))


_DECIDED = {
    "data": Cell("data", GOOD),
    "both": Cell("both", FAIR),
    "prior": Cell("prior", POOR),
}


def decided(who: str | None) -> Cell:
    """Who decided an estimate."""
    return _DECIDED.get(who or "", Cell(NONE))


def relative(row: Any) -> Cell:
    """Relative standard deviation of an estimate, with its tone."""
    rel = getattr(row, "rel_std", None)
    if rel is None and row.std is not None and row.value:
        rel = abs(row.std / row.value)
    return cell(rel, v.percent, quality(rel))


def quality(rel_std: float | None) -> str:
    """Tone of a relative standard deviation: below 5 % good, below 30 % fair, else poor."""
    if rel_std is None:
        return PLAIN
    return GOOD if abs(rel_std) < 0.05 else FAIR if abs(rel_std) < 0.3 else POOR


def fact(
    label: str, value: object, write: Write, remark: str = "", tone: str = PLAIN
) -> Fact:
    """A figure of merit that is a number."""
    known = v.real(value)
    return Fact(label, NONE if known is None else write(known), remark, tone, known)


def facts(*candidates: Fact) -> Facts | None:
    """The facts that have a value."""
    valued = [fact for fact in candidates if fact.value not in (NONE, "")]
    return Facts(valued) if valued else None


def notes(
    sentences: Sequence[str], tone: str = PLAIN, *, brief: str | None = None
) -> Notes | None:
    """Sentences, or None without any."""
    return Notes(sentences, tone, brief) if sentences else None


def sentences(
    words: Sequence[str], tone: str = PLAIN, *, brief: str | None = None
) -> Notes | None:
    """Words as sentences, or None without any."""
    return notes([v.sentence(each) for each in words], tone, brief=brief)


def section(
    title: str,
    lead: str,
    parts: Parts,
    brief: Brief,
    closed: Parts | None = None,
) -> Section:
    """A section without the blocks that are None and the parts that are left empty.

    After the parts come those that are behind their titles.
    """
    built = [_part(*part) for part in parts]
    built += [_part(*part, True) for part in closed or []]
    return Section(title, lead, [part for part in built if part.blocks], brief)


def _part(title: str, blocks: Blocks, closed: bool = False) -> Folded:
    built = [
        _part(*block) if isinstance(block, tuple) else block for block in blocks
    ]
    return Folded(title, list(filter(None, built)), closed)
