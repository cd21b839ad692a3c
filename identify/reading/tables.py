"""Tables of logs: Parquet, JSON, NPZ and MAT files."""

from __future__ import annotations

import gzip
import re
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, cast

import numpy as np

from excitant.exceptions import BadRecording
from excitant.identify.reading import mat
from excitant.identify.reading.arrays import MOST, read_arrays, refuse_size
from excitant.identify.reading.cells import Cells, Frame, cells, keys_of
from excitant.identify.reading.names import meaning
from excitant.robots.schema import parsed_json

if TYPE_CHECKING:
    import pandas as pd


def opened(path: Path) -> BinaryIO:
    """The bytes of a file, unpacked where its name ends in ``.gz``."""
    packed = path.suffix.lower() == ".gz"
    return cast(BinaryIO, gzip.open(path)) if packed else path.open("rb")


Frames = Callable[[int | None, Sequence[str] | None], Iterator[Frame]]

# bytes of a Parquet column at a time: row groups may be larger than memory
_BUFFER = 1 << 18
_PIECE = 1 << 20  # bytes unpacked at a time
_COMPRESSED = 15  # type of an element of a MAT file
_HDF5 = b"\x89HDF\r\n\x1a\n"
_NAMES = re.compile("name|joint", re.IGNORECASE)
_PER_NUMBER = 16  # bytes that a byte of JSON may take once it is read


@dataclass(frozen=True)
class Table:
    """A log that can be read whole or in pieces.

    ``frames(rows, columns)`` gives pieces of at most so many rows (one piece when None) with some
    columns (all when None); numbers that cannot be read stay text.
    """

    file: str
    names: tuple[str, ...]  # of columns, in order; a name may be there twice
    frames: Frames
    # joints' names by number, if any
    labels: Mapping[int, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    # columns are joint.quantity; messages without any asked for are left out
    joined: bool = False


def timed(table: Table, rate: float) -> Table:
    """The table with a last column of the time at which its rows are taken at a rate [Hz]."""
    name = f"rows at {rate:g} Hz"

    def frames(rows: int | None, columns: Sequence[str] | None) -> Iterator[Frame]:
        first = 0
        asked = columns and [column for column in columns if column != name]
        for frame in table.frames(rows, asked):
            n = len(next(iter(frame.values()), ()))
            yield {**frame, name: (first + np.arange(n)) / rate}
            first += n

    return replace(table, names=(*table.names, name), frames=frames)


def unreadable(path: str | Path, error: BaseException) -> BadRecording:
    """The refusal of a file that its reader cannot read."""
    lines = str(error).strip().splitlines()
    return BadRecording(
        path, f"cannot be read ({lines[0] if lines else type(error).__name__})"
    )


def table_of_frame(
    frame: pd.DataFrame, file: str, notes: tuple[str, ...] = ()
) -> Table:
    """A table in memory."""
    names = tuple(str(name) for name in frame.columns)
    return _table(
        names, [cells(frame.iloc[:, k]) for k in range(len(names))], file, notes
    )


def _table(
    names: tuple[str, ...],
    columns: Sequence[Cells],
    file: str,
    notes: tuple[str, ...],
) -> Table:
    whole = dict(zip(keys_of(names), columns, strict=True))
    n = max(len(columns[0]), 1) if columns else 1

    def frames(rows: int | None, asked: Sequence[str] | None) -> Iterator[Frame]:
        kept = {
            name: x for name, x in whole.items() if asked is None or name in asked
        }
        for start in range(0, n, rows or n):
            some = slice(start, start + (rows or n))
            yield {
                name: x[some] if isinstance(x, np.ndarray) else x.iloc[some]
                for name, x in kept.items()
            }

    return Table(file, names, frames, notes=notes)


def joined_table(folder: Path, parts: Mapping[str, Table]) -> Table:
    """One table of several that hold a quantity each, by the names of these.

    A column is named by the quantity and its joint, as ``efforts.elbow_joint``.

    Raises:
        BadRecording: A table without time, or with other times than the first one.
    """
    whole = dict[str, Cells]()
    for quantity, table in parts.items():
        frame = next(table.frames(None, None))
        of_time = [name for name in frame if meaning(name).role == "t"]
        if not of_time:
            raise BadRecording(table.file, "is missing; name it t", column="t")
        for name in of_time:
            first = np.asarray(whole.setdefault(name, frame[name]))
            if not np.array_equal(first, np.asarray(frame[name])):
                why = f"differs from that of {next(iter(parts))}; join them on one time"
                raise BadRecording(table.file, why, column=name)
        for name, values in frame.items():
            said = meaning(name)
            unit = f" [{said.unit}]" if said.unit else ""
            of_joint = name if said.joint is None else f"{said.joint}{unit}"
            if name and name not in of_time:
                whole[f"{quantity}.{of_joint if said.role else name}"] = values
    return _table((*whole,), [*whole.values()], str(folder), ())


@contextmanager
def parquet_file(path: Path, **options: Any) -> Iterator[Any]:
    """A Parquet file, opened here since PyArrow opens no path that is not UTF-8."""
    import pyarrow.parquet

    with (
        path.open("rb") as opened,
        pyarrow.parquet.ParquetFile(opened, **options) as file,
    ):
        yield file


def parquet_table(path: Path) -> Table:
    """The log in a Parquet file."""
    import pyarrow as pa

    def frames(rows: int | None, columns: Sequence[str] | None) -> Iterator[Frame]:
        # a name that is there twice cannot be asked for
        some = columns if len({*names}) == len(names) else None
        wanted = None if some is None else [name for name in names if name in some]
        try:
            with parquet_file(
                path,
                pre_buffer=False,
                buffer_size=_BUFFER,
                page_checksum_verification=True,
            ) as file:
                if rows is None:
                    kept = len(names if wanted is None else wanted)
                    refuse_size(8 * file.metadata.num_rows * kept)
                    yield frame(file.read(columns=wanted, use_threads=False))
                    return
                for batch in file.iter_batches(
                    rows, columns=wanted, use_threads=False
                ):
                    yield frame(batch)
        except (pa.ArrowException, OSError, ValueError) as error:
            raise unreadable(path, error) from None

    def frame(table: Any) -> Frame:
        pairs = zip(keys_of(table.schema.names), table.columns, strict=True)
        return {key: column(values) for key, values in pairs}

    def column(values: Any) -> Cells:
        plain = pa.types.is_integer(values.type) or pa.types.is_floating(
            values.type
        )
        if values.null_count or not plain:
            return cells(values.to_pandas())
        whole = (
            values.combine_chunks()
            if isinstance(values, pa.ChunkedArray)
            else values
        )
        return np.from_dlpack(whole)  # to_numpy would import pandas

    with parquet_file(path) as file:
        schema = file.schema_arrow
        names = tuple(schema.names)
        lists = any(map(pa.types.is_list, schema.types))
        if lists:
            about = file.metadata
            groups = map(about.row_group, range(about.num_row_groups))
            refuse_size(sum(group.total_byte_size for group in groups))
            whole = file.read().to_pandas()
    if lists:
        arrays = {name: _stacked(whole[name].tolist()) for name in whole}
        return _table_of_arrays(arrays, path)
    return Table(str(path), names, frames)


def json_table(path: Path) -> Table:
    """The log in a JSON file: a record in each line, a list of records, or lists by name.

    Entries beside a list of records are left out. Fields of records become ``record.field``,
    elements of lists ``name[0]``, ``name[1]``, ...
    """
    with opened(path) as stream:
        text = stream.read(MOST // _PER_NUMBER + 1)
    refuse_size(len(text) * _PER_NUMBER)
    try:
        content = parsed_json(text)
    except ValueError:
        content = [parsed_json(line) for line in text.splitlines() if line.strip()]
    if isinstance(content, dict):
        lists = [x for x in content.values() if _are_records(x)]
        if len(lists) != 1:
            return _table_of_arrays(_flattened(content), path)
        [content] = lists
    records = [dict(_fields(record)) for record in content]
    for row, record in enumerate(records):
        if missing := [name for name in records[0] if name not in record]:
            why = "is missing; write it, or null"
            raise BadRecording(path, why, row=row, column=missing[0])
    arrays = {
        name: _stacked([record[name] for record in records]) for name in records[0]
    }
    return _table_of_arrays(arrays, path)


def _are_records(content: object) -> bool:
    return (
        isinstance(content, list)
        and len(content) > 1
        and all(isinstance(record, Mapping) for record in content)
    )


def _fields(record: Any, before: str = "") -> Iterator[tuple[str, Any]]:
    """Names and values of a record, those of records in it after their name and a point."""
    for name, value in record.items():
        if isinstance(value, Mapping):
            yield from _fields(value, f"{before}{name}.")
        else:
            yield f"{before}{name}", value


def _stacked(rows: Sequence[Any]) -> Any:
    """One array of what is in rows, nothing as NaN; ValueError where lists differ in length."""
    return np.array([np.nan if row is None else row for row in rows])


def npz_table(path: Path) -> Table:
    """The log in an NPZ file; an array ``q`` of shape (n, nv) becomes ``q[0]``, ``q[1]``, ..."""
    return _table_of_arrays(read_arrays(path), path)


def mat_table(path: Path) -> Table:
    """The log in a MAT file of version 4 to 7.2; fields of structs become ``struct.field``."""
    with path.open("rb") as stream:
        start = stream.read(520)
    if _HDF5 in (start[:8], start[512:520]) or start.startswith(b"MATLAB 7.3"):
        why = "is a MAT file of version 7.3 (HDF5); save it with save(..., '-v7') in MATLAB"
        raise BadRecording(path, why)
    refuse_size(size := _mat_bytes(path))
    return _table_of_arrays(_flattened(mat.loaded(path, size)), path)


def _mat_bytes(path: Path) -> int:
    """Bytes of a MAT file once its compressed variables are unpacked, counted up to `MOST`."""
    with path.open("rb") as stream:
        head = stream.read(128)
        # version 4 compresses nothing
        if len(head) < 128 or head[126:128] not in (
            b"IM",
            b"MI",
        ):
            return path.stat().st_size
        tag = struct.Struct("<II" if head[126:128] == b"IM" else ">II")
        size = 0
        while len(start := stream.read(tag.size)) == tag.size and size <= MOST:
            kind, length = tag.unpack(start)
            if kind != _COMPRESSED:
                size += length
                stream.seek(length, 1)
                continue
            unpacker = zlib.decompressobj()
            left = length
            while (
                left > 0
                and size <= MOST
                and (packed := stream.read(min(left, _PIECE)))
            ):
                left -= len(packed)
                while packed and size <= MOST:
                    size += len(unpacker.decompress(packed, _PIECE))
                    packed = unpacker.unconsumed_tail
    return size


def _flattened(content: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    arrays: dict[str, Any] = {}
    for name, value in content.items():
        if isinstance(value, Mapping):
            arrays |= _flattened(value, f"{before}{name}.")
        elif (
            isinstance(value, list | np.ndarray)
            and len(value)
            and isinstance(value[0], Mapping)
        ):
            for k, part in enumerate(value, start=1):
                arrays |= _flattened(part, f"{before}{name}({k}).")
        elif not name.startswith("__"):
            arrays[f"{before}{name}"] = np.asarray(value)
    return arrays


def _table_of_arrays(arrays: Mapping[str, Any], path: Path) -> Table:
    """A table of arrays that have as many rows or columns as there are samples."""
    numbers = {
        name: array[:, None] if array.ndim == 1 else array
        for name, array in arrays.items()
        if array.dtype.kind in "fiuM" and array.ndim in (1, 2) and array.size
    }
    meanings = {name: meaning(name) for name in arrays}
    for name, array in arrays.items():
        telling = meanings[name].role and not meanings[name].words
        if name not in numbers and array.size > 1 and telling:
            kind = {"S": "bytes", "U": "text"}.get(
                array.dtype.kind, str(array.dtype)
            )
            why = f"holds {kind} instead of numbers; save it as numbers, in rows or columns"
            raise BadRecording(path, why, column=name)
    if not numbers:
        raise BadRecording(path, "holds no array of numbers; give t, q and tau")
    timed = [name for name in numbers if meanings[name].role == "t"]
    times = [numbers[name] for name in timed if 1 in numbers[name].shape]
    lengths = Counter(max(array.shape) for array in numbers.values())
    n = times[0].size if len(times) == 1 else lengths.most_common(1)[0][0]
    columns: dict[str, Any] = {}
    others = []
    for name, array in numbers.items():
        m = meanings[name]
        if array.shape == (n, n) and n > 1:
            why = f"is {n} × {n}: rows or columns could be samples"
            raise BadRecording(path, why, column=name)
        if n in array.shape:
            rows = array if n == array.shape[0] else array.T
            width = rows.shape[1]
            for k, column in enumerate(rows.T):
                columns[f"{name}[{k}]" if width > 1 else name] = column
        elif m.role in ("q", "tau", "i") and not m.words and not m.commanded:
            shape = " × ".join(map(str, array.shape))
            why = (
                f"is {shape}, but there are {n} samples; save arrays of one length"
            )
            raise BadRecording(path, why, column=name)
        else:
            others.append(name)
    left_out = f"arrays of other lengths left out: {', '.join(others)}"
    notes = (left_out,) if others else ()
    table = _table((*columns,), [*columns.values()], str(path), notes)
    return replace(table, labels=_labels(arrays))


def _labels(arrays: Mapping[str, Any]) -> dict[int, str]:
    """Names of joints among arrays, alike in all rows and unlike each other; by number from 0."""
    for name, array in arrays.items():
        if array.dtype.kind == "U" and array.ndim and _NAMES.search(name):
            rows = array.reshape(-1, array.shape[-1])
            names = rows[0].tolist()
            if (rows == rows[0]).all() and len({*names}) == len(names):
                return dict(enumerate(names))
    return {}
