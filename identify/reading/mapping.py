"""Column maps: what a user says of the columns of a log, in YAML."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, TypeAlias, TypeVar

import msgspec
import numpy as np

from excitant.exceptions import BadInput
from excitant.identify.reading.units import Unit, spelled, units_of
from excitant.identify.recording import CHANNELS
from excitant.robots.schema import Finite, Name, Positive, convert, read_yaml

QUANTITIES = ("t", "q", "dq", "tau", "i")
_T = TypeVar("_T")
OfJoints: TypeAlias = _T | tuple[_T, ...] | Mapping[str, _T]
"""One value for all joints, one for each, or values by the joints' names."""
_Names = Name | Annotated[list[Name], msgspec.Meta(min_length=1)] | None
_Units = str | Finite | list[str | Finite] | dict[Name, str | Finite] | None
_Numbers = Finite | list[Finite] | dict[Name, Finite] | None
_Constants = Finite | list[Finite] | None
_Parts = dict[Name, Finite]  # of the axes that one is read with


class _UnitsRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    t: str | Finite | None = None
    q: _Units = None
    dq: _Units = None
    tau: _Units = None
    i: _Units = None


class _OffsetRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    q: _Numbers = None
    dq: _Numbers = None
    tau: _Numbers = None
    i: _Numbers = None


class _DriveRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    gains: _Constants = msgspec.field(name="gain_Nm_per_A", default=None)
    ratios: _Constants = msgspec.field(name="gear_ratio", default=None)


class _ColumnsRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    t: _Names = None
    q: _Names = None
    dq: _Names = None
    tau: _Names = None
    i: _Names = None
    units: _UnitsRecord | None = None
    offset: _OffsetRecord | None = None
    drive: _DriveRecord | None = None
    sign: dict[Name, float | dict[Name, float]] | None = None
    coupling: dict[Name, dict[Name, Finite | _Parts]] | None = None
    rate: Positive | None = None
    topic: str | None = None


@dataclass(frozen=True)
class ColumnMap:
    """Columns of a recording by quantity; those not given are inferred from names.

    Attributes:
        columns: Per quantity (``t, q, dq, tau, i``) the column of each joint in the robot's
            order, or one text: a column, a pattern with ``{0}`` (joints counted from 0), ``{1}``
            (from 1) or ``{joint}`` (its name), or what the columns' names have in common. A
            number that is no name counts columns from 0.
        units: Per quantity one unit or one per joint; a number is how many SI units one is.
        offset: What is added per quantity (``q, dq, tau, i``), in the unit of the column.
        sign: +1 or −1 per quantity (``q, dq, tau``) and joint whose axis is logged reversed.
        coupling: Per quantity (``q, dq, tau``) and joint, how much of other axes its reading
            holds: q_read = L q, so that q = L⁻¹ q_read and, by power, tau = Lᵀ tau_read.
        rate: Samples per second, where no column holds the time [Hz].
        drive: Torque at each joint per ampere [N·m/A], where currents are to become torques.
        topic: Topic of a bag.
        torque: Prefix of the torque columns where ``columns`` names none: ``i`` for ``i1, i2, ..``.
        source: File it was read from.
    """

    columns: Mapping[str, str | tuple[str, ...]] = field(default_factory=dict)
    units: Mapping[str, OfJoints[Unit]] = field(default_factory=dict)
    offset: Mapping[str, OfJoints[float]] = field(default_factory=dict)
    sign: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    coupling: Mapping[str, Mapping[str, Mapping[str, float]]] = field(
        default_factory=dict
    )
    rate: float | None = None
    drive: tuple[float, ...] | None = None
    topic: str | None = None
    torque: str | None = None
    source: str = "columns.yaml"


def load_column_map(path: str | Path) -> ColumnMap:
    """Column map from YAML, such as ``{t: stamp, q: 'pos_{1}', tau: [a, b], units: {q: deg}}``.

    ``sign: {joint: -1}`` turns a joint round, ``sign: {tau: {joint: -1}}`` its torque alone.
    ``coupling: {joint: {other: 1}}`` says likewise that the reading of a joint holds another's.
    ``drive: {gain_Nm_per_A: [..], gear_ratio: [..]}`` makes torque of current.

    Raises:
        BadInput: Unreadable, unknown entries or units, with the nearest that exists.
    """
    return column_map(read_yaml(path, Any, "what columns mean"), str(path))


def column_map(content: object, source: str) -> ColumnMap:
    """Column map from the content of a YAML file; see `load_column_map`."""
    record = convert(content, _ColumnsRecord, source)
    names = {quantity: getattr(record, quantity) for quantity in QUANTITIES}
    if record.rate is not None and record.t is not None:
        why = "both 't' and 'rate' are given; keep one"
        raise BadInput(f"{source}: {why}")
    return ColumnMap(
        columns=_of_joints(names, lambda _, name: str(name)),
        units=_of_joints(
            msgspec.structs.asdict(record.units or _UnitsRecord()),
            lambda quantity, value: _unit(quantity, value, source),
        ),
        offset=_of_joints(
            msgspec.structs.asdict(record.offset or _OffsetRecord()),
            lambda _, value: value,
        ),
        sign=_by_quantity(
            record.sign or {},
            (1, -1).__contains__,
            source,
            "sign of '{}' must be 1 or -1",
        ),
        coupling=_by_quantity(
            record.coupling or {},
            _are_parts,
            source,
            "coupling of '{}' must be {{joint: number}}",
        ),
        drive=drive_of(record.drive, source),
        rate=record.rate,
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


def _of_joints(
    content: Mapping[str, Any], one: Callable[[str, Any], Any]
) -> dict[str, Any]:
    """What is given of quantities, made of values by ``one(quantity, value)``."""
    made = dict[str, Any]()
    for quantity, value in content.items():
        if isinstance(value, list):
            made[quantity] = tuple(one(quantity, x) for x in value)
        elif isinstance(value, dict):
            made[quantity] = {str(j): one(quantity, x) for j, x in value.items()}
        elif value is not None:
            made[quantity] = one(quantity, value)
    return made


def _by_quantity(
    content: Mapping[Any, Any],
    fits: Callable[[Any], bool],
    source: str,
    must: str,
) -> dict[str, dict[str, Any]]:
    """Entries by quantity and joint; those of a joint alone are for all quantities."""
    made: dict[str, dict[str, Any]] = {quantity: {} for quantity in CHANNELS}
    for name, value in content.items():
        of_one = str(name) in CHANNELS and isinstance(value, dict)
        for joint, entry in value.items() if of_one else [(name, value)]:
            if not fits(entry):
                raise BadInput(f"{source}: {must.format(joint)}, for q, dq or tau")
            for quantity in [str(name)] if of_one else CHANNELS:
                made[quantity][str(joint)] = entry
    return made


def _are_parts(entry: object) -> bool:
    return isinstance(entry, dict) and not any(
        isinstance(part, dict) for part in entry.values()
    )
