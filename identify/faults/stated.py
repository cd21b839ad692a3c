"""Repairs as column maps: what a user may state once and for all instead of --repair."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from excitant.identify.faults.fault import ON_COLUMNS, Remedy
from excitant.identify.reading.units import ISO, factor, named, rounded
from excitant.identify.recording import CHANNELS
from excitant.robots.motion import Array
from excitant.robots.robot import Robot
from excitant.robots.schema import in_one_line

if TYPE_CHECKING:
    from excitant.identify.reading.columns import Channel, Columns


def map_of(robot: Robot, read: Columns, remedies: Sequence[Remedy]) -> str | None:
    """The column map that reads a log as a repair leaves it, on one line; None where none can.

    Its entries take the place of those of the map with which the columns were read.
    """
    content = dict[str, Any]()
    for name in dict.fromkeys(remedy.channel for remedy in remedies):
        acting = [remedy for remedy in remedies if remedy.channel == name]
        said: dict[str, Any] | None = None
        if name == "t" and acting[0].action == "scale":
            said = _time(read, acting[0].factor)
        elif name in CHANNELS and {r.action for r in acting} <= ON_COLUMNS:
            channel = getattr(read, name)
            said = {} if channel is None else _channel(robot, channel, name, acting)
        if said is None:
            return None
        for key, entry in said.items():
            known = content.get(key)
            content[key] = {**known, **entry} if known else entry
    for key in ("sign", "coupling"):
        first, *others = (content.get(key, {}).get(name) for name in CHANNELS)
        if first is not None and others == [first, first]:
            content[key] = first
    return in_one_line(content) if content else None


def _time(read: Columns, scale: float) -> dict[str, Any] | None:
    """The entry for a clock whose time is multiplied; None for dates."""
    if read.rate is not None:
        return {"rate": rounded(read.rate / scale)}
    unit = 1.0 if read.t_unit is None else read.t_unit
    if len(read.t) > 1 or unit == ISO:
        return None
    size = factor("t", unit) if isinstance(unit, str) else unit
    return {"units": {"t": named("t", (size or 1.0) * scale)}}


def _channel(
    robot: Robot, channel: Channel, name: str, remedies: Sequence[Remedy]
) -> dict[str, Any] | None:
    """Entries by which a channel is read as remedies leave it.

    They make M x + c of x = C F (r + o), of readings r. That is G D P (r + o'): columns in the
    order P, units and signs D, and the coupling G, whose diagonal is 1; None where it cannot be,
    and where the columns of joints that stand are left out.
    """
    if len(channel.columns) != robot.nv:
        return None
    one = np.eye(robot.nv)
    order = np.arange(robot.nv)
    moved, constant = one, 0 * one
    for remedy in remedies:
        moved = remedy.on_columns(moved)
        constant = remedy.on_columns(constant)
        if remedy.action == "order":
            order = order[[*remedy.joints]]
    before = one if channel.coupling is None else channel.coupling
    whole = (moved - constant).T @ before * channel.factors * channel.gains
    whole = whole[:, order]
    sizes = np.diag(whole)
    if not sizes.all():
        return None
    said = dict[str, Any]()
    if (order != np.arange(robot.nv)).any():
        said[channel.role] = [channel.columns[k] for k in order]
    units = np.abs(sizes / channel.gains)
    usual = np.abs(channel.factors)
    # they may be those of joints, or of columns, which moved
    changed = ~(np.isclose(units, usual) & np.isclose(units, usual[order]))
    if changed.any():
        pairs = zip(units, robot.revolute, strict=True)
        names = [named(channel.role, size, bool(turns)) for size, turns in pairs]
        by_joint = _by_joint(robot, names, changed | (units != 1))
        said["units"] = {channel.role: names[0] if len({*names}) == 1 else by_joint}
    signs = np.sign(sizes)
    changed = signs != np.sign(channel.factors)
    if changed.any():
        said["sign"] = {name: _by_joint(robot, signs, changed | (signs < 0))}
    offsets = channel.offsets[order] + np.linalg.solve(whole, constant[0])
    changed = ~np.isclose(offsets, channel.offsets, rtol=1e-9, atol=0)
    if changed.any():
        by_joint = _by_joint(robot, offsets, changed | (offsets != 0))
        said["offset"] = {channel.role: by_joint}
    logged, as_given = (_logged(C, name) for C in (whole / sizes, before))
    if not np.allclose(logged, as_given):
        other = (logged != one) | (as_given != one)
        parts = zip(robot.joints, logged, other, strict=True)
        said["coupling"] = {
            name: {j: _by_joint(robot, x, k) for j, x, k in parts if k.any()}
        }
    return said


def _by_joint(robot: Robot, values: Iterable[Any], stated: Array) -> dict[str, Any]:
    """Values of the joints for which they are to be stated."""
    entries = zip(robot.joints, values, stated, strict=True)
    return {joint: rounded(value) for joint, value, known in entries if known}


def _logged(coupling: Array, name: str) -> Array:
    """L of `ColumnMap.coupling`, of the coordinates of the model by those of the log."""
    return np.asarray(coupling.T if name == "tau" else np.linalg.inv(coupling))
