"""A model as MJCF, the format of MuJoCo."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np

from excitant.identify.export.bodies import Body, Frame, Tree, quaternion, written
from excitant.robots.motion import Array
from excitant.robots.parameters import inertia

_THIN = 1e-3  # m: shorter distances between joints are not drawn


def mjcf_text(arm: Tree, complete: str, gains: Array | None = None) -> str:
    """MJCF text of an arm: bodies on their joints, actuators, frames as sites; no meshes.

    Viscous friction is ``damping``, Coulomb friction ``frictionloss``, rotor inertia
    ``armature``, a torque offset the bias of the joint's actuator. A control is a torque [N·m],
    or a current [A] where drive gains are given.

    Args:
        arm: The model.
        complete: File that holds everything, to refer to.
        gains: Torque per control, the ``gear`` of the actuators, shape (nv,); ones if None.
    """
    root = ET.Element("mujoco", model=arm.robot.name)
    root.append(ET.Comment(arm.comment("mjcf", complete)))
    ET.SubElement(root, "compiler", angle="radian", inertiafromgeom="false", autolimits="true")
    ET.SubElement(root, "option", gravity=written(arm.robot.gravity), integrator="implicitfast")
    default = ET.SubElement(root, "default")
    ET.SubElement(default, "geom", contype="0", conaffinity="0", group="1")
    world = ET.SubElement(root, "worldbody")
    _sites(world, arm.base_frames)
    elements = [world]  # that of body i is at i + 1
    for i, body in enumerate(arm.bodies):
        element = _body(elements[body.parent + 1], body)
        for child in arm.bodies:
            if child.parent == i:
                _bone(element, child.placement[:3, 3])
        elements.append(element)
    actuators = ET.SubElement(root, "actuator")
    for j, body in enumerate(arm.bodies):
        _actuator(actuators, body, 1.0 if gains is None else float(gains[j]))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _body(parent: ET.Element, body: Body) -> ET.Element:
    name = body.link if body.link != "world" else "world_"  # that of MuJoCo's own root
    element = ET.SubElement(parent, "body", {"name": name, **_pose(body.placement)})
    central = inertia(body.phi)
    moments, axes = np.linalg.eigh(central.inertia)
    axes[:, 0] *= np.linalg.det(axes)
    ET.SubElement(
        element,
        "inertial",
        pos=written(central.lever),
        quat=written(quaternion(axes)),
        mass=written(central.mass),
        diaginertia=written(moments),
    )
    _joint(element, body)
    _sites(element, body.frames)
    return element


def _joint(parent: ET.Element, body: Body) -> None:
    kind = "hinge" if body.revolute else "slide"
    joint = ET.SubElement(parent, "joint", name=body.joint, type=kind, axis=written(body.axis))
    if np.isfinite(body.position).all():
        joint.set("range", written(body.position))
    names = {"damping": "viscous", "frictionloss": "coulomb", "armature": "rotor"}
    for key, name in names.items():
        if body.positive(name):
            joint.set(key, written(body.positive(name)))


def _actuator(parent: ET.Element, body: Body, gain: float) -> None:
    """Force = gear (control + bias), the bias against the offset that the model needs."""
    actuator = ET.SubElement(parent, "general", name=body.joint, joint=body.joint)
    actuator.set("gear", written(gain))
    offset = body.properties.get("offset", 0.0)
    if offset:
        actuator.set("biastype", "affine")
        actuator.set("biasprm", written([-offset / gain, 0.0, 0.0]))
    if np.isfinite(body.torque):
        largest = body.torque / abs(gain)
        actuator.set("ctrlrange", written([-largest, largest]))


def _sites(parent: ET.Element, frames: tuple[Frame, ...]) -> None:
    for frame in frames:
        ET.SubElement(parent, "site", {"name": frame.name, **_pose(frame.pose)})


def _bone(parent: ET.Element, end: Array) -> None:
    """A line to the next joint, for the eye only."""
    length = float(np.linalg.norm(end))
    if length > _THIN:
        size = written(0.1 * min(length, 0.5))
        ET.SubElement(parent, "geom", type="capsule", size=size, fromto=f"0 0 0 {written(end)}")


def _pose(T: Array) -> dict[str, str]:
    return {"pos": written(T[:3, 3]), "quat": written(quaternion(T[:3, :3]))}
