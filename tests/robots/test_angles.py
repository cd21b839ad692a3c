"""Angles that are rounded where they are printed: the arm is that of the exact ones."""

import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from excitant.design import condition_number, information, random_trajectory
from excitant.robots import Robot, load_robot
from excitant.robots.angles import STEP, Angles
from excitant.robots.base_parameters import base_parameters, categories
from excitant.robots.effects import standard_effects
from excitant.robots.urdf import robot_from_urdf

RIGHT = repr(np.pi / 2)
NOTE = "angles rounded in the file are taken as multiples of 15°"


@pytest.mark.parametrize(
    ("text", "degrees"),
    [
        *(("1.57", 90), ("-1.5708", -90), ("1.5707963", 90), ("1.5707", 90), ("3.14", 180)),
        *(("3.1415", 180), ("0.7853", 45), ("0.2618", 15), ("-1.309", -75), ("1.570796327", 90)),
        *(("1.5712", None), ("1.6", None), ("0.001", None), ("1e-4", None), ("0", None)),
        *(("1.56", None), ("1.570734", None), (RIGHT, None), ("nan", None), ("1e308", None)),
    ],
)
def test_an_angle_is_meant_exactly_within_its_digits(text: str, degrees: float | None) -> None:
    angles = Angles()
    found = angles.meant(text)
    assert found == (None if degrees is None else pytest.approx(np.radians(degrees), rel=1e-15))
    seen = degrees is not None and abs(float(text) - np.radians(degrees)) > 1e-8
    assert bool(angles.notes) == seen


@given(st.tuples(*[st.integers(-11, 12)] * 3), st.integers(3, 8))
def test_a_rounded_quaternion_is_the_turn_that_it_was(steps: tuple[int, ...], digits: int) -> None:
    exact = pin.rpy.rpyToMatrix(*(STEP * np.array(steps)))
    x, y, z, w = pin.Quaternion(exact).coeffs()
    found = Angles().quaternion(np.round([w, x, y, z], digits))
    assert np.allclose(pin.Quaternion(*found).matrix(), exact, atol=1e-7)


def test_a_quaternion_of_a_rounded_angle_is_exact_and_others_stay() -> None:
    turned = Angles().quaternion(np.array([0.707388, 0.706825, 0.0, 0.0]))  # of 1.57 rad
    assert turned == pytest.approx(np.array([1, 1, 0, 0]) / np.sqrt(2), abs=1e-12)
    for other in ([1.0, 0.0005, 0.0, 0.0], [0.9, 0.3, 0.2, 0.1], [0.0, 0.0, 0.0, 0.0]):
        assert Angles().quaternion(np.array(other)).tolist() == other


@pytest.mark.parametrize("text", ["1.5707963", "1.5708", "1.57", "1.5707"])
def test_design_and_analysis_are_those_of_the_exact_arm(ur10: Robot, text: str) -> None:
    assert ur10.urdf.count(RIGHT) >= 4
    robot = robot_from_urdf(ur10.urdf.replace(RIGHT, text), "ur.urdf")
    [note] = robot.notes
    assert note.startswith(NOTE)
    assert f"{text} as 90°" in note
    effects = standard_effects(ur10.joints)
    motion, found = random_trajectory(ur10, np.random.default_rng(0), 10.0, 5).sample(200), []
    for each in (robot, ur10):
        base, matrix = base_parameters(each, effects), information(each, "friction").matrix(motion)
        found.append((base.columns, categories(base), condition_number(matrix)))
    assert found[0] == (*found[1][:2], pytest.approx(found[1][2], rel=1e-9))
    assert robot_from_urdf(robot.urdf, "again.urdf").notes == ()


def test_every_form_of_description_is_read_alike(tmp_path: Path) -> None:
    path = tmp_path / "arm.yaml"
    rows = "dh: [{m: 1, alpha: 1.57, I: {}}, {m: 1, a: 0.3, alpha: 0.3, I: {}}]\n"
    path.write_text(f"convention: standard\n{rows}tool: {{rpy: [3.14, 0, 0]}}\n")
    robot = load_robot(path)
    assert robot.notes == (f"{NOTE}: 1.57 as 90°, 3.14 as 180°",)
    path.write_text("convention: standard\nangles: degrees\n" + rows.replace("1.57", "90"))
    assert load_robot(path).notes == ()
    path = tmp_path / "arm.xml"
    for turn in ('euler="1.57 0 0"', 'axisangle="1 0 0 1.57"', 'quat="0.7071 0.707 0 0"'):
        inner = f'<body {turn}><joint/><geom size="1"/></body>'
        body = f'<worldbody><body><joint/><geom size="1"/>{inner}</body></worldbody>'
        path.write_text(f'<mujoco><compiler angle="radian"/>{body}</mujoco>')
        robot = load_robot(path)
        assert [note.partition(":")[0] for note in robot.notes] == [NOTE]
        poses = re.findall('rpy="([^"]*)"', robot.description)
        turns = [[float(word) for word in pose.split()] for pose in poses]
        assert any(np.allclose(turn, [np.pi / 2, 0, 0], atol=1e-12, rtol=0) for turn in turns)
