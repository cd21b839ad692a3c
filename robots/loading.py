"""Finding a robot by built-in name or file."""

from __future__ import annotations

import io
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from excitant.exceptions import BadInput, BadRobot, UnknownName
from excitant.robots.dh_entries import chain_from_entries
from excitant.robots.dh_urdf import robot_from_dh, with_limits_in_urdf
from excitant.robots.effects import (
    CoulombFriction,
    Effect,
    RotorInertia,
    Spring,
    ViscousFriction,
    effects_from_entries,
)
from excitant.robots.limits_file import LIMIT_NAMES, merge_limits
from excitant.robots.mjcf import Description, description_from_mjcf
from excitant.robots.motion import Array
from excitant.robots.robot import Robot
from excitant.robots.robot_spec import RobotSpec, spec_of_entries
from excitant.robots.urdf import number, robot_from_urdf
from excitant.robots.xacro_files import is_xacro, urdf_from_xacro
from excitant.robots.yaml_entries import entries_of, finite_numbers


def builtin_robots() -> tuple[str, ...]:
    """Names of the arms that come with excitant."""
    folder = resources.files("excitant.robots.library")
    files = (Path(f.name) for f in folder.iterdir())
    return tuple(sorted({f.stem for f in files if f.suffix in (".urdf", ".yaml")}))


def load_robot(
    spec: str | Path | RobotSpec,
    *,
    joints: Sequence[str] | None = None,
    base: str | None = None,
    tip: str | None = None,
    lock: Mapping[str, float] | None = None,
    xacro_args: Mapping[str, str] | None = None,
    packages: Sequence[str | Path] = (),
) -> Robot:
    """Robot by built-in name, URDF, xacro, MJCF or ``robot.yaml``.

    Args:
        spec: Name or path. A ``robot.yaml`` names a ``model`` file, or describes the arm itself
            in Denavit-Hartenberg form (`excitant.robots.dh_entries`).
        joints: Joints to keep; all others are held.
        base: Keep only the joints that this link carries.
        tip: Keep only the joints on the way to this link; what it carries goes along.
        lock: Joints to hold and their positions [rad or m], beside those of a ``robot.yaml``;
            what is not kept is held at zero, or where the joint puts it that it follows.
        xacro_args: Values of the arguments of a xacro file.
        packages: Folders in which ``$(find name)`` of a xacro file looks.

    Raises:
        UnknownName: Neither a built-in arm nor a file, or a joint or link that the robot does
            not have; suggests the nearest name.
        BadRobot: A file that is not a usable robot, or a choice of joints that cannot move on
            their own.
    """
    if not isinstance(spec, RobotSpec):
        spec = RobotSpec(spec)
    spec = RobotSpec(
        spec.path,
        spec.joints if joints is None else tuple(joints),
        spec.base if base is None else base,
        spec.tip if tip is None else tip,
        {**spec.lock, **(lock or {})},
        {**spec.xacro_args, **(xacro_args or {})},
        (*spec.packages, *packages),
    )
    if str(spec) in builtin_robots():
        return _builtin(spec)
    path = Path(spec)
    if not path.is_file():
        if path.suffix or "/" in str(spec):
            kinds = "a URDF, xacro, MJCF, a robot.yaml or a built-in name"
            raise BadRobot(path, f"no such file; give {kinds}")
        raise UnknownName("robot", str(spec), builtin_robots())
    if path.suffix in (".yaml", ".yml"):
        return _from_yaml(path, spec)
    return _from_model(path, spec)


def _from_model(path: Path, spec: RobotSpec, gravity: Array | None = None) -> Robot:
    """Robot of a URDF, xacro or MJCF file, with the effects that the file states."""
    found = _described(path, spec)
    robot = robot_from_urdf(
        found.urdf,
        source=str(path),
        **spec.chain | {"lock": {**found.lock, **spec.lock} or None},
        loops=found.loops,
        gravity=found.gravity if gravity is None else gravity,
    )
    robot = replace(robot, notes=(*found.notes, *robot.notes))
    return robot.with_effects([*_urdf_friction(robot), *_other_effects(robot, found)])


def _described(path: Path, spec: RobotSpec) -> Description:
    """The description in a file, whatever it is written in."""
    text = _read(path)
    if is_xacro(text):
        return Description(urdf_from_xacro(path, spec.xacro_args, spec.packages))
    if spec.xacro_args:
        raise BadRobot(path, "not a xacro file, so it takes no xacro arguments; leave them out")
    if _root_tag(text) in ("mujoco", "mujocoinclude"):
        return description_from_mjcf(path)
    return Description(text)


def _root_tag(text: str) -> str:
    try:
        return str(next(ET.iterparse(io.StringIO(text), events=("start",)))[1].tag)
    except (ET.ParseError, StopIteration):
        return ""


def _other_effects(robot: Robot, found: Description) -> list[Effect]:
    """Rotor inertia and springs of the joints that move."""
    effects: list[Effect] = []
    armature = {j: found.armature[j] for j in robot.joints if found.armature.get(j)}
    if armature:
        effects.append(RotorInertia(tuple(armature), tuple(armature.values())))
    springs = {j: found.springs[j] for j in robot.joints if j in found.springs}
    if springs:
        values = [(stiffness, -stiffness * rest) for stiffness, rest in springs.values()]
        effects.append(Spring(tuple(springs)).with_values(np.array(values)))
    return effects


def _urdf_friction(robot: Robot) -> list[Effect]:
    """Effects of the ``<dynamics damping friction>`` of a robot's URDF."""
    root = ET.fromstring(robot.urdf)
    found: dict[type[Effect], dict[str, float]] = {ViscousFriction: {}, CoulombFriction: {}}
    for joint in root.findall("joint"):
        dynamics = joint.find("dynamics")
        name = str(joint.get("name"))
        if dynamics is None or name not in robot.joints:
            continue
        for kind, key in ((ViscousFriction, "damping"), (CoulombFriction, "friction")):
            value = number(dynamics.get(key, "0"), key, joint, robot.source)
            if value != 0:
                found[kind][name] = value
    return [kind(tuple(v), tuple(v.values())) for kind, v in found.items() if v]


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise BadRobot(path, "not a text file; give a URDF, xacro, MJCF or a robot.yaml") from None


def _builtin(spec: RobotSpec) -> Robot:
    name = str(spec)
    folder = resources.files("excitant.robots.library")
    model, supplement = folder / f"{name}.urdf", folder / f"{name}.yaml"
    content = yaml.safe_load(supplement.read_text("utf-8")) if supplement.is_file() else {}
    if model.is_file():
        text = model.read_text(encoding="utf-8")
        robot = _supplemented(robot_from_urdf(text, source=name, name=name), content, name)
    else:
        robot = _from_dh({"name": name, **content}, name, RobotSpec(name))
    return _narrowed(robot, spec) if spec.is_chosen or spec.lock else robot


def _narrowed(whole: Robot, spec: RobotSpec) -> Robot:
    """A part of a robot that is loaded, with its limits and effects."""
    lock = {**dict(whole.locked), **spec.lock}
    if spec.joints is not None:  # as if the robot had no other joints
        for joint in spec.joints:
            if joint not in whole.joints:
                raise UnknownName("joint", joint, whole.joints)
    held = robot_from_urdf(
        whole.urdf,
        source=whole.source,
        name=whole.name,
        **spec.chain | {"lock": lock or None},
        gravity=whole.gravity,
    )
    return _kept(whole, replace(held, notes=(*whole.notes, *held.notes)))


def _kept(whole: Robot, held: Robot) -> Robot:
    """The arm with joints held, and of the whole arm's limits and effects what remains."""
    rows = [whole.joint_index(joint) for joint in held.joints]
    effects = []
    for effect in whole.effects:
        values = np.reshape(effect.values or (), (len(effect.joints), -1))
        kept = [k for k, joint in enumerate(effect.joints) if joint in held.joints]
        joints = tuple(effect.joints[k] for k in kept)
        effects.append(replace(effect, joints=joints).with_values(values[kept]))
    limits: dict[str, Any] = {name: getattr(whole.limits, name)[rows] for name in LIMIT_NAMES}
    return held.with_limits(replace(whole.limits, **limits)).with_effects(effects)


def _supplemented(robot: Robot, content: Mapping[str, Any], source: str) -> Robot:
    """The robot with the limits and effects that a YAML file gives beside its model."""
    robot = robot.with_limits(merge_limits(robot, content.get("limits") or {}, source))
    entries = content.get("effects")
    if entries is None:
        return robot
    if not isinstance(entries, list) or not all(isinstance(e, dict) for e in entries):
        raise BadInput(f"{source}: 'effects' must be a list of entries 'effect: name, values: []'")
    return robot.with_effects(effects_from_entries(entries, robot, source))


def _from_yaml(path: Path, spec: RobotSpec) -> Robot:
    content = entries_of(path, "a robot")
    own = replace(spec_of_entries(content, path), path=path)
    own = replace(own, lock={**own.lock, **spec.lock})
    if "dh" in content:
        if "model" in content:
            raise BadRobot(path, "both 'model' and 'dh' are given; keep one")
        robot = _from_dh(content, str(path), own)
    elif "model" in content:
        model = path.parent / str(content["model"])
        if not model.is_file():
            raise BadRobot(path, f"model {model} does not exist")
        own = replace(
            own,
            xacro_args={**own.xacro_args, **spec.xacro_args},
            packages=(*(path.parent / p for p in own.packages), *spec.packages),
        )
        gravity = _gravity(content, path) if "gravity" in content else None
        if spec.is_chosen and not own.is_chosen and not _per_joint(content):
            own, spec = replace(spec, lock=own.lock), own
        robot = _supplemented(_from_model(model, own, gravity), content, str(path))
    else:
        raise BadRobot(
            path,
            "no 'model' entry; add 'model: path/to/robot.urdf', or 'convention:' and 'dh:' with "
            "Denavit-Hartenberg numbers",
        )
    return _narrowed(robot, replace(spec, lock={})) if spec.is_chosen else robot


def _per_joint(content: Mapping[str, Any]) -> bool:
    """Whether a robot.yaml says things joint by joint, which the chosen joints must match."""
    return any(content.get(key) for key in ("limits", "effects", "drive"))


def _from_dh(content: Mapping[str, Any], source: str, spec: RobotSpec) -> Robot:
    """The robot of Denavit-Hartenberg entries; its URDF states its limits too."""
    chain = chain_from_entries(content, source, _gravity(content, source))
    whole = robot_from_dh(chain, source=source)
    robot = robot_from_urdf(whole.urdf, source=source, **spec.chain, gravity=chain.gravity)
    return with_limits_in_urdf(_supplemented(robot, content, source), chain)


def _gravity(content: Mapping[str, Any], source: str | Path) -> Array:
    gravity = finite_numbers(content.get("gravity", (0.0, 0.0, -9.81)))
    if gravity.shape != (3,):
        raise BadRobot(source, f"gravity {content['gravity']} is not three numbers")
    return gravity
