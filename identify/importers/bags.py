"""ROS 1 and ROS 2 bags and MCAP files with ``sensor_msgs/JointState``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from excitant.exceptions import BadRecording
from excitant.identify.importers.names import meaning
from excitant.identify.importers.sources import Source, unreadable

_MESSAGE = "sensor_msgs/msg/JointState"
_USUAL = "/joint_states"
_FIELDS = ("position", "velocity", "effort")
_LOOKED_AT = 500  # messages, of which several nodes may write to one topic
_AT_ONCE = 20_000  # messages turned into a table at a time


@dataclass(frozen=True)
class _Layout:
    """What the messages of a topic hold."""

    topic: str
    joints: tuple[str, ...]
    fields: tuple[str, ...]
    stamped: bool

    @property
    def names(self) -> tuple[str, ...]:
        pairs = [f"{joint}.{field}" for field in self.fields for joint in self.joints]
        return ("stamp_ns", *pairs)


def bag_source(path: Path, topic: str | None = None) -> Source:
    """The joint states in a bag: columns ``stamp_ns`` and ``joint.position``, ``.velocity``,
    ``.effort``.

    Time is that of the messages' headers, or that of their recording where headers are empty.
    Messages without any of the joints asked for, such as those of a gripper, are left out.

    Args:
        path: ``.bag``, ``.mcap``, ``.db3``, or the folder of a ROS 2 bag.
        topic: Topic, where the bag has several.

    Raises:
        BadRecording: Not readable, no joint states, or several topics with them.
    """  # noqa: D205
    with _opened(path) as reader:
        chosen, notes = _topic(reader, topic, path)
        layout = _layout(reader, chosen, path)
    if not layout.stamped:
        notes += ("time: headers hold none, so it is that of recording",)

    def frames(rows: int | None, columns: Sequence[str] | None) -> Iterator[pd.DataFrame]:
        kept = layout.names if columns is None else tuple(columns)
        parts: list[pd.DataFrame] = []
        with _opened(path) as reader:
            for part in _tables(reader, layout, kept, rows or _AT_ONCE, path):
                if rows is not None:
                    yield part
                else:
                    parts.append(part)
        if rows is None:
            yield pd.concat(parts, ignore_index=True) if parts else _table([], kept)

    labels = dict(enumerate(layout.joints))
    return Source(str(path), layout.names, frames, labels, notes, joined=True)


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


def _layout(reader: Any, topic: str, path: Path) -> _Layout:
    joints: dict[str, None] = {}
    fields: dict[str, None] = {}
    stamped = False
    for _, message in islice(_messages(reader, topic), _LOOKED_AT):
        joints |= dict.fromkeys(map(str, message.name))
        fields |= {f: None for f in _FIELDS if len(message.name) == len(getattr(message, f))}
        stamped |= bool(message.header.stamp.sec or message.header.stamp.nanosec)
    if not joints:
        raise BadRecording(path, f"no message on {topic} names a joint; record {_USUAL}")
    ordered = tuple(field for field in _FIELDS if field in fields)
    return _Layout(topic, tuple(joints), ordered, stamped)


def _tables(
    reader: Any, layout: _Layout, columns: Sequence[str], rows: int, path: Path
) -> Iterator[pd.DataFrame]:
    """Tables of at most so many rows, in the order of recording."""
    places = {name: k for k, name in enumerate(columns)}
    some: list[Any] = []
    row = 0
    for logged, message in _messages(reader, layout.topic):
        values = _row(message, logged, layout, places, row, path)
        if values is None:
            continue
        some.append(values)
        row += 1
        if len(some) == rows:
            yield _table(some, columns)
            some = []
    if some:
        yield _table(some, columns)


def _row(
    message: Any, logged: int, layout: _Layout, places: dict[str, int], row: int, path: Path
) -> tuple[int, Any] | None:
    """Stamp and values of a message; None when it holds nothing that is asked for."""
    values = np.full(len(places), np.nan)
    found = False
    if len(set(message.name)) < len(message.name):
        raise BadRecording(path, "names a joint twice; repair the recorder", row=row)
    for field in layout.fields:
        numbers = getattr(message, field)
        if len(numbers) not in (0, len(message.name)):
            raise BadRecording(
                path, f"{len(numbers)} values of {field} for {len(message.name)} joints", row=row
            )
        for joint, value in zip(message.name, numbers, strict=False):
            place = places.get(f"{joint}.{field}")
            if place is not None:
                values[place], found = value, True
    stamp = message.header.stamp
    time = stamp.sec * 1_000_000_000 + stamp.nanosec if layout.stamped else logged
    return (int(time), values) if found else None


def _table(rows: Sequence[tuple[int, Any]], columns: Sequence[str]) -> pd.DataFrame:
    values = np.array([values for _, values in rows]).reshape(len(rows), len(columns))
    frame = pd.DataFrame(values, columns=list(columns))
    if "stamp_ns" in columns:
        frame["stamp_ns"] = np.array([time for time, _ in rows], dtype=np.int64)
    return frame
