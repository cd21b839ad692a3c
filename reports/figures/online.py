"""Estimates while samples come in, with their bands."""

import numpy as np

from excitant.reports import values as v
from excitant.reports.figure import (
    BAND,
    FITTED,
    Axes,
    Axis,
    Band,
    Figure,
    Key,
    Line,
    Panel,
    figure,
)
from excitant.reports.values import Series
from excitant.results import Identify, Payload
from excitant.robots.motion import Array

_SHOWN = 12  # parameters drawn of the many that were estimated
_BAND = 2.0  # standard deviations
_LEGEND = (
    Key("line", FITTED, "estimate"),
    Key("box", BAND, f"± {_BAND:g} standard deviations"),
)


def estimates_figure(result: Identify, series: Series) -> Figure | None:
    """Estimate and band over time of the parameters that the data determined most."""
    t = v.curve(series, "online_t")
    rows = result.base_parameters
    if t is None or len(t) < 2:
        return None
    value, std = (
        v.array(series, f"online_{key}", len(t), len(rows))
        for key in ("value", "std")
    )
    if value is None or std is None:
        return None
    units = {row.name: row.unit for row in result.parameters}
    known = np.isfinite(value + std).all(axis=0)
    kept = np.where(known, std[-1] / std[0], np.inf)
    names = [row.expression.split()[0].rpartition("·")[2] for row in rows]
    best: dict[str, int] = {}
    for k in np.argsort(kept, kind="stable")[: known.sum()]:
        best.setdefault(names[k].rpartition(".")[0], k)
    panels = [
        _estimate_panel(
            t, value[:, k], std[:, k], names[k], units.get(names[k], "")
        )
        for k in [*best.values()][:_SHOWN]
    ]
    caption = (
        f"Estimates of the {len(panels)} base parameters (of {len(rows)}) whose uncertainty fell "
        "most, at most one of each link or joint, named by the first parameter of their "
        "combination: the band should close around a level line."
    )
    return figure(panels, caption, _LEGEND)


def payload_figure(payload: Payload) -> Figure | None:
    """Mass and centre of mass of a payload over time, each with its band."""
    history = payload.history
    if history is None or len(history.t) < 2:
        return None
    t = v.reals(history.t)
    mass = v.reals(history.mass)
    panels = [_estimate_panel(t, mass, v.reals(history.mass_std), "mass", "kg")]
    centre = np.array(history.centre, float)
    std = np.array(history.centre_std, float)
    for k, axis in enumerate("xyz"):
        name = f"centre of mass, {axis}"
        panels.append(_estimate_panel(t, centre[:, k], std[:, k], name, "m"))
    caption = "The payload as it was known at each instant; the band holds it 95 times out of 100."
    return figure(panels, caption, _LEGEND)


def _estimate_panel(
    t: Array, value: Array, std: Array, name: str, unit: str
) -> Panel:
    """One estimate; the ordinate shows the second half of the time and room about it."""
    low = value - _BAND * std
    high = value + _BAND * std
    late = slice(len(t) // 2, None)
    bottom = float(low[late].min())
    top = float(high[late].max())
    room = 0.6 * (top - bottom) or 1.0
    ordinate = Axis(f"[{unit}]" if unit else "[SI]", bottom - room, top + room)
    abscissa = Axis("time [s]", float(t[0]), float(t[-1]))
    marks = Band(t, low, high), Line(t, value, FITTED, "estimate", 1.2)
    last = v.interval(value[-1], std[-1])
    axes = Axes(marks, abscissa, ordinate, 150)
    label = f"{name} over time, at the end {last} {unit}"
    return Panel((axes,), label, v.shorten(name, 44))
