"""CSV logs as programs write them: any separator, decimal commas, comments, rows of units."""

from __future__ import annotations

import csv
import io
import math
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise, product
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from excitant.exceptions import BadRecording
from excitant.identify.reading.arrays import MOST, refuse_size
from excitant.identify.reading.cells import Frame, cells, keys_of
from excitant.identify.reading.tables import Table, opened, unreadable
from excitant.identify.reading.units import spelled

if TYPE_CHECKING:
    import pandas as pd

_COMMENTS = ("#", "%", "//")
_SEPARATORS = ("\t", ";", "|", ",", " ")
_LONGEST = 1 << 20  # characters of a line
_HEAD = 1 << 18  # bytes that show how the file is written
_POINT = re.compile(
    r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?|nan", re.ASCII | re.IGNORECASE
)
_NUMBER = rf"(?:{_POINT.pattern})"
_VECTOR = re.compile(
    rf"[\[(]\s*{_NUMBER}(?:[\s,;]+{_NUMBER})*\s*[\])]|{_NUMBER}(?:\s+{_NUMBER})+",
    _POINT.flags,
)
"""Several numbers in a cell, as arrays are printed."""
_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?", re.ASCII)
_CLOCK = re.compile(r"\d:\d\d")  # in cells that hold a time of day
_CONTROL = re.compile(r"[\x00-\x08\x0e-\x1f\x7f-\x9f]")
_NAME_OF_JOINT = re.compile(
    r"(?:.*[^A-Za-z])?names?[\s_.\[]*(\d+)\]?", re.IGNORECASE
)
_CUT = "last line left out: it has no end, so it may have been cut"


@dataclass(frozen=True)
class _Dialect:
    encoding: str
    separator: str  # between cells; a space stands for any white space
    decimal: str
    # of the columns; numbers from 0 where there is no header
    names: tuple[str, ...]
    # where each is: its cell of a row, and which of several numbers there
    places: tuple[tuple[int, int | None], ...]
    skipped: int  # lines before the first row
    quoted: bool = False
    cut: bool = False  # the file ends within a line
    # joints' names, where columns hold them
    labels: Mapping[int, str] = field(default_factory=dict)

    @property
    def width(self) -> int:
        """Number of cells of a row."""
        return self.places[-1][0] + 1


def text_table(path: Path) -> Table:
    """The log in a text file."""
    dialect = _dialect_of(path)
    keys = keys_of(dialect.names)

    def frames(rows: int | None, columns: Sequence[str] | None) -> Iterator[Frame]:
        import pandas as pd  # here only: it takes long to import

        kept = {
            key: place
            for key, place in zip(keys, dialect.places, strict=True)
            if columns is None or key in columns
        }
        asked = sorted({k for k, _ in kept.values()})
        with io.TextIOWrapper(opened(path), dialect.encoding, "replace") as stream:
            lines: Any = _Lines(
                stream, dialect, str(path), MOST if rows is None else math.inf
            )
            try:
                if rows is None:
                    refuse_size(path.stat().st_size)
                with pd.read_csv(
                    lines,
                    sep=r"\s+" if dialect.separator == " " else dialect.separator,
                    decimal=dialect.decimal,
                    header=None,
                    names=list(range(dialect.width)),
                    usecols=asked,
                    index_col=False,
                    quoting=csv.QUOTE_MINIMAL if dialect.quoted else csv.QUOTE_NONE,
                    skipinitialspace=True,
                    engine="c",
                    low_memory=False,
                    chunksize=rows or sys.maxsize,
                ) as parts:
                    for part in parts:
                        if dialect.decimal == ",":
                            _write_points(part)
                        several = {
                            k: _numbers(part[k])
                            for k in {k for k, i in kept.values() if i is not None}
                        }
                        yield {
                            key: cells(
                                part[k]
                                if i is None
                                else several[k].str.get(i).astype(float)
                            )
                            for key, (k, i) in kept.items()
                        }
            except (ValueError, OSError, OverflowError) as error:
                raise lines.refusal or unreadable(path, error) from None

    return Table(
        str(path),
        dialect.names,
        frames,
        dialect.labels,
        (_CUT,) if dialect.cut else (),
    )


def _numbers(column: pd.Series) -> pd.Series:
    """The several numbers of each cell, as text."""
    return column.astype(str).str.findall(_NUMBER, _POINT.flags)


def _write_points(frame: pd.DataFrame) -> None:
    """Text with decimal commas as text with points, where a column holds other text too."""
    import pandas as pd

    for column in frame.columns:
        if pd.api.types.is_string_dtype(frame[column]):
            text = frame[column].astype(str)
            pointed = text.str.contains(".", regex=False) & ~text.str.contains(
                _CLOCK
            )
            frame[column] = text.str.replace(",", ".", regex=False).mask(
                pointed, text + " (a point among decimal commas)"
            )


class _Lines:
    """The rows of a text file for a parser: comments taken out, every row counted and checked.

    ``refusal`` says what was wrong, as parsers hide errors of what they read from.
    """

    def __init__(
        self, stream: TextIO, dialect: _Dialect, file: str, most: float
    ) -> None:
        self.refusal: BadRecording | None = None
        self._left = most  # characters to be read at once
        self._stream = stream
        self._dialect = dialect
        self._file = file
        self._row = 0
        for _ in range(dialect.skipped):
            stream.readline()

    def read(self, size: int = -1) -> str:
        """About so many characters of whole rows; nothing at the end."""
        while text := self._stream.read(max(size, 1 << 16)):
            text += self._stream.readline(_LONGEST)
            self._left -= len(text)
            if self._left < 0:
                refuse_size(MOST + 1)
            if len(text) >= _LONGEST and "\n" not in text[-_LONGEST:]:
                why = f"a line holds more than {_LONGEST} characters; cut the file there"
                self.refusal = BadRecording(self._file, why)
                raise ValueError(why)
            if kept := [line for line in io.StringIO(text) if self._is_row(line)]:
                return "".join(kept)
        return ""

    def __iter__(self) -> Iterator[str]:
        return iter(self.read, "")

    def _is_row(self, line: str) -> bool:
        separator = self._dialect.separator
        expected = self._dialect.width
        cut = self._dialect.cut and not line.endswith("\n")
        if line.isspace() or line.startswith(_COMMENTS) or cut:
            return False
        parsed = separator == " " or (self._dialect.quoted and '"' in line)
        count = (
            len(_cells(line, separator)) if parsed else line.count(separator) + 1
        )
        what = ""
        if count != expected:
            what = f"{count} cells where the header names {expected}"
        elif "\0" in line:
            what = "holds zero bytes"
        if what:
            why = f"{what}; repair or remove this row"
            self.refusal = BadRecording(self._file, why, row=self._row)
            raise ValueError(why)
        self._row += 1
        return True


def _dialect_of(path: Path) -> _Dialect:
    """Format of the table in a file.

    The separator is the first of tab, semicolon, bar, comma and space for which a line of
    numbers follows one of as many names, which tells a decimal comma from a separator and skips
    preambles; `csv.Sniffer` does neither. Decimal commas are those of most cells.
    """
    encoding, text, cut, whole = _head(path)
    lines = text.splitlines()
    # a space between numbers is rather a separator, if that suits the names
    found: tuple[int, str, str, bool, bool] | None = None
    for vectors, separator in product((False, True), _SEPARATORS):
        first = _first_row(lines, separator, vectors)
        named = first is not None and _header(lines[:first], separator)
        if first is not None and (named or not found):
            found = first, separator, encoding, cut, vectors
        if named:
            break
    if found:
        return _dialect_from(lines, *found)
    if not whole:
        why = f"no row of numbers below their names in the first {_HEAD >> 10} KiB"
        advice = "cut off what stands above, or leave columns out"
        raise BadRecording(path, f"cannot be read ({why}); {advice}")
    header = next((line for line in lines if line.strip()), "")
    separator = max(_SEPARATORS, key=lambda sign: len(_cells(header, sign)))
    names = _cells(header, separator)
    if len(names) < 2:
        why = "no line of names followed by numbers"
        advice = "give a table with named columns"
        raise BadRecording(path, f"cannot be read ({why}); {advice}")
    places = tuple((k, None) for k in range(len(names)))
    after = lines.index(header) + 1
    return _Dialect(encoding, separator, ".", tuple(names), places, after)


def _dialect_from(
    lines: Sequence[str],
    first: int,
    separator: str,
    encoding: str,
    cut: bool,
    vectors: bool,
) -> _Dialect:
    """Format of a table whose first row of numbers is known, and whether cells hold several."""
    shown = lines[first : first + 200]
    rows = [_cells(x, separator) for x in shown if not x.startswith(_COMMENTS)]
    cells = [cell for row in rows for cell in row]
    commas = sum(bool(_COMMA.fullmatch(cell)) for cell in cells)
    points = sum("." in cell and bool(_POINT.fullmatch(cell)) for cell in cells)
    numbers = [*map(str, range(len(rows[0])))]
    names = _header(lines[:first], separator) or _echoed(rows[0]) or numbers
    if len(rows[0]) == len(names) + 1 and rows[0][-1] == "":
        names.append("")
    labels = {}
    for k, name in enumerate(names):
        match = _NAME_OF_JOINT.fullmatch(name)
        texts = {row[k] for row in rows if len(row) > k}
        if match and len(texts) == 1 and not _is_number(label := texts.pop()):
            labels[int(match[1])] = label
    decimal = "," if commas > points else "."
    quoted = '"' in shown[0]
    expanded = list[str]()
    places = list[tuple[int, int | None]]()
    for k, name in enumerate(names):
        cell = rows[0][k] if k < len(rows[0]) else ""
        if vectors and _VECTOR.fullmatch(cell):
            count = len(re.findall(_NUMBER, cell, _POINT.flags))
            expanded += [f"{name}[{i}]" for i in range(count)]
            places += [(k, i) for i in range(count)]
        else:
            expanded.append(name)
            places.append((k, None))
    return _Dialect(
        encoding,
        separator,
        decimal,
        tuple(expanded),
        tuple(places),
        first,
        quoted,
        cut,
        labels,
    )


def _head(path: Path) -> tuple[str, str, bool, bool]:
    """Encoding, whole lines at the start, whether the file ends within a line and is all there."""
    with opened(path) as stream:
        head = stream.read(_HEAD)
        end = head[-1:]
        whole = len(head) < _HEAD
        if not whole:
            # the end of which is behind all that is packed
            if path.suffix.lower() != ".gz":
                stream.seek(-1, 2)
                end = stream.read(1)
            head = head[: head.rfind(b"\n") + 1] or head
    marked = head[:2] in (b"\xff\xfe", b"\xfe\xff")
    for encoding in ("utf-16",) if marked else ("utf-8-sig", "cp1252"):
        try:
            text = head.decode(
                encoding, "strict" if whole or not marked else "ignore"
            )
        except UnicodeDecodeError:
            continue
        first = text.splitlines()[:1]
        if text.strip() and not (first and _CONTROL.search(first[0])):
            return encoding, text, end not in b"\n\r\0", whole
    why = "it is empty" if not head.strip() else "it is no text"
    raise BadRecording(
        path, f"cannot be read ({why}); give a table with named columns"
    )


def _cells(line: str, separator: str) -> list[str]:
    if separator == " ":
        return line.split()
    lines = [line.rstrip("\r\n")]
    try:
        [cells] = csv.reader(lines, delimiter=separator, skipinitialspace=True)
    except (csv.Error, ValueError):  # there is no cell
        return [line]
    return [cell.strip() for cell in cells]


def _is_number(cell: str) -> bool:
    return bool(_POINT.fullmatch(cell) or _COMMA.fullmatch(cell))


def _first_row(lines: Sequence[str], separator: str, vectors: bool) -> int | None:
    """The first line of mostly numbers, when the names before it are as many."""
    for k, line in enumerate(lines):
        cells = _cells(line, separator)
        numbers = sum(map(_is_number, cells))
        if vectors:
            numbers += sum(bool(_VECTOR.fullmatch(cell)) for cell in cells)
        if (
            line.startswith(_COMMENTS)
            or len(cells) < 2
            or 2 * numbers <= len(cells)
        ):
            continue
        names = _header(lines[:k], separator)
        width, expected = (
            len(some) - (some[-1:] == [""]) for some in (cells, names)
        )
        return k if not names or width == expected or separator == "," else None
    return None


def _echoed(cells: Sequence[str]) -> list[str]:
    """Names of the cells of a joint state as ``ros2 topic echo --csv`` prints it; else none."""
    n, rest = divmod(len(cells) - 3, 4)
    texts = [k for k, cell in enumerate(cells) if cell and not _is_number(cell)]
    named = [*range(3, 3 + n)]
    if (
        n < 1
        or rest
        or texts not in (named, [2, *named])
        or not cells[1].isdecimal()
    ):
        return []
    parts = [
        f"{what}_{k}"
        for what in ("name", "position", "velocity", "effort")
        for k in range(n)
    ]
    return ["stamp.sec", "stamp.nanosec", "frame_id", *parts]


def _header(above: Sequence[str], separator: str) -> list[str]:
    """Names above the first row, with units of a row of units in brackets; empty without any."""
    for upper, lower in pairwise([line for line in above if line.strip()][-2:]):
        cells = [cell.strip("[]() ") for cell in _cells(lower, separator)]
        units = [cell for cell in cells if cell not in ("", "-")]
        named = _cells(upper, separator)
        if units and all(map(spelled, units)) and len(named) == len(cells):
            return [
                f"{n} [{u}]" if spelled(u) else n
                for n, u in zip(named, cells, strict=True)
            ]
    for line in reversed(above):
        plain = line.lstrip("".join(_COMMENTS))
        if plain.strip() and len(names := _cells(plain, separator)) > 1:
            return names
    return []
