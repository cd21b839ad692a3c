"""Tables to corrupt, and recordings of a motion that is known exactly."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from known_arms import smooth_motion

from excitant.identify import Recording
from excitant.robots import Motion, Robot, torque


@pytest.fixture
def table() -> pd.DataFrame:
    """Three seconds of two joints, valid."""
    t = np.arange(300) / 100.0
    columns = {"t": t}
    for k in (1, 2):
        columns[f"q{k}"] = np.sin(k * t)
        columns[f"tau{k}"] = 3 * np.cos(2 * k * t) + k
    return pd.DataFrame(columns)


@pytest.fixture(scope="session")
def motion_of() -> Callable[..., Motion]:
    return smooth_motion


@pytest.fixture(scope="session")
def exact() -> Callable[..., Recording]:
    """``exact(robot, t)``: torque of the robot's own model on a smooth motion, no noise."""

    def recorded(robot: Robot, t: np.ndarray, seed: int = 0) -> Recording:
        motion = smooth_motion(robot, t, seed)
        return Recording("exact", "exact.csv", t, motion.q, torque(robot, motion))

    return recorded


def joint_states(
    path: Path,
    kind: str,
    names: Sequence[str],
    t: np.ndarray,
    channels: Sequence[np.ndarray],
    *,
    topics: Sequence[str] = ("/joint_states",),
    hand: bool = False,
) -> None:
    """A bag (``bag``, ``mcap`` or ``db3``) with position, velocity and effort of joints.

    Stamps count from 2023, or are zero in headers where time is negative. With ``hand``, messages
    of another node go to the same topics.
    """
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    ros1 = kind == "bag"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    state, header, time = (
        store.types[name]
        for name in (
            "sensor_msgs/msg/JointState",
            "std_msgs/msg/Header",
            "builtin_interfaces/msg/Time",
        )
    )
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    with Writer1(path) if ros1 else Writer2(path, version=9, storage_plugin=plugin) as writer:
        connections = [
            writer.add_connection(topic, state.__msgtype__, typestore=store) for topic in topics
        ]
        for k, seconds in enumerate(t):
            ns = 1_700_000_000 * 10**9 + round(abs(seconds) * 1e9)
            stamp = time(sec=ns // 10**9, nanosec=ns % 10**9) if seconds >= 0 else time(0, 0)
            more = {"seq": k} if ros1 else {}
            head = header(stamp=stamp, frame_id="", **more)
            values = [np.ascontiguousarray(x[k] if len(x) else []) for x in channels]
            messages = [state(head, list(names), *values)]
            messages += [state(head, ["finger"], *[np.array([0.2])] * 3)] if hand else []
            for connection in connections:
                for later, message in enumerate(messages):
                    writer.write(connection, ns + 10 * later, serialize(message, state.__msgtype__))


@pytest.fixture(scope="session")
def write_joint_states() -> Callable[..., None]:
    return joint_states
