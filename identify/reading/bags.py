"""ROS bags and MCAP: joint states as a table, and the arm that a bag describes."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import islice
from os.path import isfile
from pathlib import Path
from typing import Any

import numpy as np

from excitant.exceptions import BadRecording
from excitant.identify.reading.cells import Frame, as_numbers
from excitant.identify.reading.names import meaning
from excitant.identify.reading.tables import Table, table_of_frame, unreadable
from excitant.robots.schema import parsed_yaml

SUFFIXES = (".bag", ".mcap", ".db3")
_ROS1 = b"#ROSBAG V2.0"
_STATE = "sensor_msgs/msg/JointState"
_TEXT = "std_msgs/msg/String"
_USUAL = "/joint_states"
_AT_ONCE = 20_000  # messages turned into a table at a time
_FEW = 100  # messages that show which joints a bag has states of


def is_bag(path: Path) -> bool:
    """Whether a path is a bag: a file of that kind, or the folder of a ROS 2 bag."""
    return path.suffix.lower() in SUFFIXES or isfile(path / "metadata.yaml")


@dataclass(frozen=True)
class Described:
    """What a bag says of the arm whose states it holds."""

    urdf: str
    # by joint, as in a joint_limits.yaml of MoveIt
    limits: Mapping[str, Mapping[str, Any]]
    joints: tuple[str, ...]  # of which it holds states


def described(path: Path) -> Described | None:
    """The arm that a bag describes on topics of these names; None without.

    ``robot_description`` is the text of a URDF, ``joint_limits`` that of a ``joint_limits.yaml``.

    Raises:
        BadRecording: Not readable.
    """
    joints = dict[str, None]()
    with _opened(path) as reader:
        states = [c for c in reader.connections if c.msgtype == _STATE]
        for _, state in islice(_messages(reader, states), _FEW):
            joints |= dict.fromkeys(state.name)
        texts = [c for c in reader.connections if c.msgtype == _TEXT]
        described_by = {
            topic: text.data for topic, text in _messages(reader, texts)
        }
        limits = parsed_yaml(described_by.get("joint_limits", "{}")).get(
            "joint_limits", {}
        )
    urdf = described_by.get("robot_description")
    return None if urdf is None else Described(urdf, limits, tuple(joints))


def _messages(reader: Any, wanted: Sequence[Any]) -> Iterator[tuple[str, Any]]:
    """Last words of topics, and messages on them."""
    for connection, _, data in reader.messages(wanted) if wanted else ():
        yield (
            connection.topic.rpartition("/")[2],
            reader.deserialize(data, connection.msgtype),
        )


def bag_table(path: Path, topic: str | None = None) -> Table:
    """The joint states in a bag, in columns ``stamp_ns`` and ``joint.position`` (velocity, effort).

    Time is that of the messages' headers, or that of their recording where headers are empty.
    Messages without any of the joints asked for, such as those of a gripper, are left out.
    ``topic`` is needed where the bag has several.

    Raises:
        BadRecording: Not readable, no joint states, or several topics with them.
    """
    if path.suffix == ".bag" and isfile(path):
        # whose reader searches all of any other file
        with path.open("rb") as stream:
            if stream.read(len(_ROS1)) != _ROS1:
                why = "cannot be read (it is no bag of ROS 1); record it again"
                raise BadRecording(path, why)
    import pandas as pd

    with _opened(path) as reader:
        topic, notes = _topic(reader, topic, path)
        cells = _cells_of_messages(reader, topic, path)
        blocks = iter(lambda: list(islice(cells, _AT_ONCE)), [])
        parts = [pd.DataFrame(columns=["", "stamp_ns"]), *map(pd.DataFrame, blocks)]
    log = pd.concat(parts[1:] or parts, ignore_index=True)
    joints = dict.fromkeys(name.rpartition(".")[0] for name in log.columns[2:])
    if not joints:
        why = f"no message on {topic} names a joint; record {_USUAL}"
        raise BadRecording(path, why)
    if not log["stamp_ns"].any():
        notes += ("time: headers hold none, so it is that of recording",)
        log["stamp_ns"] = log[""]
    table = table_of_frame(log.drop(columns=""), str(path), notes)

    def frames(rows: int | None, columns: Sequence[str] | None) -> Iterator[Frame]:
        for part in table.frames(rows, columns):
            values = [
                as_numbers(x) for name, x in part.items() if name != "stamp_ns"
            ]
            of_arm = np.any(~np.isnan(values), axis=0)
            yield {name: x[of_arm] for name, x in part.items()}

    return replace(
        table, frames=frames, labels=dict(enumerate(joints)), joined=True
    )


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    try:
        with AnyReader(
            [path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)
        ) as reader:
            yield reader
    except (BadRecording, GeneratorExit):
        raise
    except Exception as error:  # damaged bags make the reader raise anything
        raise unreadable(path, error) from None


def _topic(
    reader: Any, wanted: str | None, path: Path
) -> tuple[str, tuple[str, ...]]:
    """The topic of the arm's states, and a note where there was a choice."""
    topics = sorted({c.topic for c in reader.connections if c.msgtype == _STATE})
    names = ", ".join(topics)
    if wanted is not None:
        if wanted in topics:
            return wanted, ()
        why = (
            f"has no joint states on {wanted}; topics with them: {names or 'none'}"
        )
        raise BadRecording(path, why)
    if not topics:
        kinds = sorted({str(c.msgtype) for c in reader.connections})
        others = ", ".join(kinds[:8]) or "nothing"
        why = f"holds no {_STATE}, only {others}; record {_USUAL}"
        raise BadRecording(path, why)
    measured = [topic for topic in topics if not meaning(topic).commanded]
    if len(measured) == 1 or _USUAL in measured:
        chosen = measured[0] if len(measured) == 1 else _USUAL
        return chosen, (f"topic: {chosen}",) if len(topics) > 1 else ()
    advice = f"say which in a file for --map, such as {{topic: {topics[0]}}}"
    raise BadRecording(path, f"joint states are on {names}: {advice}")


def _cells_of_messages(
    reader: Any, topic: str, path: Path
) -> Iterator[dict[str, Any]]:
    """Time of recording and of the header [ns], and values by column, of each message."""
    wanted = [
        c for c in reader.connections if c.topic == topic and c.msgtype == _STATE
    ]
    for row, (connection, logged, data) in enumerate(reader.messages(wanted)):
        message = reader.deserialize(data, connection.msgtype)
        joints = message.name
        stamp = message.header.stamp
        if len(set(joints)) < len(joints):
            raise BadRecording(
                path, "names a joint twice; repair the recorder", row=row
            )
        cells = {
            "": logged,
            "stamp_ns": int(stamp.sec * 1_000_000_000 + stamp.nanosec),
        }
        for what in ("position", "velocity", "effort"):
            numbers = getattr(message, what)
            if len(numbers) not in (0, len(joints)):
                why = f"{len(numbers)} values of {what} for {len(joints)} joints"
                raise BadRecording(path, why, row=row)
            cells |= {
                f"{j}.{what}": value
                for j, value in zip(joints, numbers, strict=False)
            }
        yield cells
