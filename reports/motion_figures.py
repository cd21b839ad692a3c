"""A motion against its limits, what it shows, how it was found, and estimates along it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from excitant.reports import drawing as draw
from excitant.reports import values as v
from excitant.reports.page import Figure, Key, Panel, figure
from excitant.reports.values import Result, Series
from excitant.robots.motion import Array
from excitant.robots.parameters import STANDARD

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
_ROW = 0.56  # inch: curve
_ABOVE = 0.22  # its heading
_BELOW = 0.42  # the time axis
_NEAR = 0.15  # share of a limit from which on the limit is drawn in
ENOUGH = 1.0  # level at which the window knows as much as the prior
_SHOWN = 6  # parameters drawn of links, and as many of joints, of the many that were estimated
_BAND = 2.0  # standard deviations

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
    curves = [
        {
            row[0]: values
            for row in _CURVES
            if (values := v.curve(series, row[1], k)) is not None
            and len(values) == len(t)
        }
        for k in range(len(joints))
    ]
    rows = [row for row in _CURVES if any(row[0] in known for known in curves)]
    panels = [
        _panel(k, joint, rows, curves[k], t, result)
        for k, joint in enumerate(joints)
        if curves[k]
    ]
    if not any(
        _limit_of(result, row[0], k) for row in rows for k in range(len(joints))
    ):
        caption = "The motion of every joint; the arm has no limits to compare it with."
        return figure(panels, caption)
    certified = [
        Key("box", "#cfe3f1", "certified envelope"),
        Key("ring", draw.MEASURED, "where it is touched"),
    ] * bool(v.at(result, "certified"))
    caption = _CERTIFIED if certified else _SAMPLED
    return figure(panels, caption, [Key("dash", draw.MEASURED, "limit"), *certified])


def _panel(
    k: int,
    joint: str,
    rows: list[_Curve],
    curves: dict[str, Array],
    t: Array,
    result: Result,
) -> Panel:
    time, joins = draw.timeline(t)
    height = len(rows) * (_ROW + _ABOVE) + _BELOW
    stack = draw.axes(height, [1.0] * len(rows), top=_ABOVE, space=_ABOVE / _ROW)
    turns = v.items(result, "revolute")
    slides = k < len(turns) and turns[k] is False
    said = []
    for ax, (name, _, colour, units) in zip(stack, rows, strict=True):
        look: Any = {"fontsize": 8.5, "pad": 2.5}
        ax.set_title(
            f"{name} [{units[slides]}]", loc="left", color=draw.ink(colour), **look
        )
        if name not in curves:
            ax.set_yticks([])
            continue
        draw.draw_curve(ax, time, joins, curves[name], color=colour, lw=1.1)
        remark = _against(ax, time, t, curves[name], colour, result, name, k)
        ax.set_title(remark, loc="right", color="#5a626a", **look)
        said.append(f"{name} {remark}")
        draw.few_ticks(ax.yaxis, 3)
    draw.over_time(stack[-1], time)
    return draw.panel(
        stack[0], f"{joint} over time: {', '.join(said)}", v.shorten(joint, 60)
    )


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
    limits = _limit_of(result, name, joint)
    within = envelope_of(result, name, joint)
    lowest = float(np.nanmin(y))
    highest = float(np.nanmax(y))
    ratio = None
    far = ""
    if within is not None:
        low, high, ratio, when = within
        ax.axhspan(low, high, color=colour, alpha=0.11, lw=0)
        lowest = min(lowest, low)
        highest = max(highest, high)
        near = int(np.abs(t - when).argmin())
        edge = min((high, low), key=lambda each: abs(y[near] - each))
        ring: Any = {"ms": 5.5, "mfc": "none", "mec": colour, "mew": 1.2}
        ax.plot(time[near] + when - t[near], edge, "o", **ring)
    if limits is not None:
        centre = (limits[0] + limits[1]) / 2
        half = (limits[1] - limits[0]) / 2
        if ratio is None:
            ratio = float(np.nanmax(np.abs(y - centre))) / half
        if max(abs(lowest - centre), abs(highest - centre)) < _NEAR * half:
            least, most = (v.number(limit) for limit in limits)
            far = f" ±{most}" if limits[0] == -limits[1] else f" {least} to {most}"
        else:
            for limit in limits:
                ax.axhline(limit, color=draw.MEASURED, lw=1.0, ls=draw.DASHED)
            lowest = min(lowest, limits[0])
            highest = max(highest, limits[1])
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
    said = []
    legend = []
    for key, sizes, colour, name in found:
        fill, mark = (colour, "dot") if key == "final" else ("none", "ring")
        ax.plot(
            1 + np.arange(len(sizes)), sizes, "o", ms=3.6, mec=colour, mfc=fill, mew=0.9
        )
        said.append(
            f"{name}: {len(sizes)} values, ratio {v.number(sizes[0] / sizes[-1])}"
        )
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
    ends = [
        v.real(row, "condition_number") or float(h[np.isfinite(h)][-1])
        for row, h in starts
    ]
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
    if cut := sum(
        v.text(row, "status") in ("time_limit", "time limit") for row, _ in starts
    ):
        caption += f" The time limit ended {cut} of these {len(starts)}: more time may find better."
    return draw.single(
        ax, f"condition number over iterations of {count}", caption, legend
    )


def excitation_levels(result: Result) -> tuple[Array, Array]:
    """Times and excitation levels of the looks; NaN before a whole window."""
    t, level = (
        v.reals(result, "online", "history", key) for key in ("t", "excitation_level")
    )
    known = len(t) == len(level) and bool(np.isfinite(t).all())
    return (t, level) if known else (np.empty(0), np.empty(0))


def estimates_figure(result: Result, series: Series) -> Figure | None:
    """Estimate and band over time of the parameters that the data determined most."""
    t = v.curve(series, "online_t")
    rows = v.records(result, "base_parameters")
    if t is None or len(t) < 2:
        return None
    value, std = (
        v.array(series, f"online_{key}", len(t), len(rows)) for key in ("value", "std")
    )
    if value is None or std is None:
        return None
    units = {
        v.text(row, "name"): v.text(row, "unit")
        for row in v.records(result, "parameters")
    }
    expressions = [v.text(row, "expression") for row in rows]
    words = ((each, re.split(r"[ ·−+()]+", each)) for each in expressions)
    names = [
        next((word for word in found if word in units), each) for each, found in words
    ]
    panels = [
        _estimate_panel(t, value[:, k], std[:, k], names[k], units.get(names[k], ""))
        for k in _chosen(value, std, names)
    ]
    caption = (
        f"Estimates of the {len(panels)} base parameters (of {len(names)}) whose uncertainty fell "
        "most, at most one of each link or joint, named by the first parameter of their "
        "combination: the band should close around a level line."
    )
    band = Key("box", draw.BAND, f"± {_BAND:g} standard deviations")
    return figure(panels, caption, [Key("line", draw.FITTED, "estimate"), band])


def payload_figure(payload: Result | None) -> Figure | None:
    """Mass and centre of mass of a payload over time, each with its band."""
    history = v.at(payload, "history")
    t, mass, std = (v.reals(history, key) for key in ("t", "mass", "mass_std"))
    if len(t) < 2 or not len(t) == len(mass) == len(std):
        return None
    panels = [_estimate_panel(t, mass, std, "mass", "kg")]
    centre, spread = (
        np.array(v.items(history, key)) for key in ("centre", "centre_std")
    )
    if centre.shape == spread.shape == (len(t), 3):
        panels += [
            _estimate_panel(
                t, centre[:, k], spread[:, k], f"centre of mass, {axis}", "m"
            )
            for k, axis in enumerate("xyz")
        ]
    caption = "The payload as it was known at each instant; the band holds it 95 times out of 100."
    band = Key("box", draw.BAND, f"± {_BAND:g} standard deviations")
    return figure(panels, caption, [Key("line", draw.FITTED, "estimate"), band])


def _chosen(value: Array, std: Array, names: Sequence[str]) -> list[int]:
    with np.errstate(divide="ignore", invalid="ignore"):
        gain = np.log(std[0] / std[-1])
    order = np.argsort(-np.where(np.isfinite(gain), gain, -np.inf), kind="stable")
    known = np.asarray(np.isfinite(value + std).all(axis=0))
    best: dict[str, int] = {}
    for k in order[known[order]]:
        best.setdefault(names[k].rpartition(".")[0], int(k))
    inertial = [k for k in best.values() if names[k].rpartition(".")[2] in STANDARD]
    others = [k for k in best.values() if k not in inertial]
    return [*sorted(inertial[:_SHOWN]), *sorted(others[:_SHOWN])]


def _estimate_panel(t: Array, value: Array, std: Array, name: str, unit: str) -> Panel:
    (ax,) = draw.axes(1.9, left=0.72)
    low = value - _BAND * std
    high = value + _BAND * std
    late = slice(len(t) // 2, None)
    bottom = float(low[late].min())
    top = float(high[late].max())
    room = 0.6 * (top - bottom) or 1.0
    bottom = bottom - room
    top = top + room
    ax.fill_between(
        t, np.clip(low, bottom, top), np.clip(high, bottom, top), color=draw.BAND, lw=0
    )
    ax.plot(
        t,
        np.where((value > bottom) & (value < top), value, np.nan),
        color=draw.FITTED,
        lw=1.2,
    )
    ax.set_ylim(bottom, top)
    draw.over_time(ax, t, f"[{unit}]" if unit else "[SI]")
    last = " ± ".join(v.value_and_std(value[-1], std[-1]))
    return draw.panel(
        ax, f"{name} over time, at the end {last} {unit}", v.shorten(name, 44)
    )


def excitation_figure(result: Result) -> Figure | None:
    """Excitation of the last seconds at each look, and where it was too little."""
    t, level = excitation_levels(result)
    seen = np.isfinite(level) & (level > 0)
    if seen.sum() < 2:
        return None
    t = t[seen]
    level = level[seen]
    spans = _spans(t, level < ENOUGH)
    (ax,) = draw.axes(2.5)
    for first, last in spans:
        ax.axvspan(first, last, color=draw.AMBER, alpha=0.25, lw=0)
    ax.plot(t, level, "-o", color=draw.FITTED, lw=1.3, ms=2.2)
    ax.axhline(ENOUGH, color=draw.MEASURED, lw=0.9, ls=draw.DASHED)
    ax.set_ylim(min(0.5 * level.min(), 0.5), max(2 * level.max(), 2))
    draw.log_y(ax)
    draw.over_time(ax, t, "excitation level [–]")
    legend = [
        Key("line", draw.FITTED, "weakest visible direction"),
        Key("dash", draw.MEASURED, "enough"),
    ]
    said = "never below it"
    if spans:
        legend.append(Key("box", "#f8e6bf", "not exciting enough"))
        since = ", ".join(f"{first:.1f} s to {last:.1f} s" for first, last in spans[:4])
        lacking = sum(last - first for first, last in spans)
        said = (
            f"not exciting enough from {since}{' and later again' if len(spans) > 4 else ''} "
            f"({v.quantity(lacking, 's')} in all; a message's “since” is where its window began)"
        )
    caption = (
        "Information of the last seconds about the weakest direction that a fast motion of all "
        f"joints shows, relative to the prior's. Level 1 is enough; here {said}."
    )
    return draw.single(ax, f"excitation level over time; {said}", caption, legend)


def _spans(t: Array, bad: npt.NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Intervals in which a condition held, from the look that saw it to the next that did not."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], bad, [False]]).astype(int)))
    return [
        (float(t[a]), float(t[min(b, len(t) - 1)])) for a, b in edges.reshape(-1, 2)
    ]
