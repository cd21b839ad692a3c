"""Robots from URDF text."""

from __future__ import annotations

import os
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from excitant.exceptions import BadRobot
from excitant.robots.chains import RobotSpec, held_joints, tree
from excitant.robots.limits import Limits
from excitant.robots.motion import Array
from excitant.robots.robot import Robot
from excitant.robots.urdf_writer import ENDS, LIMIT_KEYS, RENAMED, UNLIMITED

GRAVITY = (0.0, 0.0, -9.81)


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
        for end in ENDS:
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
_NUMBERS = {
    "mass": ("value",),
    "inertia": ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"),
    "origin": ("xyz", "rpy"),
    "axis": ("xyz",),
    "limit": LIMIT_KEYS,
}


def number(text: str, key: str, owner: ET.Element, source: str) -> float:
    """A finite number from an attribute of an element's child, or `BadRobot`."""
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    why = "" if np.isfinite(value) else "not a number"
    if abs(value) > _LARGEST and key not in LIMIT_KEYS:
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
        limit.attrib |= {"lower": str(-UNLIMITED), "upper": str(UNLIMITED)}
        for key in ("effort", "velocity"):
            limit.set(key, limit.get(key) or str(UNLIMITED))


def _rename_links_called_as_joints(root: ET.Element) -> None:
    """Give links that share a joint's name another one: Pinocchio cannot hold such joints."""
    joints = {joint.get("name") for joint in root.findall("joint")}
    named = [(link, "name") for link in root.findall("link")]
    named += [(end, "link") for tag in ENDS for end in root.findall(f"joint/{tag}")]
    for element, key in named:
        if element.get(key) in joints:
            element.set(key, f"{element.get(key)}{RENAMED}")


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
    position = np.where(np.abs(position) >= UNLIMITED, np.copysign(np.inf, position), position)
    unset = position[:, 0] >= position[:, 1]
    position[unset] = (-np.inf, np.inf)
    velocity, effort = (
        np.where((limit <= 0) | (limit >= UNLIMITED), np.inf, limit)
        for limit in (np.array(model.velocityLimit), np.array(model.effortLimit))
    )
    return Limits(position, velocity, np.full(model.nv, np.inf), effort)
