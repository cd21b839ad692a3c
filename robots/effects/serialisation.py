"""Effects as entries of a ``robot.yaml``, and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from excitant.exceptions import BadInput, UnknownName
from excitant.robots.effects.base import Effect
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
    known: Mapping[str, type[Effect]],
    source: str,
) -> tuple[Effect, ...]:
    """Effects of a robot from plain entries; all joints where an entry names none.

    Args:
        entries: What `effect_entries` gives.
        robot: The arm that has the effects.
        known: Effect classes by name.
        source: File of the entries, for messages.

    Raises:
        BadInput: Unknown effect, joint or field, or values that do not fit.
    """
    return tuple(_effect(dict(entry), robot, known, source) for entry in entries)


def _effect(
    entry: dict[str, Any], robot: Robot, known: Mapping[str, type[Effect]], source: str
) -> Effect:
    name = str(entry.pop("effect", ""))
    if name not in known:
        raise BadInput(f"{source}: {UnknownName('effect', name, known)}")
    joints = tuple(str(joint) for joint in entry.pop("joints", robot.joints))
    for joint in joints:
        if joint not in robot.joints:
            raise BadInput(f"{source}: {UnknownName('joint', joint, robot.joints)}")
    try:
        values = np.array(entry.pop("values"), float).ravel()
        effect = known[name](joints=joints, **entry).with_values(values)
    except (KeyError, TypeError, ValueError):
        raise BadInput(
            f"{source}: effect {name} needs 'values: [numbers]' and takes "
            f"{', '.join(f.name for f in fields(known[name]))}"
        ) from None
    expected = len(effect.parameters(robot))
    if len(values) != expected or not np.isfinite(values).all():
        raise BadInput(f"{source}: effect {name} has {len(values)} values, expected {expected}")
    return effect
