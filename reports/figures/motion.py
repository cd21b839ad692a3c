"""A motion against its limits, joint by joint."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from excitant.reports import values as v
from excitant.reports.figure import (
    BAND,
    FITTED,
    GIVEN,
    GREEN,
    MEASURED,
    PURPLE,
    SKY,
    Axes,
    Axis,
    Figure,
    Key,
    Line,
    Mark,
    Panel,
    Rule,
    Span,
    Timeline,
    figure,
)
from excitant.reports.values import Series
from excitant.results import Certified
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
    _Quantity("position", "q", FITTED, "rad", "m"),
    _Quantity("velocity", "dq", GREEN, "rad/s", "m/s"),
    _Quantity("acceleration", "ddq", PURPLE, "rad/s²", "m/s²"),
    _Quantity("jerk", "dddq", SKY, "rad/s³", "m/s³"),
    _Quantity("torque", "tau", GIVEN, "N·m", "N"),
)
_HEIGHT = 70  # px of a curve
_BELOW = 28  # px of the time axis
_NEAR = 0.15  # share of a limit from which on the limit is drawn in

_CERTIFIED = (
    "Every joint's motion in its own units. The shaded band bounds the continuous motion: a limit "
    "holds where it ends inside the dashed lines (a limit far outside is only written)."
)
_SAMPLED = (
    "Every joint's motion in its own units, and the largest share of each limit over the samples "
    "drawn (a limit far outside is only written)."
)


@dataclass(frozen=True)
class Limits:
    """Limits of a motion's joints by quantity, what is certified of it, and which joints turn."""

    values: Mapping[str, list[Any] | None] | None
    certified: Mapping[str, Sequence[Certified | None]] | None = None
    revolute: Sequence[bool] = ()

    def of(self, name: str, joint: int) -> tuple[float, float] | None:
        """Lower and upper limit of a joint's quantity, if it has both."""
        values = (self.values or {}).get(name)
        value = None if values is None else values[joint]
        if value is None:
            return None
        low, high = value if isinstance(value, list) else (-value, value)
        return None if low is None or high is None or low >= high else (low, high)

    def envelope(self, name: str, joint: int) -> Certified | None:
        """Proven bounds of a joint's quantity."""
        rows = (self.certified or {}).get(name)
        return rows[joint] if rows else None


def share_of_limit(ratio: float | None) -> str:
    """A share of a limit as a percentage, near the limit to a hundredth."""
    near = abs((ratio or 0.0) - 1) <= 5e-3
    return v.percent(ratio, 4 if near else 3)


def motion_figure(
    joints: Sequence[str], limits: Limits, series: Series
) -> Figure | None:
    """Position, velocity, acceleration, jerk and torque of each joint against their limits."""
    t = v.times(series)
    if t is None:
        return None
    curves = [_curves_of(k, series, len(t)) for k in range(len(joints))]
    rows = [
        row for row in _QUANTITIES if any(row.name in joint for joint in curves)
    ]
    panels = [
        _panel(k, joint, rows, curves[k], t, limits)
        for k, joint in enumerate(joints)
        if curves[k]
    ]
    every = [(row.name, k) for row in rows for k in range(len(joints))]
    if not any(limits.of(name, k) for name, k in every):
        caption = (
            "The motion of every joint; the arm has no limits to compare it with."
        )
        return figure(panels, caption)
    legend = [Key("dash", MEASURED, "limit")]
    caption = _SAMPLED
    if limits.certified:
        caption = _CERTIFIED
        legend.append(Key("box", BAND, "certified envelope"))
    return figure(panels, caption, legend)


def _curves_of(joint: int, series: Series, rows: int) -> dict[str, Array]:
    curves = {
        row.name: v.curve(series, row.key, joint, rows) for row in _QUANTITIES
    }
    return {name: values for name, values in curves.items() if values is not None}


def _panel(
    k: int,
    joint: str,
    rows: Sequence[_Quantity],
    curves: dict[str, Array],
    t: Array,
    limits: Limits,
) -> Panel:
    timeline = Timeline.of(t)
    slides = bool(limits.revolute) and not limits.revolute[k]
    stack = []
    remarks = []
    for row in rows:
        title = f"{row.name} [{row.linear if slides else row.angular}]"
        marks: list[Mark] = []
        remark = ""
        if row.name in curves:
            y = curves[row.name]
            curve = Line(timeline.t, timeline.broken(y), row.colour, row.name)
            context, remark = _context(y, row, limits, k)
            marks = [*context, curve]
            remarks.append(f"{row.name} {remark}")
        last = row is rows[-1]
        abscissa = timeline.axis("time [s]" if last else "")
        height = _HEIGHT + _BELOW * last
        axes = Axes(marks, abscissa, Axis(), height, title, remark, row.colour)
        stack.append(axes)
    label = f"{joint} over time: {', '.join(remarks)}"
    return Panel(stack, label, joint)


def _context(
    y: Array,
    quantity: _Quantity,
    limits: Limits,
    joint: int,
) -> tuple[list[Mark], str]:
    """Envelope and limits of a curve, and in words how near it comes to its limit."""
    ends = limits.of(quantity.name, joint)
    envelope = limits.envelope(quantity.name, joint)
    lowest = float(np.nanmin(y))
    highest = float(np.nanmax(y))
    marks: list[Mark] = []
    ratio = None
    if envelope is not None:
        low = envelope.low
        high = envelope.high
        ratio = envelope.ratio
        marks.append(Span(low, high, quantity.colour))
        lowest = min(lowest, low)
        highest = max(highest, high)
    if ends is None:
        return marks, "no limit" if ratio is None else _of_limit(ratio)
    lower, upper = ends
    centre = (lower + upper) / 2
    half = (upper - lower) / 2
    if ratio is None:
        ratio = float(np.nanmax(np.abs(y - centre))) / half
    if max(abs(lowest - centre), abs(highest - centre)) < _NEAR * half:
        far = f" {v.number(lower)} to {v.number(upper)}"
        if lower == -upper:
            far = f" ±{v.number(upper)}"
        return marks, _of_limit(ratio) + far
    marks += [Rule(limit, MEASURED, dashed=True) for limit in ends]
    return marks, _of_limit(ratio)


def _of_limit(ratio: float) -> str:
    return f"{share_of_limit(ratio)} of limit"
