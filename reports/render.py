"""Two walks over a page: one self-contained HTML file, and lines of text."""

from __future__ import annotations

import hashlib
import re
from base64 import b64encode
from collections.abc import Iterator, Sequence
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, get_args

from markupsafe import Markup, escape

from excitant.names import shortened
from excitant.reports.charts import packed
from excitant.reports.figure import COLOURS, Figure
from excitant.reports.page import (
    Block,
    Facts,
    Folded,
    Notes,
    Page,
    Player,
    Section,
    Table,
    flat,
)
from excitant.reports.values import NONE

if TYPE_CHECKING:
    import jinja2

_PAGE = "report.html.j2"
_FIGURE = 14  # characters of a number in text
_LABEL = 32
_UNBROKEN = 24  # letters of a word that is never broken
# columns of words are a multiple of this wide, so that few changes move them
_STEP = 10
_WIDE = 200  # columns where no terminal is
_STYLES = {"good": "green", "fair": "yellow", "poor": "red"}
_ASCII = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")


def html(page: Page, saved: bool = True) -> str:
    """A page as one HTML file: no network, figures and scripts inside.

    Figures are drawn by uPlot, a motion by three.js.

    Args:
        page: What to write.
        saved: Whether the result it is drawn from stands beside it.
    """
    kinds = {
        type(block)
        for section in page.sections
        for part in section.parts
        for block in flat(part.blocks)
    }
    drawn = Figure in kinds
    names = [
        "report.js",
        *["uplot.min.js", "figures.js"] * drawn,
        *["three.js", "player.js"] * (Player in kinds),
    ]
    template = _environment().get_template(_PAGE)
    scripts = [_script(name) for name in names]
    return template.render(
        page=page, saved=saved, drawn=drawn, scripts=scripts, colours=COLOURS
    )


def _script(name: str) -> dict[str, str]:
    """A script, and the digest by which the page allows it alone."""
    text = _template(name)
    if name.startswith("uplot"):
        text = f"/*\n{_template('uplot.LICENSE')}\n*/\n{text}"
    digest = b64encode(hashlib.sha256(text.encode()).digest()).decode()
    return {"text": Markup(text), "digest": f"sha256-{digest}"}


def _template(name: str) -> str:
    return (files("excitant.reports") / "templates" / name).read_text("utf-8")


def load_templates() -> None:
    """Compile all templates: work that is interrupted and saves what it has ends sooner."""
    for name in (_PAGE, *map(_template_of, get_args(Block))):
        _environment().get_template(name)


def _template_of(kind: type[Block]) -> str:
    return f"{kind.__name__.lower()}.html.j2"


@cache
def _environment() -> jinja2.Environment:
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(_template),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters["breakable"] = _breakable
    environment.filters["packed"] = packed
    environment.filters["template"] = lambda block: _template_of(type(block))
    return environment


def _breakable(words: str) -> Markup:
    """Words, escaped; only long ones may break, after an underscore, where lines are short."""

    def broken(word: re.Match[str]) -> str:
        return (
            word[0].replace("_", "_<wbr>") if len(word[0]) > _UNBROKEN else word[0]
        )

    written = re.sub(r"\S+", broken, str(escape(words)))
    return Markup(
        re.sub(r"(?<!\S)--[\w-]+", r'<span class="whole">\g<0></span>', written)
    )


def summary(page: Page) -> str:
    """A page as text that compares with ``diff``, without figures, durations and paths."""
    lines = [f"[[{page.title}]]"]
    for block in page.summary:
        lines += _block(block)
    for section in page.sections:
        if len(page.sections) > 1:
            lines += ["", f"[[{section.title}]]"]
        lines += [f"    {section.lead}", *_parts(section)]
    return "\n".join(plain(line) for line in lines) + "\n"


def brief(page: Page, *, terminal: bool = False) -> str:
    """Summary of a page in a few lines, of which a terminal shows tables in colour."""
    sections = page.sections if page.table is None else ()
    lines = [line for section in sections for line in _brief(section)]
    written = [
        f"{label:<12} {shortened(words)}".rstrip()
        for label, words in (*lines, *page.brief)
    ]
    return "\n".join(
        [*written, *([_drawn(page.table, terminal)] if page.table else [])]
    )


def _drawn(table: Table, terminal: bool) -> str:
    """A table as narrow as its cells, its judgements in colour on a terminal."""
    from rich.console import Console
    from rich.table import Table as Drawn
    from rich.text import Text

    drawn = Drawn(box=None, pad_edge=False, header_style="bold")
    for head, kind in table.columns:
        drawn.add_column(
            Text(head), justify="right" if kind == "number" else "left"
        )
    for row in table.rows:
        drawn.add_row(
            *(Text(cell.text, _STYLES.get(cell.tone, "")) for cell in row)
        )
    console = Console(force_terminal=terminal, width=None if terminal else _WIDE)
    with console.capture() as captured:
        console.print(drawn)
    return "\n".join(line.rstrip() for line in captured.get().splitlines())


def _brief(section: Section) -> Iterator[tuple[str, str]]:
    yield from section.brief
    for block in (block for part in section.parts for block in part.blocks):
        if isinstance(block, Notes) and block.brief is not None:
            yield from ((block.brief, sentence) for sentence in block.sentences)
        elif isinstance(block, Table) and block.brief is not None:
            first = 0 if block.brief else 1
            for row in block.rows:
                names: list[str] = []
                others: list[str] = []
                cells = list(zip(block.columns, row, strict=True))
                for (_, kind), cell in cells[first:]:
                    if cell.text != NONE:
                        (names if kind == "name" else others).append(cell.text)
                yield (
                    block.brief or row[0].text,
                    ": ".join([", ".join(names), *others]),
                )


def plain(line: str) -> str:
    """A line in letters that tools compare: ASCII minus signs, spaces and powers of ten."""
    line = re.sub(
        r"×10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)", lambda e: "e" + e[1].translate(_ASCII), line
    )
    return re.sub(r"[\s\u00a0]", " ", line).replace("−", "-").rstrip()


def _parts(section: Section) -> list[str]:
    lines = []
    for part in section.parts:
        written = [line for block in part.blocks for line in _block(block)]
        lines += [f"[[{part.title}]]", *written] if written else []
    return lines


def _block(block: Block) -> list[str]:
    match block:
        case Notes():
            label = f"{block.brief}: " if block.brief else ""
            return [f"    {label}{sentence}" for sentence in block.sentences]
        case Facts():
            return [
                f"    {fact.label:<{_LABEL}} = {fact.value}"
                + (f"  ({fact.remark})" if fact.remark else "")
                for fact in block.facts
                if not fact.timing
            ]
        case Player():
            return [
                f"    {moment.t:.4g} s  {moment.words}" for moment in block.moments
            ]
        case Folded():
            return [
                f"  [{block.title}]",
                *(line for b in block.blocks for line in _block(b)),
            ]
        case Table():
            rows = [[cell.text for cell in row] for row in block.rows]
            kinds = [kind for _, kind in block.columns]
            return table_lines(
                list(zip(block.heads, kinds, strict=True)), rows, "    "
            )
    return []


def table_lines(
    columns: Sequence[tuple[str, str]],
    rows: Sequence[Sequence[str]],
    indent: str = "",
) -> list[str]:
    """A table as text, its head (heading and kind) first; expressions stand last."""
    order = sorted(range(len(columns)), key=lambda k: columns[k][1] == "expression")
    written = [[" ".join(row[k].split()) for k in order] for row in rows]
    lines = [indent] * (len(rows) + 1)
    for k, (head, kind) in enumerate(columns[j] for j in order):
        cells = [head, *("-" if row[k] == NONE else row[k] for row in written)]
        width = -(-max(map(len, cells)) // _STEP) * _STEP
        side = "<"
        if kind == "number":
            width = max(_FIGURE, len(head), *(len(c) for c in cells[1:]))
            side = ">"
        lines = [
            f"{line}{cell:{side}{width}} "
            for line, cell in zip(lines, cells, strict=True)
        ]
    return [line.rstrip() for line in lines]
