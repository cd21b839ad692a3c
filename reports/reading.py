"""Reading saved results: a run may lack any key, and any value may be null."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from excitant.robots.motion import Array

Result = Mapping[str, Any]
Series = Mapping[str, Array]


def at(value: Any, *keys: str) -> Any:
    """The value under nested keys, or None as soon as one is missing."""
    for key in keys:
        if not isinstance(value, Mapping):
            return None
        value = value.get(key)
    return value


def items(value: Any, *keys: str) -> list[Any]:
    """The list under nested keys, without its nulls; empty when there is none."""
    found = at(value, *keys)
    return [item for item in found if item is not None] if isinstance(found, list | tuple) else []


def records(value: Any, *keys: str) -> list[Mapping[str, Any]]:
    """The objects of the list under nested keys."""
    return [item for item in items(value, *keys) if isinstance(item, Mapping)]


def words(value: Any, *keys: str) -> list[str]:
    """The list under nested keys as texts; one text alone counts as a list of one."""
    found = at(value, *keys)
    return [found] if isinstance(found, str) else [str(item) for item in items(value, *keys)]


def text(value: Any, *keys: str) -> str:
    """The value under nested keys as text, empty when there is none."""
    found = at(value, *keys)
    return "" if found is None else str(found)


def real(value: Any, *keys: str) -> float | None:
    """The finite number under nested keys, or None."""
    found = at(value, *keys)
    if isinstance(found, bool) or not isinstance(found, int | float | np.number):
        return None
    return float(found) if math.isfinite(found) else None


def reals(value: Any, *keys: str) -> Array:
    """The list of numbers under nested keys; nulls become NaN."""
    found = at(value, *keys)
    if not isinstance(found, list | tuple):
        return np.empty(0)
    return np.array([math.nan if (x := real(item)) is None else x for item in found], dtype=float)


def curve(series: Series, key: str, joint: int | None = None) -> Array | None:
    """One series, or its column of a joint; None when absent, misshapen or nowhere finite."""
    values = series.get(key)
    if values is None or not np.issubdtype(np.asarray(values).dtype, np.number):
        return None
    array = np.asarray(values, dtype=float)
    if joint is not None:
        if array.ndim != 2 or joint >= array.shape[1]:
            return None
        array = array[:, joint]
    return array if array.ndim == 1 and np.isfinite(array).any() else None


def times(series: Series) -> Array | None:
    """Time ``t``, shape (n,) [s]; None unless there are two finite instants or more."""
    t = curve(series, "t")
    return t if t is not None and len(t) > 1 and np.isfinite(t).all() else None


def part(series: Series, name: str) -> dict[str, Array]:
    """The series of one verb of a demo, saved under ``name/``."""
    prefix = f"{name}/"
    return {key[len(prefix) :]: value for key, value in series.items() if key.startswith(prefix)}


def joint_names(result: Result, *sources: str) -> list[str]:
    """Joint names of a result: its ``joints``, else those of the first source that has any."""
    for keys in (("joints",), *(source.split(".") for source in sources)):
        found = items(result, *keys)
        if found:
            return [
                text(item, "name") if isinstance(item, Mapping) else str(item) for item in found
            ]
    return []


@dataclass(frozen=True)
class WorstPoint:
    """Where a motion comes closest to a limit, or crosses it.

    Attributes:
        quantity: Position, velocity, acceleration or torque.
        ratio: Value over limit, at most 1 where the limit holds; None without a limit.
        joint: Name of the joint, empty when unknown.
        t: Time [s].
    """

    quantity: str
    ratio: float | None
    joint: str
    t: float | None

    @property
    def holds(self) -> bool:
        """Whether the limit holds, up to rounding."""
        return self.ratio is None or self.ratio <= 1 + 1e-9


def worst_points(result: Result) -> list[WorstPoint]:
    """The worst point of each limited quantity of a motion."""
    limits, names = at(result, "limits"), items(result, "joints")
    points = []
    for quantity in limits if isinstance(limits, Mapping) else ():
        where = at(result, "worst", quantity)
        joint = at(where, "joint")
        if isinstance(joint, int) and 0 <= joint < len(names):
            joint = names[joint]
        name = "" if joint is None else str(joint)
        ratio = real(limits, quantity)
        if ratio == 0 and where is None:  # an unlimited quantity uses nothing of its limit
            ratio = None
        points.append(WorstPoint(quantity, ratio, name, real(where, "t")))
    return points


def middle(rows: Sequence[Result], *keys: str) -> float | None:
    """Median of a number over records, e.g. of an error over joints; None when none has it."""
    found = [x for row in rows if (x := real(row, *keys)) is not None]
    return float(np.median(found)) if found else None
