"""Prediction against measurement, and what the residual goes with: state, load, frequency."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

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
_MODELS = (("given", draw.GIVEN, "model as given"), ("identified", draw.FITTED, "identified model"))


def agreement_figure(result: Result, series: Series, unit: str) -> Figure | None:
    """Measured torque over what each model predicts, per joint."""
    panels = [
        _agreement(k, v.text(row, "name"), row, series, unit)
        for k, row in enumerate(v.records(result, "joints"))
    ]
    caption = (
        "Measured over predicted torque while the joint moves on the hold-out: a good model's "
        "points lie on the diagonal; a slope tells of a wrong gain or mass, a step of friction."
    )
    keys = [Key("dot", colour, name) for _, colour, name in _MODELS]
    return figure(panels, caption, [*keys, Key("dash", draw.MEASURED, "equal")])


def _agreement(k: int, joint: str, row: Result, series: Series, unit: str) -> Panel | None:
    measured, *models = (v.curve(series, key, k) for key in ("measured", "given", "identified"))
    dq = v.curve(series, "velocity", k)
    if measured is None or models[1] is None or len(models[1]) != len(measured):
        return None
    moves = np.isfinite(measured)
    if dq is not None and len(dq) == len(measured):
        moves &= np.isfinite(dq)
    (ax,) = draw.axes(2.7)
    rows = np.flatnonzero(moves)[:: max(1, int(moves.sum()) // _POINTS)]
    for model, (_, colour, _) in zip(models, _MODELS, strict=True):
        if model is not None and len(model) == len(measured):
            look: Any = {"s": 5, "c": colour, "alpha": 0.35, "lw": 0}
            ax.scatter(model[rows], measured[rows], **look, rasterized=True)
    ends = [measured[moves].min(initial=0.0), measured[moves].max(initial=0.0)]
    ax.plot(ends, ends, color=draw.MEASURED, lw=1.0, ls=draw.DASHED)
    ax.margins(0.04)
    ax.set_xlabel(f"predicted [{unit}]")
    draw.label_y(ax, f"measured [{unit}]")
    share = v.at(row, "validate", "r2")
    told = f", identified r² {v.number4(share)}" if share is not None else ""
    return draw.panel(ax, f"{joint}: measured over predicted torque{told}", f"{joint}{told}")


def residual_figure(result: Result, series: Series, unit: str) -> Figure | None:
    """Residual of the identified model over position, velocity, load and frequency, per joint."""
    joints = v.joint_names(result)
    cutoff = v.real(result, "cutoff_hz")
    panels = [_residual(k, joint, result, series, unit, cutoff) for k, joint in enumerate(joints)]
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
        *(Key("line", colour, f"of the residual, {name}") for _, colour, name in _MODELS),
    ]
    return figure(panels, caption, legend)


def _residual(
    k: int, joint: str, result: Result, series: Series, unit: str, cutoff: float | None
) -> Panel | None:
    keys = ("measured", "given", "identified", "position", "velocity")
    measured, given, model, q, dq = (v.curve(series, key, k) for key in keys)
    t = v.times(series)
    if t is None or measured is None or model is None or q is None or dq is None:
        return None
    if any(len(x) != len(t) for x in (measured, model, q, dq)):
        return None
    speed = v.text(v.records(result, "joints")[k], "friction", "velocity_unit")
    units = (speed.removesuffix("/s"), speed, unit)
    *clouds, spectrum = draw.axes(5.4, (1, 1, 1, 1), space=0.75, shared=False)
    load = np.abs(model) * np.sign(dq)
    names = ("position", "velocity", "load")
    for ax, x, name, si in zip(clouds, (q, dq, load), names, units, strict=True):
        draw_points(ax, np.where(np.isfinite(dq), x, np.nan), measured - model)
        ax.axhline(0, color="#8a8f94", lw=0.7)
        ax.margins(0.04)
        ax.set_xlabel(f"{name} [{si}]" if si else name, labelpad=1)
        draw.label_y(ax, f"[{unit}]")
    lines = [(measured, draw.MEASURED)]
    for other, colour in ((given, draw.GIVEN), (model, draw.FITTED)):
        if other is not None and len(other) == len(t):
            lines.append((np.where(np.isfinite(dq), measured - other, 0.0), colour))
    _draw_spectra(spectrum, draw.timeline(t)[0], lines, cutoff)
    draw.label_y(spectrum, f"[{unit}/√Hz]")
    label = f"{joint}: residual over position, velocity and load, and its spectrum"
    return draw.panel(spectrum, label, joint)


def _draw_spectra(
    ax: draw.Axes, t: Array, lines: Sequence[tuple[Array, str]], cutoff: float | None
) -> None:
    """Amplitude densities up to twice the cut-off, by Welch's method."""
    from scipy.signal import welch

    rate = 1.0 / float(np.median(np.diff(t)))
    top = min(rate / 2, _SHOWN * (cutoff or rate))
    highest = 0.0
    for y, colour in lines:
        known = np.isfinite(y)
        f, power = welch(y[known], rate, nperseg=max(8, known.sum() // _WINDOWS))
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
