from __future__ import annotations

import io
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from rosbags.highlevel import AnyReader

from excitant.design import (
    FourierTrajectory,
    load_trajectory,
    random_trajectory,
    trajectory_csv,
    trajectory_json,
)
from excitant.design.export import (
    FORMATS,
    TOPIC,
    joint_trajectory_yaml,
    mcap_bag,
    npz,
    urscript,
    write_formats,
)
from excitant.design.trajectory import FourierSeries, Series, SplineSeries
from excitant.exceptions import BadInput, UnknownName
from excitant.robots import Motion, Robot


@pytest.fixture
def trajectory(planar: Robot) -> FourierTrajectory:
    return random_trajectory(planar, np.random.default_rng(0), 3.0, 3)


@pytest.fixture(scope="module")
def six_joints(ur10: Robot) -> FourierTrajectory:
    return random_trajectory(ur10, np.random.default_rng(0), 3.0, 3)


def assert_same(found: Motion, expected: Motion, *names: str) -> None:
    for name in names or ("t", "q", "dq", "ddq"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


@pytest.mark.parametrize("series", [FourierSeries(3.0, 3), SplineSeries(3.0, 9)])
def test_json_round_trip_is_the_identity(planar: Robot, series: Series, tmp_path: Path) -> None:
    path = tmp_path / "trajectory.json"
    X = np.random.default_rng(0).normal(size=(series.size, 2))
    path.write_text(trajectory_json(series.trajectory(X), planar))
    loaded = load_trajectory(path, planar)
    assert type(loaded) is type(series.trajectory(X))
    np.testing.assert_array_equal(loaded.coefficients, X)
    assert loaded.period == 3.0


def test_csv_round_trip_is_the_identity(
    planar: Robot, trajectory: FourierTrajectory, tmp_path: Path
) -> None:
    path = tmp_path / "trajectory.csv"
    path.write_text(trajectory_csv(trajectory, 50.0))
    assert_same(load_trajectory(path, planar), trajectory.motion(50.0))
    assert load_trajectory(path, planar).t[[0, -1]].tolist() == [0.0, 3.0]


def test_csv_columns_may_come_in_any_order(
    planar: Robot, trajectory: FourierTrajectory, tmp_path: Path
) -> None:
    first, *rows = trajectory_csv(trajectory, 50.0).splitlines()
    turned = [f"x,{','.join(first.split(',')[::-1])}"]
    turned += [f"0,{','.join(row.split(',')[::-1])}" for row in rows]
    path = tmp_path / "turned.csv"
    path.write_text("\n".join(turned))
    np.testing.assert_array_equal(load_trajectory(path, planar).q, trajectory.motion(50.0).q)


HEADER = "t,q1,q2,dq1,dq2,ddq1,ddq2"
ROWS = ["0,0,0,0,0,0,0", "0.1,0,0,0,0,0,0", "0.2,0,0,0,0,0,0"]


@pytest.mark.parametrize(
    ("lines", "why"),
    [
        ([HEADER.replace("dq2", "v2"), *ROWS], "column 'dq2' is missing"),
        ([HEADER.replace("t,", "time,"), *ROWS], "column 't' is missing"),
        ([HEADER + ",q3", *(row + ",0" for row in ROWS)], "3 joint columns q1..q3"),
        ([HEADER, ROWS[0], "0.1,0,nan,0,0,0,0", ROWS[2]], "row 1, column 'q2': nan is not finite"),
        ([HEADER, *ROWS[:2], "0.2,0,0,0,0,inf,0"], "row 2, column 'ddq1': inf is not finite"),
        ([HEADER, ROWS[0], "0.1,0,0,x,0,0,0"], "row 1, column 'dq1': 'x' is not a number"),
        ([HEADER, ROWS[0], "0.1,0,0"], "row 1 has 3 values, the header 7"),
        ([HEADER, *ROWS, ROWS[1]], "row 3, column 't': 0.1 s does not come after 0.2 s"),
        ([HEADER, ROWS[0], ROWS[0]], "row 1, column 't'"),
        ([HEADER + ",q2", *(row + ",0" for row in ROWS)], "3 joint columns"),
        ([HEADER + ",dq2", *(row + ",0" for row in ROWS)], "'dq2' occurs more than once"),
        ([HEADER, ROWS[0]], "at least two rows"),
        ([], "at least two rows"),
    ],
)
def test_bad_csv(planar: Robot, tmp_path: Path, lines: list[str], why: str) -> None:
    path = tmp_path / "bad.csv"
    path.write_text("\n".join(lines))
    with pytest.raises(BadInput) as error:
        load_trajectory(path, planar)
    assert why in str(error.value)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"period": None}, "period: expected a number"),
        ({"period": -1.0}, "period: expected a number above 0"),
        ({"offset": [0.0]}, "shapes differ: offset (1,)"),
        ({"offset": [0.0], "cosine": [[0.0]], "sine": [[0.0]]}, "has 1 joints, but planar_2r"),
        ({"cosine": [[0.0, 0.0]]}, "shapes differ: offset (2,), cosine (1, 2), sine (3, 2)"),
        ({"sine": [["a", 0.0]]}, "sine[0][0]: expected a number, got text"),
        ({"cosine": [[0.0, float("nan")]] * 3}, "cosine[0][1]: expected a finite number"),
        ({"joints": ["a", "b"]}, "its joints a, b are not those of"),
    ],
)
def test_bad_json(
    planar: Robot,
    trajectory: FourierTrajectory,
    tmp_path: Path,
    changes: dict[str, object],
    why: str,
) -> None:
    path = tmp_path / "bad.json"
    path.write_text(json.dumps({**json.loads(trajectory_json(trajectory, planar)), **changes}))
    with pytest.raises(BadInput) as error:
        load_trajectory(path, planar)
    assert why in str(error.value)


@pytest.mark.parametrize(
    ("name", "content", "why"),
    [
        ("none.csv", None, "no such file"),
        ("a.json", b"{", "a.json"),
        ("b.json", b"[1]", "b.json"),
        ("c.json", b'{"period": 1}', "c.json"),
        ("d.csv", b"\xff\xfe\x00\x81", "not a readable text file"),
        ("e.json", b'{"period": 2.0, "control_points": [[0, 0], [1, 1]]}', "e.json"),
    ],
)
def test_unreadable_files(
    planar: Robot, tmp_path: Path, name: str, content: bytes | None, why: str
) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(BadInput, match=why):
        load_trajectory(tmp_path / name, planar)


FIELDS = ("positions", "velocities", "accelerations")
NANOSECOND = 0.5e-9 + 1e-15  # of rounding, and of adding seconds to nanoseconds


@pytest.fixture(scope="module")
def motion(six_joints: FourierTrajectory) -> Motion:
    """Awkward numbers: times that are no multiples of 1 ns, tiny and huge values."""
    motion = six_joints.motion(130.0)
    q = np.array(motion.q)
    q[5] = [1e-17, -1e-5, 1e22, -0.0, 1 / 3, 5e-324]
    return replace(motion, q=q, t=motion.t + 7.0)


def read_yaml(text: str) -> tuple[list[str], Motion]:
    content = yaml.load(text, Loader=yaml.CSafeLoader)
    times = [point["time_from_start"] for point in content["points"]]
    values = [[point[field] for point in content["points"]] for field in FIELDS]
    t = [d["sec"] + 1e-9 * d["nanosec"] for d in times]
    return content["joint_names"], Motion(t, *values)


def read_mcap(content: bytes, path: Path) -> tuple[list[str], Motion]:
    """The motion as the rosbags reader of every ROS 2 log sees it."""
    path.write_bytes(content)
    with AnyReader([path]) as reader:
        [(connection, _, raw)] = list(reader.messages())
        message = reader.deserialize(raw, connection.msgtype)
    assert connection.topic == TOPIC
    values = [[getattr(point, field) for point in message.points] for field in FIELDS]
    times = [point.time_from_start for point in message.points]
    return message.joint_names, Motion([d.sec + 1e-9 * d.nanosec for d in times], *values)


def assert_equal(read: tuple[list[str], Motion], motion: Motion, robot: Robot) -> None:
    joints, found = read
    assert joints == list(robot.joints)
    assert np.abs(found.t - (motion.t - motion.t[0])).max() <= NANOSECOND
    assert_same(found, motion, "q", "dq", "ddq")


def test_yaml_is_the_message_that_ros_expects_and_is_read_back_equal(
    ur10: Robot, motion: Motion
) -> None:
    assert_equal(read_yaml(joint_trajectory_yaml(motion, ur10)), motion, ur10)
    content = yaml.safe_load(joint_trajectory_yaml(motion[:9], ur10))
    assert list(content) == ["header", "joint_names", "points"]
    assert content["joint_names"] == list(ur10.joints)
    for point in content["points"]:
        fields = ["positions", "velocities", "accelerations", "effort", "time_from_start"]
        assert list(point) == fields
        assert all(isinstance(x, float) for field in fields[:3] for x in point[field])
        assert {type(v) for v in point["time_from_start"].values()} == {int}
        assert 0 <= point["time_from_start"]["nanosec"] < 10**9


def test_mcap_and_npz_are_read_back_equal(ur10: Robot, motion: Motion, tmp_path: Path) -> None:
    assert_equal(read_mcap(mcap_bag(motion, ur10), tmp_path / "bag.mcap"), motion, ur10)
    with np.load(io.BytesIO(npz(motion, ur10)), allow_pickle=False) as read:
        assert tuple(read["joints"]) == ur10.joints
        assert_same(Motion(*(read[name] for name in ("t", "q", "dq", "ddq"))), motion)


def test_urscript_goes_to_the_first_pose_and_is_read_back_equal(
    ur10: Robot, six_joints: FourierTrajectory
) -> None:
    motion = six_joints.motion(125.0)
    text = urscript(motion, ur10)
    servo = re.findall(r"servoj\(\[(.*)\], t=([0-9.e+-]+),", text)
    q = np.array([pose.split(",") for pose, _ in servo], float)
    np.testing.assert_allclose(q, motion.q, rtol=0, atol=5.1e-13)
    np.testing.assert_allclose([float(step) for _, step in servo], 1 / 125, atol=1e-11)
    [first] = re.findall(r"movej\(\[(.*)\],", text)
    np.testing.assert_array_equal(np.array(first.split(","), float), q[0])
    lines = [line.strip() for line in text.splitlines() if "#" not in line]
    verbs = [line.split("(")[0] for line in lines]
    pattern = ["def excitant_motion", "movej", *["servoj"] * len(q), "stopj", "end"]
    assert verbs == [*pattern, "excitant_motion"]
    assert all(line.endswith("lookahead_time=0.1, gain=300)") for line in lines[2:-3])


def test_urscript_refuses_other_arms_and_uneven_samples(
    planar: Robot, ur10: Robot, motion: Motion
) -> None:
    with pytest.raises(BadInput, match="six turning joints, planar_2r has 2 joints"):
        urscript(Motion(np.arange(2.0), *np.zeros((3, 2, 2))), planar)
    with pytest.raises(BadInput, match="equidistant"):
        urscript(motion[np.array([0, 1, 3, 4])], ur10)


def test_write_formats_names_the_files(ur10: Robot, six_joints: FourierTrajectory) -> None:
    files = write_formats(six_joints.motion(50.0), ur10, FORMATS, "approach")
    assert list(files) == [f"approach.{s}" for s in ("yaml", "mcap", "script", "npz")]


def test_write_formats_refuses(planar: Robot, ur10: Robot, motion: Motion) -> None:
    with pytest.raises(UnknownName, match="unknown format 'mcp': did you mean 'mcap'"):
        write_formats(motion, ur10, ["npz", "mcp"])
    with pytest.raises(BadInput, match="motion has 6 joints, robot planar_2r has 2"):
        write_formats(motion, planar, ["npz"])
    close = replace(motion[:2], t=np.array([0.0, 1e-10]))
    for refused, name, why in (
        (replace(motion, q=motion.q * np.nan), "npz", "not finite"),
        (motion[:1], "npz", "at least two samples"),
        (motion[np.array([0, 0])], "npz", "times that increase"),
        (close, "ros2", "less than 1 ns apart"),
        (close, "mcap", "less than 1 ns apart"),
    ):
        with pytest.raises(BadInput, match=why):
            write_formats(refused, ur10, [name])
