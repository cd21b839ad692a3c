"""Table: a log as named columns, read whole or in pieces; Parquet, NPZ and MAT files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from excitant.exceptions import BadRecording
from excitant.identify.importers.names import meaning

Frames = Callable[[int | None, Sequence[str] | None], Iterator[pd.DataFrame]]
_BUFFER = 1 << 18  # bytes of a Parquet column at a time: row groups may be larger than memory
_HDF5 = b"\x89HDF\r\n\x1a\n"


@dataclass(frozen=True)
class Table:
    """A log that can be read.

    Attributes:
        file: Its path.
        names: Columns, in order; a name may be there twice.
        frames: ``frames(rows, columns)``: pieces of at most so many rows (one piece when None)
            with some columns (all when None). Numbers that cannot be read stay text.
        labels: Joints' names by number, where the log has them.
        notes: What was understood or left out on the way.
        joined: Whether columns are ``joint.quantity`` and rows come from messages, of which only
            those that hold what is asked for are read.
    """

    file: str
    names: tuple[str, ...]
    frames: Frames
    labels: Mapping[int, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    joined: bool = False


def unreadable(path: str | Path, error: BaseException) -> BadRecording:
    """The refusal of a file that its reader cannot read."""
    lines = str(error).strip().splitlines()
    return BadRecording(path, f"cannot be read ({lines[0] if lines else type(error).__name__})")


def table_of_frame(frame: pd.DataFrame, file: str, notes: tuple[str, ...] = ()) -> Table:
    """A table in memory."""
    names = tuple(str(name) for name in frame.columns)
    frame = frame.set_axis(list(range(len(names))), axis=1)

    def frames(rows: int | None, columns: Sequence[str] | None) -> Iterator[pd.DataFrame]:
        kept = [k for k, name in enumerate(names) if columns is None or name in columns]
        part = frame[kept].set_axis([names[k] for k in kept], axis=1)
        step = rows or max(len(part), 1)
        for start in range(0, max(len(part), 1), step):
            yield part.iloc[start : start + step]

    return Table(file, names, frames, notes=notes)


def parquet_table(path: Path) -> Table:
    """The log in a Parquet file; a column of lists becomes ``name[0]``, ``name[1]``, ..."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    def is_list(kind: Any) -> bool:
        kinds = (pa.types.is_list, pa.types.is_large_list, pa.types.is_fixed_size_list)
        return any(is_kind(kind) for is_kind in kinds)

    with pq.ParquetFile(path) as file:
        schema = file.schema_arrow
        lists = [each.name for each in schema if is_list(each.type)]
        first = next(file.iter_batches(1, columns=lists), None) if lists else None
    rows = first.to_pylist() if first is not None else []
    widths = {name: len(rows[0][name] or ()) if rows else 0 for name in lists}

    def frames(rows: int | None, columns: Sequence[str] | None) -> Iterator[pd.DataFrame]:
        logged = None
        if columns is not None:
            logged = [each.name for each in schema if each.name in columns or each.name in widths]
        try:
            with pq.ParquetFile(
                path, pre_buffer=False, buffer_size=_BUFFER, page_checksum_verification=True
            ) as file:
                if rows is None:
                    yield _frame(file.read(columns=logged, use_threads=False), widths, path)
                    return
                for batch in file.iter_batches(rows, columns=logged, use_threads=False):
                    yield _frame(pa.Table.from_batches([batch]), widths, path)
        except (pa.ArrowException, OSError, ValueError) as error:
            raise unreadable(path, error) from None

    names = [name for each in schema for name in _spread(each.name, widths)]
    return Table(str(path), tuple(names), frames)


def _spread(name: str, widths: Mapping[str, int]) -> list[str]:
    return [f"{name}[{k}]" for k in range(widths[name])] if name in widths else [name]


def _frame(table: Any, widths: Mapping[str, int], path: Path) -> pd.DataFrame:
    columns: list[pd.Series] = []
    for name, column in zip(table.column_names, table.columns, strict=True):
        if name not in widths:
            columns.append(column.to_pandas(ignore_metadata=True))
            continue
        values = column.to_pylist()
        for row, value in enumerate(values):
            if len(value or ()) != widths[name]:
                why = f"holds {len(value or ())} values, the first row {widths[name]}; remove it"
                raise BadRecording(path, why, row=row, column=name)
        columns += [pd.Series([value[k] for value in values]) for k in range(widths[name])]
    frame = pd.concat(columns, axis=1) if columns else pd.DataFrame()
    return frame.set_axis([n for name in table.column_names for n in _spread(name, widths)], axis=1)


def npz_table(path: Path) -> Table:
    """The log in an NPZ file; an array ``q`` of shape (n, nv) becomes ``q[0]``, ``q[1]``, ..."""
    with np.load(path, allow_pickle=False) as file:
        return _table_of_arrays({name: np.asarray(file[name]) for name in file.files}, path)


def mat_table(path: Path) -> Table:
    """The log in a MAT file of version 4 to 7.2; fields of structs become ``struct.field``.

    Raises:
        BadRecording: Version 7.3, which is another format (HDF5).
    """
    import scipy.io

    with path.open("rb") as stream:
        start = stream.read(520)
    if _HDF5 in (start[:8], start[512:520]) or start.startswith(b"MATLAB 7.3"):
        raise BadRecording(
            path, "is a MAT file of version 7.3 (HDF5); save it with save(..., '-v7') in MATLAB"
        )
    return _table_of_arrays(_flattened(scipy.io.loadmat(path, simplify_cells=True)), path)


def _flattened(content: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    arrays: dict[str, Any] = {}
    for name, value in content.items():
        if isinstance(value, Mapping):
            arrays |= _flattened(value, f"{before}{name}.")
        elif not name.startswith("__"):
            arrays[f"{before}{name}"] = np.asarray(value)
    return arrays


def _table_of_arrays(arrays: Mapping[str, Any], path: Path) -> Table:
    numbers = {
        name: array[:, None] if array.ndim == 1 else array
        for name, array in arrays.items()
        if array.dtype.kind in "fiuM" and array.ndim in (1, 2) and array.size
    }
    if not numbers:
        raise BadRecording(path, "holds no array of numbers; give t, q and tau")
    times = [a for name, a in numbers.items() if meaning(name).role == "t" and 1 in a.shape]
    lengths = Counter(max(array.shape) for array in numbers.values())
    n = times[0].size if len(times) == 1 else lengths.most_common(1)[0][0]
    rows = {name: _as_rows(name, array, n, path) for name, array in numbers.items()}
    columns = {
        name if array.shape[1] == 1 else f"{name}[{k}]": array[:, k]
        for name, array in rows.items()
        if array is not None
        for k in range(array.shape[1])
    }
    others = ", ".join(name for name, array in rows.items() if array is None)
    notes = (f"arrays of other lengths left out: {others}",) if others else ()
    return table_of_frame(pd.DataFrame(columns), str(path), notes)


def _as_rows(name: str, array: Any, n: int, path: Path) -> Any:
    """An array with one row per sample; None when it belongs to no sample."""
    if array.shape == (n, n) and n > 1:
        raise BadRecording(path, f"is {n} × {n}: rows or columns could be samples", column=name)
    if n in array.shape:
        return array if n == array.shape[0] else array.T
    found = meaning(name)
    if found.role in ("q", "tau", "i") and not found.words and not found.commanded:
        shape = " × ".join(map(str, array.shape))
        raise BadRecording(
            path, f"is {shape}, but there are {n} samples; save arrays of one length", column=name
        )
    return None
