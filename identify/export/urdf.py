"""A model as URDF: the one it was read from, with identified inertias and friction."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import pinocchio as pin

from excitant.identify.export.bodies import Tree, written
from excitant.robots.urdf import urdf_with_parameters

_OF_MOVING_JOINTS = ("axis", "limit", "dynamics", "mimic", "calibration", "safety_controller")


def urdf_text(arm: Tree, complete: str) -> str:
    """URDF text of an arm; meshes and everything else in its URDF stay.

    Each moving link has the inertia of all it carries. Joints that are held become fixed joints
    at their position, since what they carry is part of other links now.

    Args:
        arm: The model.
        complete: File that holds everything, to refer to.
    """
    friction = {b.joint: (b.positive("viscous"), b.positive("coulomb")) for b in arm.bodies}
    root = ET.fromstring(urdf_with_parameters(arm.robot, arm.robot.phi, friction))
    held = {name for name, _ in arm.robot.locked}
    for joint in root.findall("joint"):
        if joint.get("name") in held:
            _fix(joint, arm.robot.model)
        for mimic in joint.findall("mimic"):
            if mimic.get("joint") in held:
                joint.remove(mimic)
    root.insert(0, ET.Comment(arm.comment("urdf", complete)))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _fix(joint: ET.Element, model: pin.Model) -> None:
    """Make a joint fixed where it is held: both its links are part of one body."""
    for tag in (*_OF_MOVING_JOINTS, "origin"):
        for element in joint.findall(tag):
            joint.remove(element)
    links = {element.tag: element.get("link") for element in joint}
    parent, child = (
        model.frames[model.getFrameId(links[end], pin.FrameType.BODY)].placement
        for end in ("parent", "child")
    )
    T = parent.actInv(child)
    rpy = written(pin.rpy.matrixToRpy(T.rotation))
    ET.SubElement(joint, "origin", xyz=written(T.translation), rpy=rpy)
    joint.set("type", "fixed")
