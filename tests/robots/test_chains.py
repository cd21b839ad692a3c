"""Chains of larger robots, branched trees, coupled joints: what moves, and what is held."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from excitant.exceptions import BadInput, BadRobot, UnknownName
from excitant.robots import (
    Motion,
    Robot,
    load_robot,
    regressor,
    rigid_body_torque,
)

LINK = (
    '<link name="{0}"><inertial><origin xyz="0.05 0.02 {1}" rpy="0.1 0 0"/><mass value="{2}"/>'
    '<inertia ixx="0.02" ixy="0.001" ixz="0" iyy="0.03" iyz="0" izz="0.01"/></inertial></link>'
)
JOINT = (
    '<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/>'
    '<origin xyz="{4}" rpy="0.2 0 0.1"/><axis xyz="{5}"/>'
    '<limit lower="-2" upper="2" velocity="2" effort="60"/>{6}</joint>'
)
ARM = ("shoulder", "upper", "elbow")
FINGERS = ("thumb", "finger")


def torso(root: str = "fixed") -> str:
    """Two arms of three joints on a lifting torso; grippers whose second finger follows."""
    parts = [LINK.format(name, 0.1, mass) for name, mass in (("base", 20), ("torso", 9))]
    parts += [
        '<link name="world"/>',
        JOINT.format("root", root, "world", "base", "0 0 0.1", "0 0 1", ""),
        JOINT.format("lift", "prismatic", "base", "torso", "0 0 0.5", "0 0 1", ""),
    ]
    for side, y in (("left", 0.3), ("right", -0.3)):
        parent = "torso"
        for k, name in enumerate(ARM):
            link = f"{side}_{name}"
            axis = ("0 1 0", "1 0 0", "0 0 1")[k]
            parts += [
                LINK.format(link, 0.2, 3 - k * 0.7),
                JOINT.format(f"{link}_joint", "revolute", parent, link, f"0.1 {y} 0.2", axis, ""),
            ]
            parent = link
        mimic = f'<mimic joint="{side}_thumb_joint" multiplier="-2" offset="0.1"/>'
        for finger, follows in (("thumb", ""), ("finger", mimic)):
            link = f"{side}_{finger}"
            parts += [
                LINK.format(link, 0.01, 0.1),
                JOINT.format(
                    f"{link}_joint", "prismatic", parent, link, "0 0 0.3", "1 0 0", follows
                ),
            ]
    return f'<robot name="torso">{"".join(parts)}</robot>'


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "torso.urdf"
    file.write_text(torso())
    return file


def joints(side: str) -> tuple[str, ...]:
    return tuple(f"{side}_{name}_joint" for name in ARM)


def states(robot: Robot, seed: int = 0, n: int = 20) -> Motion:
    motion = robot.random_motion(np.random.default_rng(seed), n)
    return Motion(np.arange(n, dtype=float), *motion)


def whole_model(text: str) -> pin.Model:
    """Pinocchio's own model of all joints, made without excitant."""
    return pin.buildModelFromXML(text)


def torque_of_whole(model: pin.Model, robot: Robot, motion: Motion, at: dict[str, float]):
    """Torque of a robot's joints while all others of a model stay where they are held."""
    data, tau = model.createData(), np.zeros(motion.q.shape)
    index = [model.joints[model.getJointId(joint)].idx_v for joint in robot.joints]
    for k in range(len(motion)):
        q, dq, ddq = np.zeros((3, model.nv))
        for joint, value in at.items():
            q[model.joints[model.getJointId(joint)].idx_q] = value
        q[index], dq[index], ddq[index] = motion.q[k], motion.dq[k], motion.ddq[k]
        tau[k] = pin.rnea(model, data, q, dq, ddq)[index]
    return tau


CHOICES = {
    "to a tip": ({"tip": "left_elbow"}, ("lift", *joints("left"))),
    "between links": ({"base": "torso", "tip": "right_elbow"}, joints("right")),
    "below a base, gripper held": (
        {"base": "right_shoulder", "lock": {"right_thumb_joint": 0, "right_finger_joint": 0.1}},
        joints("right")[1:],
    ),
    "joints by name": (
        {"joints": ["right_upper_joint", "left_upper_joint"]},
        ("left_upper_joint", "right_upper_joint"),
    ),
    "one held on the way": (
        {"tip": "left_elbow", "lock": {"left_upper_joint": 0.7}},
        ("lift", "left_shoulder_joint", "left_elbow_joint"),
    ),
    "a finger too": ({"base": "torso", "tip": "left_thumb"}, (*joints("left"), "left_thumb_joint")),
}


@pytest.mark.parametrize("kind", CHOICES)
def test_the_chosen_joints_move_and_all_else_is_carried(path: Path, kind: str) -> None:
    choice, expected = CHOICES[kind]
    robot = load_robot(path, **choice)
    assert robot.joints == expected
    held = dict(robot.locked)
    assert set(held) | set(expected) == set(whole_model(path.read_text()).names) - {"universe"}
    for joint, value in choice.get("lock", {}).items():
        assert held[joint] == value
    motion = states(robot)
    tau = torque_of_whole(whole_model(path.read_text()), robot, motion, held)
    assert np.abs(rigid_body_torque(robot, motion) - tau).max() <= 1e-10 * np.abs(tau).max()


def test_a_follower_off_the_chain_is_held_where_it_belongs(path: Path) -> None:
    robot = load_robot(path, tip="left_elbow", lock={"right_thumb_joint": 0.02})
    held = dict(robot.locked)
    assert held["left_finger_joint"] == pytest.approx(0.1)
    assert held["right_finger_joint"] == pytest.approx(0.1 - 2 * 0.02)
    assert any("left_finger_joint follows left_thumb_joint" in note for note in robot.notes)
    assert any("right_shoulder_joint" in note for note in robot.notes)


REFUSED: dict[str, tuple[dict[str, object], type[Exception], str]] = {
    "a follower among the kept": ({}, BadRobot, "'left_finger_joint' mimics 'left_thumb_joint'"),
    "unknown tip": ({"tip": "left_elbw"}, UnknownName, "did you mean 'left_elbow'"),
    "unknown lock": ({"lock": {"lft": 0.0}}, UnknownName, "did you mean 'lift'"),
    "tip elsewhere": ({"base": "left_upper", "tip": "right_elbow"}, BadRobot, "does not hang"),
    "nothing between": ({"base": "torso", "tip": "torso"}, BadRobot, "no joint moves"),
    "two ways at once": ({"joints": ["lift"], "tip": "torso"}, BadInput, "one way only"),
    "kept and held": ({"joints": ["lift"], "lock": {"lift": 0.1}}, BadInput, "both kept"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_a_choice_that_cannot_be_is_refused_in_one_line(path: Path, kind: str) -> None:
    choice, error, match = REFUSED[kind]
    with pytest.raises(error, match=re.escape(match)) as refused:
        load_robot(path, **choice)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_a_joint_of_several_degrees_of_freedom_is_held_or_refused(
    tmp_path: Path, kind: str
) -> None:
    path = tmp_path / "loose.urdf"
    path.write_text(torso(root=kind))
    with pytest.raises(BadRobot, match=rf"'root' is {kind}.*--base base"):
        load_robot(path, tip="left_elbow")
    robot = load_robot(path, base="torso", tip="left_elbow")
    assert robot.joints == joints("left")
    assert any(f"{kind} joint root" in note for note in robot.notes)
    fixed = tmp_path / "fixed.urdf"
    fixed.write_text(torso())
    motion = states(robot)
    tau = rigid_body_torque(load_robot(fixed, base="torso", tip="left_elbow"), motion)
    assert np.abs(rigid_body_torque(robot, motion) - tau).max() <= 1e-10 * np.abs(tau).max()
    assert load_robot(path, lock={"root": 0}, joints=None, tip="left_elbow").nv == 4


@pytest.fixture
def both(path: Path) -> Robot:
    """Both arms and what carries them, as one tree."""
    return load_robot(path, joints=("lift", *joints("left"), *joints("right")))


def test_a_tree_needs_the_torque_of_newton_and_euler(both: Robot, path: Path) -> None:
    """Y φ of two arms at once is Pinocchio's recursion over the whole robot."""
    motion = states(both)
    model = whole_model(path.read_text())
    tau = torque_of_whole(model, both, motion, dict(both.locked))
    Y = regressor(both, motion)
    assert np.abs(Y @ both.phi - tau).max() <= 1e-10 * np.abs(tau).max()
    left, right = (slice(10 * (1 + 3 * k), 10 * (4 + 3 * k)) for k in (0, 1))
    assert not Y[:, 1:4, right].any()
    assert not Y[:, 4:, left].any()


def test_robot_yaml_chooses_a_chain(path: Path) -> None:
    file = path.parent / "left.yaml"
    file.write_text(
        "model: torso.urdf\nbase: torso\ntip: left_elbow\nlock: {lift: 0.2}\n"
        "limits: {torque: [9, 8, 7]}\n"
    )
    robot = load_robot(file)
    assert robot.joints == joints("left")
    assert robot.limits.torque.tolist() == [9, 8, 7]
    part = load_robot(file, joints=joints("left")[1:])
    assert part.joints == joints("left")[1:]
    assert part.limits.torque.tolist() == [8, 7]
    assert dict(part.locked)["lift"] == 0.2
    with pytest.raises(UnknownName):
        load_robot(file, joints=["right_elbow_joint"])
