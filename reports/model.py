"""What a report is made of; the template draws these nouns and knows nothing else."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

GOOD, FAIR, POOR, PLAIN = "good", "fair", "poor", ""


@dataclass(frozen=True)
class Cell:
    """One table cell.

    Attributes:
        text: What it says.
        tone: Judgement behind its colour: good, fair, poor or none.
    """

    text: str
    tone: str = PLAIN


@dataclass(frozen=True)
class Table:
    """A table that scrolls in its own container.

    Attributes:
        columns: Heading and kind of each column: ``number``, ``name``, ``text`` or ``expression``.
        rows: Cells, one per column; a text is a cell without tone.
        caption: One sentence that says what to see.
        folded: When not empty, the table is behind this line until opened.
    """

    kind: ClassVar[str] = "table"

    columns: tuple[tuple[str, str], ...]
    rows: tuple[tuple[Cell, ...], ...]
    caption: str = ""
    folded: str = ""


@dataclass(frozen=True)
class Panel:
    """One drawing of a figure: its SVG element, what it shows in words, and its title."""

    svg: str
    label: str
    title: str = ""


@dataclass(frozen=True)
class Key:
    """One entry of a legend: a mark (``line``, ``dash``, ``box``, ``dot``) in a colour."""

    mark: str
    colour: str
    label: str


@dataclass(frozen=True)
class Figure:
    """Small multiples that share a legend.

    Attributes:
        panels: The drawings; side by side where there is room.
        caption: One sentence that says what to see.
        legend: Entries shared by all panels.
    """

    kind: ClassVar[str] = "figure"

    panels: tuple[Panel, ...]
    caption: str
    legend: tuple[Key, ...] = ()


@dataclass(frozen=True)
class Matrix:
    """Categories of things by row and column, e.g. parameters by link.

    Attributes:
        corner: Heading of the row names.
        columns: Column names.
        rows: Name and categories of each row.
        caption: One sentence that says what to see.
        legend: Category and its meaning.
    """

    kind: ClassVar[str] = "matrix"

    corner: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[str, ...]], ...]
    caption: str
    legend: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Fact:
    """One figure of merit: what, its value, a remark, a judgement."""

    label: str
    value: str
    remark: str = ""
    tone: str = PLAIN


@dataclass(frozen=True)
class Facts:
    """Figures of merit side by side."""

    kind: ClassVar[str] = "facts"

    facts: tuple[Fact, ...]


@dataclass(frozen=True)
class Notes:
    """Sentences, as a list when there are several."""

    kind: ClassVar[str] = "notes"

    sentences: tuple[str, ...]
    tone: str = PLAIN


@dataclass(frozen=True)
class Folded:
    """Blocks behind one line until it is opened."""

    kind: ClassVar[str] = "folded"

    title: str
    blocks: tuple[Block, ...]


Block = Table | Figure | Matrix | Facts | Notes | Folded


@dataclass(frozen=True)
class Part:
    """Titled blocks within a section."""

    title: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True)
class Section:
    """One verb's result.

    Attributes:
        title: Heading.
        lead: The result in a sentence or two.
        parts: What supports it.
    """

    title: str
    lead: str
    parts: tuple[Part, ...]


@dataclass(frozen=True)
class Page:
    """A whole report: title, subtitle, what comes first, and the sections."""

    title: str
    subtitle: str
    summary: tuple[Block, ...]
    sections: tuple[Section, ...]


def table(columns: str, rows: list[list[Cell | str]], caption: str = "", folded: str = "") -> Table:
    """A table from headings as ``kind:heading | kind:heading``; the kind may be left out (text)."""
    heads = []
    for column in columns.split(" | "):
        kind, _, heading = column.rpartition(":")
        heads.append((heading, kind or "text"))
    cells = tuple(tuple(c if isinstance(c, Cell) else Cell(c) for c in row) for row in rows)
    return Table(tuple(heads), cells, caption, folded)


def section(title: str, lead: str, parts: list[tuple[str, list[Block | None]]]) -> Section:
    """A section without the blocks that are None and the parts that are left empty."""
    kept = []
    for heading, blocks in parts:
        present = tuple(block for block in blocks if block is not None)
        if present:
            kept.append(Part(heading, present))
    return Section(title, lead, tuple(kept))
