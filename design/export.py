"""Motions as files: CSV, exact coefficients in JSON, and the formats of robot controllers."""

import csv
import io
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import msgspec
import numpy as np
import yaml

from excitant.design.trajectory import Trajectory
from excitant.exceptions import BadInput, UnknownName
from excitant.files import read_text
from excitant.robots.limits import UNLIMITED
from excitant.robots.motion import Motion
from excitant.robots.robot import Robot
from excitant.robots.schema import Finite, Positive, convert, read_yaml

TOPIC = "/joint_trajectory_controller/joint_trajectory"

_KINDS = ("q", "dq", "ddq")
_MESSAGE = "trajectory_msgs/msg/JointTrajectory"
_FIELDS = ("positions", "velocities", "accelerations")
_SERVOJ = "lookahead_time=0.1, gain=300"
_FIRST = "a=0.3, v=0.2"  # rad/s² and rad/s of the move to the first pose
# s at the last pose, which servoj reaches later than it is told; whole steps
_SETTLE = 0.48
_Periods = Annotated[int, msgspec.Meta(ge=1, le=10_000)]


def motion_csv(motion: Motion) -> str:
    """Table ``t,q1..,dq1..,ddq1..`` in full double precision."""
    table = np.column_stack([*vars(motion).values()]).tolist()
    rows = [_columns(motion.nv), *([repr(value) for value in row] for row in table)]
    return "\n".join(map(",".join, rows)) + "\n"


def _columns(nv: int) -> list[str]:
    return ["t", *(f"{kind}{j + 1}" for kind in _KINDS for j in range(nv))]


def trajectory_csv(
    trajectory: Trajectory, rate_hz: float = 100.0, repetitions: int = 1
) -> str:
    """All periods at a control rate [Hz], once or more, as a table with first and last sample."""
    return motion_csv(trajectory.motion(rate_hz, repetitions))


class _Record(msgspec.Struct, frozen=True):
    """A ``trajectory.json``: the coefficients of a Fourier series."""

    period: Positive
    offset: list[Finite]
    cosine: list[list[Finite]]
    sine: list[list[Finite]]
    periods: _Periods = 1
    joints: Any = None


def trajectory_json(trajectory: Trajectory, robot: Robot) -> str:
    """The exact coefficients, with the names of the joints."""
    cosine, sine = np.split(trajectory.coefficients[1:], 2)
    content = {
        "format": "fourier",
        "robot": robot.name,
        "joints": list(robot.joints),
        "period": trajectory.period,
        "periods": trajectory.periods,
        "harmonics": trajectory.harmonics,
        "offset": trajectory.offset.tolist(),
        "cosine": cosine.tolist(),
        "sine": sine.tolist(),
    }
    return json.dumps(content, indent=1) + "\n"


def load_trajectory(path: str | Path, robot: Robot) -> Trajectory | Motion:
    """Trajectory from a ``.json`` file of coefficients or a table of samples (CSV).

    Raises:
        BadInput: Of file, row (from 0 after the header) and column: unreadable, missing, of
            another number of joints, not finite, or time that does not increase.
    """
    path = Path(path)
    if path.suffix.lower() == ".json":
        return _from_json(path, robot)
    try:
        text = read_text(path)
    except FileNotFoundError:
        raise BadInput(f"trajectory {path}: no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", None) or "not UTF-8"
        why = f"not a readable text file ({why}); give CSV or JSON"
        raise BadInput(f"trajectory {path}: {why}") from None
    return _from_csv(text, path, robot)


def _from_json(path: Path, robot: Robot) -> Trajectory:
    content = read_yaml(path, dict[str, Any], "coefficients of a trajectory")
    record = convert(content, _Record, path)
    joints = record.joints
    if (
        isinstance(joints, list)
        and len(joints) == robot.nv
        and tuple(joints) != robot.joints
    ):
        raise BadInput(
            f"trajectory {path}: its joints {', '.join(map(str, joints))} are not those of "
            f"{robot.name} ({', '.join(robot.joints)})"
        )
    try:
        offset = np.array(record.offset)
        cosine = np.array(record.cosine)
        sine = np.array(record.sine)
        if cosine.shape != sine.shape or cosine.shape[1:] != offset.shape:
            raise ValueError(
                f"shapes differ: offset {offset.shape}, cosine {cosine.shape}, sine {sine.shape}"
            )
        coefficients = np.vstack([offset, cosine, sine])
        trajectory = Trajectory(coefficients, record.period, record.periods)
    except ValueError as error:
        raise BadInput(f"trajectory {path}: {error}") from None
    if trajectory.nv != robot.nv:
        raise BadInput(
            f"trajectory {path}: has {trajectory.nv} joints, but {robot.name} has {robot.nv}"
        )
    return trajectory


def _from_csv(text: str, path: Path, robot: Robot) -> Motion:
    lines = [
        [cell.strip() for cell in row]
        for row in csv.reader(text.splitlines())
        if row
    ]
    if fault := _csv_fault(lines, robot):
        raise BadInput(f"trajectory {path}: {fault}")
    places = [lines[0].index(name) for name in _columns(robot.nv)]
    table = np.array([[float(row[place]) for place in places] for row in lines[1:]])
    t = table[:, 0]
    for k in np.flatnonzero(np.diff(t) <= 0)[:1] + 1:
        raise BadInput(
            f"trajectory {path}: row {k}, column 't': {t[k]:g} s does not come after "
            f"{t[k - 1]:g} s; time must increase"
        )
    return Motion(t, *np.split(table[:, 1:], 3, axis=1))


def _csv_fault(lines: Sequence[list[str]], robot: Robot) -> str | None:
    if len(lines) < 3:
        return "needs a header and at least two rows"
    (header, *rows) = lines
    nv = robot.nv
    joints = sum(name.startswith("q") and name[1:].isdigit() for name in header)
    if joints and joints != nv:
        return f"{joints} joint columns q1..q{joints}, but {robot.name} has {nv} joints"
    for name in _columns(nv):
        if name not in header:
            named = f"the header must name t, q1..q{nv}, dq1..dq{nv}, ddq1..ddq{nv}"
            return f"column '{name}' is missing; {named}"
        if header.count(name) > 1:
            return f"column '{name}' occurs more than once"
    for k, row in enumerate(rows):
        if len(row) != len(header):
            return f"row {k} has {len(row)} values, the header {len(header)}"
    for name in _columns(nv):
        for k, cell in enumerate(row[header.index(name)] for row in rows):
            try:
                size = abs(float(cell))
            except ValueError:
                size = np.nan
            if not size <= UNLIMITED:
                return f"row {k}, column '{name}': '{cell}' is not a number up to {UNLIMITED:g}"
    return None


def write_formats(
    motions: Mapping[str, Motion], robot: Robot, names: Sequence[str]
) -> dict[str, bytes | str]:
    """Files of motions, in the order in which they run, in some of the `FORMATS`, by their names.

    ``ros2_client`` is one program of all motions, the others are a file of each.

    Raises:
        UnknownName: A format that does not exist; suggests the nearest.
        BadInput: Another number of joints, or a motion that a format cannot hold.
    """
    UnknownName.refuse("format", names, FORMATS)
    for motion in motions.values():
        _require(motion, robot)
    files: dict[str, bytes | str] = {}
    for name in names:
        suffix, write = FORMATS[name]
        if write is None:
            files[suffix] = ros2_client(motions, robot)
        else:
            files |= {
                stem + suffix: write(motion, robot)
                for stem, motion in motions.items()
            }
    return files


def _require(motion: Motion, robot: Robot) -> None:
    if motion.nv != robot.nv:
        raise BadInput(
            f"motion has {motion.nv} joints, robot {robot.name} has {robot.nv}"
        )
    if not all(np.isfinite(x).all() for x in vars(motion).values()):
        raise BadInput("motion holds a value that is not finite")
    if len(motion) < 2 or np.any(np.diff(motion.t) <= 0):
        raise BadInput("motion needs at least two samples, at times that increase")


def ros2_client(motions: Mapping[str, Motion], robot: Robot) -> str:
    """A Python program that sends motions to a ``joint_trajectory_controller``, exact.

    It needs ROS 2 and nothing of excitant; see its own first lines.
    """
    text = (
        files("excitant.design")
        .joinpath("ros2_client.py")
        .read_text(encoding="utf-8")
    )
    rows = ["MOTIONS = {"]
    for name, motion in motions.items():
        table = np.column_stack([*vars(motion).values()]).tolist()
        rows += [
            f"    {name!r}: [",
            *(f"        {row}," for row in table),
            "    ],",
        ]
    held = {
        "JOINTS": f"JOINTS = {list(robot.joints)}",
        "MOTIONS": "\n".join([*rows, "}"]),
    }
    lines = (held.get(line.partition(":")[0], line) for line in text.splitlines())
    return "\n".join(lines) + "\n"


def joint_trajectory_yaml(motion: Motion, robot: Robot) -> str:
    """A ROS 2 ``JointTrajectory`` as YAML for ``ros2 topic pub``, exact; times rounded to 1 ns."""
    names = yaml.safe_dump(list(robot.joints), default_flow_style=True, width=10**9)
    lines = ["header: {stamp: {sec: 0, nanosec: 0}, frame_id: ''}"]
    lines += [f"joint_names: {names.strip()}", "points:"]
    for sec, nanosec, *values in _points(motion):
        for mark, field, row in zip("-  ", _FIELDS, values, strict=True):
            lines.append(f"{mark} {field}: [{', '.join(map(_yaml_number, row))}]")
        lines += [
            "  effort: []",
            f"  time_from_start: {{sec: {sec}, nanosec: {nanosec}}}",
        ]
    return "\n".join(lines) + "\n"


def mcap_bag(motion: Motion, robot: Robot) -> bytes:
    """An MCAP bag with one ``JointTrajectory`` message at time 0, exact; times rounded to 1 ns.

    The bag embeds the definition of its message and plays in every ROS 2 since Humble.
    """
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    duration, time = (
        types[f"builtin_interfaces/msg/{name}"] for name in ("Duration", "Time")
    )
    points = [
        types["trajectory_msgs/msg/JointTrajectoryPoint"](
            **dict(zip(_FIELDS, map(np.array, values), strict=True)),
            effort=np.zeros(0),
            time_from_start=duration(sec=sec, nanosec=nanosec),
        )
        for sec, nanosec, *values in _points(motion)
    ]
    header = types["std_msgs/msg/Header"](stamp=time(sec=0, nanosec=0), frame_id="")
    message = types[_MESSAGE](
        header=header, joint_names=list(robot.joints), points=points
    )
    with TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            connection = writer.add_connection(TOPIC, _MESSAGE, typestore=store)
            writer.write(connection, 0, store.serialize_cdr(message, _MESSAGE))
        return (bag / "bag.mcap").read_bytes()


def urscript(motion: Motion, robot: Robot) -> str:
    """A URScript program that servoes along a motion, after a slow ``movej`` to its first pose.

    Its line ``scale`` is the share of the speed, a fifth. In every step of the controller, 8 ms or
    2 ms, it commands the place between two poses that the time has come to; positions only, with
    12 digits, of six turning joints.
    """
    if robot.nv != 6 or not robot.revolute.all():
        raise BadInput(
            f"URScript moves arms with six turning joints, {robot.name} has {robot.nv} joints"
        )
    joints = ", ".join(robot.joints).encode("ascii", "replace").decode()
    poses = [f"[{', '.join(f'{x:.12f}' for x in row)}]" for row in motion.q]
    times = [f"{t:.9f}" for t in motion.t - motion.t[0]]
    between = ", ".join(
        f"last[{j}] + share * (target[{j}] - last[{j}])" for j in range(6)
    )
    lines = [
        "def excitant_motion():",
        f"  # {len(poses)} poses of {joints} [rad] in {times[-1]} s",
        f"  global scale = {FIRST_SPEED} # share of the speed; if that went well, up to 1.0",
        "  global tick = get_steptime() # s",
        f"  global last = {poses[0]}",
        "  global since = 0.0 # s, when it was passed",
        "  global now = 0.0 # s at full speed",
        "  def follow(target, until):",
        "    while now < until:",
        "      local share = (now - since) / (until - since)",
        f"      servoj([{between}], t=tick, {_SERVOJ})",
        "      now = now + scale * tick",
        "    end",
        "    since = until",
        "    last = target",
        "  end",
        f"  movej(last, {_FIRST})",
        *(
            f"  follow({pose}, {t})"
            for pose, t in zip(poses[1:], times[1:], strict=True)
        ),
        f"  servoj(last, t={_SETTLE}, {_SERVOJ})",
        "  stopj(2.0)",
        "end",
        "excitant_motion()",
    ]
    return "\n".join(lines) + "\n"


def npz(motion: Motion, robot: Robot) -> bytes:
    """A NumPy archive with ``t, q, dq, ddq, joints``; exact, and readable without pickle."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **vars(motion), joints=np.array(robot.joints))
    return buffer.getvalue()


def _points(
    motion: Motion,
) -> Iterator[tuple[int, int, list[float], list[float], list[float]]]:
    ticks = [round(1e9 * float(t)) for t in motion.t - motion.t[0]]
    for k in np.flatnonzero(np.diff(ticks) <= 0)[:1]:
        raise BadInput(
            f"samples {k} and {k + 1} of the motion are less than 1 ns apart"
        )
    rows = zip(
        motion.q.tolist(), motion.dq.tolist(), motion.ddq.tolist(), strict=True
    )
    for tick, values in zip(ticks, rows, strict=True):
        yield *divmod(tick, 10**9), *values


def _yaml_number(value: float) -> str:
    """Shortest exact text that YAML reads as a float: it wants a point before the exponent."""
    text = repr(value)
    return text if "." in text else text.replace("e", ".0e")


FORMATS: dict[str, tuple[str, Callable[[Motion, Robot], bytes | str] | None]] = {
    "ros2": (".yaml", joint_trajectory_yaml),
    "mcap": (".mcap", mcap_bag),
    "urscript": (".script", urscript),
    "npz": (".npz", npz),
    "ros2_client": ("ros2_client.py", None),
}
PROGRAMS = ("ros2_client", "urscript")
"""Formats that move the arm, at `FIRST_SPEED` unless told otherwise."""
FIRST_SPEED = 0.2
"""Share of the speed of a first run."""
