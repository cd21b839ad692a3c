"""Which logs are larger than the memory that identification may take."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet

BUDGET = 8e9  # bytes of filtered columns at the full rate, with what is made on the way
_COPIES = 3.0  # of all columns at once: evaluated, filtered forward, and back
_LINES = 1000  # of a text file, whose length stands for all
_TEXT = (".csv", ".txt", ".tsv")


def larger_than_memory(paths: Sequence[str | Path], nv: int, columns: int) -> bool:
    """Whether logs are better streamed than read whole.

    Args:
        paths: The logs. Those whose number of samples shows only when they are read, bags and
            arrays, count for nothing.
        nv: Number of joints.
        columns: Number of parameters of links and effects.
    """
    samples = sum(samples_of(Path(path)) for path in paths)
    return samples * nv * columns * 8 * _COPIES > BUDGET


def samples_of(path: Path) -> int:
    """Number of samples of a Parquet file, about that of a text file, else 0; 0 if unreadable."""
    suffix = path.suffix.lower()
    try:
        if suffix in (".parquet", ".pq"):
            with pa.parquet.ParquetFile(path) as file:
                return int(file.metadata.num_rows)
        if suffix in _TEXT:
            with path.open("rb") as file:
                lines = list(itertools.islice(file, 1, _LINES))
            return int(path.stat().st_size * len(lines) / max(sum(map(len, lines)), 1))
    except (OSError, pa.ArrowException):
        pass  # said where it is read
    return 0
