"""A motion against its limits, what it makes visible, and how it was found."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from excitant.reports import drawing as draw
from excitant.reports import values as v
from excitant.reports.page import Figure, Key, Panel, figure
from excitant.reports.values import Result, Series
from excitant.robots.motion import Array

_Curve = tuple[str, str, str, tuple[str, str]]
_CURVES: tuple[_Curve, ...] = (
    ("position", "q", draw.FITTED, ("rad", "m")),
    ("velocity", "dq", draw.GREEN, ("rad/s", "m/s")),
    ("acceleration", "ddq", draw.PURPLE, ("rad/s²", "m/s²")),
    ("jerk", "dddq", draw.SKY, ("rad/s³", "m/s³")),
    ("torque", "tau", draw.GIVEN, ("N·m", "N")),
)
_BEFORE_AFTER = (
    ("initial", draw.GIVEN, "start of the search"),
    ("final", draw.FITTED, "designed motion"),
)
_ROW, _ABOVE, _BELOW = 0.56, 0.22, 0.42  # inch: curve, its heading, the time axis
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


def envelope_of(result: Result, name: str, joint: int) -> tuple[float, float, float, float] | None:
    """What a quantity of a joint provably stays within: least, greatest, ratio to limit, when."""
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


def motion_figure(joints: Sequence[str], result: Result, series: Series) -> Figure | None:
    """Position, velocity, acceleration, jerk and torque of each joint against their limits."""
    t = v.times(series)
    if t is None:
        return None
    curves = [
        {
            row[0]: values
            for row in _CURVES
            if (values := v.curve(series, row[1], k)) is not None and len(values) == len(t)
        }
        for k in range(len(joints))
    ]
    rows = [row for row in _CURVES if any(row[0] in known for known in curves)]
    panels = [
        _panel(k, joint, rows, curves[k], t, result) for k, joint in enumerate(joints) if curves[k]
    ]
    if not any(_limit_of(result, row[0], k) for row in rows for k in range(len(joints))):
        caption = "The motion of every joint; the arm has no limits to compare it with."
        return figure(panels, caption)
    certified = [
        Key("box", "#cfe3f1", "certified envelope"),
        Key("ring", draw.MEASURED, "where it is touched"),
    ] * bool(v.at(result, "certified"))
    caption = _CERTIFIED if certified else _SAMPLED
    return figure(panels, caption, [Key("dash", draw.MEASURED, "limit"), *certified])


def _panel(
    k: int, joint: str, rows: list[_Curve], curves: dict[str, Array], t: Array, result: Result
) -> Panel:
    time, joins = draw.timeline(t)
    height = len(rows) * (_ROW + _ABOVE) + _BELOW
    stack = draw.axes(height, [1.0] * len(rows), top=_ABOVE, space=_ABOVE / _ROW)
    turns = v.items(result, "revolute")
    slides = k < len(turns) and turns[k] is False
    said = []
    for ax, (name, _, colour, units) in zip(stack, rows, strict=True):
        look: Any = {"fontsize": 8.5, "pad": 2.5}
        ax.set_title(f"{name} [{units[slides]}]", loc="left", color=draw.ink(colour), **look)
        if name not in curves:
            ax.set_yticks([])
            continue
        draw.draw_curve(ax, time, joins, curves[name], color=colour, lw=1.1)
        remark = _against(ax, time, t, curves[name], colour, result, name, k)
        ax.set_title(remark, loc="right", color="#5a626a", **look)
        said.append(f"{name} {remark}")
        draw.few_ticks(ax.yaxis, 3)
    draw.over_time(stack[-1], time)
    return draw.panel(stack[0], f"{joint} over time: {', '.join(said)}", v.shorten(joint, 60))


def _against(
    ax: draw.Axes,
    time: Array,
    t: Array,
    y: Array,
    colour: str,
    result: Result,
    name: str,
    joint: int,
) -> str:
    limits, within = _limit_of(result, name, joint), envelope_of(result, name, joint)
    lowest, highest = float(np.nanmin(y)), float(np.nanmax(y))
    ratio, far = None, ""
    if within is not None:
        low, high, ratio, when = within
        ax.axhspan(low, high, color=colour, alpha=0.11, lw=0)
        lowest, highest = min(lowest, low), max(highest, high)
        near = int(np.abs(t - when).argmin())
        edge = min((high, low), key=lambda each: abs(y[near] - each))
        ring: Any = {"ms": 5.5, "mfc": "none", "mec": colour, "mew": 1.2}
        ax.plot(time[near] + when - t[near], edge, "o", **ring)
    if limits is not None:
        centre, half = (limits[0] + limits[1]) / 2, (limits[1] - limits[0]) / 2
        if ratio is None:
            ratio = float(np.nanmax(np.abs(y - centre))) / half
        if max(abs(lowest - centre), abs(highest - centre)) < _NEAR * half:
            least, most = (v.number(limit) for limit in limits)
            far = f" ±{most}" if limits[0] == -limits[1] else f" {least} to {most}"
        else:
            for limit in limits:
                ax.axhline(limit, color=draw.MEASURED, lw=1.0, ls=draw.DASHED)
            lowest, highest = min(lowest, limits[0]), max(highest, limits[1])
    pad = 0.1 * max(highest - lowest, 1e-9)
    ax.set_ylim(lowest - pad, highest + pad)
    return "no limit" if ratio is None else f"{share_of_limit(ratio)} of limit{far}"


def spectrum_figure(series: Series) -> Figure | None:
    """Singular values of the observation matrix, before and after a design, greatest first."""
    found = [
        (key, np.sqrt(sizes), colour, name)
        for key, colour, name in _BEFORE_AFTER
        if len(sizes := _positive(series, f"eigenvalues_{key}"))
    ]
    designed = bool(found)
    if not designed and len(sizes := _positive(series, "singular_values")):
        found = [("final", sizes, draw.MEASURED, "this motion")]
    if not found:
        return None
    (ax,) = draw.axes(2.5)
    said, legend = [], []
    for key, sizes, colour, name in found:
        fill, mark = (colour, "dot") if key == "final" else ("none", "ring")
        ax.plot(1 + np.arange(len(sizes)), sizes, "o", ms=3.6, mec=colour, mfc=fill, mew=0.9)
        said.append(f"{name}: {len(sizes)} values, ratio {v.number(sizes[0] / sizes[-1])}")
        legend += [Key(mark, colour, name)] * designed
    draw.log_y(ax)
    ax.set_xlim(left=0)
    draw.few_ticks(ax.xaxis, 6, integer=True)
    ax.set_xlabel("direction in parameter space, best seen first")
    draw.label_y(ax, "singular value [N·m]" if designed else "singular value [–]")
    caption = (
        "Singular values of the observation matrix W/√n, the torque that each direction of the "
        "base parameters makes; the ratio of the first to the last is the condition number."
        if designed
        else "Singular values of the normalised observation matrix: estimates along directions far "
        "below the others are uncertain."
    )
    return draw.single(ax, f"singular values; {'; '.join(said)}", caption, legend)


def _positive(series: Series, key: str) -> Array:
    values = v.curve(series, key)
    return np.empty(0) if values is None else np.sort(values[values > 0])[::-1]


def convergence_figure(result: Result) -> Figure | None:
    """Condition number over the iterations of each start; the best start stands out."""
    starts = [(row, v.reals(row, "history")) for row in v.records(result, "starts")]
    starts = [(row, h) for row, h in starts if np.isfinite(h).any() and len(h) > 1]
    if not starts:
        return None
    ends = [v.real(row, "condition_number") or float(h[np.isfinite(h)][-1]) for row, h in starts]
    best = int(np.argmin(ends))
    (ax,) = draw.axes(2.3)
    for k, (_, history) in sorted(enumerate(starts), key=lambda pair: pair[0] == best):
        colour, width = (draw.FITTED, 1.6) if k == best else (draw.LIGHT, 1.0)
        ax.plot(np.arange(len(history)), history, color=colour, lw=width)
        last = int(np.flatnonzero(np.isfinite(history))[-1])
        ax.plot(last, history[last], "o", ms=3, color=colour)
    legend = [Key("line", draw.FITTED, "best start")]
    legend += [Key("line", draw.LIGHT, "other starts")] * (len(starts) > 1)
    bound = v.real(result, "condition_number", "lower_bound")
    if bound is not None and bound > 0:
        ax.axhline(bound, color=draw.AMBER, lw=1.2, ls=draw.DASHED)
        legend.append(Key("dash", draw.AMBER, "proven lower bound"))
    reached: Array = np.concatenate([h[np.isfinite(h)] for _, h in starts])
    if reached.min() > 0 and reached.max() > 8 * reached.min():
        draw.log_y(ax)
    ax.set_xlim(left=0)
    draw.few_ticks(ax.xaxis, 6, integer=True)
    ax.set_xlabel("iteration")
    draw.label_y(ax, "condition number [–]")
    count = f"{len(starts)} starts; best ends at {v.number(ends[best])}"
    caption = "Each start of the optimisation, a dot where it ended: several that end at the same "
    caption += "value suggest that a much better motion does not exist."
    if cut := sum(v.text(row, "status") in ("time_limit", "time limit") for row, _ in starts):
        caption += f" The time limit ended {cut} of these {len(starts)}: more time may find better."
    return draw.single(ax, f"condition number over iterations of {count}", caption, legend)
