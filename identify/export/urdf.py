"""A model as URDF: the one it was read from, with identified inertias and friction."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin

from excitant.identify.export.bodies import folded, tree, written
from excitant.identify.export.notes import as_comment, not_held
from excitant.robots.motion import Array
from excitant.robots.robot import Robot
from excitant.robots.urdf import urdf_with_parameters

_OF_MOVING_JOINTS = ("axis", "limit", "dynamics", "mimic", "calibration", "safety_controller")


def urdf_text(robot: Robot, complete: str) -> str:
    """URDF text of a robot; meshes and everything else in its URDF stay.

    Each moving link has the inertia of all it carries. Joints that are held become fixed joints
    at their position, since what they carry is part of other links now.

    Args:
        robot: The model.
        complete: File that holds everything, to refer to.
    """
    arm = tree(robot)
    friction = {body.joint: (body.viscous, body.coulomb) for body in arm.bodies}
    root = ET.fromstring(urdf_with_parameters(robot, folded(robot).phi, friction))
    joints = {joint.get("name"): joint for joint in root.findall("joint")}
    for name, position in robot.locked:
        _fix(joints[name], position)
    for joint in joints.values():
        for mimic in joint.findall("mimic"):
            if mimic.get("joint") in dict(robot.locked):
                joint.remove(mimic)
    root.insert(0, ET.Comment(as_comment(not_held(arm, "urdf"), complete)))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _fix(joint: ET.Element, position: float) -> None:
    """Make a joint fixed where it is held."""
    kind, axis = joint.get("type"), joint.find("axis")
    direction = _numbers(axis, "xyz", (1.0, 0.0, 0.0))
    length = float(np.linalg.norm(direction))
    if length > 0:
        direction /= length
    origin = joint.find("origin")
    place, rpy = (_numbers(origin, key, (0.0, 0.0, 0.0)) for key in ("xyz", "rpy"))
    R = pin.rpy.rpyToMatrix(rpy)
    if kind == "prismatic":
        place = place + position * R @ direction
    elif position:
        rpy = pin.rpy.matrixToRpy(R @ pin.AngleAxis(position, direction).toRotationMatrix())
    for tag in _OF_MOVING_JOINTS:
        for element in joint.findall(tag):
            joint.remove(element)
    if origin is None:
        origin = ET.SubElement(joint, "origin")
    origin.attrib.update(xyz=written(place), rpy=written(rpy))
    joint.set("type", "fixed")


def _numbers(element: ET.Element | None, key: str, default: tuple[float, ...]) -> Array:
    text = None if element is None else element.get(key)
    return np.array(default if text is None else text.split(), float)
