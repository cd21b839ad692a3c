"""A motion against its limits, joint by joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from excitant.reports import figure as fig
from excitant.reports import values as v
from excitant.reports.figure import (
    Axes,
    Axis,
    Figure,
    Key,
    Line,
    Mark,
    Panel,
    Points,
    Timeline,
)
from excitant.reports.values import Result, Series
from excitant.robots.motion import Array


@dataclass(frozen=True)
class _Quantity:
    """A curve of every joint: its series, its colour, and its unit if the joint turns or slides."""

    name: str
    key: str
    colour: str
    angular: str
    linear: str


_QUANTITIES = (
    _Quantity("position", "q", fig.FITTED, "rad", "m"),
    _Quantity("velocity", "dq", fig.GREEN, "rad/s", "m/s"),
    _Quantity("acceleration", "ddq", fig.PURPLE, "rad/s²", "m/s²"),
    _Quantity("jerk", "dddq", fig.SKY, "rad/s³", "m/s³"),
    _Quantity("torque", "tau", fig.GIVEN, "N·m", "N"),
)
_HEIGHT = 70  # px of a curve
_BELOW = 28  # px of the time axis
_NEAR = 0.15  # share of a limit from which on the limit is drawn in

_CERTIFIED = (
    "Every joint's motion in its own units. The shaded band bounds the continuous motion, which "
    "touches it at the marked instant; a limit holds where the band ends inside the dashed lines "
    "(a limit far outside is only written)."
)
_SAMPLED = (
    "Every joint's motion in its own units, and the largest share of each limit over the samples "
    "drawn (a limit far outside is only written)."
)


def envelope_of(
    result: Result, name: str, joint: int
) -> tuple[float, float, float, float] | None:
    """Proven bounds of a joint's quantity: least, greatest, ratio to limit, when."""
    rows = v.at(result, "certified", name)
    row = rows[joint] if isinstance(rows, list) and joint < len(rows) else None
    low, high, ratio, t = (v.real(row, key) for key in ("low", "high", "ratio", "t"))
    if low is None or high is None or ratio is None or t is None:
        return None
    return low, high, ratio, t


def _limit_of(result: Result, name: str, joint: int) -> tuple[float, float] | None:
    values = v.at(result, "limit_values", name)
    value = values[joint] if isinstance(values, list) and joint < len(values) else None
    low, high = value if isinstance(value, list) and len(value) == 2 else (None, value)
    upper = v.real(high)
    lower = v.real(low) if isinstance(value, list) or upper is None else -upper
    return None if lower is None or upper is None or lower >= upper else (lower, upper)


def share_of_limit(ratio: object) -> str:
    """A share of a limit as a percentage, near the limit to a hundredth."""
    near = abs((v.real(ratio) or 0.0) - 1) <= 5e-3
    return v.percent(ratio, 4 if near else 3)


def motion_figure(
    joints: Sequence[str], result: Result, series: Series
) -> Figure | None:
    """Position, velocity, acceleration, jerk and torque of each joint against their limits."""
    t = v.times(series)
    if t is None:
        return None
    curves = [_curves_of(k, series, len(t)) for k in range(len(joints))]
    rows = [row for row in _QUANTITIES if any(row.name in joint for joint in curves)]
    panels = [
        _panel(k, joint, rows, curves[k], t, result)
        for k, joint in enumerate(joints)
        if curves[k]
    ]
    every = [(row.name, k) for row in rows for k in range(len(joints))]
    if not any(_limit_of(result, name, k) for name, k in every):
        caption = "The motion of every joint; the arm has no limits to compare it with."
        return fig.figure(panels, caption)
    legend = [Key("dash", fig.MEASURED, "limit")]
    caption = _SAMPLED
    if v.at(result, "certified"):
        caption = _CERTIFIED
        legend.append(Key("box", fig.BAND, "certified envelope"))
        legend.append(Key("ring", fig.MEASURED, "where it is touched"))
    return fig.figure(panels, caption, legend)


def _curves_of(joint: int, series: Series, rows: int) -> dict[str, Array]:
    curves = {row.name: v.curve(series, row.key, joint, rows) for row in _QUANTITIES}
    return {name: values for name, values in curves.items() if values is not None}


def _panel(
    k: int,
    joint: str,
    rows: Sequence[_Quantity],
    curves: dict[str, Array],
    t: Array,
    result: Result,
) -> Panel:
    timeline = Timeline.of(t)
    turns = v.items(result, "revolute")
    slides = k < len(turns) and turns[k] is False
    stack = []
    remarks = []
    for row in rows:
        title = f"{row.name} [{row.linear if slides else row.angular}]"
        marks: list[Mark] = []
        remark = ""
        if row.name in curves:
            y = curves[row.name]
            curve = Line(timeline.t, timeline.broken(y), row.colour, row.name)
            context, remark = _context(timeline, t, y, row, result, k)
            marks = [*context, curve]
            remarks.append(f"{row.name} {remark}")
        last = row is rows[-1]
        abscissa = timeline.axis("time [s]" if last else "")
        height = _HEIGHT + _BELOW * last
        axes = Axes(tuple(marks), abscissa, Axis(), height, title, remark, row.colour)
        stack.append(axes)
    label = f"{joint} over time: {', '.join(remarks)}"
    return Panel(tuple(stack), label, v.shorten(joint, 60))


def _context(
    timeline: Timeline,
    t: Array,
    y: Array,
    quantity: _Quantity,
    result: Result,
    joint: int,
) -> tuple[list[Mark], str]:
    """Envelope and limits of a curve, and in words how near it comes to its limit."""
    limits = _limit_of(result, quantity.name, joint)
    envelope = envelope_of(result, quantity.name, joint)
    lowest = float(np.nanmin(y))
    highest = float(np.nanmax(y))
    marks: list[Mark] = []
    ratio = None
    if envelope is not None:
        low, high, ratio, when = envelope
        marks.append(fig.Span(low, high, quantity.colour))
        lowest = min(lowest, low)
        highest = max(highest, high)
        near = int(np.abs(t - when).argmin())
        touched = low if abs(y[near] - low) < abs(y[near] - high) else high
        at = np.array([when + timeline.t[0] - t[0]])
        edge = np.array([touched])
        marks.append(Points(at, edge, quantity.colour, "envelope touched", 5.5, "ring"))
    if limits is None:
        return marks, "no limit" if ratio is None else _of_limit(ratio)
    lower, upper = limits
    centre = (lower + upper) / 2
    half = (upper - lower) / 2
    if ratio is None:
        ratio = float(np.nanmax(np.abs(y - centre))) / half
    if max(abs(lowest - centre), abs(highest - centre)) < _NEAR * half:
        ends = f"{v.number(lower)} to {v.number(upper)}"
        far = f" ±{v.number(upper)}" if lower == -upper else f" {ends}"
        return marks, _of_limit(ratio) + far
    marks += [fig.Rule(limit, fig.MEASURED, dashed=True) for limit in limits]
    return marks, _of_limit(ratio)


def _of_limit(ratio: float) -> str:
    return f"{share_of_limit(ratio)} of limit"
