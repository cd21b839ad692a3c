"""Drawings of on-line estimation over time: estimates, excitation, convergence."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from excitant.reports.drawing import (
    AMBER,
    FITTED,
    LIGHT,
    MEASURED,
    axes,
    draw_curve,
    label_y,
    log_y,
    panel,
)
from excitant.reports.model import Figure, Key, Panel
from excitant.reports.reading import (
    Result,
    Series,
    curve,
    items,
    joint_names,
    real,
    reals,
    records,
    text,
)
from excitant.reports.wording import percent, quantity, shorten, value_and_std
from excitant.robots.motion import Array
from excitant.robots.parameters import STANDARD

_SHOWN = 6  # parameters drawn of links, and as many of joints, of the many that were estimated
_LEFT = 0.72  # inch: room for numbers of small parameters
ENOUGH = 1.0  # level at which the window knows as much as the prior
_BAND = 2.0  # standard deviations


@dataclass(frozen=True, eq=False)
class History:
    """Estimates over time: k looks at r base parameters.

    Attributes:
        t: Time of the looks, shape (k,) [s].
        value: Estimates, shape (k, r).
        std: Their standard deviations, shape (k, r).
        names: Leading parameter of each, r of them.
        units: Their units; empty where unknown.
    """

    t: Array
    value: Array
    std: Array
    names: tuple[str, ...]
    units: tuple[str, ...]


def history_of(result: Result, series: Series) -> History | None:
    """Estimates of a run over time; None where it has none that fit together."""
    t, rows = curve(series, "online_t"), records(result, "base_parameters")
    value, std = (np.asarray(series.get(f"online_{key}", np.empty(0))) for key in ("value", "std"))
    if t is None or len(t) < 2 or value.shape != (len(t), len(rows)) or std.shape != value.shape:
        return None
    known = {text(row, "name"): text(row, "unit") for row in records(result, "parameters")}
    names = [_leading(text(row, "expression"), known) for row in rows]
    units = tuple(known.get(name, "") for name in names)
    return History(t, value.astype(float), std.astype(float), tuple(names), units)


def _leading(expression: str, known: dict[str, str]) -> str:
    """The first parameter that an expression names."""
    words = re.split(r"[ ·−+()]+", expression)
    return next((word for word in words if word in known), expression)


def _spans(t: Array, bad: npt.NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Intervals in which a condition held, from the look that saw it to the next that did not."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], bad, [False]]).astype(int)))
    return [
        (float(t[first]), float(t[min(last, len(t) - 1)])) for first, last in edges.reshape(-1, 2)
    ]


def excitation_levels(result: Result) -> tuple[Array, Array]:
    """Times and excitation levels of the looks; NaN before a whole window."""
    t = reals(result, "online", "history", "t")
    level = reals(result, "online", "history", "excitation_level")
    return (t, level) if len(t) == len(level) else (np.empty(0), np.empty(0))


def left_figure(history: History | None) -> Figure | None:
    """Standard deviation of every parameter relative to its first, over time."""
    if history is None:
        return None
    first = history.std[0]
    usable = np.isfinite(history.std).all(axis=0) & (first > 0) & (history.std > 0).all(axis=0)
    if not usable.any():
        return None
    share = history.std[:, usable] / first[usable]
    (ax,) = axes(2.5)
    for column in share.T:
        draw_curve(ax, history.t, [], column, color=LIGHT, lw=0.7)
    middle = np.median(share, axis=1)
    draw_curve(ax, history.t, [], middle, color=FITTED, lw=1.8)
    log_y(ax)
    ax.set_xlim(history.t[0], history.t[-1])
    ax.set_xlabel("time [s]")
    label_y(ax, "std / std at first look")
    said = f"the median falls to {percent(middle[-1])} of its value at the first look"
    caption = (
        "Uncertainty that is left of each base parameter, relative to the first look one second "
        f"in: {said}; a curve that stays level is a parameter that this motion does not show."
    )
    legend = (Key("line", FITTED, "median"), Key("line", LIGHT, "each base parameter"))
    label = f"standard deviation over time of {usable.sum()} base parameters; {said}"
    return Figure((panel(ax, label),), caption, legend)


def _chosen(history: History) -> list[int]:
    """Parameters that the data taught most about: of links and of joints, one of each at most."""
    with np.errstate(divide="ignore", invalid="ignore"):
        learnt = np.log(history.std[0] / history.std[-1])
    order = np.argsort(-np.where(np.isfinite(learnt), learnt, -np.inf), kind="stable")
    known = np.asarray(np.isfinite(history.value + history.std).all(axis=0))
    best: dict[str, int] = {}
    for k in order[known[order]]:
        best.setdefault(history.names[k].rpartition(".")[0], int(k))
    inertial = [k for k in best.values() if history.names[k].rpartition(".")[2] in STANDARD]
    others = [k for k in best.values() if k not in inertial]
    return [*sorted(inertial[:_SHOWN]), *sorted(others[:_SHOWN])]


def estimates_figure(history: History | None) -> Figure | None:
    """Estimate and band over time of the parameters that the data taught most about."""
    if history is None:
        return None
    panels = [_estimate_panel(history, k) for k in _chosen(history)]
    if not panels:
        return None
    caption = (
        f"Estimate ± {_BAND:g} standard deviations over time of the {len(panels)} base parameters "
        f"(of {len(history.names)}) that the data taught most about, one of a link or joint at "
        "most: the band should close around a level line. A title names the leading "
        "parameter of its combination. Scaled to the second half of the time."
    )
    legend = (Key("line", FITTED, "estimate"), Key("box", "#c3dcec", "± 2 standard deviations"))
    return Figure(tuple(panels), caption, legend)


def _estimate_panel(history: History, k: int) -> Panel:
    t, value, std = history.t, history.value[:, k], history.std[:, k]
    (ax,) = axes(1.9, left=_LEFT)
    low, high = value - _BAND * std, value + _BAND * std
    late = slice(len(t) // 2, None)
    bottom, top = float(low[late].min()), float(high[late].max())
    room = 0.6 * (top - bottom) or 1.0
    bottom, top = bottom - room, top + room
    low, high = np.clip(low, bottom, top), np.clip(high, bottom, top)
    ax.fill_between(t, low, high, color="#c3dcec", lw=0)
    ax.plot(t, np.where((value > bottom) & (value < top), value, np.nan), color=FITTED, lw=1.2)
    ax.set_ylim(bottom, top)
    ax.set_xlim(t[0], t[-1])
    ax.set_xlabel("time [s]")
    unit = history.units[k]
    label_y(ax, f"[{unit}]" if unit else "[SI]")
    last, spread = value_and_std(value[-1], std[-1])
    name = history.names[k]
    return panel(ax, f"{name} over time, at the end {last} ± {spread} {unit}", shorten(name, 44))


def excitation_figure(result: Result) -> Figure | None:
    """How much the last seconds told at each look, and where that was too little."""
    t, level = excitation_levels(result)
    seen = np.isfinite(level) & (level > 0)
    if seen.sum() < 2:
        return None
    t, level = t[seen], level[seen]
    spans = _spans(t, level < ENOUGH)
    (ax,) = axes(2.5)
    for first, last in spans:
        ax.axvspan(first, last, color=AMBER, alpha=0.25, lw=0)
    ax.plot(t, level, "-o", color=FITTED, lw=1.3, ms=2.2)
    ax.axhline(ENOUGH, color=MEASURED, lw=0.9, ls=(0, (5, 3)))
    ax.set_ylim(min(0.5 * level.min(), 0.5), max(2 * level.max(), 2))
    log_y(ax)
    ax.set_xlim(t[0], t[-1])
    ax.set_xlabel("time [s]")
    label_y(ax, "excitation level [–]")
    legend = [Key("line", FITTED, "weakest visible direction"), Key("dash", MEASURED, "enough")]
    lacking = sum(last - first for first, last in spans)
    if spans:
        legend.append(Key("box", "#f8e6bf", "not exciting enough"))
        since = ", ".join(f"{first:.1f} s to {last:.1f} s" for first, last in spans[:4])
        said = f"not exciting enough from {since}{' and later again' if len(spans) > 4 else ''}"
        said += f" ({quantity(lacking, 's')} in all; a message's “since” is where its window began)"
    else:
        said = "never below it"
    caption = (
        "Excitation level of the last seconds at each look: how many times more they tell of the "
        "weakest direction, among those a lively motion shows, than was known beforehand. Level 1 "
        f"is enough; here {said}."
    )
    return Figure((panel(ax, f"excitation level over time; {said}"),), caption, tuple(legend))


def convergence_figure(result: Result) -> Figure | None:
    """Torque uncertainty of the estimate beside the noise of a row, joint by joint."""
    t = reals(result, "online", "history", "t")
    spread = _by_joint(result, "torque_uncertainty")
    noise = _by_joint(result, "noise")
    joints, unit = joint_names(result), text(result, "unit") or "N·m"
    if len(t) < 2 or spread is None or spread.shape != (len(t), len(joints)):
        return None
    if noise is not None and noise.shape != spread.shape:
        noise = None
    panels = [
        _convergence_panel(joint, t, spread[:, j], None if noise is None else noise[:, j], unit)
        for j, joint in enumerate(joints)
    ]
    present = tuple(each for each in panels if each is not None)
    if not present:
        return None
    caption = (
        "Torque error that the uncertainty of the estimate makes on a lively motion of all joints "
        f"[{unit}, rms]: the estimate counts as converged where it lies below the noise of one "
        "row of data in every joint, because more rows then change no prediction visibly."
    )
    legend = [Key("line", FITTED, "torque uncertainty of the estimate")]
    if noise is not None:
        legend.append(Key("dash", MEASURED, "noise of a row"))
    return Figure(present, caption, tuple(legend))


def _by_joint(result: Result, key: str) -> Array | None:
    """A quantity of every look and joint, shape (looks, nv); None where rows differ in length."""
    rows = items(result, "online", "history", key)
    if not rows or not all(isinstance(row, Sequence) and len(row) == len(rows[0]) for row in rows):
        return None
    return np.array([[np.nan if (x := real(item)) is None else x for item in row] for row in rows])


def _convergence_panel(
    joint: str, t: Array, spread: Array, noise: Array | None, unit: str
) -> Panel | None:
    seen = np.isfinite(spread) & (spread > 0)
    if seen.sum() < 2:
        return None
    (ax,) = axes(1.9)
    ax.plot(t[seen], spread[seen], color=FITTED, lw=1.3)
    said = f"{joint}: torque uncertainty falls to {quantity(spread[seen][-1], unit)}"
    if noise is not None and np.isfinite(noise).any():
        ax.plot(t, noise, color=MEASURED, lw=1.0, ls=(0, (5, 3)))
        said += f", noise of a row {quantity(noise[np.isfinite(noise)][-1], unit)}"
    log_y(ax)
    ax.set_xlim(t[0], t[-1])
    ax.set_xlabel("time [s]")
    label_y(ax, "torque [N·m]" if unit != "A" else "current [A]")
    return panel(ax, said, shorten(joint, 44))
