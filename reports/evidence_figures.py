"""What shows an effect: the residual against the quantity that tells it."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes

from excitant.reports.drawing import (
    FITTED,
    LIGHT,
    MEASURED,
    PURPLE,
    axes,
    label_x,
    label_y,
    panel,
)
from excitant.reports.model import Figure, Key
from excitant.reports.reading import Result, Series, curve, records, text
from excitant.reports.wording import listing, number, plain
from excitant.robots.motion import Array

_POINTS = 2500
_MEDIANS = 24
_CURVE = 60
_GAP = 0.08  # of the abscissa: across wider stretches without data no curve is drawn


def evidence_figure(
    index: int, finding: Result, joints: list[str], series: Series, unit: str
) -> Figure | None:
    """Residual before an effect was added, in its telling domain, and the fitted effect."""
    x, residual = curve(series, f"finding{index}_x"), curve(series, f"finding{index}_residual")
    if x is None or residual is None or len(x) != len(residual):
        return None
    fit = curve(series, f"finding{index}_fit")
    fit = fit if fit is not None and len(fit) == len(x) else None
    seen = np.isfinite(x) & np.isfinite(residual)
    if seen.sum() < 2:
        return None
    order = np.flatnonzero(seen)[np.argsort(x[seen], kind="stable")]
    x, residual = x[order], residual[order]
    (ax,) = axes(2.6)
    _scatter(ax, x, residual)
    legend = [Key("dot", LIGHT, "residual before"), Key("dot", MEASURED, "median in bins")]
    shown = [residual]
    if fit is not None:
        shown.append(_curve(ax, x, fit[order], color=FITTED, lw=1.8))
        legend.append(Key("line", FITTED, "fitted effect"))
    rival = _rival(index, finding, series, order)
    if rival is not None:
        shown.append(_curve(ax, x, rival[0], color=PURPLE, lw=1.5, ls=(0, (3, 2))))
        legend.append(Key("dash", PURPLE, f"{rival[1]} instead, fitted to these points"))
    binned = len(x) >= 4 * _MEDIANS
    if binned:
        centres, medians = _along(x, residual, _MEDIANS)
        ax.plot(centres, medians, "o", ms=4, color=MEASURED, mec="white", mew=0.7)
    else:
        del legend[1]
    _limits(ax, x, np.concatenate(shown))
    effect = plain(text(finding, "effect"))
    x_label = text(finding, "figure", "x_label") or "telling quantity"
    label_x(ax, x_label)
    label_y(ax, text(finding, "figure", "y_label") or f"residual [{unit}]")
    joint = text(finding, "figure", "joint") or listing(joints, "all joints")
    rms = number(np.sqrt(np.mean(residual**2)))
    label = f"{joint}: residual (rms {rms} {unit}) against {x_label}, with the fitted {effect}"
    through = "medians" if binned else "points"
    caption = (
        f"What is left at {joint} without {effect}, all else that was found kept, against "
        f"{x_label}: the blue curve is the fitted effect, and should run through the {through}."
    )
    if rival is not None:
        caption += (
            f" Where the dashed curve of {rival[1]} runs there too, these data cannot decide."
        )
    if fit is None:
        caption = (
            f"What everything found leaves at {joint}, against {x_label}: medians that bend away "
            "from zero are what no candidate describes."
        )
    return Figure((panel(ax, label, joint),), caption, tuple(legend))


def _rival(
    index: int, finding: Result, series: Series, order: npt.NDArray[np.intp]
) -> tuple[Array, str] | None:
    """Torque of the first rival at the points shown, and its name."""
    values, rivals = curve(series, f"finding{index}_rival"), records(finding, "rivals")
    if values is None or not rivals or len(values) <= order.max():
        return None
    return values[order], plain(text(rivals[0], "effect"))


def _scatter(ax: Axes, x: Array, y: Array) -> None:
    """Points as one small picture; thousands of them would make the page heavy."""
    step = max(1, len(x) // _POINTS)
    ax.scatter(x[::step], y[::step], s=5, c="#9aa0a6", alpha=0.35, lw=0, rasterized=True)


def _along(x: Array, y: Array, bins: int, fewest: int | None = None) -> tuple[Array, Array]:
    """Median of y in equal bins of the sorted abscissa; the points themselves when few.

    Bins with fewer points than ``fewest`` are left out; by default, than make a steady median.
    """
    if len(x) <= 2 * bins or x[-1] <= x[0]:
        return x, y
    lower, upper = np.quantile(x, [0.002, 0.998])
    if upper <= lower:
        lower, upper = x[0], x[-1]
    edges = np.searchsorted(x, np.linspace(lower, upper, bins + 1))
    least = max(3, len(x) // (40 * bins)) if fewest is None else fewest
    pairs = [
        (np.median(x[first:last]), np.nanmedian(y[first:last]))
        for first, last in pairwise(edges)
        if last - first >= least and np.isfinite(y[first:last]).any()
    ]
    centres, medians = np.array(pairs, dtype=float).reshape(-1, 2).T
    return centres, medians


def _curve(ax: Axes, x: Array, y: Array, **look: Any) -> Array:
    """Draw a fitted effect along the abscissa; what of it is finite."""
    along, height = _along(x, y, _CURVE, 1)
    ax.plot(*_with_gaps(along, height), **look)
    return height[np.isfinite(height)]


def _with_gaps(x: Array, y: Array) -> tuple[Array, Array]:
    """A curve that is not drawn across what was not measured."""
    steps = np.diff(x, prepend=x[:1])
    gaps = np.flatnonzero(steps > _GAP * np.ptp(x))
    return np.insert(x, gaps, np.nan), np.insert(y, gaps, np.nan)


def _limits(ax: Axes, x: Array, y: Array) -> None:
    for values, setter in ((x, ax.set_xlim), (y, ax.set_ylim)):
        lower, upper = float(values.min()), float(values.max())
        margin = 0.04 * (upper - lower) or 1.0
        setter(lower - margin, upper + margin)
