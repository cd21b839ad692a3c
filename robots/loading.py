"""Finding a robot by built-in name or file, and limits from a file."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Mapping
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
    EFFECTS,
    CoulombFriction,
    Effect,
    ViscousFriction,
    effects_from_entries,
)
from excitant.robots.motion import Array
from excitant.robots.robot import Limits, Robot
from excitant.robots.urdf import number, robot_from_urdf

_LIMIT_NAMES = ("position", "velocity", "acceleration", "torque", "jerk")


def builtin_robots() -> tuple[str, ...]:
    """Names of the arms that come with excitant."""
    folder = resources.files("excitant.robots.library")
    files = (Path(f.name) for f in folder.iterdir())
    return tuple(sorted({f.stem for f in files if f.suffix in (".urdf", ".yaml")}))


def load_robot(spec: str | Path, *, lock: Mapping[str, float] | None = None) -> Robot:
    """Robot by built-in name, URDF file or ``robot.yaml``.

    Args:
        spec: Name or path. A ``robot.yaml`` names a ``model`` file, or describes the arm itself
            in Denavit-Hartenberg form (`excitant.robots.dh_entries`).
        lock: Joints to hold and their positions [rad or m], beside those of a ``robot.yaml``.

    Raises:
        UnknownName: Neither a built-in arm nor a file; suggests the nearest name.
        BadRobot: A file that is not a usable robot.
    """
    spec = str(spec)
    if spec in builtin_robots():
        return _builtin(spec, lock)
    path = Path(spec)
    if not path.is_file():
        if path.suffix or "/" in spec:
            raise BadRobot(spec, "no such file; give a URDF, a robot.yaml or a built-in name")
        raise UnknownName("robot", spec, builtin_robots())
    if path.suffix in (".yaml", ".yml"):
        return _from_yaml(path, lock)
    return _with_urdf_friction(robot_from_urdf(_read(path), source=spec, lock=lock))


def _with_urdf_friction(robot: Robot) -> Robot:
    """The robot with the ``<dynamics damping friction>`` of its URDF as effects."""
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
    return robot.with_effects([kind(tuple(v), tuple(v.values())) for kind, v in found.items() if v])


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise BadRobot(path, "not a text file; give a URDF or a robot.yaml") from None


def _builtin(name: str, lock: Mapping[str, float] | None) -> Robot:
    folder = resources.files("excitant.robots.library")
    model, supplement = folder / f"{name}.urdf", folder / f"{name}.yaml"
    content = yaml.safe_load(supplement.read_text("utf-8")) if supplement.is_file() else {}
    if model.is_file():
        text = model.read_text(encoding="utf-8")
        robot = _supplemented(robot_from_urdf(text, source=name, name=name), content, name)
    else:
        robot = _from_dh({"name": name, **content}, name, {})
    if not lock:
        return robot
    held = robot_from_urdf(robot.urdf, source=name, name=name, lock=lock, gravity=robot.gravity)
    return _kept(robot, held)


def _kept(whole: Robot, held: Robot) -> Robot:
    """The arm with joints held, and of the whole arm's limits and effects what remains."""
    rows = [whole.joint_index(joint) for joint in held.joints]
    effects = []
    for effect in whole.effects:
        values = np.reshape(effect.values or (), (len(effect.joints), -1))
        kept = [k for k, joint in enumerate(effect.joints) if joint in held.joints]
        joints = tuple(effect.joints[k] for k in kept)
        effects.append(replace(effect, joints=joints).with_values(values[kept]))
    limits: dict[str, Any] = {name: getattr(whole.limits, name)[rows] for name in _LIMIT_NAMES}
    return held.with_limits(replace(whole.limits, **limits)).with_effects(effects)


def _supplemented(robot: Robot, content: Mapping[str, Any], source: str) -> Robot:
    """The robot with the limits and effects that a YAML file gives beside its model."""
    robot = robot.with_limits(merge_limits(robot, content.get("limits") or {}, source))
    entries = content.get("effects")
    if entries is None:
        return robot
    if not isinstance(entries, list) or not all(isinstance(e, dict) for e in entries):
        raise BadInput(f"{source}: 'effects' must be a list of entries 'effect: name, values: []'")
    return robot.with_effects(effects_from_entries(entries, robot, EFFECTS, source))


def _from_yaml(path: Path, lock: Mapping[str, float] | None) -> Robot:
    content = _mapping(path)
    given = content.get("lock") or {}
    if not isinstance(given, dict) or _numbers(list(given.values())).shape != (len(given),):
        raise BadRobot(path, "'lock' must hold entries 'joint: position'")
    held = {**given, **dict(lock or {})}
    if "dh" in content:
        if "model" in content:
            raise BadRobot(path, "both 'model' and 'dh' are given; keep one")
        return _from_dh(content, str(path), held)
    if "model" not in content:
        raise BadRobot(
            path,
            "no 'model' entry; add 'model: path/to/robot.urdf', or 'convention:' and 'dh:' with "
            "Denavit-Hartenberg numbers",
        )
    model = path.parent / str(content["model"])
    gravity = _gravity(content, path)
    if not model.is_file():
        raise BadRobot(path, f"model {model} does not exist")
    joints = content.get("joints")
    robot = robot_from_urdf(
        _read(model), source=str(model), joints=joints, lock=held or None, gravity=gravity
    )
    return _supplemented(_with_urdf_friction(robot), content, str(path))


def _from_dh(content: Mapping[str, Any], source: str, held: Mapping[str, float]) -> Robot:
    """The robot of Denavit-Hartenberg entries; its URDF states its limits too."""
    chain = chain_from_entries(content, source, _gravity(content, source))
    whole = robot_from_dh(chain, source=source)
    robot = robot_from_urdf(
        whole.urdf,
        source=source,
        joints=content.get("joints"),
        lock=held or None,
        gravity=chain.gravity,
    )
    return with_limits_in_urdf(_supplemented(robot, content, source), chain)


def _gravity(content: Mapping[str, Any], source: str | Path) -> Array:
    gravity = _numbers(content.get("gravity", (0.0, 0.0, -9.81)))
    if gravity.shape != (3,):
        raise BadRobot(source, f"gravity {content['gravity']} is not three numbers")
    return gravity


def _numbers(value: Any) -> Array:
    """Finite numbers of an entry; without shape when it is anything else."""
    try:
        numbers = np.asarray(value, float)
    except (TypeError, ValueError):
        return np.array(np.nan)
    return numbers if np.isfinite(numbers).all() else np.array(np.nan)


def _mapping(path: Path) -> dict[str, Any]:
    try:
        text = path.read_text(encoding="utf-8")
        content = json.loads(text) if path.suffix == ".json" else yaml.safe_load(text)
    except OSError:
        raise BadInput(f"{path}: no such file") from None
    except (ValueError, yaml.YAMLError) as error:
        raise BadInput(f"{path}: cannot be read ({str(error).splitlines()[0]})") from None
    if not isinstance(content, dict):
        raise BadInput(f"{path}: expected entries 'name: value', found something else")
    return content


def load_limits(path: str | Path, robot: Robot) -> Limits:
    """Limits of a robot with some replaced by those of a YAML or JSON file.

    The file holds ``position: [[lo, hi], ...]``, ``velocity``, ``acceleration``, ``torque``
    and ``jerk`` (one number, or one per joint), at the top or under ``limits``. What it leaves
    out stays as the robot has it.

    Raises:
        BadInput: Unreadable, unknown names, wrong counts, or limits that exclude everything.
    """
    content = _mapping(Path(path))
    return merge_limits(robot, content.get("limits", content), str(path))


def merge_limits(robot: Robot, values: Mapping[str, Any], source: str) -> Limits:
    """Limits of the robot with some replaced; see `load_limits`."""
    known = dict.fromkeys(_LIMIT_NAMES)
    for name in values:
        if name not in known:
            raise BadInput(f"{source}: {UnknownName('limit', str(name), _LIMIT_NAMES)}")
    merged: dict[str, Any] = {
        name: _limit(robot, name, values[name], source)
        if values.get(name) is not None
        else getattr(robot.limits, name)
        for name in _LIMIT_NAMES
    }
    return replace(robot.limits, **merged)


def _limit(robot: Robot, name: str, value: Any, source: str) -> Array:
    shape = (robot.nv, 2) if name == "position" else (robot.nv,)
    try:
        limit = np.broadcast_to(np.asarray(value, float), shape)
    except (ValueError, TypeError):
        raise BadInput(
            f"{source}: {name} limits have shape {np.shape(value) if value else ()}, "
            f"expected {shape} for the {robot.nv} joints of {robot.name}"
        ) from None
    bad = limit[:, 0] >= limit[:, 1] if name == "position" else ~(limit > 0)
    bad |= np.isnan(limit).reshape(robot.nv, -1).any(axis=1)
    if bad.any():
        joint = robot.joints[int(np.argmax(bad))]
        rule = "lower must be below upper" if name == "position" else "must be positive"
        raise BadInput(f"{source}: {name} limit of joint {joint}: {rule}")
    return limit
