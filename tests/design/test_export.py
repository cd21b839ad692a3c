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

from excitant.design import load_trajectory, trajectory_csv, trajectory_json, write_formats
from excitant.design.export import FORMATS, TOPIC
from excitant.design.trajectory import FourierSeries, Series, SplineSeries
from excitant.exceptions import BadInput, ExcitantError
from excitant.robots import Motion, Robot

FIELDS = ("positions", "velocities", "accelerations")
NANOSECOND = 0.5e-9 + 1e-15  # of rounding, and of adding seconds to nanoseconds


def sampled(nv: int, rate_hz: float) -> Motion:
    series = FourierSeries(3.0, 3)
    return series.trajectory(np.random.default_rng(0).normal(size=(series.size, nv))).motion(
        rate_hz
    )


def assert_same(found: Motion, expected: Motion, *names: str) -> None:
    for name in names or ("t", "q", "dq", "ddq"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


@pytest.mark.parametrize("series", [FourierSeries(3.0, 3), SplineSeries(3.0, 9)])
def test_json_and_csv_round_trips_are_the_identity(
    planar: Robot, series: Series, tmp_path: Path
) -> None:
    trajectory = series.trajectory(np.random.default_rng(0).normal(size=(series.size, 2)))
    path, table = tmp_path / "trajectory.json", tmp_path / "trajectory.csv"
    path.write_text(trajectory_json(trajectory, planar))
    loaded = load_trajectory(path, planar)
    assert type(loaded) is type(trajectory)
    np.testing.assert_array_equal(loaded.coefficients, trajectory.coefficients)
    assert loaded.period == 3.0
    table.write_text(trajectory_csv(trajectory, 50.0))
    assert_same(load_trajectory(table, planar), trajectory.motion(50.0))
    assert load_trajectory(table, planar).t[[0, -1]].tolist() == [0.0, 3.0]
    first, *rows = (line.split(",")[::-1] for line in table.read_text().splitlines())
    turned = [["x", *first], *(["0", *row] for row in rows)]  # columns may come in any order
    table.write_text("\n".join(map(",".join, turned)))
    assert_same(load_trajectory(table, planar), trajectory.motion(50.0))


HEADER = "t,q1,q2,dq1,dq2,ddq1,ddq2"
ROWS = ["0,0,0,0,0,0,0", "0.1,0,0,0,0,0,0", "0.2,0,0,0,0,0,0"]
BAD_CSV = (
    ([HEADER.replace("dq2", "v2"), *ROWS], "column 'dq2' is missing"),
    ([HEADER.replace("t,", "time,"), *ROWS], "column 't' is missing"),
    ([HEADER + ",q3", *(row + ",0" for row in ROWS)], "3 joint columns q1..q3"),
    ([HEADER, ROWS[0], "0.1,0,nan,0,0,0,0", ROWS[2]], "row 1, column 'q2': nan is not finite"),
    (
        [HEADER, ROWS[0], "0.1,1e308,0,0,0,0,0", ROWS[2]],
        "row 1, column 'q1': 1e+308 is more than an arm does",
    ),
    ([HEADER, *ROWS[:2], "0.2,0,0,0,0,inf,0"], "row 2, column 'ddq1': inf is not finite"),
    ([HEADER, ROWS[0], "0.1,0,0,x,0,0,0"], "row 1, column 'dq1': 'x' is not a number"),
    ([HEADER, ROWS[0], "0.1,0,0"], "row 1 has 3 values, the header 7"),
    ([HEADER, *ROWS, ROWS[1]], "row 3, column 't': 0.1 s does not come after 0.2 s"),
    ([HEADER, ROWS[0], ROWS[0]], "row 1, column 't'"),
    ([HEADER + ",q2", *(row + ",0" for row in ROWS)], "3 joint columns"),
    ([HEADER + ",dq2", *(row + ",0" for row in ROWS)], "'dq2' occurs more than once"),
    ([HEADER, ROWS[0]], "at least two rows"),
    ([], "at least two rows"),
)
GOOD_JSON = {"period": 3.0, "offset": [0.0] * 2} | dict.fromkeys(
    ("cosine", "sine"), [[0.0] * 2] * 3
)
BAD_JSON = (
    ({"period": None}, "period: expected a number"),
    ({"period": -1.0}, "period: expected a number above 0"),
    ({"offset": [0.0]}, "shapes differ: offset (1,)"),
    ({"offset": [0.0], "cosine": [[0.0]], "sine": [[0.0]]}, "has 1 joints, but planar_2r"),
    ({"cosine": [[0.0, 0.0]]}, "shapes differ: offset (2,), cosine (1, 2), sine (3, 2)"),
    ({"sine": [["a", 0.0]]}, "sine[0][0]: expected a number, got text"),
    ({"cosine": [[0.0, float("nan")]] * 3}, "cosine[0][1]: expected a finite number"),
    ({"joints": ["a", "b"]}, "its joints a, b are not those of"),
    ({"control_points": [[0, 0], [1, 1]]}, "at least 6 are needed"),
)
UNREADABLE = (
    *(("bad.csv", "\n".join(lines).encode(), why) for lines, why in BAD_CSV),
    *(("bad.json", json.dumps(GOOD_JSON | changes).encode(), why) for changes, why in BAD_JSON),
    ("bad.json", b"{", "bad.json"),
    ("bad.json", b"[1]", "bad.json"),
    ("bad.json", b'{"period": 1}', "bad.json"),
    ("bad.csv", b"\xff\xfe\x00\x81", "not a readable text file"),
    ("none.csv", None, "no such file"),
)


@pytest.mark.parametrize(("name", "content", "why"), UNREADABLE)
def test_what_is_no_trajectory_is_refused_in_one_line(
    planar: Robot, tmp_path: Path, name: str, content: bytes | None, why: str
) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(BadInput) as error:
        load_trajectory(path, planar)
    assert why in str(error.value)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


@pytest.fixture(scope="module")
def motion() -> Motion:
    """Awkward numbers: times that are no multiples of 1 ns, tiny and huge values."""
    motion = sampled(6, 130.0)
    q = np.array(motion.q)
    q[5] = [1e-17, -1e-5, 1e22, -0.0, 1 / 3, 5e-324]
    return replace(motion, q=q, t=motion.t + 7.0)


def test_files_are_read_back_equal_by_others(ur10: Robot, motion: Motion, tmp_path: Path) -> None:
    """YAML is the message that ROS expects; the bag is as rosbags reads every ROS 2 log."""
    files = write_formats(motion, ur10, FORMATS, "approach")
    text, bag, _, archive = (files[f"approach.{s}"] for s in ("yaml", "mcap", "script", "npz"))
    content = yaml.load(text, Loader=yaml.CSafeLoader)
    times = [point["time_from_start"] for point in content["points"]]
    t = [stamp["sec"] + 1e-9 * stamp["nanosec"] for stamp in times]
    values = [[point[field] for point in content["points"]] for field in FIELDS]
    found = {"ros2": (content["joint_names"], Motion(t, *values))}
    assert list(content) == ["header", "joint_names", "points"]
    for point in content["points"]:
        assert list(point) == [*FIELDS, "effort", "time_from_start"]
        assert all(isinstance(x, float) for field in FIELDS for x in point[field])
        assert {type(v) for v in point["time_from_start"].values()} == {int}
        assert 0 <= point["time_from_start"]["nanosec"] < 10**9
    path = tmp_path / "bag.mcap"
    path.write_bytes(bag)
    with AnyReader([path]) as reader:
        [(connection, _, raw)] = list(reader.messages())
        message = reader.deserialize(raw, connection.msgtype)
    assert connection.topic == TOPIC
    times = [point.time_from_start for point in message.points]
    t = [stamp.sec + 1e-9 * stamp.nanosec for stamp in times]
    values = [[getattr(point, field) for point in message.points] for field in FIELDS]
    found["mcap"] = (message.joint_names, Motion(t, *values))
    for joints, read in found.values():
        assert joints == list(ur10.joints)
        assert np.abs(read.t - (motion.t - motion.t[0])).max() <= NANOSECOND
        assert_same(read, motion, "q", "dq", "ddq")
    with np.load(io.BytesIO(archive), allow_pickle=False) as read:
        assert tuple(read["joints"]) == ur10.joints
        assert_same(Motion(*(read[name] for name in ("t", "q", "dq", "ddq"))), motion)


def test_urscript_goes_to_the_first_pose_and_is_read_back_equal(ur10: Robot) -> None:
    motion = sampled(6, 125.0)
    [text] = write_formats(motion, ur10, ["urscript"]).values()
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


def test_write_formats_refuses(planar: Robot, ur10: Robot, motion: Motion) -> None:
    close = replace(motion[:2], t=np.array([0.0, 1e-10]))
    for refused, robot, name, why in (
        (motion, ur10, "mcp", "unknown format 'mcp': did you mean 'mcap'"),
        (motion, planar, "npz", "motion has 6 joints, robot planar_2r has 2"),
        (sampled(2, 10.0), planar, "urscript", "six turning joints, planar_2r has 2 joints"),
        (motion[np.array([0, 1, 3, 4])], ur10, "urscript", "equidistant"),
        (replace(motion, q=motion.q * np.nan), ur10, "npz", "not finite"),
        (motion[:1], ur10, "npz", "at least two samples"),
        (motion[np.array([0, 0])], ur10, "npz", "times that increase"),
        (close, ur10, "ros2", "less than 1 ns apart"),
        (close, ur10, "mcap", "less than 1 ns apart"),
    ):
        with pytest.raises(ExcitantError, match=why):
            write_formats(refused, robot, [name])
