"""A model as SDFormat 1.9, the format of Gazebo and Drake."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable

import numpy as np

from excitant.identify.export.bodies import Body, Frame, Tree, quaternion, written
from excitant.robots.motion import Array
from excitant.robots.parameters import inertia

_BASE, _MOUNT = "base", "mount"


def sdf_text(arm: Tree, complete: str) -> str:
    """SDF text of an arm, fixed in a world, which is where SDF holds gravity; no meshes.

    Viscous friction is ``damping``, Coulomb friction ``friction`` of the axis, rotor inertia
    ``drake:rotor_inertia``. Links, joints and frames share one list of names, so one that
    occurs twice gets an underscore.

    Args:
        arm: The model.
        complete: File that holds everything, to refer to.
    """
    root = ET.Element("sdf", {"version": "1.9", "xmlns:drake": "drake.mit.edu"})
    root.append(ET.Comment(arm.comment("sdf", complete)))
    world = ET.SubElement(root, "world", name="default")
    _text(world, "gravity", written(arm.robot.gravity))
    model = ET.SubElement(world, "model", name=_unreserved(arm.robot.name))
    links = [_unreserved(body.link) for body in arm.bodies]
    taken = set(links)
    base = _fresh(_BASE, taken)
    joints = [_fresh(body.joint, taken) for body in arm.bodies]
    ET.SubElement(model, "link", name=base)
    mount = ET.SubElement(model, "joint", name=_fresh(_MOUNT, taken), type="fixed")
    _ends(mount, "world", base)
    for body, link, joint in zip(arm.bodies, links, joints, strict=True):
        _link(model, body, link, joint)
        parent = base if body.parent < 0 else links[body.parent]
        _joint(model, body, joint, parent, link)
        _frames(model, body.frames, link, taken)
    _frames(model, arm.base_frames, base, taken)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _link(model: ET.Element, body: Body, name: str, joint: str) -> None:
    link = ET.SubElement(model, "link", name=name)
    ET.SubElement(link, "pose", relative_to=joint)
    inertial = ET.SubElement(link, "inertial")
    central = inertia(body.phi)
    _text(inertial, "pose", f"{written(central.lever)} 0 0 0")
    _text(inertial, "mass", written(central.mass))
    tensor = ET.SubElement(inertial, "inertia")
    for i, j in zip(*np.triu_indices(3), strict=True):
        _text(tensor, f"i{'xyz'[i]}{'xyz'[j]}", written(central.inertia[i, j]))


def _joint(model: ET.Element, body: Body, name: str, parent: str, child: str) -> None:
    bounded = bool(np.isfinite(body.position).all())
    kind = "prismatic" if not body.revolute else "revolute" if bounded else "continuous"
    joint = ET.SubElement(model, "joint", name=name, type=kind)
    _pose(joint, body.placement, parent)
    _ends(joint, parent, child)
    axis = ET.SubElement(joint, "axis")
    _text(axis, "xyz", written(body.axis))
    limit = ET.SubElement(axis, "limit")
    names = ("lower", "upper", "effort", "velocity")
    for key, value in zip(names, (*body.position, body.torque, body.velocity), strict=True):
        if np.isfinite(value):
            _text(limit, key, written(value))
    dynamics = ET.SubElement(axis, "dynamics")
    _text(dynamics, "damping", written(body.positive("viscous")))
    _text(dynamics, "friction", written(body.positive("coulomb")))
    if body.positive("rotor"):
        _text(joint, "drake:rotor_inertia", written(body.positive("rotor")))


def _frames(model: ET.Element, frames: Iterable[Frame], link: str, taken: set[str]) -> None:
    for frame in frames:
        name = _fresh(_unreserved(frame.name), taken)
        element = ET.SubElement(model, "frame", name=name, attached_to=link)
        _pose(element, frame.pose, link)


def _pose(parent: ET.Element, T: Array, relative_to: str) -> None:
    w, x, y, z = quaternion(T[:3, :3])
    pose = ET.SubElement(parent, "pose", relative_to=relative_to, rotation_format="quat_xyzw")
    pose.text = written([*T[:3, 3], x, y, z, w])


def _ends(joint: ET.Element, parent: str, child: str) -> None:
    _text(joint, "parent", parent)
    _text(joint, "child", child)


def _text(parent: ET.Element, tag: str, text: str) -> None:
    ET.SubElement(parent, tag).text = text


def _fresh(name: str, taken: set[str]) -> str:
    """A name that is not taken yet, and is from now on."""
    while name in taken:
        name += "_"
    taken.add(name)
    return name


def _unreserved(name: str) -> str:
    """A name that SDF does not keep for itself: ``world``, and what two underscores enclose."""
    name = name.replace("::", "_")
    reserved = name == "world" or (name.startswith("__") and name.endswith("__"))
    return f"{name.strip('_')}_link" if reserved else name
