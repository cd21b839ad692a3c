"""ColumnMap: what a user says about the columns of a log, from a ``columns.yaml``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from excitant.exceptions import BadInput
from excitant.identify.importers.names import Unit, spelled, units_of
from excitant.robots.schema import Finite, Name, convert, read_yaml

_Names = Name | Annotated[list[Name], msgspec.Meta(min_length=1)] | None
_Units = str | Finite | list[str | Finite] | None
_Constants = Finite | list[Finite] | None


class _UnitsRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    t: str | Finite | None = None
    q: _Units = None
    dq: _Units = None
    tau: _Units = None
    i: _Units = None


class _DriveRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    gain: _Constants = msgspec.field(name="gain_Nm_per_A", default=None)
    gear_ratio: _Constants = None


class _ColumnsRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    t: _Names = None
    q: _Names = None
    dq: _Names = None
    tau: _Names = None
    i: _Names = None
    units: Any = None
    sign: dict[Name, float | dict[Name, float]] | None = None
    drive: Any = None
    topic: str | None = None


@dataclass(frozen=True)
class ColumnMap:
    """Where the quantities of a recording are; what it leaves out is guessed from names.

    Attributes:
        columns: Per quantity (``t, q, dq, tau, i``) the column of each joint in the robot's
            order, or one text: a column, a pattern with ``{0}`` (joints counted from 0), ``{1}``
            (from 1) or ``{joint}`` (its name), or what the columns' names have in common.
        units: Per quantity one unit or one per joint; a number is how many SI units one is.
        sign: +1 or −1 per quantity (``q, dq, tau``) and joint whose axis is logged reversed.
        drive: Torque at each joint per ampere [N·m/A], where currents are to become torques.
        topic: Topic of a bag.
        torque: Prefix of the torque columns where ``columns`` names none: ``i`` for ``i1, i2, ..``.
        source: File it was read from.
    """

    columns: Mapping[str, str | tuple[str, ...]] = field(default_factory=dict)
    units: Mapping[str, Unit | tuple[Unit, ...]] = field(default_factory=dict)
    sign: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    drive: tuple[float, ...] | None = None
    topic: str | None = None
    torque: str | None = None
    source: str = "columns.yaml"


def load_column_map(path: str | Path) -> ColumnMap:
    """Column map from YAML, such as ``{t: stamp, q: 'pos_{1}', tau: [a, b], units: {q: deg}}``.

    ``sign: {joint: -1}`` turns position, speed and torque of a joint round, ``sign: {tau:
    {joint: -1}}`` one of them. ``drive: {gain_Nm_per_A: [..], gear_ratio: [..]}`` makes torque
    of current.

    Raises:
        BadInput: Unreadable, unknown entries or units, with the nearest that exists.
    """
    return column_map(read_yaml(path, Any, "what columns mean"), str(path))


def column_map(content: object, source: str) -> ColumnMap:
    """Column map from the content of a YAML file; see `load_column_map`."""
    record = convert(content, _ColumnsRecord, source)
    units = convert(record.units or {}, _UnitsRecord, source, "units")
    columns: dict[str, str | tuple[str, ...]] = {}
    given: dict[str, Unit | tuple[Unit, ...]] = {}
    for role in _UnitsRecord.__struct_fields__:
        if (names := getattr(record, role)) is not None:
            listed = isinstance(names, list)
            columns[role] = tuple(map(str, names)) if listed else str(names)
        if (unit := getattr(units, role)) is not None:
            some = [_unit(role, u, source) for u in (unit if isinstance(unit, list) else [unit])]
            given[role] = tuple(some) if isinstance(unit, list) else some[0]
    return ColumnMap(
        columns=columns,
        units=given,
        sign=_signs(record.sign or {}, source),
        drive=drive_of(record.drive, source),
        topic=record.topic,
        source=source,
    )


def drive_of(content: object, source: str) -> tuple[float, ...] | None:
    """Torque at each joint per ampere [N·m/A] from ``{gain_Nm_per_A: [..], gear_ratio: [..]}``.

    The gains are those of the motors where there are ratios. None without gains.

    Raises:
        BadInput: Unknown entries, or anything but finite numbers other than zero.
    """
    record = convert(content or {}, _DriveRecord, source, "drive")
    if not record.gain:
        return None
    gains = np.atleast_1d(np.array(record.gain, float))
    ratios = np.atleast_1d(np.array(record.gear_ratio or np.ones(len(gains)), float))
    if len(ratios) != len(gains):
        raise BadInput(f"{source}: drive: {len(gains)} gains and {len(ratios)} gear ratios")
    if not (gains * ratios).all():
        raise BadInput(f"{source}: drive: no gain and no gear ratio may be 0")
    return tuple((gains * ratios).tolist())


def _unit(role: str, value: str | float, source: str) -> Unit:
    unit = spelled(value) if isinstance(value, str) else float(value)
    if unit and (isinstance(unit, float) or unit in units_of(role)):
        return unit
    known = ", ".join(units_of(role))
    raise BadInput(f"{source}: {role} has no unit '{value}'; known: {known}, or a number")


def _signs(content: Mapping[Any, Any], source: str) -> dict[str, dict[str, float]]:
    found: dict[str, dict[str, float]] = {"q": {}, "dq": {}, "tau": {}}
    for name, value in content.items():
        some = value if isinstance(value, dict) else {name: value}
        roles = [str(name)] if isinstance(value, dict) else list(found)
        for joint, sign in some.items():
            if sign not in (1, -1) or roles[0] not in found:
                raise BadInput(f"{source}: sign of '{joint}' must be 1 or -1, for q, dq or tau")
            for role in roles:
                found[role][str(joint)] = sign
    return found
