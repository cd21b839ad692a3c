"""Chains of larger robots, branched trees, coupled joints: what moves, and what is held."""

import shutil
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from khosla import close
from known_arms import Call
from marks import refused

from excitant.exceptions import BadInput, BadRobot, UnknownName
from excitant.robots import Motion, Robot, load_robot, regressor, rigid_body_torque
from excitant.robots.chains import RobotSpec

TWINS = Path(__file__).parent / "data" / "twins.urdf"
"""Two arms of three joints on a lifting torso; grippers whose finger follows the thumb."""
LEFT, RIGHT = (tuple(f"{side}_{k}" for k in (1, 2, 3)) for side in ("left", "right"))
GRIPPERS = tuple(f"{side}_{end}" for side in ("left", "right") for end in ("thumb", "finger"))


def torque_of_whole(robot: Robot, motion: Motion) -> np.ndarray:
    """Torque of some joints by Pinocchio's own model of all, the others where they are held."""
    model = pin.buildModelFromXML(TWINS.read_text("utf-8"))
    data, tau = model.createData(), np.zeros(motion.q.shape)
    index = [model.joints[model.getJointId(joint)].idx_v for joint in robot.joints]
    at = [model.joints[model.getJointId(joint)].idx_q for joint, _ in robot.locked]
    for k in range(len(motion)):
        q, dq, ddq = np.zeros((3, model.nv))
        q[at] = [value for _, value in robot.locked]
        q[index], dq[index], ddq[index] = motion.q[k], motion.dq[k], motion.ddq[k]
        tau[k] = pin.rnea(model, data, q, dq, ddq)[index]
    return tau


HELD = {"right_thumb": 0, "right_finger": 0.1}
CHOICES = {
    "to a tip": ({"tip": "left_hand"}, ("lift", *LEFT)),
    "between links": ({"base": "torso", "tip": "right_hand"}, RIGHT),
    "gripper held": ({"base": "right_shoulder", "lock": HELD}, RIGHT[1:]),
    "joints by name": ({"joints": ["right_2", "left_2"]}, ("left_2", "right_2")),
    "one held": ({"tip": "left_hand", "lock": {"left_2": 0.7}}, ("lift", "left_1", "left_3")),
    "a finger too": ({"base": "torso", "tip": "left_thumb_tip"}, (*LEFT, "left_thumb")),
}


@pytest.mark.parametrize("kind", CHOICES)
def test_the_chosen_joints_move_and_all_else_is_carried(kind: str, random_states: Call) -> None:
    choice, expected = CHOICES[kind]
    robot = load_robot(TWINS, **choice)
    assert robot.joints == expected
    held, tip = dict(robot.locked), robot.model.frames[robot.tip]
    assert set(held) | set(expected) == {"lift", *LEFT, *RIGHT, *GRIPPERS}
    assert choice.get("lock", {}).items() <= held.items()
    assert tip.name == choice.get("tip", tip.name)
    assert tip.parentJoint == robot.nv
    motion = random_states(robot, 0, 20)
    assert close(rigid_body_torque(robot, motion), torque_of_whole(robot, motion))


def test_a_follower_off_the_chain_is_held_where_it_belongs() -> None:
    robot = load_robot(TWINS, tip="left_hand", lock={"right_thumb": 0.02})
    held = [dict(robot.locked)[f"{side}_finger"] for side in ("left", "right")]
    assert held == pytest.approx([0.1, 0.1 - 2 * 0.02])
    said = "mimic joints held as the joints they mimic: left_finger at 0.1, right_finger at 0.06"
    assert said in robot.notes
    assert any("right_1" in note for note in robot.notes)
    assert load_robot(TWINS, lock=dict.fromkeys(GRIPPERS, 0.0)).notes == ()  # as was asked for


def test_a_follower_of_a_joint_that_moves_is_held_and_that_is_said(random_states: Call) -> None:
    robot = load_robot(TWINS)
    assert robot.joints == ("lift", *LEFT, "left_thumb", *RIGHT, "right_thumb")
    assert dict(robot.locked) == pytest.approx({"left_finger": 0.1, "right_finger": 0.1})
    (note,) = robot.notes
    assert note.endswith("not modelled: left_finger at 0.1, right_finger at 0.1")
    motion = random_states(robot, 0, 8)
    assert close(rigid_body_torque(robot, motion), torque_of_whole(robot, motion))


@pytest.mark.parametrize(
    ("choice", "error", "match"),
    [
        ({"joints": ["left_thumb", "left_finger"]}, BadRobot, "'left_finger' mimics 'left_thumb'"),
        ({"tip": "left_hnd"}, UnknownName, "did you mean 'left_hand'"),
        ({"base": "tors", "tip": "left_hand"}, UnknownName, "did you mean 'torso'"),
        ({"joints": ["lft"]}, UnknownName, "did you mean 'lift'"),
        ({"lock": {"lft": 0.0}}, UnknownName, "did you mean 'lift'"),
        ({"joints": ["root"]}, UnknownName, "root"),  # which is fixed
        ({"base": "left_upper", "tip": "right_hand"}, BadRobot, "does not hang"),
        ({"base": "torso", "tip": "torso"}, BadRobot, "no joint moves"),
        ({"joints": ["lift"], "tip": "torso"}, BadInput, "one way only"),
        ({"joints": ["lift"], "lock": {"lift": 0.1}}, BadInput, "both kept"),
    ],
)
def test_a_choice_that_cannot_be_is_refused_in_one_line(choice, error, match):
    refused(match, load_robot, TWINS, error=error, **choice)


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_a_joint_of_several_freedoms_is_held_or_refused(tmp_path, kind, random_states):
    path = tmp_path / "loose.urdf"
    text = TWINS.read_text("utf-8")
    path.write_text(text.replace('"root" type="fixed"', f'"root" type="{kind}"'))
    refused(rf"'root' is {kind}.*--base base", load_robot, path, tip="left_hand", error=BadRobot)
    robot = load_robot(path, base="torso", tip="left_hand")
    assert robot.joints == LEFT
    assert any(f"{kind} joint root" in note for note in robot.notes)
    motion = random_states(robot, 0, 20)
    fixed = load_robot(TWINS, base="torso", tip="left_hand")
    assert close(rigid_body_torque(robot, motion), rigid_body_torque(fixed, motion))
    assert load_robot(path, lock={"root": 0}, joints=None, tip="left_hand").nv == 4


def test_a_tree_needs_the_torque_of_newton_and_euler(random_states: Call) -> None:
    """Y φ of two arms at once is Pinocchio's recursion over the whole robot."""
    both = load_robot(TWINS, joints=("lift", *LEFT, *RIGHT))
    motion = random_states(both, 0, 20)
    Y = regressor(both, motion)
    assert close(Y @ both.phi, torque_of_whole(both, motion))
    assert not Y[:, 1:4, 40:].any()
    assert not Y[:, 4:, 10:40].any()


def test_robot_yaml_chooses_a_chain(tmp_path: Path) -> None:
    file = tmp_path / "left.yaml"
    shutil.copy(TWINS, tmp_path)
    chosen = f"model: {TWINS.name}\nbase: torso\ntip: left_hand\nlock: {{lift: 0.2}}\n"
    file.write_text(f"{chosen}limits: {{torque: [9, 8, 7]}}\n")
    robot = load_robot(file)
    assert (robot.joints, robot.limits.torque.tolist()) == (LEFT, [9, 8, 7])
    part = load_robot(file, joints=LEFT[1:])
    assert (part.joints, part.limits.torque.tolist()) == (LEFT[1:], [8, 7])
    assert dict(part.locked)["lift"] == 0.2
    refused("right_3", load_robot, file, joints=["right_3"], error=UnknownName)
    file.write_text(f"model: {TWINS.name}\ngravity: [0, 0, 9.81]\n")  # chooses nothing itself
    robot = load_robot(RobotSpec(file, base="torso", tip="left_hand"))
    assert (robot.joints, robot.gravity.tolist()) == (LEFT, [0, 0, 9.81])
