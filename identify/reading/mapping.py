"""Column maps: what a user says of the columns of a log, in YAML."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from excitant.exceptions import BadInput
from excitant.identify.reading.units import Unit, spelled, units_of
from excitant.robots.schema import Finite, Name, convert, read_yaml

QUANTITIES = ("t", "q", "dq", "tau", "i")
_SIGNED = ("q", "dq", "tau")
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
    gains: _Constants = msgspec.field(name="gain_Nm_per_A", default=None)
    ratios: _Constants = msgspec.field(name="gear_ratio", default=None)


class _ColumnsRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    t: _Names = None
    q: _Names = None
    dq: _Names = None
    tau: _Names = None
    i: _Names = None
    units: Any = None
    drive: Any = None
    sign: dict[Name, float | dict[Name, float]] | None = None
    topic: str | None = None


@dataclass(frozen=True)
class ColumnMap:
    """Columns of a recording by quantity; those not given are inferred from names.

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

    ``sign: {joint: -1}`` turns a joint round, ``sign: {tau: {joint: -1}}`` its torque alone.
    ``drive: {gain_Nm_per_A: [..], gear_ratio: [..]}`` makes torque of current.

    Raises:
        BadInput: Unreadable, unknown entries or units, with the nearest that exists.
    """
    return column_map(read_yaml(path, Any, "what columns mean"), str(path))


def column_map(content: object, source: str) -> ColumnMap:
    """Column map from the content of a YAML file; see `load_column_map`."""
    record = convert(content, _ColumnsRecord, source)
    units = convert(record.units or {}, _UnitsRecord, source, "units")
    columns: dict[str, str | tuple[str, ...]] = {}
    units_by_quantity: dict[str, Unit | tuple[Unit, ...]] = {}
    for quantity in QUANTITIES:
        names = getattr(record, quantity)
        unit = getattr(units, quantity)
        if isinstance(names, list):
            columns[quantity] = tuple(map(str, names))
        elif names is not None:
            columns[quantity] = str(names)
        if isinstance(unit, list):
            units_by_quantity[quantity] = tuple(
                _unit(quantity, value, source) for value in unit
            )
        elif unit is not None:
            units_by_quantity[quantity] = _unit(quantity, unit, source)
    return ColumnMap(
        columns=columns,
        units=units_by_quantity,
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
    if not record.gains:
        return None
    gains = np.atleast_1d(np.array(record.gains, float))
    ratios = np.atleast_1d(np.array(record.ratios or np.ones(len(gains)), float))
    if len(ratios) != len(gains):
        why = f"{len(gains)} gains and {len(ratios)} gear ratios"
        raise BadInput(f"{source}: drive: {why}")
    if not (gains * ratios).all():
        raise BadInput(f"{source}: drive: no gain and no gear ratio may be 0")
    return tuple((gains * ratios).tolist())


def _unit(quantity: str, value: str | float, source: str) -> Unit:
    unit = spelled(value) if isinstance(value, str) else float(value)
    if unit and (isinstance(unit, float) or unit in units_of(quantity)):
        return unit
    units = ", ".join(units_of(quantity))
    why = f"{quantity} has no unit '{value}'; known: {units}, or a number"
    raise BadInput(f"{source}: {why}")


def _signs(content: Mapping[Any, Any], source: str) -> dict[str, dict[str, float]]:
    signs: dict[str, dict[str, float]] = {quantity: {} for quantity in _SIGNED}
    for name, value in content.items():
        nested = isinstance(value, dict)
        quantities = [str(name)] if nested else _SIGNED
        for joint, sign in value.items() if nested else [(name, value)]:
            if sign not in (1, -1) or quantities[0] not in signs:
                why = f"sign of '{joint}' must be 1 or -1, for q, dq or tau"
                raise BadInput(f"{source}: {why}")
            for quantity in quantities:
                signs[quantity][str(joint)] = sign
    return signs
