"""Torque over time with its residual, and errors before and after, joint by joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from excitant.reports.drawing import (
    FITTED,
    GIVEN,
    LIGHT,
    MEASURED,
    axes,
    draw_curve,
    label_y,
    panel,
    percent_x,
    timeline,
)
from excitant.reports.interval_figure import (
    BAND,
    BAND_CAPTION,
    MEANING,
    draw_band,
    half_width,
)
from excitant.reports.model import Figure, Key, Panel
from excitant.reports.reading import Series, curve, times
from excitant.reports.wording import percent, quantity, shorten
from excitant.robots.motion import Array


@dataclass(frozen=True)
class Curves:
    """Which series are drawn against the measurement: key, legend, before and after.

    The band is the half width of intervals around the model after, where a run has any.
    """

    before: str
    before_label: str
    after: str
    after_label: str
    caption: str
    band: str = ""


@dataclass(frozen=True)
class Change:
    """The error of one joint before and after: rms, and its share of the measured torque."""

    joint: str
    before: float | None
    after: float | None
    before_share: float | None
    after_share: float | None


def over_holdout(unit: str) -> str:
    """Heading of the torque figure, which shows currents where torque is recorded as such."""
    return "Current on the hold-out" if unit == "A" else "Torque on the hold-out"


def torque_figure(
    joints: Sequence[str],
    series: Series,
    unit: str,
    curves: Curves,
    colours: tuple[str, str] = (GIVEN, FITTED),
) -> Figure | None:
    """Measured torque against the model before and after, the residual below, per joint."""
    panels = [
        _torque_panel(k, joint, series, unit, curves, colours) for k, joint in enumerate(joints)
    ]
    present = tuple(each for each in panels if each is not None)
    if not present:
        return None
    legend, caption = [Key("line", MEASURED, "measured")], curves.caption
    if any(curve(series, curves.before, k) is not None for k in range(len(joints))):
        legend.append(Key("line", colours[0], curves.before_label))
    if any(curve(series, curves.after, k) is not None for k in range(len(joints))):
        legend.append(Key("line", colours[1], curves.after_label))
    if any(curve(series, curves.band, k) is not None for k in range(len(joints))):
        legend.append(Key("box", BAND, MEANING))
        caption += f" {BAND_CAPTION}"
    return Figure(present, caption, tuple(legend))


def _torque_panel(
    k: int,
    joint: str,
    series: Series,
    unit: str,
    curves: Curves,
    colours: tuple[str, str],
) -> Panel | None:
    t, measured = times(series), curve(series, "measured", k)
    if t is None or measured is None or len(t) != len(measured):
        return None
    time, joins = timeline(t)
    torque, residual = axes(2.7, (1.55, 1))
    draw_curve(torque, time, joins, measured, color=MEASURED, lw=1.3)
    residual.axhline(0, color="#8a8f94", lw=0.7)
    said = []
    half, after = half_width(series, curves.band, k, len(t)), curve(series, curves.after, k)
    if half is not None and after is not None and len(after) == len(t):
        draw_band(torque, time, joins, after, half)
        draw_band(residual, time, joins, np.zeros(len(t)), half)
        said.append(f"{MEANING} ±{quantity(float(half.mean()), unit)}")
    for key, label, colour in (
        (curves.before, curves.before_label, colours[0]),
        (curves.after, curves.after_label, colours[1]),
    ):
        model = curve(series, key, k)
        if model is None or len(model) != len(t):
            continue
        draw_curve(torque, time, joins, model, color=colour, lw=0.9)
        draw_curve(residual, time, joins, measured - model, color=colour, lw=0.8)
        said.append(f"{label} leaves rms {quantity(_rms(measured - model), unit)}")
    label_y(torque, f"torque [{unit}]" if unit != "A" else "current [A]")
    label_y(residual, f"residual [{unit}]")
    residual.set_xlabel("time [s]")
    residual.set_xlim(time[0], time[-1])
    return panel(torque, f"{joint}: measured torque over time; {'; '.join(said)}", joint)


def _rms(values: Array) -> float | None:
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else None


def error_bars(
    changes: Sequence[Change],
    unit: str,
    labels: tuple[str, str],
    caption: str,
    colours: tuple[str, str] = (GIVEN, FITTED),
) -> Figure | None:
    """Error per joint before and after as bars, the rms written beside each.

    The bars' length is the share of the measured torque's standard deviation (nrmse), so that
    large and small joints compare; without it, the rms itself.
    """
    lengths, shares = _lengths(changes)
    known = [x for pair in lengths for x in pair if x is not None]
    if not known:
        return None
    # one useless model must not make all other bars invisible
    top = min(max(known), max(1.5, 4 * float(np.median(known)))) if shares else max(known)
    top = top or 1.0
    (ax,) = axes(0.5 * len(changes) + 0.52, left=0.14)
    for row, (change, (before, after)) in enumerate(zip(changes, lengths, strict=True)):
        ax.text(0, row - 0.36, shorten(change.joint, 40), va="center", ha="left")
        _bar(ax, row - 0.08, before, change.before, top, unit, colours[0])
        _bar(ax, row + 0.17, after, change.after, top, unit, colours[1])
    _bar_axes(ax, len(changes) - 0.6, 1.38 * top)
    if shares:
        percent_x(ax)
    share_label = "rms of residual, share of the measured torque's std"
    ax.set_xlabel(share_label if shares else f"rms [{unit}]")
    compared = any(c.after is not None for c in changes)
    said = "; ".join(
        f"{c.joint} {quantity(c.before, unit)}"
        + (f" to {quantity(c.after, unit)}" if compared else "")
        for c in changes
    )
    legend = []
    if any(c.before is not None for c in changes):
        legend.append(Key("box", colours[0], labels[0]))
    if compared:
        legend.append(Key("box", colours[1], labels[1]))
    models = f"{labels[0]} to {labels[1]}" if compared else labels[0]
    drawing = panel(ax, f"rms per joint, {models}: {said}")
    return Figure((drawing,), caption, tuple(legend))


def _lengths(
    changes: Sequence[Change],
) -> tuple[list[tuple[float | None, float | None]], bool]:
    """Length of the bars of each joint, and whether they are shares."""
    shares = [(c.before_share, c.after_share) for c in changes]
    known = [(c.before, c.after) for c in changes]
    complete = all(
        share is not None or rms is None
        for pair, values in zip(shares, known, strict=True)
        for share, rms in zip(pair, values, strict=True)
    )
    return (shares, True) if complete else (known, False)


def _bar_axes(ax: Axes, bottom: float, right: float) -> None:
    ax.set_ylim(bottom, -0.6)
    ax.set_xlim(0, right)
    ax.set_yticks([])
    ax.spines["left"].set_visible(False)


def _bar(
    ax: Axes, y: float, length: float | None, rms: float | None, top: float, unit: str, colour: str
) -> None:
    if length is None:
        return
    cut = length > top * 1.0001
    ax.barh(y, min(length, top), height=0.22, color=colour)
    text = quantity(rms, unit) + (" (bar cut)" if cut else "")
    ax.text(min(length, top) + 0.012 * top, y, text, va="center", ha="left", fontsize=8)


def waterfall(steps: Sequence[tuple[str, float]], caption: str) -> Figure | None:
    """Hold-out error, relative to the model as given, after each effect that was added."""
    if len(steps) < 2:
        return None
    top = max(rms for _, rms in steps) or 1.0
    (ax,) = axes(0.44 * len(steps) + 0.52, left=0.14)
    for row, (label, rms) in enumerate(steps):
        ax.text(0, row - 0.3, shorten(label, 52), va="center", ha="left")
        ax.barh(row + 0.06, rms, height=0.26, color=FITTED if row else GIVEN)
        end = rms
        if row and steps[row - 1][1] > rms:
            end = steps[row - 1][1]
            ax.barh(row + 0.06, end - rms, left=rms, height=0.26, color=LIGHT)
        ax.text(end + 0.012 * top, row + 0.06, percent(rms, 3), va="center", fontsize=8)
    _bar_axes(ax, len(steps) - 0.65, 1.27 * top)
    ax.set_xlabel("error on the hold-out, share of the given model's")
    ax.set_xticks([x for x in MaxNLocator(5, steps=[1, 2, 2.5, 5]).tick_values(0, top) if x <= top])
    percent_x(ax)
    said = "; ".join(f"{label} {percent(rms, 3)}" for label, rms in steps)
    legend = (
        Key("box", GIVEN, "model as given"),
        Key("box", FITTED, "what remains"),
        Key("box", LIGHT, "taken away by this effect"),
    )
    return Figure((panel(ax, f"error on the hold-out step by step: {said}"),), caption, legend)
