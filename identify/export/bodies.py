"""A model as other programs take it: bodies in a tree, each on a joint, with what drives it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from excitant.exceptions import BadInput
from excitant.robots.effects import plain
from excitant.robots.motion import Array, freeze
from excitant.robots.robot import Robot

_COMMON_GRAVITY = (0.0, 0.0, -9.81)


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame fixed to a body, such as the tool: its name and pose in the body's frame (4, 4)."""

    name: str
    pose: Array


@dataclass(frozen=True, eq=False)
class Body:
    """A joint and the link it carries, with everything that is fixed or held to that link.

    Attributes:
        joint: Name of the joint.
        link: Name of the link; its frame is the joint's frame.
        parent: Index of the body it hangs on; −1 for the base.
        placement: Pose of the frame in the parent's at q = 0, shape (4, 4).
        axis: Direction of the joint in the frame, a unit vector, shape (3,).
        revolute: Whether the joint turns (or slides).
        phi: Standard parameters, shape (10,).
        frames: Frames fixed to it.
        position: Lowest and highest position, shape (2,) [rad or m].
        velocity: Highest speed [rad/s or m/s].
        torque: Highest torque [N·m or N].
        properties: Values of effects that files have a property of the joint for, by its name.
    """

    joint: str
    link: str
    parent: int
    placement: Array
    axis: Array
    revolute: bool
    phi: Array
    frames: tuple[Frame, ...]
    position: Array
    velocity: float
    torque: float
    properties: Mapping[str, float]

    def __post_init__(self) -> None:
        freeze(self, "placement", "axis", "phi", "position")

    def positive(self, name: str) -> float:
        """A property that cannot be negative in files, such as friction; 0 where there is none."""
        return max(self.properties.get(name, 0.0), 0.0)


@dataclass(frozen=True, eq=False)
class Tree:
    """An arm as bodies; a parent comes before what hangs on it.

    Attributes:
        robot: The arm, its payloads and corrections of inertia part of its links.
        bodies: One per joint, in the order of the robot's joints.
        base_frames: Frames of what stands still.
    """

    robot: Robot
    bodies: tuple[Body, ...]
    base_frames: tuple[Frame, ...]

    def comment(self, file_format: str, complete: str) -> str:
        """What a file leaves out or means in its own way, as the text of an XML comment.

        Args:
            file_format: ``"urdf"``, ``"mjcf"`` or ``"sdf"``.
            complete: File that holds everything, to refer to.
        """
        left_out, own = [], []
        for effect in self.robot.effects:
            values, joints, below = effect.values or (), list(effect.joints), list[str]()
            if effect.joint_property:
                lowest = [p.lower for p in effect.parameters(self.robot)]
                rows = list(zip(joints, values, lowest, strict=True))
                joints = [joint for joint, value, _ in rows if value]
                below = [joint for joint, value, low in rows if value < low]
            if joints and file_format not in effect.formats:
                left_out.append(f"not in this file: {plain(effect.name)} of {self._listed(joints)}")
            elif joints and below:
                name = f"negative {plain(effect.name)}"
                left_out.append(f"not in this file: {name} of {', '.join(below)}")
            elif joints and file_format in effect.format_notes:
                own.append(effect.format_notes[file_format])
        if file_format == "sdf" and not np.allclose(self.robot.gravity, _COMMON_GRAVITY):
            own.append("gravity is that of the world, which Drake wants to be told in code")
        last = [f"{complete} holds everything"] if left_out else []
        text = "\n    ".join(("", "identified by excitant", *left_out, *own, *last))
        while "--" in text:  # which ends no comment
            text = text.replace("--", "- -")
        return f"{text}\n  "

    def _listed(self, joints: Sequence[str]) -> str:
        return "all joints" if len(joints) == len(self.bodies) else ", ".join(joints)


def tree(robot: Robot) -> Tree:
    """The bodies of a robot, with joints that are held merged into what carries them.

    Raises:
        BadInput: An effect without values.
    """
    robot = _folded(robot)
    properties: list[dict[str, float]] = [{} for _ in robot.joints]
    for effect in robot.effects:
        if effect.joint_property:
            for joint, value in zip(effect.joints, effect.values or (), strict=True):
                own = properties[robot.joint_index(joint)]
                own[effect.joint_property] = own.get(effect.joint_property, 0.0) + value
    model, limits = robot.model, robot.limits
    bodies = tuple(
        Body(
            joint=joint,
            link=robot.links[j],
            parent=int(model.parents[j + 1]) - 1,
            placement=model.jointPlacements[j + 1].homogeneous,
            axis=_axis(robot, j),
            revolute=bool(robot.revolute[j]),
            phi=robot.phi[10 * j : 10 * j + 10],
            frames=_frames(robot, j + 1),
            position=limits.position[j],
            velocity=float(limits.velocity[j]),
            torque=float(limits.torque[j]),
            properties=properties[j],
        )
        for j, joint in enumerate(robot.joints)
    )
    return Tree(robot, bodies, _frames(robot, 0))


def _folded(robot: Robot) -> Robot:
    """The robot with payloads and corrections of inertia as part of its links."""
    for effect in robot.effects:
        if effect.values is None:
            raise BadInput(f"{robot.name}: effect {effect.name} has no values; identify it first")
    bodies = [effect for effect in robot.effects if effect.role != "torque"]
    if not bodies:
        return robot
    kept = [effect for effect in robot.effects if effect.role == "torque"]
    for effect in bodies:
        robot = effect.applied(robot)
    return robot.with_effects(kept)


def _axis(robot: Robot, joint: int) -> Array:
    """Direction of a joint in its own frame, shape (3,)."""
    model, data = robot.model, robot.model.createData()
    pin.computeJointJacobians(model, data, np.zeros(robot.nv))
    # Pinocchio gives the Jacobian of a single joint as a vector
    J = np.reshape(pin.getJointJacobian(model, data, joint + 1, pin.LOCAL), (6, -1))
    return np.asarray(J[3:, joint] if robot.revolute[joint] else J[:3, joint], float)


def _frames(robot: Robot, joint: int) -> tuple[Frame, ...]:
    """Links that are fixed to the one of a joint of Pinocchio's; 0 for the base."""
    return tuple(
        Frame(str(frame.name), frame.placement.homogeneous)
        for frame in list(robot.model.frames)
        if frame.type == pin.FrameType.BODY
        and frame.parentJoint == joint
        and frame.name not in robot.links
    )


def quaternion(R: Array) -> Array:
    """Unit quaternion (w, x, y, z) of a rotation matrix."""
    x, y, z, w = pin.Quaternion(np.ascontiguousarray(R)).coeffs()
    return np.array([w, x, y, z])


def written(values: float | Sequence[float] | Array) -> str:
    """Numbers as text that reads back to the same ones."""
    return " ".join(repr(float(x) + 0.0) for x in np.ravel(values))
