"""What was identified: friction over velocity, and parameters beside the given ones."""

from collections.abc import Sequence

import numpy as np

from excitant.reports import values as v
from excitant.reports.figure import (
    BAND,
    CLOUD,
    FITTED,
    GIVEN,
    Axes,
    Axis,
    Band,
    Figure,
    Key,
    Line,
    Mark,
    Panel,
    Points,
    Rule,
    bars,
    figure,
)
from excitant.reports.figures.residual import MEDIANS, cloud
from excitant.reports.values import Series
from excitant.results import IdentifiedJoint, Parameter
from excitant.robots.effects import EFFECTS
from excitant.robots.parameters import STANDARD

_GROUPS = ("mass", *("first moment",) * 3, *("inertia",) * 6)
_DEVIATIONS = 1.96  # standard deviations that hold 95 %
_ROW = 17  # px of a parameter in the forest
_LONG = 20  # letters of a name there


def friction_figure(
    joints: Sequence[IdentifiedJoint], series: Series
) -> Figure | None:
    """Friction of every joint over its velocity, with the readings of the hold-out."""
    panels = [_friction(k, row, series) for k, row in enumerate(joints)]
    caption = (
        "Friction as identified, and what the rest of the model leaves of the measured torque on "
        "the hold-out: where medians bend away from the curve, friction has another law."
    )
    legend = (
        Key("dot", CLOUD, "hold-out"),
        MEDIANS,
        Key("line", FITTED, "identified friction"),
        Key("box", BAND, "95\u00a0% interval of the curve"),
    )
    return figure(panels, caption, legend)


def _friction(k: int, row: IdentifiedJoint, series: Series) -> Panel | None:
    """Points are what the rest of the model leaves of the torque; None where none was estimated."""
    law = row.friction
    keys = ("velocity", "torque", "half_width")
    speed, torque, half = v.curves(series, k, *(f"friction_{key}" for key in keys))
    if law is None or speed is None or torque is None or half is None:
        return None
    marks: list[Mark] = []
    at, measured, model = v.curves(series, k, "velocity", "measured", "identified")
    if at is not None and measured is not None and model is not None:
        scale = law.per_reading or 1.0
        seen = np.isfinite(speed)
        friction = np.interp(at, speed[seen], torque[seen])
        marks += cloud(at, scale * (measured - model) + friction, "hold-out")
    for side in (speed < 0, speed > 0):  # it jumps in between
        x = speed[side]
        y = torque[side]
        width = half[side]
        marks.insert(0, Band(x, y - width, y + width))
        marks.append(Line(x, y, FITTED, "identified friction", 1.8))
    abscissa = Axis(f"velocity [{law.velocity_unit}]")
    ordinate = Axis(f"friction [{law.unit}]")
    joint = row.name
    label = f"{joint}: friction over velocity, hold-out readings and the identified curve"
    return Panel((Axes(marks, abscissa, ordinate, 210),), label, joint)


def forest_groups(parameters: Sequence[Parameter]) -> dict[str, list[Parameter]]:
    """Identified parameters of one kind and unit each, under its name."""
    groups: dict[str, list[Parameter]] = {}
    for row in parameters:
        if row.value is not None:
            name = f"{_kind(symbol_of(row))} [{row.unit}]"
            groups.setdefault(name, []).append(row)
    return groups


def owner_of(row: Parameter) -> str:
    """Link or joint in the name of a parameter."""
    return row.name.rpartition(".")[0]


def symbol_of(row: Parameter) -> str:
    """Symbol in the name of a parameter."""
    return row.name.rpartition(".")[2]


def _kind(symbol: str) -> str:
    if symbol in STANDARD:
        return _GROUPS[STANDARD.index(symbol)]
    kinds = (
        v.plain(e.name)
        for e in EFFECTS.values()
        if symbol in [p.name for p in e.terms]
    )
    return next(kinds, symbol)


def forest_figure(parameters: Sequence[Parameter]) -> Figure | None:
    """Every identified parameter with its interval beside the given value, by kind."""
    panels = [
        _forest(name, rows) for name, rows in forest_groups(parameters).items()
    ]
    caption = (
        "Identified parameters with their 95\u00a0% intervals beside the given values; a "
        "value that the prior decides says nothing that was not given."
    )
    legend = (
        Key("ring", GIVEN, "given"),
        Key("dot", FITTED, "identified, 95\u00a0% interval"),
        Key("ring", FITTED, "decided by the prior"),
    )
    return figure(panels, caption, legend)


def _forest(name: str, rows: Sequence[Parameter]) -> Panel:
    """Given and identified values of parameters in one unit, a row each from above."""
    symbols = [symbol_of(row) for row in rows]
    several = len(set(symbols)) > 1
    names = []
    for row, symbol in zip(rows, symbols, strict=True):
        owner = v.shorten(owner_of(row), _LONG - 4 * several)
        names.append(f"{owner} {symbol}" if several else owner)
    y = -np.arange(len(rows), dtype=float)
    value = v.reals([row.value for row in rows])
    std = v.reals([row.std for row in rows])
    given = v.reals([row.given for row in rows])
    half = _DEVIATIONS * np.nan_to_num(std)
    interval = bars(value - half, value + half)
    prior = np.array([row.decided_by == "prior" for row in rows])
    marks = (
        Rule(0.0, along="x"),
        Line(interval, bars(y, y), FITTED, "", 1.4),
        Points(given, y, GIVEN, "given", 6.0, "ring"),
        Points(value[~prior], y[~prior], FITTED, "identified", 3.6),
        Points(value[prior], y[prior], FITTED, "by the prior", 3.6, "hole"),
    )
    ticks = list(zip(y.tolist(), names, strict=True))
    ordinate = Axis("", 0.4 - len(rows), 0.6, ticks=ticks)
    abscissa = Axis(f"[{rows[0].unit}]")
    axes = Axes(marks, abscissa, ordinate, _ROW * len(rows) + 60)
    label = f"{name}: {len(rows)} parameters, given and identified"
    return Panel((axes,), label, name)
