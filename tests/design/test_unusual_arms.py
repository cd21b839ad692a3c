"""Arms that are not six revolute joints, and limits drawn at random."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from limit_use import assert_limits_hold

from excitant.design import design_trajectory
from excitant.exceptions import Infeasible
from excitant.robots import Array, Limits, Robot, load_robot

_LINK = """<link name="{name}"><inertial><origin xyz="{com}"/><mass value="{mass}"/>
<inertia ixx="{i}" iyy="{i}" izz="{i}" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
_JOINT = """<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{xyz}"/><axis xyz="{axis}"/>
<limit lower="{low}" upper="{high}" velocity="2" effort="{effort}"/></joint>"""


def arm_urdf(joints: list[dict[str, object]]) -> str:
    parts = ['<robot name="arm">', '<link name="base"/>']
    for k, joint in enumerate(joints):
        name = f"link{k + 1}"
        values = {"kind": "revolute", "parent": "base", "low": -2, "high": 2, "effort": 500}
        values |= {"axis": "0 0 1", "xyz": "0 0 0.3"} | joint
        parts.append(_LINK.format(name=name, com="0.05 0.02 0.1", mass=8 - 0.5 * k, i=0.2))
        parts.append(_JOINT.format(name=f"joint{k + 1}", child=name, **values))
    return "\n".join([*parts, "</robot>"])


def loaded(tmp_path: Path, joints: list[dict[str, object]]) -> Robot:
    path = tmp_path / "arm.urdf"
    path.write_text(arm_urdf(joints))
    return load_robot(path)


def test_three_joints_one_of_them_sliding(tmp_path: Path) -> None:
    robot = loaded(
        tmp_path,
        [
            {},
            {"kind": "prismatic", "parent": "link1", "low": 0.1, "high": 0.6, "axis": "0 0 1"},
            {"parent": "link2", "axis": "0 1 0", "xyz": "0.3 0 0"},
        ],
    )
    found = design_trajectory(robot, duration=5.0, harmonics=4, starts=2, jobs=1)
    assert found.condition_final < 0.5 * found.condition_initial
    assert_limits_hold(found)


def test_a_dual_arm_of_twelve_joints(tmp_path: Path) -> None:
    axes = ["0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0"]
    joints: list[dict[str, object]] = []
    for side, y in enumerate((0.3, -0.3)):
        for k, axis in enumerate(axes):
            parent = "base" if k == 0 else f"link{6 * side + k}"
            xyz = f"0 {y} 0.5" if k == 0 else "0.1 0 0.25"
            joints.append({"parent": parent, "axis": axis, "xyz": xyz})
    robot = loaded(tmp_path, joints)
    found = design_trajectory(
        robot, duration=10.0, harmonics=3, columns="inertial", starts=1, jobs=1, time_limit=5.0
    )
    assert robot.nv == 12
    assert len(found.base) > 60
    assert found.condition_final < 0.3 * found.condition_initial
    assert_limits_hold(found)


def drawn_limits(robot: Robot, rng: np.random.Generator) -> tuple[Limits, str]:
    """Limits, and the joint that cannot hold itself up under them, if any."""
    middle, half = rng.uniform(-0.8, 0.8, robot.nv), rng.uniform(0.05, 1.5, robot.nv)
    if rng.random() < 0.5:
        half *= 0.2
    position = np.column_stack([middle - half, middle + half])
    kinematic = [rng.uniform(0.3, 3.0, robot.nv), rng.uniform(1.0, 20.0, robot.nv)]
    still = np.abs(_gravity_torques(robot, position))
    need = still.min(axis=0)
    if rng.random() < 0.6 and need.max() > 1.0:
        j, limit = int(need.argmax()), np.full(robot.nv, 1e4)
        limit[j] = 0.9 * need[j]
        return Limits(position, *kinematic, limit), robot.joints[j]
    return Limits(position, *kinematic, 1.3 * still.max(axis=0) + 1.0), ""


def _gravity_torques(robot: Robot, position: Array) -> Array:
    grid = [np.linspace(low, high, 41) for low, high in position]
    poses = np.stack(np.meshgrid(*grid), axis=-1).reshape(-1, robot.nv)
    data = robot.model.createData()
    gravity = [pin.computeGeneralizedGravity(robot.model, data, q).copy() for q in poses]
    return np.array(gravity)


@pytest.mark.slow
def test_random_limits_hold_or_are_refused_by_name(planar: Robot) -> None:
    bare = planar.with_effects(())
    refused = 0
    for seed in range(80):
        rng = np.random.default_rng(seed)
        limits, culprit = drawn_limits(bare, rng)
        robot = bare.with_limits(limits)
        options = {"duration": 6.0, "harmonics": 4, "columns": "inertial", "starts": 1, "jobs": 1}
        if culprit:
            refused += 1
            with pytest.raises(Infeasible, match=f"torque limit of {culprit}"):
                design_trajectory(robot, seed=seed, **options)  # type: ignore[arg-type]
            continue
        found = design_trajectory(robot, seed=seed, **options)  # type: ignore[arg-type]
        assert_limits_hold(found)
    assert 8 < refused < 48
