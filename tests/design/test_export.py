from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from excitant.design import (
    FourierTrajectory,
    load_trajectory,
    random_trajectory,
    trajectory_csv,
    trajectory_json,
)
from excitant.exceptions import BadInput
from excitant.robots import Motion, Robot


@pytest.fixture
def trajectory(planar: Robot) -> FourierTrajectory:
    return random_trajectory(planar, np.random.default_rng(0), 3.0, 3)


def test_json_round_trip_is_the_identity(
    planar: Robot, trajectory: FourierTrajectory, tmp_path: Path
) -> None:
    path = tmp_path / "trajectory.json"
    path.write_text(trajectory_json(trajectory, planar))
    loaded = load_trajectory(path, planar)
    assert isinstance(loaded, FourierTrajectory)
    np.testing.assert_array_equal(loaded.coefficients, trajectory.coefficients)
    assert loaded.period == trajectory.period


def test_csv_round_trip_is_the_identity(
    planar: Robot, trajectory: FourierTrajectory, tmp_path: Path
) -> None:
    path = tmp_path / "trajectory.csv"
    path.write_text(trajectory_csv(trajectory, 50.0))
    loaded, motion = load_trajectory(path, planar), trajectory.motion(50.0)
    assert isinstance(loaded, Motion)
    for name in ("t", "q", "dq", "ddq"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(motion, name))
    assert loaded.t[0] == 0.0
    assert loaded.t[-1] == 3.0


def test_csv_columns_may_come_in_any_order(
    planar: Robot, trajectory: FourierTrajectory, tmp_path: Path
) -> None:
    rows = [line.split(",")[::-1] for line in trajectory_csv(trajectory, 50.0).splitlines()]
    path = tmp_path / "turned.csv"
    path.write_text(
        "\n".join(",".join(["x" if k == 0 else "0", *row]) for k, row in enumerate(rows))
    )
    loaded = load_trajectory(path, planar)
    assert isinstance(loaded, Motion)
    np.testing.assert_array_equal(loaded.q, trajectory.motion(50.0).q)


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
        ({"period": None}, "'period' holds a value that is not finite"),
        ({"period": -1.0}, "period -1.0"),
        ({"offset": [0.0]}, "'offset' has shape (1,)"),
        ({"cosine": [[0.0, 0.0]]}, "shapes differ: offset (2,), cosine (1, 2), sine (3, 2)"),
        ({"sine": [["a", 0.0]]}, "'sine' is not a table of numbers"),
        ({"cosine": [[0.0, float("nan")]] * 3}, "'cosine' holds a value that is not finite"),
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


def test_unreadable_files(planar: Robot, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="no such file"):
        load_trajectory(tmp_path / "none.csv", planar)
    for name, content in (("a.json", b"{"), ("b.json", b"[1]"), ("c.json", b'{"period": 1}')):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(BadInput, match=name):
            load_trajectory(tmp_path / name, planar)
    (tmp_path / "d.csv").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(BadInput, match="not a readable text file"):
        load_trajectory(tmp_path / "d.csv", planar)
