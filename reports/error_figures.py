"""Torque and its prediction error: over time, by joint, by quantity, by effect and per finding."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from excitant.reports import drawing as draw
from excitant.reports import values as v
from excitant.reports.page import Figure, Key, Panel, Timeline, figure
from excitant.reports.values import Result, Series
from excitant.robots.motion import Array

INTERVAL = "95\u00a0% interval of a reading"
_INTERVAL_CAPTION = (
    " The band holds 95\u00a0% of readings if noise and parameters are all that is off."
)
_GIVEN = "model as given"
_BINS = 120
_SHARE = "rms of residual, share of the measured torque's std"

# lengths and colours of the pieces of a bar one after the other, and the words behind it
_Bar = tuple[Sequence[tuple[float, str]], str]

_FOLLOWED = (
    ("before", "arm as identified", ("given", "identified")),
    ("after", "after its change", ("given", "identified", "extended")),
)
_MODELS = {
    "given": (_GIVEN, draw.GIVEN),
    "identified": ("identified", draw.FITTED),
    "extended": ("extended by the diagnosis", draw.GREEN),
}

_STEPS = 12  # of the waterfall that are drawn one by one
_POINTS = 2500  # drawn of a finding: points
_MEDIANS = 24  # medians
_CURVE = 60  # along the fit
_WIDE = 0.08  # of the abscissa: across wider stretches without data no curve is drawn


@dataclass(frozen=True)
class Curves:
    """Series drawn against the measurement: two models, the half width of intervals."""

    before: str
    after: str
    after_label: str
    caption: str
    band: str = ""


def over_holdout(unit: str) -> str:
    """Heading of the torque figure, which shows currents where torque is recorded as such."""
    return "Current on the hold-out" if unit == "A" else "Torque on the hold-out"


def torque_figure(
    joints: Sequence[str], series: Series, unit: str, curves: Curves
) -> Figure | None:
    """Measured torque against the model before and after, the residual below, per joint."""
    panels = [
        _torque_panel(k, joint, series, unit, curves) for k, joint in enumerate(joints)
    ]

    def drawn(key: str) -> bool:
        return any(v.curve(series, key, k) is not None for k in range(len(joints)))

    legend = [
        Key("line", draw.MEASURED, "measured"),
        *[Key("line", draw.GIVEN, _GIVEN)] * drawn(curves.before),
        *[Key("line", draw.FITTED, curves.after_label)] * drawn(curves.after),
        *[Key("box", draw.BAND, INTERVAL)] * drawn(curves.band),
    ]
    caption = curves.caption + _INTERVAL_CAPTION * drawn(curves.band)
    return figure(panels, caption, legend, _timeline(joints, series, unit, curves))


def _timeline(
    joints: Sequence[str], series: Series, unit: str, curves: Curves
) -> Timeline | None:
    """The series that panels of all joints draw; None where one lacks any."""
    t = v.times(series)
    looks = (
        ("measured", draw.MEASURED),
        (_GIVEN, draw.GIVEN),
        (curves.after_label, draw.FITTED),
    )
    keys = ("measured", curves.before, curves.after, curves.band)
    if t is None:
        return None
    *found, half = (v.array(series, key, len(t), len(joints)) for key in keys)
    if found[0] is None:
        return None
    some = [k for k in range(len(joints)) if np.isfinite(found[0][:, k]).any()]
    return Timeline(
        draw.timeline(t)[0],
        tuple(joints[k] for k in some),
        unit,
        tuple(
            (*look, x[:, some])
            for look, x in zip(looks, found, strict=True)
            if x is not None
        ),
        None if half is None or found[2] is None else half[:, some],
    )


def _torque_panel(
    k: int, joint: str, series: Series, unit: str, curves: Curves
) -> Panel | None:
    t = v.times(series)
    measured = v.curve(series, "measured", k)
    if t is None or measured is None or len(measured) != len(t):
        return None
    time, joins = draw.timeline(t)
    torque, residual = draw.axes(2.7, (1.55, 1))
    draw.draw_curve(torque, time, joins, measured, color=draw.MEASURED, lw=1.3)
    residual.axhline(0, color="#8a8f94", lw=0.7)
    said = []
    half, after = (
        v.curve(series, key, k, len(t)) for key in (curves.band, curves.after)
    )
    if half is not None and np.isfinite(half).all() and after is not None:
        draw_band(torque, time, joins, after, half)
        draw_band(residual, time, joins, np.zeros(len(t)), half)
        said.append(f"{INTERVAL} ±{v.quantity(float(half.mean()), unit)}")
    for key, label, colour in (
        (curves.before, _GIVEN, draw.GIVEN),
        (curves.after, curves.after_label, draw.FITTED),
    ):
        model = v.curve(series, key, k, len(t))
        if model is None:
            continue
        draw.draw_curve(torque, time, joins, model, color=colour, lw=0.9)
        draw.draw_curve(residual, time, joins, measured - model, color=colour, lw=0.8)
        said.append(f"below it what the {label} leaves")
    draw.label_y(torque, f"torque [{unit}]" if unit != "A" else "current [A]")
    draw.over_time(residual, time, f"residual [{unit}]")
    return draw.panel(
        torque, f"{joint}: measured torque over time; {'; '.join(said)}", joint
    )


def draw_band(
    ax: draw.Axes, t: Array, joins: Sequence[int], centre: Array, half: Array
) -> None:
    """Fill centre ± half, broken where recordings were joined; bins lose no edge."""
    for first, last in zip([0, *joins], [*joins, len(t)], strict=True):
        bins = max(20, round(_BINS * (last - first) / len(t)))
        starts = np.unique(np.linspace(first, last, bins, endpoint=False).astype(int))
        low = np.minimum.reduceat((centre - half)[:last], starts)
        high = np.maximum.reduceat((centre + half)[:last], starts)
        x = np.append(t[starts], t[last - 1])
        low = np.append(low, low[-1])
        high = np.append(high, high[-1])
        ax.fill_between(x, low, high, color=draw.BAND, lw=0, zorder=0.5)


def error_bars(
    records: Sequence[Result],
    models: Sequence[str],
    unit: str,
    curves: Curves,
    what: str,
) -> Figure | None:
    """Errors per joint as bars as long as nrmse, or else rms, which stands beside.

    Each record holds the errors of one joint by model; ``what`` begins the caption.
    """
    errors = [
        (
            v.text(row, "name"),
            [(v.real(row, m, "rms"), v.real(row, m, "nrmse")) for m in models],
        )
        for row in records
    ]
    count = 1 + any(rms is not None for _, pairs in errors for rms, _ in pairs[1:])
    looks = ((_GIVEN, draw.GIVEN), (curves.after_label, draw.FITTED))[:count]
    every = [pair for _, pairs in errors for pair in pairs[:count]]
    shares = all(share is not None or rms is None for rms, share in every)
    known = [x for pair in every if (x := pair[shares]) is not None]
    if not known:
        return None
    # one useless model must not make all other bars invisible
    top = (
        min(max(known), max(1.5, 4 * float(np.median(known)))) if shares else max(known)
    )
    rows = []
    for joint, pairs in errors:
        bars = []
        for pair, (_, colour) in zip(pairs, looks, strict=False):
            length = pair[shares]
            cut = length is not None and length > (top or 1.0) * 1.0001
            words = v.quantity(pair[0], unit) + " (bar cut)" * cut
            bars.append(([] if length is None else [(min(length, top), colour)], words))
        rows.append((joint, bars))
    ax = _bar_axes(rows, top or 1.0, 1.38)
    if shares:
        draw.percent_x(ax)
    ax.set_xlabel(_SHARE if shares else f"rms [{unit}]")
    said = [
        f"{label} {v.quantity(pair[0], unit)} at {joint}"
        for joint, pairs in errors
        for pair, (label, _) in zip(pairs, looks, strict=False)
    ]
    measure = (
        "as a share of the measured torque's standard deviation" if shares else "as rms"
    )
    return draw.single(
        ax,
        f"rms per joint: {'; '.join(said)}",
        f"{what}, {measure}; beside each bar the rms [{unit}]: shorter is better.",
        [Key("box", colour, label) for label, colour in looks],
    )


def _bar_axes(
    rows: Sequence[tuple[str, Sequence[_Bar]]], top: float, room: float
) -> draw.Axes:
    """Horizontal bars below the name of their row, up to ``top``, words behind each."""
    count = max(len(bars) for _, bars in rows)
    step = 0.25
    (ax,) = draw.axes((0.24 + 0.13 * count) * len(rows) + 0.52, left=0.14)
    for row, (name, bars) in enumerate(rows):
        ax.text(
            0,
            row - 0.36,
            v.shorten(name, 40 if count > 1 else 52),
            va="center",
            ha="left",
        )
        for i, (pieces, words) in enumerate(bars):
            y = row + 0.045 * (count - 1) + step * (i - (count - 1) / 2)
            end = 0.0
            for length, colour in pieces:
                ax.barh(y, length, left=end, height=0.88 * step, color=colour)
                end += length
            if pieces:
                ax.text(end + 0.012 * top, y, words, va="center", ha="left", fontsize=8)
    ax.set_ylim(len(rows) - 0.6, -0.6)
    ax.set_xlim(0, room * top)
    ax.set_yticks([])
    ax.spines["left"].set_visible(False)
    return ax


def tracking_figure(
    joints: Sequence[str], result: Result, series: Series
) -> Figure | None:
    """Tracking error of each joint over time by model, before and after the arm changed."""
    t = series.get("tracking_t")
    units = v.records(result, "tracking", "before")
    if t is None or len(units) != len(joints):
        return None
    panels = []
    for k, joint in enumerate(joints):
        both = draw.axes(3.0, (1, 1), top=0.28, space=0.32)
        unit = f"m{v.text(units[k], 'unit')}"
        said = []
        for ax, (when, title, models) in zip(both, _FOLLOWED, strict=True):
            for model in models:
                error = v.curve(series, f"{when}_{model}", k, len(t))
                if error is None:
                    continue
                name, colour = _MODELS[model]
                draw.draw_curve(ax, t, [], 1e3 * error, color=colour, lw=0.9)
                rms = 1e3 * float(np.sqrt(np.mean(error**2)))
                said.append(f"{title}, {name}: rms {v.quantity(rms, unit)}")
            ax.set_title(title, fontsize=9, loc="left", color="#444444")
            draw.label_y(ax, f"error [{unit}]")
        draw.over_time(both[-1], t)
        panels.append(
            draw.panel(
                both[0], f"{joint}: tracking error over time; {'; '.join(said)}", joint
            )
        )
    caption = (
        "Desired less true position while each model gives the torque, in one and the same loop: "
        "torque that a model gets wrong, the loop makes up for by an error of position."
    )
    legend = [Key("line", colour, name) for name, colour in _MODELS.values()]
    return figure(panels, caption, legend)


def waterfall_figure(result: Result) -> Figure | None:
    """Hold-out error, relative to the given model, after each effect; small ones as one."""
    steps = []
    for row in v.records(result, "waterfall"):
        effect, where, joints = v.text(row, "label").partition(" at ")
        if (rms := v.real(row, "rms")) is not None:
            steps.append((v.plain(effect) + where + joints, rms))
    small = len(steps) - _STEPS
    if small > 1:
        merged = (f"+ {small} smaller causes", steps[-2][1])
        steps = [*steps[: _STEPS - 1], merged, steps[-1]]
    if len(steps) < 2:
        return None
    top = max(rms for _, rms in steps) or 1.0
    before = 0.0
    rows = []
    for k, (label, rms) in enumerate(steps):
        removed = [(before - rms, draw.LIGHT)] * (before > rms)
        bar = [(rms, draw.FITTED if k else draw.GIVEN), *removed]
        rows.append((label, [(bar, v.percent(rms, 3))]))
        before = rms
    ax = _bar_axes(rows, top, 1.27)
    ax.set_xlabel("error on the hold-out, share of the given model's")
    draw.few_ticks(ax.xaxis, 5)
    ax.set_xticks([x for x in ax.get_xticks() if 0 <= x <= top])
    draw.percent_x(ax)
    said = "; ".join(f"{label} {v.percent(rms, 3)}" for label, rms in steps)
    return draw.single(
        ax,
        f"error on the hold-out step by step: {said}",
        "Hold-out error after each effect that was added, every joint relative to the model as "
        "given: long grey pieces are effects that matter.",
        [
            Key("box", draw.GIVEN, "model as given"),
            Key("box", draw.FITTED, "what remains"),
            Key("box", draw.LIGHT, "removed by this effect"),
        ],
    )


def evidence_figure(
    index: int, finding: Result, series: Series, unit: str
) -> Figure | None:
    """Residual before an effect was added, over the quantity that shows it, and the fit."""
    x, residual, fit, rival = (
        v.curve(series, f"finding{index}_{key}")
        for key in ("x", "residual", "fit", "rival")
    )
    if x is None or residual is None or len(x) != len(residual):
        return None
    seen = np.isfinite(x) & np.isfinite(residual)
    if seen.sum() < 2:
        return None
    order = np.flatnonzero(seen)[np.argsort(x[seen], kind="stable")]
    fit, rival = (
        y if y is not None and len(y) == len(x) else None for y in (fit, rival)
    )
    x = x[order]
    residual = residual[order]
    effect = v.plain(v.text(finding, "effect"))
    x_label = v.text(finding, "figure", "x_label")
    x_label = x_label or "quantity that shows it"
    joint = v.text(finding, "figure", "joint")
    joint = joint or v.listing(v.words(finding, "joints"), "all joints")
    rivals = [v.plain(v.text(each, "effect")) for each in v.records(finding, "rivals")]
    (ax,) = draw.axes(2.6)
    binned = draw_points(ax, x, residual)
    legend = [Key("dot", draw.LIGHT, "residual before")]
    legend += [Key("dot", draw.MEASURED, "median in bins")] * binned
    caption = (
        f"What everything found leaves at {joint}, against {x_label}: medians that bend away "
        "from zero are what no candidate describes."
    )
    if fit is not None:
        _curve(ax, x, fit[order], color=draw.FITTED, lw=1.8)
        legend.append(Key("line", draw.FITTED, "fitted effect"))
        caption = (
            f"Residual at {joint} without {effect} but with all other findings, against {x_label}: "
            f"the fitted effect (blue) should run through the {'medians' if binned else 'points'}."
        )
    if rival is not None and rivals:
        _curve(ax, x, rival[order], color=draw.PURPLE, lw=1.5, ls=(0, (3, 2)))
        legend.append(
            Key("dash", draw.PURPLE, f"{rivals[0]} instead, fitted to these points")
        )
        caption += (
            f" Where the dashed curve of {rivals[0]} does too, these data cannot decide."
        ) * (fit is not None)
    ax.margins(0.04)
    draw.label_x(ax, x_label)
    draw.label_y(ax, v.text(finding, "figure", "y_label") or f"residual [{unit}]")
    label = f"{joint}: residual against {x_label}, with the fitted {effect}"
    return draw.single(ax, label, caption, legend, joint)


def draw_points(ax: draw.Axes, x: Array, y: Array) -> bool:
    """A cloud of points, thinned, and their medians in bins where there are enough of them."""
    seen = np.isfinite(x) & np.isfinite(y)
    order = np.flatnonzero(seen)[np.argsort(x[seen], kind="stable")]
    x = x[order]
    y = y[order]
    step = max(1, len(x) // _POINTS)
    binned = len(x) >= 4 * _MEDIANS
    # one small picture: thousands of points would make the page heavy
    ax.scatter(
        x[::step], y[::step], s=5, c="#9aa0a6", alpha=0.35, lw=0, rasterized=True
    )
    if binned:
        look: Any = {
            "ms": 4,
            "color": draw.MEASURED,
            "mec": "white",
            "mew": 0.7,
            "zorder": 4,
        }
        ax.plot(*_along(x, y, _MEDIANS), "o", **look)
    return binned


def _along(
    x: Array, y: Array, bins: int, fewest: int | None = None
) -> tuple[Array, Array]:
    """Median of y in equal bins of the sorted x, of few points in none; x and y when short."""
    if len(x) <= 2 * bins or x[-1] <= x[0]:
        return x, y
    lower, upper = np.quantile(x, [0.002, 0.998])
    if upper <= lower:
        lower = x[0]
        upper = x[-1]
    edges: npt.NDArray[np.intp] = np.searchsorted(
        x, np.linspace(lower, upper, bins + 1)
    )
    least = max(3, len(x) // (40 * bins)) if fewest is None else fewest
    pairs = [
        (np.median(x[first:last]), np.nanmedian(y[first:last]))
        for first, last in pairwise(edges)
        if last - first >= least and np.isfinite(y[first:last]).any()
    ]
    centres, medians = np.array(pairs, dtype=float).reshape(-1, 2).T
    return centres, medians


def _curve(ax: draw.Axes, x: Array, y: Array, **look: Any) -> None:
    along, height = _along(x, y, _CURVE, 1)
    gaps = np.flatnonzero(np.diff(along, prepend=along[:1]) > _WIDE * np.ptp(along))
    ax.plot(np.insert(along, gaps, np.nan), np.insert(height, gaps, np.nan), **look)
