"""What a designed motion makes visible, and how it was found."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from excitant.reports.drawing import (
    AMBER,
    FITTED,
    GIVEN,
    LIGHT,
    MEASURED,
    axes,
    label_y,
    log_y,
    panel,
    whole_ticks,
)
from excitant.reports.model import Figure, Key
from excitant.reports.reading import Series, curve, real, reals, records, text
from excitant.reports.wording import number
from excitant.robots.motion import Array

BEFORE_AFTER = (("initial", GIVEN, "start of the search"), ("final", FITTED, "designed motion"))


def spectrum_figure(series: Series) -> Figure | None:
    """Singular values of the observation matrix before and after the design, greatest first."""
    found = []
    for key, colour, name in BEFORE_AFTER:
        values = curve(series, f"eigenvalues_{key}")
        if values is not None and (values > 0).any():
            sizes = np.sqrt(np.sort(values[np.isfinite(values) & (values > 0)])[::-1])
            found.append((key, sizes, colour, name))
    if not found:
        return None
    (ax,) = axes(2.5)
    said, legend = [], []
    for key, sizes, colour, name in found:
        filled = key == "final"
        ax.plot(
            1 + np.arange(len(sizes)),
            sizes,
            "o",
            ms=3.6,
            mec=colour,
            mfc=colour if filled else "none",
            mew=0.9,
        )
        said.append(f"{name}: {len(sizes)} values, ratio {number(sizes[0] / sizes[-1])}")
        legend.append(Key("dot" if filled else "ring", colour, name))
    log_y(ax)
    ax.set_xlim(left=0)
    whole_ticks(ax)
    ax.set_xlabel("direction in parameter space, best seen first")
    label_y(ax, "singular value [N·m]")
    caption = (
        "Singular values of the observation matrix W/√n, the torque by which each direction of "
        "the base parameters shows: the design lifts the weakest, on the right, and the ratio of "
        "the first to the last is the condition number."
    )
    return Figure((panel(ax, f"singular values; {'; '.join(said)}"),), caption, tuple(legend))


def convergence_figure(result: Mapping[str, Any]) -> Figure | None:
    """Condition number over the iterations of each start; the best start stands out."""
    starts = [(row, reals(row, "history")) for row in records(result, "starts")]
    starts = [(row, h) for row, h in starts if np.isfinite(h).any() and len(h) > 1]
    if not starts:
        return None
    ends = [real(row, "condition_number") or float(h[np.isfinite(h)][-1]) for row, h in starts]
    best = int(np.argmin(ends))
    (ax,) = axes(2.3)
    for k, (_, history) in sorted(enumerate(starts), key=lambda pair: pair[0] == best):
        colour, width = (FITTED, 1.6) if k == best else (LIGHT, 1.0)
        ax.plot(np.arange(len(history)), history, color=colour, lw=width)
        last = int(np.flatnonzero(np.isfinite(history))[-1])
        ax.plot(last, history[last], "o", ms=3, color=colour)
    legend = [Key("line", FITTED, "best start")]
    if len(starts) > 1:
        legend.append(Key("line", LIGHT, "other starts"))
    bound = real(result, "condition_number", "lower_bound")
    if bound is not None and bound > 0:
        ax.axhline(bound, color=AMBER, lw=1.2, ls=(0, (4, 3)))
        legend.append(Key("dash", AMBER, "proven lower bound"))
    positive: Array = np.concatenate([h[np.isfinite(h)] for _, h in starts])
    if positive.min() > 0 and positive.max() > 8 * positive.min():
        log_y(ax)
    ax.set_xlim(left=0)
    whole_ticks(ax)
    ax.set_xlabel("iteration")
    label_y(ax, "condition number [–]")
    label = (
        f"condition number over iterations of {len(starts)} starts; "
        f"best ends at {number(ends[best])}"
    )
    caption = (
        "Each start of the optimisation, a dot where it ended: several that end at the same height "
        "suggest that a much better motion does not exist."
    )
    cut = sum(text(row, "status").replace("_", " ") == "time limit" for row, _ in starts)
    if cut:
        caption += f" The time limit ended {cut} of these {len(starts)}: more time may find better."
    return Figure((panel(ax, label),), caption, tuple(legend))


def singular_value_figure(series: Series) -> Figure | None:
    """Singular values of the observation matrix, greatest first."""
    values = curve(series, "singular_values")
    values = None if values is None else values[np.isfinite(values) & (values > 0)]
    if values is None or not len(values):
        return None
    ordered = np.sort(values)[::-1]
    (ax,) = axes(2.3)
    ax.plot(1 + np.arange(len(ordered)), ordered, "o", ms=3.6, color=MEASURED)
    log_y(ax)
    ax.set_xlabel("direction in parameter space, best seen first")
    label_y(ax, "singular value [–]")
    label = f"{len(ordered)} singular values from {number(ordered[0])} to {number(ordered[-1])}"
    caption = (
        "Singular values of the normalised observation matrix: directions far below the others "
        "are hardly seen in this motion, and their estimates are uncertain."
    )
    return Figure((panel(ax, label),), caption)
