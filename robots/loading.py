"""Finding a robot by built-in name or file."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from excitant.exceptions import BadRobot, UnknownName
from excitant.robots.dh import chain_from_record, urdf_of_chain
from excitant.robots.effects import (
    CoulombFriction,
    Effect,
    RotorInertia,
    Spring,
    ViscousFriction,
    effects_from_entries,
)
from excitant.robots.limits import merge_limits
from excitant.robots.mjcf import Description, description_from_mjcf
from excitant.robots.robot import Robot
from excitant.robots.schema import PlaceRecord, RobotRecord, read_yaml
from excitant.robots.urdf import limits_in_urdf, number, robot_from_urdf
from excitant.robots.xacro_files import is_xacro, urdf_from_xacro


@dataclass(frozen=True)
class RobotSpec:
    """Everything that says which robot is meant; `load_robot` takes it as one thing.

    Attributes:
        path: Built-in name, URDF, xacro, MJCF or ``robot.yaml``; all else as of `load_robot`.
    """

    path: str | Path
    joints: tuple[str, ...] | None = None
    base: str | None = None
    tip: str | None = None
    lock: Mapping[str, float] = field(default_factory=dict)
    xacro_args: Mapping[str, str] = field(default_factory=dict)
    packages: tuple[str | Path, ...] = ()

    def __fspath__(self) -> str:
        """The path, so that a spec stands where a path does."""
        return str(self.path)

    def __str__(self) -> str:
        return str(self.path)

    @property
    def chain(self) -> dict[str, Any]:
        """Which joints are kept, as `robot_from_urdf` takes it."""
        return {"joints": self.joints, "base": self.base, "tip": self.tip, "lock": self.lock}

    @property
    def is_part(self) -> bool:
        """Whether a part of the robot is chosen, other than by holding single joints."""
        return any(value is not None for value in (self.joints, self.base, self.tip))


def builtin_robots() -> tuple[str, ...]:
    """Names of the arms that come with excitant."""
    files = (Path(f.name) for f in resources.files("excitant.robots.library").iterdir())
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
            in Denavit-Hartenberg form (`excitant.robots.dh`).
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
    name, path = str(spec), Path(spec)
    if name in builtin_robots():
        whole = _builtin(name)
        return _narrowed(whole, spec) if spec.is_part or spec.lock else whole
    if path.is_file():
        return _from_yaml(path, spec) if path.suffix in (".yaml", ".yml") else _from_model(spec)
    if path.suffix or "/" in name:
        kinds = "a URDF, xacro, MJCF, a robot.yaml or a built-in name"
        raise BadRobot(path, f"no such file; give {kinds}")
    raise UnknownName("robot", name, builtin_robots())


def _builtin(name: str) -> Robot:
    folder = resources.files("excitant.robots.library")
    model, record = folder / f"{name}.urdf", builtin_record(name)
    if not model.is_file():
        return _from_dh(record, name, RobotSpec(name))
    text = model.read_text(encoding="utf-8")
    return _supplemented(robot_from_urdf(text, source=name, name=name), record, name)


def builtin_record(name: str) -> RobotRecord:
    """What the YAML file of a built-in arm says."""
    file = resources.files("excitant.robots.library") / f"{name}.yaml"
    with resources.as_file(file) as path:
        return read_yaml(path, RobotRecord, "a robot")


def _from_yaml(path: Path, spec: RobotSpec) -> Robot:
    record = read_yaml(path, RobotRecord, "a robot")
    own = _spec_of(record, path, spec)
    if record.dh is not None and record.model is not None:
        raise BadRobot(path, "both 'model' and 'dh' are given; keep one")
    if record.dh is not None:
        robot = _from_dh(record, str(path), own)
    elif record.model is not None:
        own = replace(own, path=path.parent / record.model)
        if not Path(own).is_file():
            raise BadRobot(path, f"model {own} does not exist")
        per_joint = record.limits or record.effects or record.drive
        if spec.is_part and not own.is_part and not per_joint:
            # nothing in the file is said joint by joint, so the model itself can be narrowed
            own = replace(own, joints=spec.joints, base=spec.base, tip=spec.tip)
            spec = RobotSpec(path)
        robot = _supplemented(_from_model(own, record.gravity), record, str(path))
    else:
        raise BadRobot(
            path,
            "no 'model' entry; add 'model: path/to/robot.urdf', or 'convention:' and 'dh:' with "
            "Denavit-Hartenberg numbers",
        )
    return _narrowed(robot, replace(spec, lock={})) if spec.is_part else robot


def _spec_of(record: RobotRecord, path: Path, spec: RobotSpec) -> RobotSpec:
    """What a robot.yaml says about the part of the model that is meant, and what was added."""
    base, tip = record.base, record.tip
    if isinstance(base, PlaceRecord):  # of a chain in Denavit-Hartenberg form
        base = tip = None
    arguments = {
        name: str(value).lower() if isinstance(value, bool) else str(value)
        for name, value in (record.xacro_args or {}).items()
    }
    return RobotSpec(
        path,
        None if record.joints is None else tuple(map(str, record.joints)),
        None if base is None else str(base),
        None if tip is None else str(tip),
        {**(record.lock or {}), **spec.lock},
        {**arguments, **spec.xacro_args},
        (*(path.parent / folder for folder in record.packages or ()), *spec.packages),
    )


def _from_dh(record: RobotRecord, source: str, spec: RobotSpec) -> Robot:
    """The robot of Denavit-Hartenberg entries; its URDF states its limits too."""
    chain = chain_from_record(record, source)
    text = urdf_of_chain(chain, source)
    robot = robot_from_urdf(text, source=source, **spec.chain, gravity=chain.gravity)
    return limits_in_urdf(_supplemented(robot, record, source))


def _supplemented(robot: Robot, record: RobotRecord, source: str) -> Robot:
    """The robot with the limits and effects that a YAML file gives beside its model."""
    if record.limits is not None:
        robot = robot.with_limits(merge_limits(robot, record.limits, source))
    if record.effects is not None:
        robot = robot.with_effects(effects_from_entries(record.effects, robot, source))
    return robot


def _from_model(spec: RobotSpec, gravity: npt.ArrayLike | None = None) -> Robot:
    """Robot of a URDF, xacro or MJCF file, with the effects that the file states."""
    found = _described(Path(spec), spec)
    robot = robot_from_urdf(
        found.urdf,
        source=str(spec),
        **spec.chain | {"lock": {**found.lock, **spec.lock}},
        loops=found.loops,
        gravity=found.gravity if gravity is None else gravity,
    )
    robot = replace(robot, notes=(*found.notes, *robot.notes))
    return robot.with_effects([*_urdf_friction(robot), *_other_effects(robot, found)])


def _described(path: Path, spec: RobotSpec) -> Description:
    """The description in a file, whatever it is written in."""
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise BadRobot(path, "not a text file; give a URDF, xacro, MJCF or a robot.yaml") from None
    if is_xacro(text):
        return Description(urdf_from_xacro(path, spec.xacro_args, spec.packages))
    if spec.xacro_args:
        raise BadRobot(path, "not a xacro file, so it takes no xacro arguments; leave them out")
    if "<mujoco" in text:
        return description_from_mjcf(path)
    return Description(text)


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
        **spec.chain | {"lock": lock},
        gravity=whole.gravity,
    )
    return _kept(whole, replace(held, notes=(*whole.notes, *held.notes)))


def _kept(whole: Robot, held: Robot) -> Robot:
    """The arm with joints held, and of the whole arm's limits and effects what remains."""
    effects = []
    for effect in whole.effects:
        values = np.reshape(effect.values or (), (len(effect.joints), -1))
        kept = [k for k, joint in enumerate(effect.joints) if joint in held.joints]
        joints = tuple(effect.joints[k] for k in kept)
        effects.append(replace(effect, joints=joints).with_values(values[kept]))
    limits = whole.limits.of([whole.joint_index(joint) for joint in held.joints])
    return held.with_limits(limits).with_effects(effects)
