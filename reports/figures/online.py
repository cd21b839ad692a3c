"""Estimates while samples come in, with their bands, and how well the motion excites them."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from excitant.reports import values as v
from excitant.reports.figure import (
    AMBER,
    BAND,
    FITTED,
    MEASURED,
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
    Span,
    figure,
)
from excitant.reports.values import Series
from excitant.results import Identify, Online, Payload
from excitant.robots.motion import Array
from excitant.robots.parameters import STANDARD

ENOUGH = 1.0  # level at which the window knows as much as the prior
_SHOWN = 6  # parameters drawn of links, and as many of joints, of the many that were estimated
_BAND = 2.0  # standard deviations
_LEGEND = (
    Key("line", FITTED, "estimate"),
    Key("box", BAND, f"± {_BAND:g} standard deviations"),
)
_FEW = 4  # stretches of too little excitation that are written out


def excitation_levels(online: Online) -> tuple[Array, Array]:
    """Times and excitation levels of the looks; NaN before a whole window."""
    return v.reals(online.history.t), v.reals(online.history.excitation_level)


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
    names = [_first_parameter(row.expression, units) for row in rows]
    panels = [
        _estimate_panel(
            t, value[:, k], std[:, k], names[k], units.get(names[k], "")
        )
        for k in _most_informed(value, std, names)
    ]
    caption = (
        f"Estimates of the {len(panels)} base parameters (of {len(names)}) whose uncertainty fell "
        "most, at most one of each link or joint, named by the first parameter of their "
        "combination: the band should close around a level line."
    )
    return figure(panels, caption, _LEGEND)


def _first_parameter(expression: str, names: dict[str, str]) -> str:
    parts = re.split(r"[ ·−+()]+", expression)
    return next((part for part in parts if part in names), expression)


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


def _most_informed(value: Array, std: Array, names: Sequence[str]) -> list[int]:
    with np.errstate(divide="ignore", invalid="ignore"):
        gain = np.log(std[0] / std[-1])
    order = np.argsort(-np.where(np.isfinite(gain), gain, -np.inf), kind="stable")
    finite = np.asarray(np.isfinite(value + std).all(axis=0))
    best: dict[str, int] = {}
    for k in order[finite[order]]:
        best.setdefault(names[k].rpartition(".")[0], int(k))
    inertial = [k for k in best.values() if names[k].rpartition(".")[2] in STANDARD]
    others = [k for k in best.values() if k not in inertial]
    return [*sorted(inertial[:_SHOWN]), *sorted(others[:_SHOWN])]


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
    last = " ± ".join(v.value_and_std(value[-1], std[-1]))
    axes = Axes(marks, abscissa, ordinate, 150)
    label = f"{name} over time, at the end {last} {unit}"
    return Panel((axes,), label, v.shorten(name, 44))


def excitation_figure(online: Online) -> Figure | None:
    """Excitation of the last seconds at each look, and where it was too little."""
    t, level = excitation_levels(online)
    seen = np.isfinite(level) & (level > 0)
    if seen.sum() < 2:
        return None
    t = t[seen]
    level = level[seen]
    spans = _spans(t, level < ENOUGH)
    name = "weakest visible direction"
    marks: list[Mark] = [
        *(Span(first, last, AMBER, "x", 0.25) for first, last in spans),
        Line(t, level, FITTED, name, 1.3),
        Points(t, level, FITTED, size=2.2),
        Rule(ENOUGH, MEASURED, dashed=True),
    ]
    least = min(0.5 * float(level.min()), 0.5)
    most = max(2 * float(level.max()), 2.0)
    ordinate = Axis("excitation level [–]", least, most, log=True)
    axes = Axes(marks, Axis("time [s]", float(t[0]), float(t[-1])), ordinate, 190)
    legend = [Key("line", FITTED, name), Key("dash", MEASURED, "enough")]
    verdict = "never below it"
    if spans:
        legend.append(Key("box", AMBER, "not exciting enough"))
        verdict = _too_little(spans)
    caption = (
        "Information of the last seconds about the weakest direction that a fast motion of all "
        f"joints shows, relative to the prior's. Level 1 is enough; here {verdict}."
    )
    panel = Panel((axes,), f"excitation level over time; {verdict}")
    return Figure((panel,), caption, legend)


def _too_little(spans: Sequence[tuple[float, float]]) -> str:
    since = ", ".join(
        f"{first:.1f} s to {last:.1f} s" for first, last in spans[:_FEW]
    )
    lacking = v.quantity(sum(last - first for first, last in spans), "s")
    more = " and later again" if len(spans) > _FEW else ""
    return (
        f"not exciting enough from {since}{more} ({lacking} in all; a message's “since” is where "
        "its window began)"
    )


def _spans(t: Array, bad: npt.NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Intervals in which a condition held, from the look that saw it to the next that did not."""
    edges = np.flatnonzero(
        np.diff(np.concatenate([[False], bad, [False]]).astype(int))
    )
    return [
        (float(t[a]), float(t[min(b, len(t) - 1)])) for a, b in edges.reshape(-1, 2)
    ]
