"""Arms of every format, from file to motion; limits from files, and limits that are missing."""

from __future__ import annotations

import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from excitant.analysis.identifiability import analyze
from excitant.analysis.uncertainty import NOT_SHOWN
from excitant.cli import main
from excitant.design import design_trajectory
from excitant.exceptions import BadInput
from excitant.robots import Motion, Robot, load_limits, load_robot, rigid_body_torque, torque
from excitant.robots.limits import require_limits

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

DATA = Path(__file__).parent / "data"
ARMS = {
    "urdf": ("scara.urdf", {"tip": "quill"}, 4),
    "xacro": ("pan_tilt.urdf.xacro", {"xacro_args": {"reach": "0.6"}}, 2),
    "mjcf": ("slider.xml", {}, 3),
    "one arm of two": ("twins.urdf", {"base": "torso", "tip": "left_hand"}, 3),
    "both arms of two": (
        "twins.urdf",
        {"joints": [f"{side}_{k}" for side in ("left", "right") for k in (1, 2, 3)]},
        6,
    ),
    "yaml over mjcf": ("slider.yaml", {}, 2),
}


def loaded(kind: str) -> Robot:
    file, options, _ = ARMS[kind]
    return load_robot(DATA / file, **options)


@pytest.mark.parametrize("kind", ARMS)
def test_any_arm_is_read(kind: str) -> None:
    assert loaded(kind).nv == ARMS[kind][2]


@pytest.mark.parametrize("kind", ["xacro", "mjcf", "both arms of two"])
def test_any_arm_gets_a_motion_that_shows_it(kind: str) -> None:
    robot = loaded(kind)
    if kind == "mjcf":  # which has no word for the limit of a speed
        with pytest.raises(BadInput, match="no velocity limits"):
            require_limits(robot)
        robot = robot.with_limits(replace(robot.limits, velocity=np.full(robot.nv, 2.5)))
    require_limits(robot)
    found = design_trajectory(robot, starts=1, jobs=1, time_limit=2.0)
    assert found.limits.hold
    motion = found.trajectory.motion(50.0)
    noise = 0.01 * np.abs(torque(robot, motion)).max(axis=0)
    shown = analyze(robot, effects=(), motion=motion, noise=noise.tolist())
    assert shown.practical
    assert all(parameter.verdict != NOT_SHOWN for parameter in shown.practical)
    assert found.condition_final <= found.condition_initial


@pytest.mark.slow
def test_arms_of_example_robot_data() -> None:
    """The arms that the benchmark tries: what is refused is refused for the model's fault."""
    from arms import ARMS as CASES
    from arms import data_folder

    folder = data_folder(None)
    if folder is None:
        pytest.skip("example-robot-data is not installed; pip install example-robot-data")
    serial = 0
    for case in CASES:
        if str(case).endswith("/ur3.urdf"):  # a file without links
            continue
        robot = load_robot(replace(case, path=folder / case.path))
        q, dq, ddq = robot.random_motion(np.random.default_rng(0), 3)
        assert np.isfinite(rigid_body_torque(robot, Motion(np.arange(3.0), q, dq, ddq))).all()
        serial += 1
    assert serial >= 25


@pytest.fixture
def bare(tmp_path: Path) -> Path:
    """An arm whose URDF has neither speed nor torque limits for two of its joints."""
    text = load_robot("planar_2r").urdf
    for key in ("velocity", "effort"):
        text = re.sub(rf'{key}="[^"]*"', f'{key}="0"', text)
    path = tmp_path / "bare.urdf"
    path.write_text(text)
    return path


def test_missing_limits_are_asked_for_with_the_file_to_write(
    bare: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["design", str(bare), "--time-limit", "2", "-o", str(tmp_path / "run")]) == 1
    said = capsys.readouterr().err.strip()
    assert "\n" not in said
    assert f"{bare} gives no velocity limits and no limits on acceleration or torque" in said
    assert "--limits limits.yaml" in said
    assert not (tmp_path / "run").exists()
    entries = re.findall(r"'(\w+: \{[^}]*\})'", said)
    limits = tmp_path / "limits.yaml"
    limits.write_text("\n".join(entry.replace("..", "2.0") for entry in entries))
    robot = load_robot(bare)
    limited = robot.with_limits(load_limits(limits, robot))
    assert limited.limits.velocity.tolist() == limited.limits.acceleration.tolist() == [2, 2]
    require_limits(limited)


def test_torque_limits_stand_in_for_those_of_acceleration(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(load_robot("planar_2r").urdf)
    robot = load_robot(path)
    assert np.isinf(robot.limits.acceleration).all()
    note = require_limits(robot)
    assert note is not None
    assert all(joint in note for joint in robot.joints)
    assert require_limits(load_robot("planar_2r")) is None


def test_the_command_line_chooses_a_part(capsys: pytest.CaptureFixture[str]) -> None:
    chain = ["--base", "torso", "--tip", "left_hand", "--lock", "lift=0.1"]
    words = [str(DATA / "twins.urdf"), *chain]
    assert main(["robots", *words, "--json"]) == 0
    shown = capsys.readouterr()
    assert [f"left_{k}" in shown.out for k in (1, 2, 3)] == [True] * 3
    assert "held at 0, as they are not chosen: right_1, right_2, right_3" in shown.err
    xacro = [str(DATA / "pan_tilt.urdf.xacro"), "--xacro-arg", "reach:=0.6"]
    assert main(["robots", *xacro, "--json"]) == 0
    assert main(["robots", *xacro[:1], "--xacro-arg", "raech:=0.6"]) == 1
    assert "did you mean 'reach'" in capsys.readouterr().err


def test_a_data_folder_says_its_joints_itself(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "robot.urdf").write_text(load_robot("planar_2r").urdf)
    assert main(["analyze", str(tmp_path), "--tip", "link1", "-o", str(tmp_path / "run")]) == 1
    assert "leave --tip out" in capsys.readouterr().err


def test_what_the_file_leaves_out_stays(planar: Robot, tmp_path: Path) -> None:
    path = tmp_path / "limits.yaml"
    path.write_text("velocity: 1.5\n")
    limits = load_limits(path, planar)
    assert (limits.velocity == 1.5).all()
    for name in ("position", "acceleration", "torque"):
        assert np.array_equal(getattr(limits, name), getattr(planar.limits, name))


@pytest.mark.parametrize("suffix", [".yaml", ".json"])
@pytest.mark.parametrize("nested", [True, False])
def test_written_limits_are_read_back(
    planar: Robot, tmp_path: Path, suffix: str, nested: bool
) -> None:
    names = ("position", "velocity", "acceleration", "torque")
    content = {name: (getattr(planar.limits, name) * 0.5).tolist() for name in names}
    whole = {"limits": content} if nested else content
    path = tmp_path / f"limits{suffix}"
    path.write_text(json.dumps(whole) if suffix == ".json" else yaml.safe_dump(whole))
    limits = load_limits(path, planar)
    for name in names:
        assert np.array_equal(getattr(limits, name), getattr(planar.limits, name) * 0.5)


REFUSED: dict[str, tuple[str, str]] = {
    "too few": ("velocity: [1.0]\nacceleration: [1, 2, 3, 4, 5, 6, 7, 8]\n", "acceleration"),
    "words": ("velocity: fast\n", "velocity"),
    "mapping of none": ("velocity: {no_joint: 1}\n", "velocity limits: unknown joint"),
    "unknown name": ("velocities: 1\n", "did you mean 'velocity'"),
    "lower equal to upper": ("position: [1, 1]\n", "lower must be below upper"),
    "zero speed": ("velocity: 0\n", "must be positive"),
    "not a number": ("acceleration: .nan\n", "acceleration"),
    "no mapping": ("- 1\n- 2\n", "expected entries"),
    "limits empty": ("limits:\n", "limits: expected entries"),
    "not YAML": ("velocity: [1, 2\n", "not valid YAML .line 2: "),
    "empty": ("", "expected entries"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_bad_limits_are_refused_in_one_line(planar: Robot, tmp_path: Path, kind: str) -> None:
    text, culprit = REFUSED[kind]
    path = tmp_path / "limits.yaml"
    path.write_text(text)
    with pytest.raises(BadInput, match=culprit) as refused:
        load_limits(path, planar)
    assert str(path) in str(refused.value)
    assert "\n" not in str(refused.value)


def test_the_joint_at_fault_is_named(planar: Robot, tmp_path: Path) -> None:
    path = tmp_path / "limits.yaml"
    path.write_text(yaml.safe_dump({"torque": [*[5.0] * (planar.nv - 1), 0.0]}))
    with pytest.raises(BadInput, match=planar.joints[-1]):
        load_limits(path, planar)
