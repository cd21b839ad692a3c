"""Xacro files without ROS: arguments, packages, and one line where something is missing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from excitant.exceptions import BadRobot, ExcitantError
from excitant.robots import Robot, load_robot
from excitant.robots.chains import RobotSpec

LINKS = """<?xml version="1.0"?>
<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:macro name="bar" params="name parent length mass axis:='0 1 0' kind:=revolute">
    <link name="${name}"><inertial><origin xyz="0 0 ${length / 2}"/><mass value="${mass}"/>
      <inertia ixx="${mass * length**2 / 12}" iyy="${mass * length**2 / 12}" izz="0.001"
        ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="${name}_joint" type="${kind}"><parent link="${parent}"/><child link="${name}"/>
      <axis xyz="${axis}"/><limit lower="-2" upper="2" velocity="2" effort="50"/></joint>
  </xacro:macro>
</robot>
"""
ARM = """<?xml version="1.0"?>
<robot name="bars" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="length" default="0.5"/>
  <xacro:arg name="tool" default="false"/>
  <xacro:include filename="$(find parts)/links.xacro"/>
  <link name="base"/>
  <xacro:bar name="upper" parent="base" length="$(arg length)" mass="3" axis="0 0 1"/>
  <xacro:bar name="fore" parent="upper" length="0.3" mass="2"/>
  <xacro:if value="$(arg tool)">
    <xacro:bar name="slider" parent="fore" length="0.1" mass="0.5" kind="prismatic"/>
  </xacro:if>
</robot>
"""


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    """An arm whose macros lie in a package somewhere else."""
    (tmp_path / "elsewhere" / "parts").mkdir(parents=True)
    (tmp_path / "elsewhere" / "parts" / "links.xacro").write_text(LINKS)
    (tmp_path / "arm").mkdir()
    path = tmp_path / "arm" / "bars.urdf.xacro"
    path.write_text(ARM)
    return path


def centre(robot: Robot, link: str) -> float:
    """Height of a link's centre of mass in its frame [m]."""
    k = 10 * robot.links.index(link)
    return float(robot.phi[k + 3] / robot.phi[k])


@pytest.mark.parametrize("folder", ["elsewhere", "elsewhere/parts"])
def test_arguments_decide_what_is_built(arm: Path, folder: str) -> None:
    packages = [arm.parent.parent / folder]
    plain = load_robot(arm, packages=packages)
    assert plain.joints == ("upper_joint", "fore_joint")
    assert centre(plain, "upper") == pytest.approx(0.25)
    given = {"length": "0.8", "tool": "true"}
    other = load_robot(RobotSpec(arm, xacro_args=given, packages=tuple(packages)))
    assert other.joints == ("upper_joint", "fore_joint", "slider_joint")
    assert centre(other, "upper") == pytest.approx(0.4)
    assert other.revolute.tolist() == [True, True, False]


def test_packages_around_the_file_are_found(arm: Path) -> None:
    (arm.parent.parent / "elsewhere" / "parts").rename(arm.parent.parent / "parts")
    assert load_robot(arm).nv == 2


def test_a_package_is_known_by_its_manifest(arm: Path) -> None:
    folder = arm.parent.parent / "elsewhere" / "parts"
    (folder / "package.xml").write_text("<package><name>parts</name></package>")
    other = folder.rename(folder.parent / "downloaded-parts-1.2")
    assert load_robot(arm, packages=[other]).nv == 2


def test_robot_yaml_over_a_xacro(arm: Path) -> None:
    path = arm.parent / "robot.yaml"
    path.write_text(
        "model: bars.urdf.xacro\nxacro_args: {length: 0.8, tool: true}\n"
        "packages: [../elsewhere]\nlock: {slider_joint: 0.1}\nlimits: {acceleration: [4, 5]}\n"
    )
    robot = load_robot(path)
    assert robot.joints == ("upper_joint", "fore_joint")
    assert robot.limits.acceleration.tolist() == [4, 5]
    assert centre(robot, "upper") == pytest.approx(0.4)
    assert robot.phi[10] == pytest.approx(2.5)
    assert centre(load_robot(path, xacro_args={"length": "1"}), "upper") == pytest.approx(0.5)


def test_written_out_it_is_the_same_arm(arm: Path, tmp_path: Path) -> None:
    robot = load_robot(arm, packages=[arm.parent.parent / "elsewhere"])
    plain = tmp_path / "plain.urdf"
    plain.write_text(robot.urdf)
    assert np.array_equal(load_robot(plain).phi, robot.phi)


NO_VALUE = ARM.replace("$(arg length)", "$(arg reach)")
NO_FILE = ARM.replace("links.xacro", "limbs.xacro")
WRONG: dict[str, tuple[str, dict[str, str], list[str], str]] = {
    "package that is not there": (ARM, {}, [], r"no package 'parts'.*--package /path/to/parts"),
    "argument of another name": (ARM, {"lenght": "1"}, ["elsewhere"], "did you mean 'length'"),
    "argument without a value": (NO_VALUE, {}, ["elsewhere"], "--xacro-arg NAME:=VALUE"),
    "value that is no number": (ARM, {"length": "long"}, ["elsewhere"], "length / 2"),
    "file that is not there": (NO_FILE, {}, ["elsewhere"], "limbs.xacro"),
    "macros alone": (LINKS, {}, [], "only defines macros"),
}


@pytest.mark.parametrize("kind", WRONG)
def test_what_is_missing_is_said_in_one_line(
    arm: Path, kind: str, capfd: pytest.CaptureFixture[str]
) -> None:
    text, arguments, folders, expected = WRONG[kind]
    arm.write_text(text)
    packages = [arm.parent.parent / folder for folder in folders]
    with pytest.raises(ExcitantError, match=expected) as refused:
        load_robot(arm, xacro_args=arguments, packages=packages)
    assert "bars.urdf.xacro" in str(refused.value)
    assert "\n" not in str(refused.value)
    assert capfd.readouterr().err == ""


def test_a_plain_urdf_takes_no_arguments(tmp_path: Path, gantry_urdf: str) -> None:
    path = tmp_path / "gantry.urdf"
    path.write_text(gantry_urdf)
    with pytest.raises(BadRobot, match="no xacro arguments"):
        load_robot(path, xacro_args={"length": "1"})


ESCAPES = {
    "frame": "(x for x in [1]).gi_frame",
    "class in a nested scope": "[c for c in [().__class__]][0].__base__",
    "lambda": "(lambda: ().__class__.__bases__)()",
    "name": "__builtins__",
    "format": "'{0.__class__}'.format(1)",
    "type": "python.type(1)",
    "vars": "python.vars(python.type(1))",
    "vars by key": "python['vars'](python['type'])['__subclasses__']",
    "method of a function": "python.abs.__self__",
    "builtin": "exec('import os; os.system(&quot;touch ran&quot;)')",
    "frames of a run": "[g.gi_frame.f_back.f_back for g in [0]]",
}


@pytest.mark.parametrize("form", ["${{{}}}", "$(eval {})"])
@pytest.mark.parametrize("escape", ESCAPES)
def test_an_expression_reaches_nothing_but_values(
    arm: Path, monkeypatch: pytest.MonkeyPatch, escape: str, form: str
) -> None:
    monkeypatch.chdir(arm.parent)
    arm.write_text(ARM.replace('mass="3"', f'mass="{form.format(ESCAPES[escape])}"'))
    with pytest.raises(BadRobot, match="xacro") as refused:
        load_robot(arm, packages=[arm.parent.parent / "elsewhere"])
    assert "\n" not in str(refused.value)
    assert not (arm.parent / "ran").exists()


@pytest.mark.parametrize(
    "expression",
    [
        "${props.mass * 2}",
        "${props['mass'] + 1.5}",
        "${[2 * x for x in [1.5]][0]}",
        "${dict(a=3)['a']}",
        "${math.sqrt(9)}",
        "${radians(180) / pi * 3}",
        "${float('a 3'.split()[1])}",
        "${max(3, float(xacro.arg('length')))}",
        "$(eval 2 * length + 2)",
        "$(eval max_mass if 2 > 1 else 0)",
        "${python.sum(x * scale for x in [1.5])}",
        "${type * vars}",
    ],
)
def test_expressions_of_values_are_evaluated(arm: Path, expression: str) -> None:
    (arm.parent / "props.yaml").write_text("mass: 1.5\n")
    arm.write_text(
        ARM.replace('mass="3"', f'mass="{expression}"').replace(
            '<link name="base"/>',
            '<xacro:arg name="max_mass" default="3"/><xacro:property name="scale" value="2"/>'
            '<xacro:property name="type" value="2"/><xacro:property name="vars" value="1.5"/>'
            """<xacro:property name="props" value="${xacro.load_yaml('props.yaml')}"/>"""
            '<link name="base"/>',
        )
    )
    robot = load_robot(arm, packages=[arm.parent.parent / "elsewhere"])
    assert robot.phi[0] == pytest.approx(3.0)
