import importlib.util
import io
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import ros2
import yaml
from marks import refused, slow
from rosbags.highlevel import AnyReader
from urscript import Controller

from excitant import design
from excitant.design import load_trajectory, write_formats
from excitant.design.export import FORMATS, TOPIC
from excitant.design.trajectory import FourierSeries
from excitant.exceptions import BadInput
from excitant.robots import Motion, Robot

FIELDS = ("positions", "velocities", "accelerations")
NANOSECOND = 0.5e-9 + 1e-15  # of rounding, and of adding seconds to nanoseconds


def drawn(series: FourierSeries, nv: int, size: float = 1.0) -> design.Trajectory:
    return series.trajectory(size * np.random.default_rng(0).normal(size=(series.size, nv)))


def sampled(nv: int, rate_hz: float) -> Motion:
    return drawn(FourierSeries(3.0, 3), nv).motion(rate_hz)


def assert_same(found: Motion, expected: Motion, *names: str) -> None:
    for name in names or ("t", "q", "dq", "ddq"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


@pytest.mark.parametrize("series", [FourierSeries(3.0, 3), FourierSeries(1.0, 3, periods=3)])
def test_json_and_csv_round_trips_are_the_identity(
    planar: Robot, series: FourierSeries, tmp_path: Path
):
    trajectory = drawn(series, 2)
    path, table = tmp_path / "trajectory.json", tmp_path / "trajectory.csv"
    path.write_text(design.trajectory_json(trajectory, planar))
    loaded = load_trajectory(path, planar)
    np.testing.assert_array_equal(loaded.coefficients, trajectory.coefficients)
    found = (type(loaded), loaded.period, loaded.duration)
    assert found == (type(trajectory), series.period, 3.0)
    table.write_text(design.trajectory_csv(trajectory, 50.0))
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
    ([HEADER, ROWS[0], "0.1,0,nan,0,0,0,0", ROWS[2]], "row 1, column 'q2': 'nan' is not a number"),
    (
        [HEADER, ROWS[0], "0.1,1e308,0,0,0,0,0", ROWS[2]],
        "row 1, column 'q1': '1e308' is not a number up to 1e+09",
    ),
    ([HEADER, *ROWS[:2], "0.2,0,0,0,0,inf,0"], "row 2, column 'ddq1': 'inf' is not a number"),
    ([HEADER, ROWS[0], "0.1,0,0,x,0,0,0"], "row 1, column 'dq1': 'x' is not a number"),
    ([HEADER, ROWS[0], "0.1,0,0"], "row 1 has 3 values, the header 7"),
    ([HEADER, *ROWS, ROWS[1]], "row 3, column 't': 0.1 s does not come after 0.2 s"),
    ([HEADER, ROWS[0], ROWS[0]], "row 1, column 't'"),
    ([HEADER + ",q2", *(row + ",0" for row in ROWS)], "3 joint columns"),
    ([HEADER + ",dq2", *(row + ",0" for row in ROWS)], "'dq2' occurs more than once"),
    ([HEADER, ROWS[0]], "at least two rows"),
    ([], "at least two rows"),
)
WAVES = [[0.0] * 2] * 3
GOOD_JSON = {"period": 3.0, "offset": [0.0] * 2, "cosine": WAVES, "sine": WAVES}
BAD_JSON = (
    ({"period": None}, "period: expected a number"),
    ({"period": -1.0}, "period: expected a number above 0"),
    ({"offset": [0.0]}, "shapes differ: offset (1,)"),
    ({"offset": [0.0], "cosine": [[0.0]], "sine": [[0.0]]}, "has 1 joints, but planar_2r"),
    ({"cosine": [[0.0, 0.0]]}, "shapes differ: offset (2,), cosine (1, 2), sine (3, 2)"),
    ({"sine": [["a", 0.0]]}, "sine[0][0]: expected a number, got text"),
    ({"cosine": [[0.0, float("nan")]] * 3}, "cosine[0][1]: expected a finite number"),
    ({"joints": ["a", "b"]}, "its joints a, b are not those of"),
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
def test_what_is_no_trajectory_is_refused_in_one_line(planar, tmp_path, name, content, why):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    said = refused(".", load_trajectory, path, planar, error=BadInput)
    assert all(words in said for words in (why, str(path)))


@pytest.fixture(scope="module")
def motion() -> Motion:
    """Awkward numbers: times that are no multiples of 1 ns, tiny and huge values."""
    motion = sampled(6, 130.0)
    q = np.array(motion.q)
    q[5] = [1e-17, -1e-5, 1e22, -0.0, 1 / 3, 5e-324]
    return replace(motion, q=q, t=motion.t + 7.0)


def test_files_are_read_back_equal_by_others(ur10: Robot, motion: Motion, tmp_path: Path) -> None:
    """YAML is the message that ROS expects; the bag is as rosbags reads every ROS 2 log."""
    files = write_formats({"approach": motion}, ur10, list(FORMATS))
    text, bag, _, archive = (files[f"approach.{s}"] for s in ("yaml", "mcap", "script", "npz"))
    content = yaml.load(text, Loader=yaml.CSafeLoader)
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
    written = json.loads(json.dumps(content), object_hook=lambda entry: SimpleNamespace(**entry))
    for each in (written, message):
        times = [point.time_from_start for point in each.points]
        t = [stamp.sec + 1e-9 * stamp.nanosec for stamp in times]
        read = Motion(t, *([getattr(point, x) for point in each.points] for x in FIELDS))
        assert each.joint_names == list(ur10.joints)
        assert np.abs(read.t - (motion.t - motion.t[0])).max() <= NANOSECOND
        assert_same(read, motion, "q", "dq", "ddq")
    with np.load(io.BytesIO(archive), allow_pickle=False) as read:
        assert tuple(read["joints"]) == ur10.joints
        assert_same(Motion(*(read[name] for name in ("t", "q", "dq", "ddq"))), motion)


@pytest.mark.parametrize("steptime", [1 / 125, slow(1 / 500)])
@pytest.mark.parametrize("scale", [0.2, 1.0])
def test_urscript_commands_the_motion_in_every_step_of_the_controller(ur10, steptime, scale):
    """Slowly unless told otherwise; between poses by a line, whatever the rates are."""
    path = drawn(FourierSeries(3.0, 3), 6, 0.5)
    [text] = write_formats({"trajectory": path.motion(100.0)}, ur10, ["urscript"]).values()
    assert isinstance(text, str)
    assert text.count("scale = 0.2 ") == 1
    ran = Controller(text.replace("scale = 0.2 ", f"scale = {scale} "), steptime)
    t, q = ran.commanded
    [(first, how)] = ran.moved
    np.testing.assert_allclose(first, path(0.0)[0], rtol=0, atol=1e-11)
    assert how["v"] <= 0.2
    assert ran.stopped
    moving = t < 3.0 / scale - 1e-9
    sagitta = np.abs(path(np.linspace(0, 3, 1000), 2)).max() / 100.0**2 / 8
    expected = path(np.minimum(scale * t, 3.0))
    assert np.abs(q - expected)[moving].max() <= sagitta + 1e-9
    np.testing.assert_allclose(q[~moving], expected[~moving], rtol=0, atol=1e-9)
    assert ran.time == pytest.approx(3.0 / scale + 0.48, abs=2 * steptime)
    speed = np.abs(np.diff(q[moving], axis=0)).max() / steptime
    assert speed <= scale * np.abs(path(np.linspace(0, 3, 1000), 1)).max() * 1.01


@pytest.fixture(scope="module")
def way(planar: Robot) -> dict[str, Motion]:
    """There, an excitation, and back."""
    path = design.random_trajectory(planar, np.random.default_rng(2), 4.0, 3)
    there, here = path(0.0)[0], np.array([0.1, -0.2])
    ways = (("approach", (here, there)), ("return", (there, here)))
    go, back = (design.approach(planar, *ends, name=name, rate_hz=100.0) for name, ends in ways)
    return {"approach": go, "trajectory": path.motion(100.0), "return": back}


def client(way: dict[str, Motion], robot: Robot, folder: Path, arm: ros2.Arm | None = None) -> Any:
    """The generated client as a module; its clock is that of an arm."""
    [(name, text)] = write_formats(way, robot, ["ros2_client"]).items()
    (folder / name).write_text(str(text), encoding="utf-8")
    spec = importlib.util.spec_from_file_location("client", folder / name)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    if arm is not None:
        vars(module)["time"] = SimpleNamespace(monotonic=lambda: arm.now)
    return module


def drive(module: Any, patch: pytest.MonkeyPatch, arm: ros2.Arm, *words: str) -> int:
    ros2.install(arm, patch)
    patch.setattr("sys.argv", ["ros2_client.py", *words])
    status: int = module.main()
    assert arm.closed
    return status


@pytest.mark.parametrize(("words", "scale"), [((), 0.2), (("--scale", "1"), 1.0)])
def test_client_is_slow_unless_told_otherwise(planar, way, tmp_path, monkeypatch, words, scale):
    arm = ros2.Arm(planar.joints, way["approach"].q[0])
    module = client(way, planar, tmp_path, arm)
    assert drive(module, monkeypatch, arm, "--go", *words) == 0
    for goal, sent, planned in zip(arm.goals, arm.sent, way.values(), strict=True):
        times = [p.time_from_start for p in goal.trajectory.points]
        t = np.array([x.sec + 1e-9 * x.nanosec for x in times])
        expected = module.LEAD + (planned.t - planned.t[0]) / scale
        assert np.abs(t - expected).max() <= NANOSECOND
        found = [[getattr(p, field) for p in goal.trajectory.points] for field in FIELDS]
        slowed = [planned.q, scale * planned.dq, scale**2 * planned.ddq]
        np.testing.assert_array_equal(found, slowed)
        path = design.HermiteTrajectory(planned)
        for now, q in arm.trace:
            since = now - sent - module.LEAD
            if 0 < since <= (planned.t[-1] - planned.t[0]) / scale:
                wanted = path(np.array([planned.t[0] + scale * since]))[0]
                np.testing.assert_allclose(q, wanted, rtol=0, atol=1e-9)
        tolerance = {x.name: x.position for x in goal.path_tolerance}
        assert tolerance == dict.fromkeys(planar.joints, 0.1)
    np.testing.assert_allclose(arm.q, way["return"].q[-1], rtol=0, atol=1e-12)


STOPS = (  # state of the arm, words, status, goals that it got, what is said
    ({"here": False}, (), 1, 0, "no action server /joint_trajectory_controller/follow"),
    ({"q": np.array([0.5, -0.2])}, (), 1, 0, "approach begins with joint1 at 0.1000"),
    ({"q": np.array([np.nan, -0.2])}, (), 1, 0, "which stands at nan"),
    ({"accepts": False}, (), 1, 1, "does not accept approach"),
    ({"error": -4}, (), 1, 1, "approach ended with error -4: why"),
    ({}, ("--motions", "trajectory"), 1, 0, "trajectory begins with joint1"),
    ({"interrupt": 3.0}, (), 130, 1, "interrupted; what was running is cancelled"),
)


@pytest.mark.parametrize(("state", "words", "status", "goals", "why"), STOPS)
def test_client_stops_in_one_line(
    planar, way, tmp_path, monkeypatch, capsys, state, words, status, goals, why
):
    arm = ros2.Arm(planar.joints, **{"q": way["approach"].q[0]} | state)
    assert drive(client(way, planar, tmp_path, arm), monkeypatch, arm, "--go", *words) == status
    [line] = capsys.readouterr().err.splitlines()
    assert why in line
    assert (len(arm.goals), arm.cancelled) == (goals, status == 130)


def test_client_without_go_moves_nothing_and_needs_no_ros(planar, way, tmp_path):
    module = client(way, planar, tmp_path)
    command = [sys.executable, "-I", module.__file__]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "trajectory: 401 points, 20.0 s at 0.2 of the speed" in said
    assert "nothing was sent" in said
    for wrong in ("0", "1.01", "nan"):
        words = [*command, "--go", "--scale", wrong]
        ran = subprocess.run(words, capture_output=True, text=True)
        assert ran.returncode == 2
        assert "not above 0 and up to 1" in ran.stderr


def test_write_formats_refuses(planar: Robot, ur10: Robot, motion: Motion) -> None:
    close = replace(motion[:2], t=np.array([0.0, 1e-10]))
    for other, robot, name, why in (
        (motion, ur10, "mcp", "unknown format 'mcp': did you mean 'mcap'"),
        (motion, planar, "npz", "motion has 6 joints, robot planar_2r has 2"),
        (sampled(2, 10.0), planar, "urscript", "six turning joints, planar_2r has 2 joints"),
        (replace(motion, q=motion.q * np.nan), ur10, "npz", "not finite"),
        (motion[:1], ur10, "npz", "at least two samples"),
        (motion[np.array([0, 0])], ur10, "npz", "times that increase"),
        (close, ur10, "ros2", "less than 1 ns apart"),
        (close, ur10, "mcap", "less than 1 ns apart"),
    ):
        refused(why, write_formats, {"trajectory": other}, robot, [name])
