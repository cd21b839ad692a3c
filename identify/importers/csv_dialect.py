"""How a text file writes its table, found from its first lines."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

from excitant.exceptions import BadRecording
from excitant.identify.importers.units import spelled

COMMENTS = ("#", "%", "//")
_SEPARATORS = ("\t", ";", "|", ",", " ")
_HEAD = 1 << 18  # bytes looked at
_POINT = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|nan", re.ASCII | re.IGNORECASE)
_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?", re.ASCII)
_CONTROL = re.compile(r"[\x00-\x08\x0e-\x1f\x7f-\x9f]")
_NAME_OF_JOINT = re.compile(r"(?:.*[^A-Za-z])?names?[\s_.\[]*(\d+)\]?", re.IGNORECASE)


@dataclass(frozen=True)
class Dialect:
    """How a text file writes its table.

    Attributes:
        encoding: Encoding of the text.
        separator: Between cells; a space stands for any white space.
        decimal: Decimal sign, ``"."`` or ``","``.
        names: Names of the columns; numbers from 0 where there is no header.
        skipped: Lines before the first row.
        quoted: Whether cells are quoted.
        cut: Whether the file ends within a line.
        labels: Joints' names by number, where columns hold them.
    """

    encoding: str
    separator: str
    decimal: str
    names: tuple[str, ...]
    skipped: int
    quoted: bool
    cut: bool
    labels: Mapping[int, str] = field(default_factory=dict)


def dialect_of(path: Path) -> Dialect:
    """How a file writes its table.

    The separator is the first of tab, semicolon, bar, comma and space for which a line of
    numbers follows one of as many names. Decimal commas are those of most cells.

    Raises:
        BadRecording: No text, or nothing that names columns.
    """
    with path.open("rb") as stream:
        head = stream.read(_HEAD)
        end = head[-1:]
        if len(head) == _HEAD:
            stream.seek(-1, 2)
            end = stream.read(1)
    encoding, text = _decoded(head, path)
    lines = text.splitlines()
    if len(head) == _HEAD and lines:
        lines.pop()
    for separator in _SEPARATORS:
        first = _first_row(lines, separator)
        if first is not None:
            return _described(lines, first, separator, encoding, end not in b"\n\r\0")
    return _without_rows(lines, encoding, path)


def split_line(line: str, separator: str) -> list[str]:
    """Cells of a line, without white space around them."""
    if separator == " ":
        return line.split()
    try:
        cells = next(csv.reader([line.rstrip("\r\n")], delimiter=separator, skipinitialspace=True))
    except (csv.Error, StopIteration):
        return [line]
    return [cell.strip() for cell in cells]


def _decoded(head: bytes, path: Path) -> tuple[str, str]:
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encodings: tuple[str, ...] = ("utf-16",)
    else:
        encodings = ("utf-8-sig", "cp1252")
    for encoding in encodings:
        try:
            text = head.decode(encoding, "strict")
        except UnicodeDecodeError as error:
            if encoding != "utf-8-sig" or error.start < len(head) - 4 or len(head) < _HEAD:
                continue
            text = head[: error.start].decode(encoding)
        first = text.splitlines()[:1]
        if text.strip() and not (first and _CONTROL.search(first[0])):
            return encoding, text
    why = "it is empty" if not head.strip() else "it is no text"
    raise BadRecording(path, f"cannot be read ({why}); give a table with named columns")


def _is_number(cell: str) -> bool:
    return bool(_POINT.fullmatch(cell) or _COMMA.fullmatch(cell))


def _numeric(cells: Sequence[str]) -> bool:
    """Whether a line is one of numbers, a few of which may be damaged or dates."""
    return len(cells) > 1 and 2 * sum(map(_is_number, cells)) > len(cells)


def _first_row(lines: Sequence[str], separator: str) -> int | None:
    """The first line of numbers, when the line of names before it has as many cells."""
    for k, line in enumerate(lines):
        if line.startswith(COMMENTS) or not _numeric(split_line(line, separator)):
            continue
        cells = _stripped(split_line(line, separator))
        header = _header(lines, k, separator)
        if header is not None and len(_stripped(split_line(header, separator))) != len(cells):
            return k if separator == "," else None
        return k
    return None


def _stripped(cells: list[str]) -> list[str]:
    return cells[:-1] if cells[-1:] == [""] else cells


def _header(lines: Sequence[str], row: int, separator: str) -> str | None:
    """The line of names above the first row, without a comment sign; None when there is none."""
    for line in reversed(lines[:row]):
        plain = line.lstrip("".join(COMMENTS)).strip("\r\n")
        if plain.strip() and len(split_line(plain, separator)) > 1:
            return plain.strip() if separator == " " else plain
    return None


def _described(lines: Sequence[str], row: int, separator: str, encoding: str, cut: bool) -> Dialect:
    header = _header(lines, row, separator)
    some = [line for line in lines[row : row + 200] if not line.startswith(COMMENTS)]
    cells = [cell for line in some for cell in split_line(line, separator)]
    commas = sum(bool(_COMMA.fullmatch(cell)) for cell in cells)
    points = sum("." in cell and bool(_POINT.fullmatch(cell)) for cell in cells)
    first = split_line(lines[row], separator)
    names = _names(lines, row, header, separator) if header else list(map(str, range(len(first))))
    if len(first) == len(names) + 1 and first[-1] == "":
        names.append("")
    return Dialect(
        encoding,
        separator,
        "," if commas > points else ".",
        tuple(names),
        row,
        any('"' in line for line in some[:1]),
        cut and len(lines) > row,
        _labels(names, [split_line(line, separator) for line in some]),
    )


def _names(lines: Sequence[str], row: int, header: str, separator: str) -> list[str]:
    """Names of the header, with units of a row of units below it in brackets."""
    names = split_line(header, separator)
    above = [line for line in lines[:row] if line.strip()]
    for upper, lower in pairwise(above[-2:]):
        cells = [cell.strip("[]() ") for cell in split_line(lower, separator)]
        units = [cell for cell in cells if cell not in ("", "-")]
        named = split_line(upper, separator)
        if units and all(map(spelled, units)) and len(named) == len(cells):
            return [f"{n} [{u}]" if spelled(u) else n for n, u in zip(named, cells, strict=True)]
    return names


def _labels(names: Sequence[str], rows: Sequence[Sequence[str]]) -> dict[int, str]:
    """Joints' names by number, of columns such as ``name_0`` that hold one text throughout."""
    labels = {}
    for k, name in enumerate(names):
        match = _NAME_OF_JOINT.fullmatch(name)
        texts = {row[k] for row in rows if len(row) > k}
        if match and len(texts) == 1 and not _is_number(text := texts.pop()):
            labels[int(match[1])] = text
    return labels


def _without_rows(lines: Sequence[str], encoding: str, path: Path) -> Dialect:
    """A header alone, or no line of numbers at all."""
    header = next((line for line in lines if line.strip()), "")
    separator = max(_SEPARATORS, key=lambda sign: len(split_line(header, sign)))
    names = split_line(header, separator)
    if len(names) < 2:
        raise BadRecording(
            path, "cannot be read (no line of names followed by numbers); give a table with "
            "named columns",
        )  # fmt: skip
    return Dialect(encoding, separator, ".", tuple(names), lines.index(header) + 1, False, False)
