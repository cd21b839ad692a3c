"""Reading robots from URDF."""

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
from excitant.robots.chains import Choice, chain, tree
from excitant.robots.motion import Array
from excitant.robots.robot import Limits, Robot

_UNLIMITED = 1e9
_ENDS = ("parent", "child")


def robot_from_urdf(
    text: str,
    *,
    source: str,
    name: str | None = None,
    joints: Sequence[str] | None = None,
    base: str | None = None,
    tip: str | None = None,
    lock: Mapping[str, float] | None = None,
    loops: Sequence[tuple[str, str]] = (),
    gravity: npt.ArrayLike = (0.0, 0.0, -9.81),
) -> Robot:
    """Robot from the text of a URDF.

    Args:
        text: The URDF.
        source: Where it came from, for messages.
        name: Name of the arm; the URDF's own when not given.
        joints: Joints to keep; all others are held. All joints when not given.
        base: Keep only the joints that this link carries.
        tip: Keep only the joints on the way to this link; what it carries goes along.
        lock: Joints to hold and their positions [rad or m]; those that are not kept are held at
            zero, or where the joint puts them that they follow.
        loops: Pairs of links that are tied together outside the tree.
        gravity: Gravity in the base frame [m/s²].

    Raises:
        BadRobot: Not XML, not a URDF, no joints, joints of several degrees of freedom or that
            follow others among those kept, inertias or limits that are not numbers.
        UnknownName: A joint or link that the URDF does not have.
    """
    root = _parse(text, source)
    _check(root, source)
    named = tree(root, source)
    chosen = chain(named, Choice(joints, base, tip, lock, tuple(loops)))
    title = name or root.get("name") or Path(source).stem
    model = _build(_prepared(root), source)
    if chosen.held:
        model = _reduced(model, chosen.held, source)
    if model.nv == 0:
        raise BadRobot(source, "it has no moving joints; name a URDF of an arm")
    model.gravity.linear = np.asarray(gravity, float)
    names = [str(joint) for joint in list(model.names)[1:]]
    return Robot(
        name=title,
        model=model,
        links=tuple(named.joints[joint].child for joint in names),
        revolute=np.array([named.joints[joint].kind != "prismatic" for joint in names]),
        limits=_limits(model),
        urdf=text,
        locked=tuple(sorted((joint, value or 0.0) for joint, value in chosen.held.items())),
        source=source,
        tool=tip or "",
        notes=chosen.notes,
    )


def full_model(root: ET.Element, robot: Robot) -> tuple[pin.Model, Array, list[int]]:
    """Model of a robot's URDF with all joints, to build geometry on.

    Args:
        root: The robot's URDF; its continuous joints become revolute.
        robot: The robot that was read from it.

    Returns:
        The model, a configuration with the locked joints in place, and their indices.
    """
    model = _build(_prepared(root), robot.source)
    joints, reference = _lock(model, dict(robot.locked))
    return model, reference, joints


def _reduced(model: pin.Model, held: Mapping[str, float | None], source: str) -> pin.Model:
    try:
        return pin.buildReducedModel(model, *_lock(model, held))
    except ValueError as error:
        raise BadRobot(source, f"Pinocchio cannot hold joints of it: {error}") from None


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
    links = [str(link.get("name")) for link in root.findall("link")]
    if not links:
        raise BadRobot(source, "it has no <link>; give the URDF of an arm")
    for kind, names in (
        ("link", links),
        ("joint", [str(joint.get("name")) for joint in root.findall("joint")]),
    ):
        double = {name for name in names if names.count(name) > 1}
        if double:
            raise BadRobot(source, f"{kind} '{min(double)}' is defined twice; rename one")
    carried: dict[str, str] = {}
    for joint in root.findall("joint"):
        for end in _ENDS:
            element = joint.find(end)
            if element is None or element.get("link") not in links:
                raise BadRobot(source, f"joint '{joint.get('name')}' has no known {end} link")
        child, name = _child(joint), str(joint.get("name"))
        if child in carried:
            raise BadRobot(
                source,
                f"link '{child}' hangs from two joints, '{carried[child]}' and '{name}': a closed "
                "loop, which a URDF cannot hold; remove one",
            )
        carried[child] = name
    for owner in root:
        for element in owner.iter():
            for key in ("value", "xyz", "rpy", "ixx", "ixy", "ixz", "iyy", "iyz", "izz",
                        "lower", "upper", "effort", "velocity"):  # fmt: skip
                if element.tag in _NUMERIC and key in element.attrib:
                    for word in element.attrib[key].split():
                        number(word, key, owner, source)


_LARGEST = 1e9  # kg, m, rad, kg·m² of anything that is part of an arm
_LIMIT_KEYS = ("lower", "upper", "effort", "velocity")  # large numbers that mean no limit
_NUMERIC = ("mass", "inertia", "origin", "limit", "axis")


def number(text: str, key: str, owner: ET.Element, source: str) -> float:
    """A finite number from an attribute of an element's child, or `BadRobot`."""
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise BadRobot(
            source, f"{owner.tag} '{owner.get('name')}': {key}=\"{text}\" is not a number"
        )
    if abs(value) > _LARGEST and key not in _LIMIT_KEYS:
        raise BadRobot(
            source, f"{owner.tag} '{owner.get('name')}': {key}=\"{text}\" is beyond any arm's size"
        )
    return value


def _prepared(root: ET.Element) -> str:
    """The URDF as Pinocchio can take it; ``root`` changes with it."""
    root.set("name", root.get("name") or "robot")
    _bound_continuous_joints(root)
    _rename_links_called_as_joints(root)
    return ET.tostring(root, encoding="unicode")


def _bound_continuous_joints(root: ET.Element) -> None:
    """Make continuous joints revolute with no limits, so that q and q̇ have the same size."""
    for joint in root.findall("joint"):
        if joint.get("type") != "continuous":
            continue
        joint.set("type", "revolute")
        limit = joint.find("limit")
        if limit is None:
            limit = ET.SubElement(joint, "limit")
        for key, value in (("lower", -_UNLIMITED), ("upper", _UNLIMITED)):
            limit.set(key, str(value))
        for key in ("effort", "velocity"):
            limit.set(key, limit.get(key) or str(_UNLIMITED))


def _rename_links_called_as_joints(root: ET.Element) -> None:
    """Give links that share a joint's name another one: Pinocchio cannot hold such joints."""
    taken = {str(element.get("name")) for element in root}
    joints = {str(joint.get("name")) for joint in root.findall("joint")}
    links = {str(link.get("name")) for link in root.findall("link")}
    new = {}
    for name in sorted(joints & links):
        new[name] = f"{name}_link"
        while new[name] in taken:
            new[name] += "_"
        taken.add(new[name])
    for link in root.findall("link"):
        link.set("name", new.get(str(link.get("name")), str(link.get("name"))))
    for end in (e for joint in root.findall("joint") for e in joint if e.tag in _ENDS):
        end.set("link", new.get(str(end.get("link")), str(end.get("link"))))


def _build(text: str, source: str) -> pin.Model:
    with _captured_stderr() as messages:
        try:
            return pin.buildModelFromXML(text)
        except Exception as error:
            first = next(iter(messages()), str(error).splitlines()[0] if str(error) else "")
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


def _child(joint: ET.Element) -> str:
    child = joint.find("child")
    assert child is not None  # checked in _check
    return str(child.get("link"))


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
