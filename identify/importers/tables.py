"""Tables of logs: Parquet, NPZ and MAT files, ROS bags and MCAP; their cells as numbers and time.

A bag is a table of the ``sensor_msgs/JointState`` messages on one topic.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from decimal import Decimal
from itertools import islice
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from excitant.exceptions import BadRecording
from excitant.identify.importers.arrays import MOST, read_arrays, refuse_size
from excitant.identify.importers.names import Unit, factor, meaning
from excitant.robots.motion import Array

Frames = Callable[[int | None, Sequence[str] | None], Iterator[pd.DataFrame]]
ISO = "ISO 8601"

_BUFFER = 1 << 18  # bytes of a Parquet column at a time: row groups may be larger than memory
_PIECE = 1 << 20  # bytes unpacked at a time
_BYTES = {"double": 8, "single": 4} | {f"{u}int{8 * k}": k for u in ("", "u") for k in (1, 2, 4, 8)}
_COMPRESSED = 15  # type of an element of a MAT file
_ROS1 = b"#ROSBAG V2.0"
_HDF5 = b"\x89HDF\r\n\x1a\n"
_MESSAGE = "sensor_msgs/msg/JointState"
_USUAL = "/joint_states"
_AT_ONCE = 20_000  # messages turned into a table at a time
_SECONDS_SINCE_1970 = (0.95e9, 4.2e9)  # the years 2000 to 2103
_SCALES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_FAR_APART = 0.5  # s: no motion of an arm shows in samples so rare


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
    """The log in a Parquet file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    def frames(rows: int | None, columns: Sequence[str] | None) -> Iterator[pd.DataFrame]:
        wanted = None if columns is None else [name for name in names if name in columns]
        try:
            with pq.ParquetFile(
                path, pre_buffer=False, buffer_size=_BUFFER, page_checksum_verification=True
            ) as file:
                if rows is None:
                    kept = len(names) if wanted is None else len(wanted)
                    refuse_size(8 * file.metadata.num_rows * kept)
                    yield framed(file.read(columns=wanted, use_threads=False))
                    return
                for batch in file.iter_batches(rows, columns=wanted, use_threads=False):
                    yield framed(batch)
        except (pa.ArrowException, OSError, ValueError) as error:
            raise unreadable(path, error) from None

    def framed(table: Any) -> pd.DataFrame:
        columns = [pd.Series(each.to_pandas()) for each in table.columns]
        frame = pd.concat(columns, axis=1) if columns else pd.DataFrame()
        return frame.set_axis(table.schema.names, axis=1)

    names = tuple(pq.read_schema(path).names)
    return Table(str(path), names, frames)


def npz_table(path: Path) -> Table:
    """The log in an NPZ file; an array ``q`` of shape (n, nv) becomes ``q[0]``, ``q[1]``, ..."""
    return _table_of_arrays(read_arrays(path), path)


def mat_table(path: Path) -> Table:
    """The log in a MAT file of version 4 to 7.2; fields of structs become ``struct.field``."""
    import scipy.io

    with path.open("rb") as stream:
        start = stream.read(520)
    if _HDF5 in (start[:8], start[512:520]) or start.startswith(b"MATLAB 7.3"):
        why = "is a MAT file of version 7.3 (HDF5); save it with save(..., '-v7') in MATLAB"
        raise BadRecording(path, why)
    held = [(n, math.prod(shape), kind) for n, shape, kind in scipy.io.whosmat(path)]
    refuse_size(sum(count * _BYTES.get(kind, 0) for _, count, kind in held))
    refuse_size(size := _mat_bytes(path))
    for name, count, kind in held:
        if kind in _BYTES and count > size:
            raise ValueError(f"{name} is shorter than its header says")
    return _table_of_arrays(_flattened(scipy.io.loadmat(path, simplify_cells=True)), path)


def _mat_bytes(path: Path) -> int:
    """Bytes of a MAT file once its compressed variables are unpacked, counted up to `MOST`."""
    with path.open("rb") as stream:
        head = stream.read(128)
        if len(head) < 128 or head[126:128] not in (b"IM", b"MI"):  # version 4 compresses nothing
            return path.stat().st_size
        tag, size = struct.Struct("<II" if head[126:128] == b"IM" else ">II"), 0
        while len(start := stream.read(tag.size)) == tag.size and size <= MOST:
            kind, length = tag.unpack(start)
            if kind != _COMPRESSED:
                size += length
                stream.seek(length, 1)
                continue
            unpacker, left = zlib.decompressobj(), length
            while left > 0 and size <= MOST and (packed := stream.read(min(left, _PIECE))):
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
        elif not name.startswith("__"):
            arrays[f"{before}{name}"] = np.asarray(value)
    return arrays


def _table_of_arrays(arrays: Mapping[str, Any], path: Path) -> Table:
    numbers = {
        name: array[:, None] if array.ndim == 1 else array
        for name, array in arrays.items()
        if array.dtype.kind in "fiuM" and array.ndim in (1, 2) and array.size
    }
    for name, array in arrays.items():
        means = meaning(name)
        if name not in numbers and array.size > 1 and means.role and not means.words:
            kind = {"S": "bytes", "U": "text"}.get(array.dtype.kind, str(array.dtype))
            why = f"holds {kind} instead of numbers; save it as numbers, in rows or columns"
            raise BadRecording(path, why, column=name)
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
    if path.suffix == ".bag" and path.is_file():  # whose reader searches all of any other file
        with path.open("rb") as stream:
            if stream.read(len(_ROS1)) != _ROS1:
                raise BadRecording(path, "cannot be read (it is no bag of ROS 1); record it again")
    with _opened(path) as reader:
        topic, notes = _topic(reader, topic, path)
        cells = _cells_of_messages(reader, topic, path)
        blocks = iter(lambda: list(islice(cells, _AT_ONCE)), [])
        parts = [pd.DataFrame(block) for block in blocks]
    log = pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=["", "stamp_ns"])
    joints = dict.fromkeys(name.rpartition(".")[0] for name in log.columns[2:])
    if not joints:
        raise BadRecording(path, f"no message on {topic} names a joint; record {_USUAL}")
    if not log["stamp_ns"].any():
        notes += ("time: headers hold none, so it is that of recording",)
        log["stamp_ns"] = log[""]
    table = table_of_frame(log.drop(columns=""), str(path), notes)

    def frames(rows: int | None, columns: Sequence[str] | None) -> Iterator[pd.DataFrame]:
        for part in table.frames(rows, columns):
            kept = part.drop(columns="stamp_ns").notna().any(axis=1)
            yield part[kept].reset_index(drop=True)

    return replace(table, frames=frames, labels=dict(enumerate(joints)), joined=True)


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
    measured = [topic for topic in topics if not meaning(topic).commanded]
    some = ", ".join(topics)
    if wanted is not None and wanted in topics:
        return wanted, ()
    if wanted is not None:
        why = f"has no joint states on {wanted}; topics with them: {some or 'none'}"
    elif not topics:
        kinds = ", ".join(sorted({str(c.msgtype) for c in reader.connections})[:8]) or "nothing"
        why = f"holds no {_MESSAGE}, only {kinds}; record {_USUAL}"
    elif len(measured) == 1 or _USUAL in measured:
        chosen = measured[0] if len(measured) == 1 else _USUAL
        return chosen, (f"topic: {chosen}",) if len(topics) > 1 else ()
    else:
        advice = f"say which in a file for --map, such as {{topic: {topics[0]}}}"
        why = f"joint states are on {some}: {advice}"
    raise BadRecording(path, why)


def _cells_of_messages(reader: Any, topic: str, path: Path) -> Iterator[dict[str, Any]]:
    """Time of recording and of the header [ns], and values by column, of each message."""
    wanted = [c for c in reader.connections if c.topic == topic and c.msgtype == _MESSAGE]
    for row, (connection, logged, data) in enumerate(reader.messages(wanted)):
        message = reader.deserialize(data, connection.msgtype)
        joints, stamp = message.name, message.header.stamp
        if len(set(joints)) < len(joints):
            raise BadRecording(path, "names a joint twice; repair the recorder", row=row)
        cells = {"": logged, "stamp_ns": int(stamp.sec * 1_000_000_000 + stamp.nanosec)}
        for what in ("position", "velocity", "effort"):
            numbers = getattr(message, what)
            if len(numbers) not in (0, len(joints)):
                why = f"{len(numbers)} values of {what} for {len(joints)} joints"
                raise BadRecording(path, why, row=row)
            cells |= {f"{j}.{what}": value for j, value in zip(joints, numbers, strict=False)}
        yield cells


def as_numbers(values: pd.Series) -> Array:
    """Numbers of a column; NaN for text, dates, truth values and where there is nothing."""
    kinds = pd.api.types
    others = (kinds.is_bool_dtype, kinds.is_complex_dtype, kinds.is_timedelta64_dtype, _is_date)
    if any(is_other(values) for is_other in others):
        return np.full(len(values), np.nan)
    if not kinds.is_numeric_dtype(values) and not isinstance(values.dtype, pd.StringDtype):
        real = (str, Real, Decimal)
        plain = [isinstance(v, real) and not isinstance(v, bool | np.bool_) for v in values]
        values = values.astype(object).where(np.array(plain, bool), None)
    numbers = pd.to_numeric(values, errors="coerce")
    return np.asarray(numbers.to_numpy(float, na_value=np.nan))


def stamps_unit(values: pd.Series) -> tuple[str | None, str]:
    """The unit of time that numbers show, None where it is seconds, and what they are.

    Stamps of the years 2000 to 2103 are in the one unit in which they lie there. Other numbers are
    in the largest in which two samples are less than half a second apart; every step exactly 1 may
    count samples, and stays.
    """
    if _is_date(values):
        return ISO, "dates"
    if pd.api.types.is_timedelta64_dtype(values):
        return None, ""
    numbers = as_numbers(values)
    numbers = numbers[np.isfinite(numbers)]
    if not len(numbers):
        return (ISO, "dates") if _dates(values).notna().any() else (None, "")
    with np.errstate(over="ignore"):
        steps, (low, high) = np.diff(numbers), _SECONDS_SINCE_1970
    middle, forward = float(np.median(numbers)), steps[(steps > 0) & (steps != 1)]
    step = float(np.median(forward)) if 2 * len(forward) > len(steps) else 0.0
    short = {unit: s for unit, s in _SCALES.items() if step * s < _FAR_APART}
    since = [unit for unit, s in short.items() if low <= middle * s <= high]
    unit = next(iter(since or short), "s")
    if unit == "s":
        return None, ""
    if since:
        return unit, f"stamps since 1970 [{unit}]"
    return unit, f"[{unit}], for as seconds its samples would be {step:.4g} s apart"


def in_seconds(values: pd.Series, unit: Unit | None) -> tuple[Array, Array]:
    """Whole and remaining seconds of stamps, so that nanoseconds since 1970 keep their digits.

    ``unit`` is `ISO` for dates, or seconds per logged unit; cells that are no time become NaN.
    """
    dated, lasting = unit == ISO or _is_date(values), pd.api.types.is_timedelta64_dtype(values)
    if dated or lasting:
        values = _dates(values) if dated else values
        kind: Any = "datetime64[{}, UTC]" if dated else "timedelta64[{}]"
        try:
            stamps, per_second = values.astype(kind.format("ns")), 1_000_000_000
        except (pd.errors.OutOfBoundsDatetime, pd.errors.OutOfBoundsTimedelta, OverflowError):
            stamps, per_second = values.astype(kind.format("us")), 1_000_000
        ticks, bad = stamps.astype("int64").to_numpy(), values.isna().to_numpy()
    else:
        scale = (factor("t", unit) or 1.0) if isinstance(unit, str) else unit or 1.0
        whole = pd.api.types.is_integer_dtype(values) and not values.isna().any()
        if not whole or scale not in (1e-3, 1e-6, 1e-9):
            with np.errstate(over="ignore", invalid="ignore"):
                return as_numbers(values) * scale, np.zeros(len(values))
        ticks, per_second, bad = values.to_numpy(), round(1 / scale), np.zeros(len(values), bool)
    seconds = np.where(bad, np.nan, ticks // per_second)
    return seconds, (ticks % per_second).astype(float) / per_second


def _is_date(values: pd.Series) -> bool:
    return bool(pd.api.types.is_datetime64_any_dtype(values))


def _dates(values: pd.Series) -> pd.Series:
    if _is_date(values):
        return pd.to_datetime(values, utc=True)
    return pd.to_datetime(values.astype(str), format="ISO8601", errors="coerce", utc=True)
