"""Finding a robot by built-in name or file."""

import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from importlib import resources
from os.path import exists, isfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from excitant.exceptions import BadRobot, UnknownName
from excitant.robots.angles import Angles
from excitant.robots.chains import RobotSpec, tree
from excitant.robots.dh import chain_from_record, urdf_of_chain
from excitant.robots.effects import (
    CoulombFriction,
    Effect,
    RotorInertia,
    Spring,
    ViscousFriction,
    effects_from_entries,
)
from excitant.robots.files import parse_xml, read_description, within
from excitant.robots.limits import LIMIT_NAMES
from excitant.robots.limits_file import merge_limits
from excitant.robots.mjcf import Description, description_from_mjcf
from excitant.robots.parameters import base_estimate_from_csv
from excitant.robots.robot import Robot
from excitant.robots.schema import PlaceRecord, RobotRecord, read_yaml
from excitant.robots.urdf import robot_from_urdf
from excitant.robots.urdf_model import with_held
from excitant.robots.urdf_writer import (
    child_attribute,
    limits_in_urdf,
    stated_joints,
)
from excitant.robots.xacro import is_xacro, urdf_from_xacro


def builtin_robots() -> tuple[str, ...]:
    """Names of the arms that come with excitant."""
    files = resources.files("excitant.robots.library").iterdir()
    paths = (Path(file.name) for file in files)
    return tuple(sorted({p.stem for p in paths if p.suffix in (".urdf", ".yaml")}))


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
        packages: Folders of packages, or folders that hold them, in which ``$(find name)`` of a
            xacro file looks, and in which files that the description names may lie beside its
            own folder.

    Raises:
        UnknownName: Neither a built-in arm nor a file, or a joint or link that the robot does
            not have; suggests the nearest name.
        BadRobot: A file that is not a usable robot, or a choice of joints that cannot move on
            their own.
    """
    spec = spec if isinstance(spec, RobotSpec) else RobotSpec(spec)
    spec = replace(
        spec,
        joints=spec.joints if joints is None else tuple(joints),
        base=spec.base if base is None else base,
        tip=spec.tip if tip is None else tip,
        lock={**spec.lock, **(lock or {})},
        xacro_args={**spec.xacro_args, **(xacro_args or {})},
        packages=(*spec.packages, *packages),
    )
    name = str(spec)
    path = Path(spec)
    if name in builtin_robots():
        whole = _builtin(name)
        return _narrowed(whole, spec) if spec.is_part or spec.lock else whole
    if exists(path):
        is_yaml = path.suffix in (".yaml", ".yml")
        return _from_yaml(path, spec) if is_yaml else _from_model(spec)
    if path.suffix or "/" in name:
        why = "no such file; give a URDF, xacro, MJCF, a robot.yaml or a built-in name"
        raise BadRobot(path, why)
    raise UnknownName("robot", name, builtin_robots())


def _builtin(name: str) -> Robot:
    model = resources.files("excitant.robots.library") / f"{name}.urdf"
    record = builtin_record(name)
    if not model.is_file():
        return _from_dh(record, RobotSpec(name))
    text = model.read_text(encoding="utf-8")
    return _supplemented(robot_from_urdf(text, name, name=name), record, name)


def builtin_record(name: str) -> RobotRecord:
    """Content of the YAML file of a built-in arm."""
    file = resources.files("excitant.robots.library") / f"{name}.yaml"
    with resources.as_file(file) as path:
        return read_yaml(path, RobotRecord, "a robot")


def _from_yaml(path: Path, spec: RobotSpec) -> Robot:
    record = read_yaml(path, RobotRecord, "a robot")
    own = _joined(record, path, spec)
    if record.dh is not None:
        if record.model is not None:
            raise BadRobot(path, "both 'model' and 'dh' are given; keep one")
        robot = _from_dh(record, own)
    elif record.model is not None:
        own = replace(own, path=path.parent / record.model)
        if not isfile(own):
            raise BadRobot(path, f"model {own} does not exist")
        within(str(own), path, own.packages)
        per_joint = record.limits or record.effects or record.drive
        if spec.is_part and not own.is_part and not per_joint:
            # nothing in the file is said joint by joint, so the model itself can be narrowed
            own = replace(own, joints=spec.joints, base=spec.base, tip=spec.tip)
            spec = RobotSpec(path)
        robot = _supplemented(_from_model(own, record.gravity), record, str(path))
        if record.estimate is not None and not spec.is_part and not spec.lock:
            file = within(path.parent / record.estimate, path, own.packages)
            estimate = base_estimate_from_csv(read_description(file), file)
            robot = replace(robot, estimate=estimate)
    else:
        raise BadRobot(
            path,
            "no 'model' entry; add 'model: path/to/robot.urdf', or 'convention:' and 'dh:' with "
            "Denavit-Hartenberg numbers",
        )
    return _narrowed(robot, replace(spec, lock={})) if spec.is_part else robot


def _joined(record: RobotRecord, path: Path, spec: RobotSpec) -> RobotSpec:
    """The part of the model that a robot.yaml selects, with its additions."""
    base = record.base
    tip = record.tip
    if isinstance(base, PlaceRecord):  # of a chain in Denavit-Hartenberg form
        base = tip = None
    arguments = {
        name: str(value).lower() if isinstance(value, bool) else str(value)
        for name, value in (record.xacro_args or {}).items()
    }
    folders = [path.parent / folder for folder in record.packages or ()]
    for folder in folders:
        within(folder, path, spec.packages)
    return RobotSpec(
        path,
        None if record.joints is None else tuple(map(str, record.joints)),
        None if base is None else str(base),
        None if tip is None else str(tip),
        {**(record.lock or {}), **spec.lock},
        {**arguments, **spec.xacro_args},
        (*folders, *spec.packages),
    )


def _from_dh(record: RobotRecord, spec: RobotSpec) -> Robot:
    """The robot of Denavit-Hartenberg entries; its URDF states its limits too."""
    source = str(spec)
    angles = Angles()
    chain = chain_from_record(record, source, angles)
    robot = robot_from_urdf(
        urdf_of_chain(chain, source), spec, gravity=chain.gravity
    )
    robot = replace(robot, notes=(*angles.notes, *robot.notes))
    return limits_in_urdf(_supplemented(robot, record, source))


def _supplemented(robot: Robot, record: RobotRecord, source: str) -> Robot:
    """The robot with limits and effects as a YAML file gives them."""
    if record.limits is not None:
        robot = robot.with_limits(merge_limits(robot, record.limits, source))
    if record.effects is not None:
        stated = effects_from_entries(record.effects, robot, source)
        robot = _with_stated_effects(robot, stated, source)
    return robot


def _with_stated_effects(
    robot: Robot, stated: Sequence[Effect], source: str
) -> Robot:
    """The robot with more effects; one that its model has too replaces that of the model."""
    names = {effect.name for effect in stated}
    others = [effect for effect in robot.effects if effect.name not in names]
    replaced = [
        effect.label
        for effect in robot.effects
        if effect.name in names
        and all(entry.among(effect.joints) != effect for entry in stated)
    ]
    note = f"{', '.join(replaced)}: as in {Path(source).name}, not as in its model"
    changed = robot.with_effects([*others, *stated])
    return replace(changed, notes=(*robot.notes, *[note] * bool(replaced)))


def _from_model(spec: RobotSpec, gravity: npt.ArrayLike | None = None) -> Robot:
    """Robot of a URDF, xacro or MJCF file, with the effects that the file states."""
    return robot_of(_described(spec), spec, gravity)


def robot_of(
    description: Description, spec: RobotSpec, gravity: npt.ArrayLike | None = None
) -> Robot:
    """Robot of a description that was read, wherever it was, with the effects that it states."""
    robot = robot_from_urdf(
        description.urdf,
        replace(spec, lock={**description.lock, **spec.lock}),
        loops=description.loops,
        gravity=description.gravity if gravity is None else gravity,
    )
    robot = replace(robot, notes=(*description.notes, *robot.notes))
    return robot.with_effects(_effects(robot, description))


def _described(spec: RobotSpec) -> Description:
    """The description in a file, whatever it is written in."""
    path = Path(spec)
    text = read_description(path)
    if is_xacro(text):
        urdf, notes = urdf_from_xacro(path, spec.xacro_args, spec.packages)
        return Description(urdf, notes=notes)
    if spec.xacro_args:
        raise BadRobot(
            path, "not a xacro file, so it takes no xacro arguments; leave them out"
        )
    if "<mujoco" in text and parse_xml(text, path, "MJCF").tag == "mujoco":
        return description_from_mjcf(path, spec.packages)
    return Description(text)


def _effects(robot: Robot, description: Description) -> Iterator[Effect]:
    """Friction, rotor inertia and springs that a description states of the joints that move."""
    stated = stated_joints(ET.fromstring(robot.description))
    for kind, key in ((ViscousFriction, "damping"), (CoulombFriction, "friction")):
        values = {}
        for name in robot.joints:
            text = child_attribute(stated[name], "dynamics", key, "0")
            if value := float(text):
                values[name] = value
        if values:
            yield kind(tuple(values), tuple(values.values()))
    turning = tuple(j for j in robot.joints if j in description.armature)
    if turning:
        yield RotorInertia(turning, tuple(description.armature[j] for j in turning))
    sprung = tuple(j for j in robot.joints if j in description.springs)
    if sprung:
        springs = (description.springs[j] for j in sprung)
        values_of = [(stiffness, -stiffness * rest) for stiffness, rest in springs]
        yield Spring(sprung).with_values(np.array(values_of))


def _narrowed(whole: Robot, spec: RobotSpec) -> Robot:
    """A part of a robot that is loaded, with its limits and effects."""
    # as if the robot had no other joints
    UnknownName.refuse("joint", spec.joints or (), whole.joints)
    lock = {**dict(whole.locked), **spec.lock}
    part = replace(spec, path=whole.source, lock=lock, packages=whole.packages)
    held = robot_from_urdf(
        whole.description, part, name=whole.name, gravity=whole.gravity
    )
    return _kept(whole, replace(held, notes=(*whole.notes, *held.notes)))


def _kept(whole: Robot, held: Robot) -> Robot:
    """The arm with joints held, and of the whole arm's limits and effects what remains."""
    effects = [effect.among(held.joints) for effect in whole.effects]
    limits = whole.limits.of([whole.joint_index(joint) for joint in held.joints])
    return held.with_limits(limits).with_effects(filter(None, effects))


def hold(robot: Robot, positions: Mapping[str, float]) -> Robot:
    """The arm as it is now, with some of its joints held at positions [rad or m]."""
    for effect in robot.effects:
        if effect.role != "torque" and {*effect.joints} & {*positions}:
            robot = effect.applied(robot)  # a body of a link that is held
    kept = [j for j, joint in enumerate(robot.joints) if joint not in positions]
    held = replace(
        robot,
        model=with_held(robot.model, positions),
        links=tuple(robot.links[j] for j in kept),
        revolute=robot.revolute[kept],
        locked=tuple(sorted({**dict(robot.locked), **positions}.items())),
    )
    return _kept(robot, held)


def held_alone(robot: Robot) -> tuple[str, ...]:
    """Joints that are held and could move on their own."""
    joints = tree(ET.fromstring(robot.description), robot.source).joints
    return tuple(name for name, _ in robot.locked if joints[name].is_single)


def freed(robot: Robot, names: Collection[str]) -> Robot:
    """The arm as described, with its limits and effects, where some of its held joints move."""
    lock = {joint: q for joint, q in robot.locked if joint not in names}
    chosen = (*robot.joints, *names)
    spec = RobotSpec(robot.source, chosen, lock=lock, packages=robot.packages)
    whole = robot_from_urdf(
        robot.description, spec, name=robot.name, gravity=robot.gravity
    )
    own = [whole.joint_index(joint) for joint in robot.joints]
    rows: dict[str, Any] = {}
    for name in LIMIT_NAMES:
        rows[name] = np.array(getattr(whole.limits, name))
        rows[name][own] = getattr(robot.limits, name)
    whole = replace(
        whole,
        limits=replace(robot.limits, **rows),
        tool=robot.tool,
        notes=robot.notes,
        unchosen=robot.unchosen,
    )
    return whole.with_effects(robot.effects)
