"""Structural identifiability: three independent methods agree, and circumstances count."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from arms import data_folder
from hypothesis import given
from hypothesis import strategies as st
from khosla import dh_from_robot
from second_opinion import grouping, into_previous, largest_count, parameter_nullspace

from excitant.analysis.structure import HAIR, Structure, structure
from excitant.exceptions import BadInput, UnknownName
from excitant.robots import (
    DHChain,
    Robot,
    base_parameters,
    builtin_robots,
    load_robot,
    robot_from_dh,
)
from excitant.robots.base_parameters import LENGTH_POWERS, arm_length
from excitant.robots.chains import RobotSpec
from excitant.robots.effects import standard_effects
from excitant.robots.parameters import moved_parameters
from excitant.robots.urdf import robot_from_urdf

SEEDS = st.integers(0, 2**32 - 1)
SAME = 1e-8  # rad: null spaces from columns known to 1e-13, gaps of 1e-4 at least
GRAVITIES = [None, (0.0, 0.0, 0.0), (1.0, 2.0, -9.0), (0.0, -9.81, 0.0)]

KINDS = ("planar_2r", "cylindrical", "scara", "puma560", "ur10", "panda", "cmu_dd_arm_ii")


def body(rng: np.random.Generator, nv: int) -> np.ndarray:
    """Masses at random points: consistent parameters."""
    phi = np.zeros((nv, 10))
    for point, mass in zip(rng.uniform(-0.3, 0.3, (8, nv, 3)), rng.uniform(0.1, 2, 8), strict=True):
        x, y, z = point.T
        phi += mass * np.column_stack(
            [np.ones(nv), x, y, z, y**2 + z**2, -x * y, x**2 + z**2, -x * z, -y * z, x**2 + y**2]
        )
    return phi.ravel()


def chain(seed: int, nv: int, special: bool, prismatic: float = 0.3) -> DHChain:
    """Joints of both kinds; axes at right angles and coincident axes when special."""
    rng = np.random.default_rng(seed)
    angles = rng.choice([0.0, np.pi / 2, -np.pi / 2, np.pi], (2, nv))
    alpha, theta = angles if special else rng.uniform(-3, 3, (2, nv))
    lengths = rng.choice([0.0, 0.3, -0.4], (2, nv)) if special else rng.uniform(-0.5, 0.5, (2, nv))
    gravity = [(0, 0, -9.81), (0, 0, 0), (3, 1, -9)][rng.integers(3)] if special else (2, -4, 8)
    return DHChain(
        name="chain",
        convention="modified",
        joints=tuple(f"j{i}" for i in range(nv)),
        links=tuple(f"l{i}" for i in range(nv)),
        revolute=rng.random(nv) >= prismatic,
        a=lengths[0] * (np.arange(nv) > 0),
        d=lengths[1],
        alpha=alpha * (np.arange(nv) > 0),
        theta=theta,
        phi=body(rng, nv),
        gravity=np.array(gravity, float),
        base=np.eye(4),
        tool=np.eye(4),
    )


def scaled(given: DHChain, length: float, mass: float, gravity: float = 1.0) -> Robot:
    """The chain in other units."""
    places = np.array([given.base, given.tool])
    places[:, :3, 3] *= length
    return robot_from_dh(
        replace(
            given,
            a=given.a * length,
            d=given.d * length,
            phi=given.phi * np.tile(mass * length**LENGTH_POWERS, given.nv),
            gravity=given.gravity * gravity,
            base=places[0],
            tool=places[1],
            shapes=(),
        )
    )


def angle_between_methods(robot: Robot, moving: Any = None, held: Any = None) -> float:
    """Largest angle between the null spaces of the regressor and of the recursion [rad]."""
    base = structure(robot, moving=moving, measured=moving, held=held).base
    other = parameter_nullspace(robot, moving=moving, held=held)
    return other.angle(base.null_space, arm_length(robot))


def some(robot: Robot, rng: np.random.Generator) -> tuple[list[str], dict[str, float]]:
    """Joints that move, and where the others are."""
    moving = [name for name in robot.joints if rng.random() < 0.5] or [robot.joints[-1]]
    return moving, {n: float(rng.uniform(-1, 1)) for n in robot.joints if n not in moving}


@pytest.mark.parametrize("gravity", GRAVITIES)
@pytest.mark.parametrize("name", KINDS)
def test_recursion_and_regressor_agree(name: str, gravity: tuple[float, ...] | None) -> None:
    robot = load_robot(name)
    robot = robot if gravity is None else robot.with_gravity(gravity)
    assert angle_between_methods(robot) < SAME


@given(seed=SEEDS, nv=st.integers(1, 7), special=st.booleans())
def test_three_methods_agree_on_random_chains(seed: int, nv: int, special: bool) -> None:
    given_chain = chain(seed, nv, special)
    robot = robot_from_dh(given_chain)
    base, other = base_parameters(robot), parameter_nullspace(robot)
    assert len(base) == len(other)
    assert other.angle(base.null_space, arm_length(robot)) < SAME
    if given_chain.gravity.any():
        rules = grouping(robot)
        assert rules.shown == other.shown
        assert other.angle(rules.basis, arm_length(robot)) < SAME


@given(seed=SEEDS, nv=st.integers(2, 6), special=st.booleans(), any_pose=st.booleans())
def test_held_joints_in_both_methods(seed: int, nv: int, special: bool, any_pose: bool) -> None:
    robot = robot_from_dh(chain(seed, nv, special))
    moving, pose = some(robot, np.random.default_rng(seed))
    assert angle_between_methods(robot, moving, "any" if any_pose else pose) < SAME


def branched(seed: int, nv: int) -> Robot:
    """An arm whose joints hang from any one before them, or from the base."""
    rng = np.random.default_rng(seed)
    links, joints = ['<link name="base"/>'], []
    for k in range(nv):
        parent, kind = int(rng.integers(-1, k)), rng.choice(["revolute", "revolute", "prismatic"])
        axis = np.eye(3)[rng.integers(3)] if rng.random() < 0.6 else rng.normal(size=3)
        xyz, rpy = rng.choice([0.0, 0.3, -0.2], 3), rng.choice([0.0, np.pi / 2, 0.7], 3)
        links.append(
            f'<link name="l{k}"><inertial><origin xyz="0.1 0.05 0.1"/><mass value="2"/>'
            '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        )
        joints.append(
            f'<joint name="j{k}" type="{kind}"><child link="l{k}"/>'
            f'<parent link="{"base" if parent < 0 else f"l{parent}"}"/>'
            f'<origin xyz="{" ".join(map(str, xyz))}" rpy="{" ".join(map(str, rpy))}"/>'
            f'<axis xyz="{" ".join(map(str, axis / np.linalg.norm(axis)))}"/>'
            '<limit lower="-2" upper="2" velocity="1" effort="1"/></joint>'
        )
    text = f'<robot name="tree">{"".join((*links, *joints))}</robot>'
    return robot_from_urdf(text, source="tree.urdf", gravity=(0, 0, -9.81 * (seed % 3 > 0)))


@given(seed=SEEDS, nv=st.integers(2, 6), held=st.sampled_from([None, "any", "pose"]))
def test_branched_arms_in_both_methods(seed: int, nv: int, held: str | None) -> None:
    robot = branched(seed, nv)
    moving, pose = some(robot, np.random.default_rng(seed))
    angle = angle_between_methods(robot, moving if held else None, pose if held == "pose" else held)
    assert angle < SAME


@pytest.mark.parametrize(
    ("name", "per_link"),
    [
        ("planar_2r", (3, 3)),
        ("ur10", (1, 7, 7, 7, 7, 7)),
        ("puma560", (1, 7, 7, 7, 7, 7)),
        ("panda", (1, 7, 7, 7, 7, 7, 7)),
        ("cylindrical", (1, 1, 3)),
        ("cmu_dd_arm_ii", (1, 3, 7, 7, 7, 7)),
    ],
)
def test_what_each_link_brings(name: str, per_link: tuple[int, ...]) -> None:
    robot = load_robot(name)
    assert parameter_nullspace(robot).shown == per_link
    assert grouping(robot).shown == per_link
    assert len(base_parameters(robot)) == sum(per_link)


@pytest.mark.parametrize("name", ["puma560", "ur10", "panda"])
@pytest.mark.parametrize("gravity", [(0.0, 0.0, -9.81), (3.0, 0.0, -9.0)])
def test_the_count_formula(name: str, gravity: tuple[float, ...]) -> None:
    robot = load_robot(name).with_gravity(gravity)
    upright = gravity[0] == 0
    assert len(grouping(robot)) == largest_count(robot.nv, 0, first_along_gravity=upright)


@given(seed=SEEDS, nv=st.integers(1, 7), special=st.booleans())
def test_no_chain_exceeds_the_count_formula(seed: int, nv: int, special: bool) -> None:
    given_chain = chain(seed, nv, special)
    revolute = int(given_chain.revolute.sum())
    if revolute:
        count = len(parameter_nullspace(robot_from_dh(given_chain)))
        assert count <= largest_count(revolute, nv - revolute, first_along_gravity=False)


@given(seed=SEEDS)
def test_published_relations_move_parameters(seed: int) -> None:
    given_chain = chain(seed, 2, seed % 2 == 0, prismatic=0.0)
    YY, MZ, M = np.random.default_rng(seed).standard_normal(3)
    phi = np.array([[M, 0, 0, MZ, YY, 0, YY, 0, 0, 0.0]])
    pose = given_chain.poses(np.zeros((1, 2)))[0, 1:]
    expected = moved_parameters(phi, pose)
    np.testing.assert_allclose(into_previous(given_chain, 1, phi), expected, atol=1e-12)


def test_rules_need_gravity_unless_all_axes_are_parallel(ur10: Robot, planar: Robot) -> None:
    with pytest.raises(BadInput, match="without gravity"):
        grouping(ur10.with_gravity((0, 0, 0)))
    assert len(grouping(planar.with_gravity((0, 0, 0)))) == 4


@pytest.mark.parametrize("name", KINDS)
def test_categories_do_not_depend_on_units(name: str) -> None:
    arm = dh_from_robot(load_robot(name))
    robots = [scaled(arm, 1, 1), scaled(arm, 1e-3, 1e-3), scaled(arm, 1e3, 1, 1e3)]
    effects = standard_effects(arm.joints)
    for chosen in ((), effects):
        metres, *others = (structure(robot, chosen) for robot in robots)
        for other in others:
            assert other.category == metres.category
            assert other.base.columns == metres.base.columns
            assert not other.close


@pytest.mark.parametrize("name", builtin_robots())
def test_nothing_is_decided_by_a_hair_on_arms_of_exact_geometry(name: str) -> None:
    robot = load_robot(name)
    found = structure(robot, standard_effects(robot.joints))
    assert found.close == ()
    assert (found.margin == HAIR).all()
    assert found.marginal is None


@pytest.mark.parametrize("angle", [1e-5, 1e-6, 1e-7, 1e-9, 1e-10])
def test_a_twist_just_off_a_right_angle_is_by_a_hair(angle: float) -> None:
    arm = dh_from_robot(load_robot("ur10"))
    assert abs(abs(arm.alpha[4]) - np.pi / 2) < 1e-12
    found = structure(robot_from_dh(replace(arm, alpha=arm.alpha + angle * (np.arange(6) == 4))))
    assert found.close == ("wrist_1_link.Iyz",)
    k = found.base.names.index("wrist_1_link.Iyz")
    assert found.category[k] == ("combined" if angle > 1e-8 else "unique")
    assert found.flips_at[k] == pytest.approx(angle, rel=3)  # a decision scales with the angle
    assert "wrist_1_link.Iyz" in found.marginal


@pytest.mark.parametrize("tilt", [1e-6, 1e-9])
def test_a_base_just_off_upright_is_by_a_hair(ur10: Robot, tilt: float) -> None:
    found = structure(ur10.with_gravity(9.81 * np.array([tilt, 0.3 * tilt, -1.0])))
    assert {"shoulder_link.mcx", "shoulder_link.mcy"} <= set(found.close)
    assert len(found.base) == (38 if tilt > 1e-8 else 36)
    assert structure(ur10.with_gravity((0.1, 0.03, -9.8))).close == ()


def test_nearly_parallel_axes_are_by_a_hair(planar: Robot) -> None:
    arm = dh_from_robot(planar)
    assert structure(robot_from_dh(arm)).close == ()
    bent = structure(robot_from_dh(replace(arm, alpha=arm.alpha + np.array([0, 1e-6]))))
    assert {"link2.mcz", "link2.Iyz"} & set(bent.close)
    assert bent.base.gap[0] < 1e-5
    wide = structure(robot_from_dh(replace(arm, alpha=arm.alpha + np.array([0, 0.3]))))
    assert wide.close == ()


def evaluated(text: str, values: Mapping[str, float]) -> float:
    """Value of an expression with names by their values."""
    text = re.sub(r"[A-Za-z_]\w*\.\w+", lambda name: str(values[name[0]]), text)
    return float(eval(text.translate(str.maketrans({"−": "-", "·": "*", "²": "**2"}))))


@pytest.mark.parametrize("name", KINDS)
def test_expressions_say_what_the_matrix_says(name: str) -> None:
    base = base_parameters(load_robot(name))
    phi = np.random.default_rng(0).uniform(0.5, 2, len(base.names))
    values = dict(zip(base.names, phi, strict=True))
    for row, text in zip(base.regrouping, base.expressions, strict=True):
        assert abs(evaluated(text, values) - row @ phi) <= 5e-5 * (np.abs(row) @ phi)  # five digits


def test_one_joint_at_a_time_on_the_dd_arm() -> None:
    """One joint moves, its own torque is read: 14 in one pose (3 + 3 + 3 + 3 + 1 + 1)."""
    robot = load_robot("cmu_dd_arm_ii")
    pose = dict(zip(robot.joints, (0.3, -0.7, 0.9, 0.5, -1.1, 0.4), strict=True))
    counts = [
        len(structure(robot, moving=[joint], measured=[joint], held=pose).base)
        for joint in robot.joints
    ]
    assert counts == [1, 1, 3, 3, 3, 3]


@pytest.mark.parametrize(("inner", "together"), [(False, 30), (True, 32)])
def test_one_joint_at_a_time_in_many_poses(inner: bool, together: int) -> None:
    """Six recordings, one joint moving in each: its own torque alone misses two combinations."""
    robot = load_robot("cmu_dd_arm_ii")
    rows = [
        structure(
            robot, moving=[joint], measured=robot.joints[: i + 1] if inner else [joint], held="any"
        ).base.regrouping
        for i, joint in enumerate(robot.joints)
    ]
    assert np.linalg.matrix_rank(np.vstack(rows), tol=1e-8) == together


def shown_of(found: Structure) -> set[str]:
    pairs = zip(found.base.names, found.category, strict=True)
    return {name for name, kind in pairs if kind != "unidentifiable"}


def test_the_last_torque_shows_the_last_link_alone(ur10: Robot) -> None:
    found = structure(ur10, measured=[ur10.joints[-1]])
    shown = shown_of(found)
    assert {name.rpartition(".")[0] for name in shown} == {ur10.links[-1]}
    assert len(found.base) == parameter_nullspace(ur10).shown[-1]
    assert "torque of joints" in found.circumstances[-1]


def test_circumstances_are_said(ur10: Robot) -> None:
    still = [joint for joint in ur10.joints if joint != "elbow_joint"]
    found = structure(ur10, moving=["elbow_joint"], held={"wrist_1_joint": 0.5})
    assert found.circumstances[:2] == ("the base is fixed", "gravity along −z of the base")
    assert found.circumstances[2].startswith("joints shoulder_pan_joint at 0, ")
    assert "wrist_1_joint at 0.5" in found.circumstances[2]
    many = structure(ur10, moving=["elbow_joint"], held="any")
    assert many.circumstances[2] == f"joints {', '.join(still)} at rest at many positions"
    assert len(many.base) > len(found.base)
    locked = structure(load_robot("ur10", lock={"elbow_joint": 1.0}).with_gravity((0, 0, 0)))
    assert "no gravity" in locked.circumstances
    assert "joint elbow_joint at 1 locked" in locked.circumstances


def test_at_rest_only_gravity_speaks(ur10: Robot) -> None:
    found = structure(ur10, moving=[], held="any")
    shown = shown_of(found)
    assert shown
    assert not any(".I" in name for name in shown)
    assert len(structure(ur10.with_gravity((0, 0, 0)), moving=[], held="any").base) == 0


def test_fewer_joints_show_no_more() -> None:
    robot = load_robot("panda")
    every = structure(robot)
    for joint in robot.joints:
        moving = [name for name in robot.joints if name != joint]
        fewer = structure(robot, moving=moving, held="any")
        assert len(fewer.base) <= len(every.base)
        # what the whole motion does not show, part of it does not either
        assert np.abs(fewer.base.regrouping @ every.base.null_space).max() < 1e-9


def test_unknown_joints_are_refused(ur10: Robot) -> None:
    for joints in ({"moving": ["elbow"]}, {"measured": ["elbow"]}):
        with pytest.raises(UnknownName, match="elbow"):
            structure(ur10, **joints)
    with pytest.raises(UnknownName, match="elbow"):
        parameter_nullspace(ur10, moving=[], held={"elbow": 1.0})


def test_branches_are_counted() -> None:
    body = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    text = '<robot name="fork"><link name="root"/>'
    for parent, child, axis in (("root", "x", "0 0 1"), ("x", "y", "0 1 0"), ("x", "z", "1 0 0")):
        text += (
            f'<link name="{child}">{body}</inertial></link><joint name="to_{child}" '
            f'type="revolute"><parent link="{parent}"/><child link="{child}"/><axis xyz="{axis}"/>'
            '<limit lower="-1" upper="1" velocity="1" effort="1"/></joint>'
        )
    robot = robot_from_urdf(f"{text}</robot>", RobotSpec("fork.urdf"))
    assert len(structure(robot).base) == 15
    assert parameter_nullspace(robot).shown == (1, 7, 7)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "joints", "count"),
    [
        ("ur_description/urdf/ur5_robot.urdf", 6, 36),
        ("ur_description/urdf/ur10_robot.urdf", 6, 36),
        ("kinova_description/robots/kinova.urdf", 6, 36),
        ("panda_description/urdf/panda.urdf", 7, 43),
        ("xarm_description/urdf/xarm7.urdf", 7, 43),
        ("talos_data/robots/talos_left_arm.urdf", 7, 45),
    ],
)
def test_arms_of_example_robot_data(file: str, joints: int, count: int) -> None:
    folder = data_folder(None)
    if folder is None:
        pytest.skip("example-robot-data is not installed and EXAMPLE_ROBOT_DATA names no folder")
    text = (folder / file).read_text(encoding="utf-8")
    names = robot_from_urdf(text, source=file).joints[:joints]
    robot = robot_from_urdf(text, RobotSpec(file, joints=tuple(names)))
    assert len(structure(robot).base) == count
    assert angle_between_methods(robot) < 1e-6
