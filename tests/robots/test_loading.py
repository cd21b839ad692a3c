"""Arms of every format, from file to motion; limits from files, and limits that are missing."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from textwrap import indent

import numpy as np
import pytest
import yaml
from arms import ARMS as LIBRARY
from arms import data_folder
from known_arms import Call
from marks import refused

from excitant.analysis.identifiability import analyze
from excitant.analysis.uncertainty import NOT_SHOWN
from excitant.design import design_trajectory
from excitant.exceptions import BadInput, BadRobot
from excitant.robots import Limits, Motion, Robot, load_limits, load_robot, rigid_body_torque
from excitant.robots.chains import RobotSpec
from excitant.robots.limits import require_limits, unlimited
from excitant.robots.parameters import BaseEstimate
from excitant.robots.torque import torque

DATA = Path(__file__).parent / "data"
SIX = ("left_1", "left_2", "left_3", "right_1", "right_2", "right_3")
READ = {
    "urdf": (RobotSpec(DATA / "scara.urdf", tip="quill"), 4),
    "xacro": (RobotSpec(DATA / "pan_tilt.urdf.xacro", xacro_args={"reach": "0.6"}), 2),
    "mjcf": (RobotSpec(DATA / "slider.xml"), 3),
    "both arms of two": (RobotSpec(DATA / "twins.urdf", SIX), 6),
    "yaml over mjcf": (RobotSpec(DATA / "slider.yaml"), 2),
}


@pytest.mark.parametrize(("spec", "joints"), READ.values(), ids=READ)
def test_any_arm_is_read(spec: RobotSpec, joints: int) -> None:
    assert load_robot(spec).nv == joints


@pytest.mark.slow
@pytest.mark.usefixtures("own_time")
@pytest.mark.parametrize("kind", ["xacro", "mjcf", "both arms of two"])
def test_any_arm_gets_a_motion_that_shows_it(kind: str) -> None:
    robot = load_robot(READ[kind][0])
    if kind == "mjcf":  # which has no word for the limit of a speed
        refused("no velocity limits", require_limits, robot, error=BadInput)
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
    folder = data_folder(None)
    if folder is None:
        pytest.skip("example-robot-data is not installed; pip install example-robot-data")
    cases = [case for case in LIBRARY if not str(case).endswith("/ur3.urdf")]  # has no links
    assert len(cases) >= 25
    for case in cases:
        robot = load_robot(replace(case, path=folder / case.path))
        motion = Motion(np.arange(3.0), *robot.random_motion(np.random.default_rng(0), 3))
        assert np.isfinite(rigid_body_torque(robot, motion)).all()


def test_missing_limits_are_asked_for_with_the_file_to_write(planar, excitant, tmp_path):
    bare, limits = tmp_path / "bare.urdf", tmp_path / "limits.yaml"
    bare.write_text(re.sub('(velocity|effort)="[^"]*"', r'\1="0"', planar.urdf))
    ran = excitant("design --time-limit 2", bare, "-o", tmp_path / "run")
    assert ran.status == 1
    said = ran.err.strip()
    assert "\n" not in said
    assert f"{bare} gives no velocity limits and no limits on acceleration or torque" in said
    assert "--limits limits.yaml" in said
    assert not (tmp_path / "run").exists()
    entries = re.findall(r"'(\w+: \{[^}]*\})'", said)
    limits.write_text("\n".join(entry.replace("..", "2.0") for entry in entries))
    robot = load_robot(bare)
    limited = robot.with_limits(load_limits(limits, robot))
    assert limited.limits.velocity.tolist() == limited.limits.acceleration.tolist() == [2, 2]
    require_limits(limited)


def test_limits_that_few_joints_have_are_told_and_soft_ones_kept(tmp_path: Path) -> None:
    text = load_robot("planar_2r").urdf
    soft = '<safety_controller k_velocity="10" soft_lower_limit="-1" soft_upper_limit="9"/></joint>'
    (tmp_path / "soft.urdf").write_text(text.replace("</joint>", soft, 1))
    robot = load_robot(tmp_path / "soft.urdf")
    hard = load_robot("planar_2r").limits.position
    assert robot.limits.position.tolist() == [[-1.0, hard[0, 1]], hard[1].tolist()]
    assert "soft ones of the safety_controller: joint1" in robot.notes[-1]
    endless = robot.with_limits(replace(robot.limits, position=57.3 * hard))
    assert "perhaps of degrees" in require_limits(endless)
    none = robot.with_limits(replace(robot.limits, torque=np.array([np.inf, 1.0])))
    assert [unlimited(robot), unlimited(none)] == ["", "torque of joint1, no limit is given"]


MOVEIT = """
default_velocity_scaling_factor: 0.1
joint_limits:
  joint2: {has_velocity_limits: true, max_velocity: 1.5, has_acceleration_limits: false,
           max_acceleration: 0, has_effort_limits: true, max_effort: 12.0,
           has_position_limits: true, min_position: -1.0, max_position: 2.0}
  finger: {has_velocity_limits: true, max_velocity: 0.1}
"""


def limits_of(tmp_path: Path, text: str, robot: Robot, suffix: str = ".yaml") -> Limits:
    path = tmp_path / f"limits{suffix}"
    path.write_text(text)
    return load_limits(path, robot)


def numbers(limits: Limits) -> dict[str, list]:
    names = ("position", "velocity", "acceleration", "torque")
    return {name: getattr(limits, name).tolist() for name in names}


def test_joint_limits_of_moveit_and_ros2_control_are_read(planar: Robot, tmp_path: Path) -> None:
    """Only limits in force count, of joints that the arm has."""
    expected = numbers(planar.limits)
    for name, value in (("velocity", 1.5), ("torque", 12.0), ("position", [-1.0, 2.0])):
        expected[name][1] = value
    for text in (MOVEIT, f"/**:\n  ros__parameters:{indent(MOVEIT, '    ')}"):
        assert numbers(limits_of(tmp_path, text, planar)) == expected


def test_an_arm_without_mass_is_refused_a_design(planar: Robot) -> None:
    massless = planar.with_parameters(np.zeros(20))
    refused("no link has a mass", design_trajectory, massless, starts=1, error=BadRobot)


def test_torque_limits_stand_in_for_those_of_acceleration(planar: Robot) -> None:
    assert require_limits(planar) is None
    unlimited = replace(planar.limits, acceleration=np.full(2, np.inf))
    note = require_limits(planar.with_limits(unlimited))
    assert note is not None
    assert all(joint in note for joint in planar.joints)


def test_the_command_line_chooses_a_part(excitant: Call, tmp_path: Path) -> None:
    chain = "--base torso --tip left_hand --lock lift=0.1 --lock left_thumb=0,left_finger=0.1"
    ran = excitant("robots --json", DATA / "twins.urdf", *chain.split())
    assert all(f"left_{k}" in ran.out for k in (1, 2, 3))
    assert "held at 0, as they are not chosen: right_1, right_2, right_3" in ran.err
    head = DATA / "pan_tilt.urdf.xacro"
    assert excitant("robots", head, "--xacro-arg", "reach:=0.6", "--json").status == 0
    shutil.copy(DATA / "scara.urdf", tmp_path / "robot.urdf")
    ran = excitant("analyze --tip link1", tmp_path, "-o", tmp_path / "run")
    assert ran.status == 1
    assert "leave --tip out" in ran.err  # a data folder says its joints itself


# What cannot be read

LOOP = """<joint name="brace" type="revolute"><parent link="rail"/><child link="hand"/></joint>
</robot>"""
BODY = '<mujoco><worldbody><body name="a">{}</body></worldbody></mujoco>'
MESH = """<mujoco><asset><mesh name="m" file="m.stl"/></asset><worldbody><body><joint/>
<geom type="mesh" mesh="m"/></body></worldbody></mujoco>"""
OVER = "model: gantry.urdf\n"
REFUSED = [  # a file, what is written in place of a part of it or at its start, what is said
    ("gantry.urdf", 'mass value="1.5"', 'mass value="nan"', "box"),
    ("gantry.urdf", 'mass value="1.5"', 'mass value="1e-320"', "is too little for a body"),
    ("gantry.urdf", 'velocity="', 'velocity="1e-300" was="', "is too little for a limit"),
    ("gantry.urdf", 'ixx="0.003"', 'ixx="small"', "box"),
    ("gantry.urdf", 'upper="1.5"', 'upper="inf"', "slide"),
    ("gantry.urdf", 'child link="box"', 'child link="bux"', "weld"),
    ("gantry.urdf", 'parent link="box"', 'parent link="bux"', "twist"),
    ("gantry.urdf", 'joint name="twist"', 'joint name="slide"', "slide"),
    ("gantry.urdf", 'link name="tip"', 'link name="box"', "box"),
    ("gantry.urdf", '"twist" type="revolute"', '"twist" type="rev"', "twist"),
    ("gantry.urdf", "</robot>", LOOP, "'hand' hangs from two joints, 'twist' and 'brace'"),
    ("arm.urdf", "", "<sdf/>", "not a URDF: the root element is <sdf>"),
    ("arm.urdf", "", '<mujoco model="gantry"/>', "give an MJCF of an arm"),
    ("arm.urdf", "", '<robot name="empty"/>', "no <link>"),
    ("arm.urdf", "", "\xff", "not a text file"),
    ("over.yaml", "", "gravity: [0, 0, -9.81]\n", "no 'model' entry"),
    ("over.yaml", "", OVER + "gravity: [0, -9.81]\n", "gravity"),
    ("over.yaml", "", OVER + "gravity: [0, .nan, 0]\n", "gravity"),
    ("over.yaml", "", OVER + "lock: {swing: up}\n", "lock"),
    ("over.yaml", "", OVER + "lock: [swing]\n", "lock"),
    ("over.yaml", "", OVER + "lock: {slde: 0}\n", "did you mean 'slide'"),
    ("over.yaml", "", OVER + "joints: [slde]\n", "did you mean 'slide'"),
    ("over.yaml", "", OVER + "limits: {velocty: 1}\n", "velocity"),
    ("over.yaml", "", OVER + "effects: [{effect: viscos_friction, values: 1}]\n", "viscous"),
    ("over.yaml", "", OVER + "effects: [{effect: viscous_friction, values: [1, 2]}]\n", "viscous"),
    ("over.yaml", "", OVER + "effects: {viscous_friction: 1}\n", "effects"),
    ("over.yaml", "", OVER + "tip: a\ntip: b\n", "line .: 'tip' is given twice"),
    ("over.yaml", "", "- model\n", "expected entries"),
    ("over.yaml", "", "model: [\n", "not valid YAML .line 2: "),
    ("over.yaml", "", "convention: standard\ndh: []\n", "dh"),
    ("drill.yaml", "convention: standard", "", "convention: None.*standard, modified"),
    ("drill.yaml", "convention: standard", "convention: craig", "convention.*craig"),
    ("drill.yaml", "angles: degrees", "angles: gon", "angles.*gon"),
    ("drill.yaml", "a: 0.4", "aa: 0.4", r"dh\[0\]: unknown entry 'aa': did you mean 'a'"),
    ("drill.yaml", "a: 0.3", "a: long", r"dh\[1\].a: expected a number"),
    ("drill.yaml", "theta: 30", "theta: .inf", r"dh\[1\].theta: expected a finite"),
    ("drill.yaml", "type: prismatic", "type: sliding", r"dh\[2\].type.*sliding"),
    ("drill.yaml", "m: 5, ", "", r"dh\[0\]: it lacks 'm'"),
    ("drill.yaml", "m: 3", "m: -3", r"dh\[1\].m: expected a number above 0"),
    ("drill.yaml", "com: [-0.2, 0.01, 0]", "com: [0, 0, 0], mc: [0, 0, 0]", "upper: both 'com'"),
    ("drill.yaml", "Ic: {", "I: {}, Ic: {", "upper: both 'I' and 'Ic'"),
    ("drill.yaml", "I: {xx: 0.01, yy: 0.01, zz: 0.001}", "a: 0", "link3: give the inertia"),
    ("drill.yaml", "xy: 0.002", "yx: 0.002", r"dh\[0\].Ic: unknown entry 'yx'"),
    ("drill.yaml", "radius: 0.05", "size: 0.05", r"dh\[0\].collision\[0\]: unknown entry 'size'"),
    ("drill.yaml", "radius: 0.05", "radius: 0", r"n\[0\].radius: expected a number above 0"),
    ("drill.yaml", "base: {position", "base: {place", "base: unknown entry 'place'"),
    ("drill.yaml", "tool: {position: [0, 0, 0.1]}", "tool: 3", "tool: expected entries"),
    ("drill.yaml", "gravity: [0, 0, -9.8]", "gravity: 9.8", "gravity: expected a list"),
    ("drill.yaml", "joint: quill", "joint: shoulder", "joint 'shoulder' is defined twice"),
    ("drill.yaml", "name: drill", "model: gantry.urdf", "both 'model' and 'dh'"),
    ("drill.yaml", "name: drill", "lock: {elbow: 1}", "unknown joint 'elbow'"),
    ("drill.yaml", "velocity: 3", "velocity: -3", "velocity limit"),
    ("arm.xml", "", "<mujoco/>", "worldbody"),
    ("arm.xml", "", "<mujoco><worldbody>", "XML"),
    ("arm.xml", "", BODY.format('<joint/><inertial pos="0 0 0" mass="much"/>'), "attribute 'mass'"),
    ("arm.xml", "", BODY.format('<joint name="b" type="ball"/><geom size="1"/>'), "'b'"),
    ("arm.xml", "", BODY.format('<joint/><geom size="1"/><body name="a"/>'), "'a'"),
    ("arm.xml", "", '<mujoco><include file="none.xml"/></mujoco>', "none.xml"),
    ("arm.xml", "", MESH, "m.stl"),
]


@pytest.mark.parametrize(("file", "old", "new", "words"), REFUSED)
def test_a_file_that_cannot_be_read_is_refused_by_name(tmp_path, file, old, new, words):
    shutil.copy(DATA / "gantry.urdf", tmp_path)
    path, text = tmp_path / file, (DATA / file).read_text() if (DATA / file).exists() else ""
    assert old in text
    path.write_text(text.replace(old, new, 1), "latin-1")
    said = refused(".", load_robot, path)
    assert re.search(words, said.replace(str(path), ""))
    assert str(path) in said or said.startswith("unknown")


# Limits from files


def test_what_the_file_leaves_out_stays(planar: Robot, tmp_path: Path) -> None:
    before = numbers(planar.limits)
    limits = limits_of(tmp_path, "velocity: 1.5\n", planar)
    assert numbers(limits) == before | {"velocity": [1.5, 1.5]}
    text = "velocity: {joint2: 0.5}\nposition: {joint1: [-1, 0.5]}\n"
    before["velocity"][1], before["position"][0] = 0.5, [-1, 0.5]
    assert numbers(limits_of(tmp_path, text, planar)) == before


@pytest.mark.parametrize(("suffix", "written"), [(".yaml", yaml.safe_dump), (".json", json.dumps)])
@pytest.mark.parametrize("nested", [True, False])
def test_written_limits_are_read_back(planar, tmp_path, suffix, written, nested):
    half = {name: (0.5 * np.array(x)).tolist() for name, x in numbers(planar.limits).items()}
    text = written({"limits": half} if nested else half)
    assert numbers(limits_of(tmp_path, text, planar, suffix)) == half


BAD_LIMITS = {
    "velocity: [1.0]\nacceleration: [1, 2, 3, 4, 5, 6, 7, 8]\n": "acceleration",
    "position: [1, 2, 3]\n": "position limits: expected one pair",
    "torque: [1, two]\n": r"torque\[1\]",
    "velocity: {no_joint: 1}\n": "velocity limits: unknown joint",
    "position: [.nan, 1]\n": "position",
    **dict.fromkeys(("velocity: 0\n", "jerk: 1e-300\n"), "must be positive"),
    "acceleration: .nan\n": "acceleration",
    "velocity: [1, 2\n": "not valid YAML .line 2: ",
    "joint_limits: {wrist: {has_velocity_limits: true, max_velocity: 1.5}}\n": "joint 'wrist'",
    "joint_limits: {joint2: {has_velocity_limits: true, max_velocity: fast}}\n": "fast|velocity",
    **dict.fromkeys(("velocity: fast\n", "velocity: [[[1]]]\n"), "velocity"),
    "velocity: {joint1: fast}\n": "velocity",
    **dict.fromkeys(("position: [1, -1]\n", "position: [1, 1]\n"), "lower must be below upper"),
    **dict.fromkeys(("- 1\n- 2\n", ""), "expected entries"),
    **dict.fromkeys(("limits: [1, 2]\n", "limits:\n"), "limits: expected entries"),
}


def test_a_range_beyond_reason_is_none(planar, tmp_path):
    limits = limits_of(tmp_path, "position: [[-1.0e+300, 1.0e+300], [0, 1]]\n", planar)
    assert limits.position.tolist() == [[-np.inf, np.inf], [0, 1]]


def test_more_joints_than_can_be_examined_are_refused(tmp_path):
    body = '<body name="b{0}"><joint name="j{0}"/><geom size=".1"/></body>'
    bodies = "".join(body.format(k) for k in range(70))
    path = tmp_path / "many.xml"
    path.write_text(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    assert "70 moving joints, more than 32" in refused(
        "choose some with --joints", load_robot, path
    )


@pytest.mark.parametrize("text", BAD_LIMITS)
def test_bad_limits_are_refused_in_one_line(planar, tmp_path, text):
    refused("no such file", load_limits, tmp_path / "limits.yaml", planar)
    said = refused(BAD_LIMITS[text], limits_of, tmp_path, text, planar, error=BadInput)
    assert str(tmp_path / "limits.yaml") in said


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    """A robot.yaml that keeps its estimate of two parameters."""
    C = np.array([[4.0, 1.0], [1.0, 2.0]])
    text = BaseEstimate(("link1.mcx", "link,2.m"), np.array([0.5, -1 / 3]), C).csv()
    (tmp_path / "arm-estimate.csv").write_text(text)
    (tmp_path / "arm.urdf").write_text(load_robot("planar_2r").urdf)
    path = tmp_path / "arm.yaml"
    path.write_text("model: arm.urdf\nestimate: arm-estimate.csv\n")
    return path


def test_a_robot_yaml_keeps_an_estimate_of_the_whole_arm_beside_it(kept: Path) -> None:
    found = load_robot(kept).estimate
    assert (found.names, found.value.tolist()) == (("link1.mcx", "link,2.m"), [0.5, -1 / 3])
    assert found.covariance.tolist() == [[4.0, 1.0], [1.0, 2.0]]
    assert load_robot(kept, lock={"joint2": 0.3}).estimate is None
    for name, why in (("../x.csv", "outside its folder"), ("none.csv", "cannot be read")):
        kept.write_text(f"model: arm.urdf\nestimate: {name}\n")
        refused(why, load_robot, kept, error=BadRobot)


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("parameter,", "name,", "not a table"),
        ("0.5", "half", "half"),
        ("0.5", "nan", "not finite"),
        ("4.0", "-4.0", "positive definite"),
        ("4.0,1.0", "4.0,1.5", "not symmetric"),
        ("2.0\n", "0.25\n", "positive definite"),
        ("\nlink1.mcx", "\nlink1.mcy", "a column for each"),
    ],
)
def test_an_estimate_that_is_none_is_refused(kept, old, new, why):
    file = kept.with_name("arm-estimate.csv")
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new, 1))
    said = refused(re.escape(why), load_robot, kept, error=BadRobot)
    assert "arm-estimate.csv" in said
    assert "write the model again" in said
