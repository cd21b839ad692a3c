"""Denavit-Hartenberg chains from robots, and robots (URDF) from chains; torques stay the same."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pinocchio as pin

from excitant.exceptions import BadRobot
from excitant.robots.dh import (
    Convention,
    Cylinder,
    DHChain,
    chain_through_axes,
    inverse,
    joint_frames,
    moved_parameters,
)
from excitant.robots.motion import Array
from excitant.robots.robot import Limits, Robot
from excitant.robots.urdf import robot_from_urdf
from excitant.robots.urdf_writing import urdf_with_parameters

_NONE = "1000000000.0"  # a limit that URDF readers take for none


def dh_from_robot(robot: Robot, convention: Convention = "standard") -> DHChain:
    """The arm as a Denavit-Hartenberg chain with the same joint angles and torques.

    Locked joints stay where they are. Axes within 1e-5 rad of parallel are taken as parallel,
    which may change torques by as much; see `chain_through_axes`.

    Args:
        robot: A serial arm; its base and tool become ``base`` and ``tool`` of the chain.
        convention: ``"standard"`` or ``"modified"``.

    Raises:
        BadRobot: A joint that does not hang on the one before it.
    """
    model, data = robot.model, robot.model.createData()
    for j, parent in enumerate(list(model.parents)[1:]):
        if parent != j:
            raise BadRobot(
                robot.source,
                f"joint '{robot.joints[j]}' branches off; Denavit-Hartenberg frames need a "
                "serial arm, so keep the joints of one branch",
            )
    q = np.zeros(robot.nv)
    J = pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    poses = np.array([pose.homogeneous for pose in list(data.oMi)[1:]])
    axes = np.where(robot.revolute[:, None], J[3:].T, J[:3].T)
    tip = data.oMf[robot.tip].homogeneous
    frames, (a, d, alpha, theta) = chain_through_axes(poses[:, :3, 3], axes, tip[:3, 3], convention)
    moves = inverse(frames[1:]) @ poses
    return DHChain(
        name=robot.name,
        convention=convention,
        joints=robot.joints,
        links=robot.links,
        revolute=robot.revolute,
        a=a,
        d=d,
        alpha=alpha,
        theta=theta,
        phi=moved_parameters(robot.phi.reshape(-1, 10), moves).ravel(),
        gravity=robot.gravity,
        base=frames[0],
        tool=inverse(frames[-1:])[0] @ tip,
    )


def robot_from_dh(chain: DHChain, limits: Limits | None = None, source: str | None = None) -> Robot:
    """The chain as a robot whose links sit in their joint frames.

    Args:
        chain: The chain; its masses not zero.
        limits: Limits, written into the URDF too; none when not given.
        source: Where the chain came from, for messages; its name when not given.

    Raises:
        BadRobot: A link without mass, or names that occur twice.
    """
    source = source or chain.name
    for link, mass in zip(chain.links, chain.phi[::10], strict=True):
        if mass == 0:
            raise BadRobot(source, f"link '{link}' has no mass; give one, even if only assumed")
    skeleton = robot_from_urdf(_skeleton(chain, limits), source=source, gravity=chain.gravity)
    phi = moved_parameters(chain.phi.reshape(-1, 10), joint_frames(chain))
    text = urdf_with_parameters(skeleton, phi.ravel())
    robot = robot_from_urdf(text, source=source, gravity=chain.gravity)
    return robot if limits is None else robot.with_limits(limits)


def urdf_from_dh(chain: DHChain, limits: Limits | None = None) -> str:
    """URDF text of a chain; joints and links have the chain's names and q means the same."""
    return robot_from_dh(chain, limits).urdf


def _skeleton(chain: DHChain, limits: Limits | None) -> str:
    """URDF without inertias: links in their joint frames, joints, limits, shapes, tool."""
    root = ET.Element("robot", name=chain.name)
    steps, inner = chain.poses(np.zeros((1, chain.nv)))[0], joint_frames(chain)
    distal = chain.convention == "standard"
    parent, place = _unused("base", chain), chain.base
    ET.SubElement(root, "link", name=parent)
    for i, link in enumerate(chain.links):
        _joint(root, chain, i, parent, place if distal else place @ steps[i], limits)
        ET.SubElement(root, "link", name=link)
        parent, place = link, inner[i]
    tool = _unused("tool", chain)
    ET.SubElement(root, "link", name=tool)
    end = ET.SubElement(root, "joint", name=_unused("flange", chain), type="fixed")
    _ends(end, parent, tool, place @ chain.tool)
    names = (root[0].get("name"), *chain.links)
    elements = {element.get("name"): element for element in root.findall("link")}
    for shape in chain.shapes:
        frame = inner[shape.link - 1] if shape.link else np.eye(4)
        _collision(elements[names[shape.link]], shape, frame)
    return ET.tostring(root, encoding="unicode")


def _unused(name: str, chain: DHChain) -> str:
    while name in chain.links or name in chain.joints:
        name += "_"
    return name


def _joint(
    root: ET.Element, chain: DHChain, i: int, parent: str, place: Array, limits: Limits | None
) -> None:
    low, high, speed, effort = -np.inf, np.inf, np.inf, np.inf
    if limits is not None:
        low, high = limits.position[i]
        speed, effort = limits.velocity[i], limits.torque[i]
    kind = "prismatic" if not chain.revolute[i] else "revolute"
    if chain.revolute[i] and np.isinf(high) and np.isinf(low):
        kind = "continuous"
    joint = ET.SubElement(root, "joint", name=chain.joints[i], type=kind)
    _ends(joint, parent, chain.links[i], place)
    ET.SubElement(joint, "axis", xyz="0 0 1")
    numbers = {"lower": low, "upper": high, "velocity": speed, "effort": effort}
    if kind == "continuous":
        numbers = {"velocity": speed, "effort": effort}
    words = {
        key: repr(float(x)) if np.isfinite(x) else ("-" if x < 0 else "") + _NONE
        for key, x in numbers.items()
    }
    ET.SubElement(joint, "limit", words)


def _ends(joint: ET.Element, parent: str, child: str, place: Array) -> None:
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    ET.SubElement(joint, "origin", _origin(place))


def _origin(T: Array) -> dict[str, str]:
    return {
        "xyz": " ".join(repr(float(x) + 0.0) for x in T[:3, 3]),
        "rpy": " ".join(repr(float(x) + 0.0) for x in pin.rpy.matrixToRpy(T[:3, :3])),
    }


def _collision(link: ET.Element, shape: Cylinder, frame: Array) -> None:
    """A cylinder along z turned onto the line between both ends, or a sphere."""
    start, end = (frame[:3, :3] @ np.array(x) + frame[:3, 3] for x in (shape.start, shape.end))
    length = float(np.linalg.norm(end - start))
    T = np.eye(4)
    T[:3, 3] = (start + end) / 2
    if length > 0:
        z = (end - start) / length
        side = np.eye(3)[int(np.argmin(np.abs(z)))]
        x = side - z * (z @ side)
        x /= np.linalg.norm(x)
        T[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    element = ET.SubElement(link, "collision")
    ET.SubElement(element, "origin", _origin(T))
    geometry = ET.SubElement(element, "geometry")
    radius = repr(float(shape.radius))
    if length > 0:
        ET.SubElement(geometry, "cylinder", length=repr(length), radius=radius)
    else:
        ET.SubElement(geometry, "sphere", radius=radius)


def with_limits_in_urdf(robot: Robot, chain: DHChain) -> Robot:
    """The robot with a URDF text that states the limits of the joints it keeps."""
    rows = [chain.joints.index(joint) for joint in robot.joints]
    free = np.full(chain.nv, np.inf)
    position = np.column_stack([-free, free])
    velocity, torque = free.copy(), free.copy()
    position[rows], velocity[rows] = robot.limits.position, robot.limits.velocity
    torque[rows] = robot.limits.torque
    text = urdf_from_dh(chain, Limits(position, velocity, free, torque))
    return replace(robot, urdf=text)
