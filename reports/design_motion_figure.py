"""The motion of every joint in its own units, against its limits and what is certified."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from excitant.reports.drawing import (
    FITTED,
    GIVEN,
    GREEN,
    MEASURED,
    PURPLE,
    SKY,
    axes,
    draw_curve,
    ink,
    panel,
    timeline,
)
from excitant.reports.model import Figure, Key, Panel
from excitant.reports.reading import Result, Series, at, curve, items, real, times
from excitant.reports.wording import number, percent, shorten
from excitant.robots.motion import Array

_CURVES = (
    ("position", "q", FITTED, ("rad", "m")),
    ("velocity", "dq", GREEN, ("rad/s", "m/s")),
    ("acceleration", "ddq", PURPLE, ("rad/s²", "m/s²")),
    ("jerk", "dddq", SKY, ("rad/s³", "m/s³")),
    ("torque", "tau", GIVEN, ("N·m", "N")),
)
_ROW, _ABOVE, _BELOW = 0.56, 0.22, 0.42  # inch: curve, its heading, the time axis
_NEAR = 0.15  # share of a limit from which on the limit is drawn in

_CERTIFIED = (
    "Every joint's motion in its own units: each curve touches the edge of its shaded band at "
    "the marked instant and never leaves it, between samples too, and a limit holds where "
    "the band ends inside the dashed lines (a limit far outside is only written)."
)
_SAMPLED = (
    "Every joint's motion in its own units: shaded bands, which the motion never leaves, between "
    "samples too, stand at the joint that comes closest to a limit; other shares are those of "
    "the samples drawn."
)


@dataclass(frozen=True)
class Envelope:
    """What a quantity of a joint provably stays within over the continuous motion.

    Attributes:
        low: Least value, in the quantity's unit.
        high: Greatest value.
        ratio: Largest magnitude over its limit.
        t: When it occurs [s].
    """

    low: float
    high: float
    ratio: float
    t: float | None


def envelope_of(result: Result, name: str, joint: int) -> Envelope | None:
    """The certified envelope of a quantity of a joint, or None where there is no limit."""
    rows, limits = at(result, "certified", name), limit_of(result, name, joint)
    row = rows[joint] if isinstance(rows, list) and joint < len(rows) else None
    if row is None and _is_worst(result, name, joint):
        row = {"ratio": at(result, "limits", name), "t": at(result, "worst", name, "t")}
    low, high, ratio = (real(row, key) for key in ("low", "high", "ratio"))
    if ratio is None:
        return None
    if (low is None or high is None) and limits is not None:
        centre, half = (limits[0] + limits[1]) / 2, (limits[1] - limits[0]) / 2
        low, high = centre - ratio * half, centre + ratio * half
    return None if low is None or high is None else Envelope(low, high, ratio, real(row, "t"))


def _is_worst(result: Result, name: str, joint: int) -> bool:
    names, where = items(result, "joints"), at(result, "worst", name, "joint")
    return joint < len(names) and where in (names[joint], joint)


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


def share_of_limit(ratio: float) -> str:
    """A share of a limit as a percentage, near the limit to a hundredth."""
    return percent(ratio, 3 if abs(ratio - 1) > 5e-3 else 4)


def motion_figure(joints: Sequence[str], result: Result, series: Series) -> Figure | None:
    """Position, velocity, acceleration, jerk and torque of each joint against their limits."""
    rows = [row for row in _CURVES if any(_has(series, row[1], k) for k in range(len(joints)))]
    panels = [_panel(k, joint, rows, result, series) for k, joint in enumerate(joints)]
    present = tuple(each for each in panels if each is not None)
    if not present:
        return None
    known = [row[0] for row in rows if any(limit_of(result, row[0], k) for k in range(len(joints)))]
    if not known:
        caption = "The motion of every joint; the arm has no limits to compare it with."
        return Figure(present, caption)
    caption = _CERTIFIED if at(result, "certified") else _SAMPLED
    legend = (
        Key("dash", MEASURED, "limit"),
        Key("box", "#cfe3f1", "certified envelope"),
        Key("ring", MEASURED, "where it is touched"),
    )
    return Figure(present, caption, legend)


def _has(series: Series, key: str, joint: int) -> bool:
    t, values = times(series), curve(series, key, joint)
    return t is not None and values is not None and len(values) == len(t)


def _panel(
    k: int,
    joint: str,
    rows: Sequence[tuple[str, str, str, tuple[str, str]]],
    result: Result,
    series: Series,
) -> Panel | None:
    """The curves of one joint one above the other."""
    t = times(series)
    if t is None or not any(_has(series, row[1], k) for row in rows):
        return None
    time, joins = timeline(t)
    height = len(rows) * (_ROW + _ABOVE) + _BELOW
    stack = axes(height, [1.0] * len(rows), top=_ABOVE, space=_ABOVE / _ROW)
    turns = items(result, "revolute")
    slides = k < len(turns) and turns[k] is False
    said = []
    for ax, (name, key, colour, units) in zip(stack, rows, strict=True):
        ax.set_title(
            f"{name} [{units[slides]}]", loc="left", fontsize=8.5, pad=2.5, color=ink(colour)
        )
        values = curve(series, key, k) if _has(series, key, k) else None
        if values is None:
            ax.set_yticks([])
            continue
        draw_curve(ax, time, joins, values, color=colour, lw=1.1)
        remark = _against(ax, time, t, values, colour, result, name, k)
        ax.set_title(remark, loc="right", fontsize=8.5, pad=2.5, color="#5a626a")
        said.append(f"{name} {remark}")
        ax.yaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 2.5, 5, 10]))
    stack[-1].set_xlim(time[0], time[-1])
    stack[-1].set_xlabel("time [s]")
    return panel(stack[0], f"{joint} over time: {', '.join(said)}", shorten(joint, 60))


def _against(
    ax: Axes,
    time: Array,
    t: Array,
    values: Array,
    colour: str,
    result: Result,
    name: str,
    joint: int,
) -> str:
    """Limit lines, certified band and its point of contact; what they say in words."""
    limits, within = limit_of(result, name, joint), envelope_of(result, name, joint)
    lowest, highest = float(np.nanmin(values)), float(np.nanmax(values))
    if within is not None:
        ax.axhspan(within.low, within.high, color=colour, alpha=0.11, lw=0)
        lowest, highest = min(lowest, within.low), max(highest, within.high)
        _mark_contact(ax, time, t, values, colour, within)
    far = False
    if limits is not None:
        centre, half = (limits[0] + limits[1]) / 2, (limits[1] - limits[0]) / 2
        far = max(abs(lowest - centre), abs(highest - centre)) < _NEAR * half
        if not far:
            for limit in limits:
                ax.axhline(limit, color=MEASURED, lw=1.0, ls=(0, (4, 3)))
            lowest, highest = min(lowest, limits[0]), max(highest, limits[1])
    pad = 0.1 * max(highest - lowest, 1e-9)
    ax.set_ylim(lowest - pad, highest + pad)
    return _remark(limits, within, values, far)


def _mark_contact(
    ax: Axes, time: Array, t: Array, values: Array, colour: str, within: Envelope
) -> None:
    if within.t is None:
        return
    nearest = int(np.abs(t - within.t).argmin())
    up = abs(values[nearest] - within.high) <= abs(values[nearest] - within.low)
    ax.plot(
        time[nearest] + within.t - t[nearest],
        within.high if up else within.low,
        "o",
        ms=5.5,
        mfc="none",
        mec=colour,
        mew=1.2,
    )


def _remark(
    limits: tuple[float, float] | None, within: Envelope | None, values: Array, far: bool
) -> str:
    if within is not None:
        ratio = within.ratio
    elif limits is not None:
        centre, half = (limits[0] + limits[1]) / 2, (limits[1] - limits[0]) / 2
        ratio = float(np.nanmax(np.abs(values - centre))) / half
    else:
        return "no limit"
    share = share_of_limit(ratio)
    if not far or limits is None:
        return f"{share} of limit"
    low, high = (number(limit) for limit in limits)
    return f"{share} of limit {f'±{high}' if limits[0] == -limits[1] else f'{low} to {high}'}"
