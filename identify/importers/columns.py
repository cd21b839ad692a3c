"""Columns: which columns of a log hold time, positions, speeds and torques, in which units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from excitant.exceptions import BadInput, BadRecording
from excitant.identify.importers.groups import Group, Joints
from excitant.identify.importers.guesses import Guesses, ambiguous, guesses, missing
from excitant.identify.importers.mapping import ColumnMap, Unit
from excitant.identify.importers.patterns import explicit, shortened
from excitant.identify.importers.sources import Source
from excitant.identify.importers.units import factor
from excitant.robots.motion import Array


@dataclass(frozen=True)
class Channel:
    """The columns of one quantity, in the order of the robot's joints.

    Attributes:
        columns: Names as logged.
        factors: SI units, with sign and drive gain, per logged unit.
        shown: How the columns were understood, one line; empty where there was no choice.
    """

    columns: tuple[str, ...]
    factors: tuple[float, ...]
    shown: str = ""

    @property
    def scale(self) -> Array:
        """The factors as a row, shape (nv,)."""
        return np.array(self.factors)


@dataclass(frozen=True)
class Columns:
    """Where each quantity of a recording is.

    Attributes:
        t: One column, or whole seconds and the nanoseconds to add.
        t_unit: Unit of time, or seconds per logged unit; None where the values say.
        q: Positions.
        dq: Speeds, where all joints' are there.
        tau: Torques or currents.
        unit: What ``tau`` becomes: ``"N·m"`` or ``"A"``.
        notes: How the columns were understood, one line each.
    """

    t: tuple[str, ...]
    t_unit: Unit | None
    q: Channel
    dq: Channel | None
    tau: Channel
    unit: str
    notes: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """All columns that are read."""
        speeds = self.dq.columns if self.dq else ()
        return (*self.t, *self.q.columns, *speeds, *self.tau.columns)


def resolve(
    source: Source,
    joints: Joints,
    *,
    mapping: ColumnMap | None = None,
    torque_column: str | None = None,
) -> Columns:
    """Which columns hold what: as a map says, else as their names say beyond doubt.

    Args:
        source: The log.
        joints: The arm's joints.
        mapping: What the user says.
        torque_column: Prefix of the torque columns, ``tau`` for ``tau1, tau2, ...``.

    Raises:
        BadRecording: A column is missing, or could be several; says what to write.
        BadInput: The map does not fit the robot.
    """
    mapping = mapping or ColumnMap()
    names, file = source.names, source.file
    found = guesses(source.meanings(joints), joints, source.labels, file)
    t, t_shown = _time(found, mapping, names, file)
    t_unit = found.t_unit if mapping.t_unit is None else mapping.t_unit
    q = _channel("q", found, mapping, names, joints, file)
    role, tau = _torque(found, mapping, names, joints, file, torque_column)
    dq = _channel("dq", found, mapping, names, joints, file, optional=True)
    if q is None or tau is None:
        raise missing(found, "q" if q is None else "tau", file)
    unit = "A" if role == "i" else "N·m"
    if role == "i" and mapping.drive is not None:
        unit, gains = "N·m", _fitting(mapping.drive.gains(), joints, mapping)
        factors = tuple((tau.scale * gains).tolist())
        tau = Channel(tau.columns, factors, f"{tau.shown or 'i'}, × drive gain = N·m")
    read = Columns(t, t_unit, q, dq, tau, unit)
    _once(read, names, file)
    shown = [t_shown, q.shown, dq.shown if dq else "", tau.shown]
    notes = [f"columns: {'; '.join(s for s in shown if s)}"] if any(shown) else []
    notes += found.notes
    return Columns(t, t_unit, q, dq, tau, unit, tuple(notes))


def _time(
    found: Guesses, mapping: ColumnMap, names: Sequence[str], file: str
) -> tuple[tuple[str, ...], str]:
    given = mapping.columns.get("t")
    if given is not None:
        columns = (given,) if isinstance(given, str) else given
        for column in columns:
            if column not in names:
                raise _not_there(file, column, names, mapping)
        if len(columns) > 2:
            raise BadInput(f"{mapping.source}: 't' is one column, or seconds and nanoseconds")
    elif len(found.times) == 1:
        columns = found.times[0]
    elif found.times:
        raise ambiguous(found, "t", [", ".join(times) for times in found.times], file)
    else:
        raise missing(found, "t", file)
    unit = found.t_unit if mapping.t_unit is None else mapping.t_unit
    if columns == ("t",) and unit is None:
        return columns, ""
    return columns, f"t = {' + '.join(columns)}{_in_unit(unit, columns[0])}"


def _channel(
    role: str,
    found: Guesses,
    mapping: ColumnMap,
    names: Sequence[str],
    joints: Joints,
    file: str,
    *,
    optional: bool = False,
) -> Channel | None:
    given = mapping.columns.get(role)
    if given is not None:
        columns = explicit(role, given, names, joints, file, mapping.source)
        hints: tuple[str | None, ...] = (None,) * joints.count
        plain = False
    else:
        group = found.chosen(role, file, optional=optional)
        if group is None:
            return None
        columns, hints = group.columns(joints), group.units(joints)
        plain = group.canonical
    factors = _factors(role, hints, mapping, joints)
    units = mapping.units.get(role, hints[0])
    if plain and units is None:
        return Channel(columns, factors)
    shown = f"{role} = {shortened(columns, joints)}{_in_unit(units, columns[0])}"
    return Channel(columns, factors, shown)


def _in_unit(units: Unit | tuple[Unit, ...] | None, column: str) -> str:
    """A unit in brackets, unless the column's name ends with it."""
    if units is None or (isinstance(units, str) and column.endswith((f"[{units}]", f"({units})"))):
        return ""
    return f" [{', '.join(map(str, units)) if isinstance(units, tuple) else units}]"


def _torque(
    found: Guesses,
    mapping: ColumnMap,
    names: Sequence[str],
    joints: Joints,
    file: str,
    torque_column: str | None,
) -> tuple[str, Channel | None]:
    """Torques, or currents where there are none or the user says so."""
    said = [role for role in ("tau", "i") if role in mapping.columns]
    if len(said) == 2:
        raise BadInput(f"{mapping.source}: both 'tau' and 'i' are given; keep the measured one")
    if said:
        return said[0], _channel(said[0], found, mapping, names, joints, file)
    if torque_column is not None:
        role = "i" if torque_column == "i" else "tau"
        group = Group.numbered(torque_column, names, role)
        group.check(joints, file, torque_column)
        columns = group.columns(joints)
        return role, Channel(columns, _factors(role, (None,) * joints.count, mapping, joints))
    for role in found.torque_roles():
        channel = _channel(role, found, mapping, names, joints, file)
        return role, channel
    raise missing(found, "tau", file)


def _factors(
    role: str, hints: Sequence[str | None], mapping: ColumnMap, joints: Joints
) -> tuple[float, ...]:
    """SI units per logged unit and joint, signs included."""
    given = mapping.units.get(role)
    units: Sequence[Unit | None]
    if given is None:
        units = hints
    else:
        units = given if isinstance(given, tuple) else [given] * joints.count
    if len(units) != joints.count:
        raise BadInput(
            f"{mapping.source}: units of {role}: {len(units)} given, the robot has "
            f"{joints.count} joints"
        )
    signs = mapping.sign.get("tau" if role == "i" else role, {})
    for joint in signs:
        if joint not in joints.labels:
            known = ", ".join(joints.labels)
            raise BadInput(f"{mapping.source}: sign of unknown joint '{joint}'; known: {known}")
    values = []
    for k, unit in enumerate(units):
        value = 1.0 if unit is None else unit
        if isinstance(value, str):
            known_factor = factor(role, value, joints.turns(k))
            if known_factor is None:
                raise BadInput(
                    f"{mapping.source}: joint {joints.labels[k]} "
                    f"{'turns' if joints.turns(k) else 'slides'}: its {role} is not in {value}"
                )
            value = known_factor
        values.append(value * signs.get(joints.labels[k], 1.0))
    return tuple(values)


def _fitting(gains: Array, joints: Joints, mapping: ColumnMap) -> Array:
    if len(gains) != joints.count:
        raise BadInput(
            f"{mapping.source}: drive has {len(gains)} gains, the robot has {joints.count} joints"
        )
    return gains


def _not_there(file: str, column: str, names: Sequence[str], mapping: ColumnMap) -> BadRecording:
    some = ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
    return BadRecording(
        file, f"is not there, mend {mapping.source}; columns are {some}", column=column
    )


def _once(read: Columns, names: Sequence[str], file: str) -> None:
    """No column twice in the file, none for two quantities."""
    for column in read.names:
        if list(names).count(column) > 1:
            raise BadRecording(file, "is there twice; rename or remove one", column=column)
        if read.names.count(column) > 1:
            raise BadRecording(
                file, "is taken for two things; say which in a file for --map", column=column
            )
