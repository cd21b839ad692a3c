"""The designed motion against its limits, what it makes visible, and how it was found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.ticker import FixedLocator

from excitant.reports.drawing import (
    AMBER,
    FITTED,
    GIVEN,
    GREEN,
    LIGHT,
    MEASURED,
    PURPLE,
    axes,
    draw_curve,
    label_y,
    log_y,
    panel,
    timeline,
)
from excitant.reports.model import Figure, Key, Panel
from excitant.reports.reading import Result, Series, at, curve, real, reals, records, times
from excitant.reports.wording import number, percent
from excitant.robots.motion import Array

_CURVES = (
    ("position", "q", FITTED),
    ("velocity", "dq", GREEN),
    ("acceleration", "ddq", PURPLE),
    ("torque", "tau", GIVEN),
)


def motion_figure(joints: Sequence[str], result: Result, series: Series) -> Figure | None:
    """Position, velocity, acceleration and torque of each joint as fractions of their limits."""
    panels = [_motion_panel(k, joint, result, series) for k, joint in enumerate(joints)]
    present = tuple(each for each in panels if each is not None)
    if not present:
        return _plain_motion_figure(joints, series)
    known = [row for row in _CURVES if _any_limit(result, row[0], len(joints))]
    return Figure(
        present,
        "Each quantity as a fraction of its limit (a position between its two limits, −1 to 1); "
        "the grey lines at ±1 are the limits: curves that come close to them use what the arm "
        "can do, none may cross.",
        tuple(Key("line", colour, name) for name, _, colour in known),
    )


def _any_limit(result: Result, name: str, count: int) -> bool:
    return any(limit_of(result, name, k) is not None for k in range(count))


def limit_of(result: Result, name: str, joint: int) -> tuple[float, float] | None:
    """Lower and upper limit of a quantity of a joint, or None where it has none."""
    values = at(result, "limit_values", name)
    value = values[joint] if isinstance(values, list) and joint < len(values) else None
    if isinstance(value, list) and len(value) == 2:
        lower, upper = real(value[0]), real(value[1])
    else:
        upper = real(value)
        lower = None if upper is None else -upper
    return None if lower is None or upper is None or lower >= upper else (lower, upper)


def _motion_panel(k: int, joint: str, result: Result, series: Series) -> Panel | None:
    t = times(series)
    if t is None:
        return None
    time, joins = timeline(t)
    (ax,) = axes(1.85)
    said = []
    for name, key, colour in _CURVES:
        values, limits = curve(series, key, k), limit_of(result, name, k)
        if values is None or limits is None or len(values) != len(t):
            continue
        centre, half = (limits[0] + limits[1]) / 2, (limits[1] - limits[0]) / 2
        fraction = (values - centre) / half
        draw_curve(ax, time, joins, fraction, color=colour, lw=1.0)
        said.append(f"{name} {percent(np.nanmax(np.abs(fraction)))}")
    if not said:
        return None
    for limit in (-1, 1):
        ax.axhline(limit, color="#8a8f94", lw=1.0, ls=(0, (4, 3)))
    reach = max(1.15, *(float(np.nanmax(np.abs(line.get_ydata()))) for line in ax.lines))
    ax.set_ylim(-1.02 * reach, 1.02 * reach)
    ax.yaxis.set_major_locator(FixedLocator([-1, -0.5, 0, 0.5, 1]))
    ax.set_xlim(time[0], time[-1])
    ax.set_xlabel("time [s]")
    label_y(ax, "fraction of limit [–]")
    return panel(ax, f"{joint} over time, largest share of its limit: {', '.join(said)}", joint)


def _plain_motion_figure(joints: Sequence[str], series: Series) -> Figure | None:
    t = times(series)
    if t is None:
        return None
    time, joins = timeline(t)
    panels = []
    for k, joint in enumerate(joints):
        values = curve(series, "q", k)
        if values is None or len(values) != len(t):
            continue
        (ax,) = axes(1.85)
        draw_curve(ax, time, joins, values, color=FITTED)
        ax.set_xlim(time[0], time[-1])
        ax.set_xlabel("time [s]")
        label_y(ax, "position [rad]")
        panels.append(panel(ax, f"{joint}: position over time", joint))
    caption = "Joint positions over the designed motion; the arm has no limits to compare with."
    return Figure(tuple(panels), caption) if panels else None


def eigenvalue_figure(series: Series) -> Figure | None:
    """Eigenvalues of the information before and after the design, greatest first."""
    found = [
        (key, curve(series, f"eigenvalues_{key}"), colour, mark)
        for key, colour, mark in (("initial", GIVEN, "o"), ("final", FITTED, "o"))
    ]
    found = [(k, v[np.isfinite(v) & (v > 0)], c, m) for k, v, c, m in found if v is not None]
    found = [row for row in found if row[1] is not None and len(row[1])]
    if not found:
        return None
    (ax,) = axes(2.3)
    said, legend = [], []
    for key, values, colour, mark in found:
        assert values is not None
        ordered = np.sort(values)[::-1]
        face = colour if key == "final" else "none"
        ax.plot(1 + np.arange(len(ordered)), ordered, mark, ms=3.6, mec=colour, mfc=face, mew=0.9)
        spread = number(ordered[0] / ordered[-1])
        said.append(f"{key}: {len(ordered)} values, greatest over smallest {spread}")
        name = "start" if key == "initial" else "designed motion"
        legend.append(Key("dot" if key == "final" else "ring", colour, name))
    log_y(ax)
    ax.set_xlabel("direction in parameter space, best seen first")
    label_y(ax, "eigenvalue [–]")
    caption = (
        "How strongly the motion shows each direction of the base parameters (eigenvalues of the "
        "normalised information): the design lifts the weakest ones on the right."
    )
    return Figure((panel(ax, f"eigenvalues; {'; '.join(said)}"),), caption, tuple(legend))


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
    ax.set_xlabel("iteration")
    label_y(ax, "condition number [–]")
    label = (
        f"condition number over iterations of {len(starts)} starts; "
        f"best ends at {number(ends[best])}"
    )
    caption = (
        "Each start of the optimisation; several that end at the same height suggest that no much "
        "better motion exists."
    )
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
