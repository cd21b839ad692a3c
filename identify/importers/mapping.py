"""ColumnMap: what a user says about the columns of a log, from a ``columns.yaml``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from excitant.exceptions import BadInput, UnknownName
from excitant.identify.importers.units import Unit, spelled, units_of
from excitant.robots.motion import Array
from excitant.robots.yaml_entries import finite_numbers, yaml_content

ROLES = ("t", "q", "dq", "tau", "i")
_KEYS = (*ROLES, "units", "sign", "drive", "topic")
_DRIVE = ("gain_Nm_per_A", "gear_ratio")


@dataclass(frozen=True)
class Drive:
    """What one ampere makes at the joint.

    Attributes:
        gain: Torque constant per joint [N·m/A]; at the motor where there is a ratio.
        gear_ratio: Turns of the motor per turn of the joint, ones where the gain is the joint's.
    """

    gain: tuple[float, ...]
    gear_ratio: tuple[float, ...]

    def gains(self) -> Array:
        """Torque at the joint per ampere, shape (nv,) [N·m/A]."""
        gains: Array = np.array(self.gain) * np.array(self.gear_ratio)
        return gains


@dataclass(frozen=True)
class ColumnMap:
    """Where the quantities of a recording are; what it leaves out is guessed from names.

    Attributes:
        columns: Per quantity (``t, q, dq, tau, i``) the column of each joint in the robot's
            order, or one text: a column, a pattern with ``{0}`` (joints counted from 0), ``{1}``
            (from 1) or ``{joint}`` (its name), or what the columns' names have in common.
        units: Per quantity one unit or one per joint; a number is how many SI units one is.
        sign: +1 or −1 per quantity (``q, dq, tau``) and joint whose axis is logged reversed.
        drive: Torque per ampere, where currents are to become torques.
        topic: Topic of a bag.
        source: File it was read from.
    """

    columns: Mapping[str, str | tuple[str, ...]] = field(default_factory=dict)
    units: Mapping[str, Unit | tuple[Unit, ...]] = field(default_factory=dict)
    sign: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    drive: Drive | None = None
    topic: str | None = None
    source: str = "columns.yaml"


def load_column_map(path: str | Path) -> ColumnMap:
    """Column map from YAML, such as ``{t: stamp, q: 'pos_{1}', tau: [a, b], units: {q: deg}}``.

    ``sign: {joint: -1}`` turns position, speed and torque of a joint round, ``sign: {tau:
    {joint: -1}}`` one of them. ``drive: {gain_Nm_per_A: [..], gear_ratio: [..]}`` makes torque
    of current.

    Raises:
        BadInput: Unreadable, unknown entries or units, with the nearest that exists.
    """
    return column_map(yaml_content(path, "what columns mean"), str(path))


def column_map(content: object, source: str) -> ColumnMap:
    """Column map from the content of a YAML file; see `load_column_map`."""
    entries = _entries(content, source, "t: stamp, q: [...], tau: [...]", _KEYS)
    topic = entries.get("topic")
    if not isinstance(topic, str | None):
        raise BadInput(f"{source}: 'topic' must be a name such as /joint_states")
    return ColumnMap(
        columns={
            role: _columns(role, entries[role], source)
            for role in ROLES
            if entries.get(role) is not None
        },
        units=_units(entries.get("units") or {}, source),
        sign=_signs(entries.get("sign") or {}, source),
        drive=drive_from_entry(entries.get("drive"), source),
        topic=topic,
        source=source,
    )


def drive_from_entry(content: object, source: str) -> Drive | None:
    """Drive constants from ``{gain_Nm_per_A: [..], gear_ratio: [..]}``; None without gains.

    Raises:
        BadInput: Unknown entries, or anything but finite numbers other than zero.
    """
    if content is None:
        return None
    example = "drive: {gain_Nm_per_A: [0.1], gear_ratio: [100]}"
    entries = _entries(content, f"{source}: drive", example, _DRIVE)
    values = {key: np.atleast_1d(finite_numbers(value)) for key, value in entries.items() if value}
    for key, numbers in values.items():
        if numbers.ndim != 1 or not np.isfinite(numbers).all() or (numbers == 0).any():
            raise BadInput(f"{source}: drive: '{key}' must be one number per joint, none of them 0")
    if "gain_Nm_per_A" not in values:
        return None
    gains = values["gain_Nm_per_A"]
    ratios = values.get("gear_ratio", np.ones(len(gains)))
    if len(ratios) != len(gains):
        raise BadInput(f"{source}: drive: {len(gains)} gains and {len(ratios)} gear ratios")
    return Drive(tuple(gains.tolist()), tuple(ratios.tolist()))


def _entries(
    content: object, source: str, example: str, known: tuple[str, ...] = ()
) -> dict[Any, Any]:
    if not isinstance(content, dict):
        raise BadInput(f"{source}: expected entries such as {{{example}}}")
    for key in content:
        if known and key not in known:
            what = "quantity" if known == ROLES else "entry"
            raise BadInput(f"{source}: {UnknownName(what, str(key), known)}")
    return content


def _columns(role: str, value: object, source: str) -> str | tuple[str, ...]:
    if isinstance(value, str | int) and not isinstance(value, bool):
        return str(value)
    if isinstance(value, list) and value and all(isinstance(v, str | int) for v in value):
        return tuple(str(v) for v in value)
    raise BadInput(f"{source}: '{role}' must be a column, a pattern, or a list of columns")


def _units(content: object, source: str) -> dict[str, Unit | tuple[Unit, ...]]:
    found: dict[str, Unit | tuple[Unit, ...]] = {}
    for role, value in _entries(content, f"{source}: units", "q: deg", ROLES).items():
        if isinstance(value, list) and role != "t":
            found[role] = tuple(_unit(role, each, source) for each in value)
        else:
            found[role] = _unit(role, value, source)
    return found


def _unit(role: str, value: object, source: str) -> Unit:
    if isinstance(value, int | float) and not isinstance(value, bool):
        if np.isfinite(value) and value != 0:
            return float(value)
    elif isinstance(value, str) and (unit := spelled(value)) in units_of(role):
        return str(unit)
    known = ", ".join(units_of(role))
    raise BadInput(f"{source}: {role} has no unit '{value}'; known: {known}, or a number")


def _signs(content: object, source: str) -> dict[str, dict[str, float]]:
    found: dict[str, dict[str, float]] = {"q": {}, "dq": {}, "tau": {}}
    for name, value in _entries(content, f"{source}: sign", "joint: -1").items():
        some = value if isinstance(value, dict) else {name: value}
        roles = [str(name)] if isinstance(value, dict) else list(found)
        for joint, sign in some.items():
            if sign not in (1, -1) or isinstance(sign, bool) or roles[0] not in found:
                raise BadInput(f"{source}: sign of '{joint}' must be 1 or -1, for q, dq or tau")
            for role in roles:
                found[role][str(joint)] = float(sign)
    return found
