"""95 % intervals as a band around a curve, and what the hold-out says of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from excitant.reports.model import Cell, Notes, Table, table
from excitant.reports.reading import Result, Series, at, curve, real, records, text, words
from excitant.reports.wording import number, percent
from excitant.robots.motion import Array

BAND = "#c3dcec"
MEANING = "95\u00a0% interval of a reading"
BAND_CAPTION = (
    "The band is where 95\u00a0% of readings lie if noise and parameters are all that is off."
)
_BINS = 120


def half_width(series: Series, key: str, joint: int, n: int) -> Array | None:
    """Half width of one joint's intervals at n instants; None where a run has none."""
    found = curve(series, key, joint)
    return found if found is not None and len(found) == n and np.isfinite(found).all() else None


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
        low, high = np.append(low, low[-1]), np.append(high, high[-1])
        ax.fill_between(x, low, high, color=BAND, lw=0, zorder=0.5)


def interval_table(result: Result, unit: str) -> Table | None:
    """Width and coverage of the intervals per joint; None where a run has none."""
    rows: list[list[Cell | str]] = [
        [
            text(row, "name"),
            number(at(row, "validate", "interval95", "half_width")),
            number(at(row, "validate", "interval95", "half_width_parameters")),
            percent(at(row, "validate", "interval95", "coverage")),
        ]
        for row in records(result, "joints")
        if real(row, "validate", "interval95", "half_width") is not None
    ]
    if not rows:
        return None
    return table(
        f"name:Joint | number:95\u00a0% interval of a reading, ± [{unit}] | "
        f"number:of which by the parameters, ± [{unit}] | number:Hold-out inside",
        rows,
        "What the fitted data say a new reading may be off, parameters and coloured noise counted; "
        "far less than 95\u00a0% of the hold-out inside means that the model misses something.",
    )


def essential_line(result: Result) -> Notes | None:
    """How many base parameters would do; None where that was not asked."""
    kept, dropped = words(result, "essential", "kept"), words(result, "essential", "dropped")
    if not kept and not dropped:
        return None
    few, every = (real(result, "essential", key) for key in ("nrmse_essential", "nrmse_all"))
    return Notes(
        (
            f"{len(kept)} of {len(kept) + len(dropped)} base parameters are essential: with the "
            f"others at zero, least squares misses {percent(few)} of the hold-out instead of "
            f"{percent(every)} (median over joints).",
        )
    )
