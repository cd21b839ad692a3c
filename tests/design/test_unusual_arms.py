"""Arms that are not six revolute joints, and limits drawn at random."""

import itertools

import numpy as np
import pinocchio as pin
import pytest
from limit_use import assert_limits_hold, limited
from urdf_arms import urdf_of

from excitant.design import design_trajectory
from excitant.exceptions import Infeasible
from excitant.robots import Robot
from excitant.robots.urdf import robot_from_urdf


def arm(*joints: dict[str, object]) -> Robot:
    heavy = ({"mass": 8.5 - 0.5 * k} | joint for k, joint in enumerate(joints, start=1))
    return robot_from_urdf(urdf_of(*heavy, inertia=0.2, effort=500), source="arm.urdf")


def test_three_joints_one_of_them_sliding() -> None:
    slide = {"kind": "prismatic", "low": 0.1, "high": 0.6}
    robot = arm({}, slide, {"axis": "0 1 0", "xyz": "0.3 0 0"})
    found = design_trajectory(robot, duration=5.0, harmonics=3, starts=1, jobs=1)
    assert found.condition_final < 0.5 * found.condition_initial
    assert_limits_hold(found)


@pytest.mark.usefixtures("own_time")
@pytest.mark.slow
def test_a_dual_arm_of_twelve_joints() -> None:
    axes = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
    joints = [{"axis": axis, "xyz": "0.1 0 0.25"} for axis in axes * 2]
    joints[0]["xyz"] = "0 0.3 0.5"
    joints[6] |= {"xyz": "0 -0.3 0.5", "parent": 0}
    robot = arm(*joints)
    options = {"harmonics": 3, "columns": "inertial", "starts": 1, "jobs": 1, "time_limit": 5.0}
    found = design_trajectory(robot, duration=10.0, **options)
    assert robot.nv == 12
    assert len(found.base) > 60
    assert found.condition_final < 0.3 * found.condition_initial
    assert_limits_hold(found)


def drawn_limits(robot: Robot, rng: np.random.Generator) -> tuple[Robot, str]:
    """The robot with other limits, and the joint that they leave too weak to hold itself up."""
    middle, half = rng.uniform(-0.8, 0.8, robot.nv), rng.uniform(0.05, 1.5, robot.nv)
    if rng.random() < 0.5:
        half *= 0.2
    position = np.column_stack([middle - half, middle + half])
    velocity, acceleration = rng.uniform(0.3, 3.0, robot.nv), rng.uniform(1.0, 20.0, robot.nv)
    robot = limited(robot, position=position, velocity=velocity, acceleration=acceleration)
    poses = itertools.product(*(np.linspace(low, high, 41) for low, high in position))
    data = robot.model.createData()
    still = np.abs([
        pin.computeGeneralizedGravity(robot.model, data, np.array(q)).copy() for q in poses
    ])  # fmt: skip
    need = still.min(axis=0)
    if rng.random() < 0.6 and need.max() > 1.0:
        j, torque = int(need.argmax()), np.full(robot.nv, 1e4)
        torque[j] = 0.9 * need[j]
        return limited(robot, torque=torque), robot.joints[j]
    return limited(robot, torque=1.3 * still.max(axis=0) + 1.0), ""


@pytest.mark.slow
def test_random_limits_hold_or_are_refused_by_name(planar: Robot) -> None:
    refused = 0
    options = {"duration": 6.0, "harmonics": 4, "columns": "inertial", "starts": 1, "jobs": 1}
    for seed in range(40):
        robot, culprit = drawn_limits(planar.with_effects(()), np.random.default_rng(seed))
        if culprit:
            refused += 1
            with pytest.raises(Infeasible, match=f"torque limit of {culprit}"):
                design_trajectory(robot, seed=seed, **options)
        else:
            assert_limits_hold(design_trajectory(robot, seed=seed, **options))
    assert 4 < refused < 24
