"""Arms to state laws on: the built-in ones, and one with a sliding joint and fixed links."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from excitant.robots import Motion, Robot, load_robot
from excitant.robots.urdf import robot_from_urdf

GANTRY = """
<robot name="gantry">
  <link name="rail"><inertial><mass value="20"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0"
    izz="1"/></inertial></link>
  <link name="cart"><inertial><origin xyz="0.1 0.02 -0.05" rpy="0.1 0.2 0.3"/><mass value="4"/>
    <inertia ixx="0.04" ixy="0.001" ixz="0" iyy="0.05" iyz="0.002" izz="0.03"/></inertial></link>
  <link name="arm"><inertial><origin xyz="0.2 0 0"/><mass value="2"/>
    <inertia ixx="0.004" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial></link>
  <link name="box"><inertial><origin xyz="0 0.05 0.1" rpy="0.4 0 0"/><mass value="1.5"/>
    <inertia ixx="0.003" ixy="0" ixz="0.0001" iyy="0.004" iyz="0" izz="0.005"/></inertial></link>
  <link name="hand"><inertial><origin xyz="0 0 0.06"/><mass value="0.7"/>
    <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.0015"/></inertial></link>
  <link name="tip"/>
  <joint name="slide" type="prismatic"><parent link="rail"/><child link="cart"/>
    <origin xyz="0 0 1" rpy="0.3 0 0.2"/><axis xyz="0.6 0 0.8"/>
    <limit lower="-1" upper="1.5" velocity="2" effort="400"/></joint>
  <joint name="swing" type="continuous"><parent link="cart"/><child link="arm"/>
    <origin xyz="0 0.1 0" rpy="0 1.2 0"/><axis xyz="0 1 0"/></joint>
  <joint name="weld" type="fixed"><parent link="arm"/><child link="box"/>
    <origin xyz="0.3 0 0" rpy="0.2 -0.4 1"/></joint>
  <joint name="twist" type="revolute"><parent link="box"/><child link="hand"/>
    <origin xyz="0.1 0 0.05" rpy="1 0 0"/><axis xyz="0 0 -1"/>
    <limit lower="-2" upper="2.5" velocity="3" effort="30"/></joint>
  <joint name="end" type="fixed"><parent link="hand"/><child link="tip"/>
    <origin xyz="0 0 0.1"/></joint>
</robot>
"""


@pytest.fixture(scope="session")
def gantry_urdf() -> str:
    """Sliding, continuous and revolute joints, and links fixed to others that carry mass."""
    return GANTRY


@pytest.fixture(scope="session")
def gantry() -> Robot:
    return robot_from_urdf(GANTRY, source="gantry.urdf")


@pytest.fixture(scope="session")
def wedge() -> Callable[[Path], None]:
    """``wedge(path)`` writes a closed mesh of four faces as binary STL."""

    def write(path: Path) -> None:
        corners = np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.2, 0], [0.1, 0.1, 0.4]], np.float32)
        faces = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]
        triangles = (struct.pack("<12fH", 0, 0, 0, *corners[list(f)].ravel(), 0) for f in faces)
        path.write_bytes(bytes(80) + struct.pack("<I", 4) + b"".join(triangles))

    return write


KINDS = ("planar_2r", "scara", "ur10", "panda")
"""Two to seven joints, with a sliding one; `test_library` looks at every arm."""


@pytest.fixture(scope="session", params=[*KINDS, "gantry"])
def arm(request: pytest.FixtureRequest) -> Robot:
    if request.param == "gantry":
        return robot_from_urdf(GANTRY, source="gantry.urdf")
    return load_robot(request.param)


@pytest.fixture(scope="session", params=KINDS)
def builtin(request: pytest.FixtureRequest) -> Robot:
    return load_robot(request.param)


@pytest.fixture(scope="session")
def random_states() -> Callable[[Robot, int, int], Motion]:
    """``random_states(robot, seed, n)``: states without relation to one another."""

    def states(robot: Robot, seed: int, n: int) -> Motion:
        motion = robot.random_motion(np.random.default_rng(seed), n)
        return Motion(np.arange(n, dtype=float), *motion)

    return states
