"""Motions in the formats of robot controllers: ROS 2, MCAP, URScript and NPZ, and back."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml

from excitant.design.trajectory import Trajectory
from excitant.exceptions import BadInput, UnknownName
from excitant.robots import Array, Motion, Robot
from excitant.robots.motion import freeze, read_only

TOPIC = "/joint_trajectory_controller/joint_trajectory"

_MESSAGE = "trajectory_msgs/msg/JointTrajectory"
_FIELDS = ("positions", "velocities", "accelerations")
_SERVOJ = "lookahead_time=0.1, gain=300"
_FIRST = "a=0.3, v=0.2"  # rad/s² and rad/s of the move to the first pose
_JOINTS_UR = 6
_UNEVEN = 1e-6  # relative difference of sampling intervals that counts as one rate


@dataclass(frozen=True, eq=False)
class NamedMotion:
    """A motion with the names of its joints, as the formats hold it.

    Attributes:
        joints: Names of the joints.
        motion: The motion.
    """

    joints: tuple[str, ...]
    motion: Motion


def write_formats(
    motion: Motion | Trajectory,
    robot: Robot,
    names: Sequence[str],
    *,
    rate_hz: float = 100.0,
    stem: str = "trajectory",
) -> dict[str, bytes | str]:
    """Contents of files in several formats, by file name.

    Args:
        motion: Motion, or a Fourier trajectory of which one period is sampled.
        robot: Arm that gives the names of the joints.
        names: Formats: ``"ros2"`` (YAML), ``"mcap"``, ``"urscript"``, ``"npz"``.
        rate_hz: Control rate at which a Fourier trajectory is sampled [Hz].
        stem: File name before the suffix.

    Raises:
        UnknownName: A format that does not exist; suggests the nearest.
        BadInput: Another number of joints, or a motion that a format cannot hold.
    """
    for name in names:
        if name not in FORMATS:
            raise UnknownName("format", name, FORMATS)
    sampled = motion.motion(rate_hz) if isinstance(motion, Trajectory) else motion
    if sampled.nv != robot.nv:
        raise BadInput(f"motion has {sampled.nv} joints, robot {robot.name} has {robot.nv}")
    if not all(np.isfinite(x).all() for x in (sampled.t, sampled.q, sampled.dq, sampled.ddq)):
        raise BadInput("motion holds a value that is not finite")
    if len(sampled) < 2 or np.any(np.diff(sampled.t) <= 0):
        raise BadInput("motion needs at least two samples, at times that increase")
    return {stem + FORMATS[name][0]: FORMATS[name][1](sampled, robot) for name in names}


def joint_trajectory_yaml(motion: Motion, robot: Robot) -> str:
    """A ROS 2 ``trajectory_msgs/msg/JointTrajectory`` as YAML, as ``ros2 topic pub`` takes it.

    Values are exact, times rounded to 1 ns and counted from the first sample.
    """
    lines = ["header: {stamp: {sec: 0, nanosec: 0}, frame_id: ''}"]
    names = yaml.safe_dump(list(robot.joints), default_flow_style=True, width=10**9)
    lines += [f"joint_names: {names.strip()}", "points:"]
    for (sec, nanosec), values in zip(_durations(motion), _points(motion), strict=True):
        for mark, field, row in zip("-  ", _FIELDS, values, strict=True):
            lines.append(f"{mark} {field}: [{', '.join(map(_yaml_number, row))}]")
        lines += ["  effort: []", f"  time_from_start: {{sec: {sec}, nanosec: {nanosec}}}"]
    return "\n".join(lines) + "\n"


def read_joint_trajectory_yaml(text: str) -> NamedMotion:
    """The motion of a ``JointTrajectory`` in YAML.

    Raises:
        BadInput: No YAML, or not such a message.
    """
    try:
        content = yaml.load(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
        points = content["points"]
        times = [point["time_from_start"] for point in points]
        t = [d["sec"] + 1e-9 * d["nanosec"] for d in times]
        values = [[point[field] for point in points] for field in _FIELDS]
        return _named(content["joint_names"], t, values, "ROS 2 trajectory")
    except (yaml.YAMLError, KeyError, TypeError) as error:
        reason = str(error).splitlines()[0]
        raise BadInput(f"not a {_MESSAGE} in YAML ({reason})") from None


def mcap_bag(motion: Motion, robot: Robot, *, topic: str = TOPIC) -> bytes:
    """An MCAP bag with one ``trajectory_msgs/msg/JointTrajectory`` message at time 0.

    Values are exact, times rounded to 1 ns and counted from the first sample. The bag embeds
    the definition of its message and plays in every ROS 2 since Humble.
    """
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    message = _message(store.types, motion, robot)
    with TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            connection = writer.add_connection(topic, _MESSAGE, typestore=store)
            writer.write(connection, 0, store.serialize_cdr(message, _MESSAGE))
        return (bag / "bag.mcap").read_bytes()


def _message(types: Any, motion: Motion, robot: Robot) -> Any:
    point = types["trajectory_msgs/msg/JointTrajectoryPoint"]
    duration = types["builtin_interfaces/msg/Duration"]
    stamp = types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    points = [
        point(
            **{field: np.array(row) for field, row in zip(_FIELDS, values, strict=True)},
            effort=np.zeros(0),
            time_from_start=duration(sec=sec, nanosec=nanosec),
        )
        for (sec, nanosec), values in zip(_durations(motion), _points(motion), strict=True)
    ]
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
    return types[_MESSAGE](header=header, joint_names=list(robot.joints), points=points)


def read_mcap_bag(content: bytes) -> NamedMotion:
    """The motion of the first ``JointTrajectory`` message in an MCAP bag.

    Raises:
        BadInput: No MCAP, or no such message in it.
    """
    from rosbags.highlevel import AnyReader, AnyReaderError

    with TemporaryDirectory() as folder:
        path = Path(folder) / "bag.mcap"
        path.write_bytes(content)
        try:
            with AnyReader([path]) as reader:
                wanted = [c for c in reader.connections if c.msgtype == _MESSAGE]
                message: Any = next(
                    (reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages(wanted)),
                    None,
                )
        except AnyReaderError as error:
            raise BadInput(f"not a readable MCAP bag ({error})") from None
    if not wanted or message is None:
        raise BadInput(f"no {_MESSAGE} message in the MCAP bag")
    times = [point.time_from_start for point in message.points]
    values = [[getattr(point, field) for point in message.points] for field in _FIELDS]
    return _named(
        message.joint_names, [d.sec + 1e-9 * d.nanosec for d in times], values, "MCAP bag"
    )


def urscript(motion: Motion, robot: Robot) -> str:
    """A URScript program that servoes through the positions at the control rate.

    It first goes to the first pose by a slow ``movej``, and ends with ``stopj``. The program
    holds positions only, with 12 digits; the controller derives the speed.

    Raises:
        BadInput: Not six turning joints, or samples that are not equidistant.
    """
    if robot.nv != _JOINTS_UR or not robot.revolute.all():
        raise BadInput(
            f"URScript moves arms with six turning joints, {robot.name} has {robot.nv} joints"
        )
    intervals = np.diff(motion.t)
    dt = float((motion.t[-1] - motion.t[0]) / len(intervals))
    if np.abs(intervals / dt - 1).max() > _UNEVEN:
        raise BadInput("URScript needs equidistant samples; resample the motion at one rate")
    poses = [f"[{', '.join(f'{x:.12f}' for x in row)}]" for row in motion.q]
    lines = [
        "def excitant_motion():",
        f"  # {len(poses)} poses of {', '.join(robot.joints)} [rad], every {dt:.9g} s",
        f"  movej({poses[0]}, {_FIRST})",
        *(f"  servoj({pose}, t={dt:.12g}, {_SERVOJ})" for pose in poses),
        "  stopj(2.0)",
        "end",
        "excitant_motion()",
    ]
    return "\n".join(lines) + "\n"


@dataclass(frozen=True, eq=False)
class ServoProgram:
    """What a program of `urscript` does.

    Attributes:
        first: Pose that is approached slowly, shape (6,) [rad].
        t: Time of each pose, shape (n,) [s].
        q: Poses, shape (n, 6) [rad].
    """

    first: Array
    t: Array
    q: Array

    def __post_init__(self) -> None:
        freeze(self, "first", "t", "q")


def read_urscript(text: str) -> ServoProgram:
    """The poses of a program as `urscript` writes it.

    Raises:
        BadInput: No ``movej``, no ``servoj``, or several rates.
    """
    moves = re.findall(r"^\s*movej\(\[([^\]]*)\]", text, re.MULTILINE)
    servos = re.findall(r"^\s*servoj\(\[([^\]]*)\], t=([0-9.e+-]+),", text, re.MULTILINE)
    steps = {step for _, step in servos}
    if len(moves) != 1 or len(steps) != 1:
        raise BadInput("not a program with one movej and servoj commands at one rate")
    first, *poses = (
        [float(x) for x in pose.split(",")] for pose in (moves[0], *(pose for pose, _ in servos))
    )
    t = np.arange(float(len(poses))) * float(steps.pop())
    return ServoProgram(read_only(first), t, read_only(poses))


def npz(motion: Motion, robot: Robot) -> bytes:
    """A NumPy archive with ``t, q, dq, ddq, joints``; exact, and readable without pickle."""
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        t=motion.t,
        q=motion.q,
        dq=motion.dq,
        ddq=motion.ddq,
        joints=np.array(robot.joints),
    )
    return buffer.getvalue()


def read_npz(content: bytes) -> NamedMotion:
    """The motion of a NumPy archive.

    Raises:
        BadInput: No archive, or an array is missing.
    """
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in ("t", "q", "dq", "ddq", "joints")}
    except (KeyError, ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise BadInput(f"not a NumPy archive with t, q, dq, ddq, joints ({error})") from None
    values = [arrays[name] for name in ("q", "dq", "ddq")]
    return _named(arrays["joints"], arrays["t"], values, "NumPy archive")


def _durations(motion: Motion) -> list[tuple[int, int]]:
    """Seconds and nanoseconds of each sample since the first."""
    ticks = [round(1e9 * float(t)) for t in motion.t - motion.t[0]]
    stuck = next((k for k in range(1, len(ticks)) if ticks[k] <= ticks[k - 1]), None)
    if stuck is not None:
        raise BadInput(f"samples {stuck - 1} and {stuck} of the motion are less than 1 ns apart")
    return [divmod(tick, 10**9) for tick in ticks]


def _points(motion: Motion) -> list[tuple[list[float], list[float], list[float]]]:
    rows = (motion.q.tolist(), motion.dq.tolist(), motion.ddq.tolist())
    return list(zip(*rows, strict=True))


def _yaml_number(value: float) -> str:
    """Shortest exact text that YAML reads as a float: it wants a point before the exponent."""
    text = repr(value)
    return text if "." in text else text.replace("e", ".0e")


def _named(joints: Any, t: Any, values: Any, what: str) -> NamedMotion:
    names = tuple(str(name) for name in joints)
    try:
        motion = Motion(t, *values)
    except (ValueError, TypeError, IndexError):
        raise BadInput(f"{what}: positions, velocities and accelerations do not match") from None
    if motion.nv != len(names):
        raise BadInput(f"{what}: {len(names)} names of joints for {motion.nv} positions")
    return NamedMotion(names, motion)


Exporter = Callable[[Motion, Robot], bytes | str]

FORMATS: dict[str, tuple[str, Exporter]] = {
    "ros2": (".yaml", joint_trajectory_yaml),
    "mcap": (".mcap", mcap_bag),
    "urscript": (".script", urscript),
    "npz": (".npz", npz),
}
