"""What was identified: friction over velocity, and parameters beside the given ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from excitant.reports import drawing as draw
from excitant.reports import values as v
from excitant.reports.error_figures import draw_points
from excitant.reports.page import Figure, Key, Panel, figure
from excitant.reports.values import Result, Series
from excitant.robots.effects import EFFECTS
from excitant.robots.parameters import STANDARD

_GROUPS = ("mass", *("first moment",) * 3, *("inertia",) * 6)
_BAND = "95\u00a0% interval of the curve"
FRICTION_KEYS = (
    Key("dot", draw.LIGHT, "hold-out"),
    Key("dot", draw.MEASURED, "median in bins"),
    Key("line", draw.FITTED, "identified friction"),
    Key("box", draw.BAND, _BAND),
)
FOREST_KEYS = (
    Key("ring", draw.GIVEN, "given"),
    Key("dot", draw.FITTED, "identified, 95\u00a0% interval"),
    Key("ring", draw.FITTED, "decided by the prior"),
)
_DEVIATIONS = 1.96  # standard deviations that hold 95 %
_LINE = 0.165  # inch: height of a row of the forest
_LABELS = 1.3  # room for its name
_LONG = 20  # letters of a name there


def friction_axes(k: int, result: Result, series: Series) -> draw.Axes | None:
    """Friction of the k-th joint over its velocity; None where none was estimated.

    The points are what the rest of the model leaves of the measured torque; they and the curve come
    from ``result.json`` and the series of `identify`.
    """
    known = v.at(v.records(result, "joints")[k], "friction")
    keys = ("velocity", "torque", "half_width")
    speed, torque, half = v.curves(series, k, *(f"friction_{key}" for key in keys))
    if known is None or speed is None or torque is None or half is None:
        return None
    (ax,) = draw.axes(2.6)
    at, measured, model = v.curves(series, k, "velocity", "measured", "identified")
    if at is not None and measured is not None and model is not None:
        scale = v.real(known, "per_reading") or 1.0
        seen = np.isfinite(speed)
        y = scale * (measured - model) + np.interp(at, speed[seen], torque[seen])
        draw_points(ax, at, y)
    for side in (speed < 0, speed > 0):  # it jumps in between
        x = speed[side]
        y = torque[side]
        width = half[side]
        ax.fill_between(x, y - width, y + width, color=draw.BAND, lw=0, zorder=1.5)
        ax.plot(x, y, color=draw.FITTED, lw=1.8, zorder=3)
    ax.margins(0.04)
    ax.set_xlabel(f"velocity [{v.text(known, 'velocity_unit')}]")
    draw.label_y(ax, f"friction [{v.text(known, 'unit')}]")
    return ax


def friction_figure(result: Result, series: Series) -> Figure | None:
    """Friction of every joint over its velocity, with the readings of the hold-out."""
    panels: list[Panel] = []
    for k, row in enumerate(v.records(result, "joints")):
        if (ax := friction_axes(k, result, series)) is not None:
            joint = v.text(row, "name")
            label = f"{joint}: friction over velocity, hold-out readings and the identified curve"
            panels.append(draw.panel(ax, label, joint))
    caption = (
        "Friction as identified, and what the rest of the model leaves of the measured torque on "
        "the hold-out: where medians bend away from the curve, friction has another law."
    )
    return figure(panels, caption, FRICTION_KEYS)


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


def forest_axes(rows: Sequence[Result]) -> draw.Axes:
    """Given and identified values of parameters in one unit, a row each, as `forest_groups`."""
    several = len({v.text(row, "symbol") for row in rows}) > 1
    (ax,) = draw.axes(_LINE * len(rows) + 0.6, left=_LABELS)
    symbols = [f" {v.text(row, 'symbol')}" * several for row in rows]
    owners = [v.shorten(v.text(row, "owner"), _LONG - 4 * several) for row in rows]
    ax.axvline(0, color="#8a8f94", lw=0.7)
    y = np.arange(len(rows))
    value, std, given = (
        np.array([v.real(row, key) for row in rows], float)
        for key in ("value", "std", "given")
    )
    half = _DEVIATIONS * np.nan_to_num(std)
    ax.hlines(
        y, value - half, value + half, color=draw.FITTED, lw=1.4, capstyle="round"
    )
    ring: Any = {"ms": 6, "mec": draw.GIVEN, "mfc": "none", "mew": 1.1}
    ax.plot(given, y, "o", **ring)
    prior = np.array([v.text(row, "decided_by") == "prior" for row in rows])
    for some, fill in ((~prior, draw.FITTED), (prior, "white")):
        look: Any = {"ms": 3.6, "mec": draw.FITTED, "mfc": fill, "mew": 1.0}
        ax.plot(value[some], y[some], "o", **look)
    names = map("".join, zip(owners, symbols, strict=True))
    ax.set_yticks(y, list(names))
    ax.tick_params(axis="y", labelsize=8)
    ax.set_ylim(len(rows) - 0.4, -0.6)
    ax.grid(visible=False, axis="y")
    ax.set_xlabel(f"[{v.text(rows[0], 'unit')}]")
    return ax


def forest_figure(result: Result) -> Figure | None:
    """Every identified parameter with its interval beside the given value, by kind."""
    panels = [
        draw.panel(
            forest_axes(rows),
            f"{name}: {len(rows)} parameters, given and identified",
            name,
        )
        for name, rows in forest_groups(result).items()
    ]
    caption = (
        "Identified parameters with their 95\u00a0% intervals beside the given values; a "
        "value that the prior decides says nothing that was not given."
    )
    return figure(panels, caption, FOREST_KEYS)
