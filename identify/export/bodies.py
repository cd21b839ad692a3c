"""A model as other programs take it: bodies in a tree, each on a joint, with what drives it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from excitant.exceptions import BadInput
from excitant.robots.effects import EFFECTS, Effect
from excitant.robots.motion import Array, freeze
from excitant.robots.robot import Robot


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
        viscous: F_v [N·m·s/rad].
        coulomb: F_c [N·m].
        rotor: I_a, rotor and gear inertia at the joint side [kg·m²].
        offset: τ_0, constant torque [N·m].
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
    viscous: float
    coulomb: float
    rotor: float
    offset: float

    def __post_init__(self) -> None:
        freeze(self, "placement", "axis", "phi", "position")


@dataclass(frozen=True, eq=False)
class Tree:
    """An arm as bodies; a parent comes before what hangs on it.

    Attributes:
        name: Name of the arm.
        bodies: One per joint, in the order of the robot's joints.
        base_frames: Frames of what stands still.
        gravity: Gravity in the base frame, shape (3,) [m/s²].
        others: Effects that no body holds, such as the Stribeck effect.
    """

    name: str
    bodies: tuple[Body, ...]
    base_frames: tuple[Frame, ...]
    gravity: Array
    others: tuple[Effect, ...]

    def children(self, parent: int) -> list[int]:
        """Indices of the bodies that hang on one, or on the base (−1)."""
        return [i for i, body in enumerate(self.bodies) if body.parent == parent]


def tree(robot: Robot) -> Tree:
    """The bodies of a robot, with joints that are held merged into what carries them.

    Raises:
        BadInput: An effect without values.
    """
    robot = folded(robot)
    properties = {kind.joint_property: np.zeros(robot.nv) for kind in held_kinds()}
    for effect in robot.effects:
        if effect.joint_property:
            properties[effect.joint_property][effect.rows(robot)] += effect.values or ()
    model, limits = robot.model, robot.limits
    axes, phi = _axes(robot), robot.phi.reshape(-1, 10)
    bodies = tuple(
        Body(
            joint=joint,
            link=robot.links[j],
            parent=int(model.parents[j + 1]) - 1,
            placement=model.jointPlacements[j + 1].homogeneous,
            axis=axes[j],
            revolute=bool(robot.revolute[j]),
            phi=phi[j],
            frames=_frames(robot, j + 1),
            position=limits.position[j],
            velocity=float(limits.velocity[j]),
            torque=float(limits.torque[j]),
            **{name: float(values[j]) for name, values in properties.items()},
        )
        for j, joint in enumerate(robot.joints)
    )
    others = tuple(effect for effect in robot.effects if not effect.joint_property)
    return Tree(robot.name, bodies, _frames(robot, 0), robot.gravity, others)


def held_kinds() -> list[type[Effect]]:
    """Kinds of effects that bodies hold as properties of their joints."""
    return [kind for kind in EFFECTS.values() if kind.joint_property]


def folded(robot: Robot) -> Robot:
    """The robot with payloads and corrections of inertia as part of its links.

    Raises:
        BadInput: An effect without values.
    """
    whole, kept = robot, []
    for effect in robot.effects:
        if effect.values is None:
            raise BadInput(f"{robot.name}: effect {effect.name} has no values; identify it first")
        if effect.link(robot) is None:
            kept.append(effect)
        else:
            whole = effect.applied(whole)
    return whole.with_effects(kept)


def _axes(robot: Robot) -> Array:
    """Direction of every joint in its own frame, shape (nv, 3)."""
    model, data = robot.model, robot.model.createData()
    pin.computeJointJacobians(model, data, np.zeros(robot.nv))
    # Pinocchio gives the Jacobian of a single joint as a vector
    full = [pin.getJointJacobian(model, data, j + 1, pin.LOCAL) for j in range(robot.nv)]
    J = np.array([np.reshape(each, (6, -1))[:, j] for j, each in enumerate(full)])
    return np.where(robot.revolute[:, None], J[:, 3:], J[:, :3])


def _frames(robot: Robot, joint: int) -> tuple[Frame, ...]:
    """Links that are fixed to the one of a joint of Pinocchio's; 0 for the base."""
    return tuple(
        Frame(str(frame.name), frame.placement.homogeneous)
        for frame in list(robot.model.frames)
        if frame.type == pin.FrameType.BODY
        and frame.parentJoint == joint
        and frame.name not in robot.links
    )


def central(phi: Array) -> tuple[float, Array, Array]:
    """Mass, centre of mass (3,) and inertia about it (3, 3) of standard parameters (10,)."""
    mass = float(phi[0])
    lever = phi[1:4] / mass if mass else np.zeros(3)
    xx, xy, yy, xz, yz, zz = phi[4:]
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return mass, lever, inertia - mass * (lever @ lever * np.eye(3) - np.outer(lever, lever))


def quaternion(R: Array) -> Array:
    """Unit quaternion (w, x, y, z) of a rotation matrix."""
    x, y, z, w = pin.Quaternion(np.ascontiguousarray(R)).coeffs()
    return np.array([w, x, y, z])


def written(values: float | Sequence[float] | Array) -> str:
    """Numbers as text that reads back to the same ones."""
    return " ".join(repr(float(x) + 0.0) for x in np.ravel(values))
