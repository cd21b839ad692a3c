"""ROS 1 and ROS 2 bags and MCAP files with ``sensor_msgs/JointState``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from excitant.exceptions import BadRecording
from excitant.identify.importers.names import meaning
from excitant.identify.importers.tables import Table, unreadable

_MESSAGE = "sensor_msgs/msg/JointState"
_USUAL = "/joint_states"
_FIELDS = ("position", "velocity", "effort")
_LOOKED_AT = 500  # messages, of which several nodes may write to one topic
_AT_ONCE = 20_000  # messages turned into a table at a time


def bag_table(path: Path, topic: str | None = None) -> Table:
    """The joint states in a bag, in columns ``stamp_ns`` and ``joint.position`` (velocity, effort).

    Time is that of the messages' headers, or that of their recording where headers are empty.
    Messages without any of the joints asked for, such as those of a gripper, are left out.

    Args:
        path: ``.bag``, ``.mcap``, ``.db3``, or the folder of a ROS 2 bag.
        topic: Topic, where the bag has several.

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
    names = ("stamp_ns", *(f"{joint}.{field}" for field in fields for joint in joints))

    def frames(rows: int | None, columns: Sequence[str] | None) -> Iterator[pd.DataFrame]:
        kept = names if columns is None else tuple(columns)
        parts: list[pd.DataFrame] = []
        with _opened(path) as reader:
            messages = _rows(reader, topic, fields, stamped, kept, path)
            while some := list(islice(messages, rows or _AT_ONCE)):
                if rows is not None:
                    yield _frame(some, kept)
                else:
                    parts.append(_frame(some, kept))
        if rows is None:
            yield pd.concat(parts, ignore_index=True) if parts else _frame([], kept)

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


_Row = tuple[int, Any]
"""Stamp [ns] and values of a message, shape (columns,)."""


def _rows(
    reader: Any,
    topic: str,
    fields: Sequence[str],
    stamped: bool,
    columns: Sequence[str],
    path: Path,
) -> Iterator[_Row]:
    """Messages that hold any of the columns, in the order of recording."""
    places = {name: k for k, name in enumerate(columns)}
    row = 0
    for logged, message in _messages(reader, topic):
        values = np.full(len(places), np.nan)
        found = False
        if len(set(message.name)) < len(message.name):
            raise BadRecording(path, "names a joint twice; repair the recorder", row=row)
        for field in fields:
            numbers = getattr(message, field)
            if len(numbers) not in (0, len(message.name)):
                why = f"{len(numbers)} values of {field} for {len(message.name)} joints"
                raise BadRecording(path, why, row=row)
            for joint, value in zip(message.name, numbers, strict=False):
                if (place := places.get(f"{joint}.{field}")) is not None:
                    values[place], found = value, True
        if found:
            stamp = message.header.stamp
            yield int(stamp.sec * 1_000_000_000 + stamp.nanosec if stamped else logged), values
            row += 1


def _frame(rows: Sequence[_Row], columns: Sequence[str]) -> pd.DataFrame:
    values = np.array([values for _, values in rows]).reshape(len(rows), len(columns))
    frame = pd.DataFrame(values, columns=list(columns))
    if "stamp_ns" in columns:
        frame["stamp_ns"] = np.array([time for time, _ in rows], dtype=np.int64)
    return frame
