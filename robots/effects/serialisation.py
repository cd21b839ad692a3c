"""Effects as entries of a ``robot.yaml``, and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from excitant.exceptions import BadInput, UnknownName
from excitant.robots.effects.base import EFFECTS, Effect
from excitant.robots.robot import Robot


def effect_entries(effects: Sequence[Effect]) -> list[dict[str, Any]]:
    """Effects as plain entries ``{effect, joints, values, …}`` with their shape fields."""
    entries = []
    for effect in effects:
        entry: dict[str, Any] = {"effect": effect.name, "joints": list(effect.joints)}
        for field in fields(effect):
            value = getattr(effect, field.name)
            if field.name != "joints" and value is not None:
                entry[field.name] = list(value) if isinstance(value, tuple) else value
        entries.append(entry)
    return entries


def effects_from_entries(
    entries: Sequence[Mapping[str, Any]],
    robot: Robot,
    source: str,
) -> tuple[Effect, ...]:
    """Effects of a robot from plain entries; all joints where an entry names none.

    Args:
        entries: What `effect_entries` gives.
        robot: The arm that has the effects.
        source: File of the entries, for messages.

    Raises:
        BadInput: Unknown effect, joint or field, or values that do not fit.
    """
    return tuple(_effect(dict(entry), robot, source) for entry in entries)


def _effect(entry: dict[str, Any], robot: Robot, source: str) -> Effect:
    name = str(entry.pop("effect", ""))
    if name not in EFFECTS:
        raise BadInput(f"{source}: {UnknownName('effect', name, EFFECTS)}")
    joints = entry.pop("joints", robot.joints)
    if not isinstance(joints, list | tuple):
        raise BadInput(f"{source}: effect {name} needs 'joints: [names]', not '{joints}'")
    joints = tuple(str(joint) for joint in joints)
    for joint in joints:
        if joint not in robot.joints:
            raise BadInput(f"{source}: {UnknownName('joint', joint, robot.joints)}")
    try:
        values = np.array(entry.pop("values"), float).ravel()
        shape = {key: _shape(EFFECTS[name], key, value) for key, value in entry.items()}
        effect = EFFECTS[name](joints=joints, **shape).with_values(values)
    except BadInput as error:
        raise BadInput(f"{source}: {error}") from None
    except (KeyError, TypeError, ValueError):
        raise BadInput(
            f"{source}: effect {name} needs 'values: [numbers]' and takes "
            f"{', '.join(f.name for f in fields(EFFECTS[name]))}"
        ) from None
    expected = len(effect.parameters(robot))
    if len(values) != expected or not np.isfinite(values).all():
        raise BadInput(
            f"{source}: effect {name} has {len(values)} values, expected {expected}, all finite"
        )
    return effect


def _shape(kind: type[Effect], name: str, value: Any) -> Any:
    """A field of an effect's shape as its default is: yes or no, a finite number, or other."""
    default = {field.name: field.default for field in fields(kind)}[name]
    if isinstance(default, bool) != isinstance(value, bool):
        raise TypeError(name)
    if isinstance(default, float):
        if not np.isfinite(float(value)):
            raise ValueError(name)
        return float(value)
    return value
