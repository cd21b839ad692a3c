"""Structural identifiability: two independent methods agree, and circumstances count."""

import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from arms import data_folder
from hypothesis import given
from hypothesis import strategies as st
from khosla import dh_from_robot, joint_axes
from marks import slow
from second_opinion import parameter_nullspace
from urdf_arms import urdf_of

from excitant.analysis import analyze
from excitant.analysis.structure import MARGIN, Structure, distal_frames, structure
from excitant.exceptions import BadInput
from excitant.identify.prior import reference_motion
from excitant.robots import DHChain, Robot, builtin_robots, load_robot, robot_from_dh
from excitant.robots.base_parameters import LENGTH_POWERS, TOLERANCE, arm_length, base_parameters
from excitant.robots.chains import RobotSpec
from excitant.robots.dh import joint_frames
from excitant.robots.effects import standard_effects
from excitant.robots.urdf import robot_from_urdf

SEEDS = st.integers(0, 2**32 - 1)
SAME = 1e-8  # rad: null spaces from columns known to 1e-13, gaps of 1e-4 at least
KINDS = ("planar_2r", "cylindrical", "scara", "puma560", "ur10", "panda", "cmu_dd_arm_ii")


def special(chain: DHChain, seed: int) -> DHChain:
    """The chain with right angles, coincident axes, and gravity along an axis, across or none."""
    rng, later = np.random.default_rng(seed), np.arange(chain.nv) > 0
    alpha, theta = rng.choice([0.0, np.pi / 2, -np.pi / 2, np.pi], (2, chain.nv))
    a, d = rng.choice([0.0, 0.3, -0.4], (2, chain.nv))
    gravity = np.array([(0.0, 0.0, -9.81), (0.0, 0.0, 0.0), (3.0, 1.0, -9.0)][rng.integers(3)])
    places = {"a": a * later, "d": d, "alpha": alpha * later, "theta": theta}
    return replace(chain, **places, gravity=gravity, base=np.eye(4), tool=np.eye(4))


def tree(*joints: tuple[Any, ...], gravity: float = 9.81) -> Robot:
    """Links at joints (parent, kind, axis, xyz, rpy), numbered as they come from 1."""
    links = []
    for parent, kind, *numbers in joints:
        places = zip(("axis", "xyz", "rpy"), numbers, strict=True)
        texts = {name: " ".join(map(str, each)) for name, each in places}
        links.append({"parent": parent, "kind": kind} | texts)
    text = urdf_of(*links, com="0.1 0.05 0.1", mass=2, inertia=1)
    return robot_from_urdf(text, source="tree.urdf", gravity=(0, 0, -gravity))


def branched(seed: int, nv: int) -> Robot:
    """An arm whose joints hang from any one before them, or from the base."""
    rng, joints = np.random.default_rng(seed), []
    for k in range(nv):
        kind = rng.choice(["revolute", "revolute", "prismatic"])
        axis = np.eye(3)[rng.integers(3)] if rng.random() < 0.6 else rng.normal(size=3)
        xyz, rpy = rng.choice([0.0, 0.3, -0.2], 3), rng.choice([0.0, np.pi / 2, 0.7], 3)
        joints.append((rng.integers(0, k + 1), kind, axis / np.linalg.norm(axis), xyz, rpy))
    return tree(*joints, gravity=9.81 * (seed % 3 > 0))


def angle_between_methods(robot: Robot, moving: Any = None, anywhere: bool = False) -> float:
    """Largest angle between the null spaces of the regressor and of the recursion [rad]."""
    base = structure(robot, moving=moving, measured=moving, anywhere=anywhere).base
    other = parameter_nullspace(robot, moving=moving, anywhere=anywhere)
    return other.angle(base.null_space, arm_length(robot))


@given(seed=SEEDS, nv=st.integers(1, 7), right=st.booleans())
def test_both_methods_agree_on_random_chains(random_chain, seed, nv, right):
    chain = random_chain(seed, nv, "modified")
    chain = special(chain, seed) if right else chain
    robot = robot_from_dh(chain)
    base, other = base_parameters(robot), parameter_nullspace(robot)
    assert len(base) == len(other)
    assert other.angle(base.null_space, arm_length(robot)) < SAME


@pytest.mark.parametrize("kind", ["general", "special", "branched"])
@given(seed=SEEDS, nv=st.integers(2, 6), held=st.sampled_from(["none", "anywhere", "zero"]))
def test_held_joints_in_both_methods(random_chain, kind, seed, nv, held):
    chain = random_chain(seed, nv, "modified")
    chain = special(chain, seed) if kind == "special" else chain
    robot = branched(seed, nv) if kind == "branched" else robot_from_dh(chain)
    rng, moving = np.random.default_rng(seed), None
    if held != "none":
        moving = [name for name in robot.joints if rng.random() < 0.5] or [robot.joints[-1]]
    assert angle_between_methods(robot, moving, held == "anywhere") < SAME


@pytest.mark.parametrize(
    ("name", "per_link"),
    [
        ("planar_2r", (3, 3)),
        ("ur10", (1, 7, 7, 7, 7, 7)),
        ("puma560", (1, 7, 7, 7, 7, 7)),
        ("panda", (1, 7, 7, 7, 7, 7, 7)),
        ("cylindrical", (1, 1, 3)),
        ("scara", (1, 3, 1, 3)),
        ("cmu_dd_arm_ii", (1, 3, 7, 7, 7, 7)),
    ],
)
def test_what_each_link_brings(name: str, per_link: tuple[int, ...]) -> None:
    robot = load_robot(name)
    assert parameter_nullspace(robot).shown == per_link
    assert len(base_parameters(robot)) == sum(per_link)
    for gravity in (robot.gravity, (0, 0, 0), (1.0, 2.0, -9.0), (0, -9.81, 0)):
        assert angle_between_methods(robot.with_gravity(gravity)) < SAME


def test_branches_are_counted() -> None:
    fork = zip((0, 1, 1), np.eye(3)[[2, 1, 0]], strict=True)
    robot = tree(*((on, "revolute", axis, np.zeros(3), np.zeros(3)) for on, axis in fork))
    assert len(structure(robot).base) == 15
    assert parameter_nullspace(robot).shown == (1, 7, 7)


def scaled(given: DHChain, length: float, mass: float, gravity: float = 1.0) -> Robot:
    """The chain in other units."""
    grow = np.diag([length, length, length, 1.0])
    base, tool = (grow @ T @ np.linalg.inv(grow) for T in (given.base, given.tool))
    phi = given.phi * np.tile(mass * length**LENGTH_POWERS, given.nv)
    places = {"a": given.a * length, "d": given.d * length, "base": base, "tool": tool}
    units = {"phi": phi, "gravity": given.gravity * gravity}
    return robot_from_dh(replace(given, **places, **units, shapes=()))


@pytest.mark.parametrize("name", [*KINDS[:3], *map(slow, KINDS[3:])])
def test_categories_do_not_depend_on_units(name: str) -> None:
    arm = dh_from_robot(load_robot(name))
    robots = [scaled(arm, 1, 1), scaled(arm, 1e-3, 1e-3), scaled(arm, 1e3, 1, 1e3)]
    for effects in ((), standard_effects(arm.joints)):
        metres, *others = (structure(robot, effects) for robot in robots)
        for other in others:
            found = (other.category, other.base.columns, other.close)
            assert found == (metres.category, metres.base.columns, ())


@pytest.mark.parametrize("name", builtin_robots())
def test_nothing_is_marginal_on_arms_of_exact_geometry(name: str) -> None:
    robot = load_robot(name)
    found = structure(robot, standard_effects(robot.joints))
    assert (found.close, found.marginal) == ((), None)
    assert (found.margin == MARGIN).all()


def twisted(robot: Robot, joint: int, angle: float) -> Structure:
    """The arm with one axis turned out of its place."""
    arm = dh_from_robot(robot)
    return structure(robot_from_dh(replace(arm, alpha=arm.alpha + angle * np.eye(arm.nv)[joint])))


@pytest.mark.parametrize("angle", [1e-3, 1e-4, 1e-5, 1e-7, 1e-8])
def test_a_twist_just_off_a_right_angle_is_marginal(ur10: Robot, angle: float) -> None:
    found = twisted(ur10, 4, angle)
    assert found.close == ("wrist_1_link.Iyz",)
    k = found.base.names.index("wrist_1_link.Iyz")
    assert found.category[k] == ("combined" if angle > TOLERANCE else "unique")
    assert found.flips_at[k] == pytest.approx(angle, rel=3)  # a decision scales with the angle
    assert "wrist_1_link.Iyz" in found.marginal


@pytest.mark.parametrize("tilt", [1e-4, 1e-7])
def test_a_base_just_off_upright_is_marginal(ur10: Robot, tilt: float) -> None:
    found = structure(ur10.with_gravity(9.81 * np.array([tilt, 0.3 * tilt, -1.0])))
    assert {"shoulder_link.mcx", "shoulder_link.mcy"} <= set(found.close)
    assert len(found.base) == (38 if tilt > TOLERANCE else 36)
    assert structure(ur10.with_gravity((0.1, 0.03, -9.8))).close == ()


@pytest.mark.parametrize("name", ["planar_2r", "puma560", "ur10"])
@pytest.mark.parametrize("error", [2.7e-8, 1e-7])  # of an angle in seven digits, and more
def test_rounded_geometry_has_the_structure_of_the_exact_one(name: str, error: float) -> None:
    exact, rng = load_robot(name), np.random.default_rng(0)
    model = exact.model.copy()
    for k in range(1, model.njoints):
        place = model.jointPlacements[k]
        turned = place.rotation @ pin.exp3(error * rng.standard_normal(3))
        shifted = place.translation + error * rng.standard_normal(3)
        model.jointPlacements[k] = pin.SE3(turned, shifted)
    found, true = structure(replace(exact, model=model)), structure(exact)
    assert (found.category, found.base.columns) == (true.category, true.base.columns)
    assert found.base.gap[0] > 1e4 * found.base.gap[1]


def test_nearly_parallel_axes_are_marginal(planar: Robot) -> None:
    bent = twisted(planar, 1, 1e-4)
    assert {"link2.mcz", "link2.Iyz"} & set(bent.close)
    assert bent.base.gap[0] < 1e-3
    assert twisted(planar, 1, 0.0).close == twisted(planar, 1, 0.3).close == ()


@pytest.mark.parametrize("name", KINDS)
def test_expressions_say_what_the_matrix_says(name: str) -> None:
    base = base_parameters(load_robot(name))
    phi = np.random.default_rng(0).uniform(0.5, 2, len(base.names))
    values = dict(zip(base.names, phi, strict=True))
    for row, text in zip(base.regrouping, base.expressions, strict=True):
        numbers = re.sub(r"[A-Za-z_]\w*\.\w+", lambda name: str(values[name[0]]), text)
        value = eval(numbers.translate(str.maketrans({"−": "-", "·": "*", "²": "**2"})))
        assert abs(value - row @ phi) <= 5e-5 * (np.abs(row) @ phi)  # five digits


@pytest.mark.parametrize(("inner", "together"), [(False, 30), (True, 32)])
def test_one_joint_at_a_time_in_many_poses(inner: bool, together: int) -> None:
    """Six recordings, one joint moving in each: its own torque alone misses two combinations."""
    robot = load_robot("cmu_dd_arm_ii")
    read = {joint: robot.joints[0 if inner else i : i + 1] for i, joint in enumerate(robot.joints)}
    rows = [
        structure(robot, moving=[joint], measured=measured, anywhere=True).base.regrouping
        for joint, measured in read.items()
    ]
    assert np.linalg.matrix_rank(np.vstack(rows), tol=1e-8) == together


def shown_of(found: Structure) -> set[str]:
    pairs = zip(found.base.names, found.category, strict=True)
    return {name for name, kind in pairs if kind != "unidentifiable"}


def test_the_last_torque_shows_the_last_link_alone_and_a_rest_only_gravity(ur10: Robot) -> None:
    found = structure(ur10, measured=[ur10.joints[-1]])
    assert {name.rpartition(".")[0] for name in shown_of(found)} == {ur10.links[-1]}
    assert len(found.base) == parameter_nullspace(ur10).shown[-1]
    assert "torque of joints" in found.circumstances[-1]
    shown = shown_of(structure(ur10, moving=[], anywhere=True))
    assert {name.rpartition(".")[2][0] for name in shown} == {"m"}
    assert len(structure(ur10.with_gravity((0, 0, 0)), moving=[], anywhere=True).base) == 0


def test_circumstances_are_said(ur10: Robot) -> None:
    still = [joint for joint in ur10.joints if joint != "elbow_joint"]
    found = structure(ur10, moving=["elbow_joint"])
    base, gravity, held, *_ = found.circumstances
    assert (base, gravity) == ("the base is fixed", "gravity along −z of the base")
    assert held == f"joints {', '.join(still)} held at 0"
    many = structure(ur10, moving=["elbow_joint"], anywhere=True)
    assert many.circumstances[2] == f"joints {', '.join(still)} at rest in many positions"
    assert len(many.base) > len(found.base)
    locked = structure(load_robot("ur10", lock={"elbow_joint": 1.0}).with_gravity((0, 0, 0)))
    assert {"no gravity", "joint elbow_joint at 1 locked"} <= set(locked.circumstances)


MOVING = {"revolute", "continuous", "prismatic"}


@pytest.mark.slow
@pytest.mark.skipif(data_folder(None) is None, reason="example-robot-data is not at hand")
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
    text = (data_folder(None) / file).read_text(encoding="utf-8")
    moving = (e for e in ET.fromstring(text).iter("joint") if e.get("type") in MOVING)
    names = tuple(str(element.get("name")) for element in moving)[:joints]
    robot = robot_from_urdf(text, RobotSpec(file, joints=names))
    assert len(structure(robot).base) == count
    assert angle_between_methods(robot) < 1e-6


def test_table_4_of_the_seed_paper_in_its_frames() -> None:
    """Links 1 and 2: seven of twenty, about distal frames, with the values as printed."""
    arm = load_robot("cmu_dd_arm_ii")
    found = analyze(arm, frames="dh").result()
    first = [row for link in found["links"][:2] for row in link["parameters"]]
    shown = {row["name"]: row["value"] for row in first if row["category"] != "unidentifiable"}
    assert len(first) == 20
    about_centre = 1.193645 + 5.9259**2 / 19.753  # as it is printed, moved to the frame
    printed = {"link1.m": 19.753, "link1.mcx": -5.9259, "link1.Izz": about_centre, "link2.m": 7.894}
    printed |= {"link2.mcx": -1.039971, "link2.mcz": 0.008722, "link2.Iyy": 0.264736}
    assert shown == pytest.approx(printed, abs=1e-6)
    assert "link1 3, link2 4, link3 10" in found["notes"][0]
    in_joint_frames = analyze(arm).result()
    assert in_joint_frames["base_parameters"] == found["base_parameters"] == 32
    assert in_joint_frames["structure"]["frames"] == "joint"
    with pytest.raises(BadInput, match="joint frames"):
        analyze(arm, frames="dh", motion=reference_motion(arm, 1.0, 50.0))


@pytest.mark.parametrize("name", ["cmu_dd_arm_ii", "puma560", "scara"])
def test_categories_are_those_of_the_singular_vectors(name: str) -> None:
    """Unique: orthogonal to the null vectors; unidentifiable: among them (Khosla 1987, 5.4)."""
    arm = load_robot(name)
    found = structure(arm, frames=distal_frames(arm))
    r, V = len(found.base), found.singular_vectors
    np.testing.assert_allclose(V @ V.T, np.eye(len(V)), atol=1e-12)
    assert found.singular_values[r - 1] > 1e-6
    assert found.singular_values[r:].max() < 1e-10
    hidden = np.linalg.norm(V[r:], axis=0)
    kinds = np.where(hidden < 1e-8, "unique", np.where(hidden > 1 - 1e-12, "unidentifiable", ""))
    assert found.category == tuple(kind or "combined" for kind in kinds.tolist())


@pytest.mark.parametrize("name", ["ur10", "panda", "puma560", "cylindrical"])
def test_distal_frames_of_any_arm(name: str) -> None:
    """x of frame i meets the axis of joint i at a right angle; z is the axis of joint i + 1."""
    arm = load_robot(name)
    placed, data = distal_frames(arm), arm.model.createData()
    axes = joint_axes(arm, np.zeros(arm.nv), data)
    for j, T in enumerate(placed):
        world = data.oMi[j + 1].homogeneous @ T
        origin = world[:3, 3] - data.oMi[j + 1].translation
        assert abs(axes[j] @ world[:3, 0]) < 1e-9
        assert abs(np.cross(axes[j], world[:3, 0]) @ origin) < 1e-9
        if j + 1 < arm.nv:
            np.testing.assert_allclose(world[:3, 2], axes[j + 1], atol=1e-9)
            to_next = world[:3, 3] - data.oMi[j + 2].translation
            assert np.linalg.norm(np.cross(axes[j + 1], to_next)) < 1e-9


def test_frames_of_a_chain_are_its_own(random_chain: Callable[..., DHChain]) -> None:
    for chain in (random_chain(seed, 5) for seed in range(5)):
        placed = distal_frames(robot_from_dh(replace(chain, tool=np.eye(4))))
        np.testing.assert_allclose(placed, joint_frames(chain), atol=1e-9)
