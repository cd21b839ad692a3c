"""What was identified: friction over velocity, and parameters beside the given ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from excitant.reports import figure as fig
from excitant.reports import values as v
from excitant.reports.figure import (
    Axes,
    Axis,
    Band,
    Figure,
    Key,
    Line,
    Mark,
    Panel,
    Points,
)
from excitant.reports.figures.residual import MEDIANS, cloud
from excitant.reports.values import Result, Series
from excitant.robots.effects import EFFECTS
from excitant.robots.parameters import STANDARD

_GROUPS = ("mass", *("first moment",) * 3, *("inertia",) * 6)
_DEVIATIONS = 1.96  # standard deviations that hold 95 %
_ROW = 17  # px of a parameter in the forest
_LONG = 20  # letters of a name there


def friction_figure(result: Result, series: Series) -> Figure | None:
    """Friction of every joint over its velocity, with the readings of the hold-out."""
    panels = [
        _friction(k, row, series) for k, row in enumerate(v.records(result, "joints"))
    ]
    caption = (
        "Friction as identified, and what the rest of the model leaves of the measured torque on "
        "the hold-out: where medians bend away from the curve, friction has another law."
    )
    legend = (
        Key("dot", fig.CLOUD, "hold-out"),
        MEDIANS,
        Key("line", fig.FITTED, "identified friction"),
        Key("box", fig.BAND, "95\u00a0% interval of the curve"),
    )
    return fig.figure(panels, caption, legend)


def _friction(k: int, row: Result, series: Series) -> Panel | None:
    """Points are what the rest of the model leaves of the torque; None where none was estimated."""
    law = v.at(row, "friction")
    keys = ("velocity", "torque", "half_width")
    speed, torque, half = v.curves(series, k, *(f"friction_{key}" for key in keys))
    if law is None or speed is None or torque is None or half is None:
        return None
    marks: list[Mark] = []
    at, measured, model = v.curves(series, k, "velocity", "measured", "identified")
    if at is not None and measured is not None and model is not None:
        scale = v.real(law, "per_reading") or 1.0
        seen = np.isfinite(speed)
        friction = np.interp(at, speed[seen], torque[seen])
        marks += cloud(at, scale * (measured - model) + friction, "hold-out")
    for side in (speed < 0, speed > 0):  # it jumps in between
        x = speed[side]
        y = torque[side]
        width = half[side]
        marks.insert(0, Band(x, y - width, y + width))
        marks.append(Line(x, y, fig.FITTED, "identified friction", 1.8))
    abscissa = Axis(f"velocity [{v.text(law, 'velocity_unit')}]")
    ordinate = Axis(f"friction [{v.text(law, 'unit')}]")
    joint = v.text(row, "name")
    label = (
        f"{joint}: friction over velocity, hold-out readings and the identified curve"
    )
    return Panel((Axes(tuple(marks), abscissa, ordinate, 210),), label, joint)


def forest_groups(result: Result) -> dict[str, list[Result]]:
    """Records of identified parameters of one kind and unit each, under its name."""
    groups: dict[str, list[Result]] = {}
    for row in v.records(result, "parameters"):
        owner, _, symbol = v.text(row, "name").rpartition(".")
        if v.real(row, "value") is not None:
            name = f"{_kind(symbol)} [{v.text(row, 'unit')}]"
            groups.setdefault(name, []).append(
                {**row, "owner": owner, "symbol": symbol}
            )
    return groups


def _kind(symbol: str) -> str:
    if symbol in STANDARD:
        return _GROUPS[STANDARD.index(symbol)]
    kinds = (
        v.plain(e.name) for e in EFFECTS.values() if symbol in [p.name for p in e.terms]
    )
    return next(kinds, symbol)


def forest_figure(result: Result) -> Figure | None:
    """Every identified parameter with its interval beside the given value, by kind."""
    panels = [_forest(name, rows) for name, rows in forest_groups(result).items()]
    caption = (
        "Identified parameters with their 95\u00a0% intervals beside the given values; a "
        "value that the prior decides says nothing that was not given."
    )
    legend = (
        Key("ring", fig.GIVEN, "given"),
        Key("dot", fig.FITTED, "identified, 95\u00a0% interval"),
        Key("ring", fig.FITTED, "decided by the prior"),
    )
    return fig.figure(panels, caption, legend)


def _forest(name: str, rows: Sequence[Result]) -> Panel:
    """Given and identified values of parameters in one unit, a row each from above."""
    symbols = [v.text(row, "symbol") for row in rows]
    several = len(set(symbols)) > 1
    names = []
    for row, symbol in zip(rows, symbols, strict=True):
        owner = v.shorten(v.text(row, "owner"), _LONG - 4 * several)
        names.append(f"{owner} {symbol}" if several else owner)
    y = -np.arange(len(rows), dtype=float)
    value, std, given = (
        np.array([v.real(row, key) for row in rows], float)
        for key in ("value", "std", "given")
    )
    half = _DEVIATIONS * np.nan_to_num(std)
    apart = np.full(len(rows), np.nan)
    interval = np.column_stack([value - half, value + half, apart]).ravel()
    heights = np.column_stack([y, y, apart]).ravel()
    prior = np.array([v.text(row, "decided_by") == "prior" for row in rows])
    marks = (
        fig.Rule(0.0, along="x"),
        Line(interval, heights, fig.FITTED, "", 1.4),
        Points(given, y, fig.GIVEN, "given", 6.0, "ring"),
        Points(value[~prior], y[~prior], fig.FITTED, "identified", 3.6),
        Points(value[prior], y[prior], fig.FITTED, "by the prior", 3.6, "hole"),
    )
    ticks = tuple(zip(y.tolist(), names, strict=True))
    ordinate = Axis("", 0.4 - len(rows), 0.6, ticks=ticks)
    abscissa = Axis(f"[{v.text(rows[0], 'unit')}]")
    axes = Axes(marks, abscissa, ordinate, _ROW * len(rows) + 60)
    label = f"{name}: {len(rows)} parameters, given and identified"
    return Panel((axes,), label, name)
