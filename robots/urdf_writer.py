"""URDF text: of an arm as it is now, of its limits, and elements of descriptions."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING
from xml.etree.ElementTree import Element, SubElement, fromstring, indent, tostring

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from excitant.robots.chains import tree
from excitant.robots.limits import UNLIMITED
from excitant.robots.motion import Array
from excitant.robots.parameters import elements, steiner

if TYPE_CHECKING:
    from excitant.robots.robot import Robot

ENDS = ("parent", "child")
# large numbers that mean no limit
LIMIT_KEYS = ("lower", "upper", "effort", "velocity")


def current_urdf(robot: Robot) -> str:
    """The arm's description with its present inertias and friction, and its held joints fixed.

    Each moving link gets the inertia of everything it carries: links fixed to it, or held by a
    locked joint, lose their own ``<inertial>`` so that nothing counts twice. Viscous and Coulomb
    friction are ``<dynamics damping friction>``; negative ones, which URDF does not know, are 0.
    """
    root = fromstring(robot.description)
    held = {name for name, _ in robot.locked}
    friction = {kind: np.zeros(robot.nv) for kind in ("viscous", "coulomb")}
    carrying = robot
    for effect in (effect for effect in robot.effects if effect.values is not None):
        if effect.role != "torque":  # a payload, or other inertia of a link
            carrying = effect.applied(carrying)
        elif effect.export.joint_property in friction:
            friction[effect.export.joint_property][effect.rows(robot)] += (
                effect.values or ()
            )
    values = dict(zip(robot.links, carrying.phi.reshape(-1, 10), strict=True))
    braking = np.maximum(list(friction.values()), 0.0).T.tolist()
    dry = dict(zip(robot.joints, braking, strict=True))
    named = tree(root, robot.source)
    zeros = dict(robot.zeros)
    for link in root.findall("link"):
        name = link.attrib["name"]
        if not named.carrier(name, robot.links):
            continue
        for inertial in link.findall("inertial"):
            link.remove(inertial)
        if name in values:
            link.insert(0, inertial_element(values[name]))
    for name, joint in stated_joints(root).items():
        if name in dry:
            viscous, coulomb = dry[name]
            dynamics = joint.find("dynamics")
            if dynamics is None:
                dynamics = SubElement(joint, "dynamics")
            dynamics.attrib |= {"damping": repr(viscous), "friction": repr(coulomb)}
            if turned := zeros.get(name):
                _turn(joint, turned)
        elif name in held:
            _fix(joint, robot.model)
        for mimic in joint.findall("mimic"):
            if mimic.get("joint") in held:
                joint.remove(mimic)
    return urdf_text(root)


def _fix(joint: Element, model: pin.Model) -> None:
    """Make a joint fixed where it is held: both its links are part of one body."""
    for element in [element for element in joint if element.tag not in ENDS]:
        joint.remove(element)
    links = {element.tag: str(element.get("link")) for element in joint}
    frames = (model.getFrameId(links[end], pin.FrameType.BODY) for end in ENDS)
    parent, child = (model.frames[frame].placement for frame in frames)
    T = parent.actInv(child)
    joint.append(origin_element(T.rotation, T.translation))
    joint.set("type", "fixed")


def _turn(joint: Element, angle: float) -> None:
    """Turn a joint's zero position about its axis [rad]."""
    place = stated_place(joint)
    axis = floats(child_attribute(joint, "axis", "xyz", "1 0 0"))
    about = pin.AngleAxis(angle, axis / np.linalg.norm(axis)).toRotationMatrix()
    turned = origin_element(place.rotation @ about, place.translation)
    origin = joint.find("origin")
    if origin is None:
        joint.append(turned)
    else:
        origin.attrib |= turned.attrib


def stated_joints(root: Element) -> dict[str, Element]:
    """Joints of a description by name."""
    return {joint.attrib["name"]: joint for joint in root.findall("joint")}


def child_attribute(element: Element, child: str, key: str, default: str) -> str:
    """Attribute of an element's child, or a default where there is none."""
    inner = element.find(child)
    return default if inner is None else inner.get(key) or default


def stated_place(element: Element) -> pin.SE3:
    """Placement that an element's ``<origin xyz rpy>`` states; none is the identity."""
    xyz, rpy = (
        floats(child_attribute(element, "origin", key, "0 0 0"))
        for key in ("xyz", "rpy")
    )
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), xyz)


def floats(text: str) -> Array:
    """Numbers of a text."""
    return np.array(text.split(), float)


def urdf_text(root: Element) -> str:
    """The text of a URDF, indented."""
    indent(root)
    return tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def limits_in_urdf(robot: Robot) -> Robot:
    """The robot with a URDF text that states the limits of the joints it keeps."""
    root = fromstring(robot.description)
    limits = robot.limits
    stated = stated_joints(root)
    for j, joint in enumerate(stated[name] for name in robot.joints):
        values = (*limits.position[j], limits.torque[j], limits.velocity[j])
        numbers = dict(zip(LIMIT_KEYS, values, strict=True))
        if robot.revolute[j]:
            joint.set("type", "revolute")
            if np.isinf(limits.position[j]).all():
                joint.set("type", "continuous")
                del numbers["lower"], numbers["upper"]
        for limit in joint.findall("limit"):
            joint.remove(limit)
        words = {
            k: repr(float(np.clip(x, -UNLIMITED, UNLIMITED)))
            for k, x in numbers.items()
        }
        SubElement(joint, "limit", words)
    return replace(robot, description=urdf_text(root))


def joint_element(
    root: Element, name: str, kind: str, parent: str, child: str, pose: Array
) -> Element:
    """A new ``<joint>`` whose frame has a pose in the parent link, shape (4, 4)."""
    joint = SubElement(root, "joint", name=name, type=kind)
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    joint.append(origin_element(pose[:3, :3], pose[:3, 3]))
    return joint


def numbers_text(values: npt.ArrayLike) -> str:
    """Numbers as a URDF has them, with all their digits."""
    return " ".join(repr(float(value) + 0.0) for value in np.ravel(values))


def origin_element(rotation: Array, translation: Array) -> Element:
    """``<origin>`` of a pose."""
    rpy = numbers_text(pin.rpy.matrixToRpy(rotation))
    return Element("origin", xyz=numbers_text(translation), rpy=rpy)


def collision(place: pin.SE3, shape: str, **attributes: str) -> Element:
    """``<collision>`` of a shape at a pose in its link."""
    element = Element("collision")
    element.append(origin_element(place.rotation, place.translation))
    SubElement(SubElement(element, "geometry"), shape, attributes)
    return element


def inertial_element(phi: Array) -> Element:
    """``<inertial>`` of standard parameters about the link's frame, shape (10,)."""
    mass = phi[0]
    lever = phi[1:4] / mass if mass else np.zeros(3)
    xx, xy, yy, xz, yz, zz = phi[4:] - elements(steiner(mass, lever))
    element = Element("inertial")
    SubElement(element, "origin", xyz=numbers_text(lever), rpy="0 0 0")
    SubElement(element, "mass", value=repr(float(mass)))
    tensor = {"ixx": xx, "ixy": xy, "ixz": xz, "iyy": yy, "iyz": yz, "izz": zz}
    SubElement(
        element, "inertia", {key: repr(float(x)) for key, x in tensor.items()}
    )
    return element
