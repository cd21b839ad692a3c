"""Serial arms of example-robot-data, and arms of which everything is known."""

import os
import site
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from excitant.robots import BaseParameters, Motion, Robot, base_parameters, load_robot
from excitant.robots.chains import RobotSpec
from excitant.robots.effects import standard_effects

ASSUMED = {"velocity": 1.5, "acceleration": 10.0}  # rad/s or m/s, rad/s² or m/s²


@dataclass(frozen=True, eq=False)
class TrueArm:
    """Pinocchio's rigid bodies, and what each joint has besides, shape (nv,) [SI]."""

    model: pin.Model
    Fv: np.ndarray | float = 0.0
    Fc: np.ndarray | float = 0.0
    offset: np.ndarray | float = 0.0
    Ia: np.ndarray | float = 0.0

    def torque(self, motion: Motion) -> np.ndarray:
        """Torque of a motion, shape (n, nv)."""
        data, states = self.model.createData(), (motion.q, motion.dq, motion.ddq)
        rigid = [pin.rnea(self.model, data, *state) for state in zip(*states, strict=True)]
        friction = self.Fv * motion.dq + self.Fc * np.sign(motion.dq) + self.offset
        return np.asarray(np.array(rigid) + friction + self.Ia * motion.ddq)


class Truth(NamedTuple):
    """An arm of which everything is known, its base parameters and their values."""

    robot: Robot
    arm: TrueArm
    base: BaseParameters
    beta: np.ndarray


def truth(name: str) -> Truth:
    """A built-in arm with friction and rotors drawn in proportion to its torques."""
    robot, rng = load_robot(name).with_effects(()), np.random.default_rng(3)
    motion = Motion(np.arange(200.0), *robot.random_motion(rng, 200))
    size = TrueArm(robot.model).torque(motion).std(axis=0)
    drawn = size * rng.uniform(0.5, 1.5, (4, robot.nv)) * [[0.03], [0.05], [0.01], [0.01]]
    coefficients = dict(zip(("Fv", "Fc", "offset", "Ia"), drawn, strict=True))
    effects = standard_effects(robot.joints)
    names = (p.name.rpartition(".") for effect in effects for p in effect.parameters(robot))
    values = [coefficients[symbol][robot.joint_index(joint)] for joint, _, symbol in names]
    base = base_parameters(robot, effects)
    beta = base.regrouping @ np.concatenate([robot.phi, values])
    return Truth(robot, TrueArm(robot.model, **coefficients), base, beta)


def data_folder(given: str | None) -> Path | None:
    """Folder of the models: given, from EXAMPLE_ROBOT_DATA, or installed beside this Python."""
    named = given or os.environ.get("EXAMPLE_ROBOT_DATA")
    installed = (
        Path(packages, "cmeel.prefix", "share", "example-robot-data", "robots")
        for packages in site.getsitepackages()
    )
    return next((f for f in ([Path(named)] if named else installed) if f.is_dir()), None)


LISTED = """
ur_description/urdf: ur3_robot ur3_joint_limited_robot ur3_gripper ur5_robot
    ur5_joint_limited_robot ur5_gripper ur10_robot ur10_joint_limited_robot ur3
kinova_description/robots: kinova
xarm_description/urdf: xarm7
z1_description/urdf: z1
so_arm_description/urdf: so100 so101
double_pendulum_description/urdf: double_pendulum double_pendulum_continuous double_pendulum_simple
asr_twodof_description/urdf: TwoDofs
finger_edu_description/robots: finger_edu
borinot_description/urdf: borinot_flying_arm_2
hextilt_description/urdf: hextilt_flying_arm_5
talos_data/robots: talos_left_arm
panda_description/urdf: panda@panda_hand panda_collision@panda_link8
z1_description/urdf: z1@link06
anymal_b_simple_description/robots: anymal-kinova@j2s6s200_end_effector
b1_description/urdf: b1-z1@gripperMover
tiago_description/robots: tiago_no_hand@wrist_ft_tool_link tiago@torso_lift_link:wrist_ft_tool_link
    tiago_dual@torso_lift_link:hand_left_tool_link tiago_dual@torso_lift_link:hand_right_tool_link
tiago_pro_description/robots: tiago_pro@torso_lift_link:arm_left_7_link
    tiago_pro@torso_lift_link:arm_right_7_link
talos_data/robots: talos_reduced@torso_2_link:arm_left_7_link
    talos_reduced@torso_2_link:arm_right_7_link talos_full_v2@arm_left_7_link
baxter_description/urdf: baxter@left_gripper_base_link baxter@right_gripper_base_link
pr2_description/urdf: pr2@torso_lift_link:l_gripper_palm_link
    pr2@torso_lift_link:r_gripper_palm_link pr2@r_gripper_led_frame
romeo_description/urdf: romeo_small@l_gripper romeo_small@r_gripper
icub_description/robots: icub@chest:l_gripper icub@chest:r_gripper
centauro_description/urdf: centauro@ball1_tip centauro@ball2_tip
g1_description/urdf: g1_29dof_rev_1_0@torso_link:left_rubber_hand
    g1_29dof_rev_1_0@torso_link:right_rubber_hand
simple_humanoid_description/urdf: simple_humanoid@l_wrist simple_humanoid@r_wrist
human_description/robots: human@right_hand
alex_description/urdf: alex_nub_hands@leftNub alex_nub_hands@rightNub
    alex_psyonic_hands@LeftGripperYawLink alex_sake_hands@RightSakeFingerTip1
allegro_hand_description/urdf: allegro_right_hand@link_3.0_tip
"""


def chain(word: str, folder: str = "", suffix: str = "") -> RobotSpec:
    """The chain FILE@BASE:TIP or FILE@TIP; all joints where no end is named."""
    file, _, ends = word.partition("@")
    base, _, tip = ends.rpartition(":")
    return RobotSpec(f"{folder}{file}{suffix}", base=base or None, tip=tip or None)


_ARM = ("s0", "s1", "e0", "e1", "w0", "w1", "w2")
DUAL = tuple(f"{side}_{joint}" for side in ("left", "right") for joint in _ARM)
_PLACES = (line.split(": ") for line in LISTED.strip().replace("\n    ", " ").splitlines())
ARMS = (
    *(chain(word, f"{place}/", ".urdf") for place, words in _PLACES for word in words.split()),
    RobotSpec("baxter_description/urdf/baxter.urdf", joints=DUAL),
)


def with_assumed_limits(robot: Robot) -> Robot:
    """The arm with limits where its description has none."""
    limits = robot.limits
    slides = ~robot.revolute & ~np.isfinite(limits.position).all(axis=1)
    position = np.where(slides[:, None], [-0.5, 0.5], limits.position)
    limits = replace(limits, position=position)
    for name, value in ASSUMED.items():
        missing = np.isinf(getattr(limits, name))
        if name == "acceleration":
            missing &= np.isinf(limits.torque)
        limits = replace(limits, **{name: np.where(missing, value, getattr(limits, name))})
    return robot.with_limits(limits)
