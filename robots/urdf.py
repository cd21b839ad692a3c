"""Robots from URDF text."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from excitant.exceptions import BadRobot
from excitant.files import real_path
from excitant.robots.angles import Angles
from excitant.robots.chains import RobotSpec, held_joints, tree
from excitant.robots.files import parse_xml
from excitant.robots.limits import LEAST, UNLIMITED, Limits
from excitant.robots.robot import Robot
from excitant.robots.urdf_model import build_model, held_pose, restore_link_names
from excitant.robots.urdf_shapes import URDF
from excitant.robots.urdf_writer import (
    ENDS,
    LIMIT_KEYS,
    child_attribute,
    stated_joints,
)

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
    angles = Angles()
    text = angles.urdf(text)
    root = parse_xml(text, source)
    _check(root, source)
    weight = np.array(gravity, float)
    if not (np.abs(weight) < UNLIMITED).all():
        raise BadRobot(
            source, f"gravity {weight.tolist()} is none; give it in m/s²"
        )
    named = tree(root, source)
    held, notes = held_joints(named, spec, loops)
    unchosen = [
        joint
        for joint in held
        if joint not in spec.lock and named.joints[joint].is_single
    ]
    title = name or root.get("name") or Path(source).stem
    model = build_model(root, source)
    order = list(model.names)
    if held:
        try:
            model = pin.buildReducedModel(model, *held_pose(model, held))
        except ValueError as error:
            raise BadRobot(
                source, f"Pinocchio cannot hold joints of it: {error}"
            ) from None
    if model.nv == 0:
        raise BadRobot(source, "it has no moving joints; name a URDF of an arm")
    if model.nv > _MOVING:
        why = f"it has {model.nv} moving joints, more than {_MOVING}"
        raise BadRobot(source, f"{why}; choose some with --joints or --tip")
    restore_link_names(model)
    stated = stated_joints(root)
    joints = [stated[joint] for joint in list(model.names)[1:]]
    limits, soft = _softened(_limits(model), joints)
    model.gravity.linear = weight
    moving = [named.joints[joint] for joint in list(model.names)[1:]]
    return Robot(
        name=title,
        model=model,
        links=tuple(joint.child for joint in moving),
        revolute=np.array([joint.kind != "prismatic" for joint in moving]),
        limits=limits,
        description=text,
        locked=tuple(
            sorted((joint, value or 0.0) for joint, value in held.items())
        ),
        unchosen=tuple(sorted(unchosen, key=order.index)),
        source=source,
        tool=spec.tip or "",
        notes=(*angles.notes, *notes, *soft),
        packages=tuple(str(real_path(folder)) for folder in spec.packages),
        format=URDF,
    )


def _check(root: Element, source: str) -> None:
    """Refuse what Pinocchio would accept in silence or crash on."""
    if root.tag != "robot":
        raise BadRobot(
            source, f"not a URDF: the root element is <{root.tag}>, not <robot>"
        )
    named = {
        tag: [str(element.get("name")) for element in root.findall(tag)]
        for tag in ("link", "joint")
    }
    if not named["link"]:
        raise BadRobot(source, "it has no <link>; give the URDF of an arm")
    for kind, names in named.items():
        if len(names) > _MOST:
            raise BadRobot(
                source, f"it has {len(names)} {kind}s; an arm has {_MOST} at most"
            )
        double = [name for name, count in Counter(names).items() if count > 1]
        if double:
            raise BadRobot(
                source, f"{kind} '{min(double)}' is defined twice; rename one"
            )
    carried: dict[str, str] = {}
    for joint, name in zip(root.findall("joint"), named["joint"], strict=True):
        for end in ENDS:
            child = child_attribute(joint, end, "link", "")
            if child not in named["link"]:
                raise BadRobot(source, f"joint '{name}' has no known {end} link")
        if child in carried:
            raise BadRobot(
                source,
                f"link '{child}' hangs from two joints, '{carried[child]}' and '{name}': a closed "
                "loop, which a URDF cannot hold; remove one",
            )
        carried[child] = name
    for owner in (*root.findall("link"), *root.findall("joint")):
        for element in owner.iter():
            for key in _NUMBERS.get(element.tag, ()):
                if (text := element.get(key)) is None:
                    continue
                count = 3 if key in _VECTORS else 1
                words = text.split()
                if len(words) != count:
                    what = f'{key}="{text}" holds {len(words)} numbers instead of {count}'
                    raise BadRobot(
                        source, f"{owner.tag} '{owner.get('name')}': {what}"
                    )
                for word in words:
                    number(word, key, owner, source)
    _refuse_without_limits(root, source)


def _refuse_without_limits(root: Element, source: str) -> None:
    """Refuse joints that need a limit and state none, or one without effort or velocity."""
    lacking: dict[str, list[str]] = {}
    for joint in root.findall("joint"):
        if joint.get("type") not in _LIMITED:
            continue
        limit = joint.find("limit")
        keys = (
            [] if limit is None else [k for k in _STATED if k not in limit.attrib]
        )
        what = (
            f"no {' and no '.join(keys)} in the <limit>" if keys else "no <limit>"
        )
        if keys or limit is None:
            lacking.setdefault(what, []).append(str(joint.get("name")))
    if lacking:
        parts = [f"{what} of {', '.join(names)}" for what, names in lacking.items()]
        raise BadRobot(
            source,
            f"{'; '.join(parts)}: give lower and upper [rad or m], effort [N·m or N] and velocity "
            '[rad/s or m/s], or type="continuous" to a joint that turns without end',
        )


_LIMITED = ("revolute", "prismatic")
_STATED = ("effort", "velocity")  # attributes of a limit that URDF requires
_MOVING = 32  # joints: work grows with their third power; humanoids have 30
_MOST = 1000  # links or joints
_VECTORS = ("xyz", "rpy", "size", "scale")
_NUMBERS = {
    "mass": ("value",),
    "inertia": ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"),
    "origin": ("xyz", "rpy"),
    "axis": ("xyz",),
    "limit": LIMIT_KEYS,
    "dynamics": ("damping", "friction"),
    "mimic": ("multiplier", "offset"),
    "safety_controller": (
        "soft_lower_limit",
        "soft_upper_limit",
        "k_position",
        "k_velocity",
    ),
    "calibration": ("reference_position", "rising", "falling"),
    "sphere": ("radius",),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),
    "box": ("size",),
    "mesh": ("scale",),
}


def number(text: str, key: str, owner: Element, source: str) -> float:
    """A finite number from an attribute of an element's child, or `BadRobot`."""
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    why = "" if np.isfinite(value) else "not a number"
    if abs(value) > UNLIMITED and key not in LIMIT_KEYS:
        why = "beyond any arm's size"
    if key in ("value", *_STATED) and 0 < abs(value) < LEAST:
        what = "body, and not 0, which means no mass" if key == "value" else "limit"
        why = f"too little for a {what}"
    if why:
        raise BadRobot(
            source, f"{owner.tag} '{owner.get('name')}': {key}=\"{text}\" is {why}"
        )
    return value


def _softened(
    limits: Limits, joints: Sequence[Element]
) -> tuple[Limits, list[str]]:
    """Limits within the soft ones of safety controllers, which brake a joint there, and a note."""
    position = np.array(limits.position)
    soft = []
    for row, joint in zip(position, joints, strict=True):
        low, high = (
            float(
                child_attribute(
                    joint, "safety_controller", f"soft_{end}_limit", "0"
                )
            )
            for end in ("lower", "upper")
        )
        inner = np.clip([low, high], *row)
        if inner[0] < inner[1] and (inner != row).any():
            row[:] = inner
            soft.append(joint.attrib["name"])
    if not soft:
        return limits, []
    note = f"position limits are the soft ones of the safety_controller: {', '.join(soft)}"
    return replace(limits, position=position), [note]


def _limits(model: pin.Model) -> Limits:
    """Limits of the URDF; zero speed or effort means that none was given."""
    position = np.column_stack([model.lowerPositionLimit, model.upperPositionLimit])
    position = np.where(
        np.abs(position) >= UNLIMITED, np.copysign(np.inf, position), position
    )
    unset = position[:, 0] >= position[:, 1]
    position[unset] = (-np.inf, np.inf)
    velocity, effort = (
        np.where((limit <= 0) | (limit >= UNLIMITED), np.inf, limit)
        for limit in (model.velocityLimit, model.effortLimit)
    )
    return Limits(position, velocity, np.full(model.nv, np.inf), effort)
