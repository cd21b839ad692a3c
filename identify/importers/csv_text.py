"""CSV logs as programs write them: any separator, decimal commas, comments, rows of units."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, TextIO

import pandas as pd

from excitant.exceptions import BadRecording
from excitant.identify.importers.csv_dialect import COMMENTS, Dialect, dialect_of, split_line
from excitant.identify.importers.sources import Source, unreadable

_CUT = "last line left out: it has no end, so it may have been cut"


def csv_source(path: Path) -> Source:
    """The log in a text file.

    Raises:
        BadRecording: No text, or no line that could name columns.
    """
    dialect = dialect_of(path)

    def frames(rows: int | None, columns: Sequence[str] | None) -> Iterator[pd.DataFrame]:
        kept = [k for k, name in enumerate(dialect.names) if columns is None or name in columns]
        with path.open(encoding=dialect.encoding, errors="replace") as stream:
            lines = _Lines(stream, dialect, str(path))
            try:
                for part in _parsed(lines, dialect, rows, kept):
                    yield part.set_axis([dialect.names[k] for k in kept], axis=1)
            except (ValueError, OSError, OverflowError) as error:
                raise lines.refusal or unreadable(path, error) from None

    return Source(str(path), dialect.names, frames, dialect.labels, (_CUT,) if dialect.cut else ())


def _parsed(
    lines: _Lines, dialect: Dialect, rows: int | None, kept: Sequence[int]
) -> Iterator[pd.DataFrame]:
    first = lines.peek()
    if not first:
        yield pd.DataFrame({k: pd.Series(dtype=float) for k in kept})
        return
    source: Any = lines
    options: dict[str, Any] = {
        "sep": r"\s+" if dialect.separator == " " else dialect.separator,
        "decimal": dialect.decimal,
        "header": None,
        "names": list(range(len(dialect.names))),
        "usecols": list(kept),
        "index_col": False,
        "quoting": csv.QUOTE_MINIMAL if dialect.quoted else csv.QUOTE_NONE,
        "skipinitialspace": True,
        "engine": "c",
    }
    if rows is None:
        whole = pd.read_csv(source, low_memory=False, **options)
        yield _with_points(whole, dialect.decimal)
        return
    with pd.read_csv(source, chunksize=rows, low_memory=False, **options) as parts:
        for part in parts:
            yield _with_points(part.reset_index(drop=True), dialect.decimal)


def _with_points(frame: pd.DataFrame, decimal: str) -> pd.DataFrame:
    """Text with decimal commas as text with points, where a column holds other text too."""
    if decimal == ".":
        return frame
    for column in frame.columns:
        if pd.api.types.is_string_dtype(frame[column]):
            text = frame[column].astype(str)
            pointed = text.str.contains(".", regex=False)
            frame[column] = text.str.replace(",", ".", regex=False).mask(
                pointed, text + " (a point among decimal commas)"
            )
    return frame


class _Lines:
    """The rows of a text file for a parser: comments taken out, every row counted and checked.

    Attributes:
        refusal: What was wrong, as parsers hide errors of what they read from.
    """

    def __init__(self, stream: TextIO, dialect: Dialect, file: str) -> None:
        self.refusal: BadRecording | None = None
        self._stream, self._dialect, self._file = stream, dialect, file
        self._row = 0
        for _ in range(dialect.skipped):
            stream.readline()
        self._waiting = ""

    def peek(self) -> str:
        """The first rows, kept for the parser."""
        self._waiting = self.read(1 << 12)
        return self._waiting

    def read(self, size: int = -1) -> str:
        """About so many characters of whole rows; nothing at the end."""
        if self._waiting:
            text, self._waiting = self._waiting, ""
            return text
        while lines := self._stream.readlines(max(size, 1 << 16)):
            if kept := [line for line in lines if self._is_row(line)]:
                return "".join(kept)
        return ""

    def __iter__(self) -> Iterator[str]:
        while text := self.read():
            yield text

    def _is_row(self, line: str) -> bool:
        if line.isspace() or line.startswith(COMMENTS):
            return False
        if self._dialect.cut and not line.endswith("\n"):
            return False
        expected, found = len(self._dialect.names), self._count(line)
        if found != expected or "\0" in line:
            why = (
                f"{found} cells where the header names {expected}; repair or remove this row"
                if found != expected
                else "holds zero bytes; repair or remove this row"
            )
            self.refusal = BadRecording(self._file, why, row=self._row)
            raise ValueError(why)
        self._row += 1
        return True

    def _count(self, line: str) -> int:
        separator = self._dialect.separator
        if separator == " " or (self._dialect.quoted and '"' in line):
            return len(split_line(line, separator))
        return line.count(separator) + 1
