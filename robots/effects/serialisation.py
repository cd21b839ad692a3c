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
    """Effects as entries ``{effect, joints, values, …}`` of a ``robot.yaml``."""
    return [
        {"effect": effect.name}
        | {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in vars(effect).items()
            if value is not None
        }
        for effect in effects
    ]


def effects_from_entries(
    entries: Sequence[Mapping[str, Any]], robot: Robot, source: str
) -> tuple[Effect, ...]:
    """Effects of a robot from entries of a file; all joints where an entry names none.

    Raises:
        BadInput: Unknown effect, joint or field, or values that do not fit.
    """
    return tuple(_effect(dict(entry), robot, source) for entry in entries)


def _effect(entry: dict[str, Any], robot: Robot, source: str) -> Effect:
    name = str(entry.pop("effect", ""))
    if name not in EFFECTS:
        raise BadInput(f"{source}: {UnknownName('effect', name, EFFECTS)}")
    defaults = {field.name: field.default for field in fields(EFFECTS[name])}
    joints = entry.pop("joints", robot.joints)
    if not isinstance(joints, list | tuple):
        raise BadInput(
            f"{source}: effect {name} needs 'joints: [names]', not '{joints}'"
        )
    joints = tuple(str(joint) for joint in joints)
    try:
        UnknownName.refuse("joint", joints, robot.joints)
        values = np.array(entry.pop("values"), float).ravel()
        shape = {key: _shape(defaults[key], value) for key, value in entry.items()}
        effect = EFFECTS[name](joints=joints, **shape).with_values(values)
    except (BadInput, UnknownName) as error:
        raise BadInput(f"{source}: {error}") from None
    except (KeyError, TypeError, ValueError, OverflowError):
        raise BadInput(
            f"{source}: effect {name} needs 'values: [numbers]' and takes {', '.join(defaults)}"
        ) from None
    expected = len(effect.parameters(robot))
    if len(values) != expected or not np.isfinite(values).all():
        raise BadInput(
            f"{source}: effect {name} has {len(values)} values, expected {expected}, all finite"
        )
    return effect


def _shape(default: Any, value: Any) -> Any:
    """A field of an effect's shape as its default is: yes or no, a finite number, or other."""
    if isinstance(default, bool) != isinstance(value, bool):
        raise TypeError
    if isinstance(default, float):
        value = float(value)
        if not np.isfinite(value):
            raise ValueError
    return value
