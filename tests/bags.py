"""Bags of joint states, as ROS 1 and ROS 2 write them."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore


def joint_states(
    path: Path, kind: str, names: Sequence[str], t: np.ndarray, channels: Sequence[np.ndarray], *,
    topics: Sequence[str] = ("/joint_states",), hand: bool = False, other: str = "",
    texts: Mapping[str, str] | None = None,
) -> None:  # fmt: skip
    """A bag (``bag``, ``mcap`` or ``db3``) with position, velocity and effort of joints.

    Stamps count from 2023, or are zero in headers where time is negative. With ``hand``, messages
    of another node go to the same topics; with ``other``, those of another arm, whose joints begin
    with that instead of two letters. Texts go to topics of their own.
    """
    ros1 = kind == "bag"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    state = store.types["sensor_msgs/msg/JointState"]
    header, time = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    plugin = rosbag2.StoragePlugin.MCAP if kind == "mcap" else rosbag2.StoragePlugin.SQLITE3
    bag = rosbag1.Writer(path) if ros1 else rosbag2.Writer(path, version=9, storage_plugin=plugin)
    with bag as writer:
        add = partial(writer.add_connection, typestore=store)
        connections = [add(topic, msgtype=state.__msgtype__) for topic in topics]
        for topic, content in (texts or {}).items():
            text = store.types["std_msgs/msg/String"]
            link = add(f"/left/{topic}", msgtype=text.__msgtype__)
            writer.write(link, 1, serialize(text(content), text.__msgtype__))
        for k, seconds in enumerate(t):
            ns = 1_700_000_000 * 10**9 + round(abs(seconds) * 1e9)
            stamp = time(sec=ns // 10**9, nanosec=ns % 10**9) if seconds >= 0 else time(0, 0)
            head = header(stamp=stamp, frame_id="", **({"seq": k} if ros1 else {}))
            values = [np.ascontiguousarray(x[k] if len(x) else []) for x in channels]
            messages = [state(head, list(names), *values)]
            messages += [state(head, [other + n[2:] for n in names], *values)] if other else []
            messages += [state(head, ["finger"], *[np.array([0.2])] * 3)] if hand else []
            for connection in connections:
                for later, message in enumerate(messages):
                    writer.write(connection, ns + 10 * later, serialize(message, state.__msgtype__))
