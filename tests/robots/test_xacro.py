"""Xacro files without ROS: arguments, packages, and one line where something is missing."""

import shutil
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
import xacro as ros
from marks import refused

from excitant.exceptions import BadRobot
from excitant.robots import Robot, load_robot
from excitant.robots.chains import RobotSpec
from excitant.robots.xacro import urdf_from_xacro


@pytest.fixture
def arm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An arm whose macros lie in the package `parts`; what it holds runs in this process."""
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
    monkeypatch.setattr("excitant.robots.xacro.in_child", lambda work, *task, **_: work(*task))
    shutil.copytree(Path(__file__).parent / "data" / "bars", tmp_path, dirs_exist_ok=True)
    return tmp_path / "arm" / "bars.urdf.xacro"


def write(path: Path, old: str, new: str) -> None:
    text = path.read_text("utf-8")
    assert old in text
    path.write_text(text.replace(old, new))


def centre(robot: Robot, link: str) -> float:
    """Height of a link's centre of mass in its frame [m]."""
    k = 10 * robot.links.index(link)
    return float(robot.phi[k + 3] / robot.phi[k])


def test_arguments_decide_what_is_built(arm: Path) -> None:
    plain = load_robot(arm)
    assert plain.joints == ("upper_joint", "fore_joint")
    other = load_robot(RobotSpec(arm, xacro_args={"length": "0.8", "tool": "true"}))
    assert other.joints == (*plain.joints, "slider_joint")
    assert other.revolute.tolist() == [True, True, False]
    assert [centre(x, "upper") for x in (plain, other)] == pytest.approx([0.25, 0.4])


@pytest.mark.parametrize(
    ("to", "given"), [("far/parts", "far"), ("far/parts", "far/parts"), ("far/x-1.2", "far/x-1.2")]
)
def test_a_package_is_found_where_it_is_said_to_be(arm: Path, to: str, given: str) -> None:
    """By the name of its folder or of its manifest."""
    around = arm.parents[1]
    (around / "far").mkdir()
    parts = (around / "parts").rename(around / to)
    if parts.name != "parts":
        (parts / "package.xml").write_text("<package><name>parts</name></package>")
    assert load_robot(arm, packages=[around / given]).nv == 2
    refused(r"no package 'parts'.*--package /path/to/parts", load_robot, arm, error=BadRobot)


def test_robot_yaml_over_a_xacro(arm: Path) -> None:
    path, around = arm.parent / "robot.yaml", arm.parents[1]
    (around / "far").mkdir()
    (around / "parts").rename(around / "far" / "parts")
    path.write_text(
        "model: bars.urdf.xacro\nxacro_args: {length: 0.8, tool: true}\n"
        "lock: {slider_joint: 0.1}\nlimits: {acceleration: [4, 5]}\n"
    )
    far = [around / "far"]
    robot = load_robot(path, packages=far)
    assert robot.joints == ("upper_joint", "fore_joint")
    assert robot.limits.acceleration.tolist() == [4, 5]
    assert centre(robot, "upper") == pytest.approx(0.4)
    assert robot.phi[10] == pytest.approx(2.5)
    longer = load_robot(path, xacro_args={"length": "1"}, packages=far)
    assert centre(longer, "upper") == pytest.approx(0.5)


def test_written_out_it_is_the_same_arm(arm: Path) -> None:
    robot = load_robot(arm)
    (arm.parent / "plain.urdf").write_text(robot.urdf)
    assert np.array_equal(load_robot(arm.parent / "plain.urdf").phi, robot.phi)


@pytest.mark.parametrize(
    ("old", "new", "arguments", "words"),
    [
        ("", "", {"lenght": "1"}, "did you mean 'length'"),
        ("arg length", "arg reach", {}, "--xacro-arg NAME:=VALUE"),
        (' default="0.5"', "", {"length": "1"}, "default"),
        ("", "", {"length": "long"}, "length / 2"),
        ("</robot>", "", {}, "not XML"),
        ("xacro:bar name", "xacro:rod name", {}, "xacro:rod"),
        ("links.xacro", "limbs.xacro", {}, "limbs.xacro"),
    ],
)
def test_what_is_missing_is_said_in_one_line(arm, capfd, old, new, arguments, words):
    write(arm, old, new)
    assert "bars.urdf.xacro" in refused(words, load_robot, arm, xacro_args=arguments)
    assert capfd.readouterr().err == ""


def test_what_is_no_arm_in_xacro_is_refused(arm: Path) -> None:
    macros, plain = arm.parents[1] / "parts" / "links.xacro", arm.parent / "plain.urdf"
    plain.write_text(load_robot("planar_2r").urdf)
    assert "links.xacro" in refused("only defines macros", load_robot, macros)
    refused("no xacro arguments", load_robot, plain, xacro_args={"length": "1"}, error=BadRobot)


@pytest.mark.parametrize(
    "expression",
    [
        *("${props.mass * 2}", "${props['mass'] + 1.5}", "${[2 * x for x in [1.5]][0]}"),
        *("${dict(a=3)['a']}", "${math.sqrt(9)}", "${radians(180) / pi * 3}", "${type * vars}"),
        *("${float('a 3'.split()[1])}", "${max(3, float(xacro.arg('length')))}"),
        *("$(eval 2 * length + 2)", "$(eval max_mass if 2 > 1 else 0)"),
        "${python.sum(x * scale for x in [1.5])}",
    ],
)
def test_expressions_of_values_are_evaluated(arm: Path, expression: str) -> None:
    (arm.parent / "props.yaml").write_text("mass: 1.5\n")
    write(arm, 'mass="3"', f'mass="{expression}"')
    before = """<xacro:arg name="max_mass" default="3"/><xacro:property name="scale" value="2"/>
        <xacro:property name="type" value="2"/><xacro:property name="vars" value="1.5"/>
        <xacro:property name="props" value="${xacro.load_yaml('props.yaml')}"/>"""
    write(arm, '<link name="base"/>', f'{before}<link name="base"/>')
    assert load_robot(arm).phi[0] == pytest.approx(3.0)


@pytest.mark.parametrize("file", ["bars/arm/bars.urdf.xacro", "features.urdf.xacro"])
def test_a_file_builds_what_ros_builds_of_it(file: str, tmp_path: Path) -> None:
    """Elements and attributes are those of the xacro package, which finds no packages alone."""
    shutil.copytree(Path(__file__).parent / "data", tmp_path, dirs_exist_ok=True)
    path = tmp_path / file
    if "$(find parts)" in (text := path.read_text("utf-8")):
        path.write_text(text.replace("$(find parts)", str(path.parents[1] / "parts")))
    arguments = {"length": "0.7"}
    text, notes = urdf_from_xacro(path, arguments, [tmp_path])
    texts = (text, ros.process_file(str(path), mappings=arguments).toxml())
    trees = (ET.fromstring(xml).iter() for xml in texts)
    built, expected = ([(e.tag, e.attrib, (e.text or "").strip()) for e in tree] for tree in trees)
    assert built == expected
    assert notes == ()
