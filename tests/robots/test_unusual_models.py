"""Descriptions as vendors write them: equal names, no name, meshes, loops."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import numpy as np
import pytest

from excitant.exceptions import BadRobot
from excitant.robots import Motion, Robot, load_robot, rigid_body_torque
from excitant.robots.geometry import scene
from excitant.robots.urdf import robot_from_urdf, urdf_with_parameters


def states(robot: Robot) -> Motion:
    return Motion(np.arange(8.0), *robot.random_motion(np.random.default_rng(0), 8))


def test_links_may_be_called_as_joints(gantry: Robot, gantry_urdf: str) -> None:
    """Names of links change nothing, even where Pinocchio cannot hold two of one name."""
    text = gantry_urdf
    for link, joint in (("cart", "slide"), ("arm", "swing"), ("hand", "twist")):
        text = re.sub(rf'(link(?: name)?=?"?){link}"', rf'\g<1>{joint}"', text)
    assert '<link name="slide">' in text
    robot = robot_from_urdf(text, source="same.urdf", lock={"swing": 0.3})
    assert robot.joints == robot.links == ("slide", "twist")
    part = robot_from_urdf(gantry_urdf, source="gantry.urdf", lock={"swing": 0.3})
    motion = states(part)
    tau = rigid_body_torque(part, motion)
    assert np.abs(rigid_body_torque(robot, motion) - tau).max() <= 1e-12 * np.abs(tau).max()
    written = robot_from_urdf(
        urdf_with_parameters(robot, robot.phi), source="written", lock={"swing": 0.3}
    )
    assert np.abs(rigid_body_torque(written, motion) - tau).max() <= 1e-9 * np.abs(tau).max()


def test_a_robot_without_a_name_is_called_as_its_file(tmp_path: Path, gantry_urdf: str) -> None:
    path = tmp_path / "unnamed.urdf"
    path.write_text(gantry_urdf.replace('<robot name="gantry">', "<robot>"))
    assert load_robot(path).name == "unnamed"


def test_a_file_without_links_is_said_to_have_none() -> None:
    with pytest.raises(BadRobot, match="no <link>"):
        robot_from_urdf('<robot name="empty"/>', source="empty.urdf")


def test_a_link_that_hangs_from_two_joints_is_refused(gantry_urdf: str) -> None:
    second = (
        '<joint name="brace" type="revolute"><parent link="rail"/><child link="hand"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
    )
    with pytest.raises(BadRobot, match="'hand' hangs from two joints, 'twist' and 'brace'"):
        robot_from_urdf(gantry_urdf.replace("</robot>", second), source="loop.urdf")


def wedge(path: Path) -> None:
    """A tetrahedron as binary STL."""
    corners = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.3]], np.float32)
    faces = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]
    triangles = (struct.pack("<12fH", 0, 0, 0, *corners[list(f)].ravel(), 0) for f in faces)
    path.write_bytes(bytes(80) + struct.pack("<I", 4) + b"".join(triangles))


def test_meshes_beside_the_file_are_found_from_anywhere(
    tmp_path: Path, gantry_urdf: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "model" / "meshes").mkdir(parents=True)
    wedge(tmp_path / "model" / "meshes" / "wedge.stl")
    shape = '<collision><geometry><mesh filename="meshes/wedge.stl"/></geometry></collision></link>'
    path = tmp_path / "model" / "gantry.urdf"
    path.write_text(gantry_urdf.replace("</link>", shape))
    monkeypatch.chdir(tmp_path)
    found = scene(load_robot(path))
    assert found is not None
    gap = found.distances(states(found.robot).q)
    assert np.isfinite(gap).all()
    path.write_text(gantry_urdf.replace("</link>", shape.replace("wedge", "gone")))
    assert scene(load_robot(path)) is None
