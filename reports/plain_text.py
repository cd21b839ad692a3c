"""How a summary writes values, tables and sentences as text of fixed columns."""

from __future__ import annotations

from collections.abc import Sequence

from excitant.reports.reading import at, real

FIGURE = 12  # characters of a number
Cells = Sequence[str | float | None]


def fields(title: str, value: object, keys: Sequence[str]) -> list[str]:
    """Values under a title, one per line; a key may be a path with dots."""
    lines = [f"[[{title}]]"] if title else []
    for key in keys:
        found = at(value, *key.split("."))
        if found is None:
            written = "-"
        elif isinstance(found, list):
            written = ", ".join(map(str, found)) or "none"
        elif isinstance(found, bool):
            written = "yes" if found else "no"
        else:
            written = str(found) if real(found) is None else f"{real(found):.6g}"
        lines.append(f"    {key.replace('.', ' '):<32} = {one_line(written)}")
    return lines


def one_line(words: str) -> str:
    """Words without line breaks."""
    return " ".join(words.split())


def figure(value: float | None) -> str:
    """A number of five digits, a dash for none."""
    return "-" if value is None else f"{value:.5g}"


def table(title: str, heads: Sequence[str], rows: Sequence[Cells]) -> list[str]:
    """A titled table: names on the left at their own width, the rest in columns of fixed width."""
    if not rows:
        return []
    wide = max(20, *(len(one_line(str(row[0]))) for row in rows))
    words_in = [any(isinstance(row[k], str) for row in rows) for k in range(len(heads))]
    lines = [f"[[{title}]]"]
    for row in (heads, *rows):
        line = f"    {one_line(str(row[0])):<{wide}}"
        for cell, left in list(zip(row, words_in, strict=True))[1:]:
            written = one_line(cell) if isinstance(cell, str) else figure(cell)
            line += f"  {written:<{FIGURE}}" if left else f"  {written:>{FIGURE}}"
        lines.append(line)
    return lines


def sentences(title: str, lines: Sequence[str]) -> list[str]:
    """Sentences under a title; nothing where there are none."""
    written = [f"    {one_line(line)}" for line in lines]
    return [f"[[{title}]]", *written] if written else []


def numbers_first(title: str, heads: Sequence[str], rows: Sequence[Cells]) -> list[str]:
    """A titled table whose first column, written last, is as long as it likes."""
    if not rows:
        return []
    lines = [
        f"[[{title}]]",
        "   " + "".join(f" {head:>{FIGURE}}" for head in heads) + "  expression",
    ]
    for row in rows:
        cells = [c if isinstance(c, str) else figure(c) for c in row[1:]]
        lines.append(
            "   " + "".join(f" {cell:>{FIGURE}}" for cell in cells) + f"  {one_line(str(row[0]))}"
        )
    return lines
