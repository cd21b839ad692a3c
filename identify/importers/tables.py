"""Tables of logs: Parquet, NPZ and MAT files, ROS bags and MCAP; their cells as numbers and time.

A bag is a table of the ``sensor_msgs/JointState`` messages on one topic.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from decimal import Decimal
from itertools import islice
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from excitant.exceptions import BadRecording
from excitant.identify.importers.names import Unit, factor, meaning
from excitant.robots.motion import Array

Frames = Callable[[int | None, Sequence[str] | None], Iterator[pd.DataFrame]]
ISO = "ISO 8601"
_BUFFER = 1 << 18  # bytes of a Parquet column at a time: row groups may be larger than memory
_HDF5 = b"\x89HDF\r\n\x1a\n"
_MESSAGE = "sensor_msgs/msg/JointState"
_USUAL = "/joint_states"
_FIELDS = ("position", "velocity", "effort")
_LOOKED_AT = 500  # messages, of which several nodes may write to one topic
_AT_ONCE = 20_000  # messages turned into a table at a time
_SECONDS_SINCE_1970 = (0.95e9, 4.2e9)  # the years 2000 to 2103


@dataclass(frozen=True)
class Table:
    """A log that can be read whole or in pieces.

    ``frames(rows, columns)`` gives pieces of at most so many rows (one piece when None) with some
    columns (all when None); numbers that cannot be read stay text.
    """

    file: str
    names: tuple[str, ...]  # of columns, in order; a name may be there twice
    frames: Frames
    labels: Mapping[int, str] = field(default_factory=dict)  # joints' names by number, if any
    notes: tuple[str, ...] = ()
    joined: bool = False  # columns are joint.quantity; messages without any asked for are left out


def unreadable(path: str | Path, error: BaseException) -> BadRecording:
    """The refusal of a file that its reader cannot read."""
    lines = str(error).strip().splitlines()
    return BadRecording(path, f"cannot be read ({lines[0] if lines else type(error).__name__})")


def table_of_frame(frame: pd.DataFrame, file: str, notes: tuple[str, ...] = ()) -> Table:
    """A table in memory."""
    names = tuple(str(name) for name in frame.columns)

    def frames(rows: int | None, columns: Sequence[str] | None) -> Iterator[pd.DataFrame]:
        kept = [k for k, name in enumerate(names) if columns is None or name in columns]
        part = frame.iloc[:, kept].set_axis([names[k] for k in kept], axis=1)
        step = rows or max(len(part), 1)
        for start in range(0, max(len(part), 1), step):
            yield part.iloc[start : start + step]

    return Table(file, names, frames, notes=notes)


def parquet_table(path: Path) -> Table:
    """The log in a Parquet file; a column of lists becomes ``name[0]``, ``name[1]``, ..."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    kinds = (pa.types.is_list, pa.types.is_large_list, pa.types.is_fixed_size_list)
    with pq.ParquetFile(path) as file:
        schema = file.schema_arrow
        lists = [each.name for each in schema if any(is_kind(each.type) for is_kind in kinds)]
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
    columns: list[Any] = []
    for name, column in zip(table.column_names, table.columns, strict=True):
        values = column.to_pandas(ignore_metadata=True)
        if name in widths:
            lengths = values.map(lambda value: 0 if value is None else len(value))
            for row in np.flatnonzero(lengths != widths[name]):
                why = f"holds {lengths[row]} values, the first row {widths[name]}; remove it"
                raise BadRecording(path, why, row=int(row), column=name)
            values = pd.DataFrame(values.tolist(), columns=range(widths[name]))
        columns.append(values)
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

    def flattened(content: Mapping[str, Any], before: str = "") -> dict[str, Any]:
        arrays: dict[str, Any] = {}
        for name, value in content.items():
            if isinstance(value, Mapping):
                arrays |= flattened(value, f"{before}{name}.")
            elif not name.startswith("__"):
                arrays[f"{before}{name}"] = np.asarray(value)
        return arrays

    return _table_of_arrays(flattened(scipy.io.loadmat(path, simplify_cells=True)), path)


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
    columns: dict[str, Any] = {}
    others = []
    for name, array in numbers.items():
        if array.shape == (n, n) and n > 1:
            raise BadRecording(path, f"is {n} × {n}: rows or columns could be samples", column=name)
        if n not in array.shape:
            found, shape = meaning(name), " × ".join(map(str, array.shape))
            if found.role in ("q", "tau", "i") and not found.words and not found.commanded:
                why = f"is {shape}, but there are {n} samples; save arrays of one length"
                raise BadRecording(path, why, column=name)
            others.append(name)
            continue
        rows = array if n == array.shape[0] else array.T
        width = rows.shape[1]
        columns |= {f"{name}[{k}]" if width > 1 else name: rows[:, k] for k in range(width)}
    notes = (f"arrays of other lengths left out: {', '.join(others)}",) if others else ()
    return table_of_frame(pd.DataFrame(columns), str(path), notes)


def bag_table(path: Path, topic: str | None = None) -> Table:
    """The joint states in a bag, in columns ``stamp_ns`` and ``joint.position`` (velocity, effort).

    Time is that of the messages' headers, or that of their recording where headers are empty.
    Messages without any of the joints asked for, such as those of a gripper, are left out.
    ``topic`` is needed where the bag has several.

    Raises:
        BadRecording: Not readable, no joint states, or several topics with them.
    """
    with _opened(path) as reader:
        topic, notes = _topic(reader, topic, path)
        some = [message for _, message in islice(_messages(reader, topic), _LOOKED_AT)]
    joints = tuple(dict.fromkeys(str(name) for message in some for name in message.name))
    if not joints:
        raise BadRecording(path, f"no message on {topic} names a joint; record {_USUAL}")
    fields = [f for f in _FIELDS if any(len(m.name) == len(getattr(m, f)) for m in some)]
    stamped = any(m.header.stamp.sec or m.header.stamp.nanosec for m in some)
    if not stamped:
        notes += ("time: headers hold none, so it is that of recording",)
    names = ("stamp_ns", *(f"{joint}.{what}" for what in fields for joint in joints))

    def frames(rows: int | None, columns: Sequence[str] | None) -> Iterator[pd.DataFrame]:
        kept = list(names if columns is None else columns)
        with _opened(path) as reader:
            cells = _cells_of_messages(reader, topic, fields, stamped, kept, path)
            blocks = iter(lambda: list(islice(cells, rows or _AT_ONCE)), [])
            parts = (pd.DataFrame(block, columns=kept) for block in blocks)
            if rows is not None:
                yield from parts
            else:
                yield pd.concat(list(parts) or [pd.DataFrame(columns=kept)], ignore_index=True)

    return Table(str(path), names, frames, dict(enumerate(joints)), notes, joined=True)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            yield reader
    except (BadRecording, GeneratorExit):
        raise
    except Exception as error:  # damaged bags make the reader raise anything
        raise unreadable(path, error) from None


def _topic(reader: Any, wanted: str | None, path: Path) -> tuple[str, tuple[str, ...]]:
    topics = sorted({c.topic for c in reader.connections if c.msgtype == _MESSAGE})
    if wanted is not None:
        if wanted not in topics:
            some = ", ".join(topics) or "none"
            raise BadRecording(path, f"has no joint states on {wanted}; topics with them: {some}")
        return wanted, ()
    if not topics:
        kinds = ", ".join(sorted({str(c.msgtype) for c in reader.connections})[:8]) or "nothing"
        raise BadRecording(path, f"holds no {_MESSAGE}, only {kinds}; record {_USUAL}")
    measured = [topic for topic in topics if not meaning(topic).commanded]
    if len(measured) == 1 or _USUAL in measured:
        chosen = measured[0] if len(measured) == 1 else _USUAL
        return chosen, (f"topic: {chosen}",) if len(topics) > 1 else ()
    raise BadRecording(
        path,
        f"joint states are on {', '.join(topics)}: say which in a file for --map, such as "
        f"{{topic: {topics[0]}}}",
    )


def _messages(reader: Any, topic: str) -> Iterator[tuple[int, Any]]:
    wanted = [c for c in reader.connections if c.topic == topic and c.msgtype == _MESSAGE]
    for connection, logged, data in reader.messages(wanted):
        yield logged, reader.deserialize(data, connection.msgtype)


def _cells_of_messages(
    reader: Any, topic: str, fields: Sequence[str], stamped: bool, kept: Sequence[str], path: Path
) -> Iterator[dict[str, Any]]:
    """Stamp and values, by column, of messages that hold any of the columns."""
    wanted, row = frozenset(kept), 0
    for logged, message in _messages(reader, topic):
        if len(set(message.name)) < len(message.name):
            raise BadRecording(path, "names a joint twice; repair the recorder", row=row)
        found: dict[str, Any] = {}
        for what in fields:
            numbers = getattr(message, what)
            if len(numbers) not in (0, len(message.name)):
                why = f"{len(numbers)} values of {what} for {len(message.name)} joints"
                raise BadRecording(path, why, row=row)
            cells = zip((f"{joint}.{what}" for joint in message.name), numbers, strict=False)
            found |= {column: value for column, value in cells if column in wanted}
        if found:
            stamp = message.header.stamp
            at = stamp.sec * 1_000_000_000 + stamp.nanosec if stamped else logged
            yield {"stamp_ns": int(at), **found}
            row += 1


def as_numbers(values: pd.Series) -> Array:
    """Numbers of a column; NaN for text, dates, truth values and where there is nothing."""
    kinds = pd.api.types
    others = (kinds.is_bool_dtype, kinds.is_complex_dtype, kinds.is_timedelta64_dtype, _is_date)
    if any(is_other(values) for is_other in others):
        return np.full(len(values), np.nan)
    if not kinds.is_numeric_dtype(values) and not isinstance(values.dtype, pd.StringDtype):
        plain = values.astype(object).map(lambda v: v if _is_plain(v) else None)
        values = plain.astype(object)
    numbers = pd.to_numeric(values, errors="coerce")
    return np.asarray(numbers.to_numpy(float, na_value=np.nan))


def _is_plain(value: object) -> bool:
    """Whether a cell is text or a real number, and no truth value."""
    return isinstance(value, str | Real | Decimal) and not isinstance(value, bool | np.bool_)


def stamps_unit(values: pd.Series) -> str | None:
    """The unit in which numbers are stamps of the years 2000 to 2103; ranges do not meet."""
    if _is_date(values):
        return ISO
    if pd.api.types.is_timedelta64_dtype(values):
        return None
    numbers = as_numbers(values)
    numbers = numbers[np.isfinite(numbers)]
    if not len(numbers):
        return ISO if _dates(values).notna().any() else None
    middle, (low, high) = float(np.median(numbers)), _SECONDS_SINCE_1970
    scales = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
    return next((unit for unit, s in scales.items() if low <= middle * s <= high), None)


def in_seconds(values: pd.Series, unit: Unit | None) -> tuple[Array, Array]:
    """Whole and remaining seconds of stamps, so that nanoseconds since 1970 keep their digits.

    ``unit`` is `ISO` for dates, or seconds per logged unit; cells that are no time become NaN.
    """
    if unit == ISO or _is_date(values):
        dates = _dates(values)
        return _split(*_ticks(dates, "datetime64[{}, UTC]"), dates.isna().to_numpy())
    if pd.api.types.is_timedelta64_dtype(values):
        return _split(*_ticks(values, "timedelta64[{}]"), values.isna().to_numpy())
    scale = (factor("t", unit) or 1.0) if isinstance(unit, str) else unit or 1.0
    whole = pd.api.types.is_integer_dtype(values) and not values.isna().any()
    if whole and scale in (1e-3, 1e-6, 1e-9):
        return _split(values.to_numpy(), round(1 / scale), np.zeros(len(values), bool))
    numbers = as_numbers(values)
    with np.errstate(over="ignore", invalid="ignore"):
        return numbers * scale, np.zeros(len(numbers))


def _ticks(values: Any, kind: str) -> tuple[np.ndarray, int]:
    """Whole ticks of dates and how many make a second; nanoseconds where their range allows."""
    try:
        return values.astype(kind.format("ns")).astype("int64").to_numpy(), 1_000_000_000
    except (pd.errors.OutOfBoundsDatetime, pd.errors.OutOfBoundsTimedelta, OverflowError):
        return values.astype(kind.format("us")).astype("int64").to_numpy(), 1_000_000


def _split(values: np.ndarray, per_second: int, bad: np.ndarray) -> tuple[Array, Array]:
    whole = (values // per_second).astype(float)
    whole[bad] = np.nan
    return whole, (values % per_second).astype(float) / per_second


def _is_date(values: pd.Series) -> bool:
    return bool(pd.api.types.is_datetime64_any_dtype(values))


def _dates(values: pd.Series) -> pd.Series:
    if _is_date(values):
        return pd.to_datetime(values, utc=True)
    return pd.to_datetime(values.astype(str), format="ISO8601", errors="coerce", utc=True)
