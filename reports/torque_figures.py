"""Torque over time with its residual, and errors of models side by side, joint by joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from excitant.reports import drawing as draw
from excitant.reports import values as v
from excitant.reports.page import Figure, Key, Panel, figure
from excitant.reports.values import Result, Series
from excitant.robots.motion import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

INTERVAL = "95\u00a0% interval of a reading"
_INTERVAL_CAPTION = (
    " The band holds 95\u00a0% of readings if noise and parameters are all that is off."
)
_BINS = 120
_SHARE = "rms of residual, share of the measured torque's std"


@dataclass(frozen=True)
class Curves:
    """Which series are drawn against the measurement: key and legend, before and after.

    The band is the half width of intervals around the model after, where a run has any.
    """

    before: str
    before_label: str
    after: str
    after_label: str
    caption: str
    band: str = ""


# joints by name, each with rms and share of the measured torque for every model
Errors = Sequence[tuple[str, Sequence[tuple[float | None, float | None]]]]


def over_holdout(unit: str) -> str:
    """Heading of the torque figure, which shows currents where torque is recorded as such."""
    return "Current on the hold-out" if unit == "A" else "Torque on the hold-out"


def torque_figure(
    joints: Sequence[str], series: Series, unit: str, curves: Curves
) -> Figure | None:
    """Measured torque against the model before and after, the residual below, per joint."""
    panels = [_torque_panel(k, joint, series, unit, curves) for k, joint in enumerate(joints)]

    def drawn(key: str) -> bool:
        return any(v.curve(series, key, k) is not None for k in range(len(joints)))

    legend = [
        Key("line", draw.MEASURED, "measured"),
        *[Key("line", draw.GIVEN, curves.before_label)] * drawn(curves.before),
        *[Key("line", draw.FITTED, curves.after_label)] * drawn(curves.after),
        *[Key("box", draw.BAND, INTERVAL)] * drawn(curves.band),
    ]
    caption = curves.caption + _INTERVAL_CAPTION * drawn(curves.band)
    return figure(panels, caption, legend)


def _torque_panel(k: int, joint: str, series: Series, unit: str, curves: Curves) -> Panel | None:
    t, measured = v.times(series), v.curve(series, "measured", k)
    if t is None or measured is None or len(measured) != len(t):
        return None
    time, joins = draw.timeline(t)
    torque, residual = draw.axes(2.7, (1.55, 1))
    draw.draw_curve(torque, time, joins, measured, color=draw.MEASURED, lw=1.3)
    residual.axhline(0, color="#8a8f94", lw=0.7)
    said = []
    half, after = (_of_rows(series, key, k, len(t)) for key in (curves.band, curves.after))
    if half is not None and np.isfinite(half).all() and after is not None:
        draw_band(torque, time, joins, after, half)
        draw_band(residual, time, joins, np.zeros(len(t)), half)
        said.append(f"{INTERVAL} ±{v.quantity(float(half.mean()), unit)}")
    for key, label, colour in (
        (curves.before, curves.before_label, draw.GIVEN),
        (curves.after, curves.after_label, draw.FITTED),
    ):
        model = _of_rows(series, key, k, len(t))
        if model is None:
            continue
        draw.draw_curve(torque, time, joins, model, color=colour, lw=0.9)
        draw.draw_curve(residual, time, joins, measured - model, color=colour, lw=0.8)
        finite = (measured - model)[np.isfinite(measured - model)]
        rms = float(np.sqrt(np.mean(finite**2))) if len(finite) else None
        said.append(f"{label} leaves rms {v.quantity(rms, unit)}")
    draw.label_y(torque, f"torque [{unit}]" if unit != "A" else "current [A]")
    draw.label_y(residual, f"residual [{unit}]")
    residual.set_xlabel("time [s]")
    residual.set_xlim(time[0], time[-1])
    return draw.panel(torque, f"{joint}: measured torque over time; {'; '.join(said)}", joint)


def _of_rows(series: Series, key: str, joint: int, n: int) -> Array | None:
    """One joint's column of n rows; None where a run has none."""
    found = v.curve(series, key, joint)
    return found if found is not None and len(found) == n else None


def draw_band(ax: Axes, t: Array, joins: Sequence[int], centre: Array, half: Array) -> None:
    """Fill centre ± half over time, broken where recordings were joined.

    Bins take the least and the greatest edge in them, so that no part of the band is lost.
    """
    for first, last in zip([0, *joins], [*joins, len(t)], strict=True):
        bins = max(20, round(_BINS * (last - first) / len(t)))
        starts = np.unique(np.linspace(first, last, bins, endpoint=False).astype(int))
        low = np.minimum.reduceat((centre - half)[:last], starts)
        high = np.maximum.reduceat((centre + half)[:last], starts)
        x = np.append(t[starts], t[last - 1])
        ax.fill_between(
            x, np.append(low, low[-1]), np.append(high, high[-1]), color=draw.BAND, lw=0, zorder=0.5
        )


def error_bars(
    rows: Sequence[Result], models: Sequence[str], unit: str, curves: Curves, what: str
) -> Figure | None:
    """Errors of the models before and after, by joint, as each record holds them by model."""
    labels = [(curves.before_label, draw.GIVEN), (curves.after_label, draw.FITTED)][: len(models)]
    errors = [
        (v.text(row, "name"), [(v.real(row, m, "rms"), v.real(row, m, "nrmse")) for m in models])
        for row in rows
    ]
    changed = any(rms is not None for _, pairs in errors for rms, _ in pairs[1:])
    return bars(errors, unit, labels[: 1 + changed], what)


def bars(errors: Errors, unit: str, models: Sequence[tuple[str, str]], what: str) -> Figure | None:
    """Errors per joint of some models as bars, the rms written beside each.

    The bars' length is the share of the measured torque's standard deviation (nrmse), so that
    large and small joints compare; without it, the rms itself.

    Args:
        errors: Of each joint.
        unit: Of the torque.
        models: Label and colour of each.
        what: First words of the caption.
    """
    count = len(models)
    every = [pair for _, pairs in errors for pair in pairs[:count]]
    shares = all(share is not None or rms is None for rms, share in every)
    known = [x for pair in every if (x := pair[shares]) is not None]
    if not known:
        return None
    # one useless model must not make all other bars invisible
    top = min(max(known), max(1.5, 4 * float(np.median(known)))) if shares else max(known)
    top = top or 1.0
    step = 0.25 if count < 3 else 0.23
    (ax,) = draw.axes((0.24 + 0.13 * count) * len(errors) + 0.52, left=0.14)
    for row, (joint, pairs) in enumerate(errors):
        ax.text(0, row - 0.36, v.shorten(joint, 40), va="center", ha="left")
        for i, (pair, (_, colour)) in enumerate(zip(pairs, models, strict=False)):
            length = pair[shares]
            if length is None:
                continue
            y = row + 0.045 * (count - 1) + step * (i - (count - 1) / 2)
            ax.barh(y, min(length, top), height=0.88 * step, color=colour)
            rms = v.quantity(pair[0], unit) + " (bar cut)" * (length > top * 1.0001)
            ax.text(min(length, top) + 0.012 * top, y, rms, va="center", ha="left", fontsize=8)
    bar_axes(ax, len(errors) - (0.6 if count < 3 else 0.5), 1.38 * top)
    if shares:
        draw.percent_x(ax)
    ax.set_xlabel(_SHARE if shares else f"rms [{unit}]")
    said = [
        f"{label} {v.quantity(pairs[i][0], unit)} at {joint}"
        for joint, pairs in errors
        for i, (label, _) in enumerate(models)
    ]
    measure = "as a share of the measured torque's standard deviation" if shares else "as rms"
    return Figure(
        (draw.panel(ax, f"rms per joint: {'; '.join(said)}"),),
        f"{what}, {measure}; beside each bar the rms [{unit}]: shorter is better.",
        tuple(Key("box", colour, label) for label, colour in models),
    )


def bar_axes(ax: Axes, bottom: float, right: float) -> None:
    """Frame for horizontal bars with their names above them."""
    ax.set_ylim(bottom, -0.6)
    ax.set_xlim(0, right)
    ax.set_yticks([])
    ax.spines["left"].set_visible(False)
