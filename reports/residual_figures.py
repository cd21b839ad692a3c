"""Prediction against measurement, and what the residual goes with: state, load, frequency."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from excitant.identify.spectra import power_density
from excitant.reports import drawing as draw
from excitant.reports import values as v
from excitant.reports.error_figures import draw_points
from excitant.reports.page import Figure, Key, Panel, figure
from excitant.reports.values import Result, Series
from excitant.robots.motion import Array

_POINTS = 1500  # of each cloud
_SHOWN = 2.0  # times the cut-off: frequencies up to there are drawn
_WINDOWS = 8  # at least, of which a spectrum is the mean
_DECADES = 4.0  # below the highest density, what is drawn of a spectrum
_MODELS = (
    ("given", draw.GIVEN, "model as given"),
    ("identified", draw.FITTED, "identified model"),
)


def agreement_figure(result: Result, series: Series, unit: str) -> Figure | None:
    """Measured torque over what each model predicts, per joint."""
    panels = [
        _agreement(k, row, series, unit)
        for k, row in enumerate(v.records(result, "joints"))
    ]
    caption = (
        "Measured over predicted torque while the joint moves on the hold-out: a good model's "
        "points lie on the diagonal; a slope tells of a wrong gain or mass, a step of friction."
    )
    keys = [Key("dot", colour, name) for _, colour, name in _MODELS]
    return figure(panels, caption, [*keys, Key("dash", draw.MEASURED, "equal")])


def _agreement(k: int, row: Result, series: Series, unit: str) -> Panel | None:
    keys = ("measured", "given", "identified", "velocity")
    measured, given, identified, dq = v.curves(series, k, *keys)
    if measured is None or identified is None:
        return None
    moves = np.isfinite(measured if dq is None else measured + dq)
    (ax,) = draw.axes(2.7)
    rows = np.flatnonzero(moves)[:: max(1, int(moves.sum()) // _POINTS)]
    for model, (_, colour, _) in zip((given, identified), _MODELS, strict=True):
        if model is not None:
            look: Any = {"s": 5, "c": colour, "alpha": 0.35, "lw": 0}
            ax.scatter(model[rows], measured[rows], **look, rasterized=True)
    ends = [measured[moves].min(initial=0.0), measured[moves].max(initial=0.0)]
    ax.plot(ends, ends, color=draw.MEASURED, lw=1.0, ls=draw.DASHED)
    ax.margins(0.04)
    ax.set_xlabel(f"predicted [{unit}]")
    draw.label_y(ax, f"measured [{unit}]")
    share = v.at(row, "validate", "r2")
    told = f", identified r² {v.number4(share)}" if share is not None else ""
    joint = v.text(row, "name")
    return draw.panel(
        ax, f"{joint}: measured over predicted torque{told}", f"{joint}{told}"
    )


def residual_figure(result: Result, series: Series, unit: str) -> Figure | None:
    """Residual of the identified model over position, velocity, load and frequency, per joint."""
    cutoff = v.real(result, "cutoff_hz")
    rows = enumerate(v.records(result, "joints"))
    panels = [_residual(k, row, series, unit, cutoff) for k, row in rows]
    caption = (
        "What the identified model leaves while the joint moves on the hold-out. Medians that bend "
        "away from zero over position tell of springs or ripple, over velocity of friction, over "
        "load (the torque's magnitude, signed by direction) of gains or load-dependent friction. "
        "Last its spectrum, with those of the torque and of the given model's residual."
    )
    legend = [
        Key("dot", draw.LIGHT, "residual"),
        Key("dot", draw.MEASURED, "median in bins"),
        Key("line", draw.MEASURED, "spectrum of the torque"),
        *(
            Key("line", colour, f"of the residual, {name}")
            for _, colour, name in _MODELS
        ),
    ]
    return figure(panels, caption, legend)


def _residual(
    k: int, row: Result, series: Series, unit: str, cutoff: float | None
) -> Panel | None:
    t = v.times(series)
    keys = ("measured", "given", "identified", "position", "velocity")
    measured, given, model, q, dq = v.curves(series, k, *keys)
    if t is None or measured is None or model is None or q is None or dq is None:
        return None
    if len(measured) != len(t):
        return None
    speed = v.text(row, "friction", "velocity_unit")
    *clouds, spectrum = draw.axes(5.4, (1, 1, 1, 1), space=0.75, shared=False)
    drawn = (
        ("position", q, speed.removesuffix("/s")),
        ("velocity", dq, speed),
        ("load", np.abs(model) * np.sign(dq), unit),
    )
    for ax, (name, x, si) in zip(clouds, drawn, strict=True):
        draw_points(ax, np.where(np.isfinite(dq), x, np.nan), measured - model)
        ax.axhline(0, color="#8a8f94", lw=0.7)
        ax.margins(0.04)
        ax.set_xlabel(f"{name} [{si}]" if si else name, labelpad=1)
        draw.label_y(ax, f"[{unit}]")
    lines = [(measured, draw.MEASURED)]
    for other, (_, colour, _) in zip((given, model), _MODELS, strict=True):
        if other is not None:
            lines.append((np.where(np.isfinite(dq), measured - other, 0.0), colour))
    _draw_spectra(spectrum, draw.timeline(t)[0], lines, cutoff)
    draw.label_y(spectrum, f"[{unit}/√Hz]")
    joint = v.text(row, "name")
    label = f"{joint}: residual over position, velocity and load, and its spectrum"
    return draw.panel(spectrum, label, joint)


def _draw_spectra(
    ax: draw.Axes, t: Array, lines: Sequence[tuple[Array, str]], cutoff: float | None
) -> None:
    """Amplitude densities up to twice the cut-off."""
    rate = 1.0 / float(np.median(np.diff(t)))
    top = min(rate / 2, _SHOWN * (cutoff or rate))
    highest = 0.0
    for y, colour in lines:
        known = y[np.isfinite(y)]
        f, power = power_density(known, rate, max(8, len(known) // _WINDOWS))
        shown = (f > 0) & (f <= top)
        density = np.sqrt(power[shown])
        highest = max(highest, float(density.max(initial=0.0)))
        ax.plot(f[shown], density, color=colour, lw=1.0)
    if cutoff is not None and cutoff < top:
        ax.axvline(cutoff, color=draw.MEASURED, lw=0.9, ls=draw.DASHED)
    ax.set_xlim(0, top)
    if highest > 0:
        ax.set_ylim(highest / 10**_DECADES, 2 * highest)
        draw.log_y(ax)
    ax.set_xlabel("frequency [Hz], cut-off dashed", labelpad=1)
