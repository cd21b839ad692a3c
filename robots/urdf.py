"""Robots from URDF text, and back: parameters, limits and friction written into it."""

from __future__ import annotations

import os
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from excitant.exceptions import BadRobot
from excitant.robots.chains import RobotSpec, held_joints, tree
from excitant.robots.limits import Limits
from excitant.robots.motion import Array
from excitant.robots.parameters import elements, steiner
from excitant.robots.robot import Robot

GRAVITY = (0.0, 0.0, -9.81)
_OF_MOVING_JOINTS = ("axis", "limit", "dynamics", "mimic", "calibration", "safety_controller")
_UNLIMITED = 1e9
_ENDS, _RENAMED = ("parent", "child"), " (link)"


def robot_from_urdf(
    text: str,
    source: str | RobotSpec,
    *,
    name: str | None = None,
    loops: Sequence[tuple[str, str]] = (),
    gravity: npt.ArrayLike = GRAVITY,
) -> Robot:
    """Robot from the text of a URDF.

    Args:
        text: The URDF.
        source: Where it came from, for messages, and perhaps which part of it is meant.
        name: Name of the arm; the URDF's own when not given.
        loops: Pairs of links that are tied together outside the tree.
        gravity: Gravity in the base frame [m/s²].

    Raises:
        BadRobot: Not XML, not a URDF, no joints, joints of several degrees of freedom or that
            follow others among those kept, inertias or limits that are not numbers.
        UnknownName: A joint or link that the URDF does not have.
    """
    spec = source if isinstance(source, RobotSpec) else RobotSpec(source)
    source = str(spec)
    root = _parse(text, source)
    _check(root, source)
    named = tree(root, source)
    held, notes = held_joints(named, spec, loops)
    title = name or root.get("name") or Path(source).stem
    model = _build(root, source)
    if held:
        try:
            model = pin.buildReducedModel(model, *_lock(model, held))
        except ValueError as error:
            raise BadRobot(source, f"Pinocchio cannot hold joints of it: {error}") from None
    if model.nv == 0:
        raise BadRobot(source, "it has no moving joints; name a URDF of an arm")
    model.gravity.linear = np.asarray(gravity, float)
    moving = [named.joints[str(joint)] for joint in list(model.names)[1:]]
    return Robot(
        name=title,
        model=model,
        links=tuple(joint.child for joint in moving),
        revolute=np.array([joint.kind != "prismatic" for joint in moving]),
        limits=_limits(model),
        description=text,
        locked=tuple(sorted((joint, value or 0.0) for joint, value in held.items())),
        source=source,
        tool=spec.tip or "",
        notes=notes,
    )


def full_model(root: ET.Element, robot: Robot) -> tuple[pin.Model, Array, list[int]]:
    """Model of a robot's URDF with all joints, to build geometry on; changes the URDF.

    Returns:
        The model, a configuration with the locked joints in place, and their indices.
    """
    model = _build(root, robot.source)
    joints, reference = _lock(model, dict(robot.locked))
    return model, reference, joints


def _lock(model: pin.Model, held: Mapping[str, float | None]) -> tuple[list[int], Array]:
    """Indices of held joints, and a configuration that has them in place."""
    reference: Array = pin.neutral(model)
    for name, value in held.items():
        joint = model.joints[model.getJointId(name)]
        if joint.nq == 1:
            reference[joint.idx_q] = value
    return [model.getJointId(name) for name in held], reference


def _parse(text: str, source: str) -> ET.Element:
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise BadRobot(source, f"not XML ({error}); give a URDF file") from None
    if root.tag != "robot":
        raise BadRobot(source, f"not a URDF: the root element is <{root.tag}>, not <robot>")
    return root


def _check(root: ET.Element, source: str) -> None:
    """Refuse what Pinocchio would accept in silence or crash on."""
    links, joints = (
        [str(element.get("name")) for element in root.findall(tag)] for tag in ("link", "joint")
    )
    if not links:
        raise BadRobot(source, "it has no <link>; give the URDF of an arm")
    for kind, names in (("link", links), ("joint", joints)):
        double = {name for name in names if names.count(name) > 1}
        if double:
            raise BadRobot(source, f"{kind} '{min(double)}' is defined twice; rename one")
    carried: dict[str, str] = {}
    for joint, name in zip(root.findall("joint"), joints, strict=True):
        for end in _ENDS:
            element = joint.find(end)
            if element is None or element.get("link") not in links:
                raise BadRobot(source, f"joint '{name}' has no known {end} link")
            child = str(element.get("link"))
        if child in carried:
            raise BadRobot(
                source,
                f"link '{child}' hangs from two joints, '{carried[child]}' and '{name}': a closed "
                "loop, which a URDF cannot hold; remove one",
            )
        carried[child] = name
    for owner in root:
        for element in owner.iter():
            for key in _NUMBERS.get(element.tag, ()):
                for word in element.get(key, "").split():
                    number(word, key, owner, source)


_LARGEST = 1e9  # kg, m, rad, kg·m² of anything that is part of an arm
_LIMIT_KEYS = ("lower", "upper", "effort", "velocity")  # large numbers that mean no limit
_NUMBERS = {
    "mass": ("value",),
    "inertia": ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"),
    "origin": ("xyz", "rpy"),
    "axis": ("xyz",),
    "limit": _LIMIT_KEYS,
}


def number(text: str, key: str, owner: ET.Element, source: str) -> float:
    """A finite number from an attribute of an element's child, or `BadRobot`."""
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    why = "" if np.isfinite(value) else "not a number"
    if abs(value) > _LARGEST and key not in _LIMIT_KEYS:
        why = "beyond any arm's size"
    if why:
        raise BadRobot(source, f"{owner.tag} '{owner.get('name')}': {key}=\"{text}\" is {why}")
    return value


def _bound_continuous_joints(root: ET.Element) -> None:
    """Make continuous joints revolute with no limits, so that q and q̇ have the same size."""
    for joint in root.findall("joint[@type='continuous']"):
        joint.set("type", "revolute")
        limit = joint.find("limit")
        limit = ET.SubElement(joint, "limit") if limit is None else limit
        limit.attrib |= {"lower": str(-_UNLIMITED), "upper": str(_UNLIMITED)}
        for key in ("effort", "velocity"):
            limit.set(key, limit.get(key) or str(_UNLIMITED))


def _rename_links_called_as_joints(root: ET.Element) -> None:
    """Give links that share a joint's name another one: Pinocchio cannot hold such joints."""
    joints = {joint.get("name") for joint in root.findall("joint")}
    named = [(link, "name") for link in root.findall("link")]
    named += [(end, "link") for tag in _ENDS for end in root.findall(f"joint/{tag}")]
    for element, key in named:
        if element.get(key) in joints:
            element.set(key, f"{element.get(key)}{_RENAMED}")


def _build(root: ET.Element, source: str) -> pin.Model:
    """Pinocchio's model; the URDF is changed into one that Pinocchio can take."""
    root.set("name", root.get("name") or "robot")
    _bound_continuous_joints(root)
    _rename_links_called_as_joints(root)
    with _captured_stderr() as messages:
        try:
            return pin.buildModelFromXML(ET.tostring(root, encoding="unicode"))
        except Exception as error:
            first = next(iter(messages()), str(error).partition("\n")[0])
            raise BadRobot(source, f"Pinocchio cannot read it: {first}") from None


@contextmanager
def _captured_stderr() -> Iterator[Callable[[], list[str]]]:
    """Collect what C++ libraries write to the error stream."""
    with tempfile.TemporaryFile() as sink:
        saved = os.dup(2)
        os.dup2(sink.fileno(), 2)

        def messages() -> list[str]:
            sink.seek(0)
            return [line for line in sink.read().decode(errors="replace").splitlines() if line]

        try:
            yield messages
        finally:
            os.dup2(saved, 2)
            os.close(saved)


def _limits(model: pin.Model) -> Limits:
    """Limits of the URDF; zero speed or effort means that none was given."""
    position = np.column_stack([model.lowerPositionLimit, model.upperPositionLimit])
    position = np.where(np.abs(position) >= _UNLIMITED, np.copysign(np.inf, position), position)
    unset = position[:, 0] >= position[:, 1]
    position[unset] = (-np.inf, np.inf)
    velocity, effort = (
        np.where((limit <= 0) | (limit >= _UNLIMITED), np.inf, limit)
        for limit in (np.array(model.velocityLimit), np.array(model.effortLimit))
    )
    return Limits(position, velocity, np.full(model.nv, np.inf), effort)


def current_urdf(robot: Robot) -> str:
    """The arm's description with its present inertias and friction, and its held joints fixed.

    Each moving link gets the inertia of everything it carries: links fixed to it, or held by a
    locked joint, lose their own ``<inertial>`` so that nothing counts twice. Viscous and Coulomb
    friction are ``<dynamics damping friction>``; negative ones, which URDF does not know, are 0.
    """
    root, held = ET.fromstring(robot.description), {name for name, _ in robot.locked}
    friction = {kind: np.zeros(robot.nv) for kind in ("viscous", "coulomb")}
    carrying = robot
    for effect in (effect for effect in robot.effects if effect.values is not None):
        if effect.role != "torque":  # a payload, or other inertia of a link
            carrying = effect.applied(carrying)
        elif effect.joint_property in friction:
            friction[effect.joint_property][effect.rows(robot)] += effect.values or ()
    values = dict(zip(robot.links, carrying.phi.reshape(-1, 10), strict=True))
    dry = dict(zip(robot.joints, np.maximum(list(friction.values()), 0.0).T.tolist(), strict=True))
    named = tree(root, robot.source)
    for link in root.findall("link"):
        name = str(link.get("name"))
        if not named.carrier(name, robot.links):
            continue
        for inertial in link.findall("inertial"):
            link.remove(inertial)
        if name in values:
            link.insert(0, inertial_element(values[name]))
    for joint in root.findall("joint"):
        if (own := dry.get(str(joint.get("name")))) is not None:
            dynamics = joint.find("dynamics")
            dynamics = ET.SubElement(joint, "dynamics") if dynamics is None else dynamics
            dynamics.attrib |= {"damping": repr(own[0]), "friction": repr(own[1])}
        elif joint.get("name") in held:
            _fix(joint, robot.model)
        for mimic in joint.findall("mimic"):
            if mimic.get("joint") in held:
                joint.remove(mimic)
    return urdf_text(root)


def _fix(joint: ET.Element, model: pin.Model) -> None:
    """Make a joint fixed where it is held: both its links are part of one body."""
    for tag in (*_OF_MOVING_JOINTS, "origin"):
        for element in joint.findall(tag):
            joint.remove(element)
    links = {element.tag: str(element.get("link")) for element in joint}
    names = [links[end] + _RENAMED * (not model.existBodyName(links[end])) for end in _ENDS]
    frames = (model.getFrameId(name, pin.FrameType.BODY) for name in names)
    parent, child = (model.frames[frame].placement for frame in frames)
    T = parent.actInv(child)
    joint.append(origin_element(T.rotation, T.translation))
    joint.set("type", "fixed")


def urdf_text(root: ET.Element) -> str:
    """The text of a URDF, indented."""
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def limits_in_urdf(robot: Robot) -> Robot:
    """The robot with a URDF text that states the limits of the joints it keeps."""
    root, limits = ET.fromstring(robot.description), robot.limits
    stated = {str(joint.get("name")): joint for joint in root.findall("joint")}
    for j, joint in enumerate(stated[name] for name in robot.joints):
        values = (*limits.position[j], limits.torque[j], limits.velocity[j])
        numbers = dict(zip(_LIMIT_KEYS, values, strict=True))
        if robot.revolute[j]:
            joint.set("type", "revolute")
            if np.isinf(limits.position[j]).all():
                joint.set("type", "continuous")
                del numbers["lower"], numbers["upper"]
        for limit in joint.findall("limit"):
            joint.remove(limit)
        words = {k: repr(float(np.clip(x, -_UNLIMITED, _UNLIMITED))) for k, x in numbers.items()}
        ET.SubElement(joint, "limit", words)
    return replace(robot, description=urdf_text(root))


def joint_element(
    root: ET.Element, name: str, kind: str, parent: str, child: str, pose: Array
) -> ET.Element:
    """A new ``<joint>`` whose frame has a pose in the parent link, shape (4, 4)."""
    joint = ET.SubElement(root, "joint", name=name, type=kind)
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    joint.append(origin_element(pose[:3, :3], pose[:3, 3]))
    return joint


def numbers_text(values: Iterable[float]) -> str:
    """Numbers as a URDF has them, with all their digits."""
    return " ".join(repr(float(value) + 0.0) for value in values)


def origin_element(rotation: Array, translation: Array) -> ET.Element:
    """``<origin>`` of a pose."""
    rpy = pin.rpy.matrixToRpy(np.asarray(rotation))
    return ET.Element("origin", xyz=numbers_text(translation), rpy=numbers_text(rpy))


def collision(place: pin.SE3, shape: str, **attributes: str) -> ET.Element:
    """``<collision>`` of a shape at a pose in its link."""
    element = ET.Element("collision")
    element.append(origin_element(place.rotation, place.translation))
    ET.SubElement(ET.SubElement(element, "geometry"), shape, attributes)
    return element


def inertial_element(phi: Array) -> ET.Element:
    """``<inertial>`` of standard parameters about the link's frame, shape (10,)."""
    mass = phi[0]
    lever = phi[1:4] / mass if mass else np.zeros(3)
    xx, xy, yy, xz, yz, zz = phi[4:] - elements(steiner(mass, lever))
    element = ET.Element("inertial")
    ET.SubElement(element, "origin", xyz=numbers_text(lever), rpy="0 0 0")
    ET.SubElement(element, "mass", value=repr(float(mass)))
    tensor = {"ixx": xx, "ixy": xy, "ixz": xz, "iyy": yy, "iyz": yz, "izz": zz}
    ET.SubElement(element, "inertia", {key: repr(float(x)) for key, x in tensor.items()})
    return element
