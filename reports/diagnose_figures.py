"""Where the given model's error shows, what shows an effect, and what each effect takes away."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from excitant.reports import drawing as draw
from excitant.reports import values as v
from excitant.reports.page import Figure, Key, Panel
from excitant.reports.torque_figures import bar_axes
from excitant.reports.values import Result, Series
from excitant.robots.motion import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_DOMAINS = ("constant", "direction", "velocity", "position", "load", "reversal", "time")
_BANDS = ("slower", "motion", "faster")
_ROW, _GAP = 0.29, 0.35  # inch, cells
_LEFT, _TOP, _BELOW, _LEAST = 1.3, 0.64, 0.06, 0.4  # inch
_DARK = 0.55  # share from which on letters are white
_STEPS = 12  # of the waterfall that are drawn one by one
_POINTS = 2500
_MEDIANS = 24
_CURVE = 60
_WIDE = 0.08  # of the abscissa: across wider stretches without data no curve is drawn


def share_figure(result: Result, unit: str, changed: bool = True) -> Figure | None:
    """Joints by quantities: share of the squared error, as given and left over.

    Args:
        result: Of a diagnosis.
        unit: Of the torque.
        changed: Whether the extended model differs; else only the given one is shown.
    """
    joints = v.records(result, "error", "joints")
    if not joints:
        return None
    panels = [_shares(joints, False, "model as given", unit)]
    if changed:
        panels.append(_shares(joints, True, "left by the extended model", unit))
    said = "Orange: model as given; blue: after the findings are added. " if changed else ""
    caption = (
        "Percentage of each joint's squared error that goes with one quantity alone; the simplest "
        "that explains it is framed: an offset, the direction of motion (dry friction), velocity "
        "(viscous friction), position (springs, ripple), load (gain, load-dependent friction), "
        "distance since the last reversal (hysteresis, backlash) or time (drift). Shares overlap. "
        "The last three columns divide the error by frequency: slower than the motion, as fast, "
        f"faster. A dash: not judged. {said}The rms stands beside each row, over rows at which the "
        "joint moves."
    )
    return Figure(tuple(panels), caption)


def _shares(joints: list[Result], left: bool, title: str, unit: str) -> Panel:
    names, count = (*_DOMAINS, *_BANDS), len(joints)
    height = max(_ROW * count, _LEAST) + _TOP + _BELOW
    (ax,) = draw.axes(height, left=_LEFT, top=_TOP)
    box = ax.get_position()
    rows = _ROW * count / height
    ax.set_position((box.x0, 1 - _TOP / height - rows, box.width, rows))
    ax.grid(False)
    for side in ax.spines.values():
        side.set_visible(False)
    for row, joint in enumerate(joints):
        source = v.at(joint, "left") if left else joint
        rms, before = v.real(source, "rms"), v.real(joint, "rms")
        size = v.quantity(rms, unit, 2)
        if left and before and rms is not None:
            size += f", {v.percent(rms / before)} of it"
        said = f"{v.shorten(v.text(joint, 'name'), 20)}\n{size}"
        ax.text(-0.15, row + 0.5, said, ha="right", va="center", fontsize=7.2, linespacing=1.05)
        for column, name in enumerate(names):
            group = "shares" if name in _DOMAINS else "bands"
            colour, framed = draw.FITTED if left else draw.GIVEN, name == v.text(source, "telling")
            _cell(ax, _at(column), row, v.real(source, group, name), colour, framed)
    for column, name in enumerate(names):
        ax.text(_at(column) + 0.35, -0.12, name, rotation=50, ha="left", va="bottom", fontsize=7.5)
    ax.set_xlim(0, _at(len(names) - 1) + 1)
    ax.set_ylim(count, 0)
    ax.set_xticks([])
    ax.set_yticks([])
    worst = "; ".join(f"{v.text(j, 'name')} by {v.text(j, 'telling') or 'unknown'}" for j in joints)
    return draw.panel(ax, f"share of the squared error by quantity, {title}: {worst}", title)


def _at(column: int) -> float:
    return column + (_GAP if column >= len(_DOMAINS) else 0.0)


def _cell(ax: Axes, x: float, row: int, share: float | None, colour: str, framed: bool) -> None:
    """One share as a box of a shade, framed where it is the one to look at."""
    from matplotlib.colors import to_rgb
    from matplotlib.patches import Rectangle

    depth = min(max(share or 0.0, 0.0), 1.0)
    shade = [1 - depth * (1 - part) for part in to_rgb(colour)]
    frame: Any = (
        {"ec": "#222222", "lw": 1.5, "zorder": 3} if framed else {"ec": "#d8dadd", "lw": 0.5}
    )
    ax.add_patch(Rectangle((x + 0.03, row + 0.05), 0.94, 0.9, fc=shade, **{"zorder": 2, **frame}))
    said = "–" if share is None else f"{100 * share:.0f}" if share < 9.995 else ">999"
    ink, weight = "white" if depth > _DARK else "#222222", "bold" if framed else "normal"
    look: Any = {"ha": "center", "va": "center", "fontsize": 7, "zorder": 4}
    ax.text(x + 0.5, row + 0.52, said, color=ink, fontweight=weight, **look)


def waterfall_figure(result: Result) -> Figure | None:
    """Hold-out error, relative to the model as given, after each effect that was added.

    The smaller effects at the end are one step.
    """
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
    (ax,) = draw.axes(0.44 * len(steps) + 0.52, left=0.14)
    before = 0.0
    for row_, (label, rms) in enumerate(steps):
        end = max(rms, before)
        ax.text(0, row_ - 0.3, v.shorten(label, 52), va="center", ha="left")
        ax.barh(row_ + 0.06, rms, height=0.26, color=draw.FITTED if row_ else draw.GIVEN)
        if end > rms:
            ax.barh(row_ + 0.06, end - rms, left=rms, height=0.26, color=draw.LIGHT)
        ax.text(end + 0.012 * top, row_ + 0.06, v.percent(rms, 3), va="center", fontsize=8)
        before = rms
    bar_axes(ax, len(steps) - 0.65, 1.27 * top)
    ax.set_xlabel("error on the hold-out, share of the given model's")
    draw.few_ticks(ax.xaxis, 5)
    ax.set_xticks([x for x in ax.get_xticks() if 0 <= x <= top])
    draw.percent_x(ax)
    said = "; ".join(f"{label} {v.percent(rms, 3)}" for label, rms in steps)
    return Figure(
        (draw.panel(ax, f"error on the hold-out step by step: {said}"),),
        "Error on the hold-out after each effect that was added, every joint relative to the "
        "model as given: long grey pieces are effects that matter.",
        (
            Key("box", draw.GIVEN, "model as given"),
            Key("box", draw.FITTED, "what remains"),
            Key("box", draw.LIGHT, "removed by this effect"),
        ),
    )


def evidence_figure(index: int, finding: Result, series: Series, unit: str) -> Figure | None:
    """Residual before an effect was added, over the quantity that shows it, and the fit."""
    x, residual, fit, rival = (
        v.curve(series, f"finding{index}_{key}") for key in ("x", "residual", "fit", "rival")
    )
    if x is None or residual is None or len(x) != len(residual):
        return None
    seen = np.isfinite(x) & np.isfinite(residual)
    if seen.sum() < 2:
        return None
    order = np.flatnonzero(seen)[np.argsort(x[seen], kind="stable")]
    fit, rival = (y if y is not None and len(y) == len(x) else None for y in (fit, rival))
    x, residual = x[order], residual[order]
    rivals = [v.plain(v.text(each, "effect")) for each in v.records(finding, "rivals")]
    (ax,) = draw.axes(2.6)
    step = max(1, len(x) // _POINTS)
    # one small picture: thousands of points would make the page heavy
    ax.scatter(x[::step], residual[::step], s=5, c="#9aa0a6", alpha=0.35, lw=0, rasterized=True)
    legend = [Key("dot", draw.LIGHT, "residual before")]
    binned = len(x) >= 4 * _MEDIANS
    if binned:
        legend.append(Key("dot", draw.MEASURED, "median in bins"))
    if fit is not None:
        _curve(ax, x, fit[order], color=draw.FITTED, lw=1.8)
        legend.append(Key("line", draw.FITTED, "fitted effect"))
    if rival is not None and rivals:
        _curve(ax, x, rival[order], color=draw.PURPLE, lw=1.5, ls=(0, (3, 2)))
        legend.append(Key("dash", draw.PURPLE, f"{rivals[0]} instead, fitted to these points"))
    if binned:
        ax.plot(
            *_along(x, residual, _MEDIANS), "o", ms=4, color=draw.MEASURED, mec="white", mew=0.7
        )
    ax.margins(0.04)
    effect, x_label = v.plain(v.text(finding, "effect")), v.text(finding, "figure", "x_label")
    x_label = x_label or "quantity that shows it"
    draw.label_x(ax, x_label)
    draw.label_y(ax, v.text(finding, "figure", "y_label") or f"residual [{unit}]")
    joint = v.text(finding, "figure", "joint") or v.listing(
        v.words(finding, "joints"), "all joints"
    )
    rms = v.number(np.sqrt(np.mean(residual**2)))
    caption = (
        f"Residual at {joint} without {effect}, everything else that was found being kept, against "
        f"{x_label}: the blue curve is the fitted effect, and should run through the "
        f"{'medians' if binned else 'points'}."
    )
    if rival is not None and rivals:
        caption += (
            f" Where the dashed curve of {rivals[0]} runs there too, these data cannot decide."
        )
    if fit is None:
        caption = (
            f"What everything found leaves at {joint}, against {x_label}: medians that bend away "
            "from zero are what no candidate describes."
        )
    label = f"{joint}: residual (rms {rms} {unit}) against {x_label}, with the fitted {effect}"
    return Figure((draw.panel(ax, label, joint),), caption, tuple(legend))


def _along(x: Array, y: Array, bins: int, fewest: int | None = None) -> tuple[Array, Array]:
    """Median of y in equal bins of the sorted abscissa; the points themselves when few.

    Bins with fewer points than ``fewest`` are left out; by default, than make a steady median.
    """
    if len(x) <= 2 * bins or x[-1] <= x[0]:
        return x, y
    lower, upper = np.quantile(x, [0.002, 0.998])
    if upper <= lower:
        lower, upper = x[0], x[-1]
    edges: npt.NDArray[np.intp] = np.searchsorted(x, np.linspace(lower, upper, bins + 1))
    least = max(3, len(x) // (40 * bins)) if fewest is None else fewest
    pairs = [
        (np.median(x[first:last]), np.nanmedian(y[first:last]))
        for first, last in pairwise(edges)
        if last - first >= least and np.isfinite(y[first:last]).any()
    ]
    centres, medians = np.array(pairs, dtype=float).reshape(-1, 2).T
    return centres, medians


def _curve(ax: Axes, x: Array, y: Array, **look: Any) -> None:
    """Draw a fitted effect along the abscissa, broken where nothing was measured."""
    along, height = _along(x, y, _CURVE, 1)
    gaps = np.flatnonzero(np.diff(along, prepend=along[:1]) > _WIDE * np.ptp(along))
    ax.plot(np.insert(along, gaps, np.nan), np.insert(height, gaps, np.nan), **look)
