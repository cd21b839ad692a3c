"""On-line estimation over time: uncertainty, estimates, excitation and convergence."""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from excitant.reports import drawing as draw
from excitant.reports import values as v
from excitant.reports.page import Figure, Key, Panel, figure
from excitant.reports.values import Result, Series
from excitant.robots.motion import Array
from excitant.robots.parameters import STANDARD

ENOUGH = 1.0  # level at which the window knows as much as the prior
_SHOWN = 6  # parameters drawn of links, and as many of joints, of the many that were estimated
_BAND = 2.0  # standard deviations


class History(NamedTuple):
    """Estimates and std (k, r) at k times, r leading parameters and their units, if known."""

    t: Array
    value: Array
    std: Array
    names: tuple[str, ...]
    units: tuple[str, ...]


def history_of(result: Result, series: Series) -> History | None:
    """Estimates of a run over time; None where it has none that fit together."""
    t, rows = v.curve(series, "online_t"), v.records(result, "base_parameters")
    if t is None or len(t) < 2:
        return None
    value, std = (v.array(series, f"online_{key}", len(t), len(rows)) for key in ("value", "std"))
    if value is None or std is None:
        return None
    known = {v.text(row, "name"): v.text(row, "unit") for row in v.records(result, "parameters")}
    expressions = [v.text(row, "expression") for row in rows]
    words = ((each, re.split(r"[ ·−+()]+", each)) for each in expressions)
    names = tuple(next((word for word in found if word in known), each) for each, found in words)
    return History(t, value, std, names, tuple(known.get(name, "") for name in names))


def excitation_levels(result: Result) -> tuple[Array, Array]:
    """Times and excitation levels of the looks; NaN before a whole window."""
    t = v.reals(result, "online", "history", "t")
    level = v.reals(result, "online", "history", "excitation_level")
    return (t, level) if len(t) == len(level) else (np.empty(0), np.empty(0))


def estimates_figure(history: History | None) -> Figure | None:
    """Estimate and band over time of the parameters that the data determined most."""
    if history is None:
        return None
    panels = [_estimate_panel(history, k) for k in _chosen(history)]
    caption = (
        f"Estimates of the {len(panels)} base parameters (of {len(history.names)}) whose "
        "uncertainty fell most, at most one of each link or joint, named by the first parameter of "
        "their combination: the band should close around a level line."
    )
    band = Key("box", draw.BAND, f"± {_BAND:g} standard deviations")
    return figure(panels, caption, [Key("line", draw.FITTED, "estimate"), band])


def _chosen(history: History) -> list[int]:
    with np.errstate(divide="ignore", invalid="ignore"):
        gain = np.log(history.std[0] / history.std[-1])
    order = np.argsort(-np.where(np.isfinite(gain), gain, -np.inf), kind="stable")
    known = np.asarray(np.isfinite(history.value + history.std).all(axis=0))
    best: dict[str, int] = {}
    for k in order[known[order]]:
        best.setdefault(history.names[k].rpartition(".")[0], int(k))
    inertial = [k for k in best.values() if history.names[k].rpartition(".")[2] in STANDARD]
    others = [k for k in best.values() if k not in inertial]
    return [*sorted(inertial[:_SHOWN]), *sorted(others[:_SHOWN])]


def _estimate_panel(history: History, k: int) -> Panel:
    t, value, std = history.t, history.value[:, k], history.std[:, k]
    (ax,) = draw.axes(1.9, left=0.72)
    low, high = value - _BAND * std, value + _BAND * std
    late = slice(len(t) // 2, None)
    bottom, top = float(low[late].min()), float(high[late].max())
    room = 0.6 * (top - bottom) or 1.0
    bottom, top = bottom - room, top + room
    ax.fill_between(t, np.clip(low, bottom, top), np.clip(high, bottom, top), color=draw.BAND, lw=0)
    ax.plot(t, np.where((value > bottom) & (value < top), value, np.nan), color=draw.FITTED, lw=1.2)
    ax.set_ylim(bottom, top)
    unit, name = history.units[k], history.names[k]
    draw.over_time(ax, t, f"[{unit}]" if unit else "[SI]")
    last = " ± ".join(v.value_and_std(value[-1], std[-1]))
    return draw.panel(ax, f"{name} over time, at the end {last} {unit}", v.shorten(name, 44))


def excitation_figure(result: Result) -> Figure | None:
    """Excitation of the last seconds at each look, and where it was too little."""
    t, level = excitation_levels(result)
    seen = np.isfinite(level) & (level > 0)
    if seen.sum() < 2:
        return None
    t, level = t[seen], level[seen]
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
    return [(float(t[a]), float(t[min(b, len(t) - 1)])) for a, b in edges.reshape(-1, 2)]


def convergence_figure(result: Result) -> Figure | None:
    """Torque uncertainty of the estimate beside the noise of a row, joint by joint."""
    t, joints = v.reals(result, "online", "history", "t"), v.joint_names(result)
    spread = _by_joint(result, "torque_uncertainty", len(t), len(joints))
    noise = _by_joint(result, "noise", len(t), len(joints))
    if len(t) < 2 or spread is None:
        return None
    unit = v.text(result, "unit") or "N·m"
    panels = [
        _convergence_panel(joint, t, spread[:, j], None if noise is None else noise[:, j], unit)
        for j, joint in enumerate(joints)
    ]
    caption = (
        "Torque error that the uncertainty of the estimate makes on a fast motion of all joints "
        f"[{unit}, rms]: converged when below the noise of one row of data in every joint."
    )
    legend = [Key("line", draw.FITTED, "torque uncertainty of the estimate")]
    legend += [Key("dash", draw.MEASURED, "noise of a row")] * (noise is not None)
    return figure(panels, caption, legend)


def _by_joint(result: Result, key: str, looks: int, joints: int) -> Array | None:
    rows = [v.reals({key: row}, key) for row in v.items(result, "online", "history", key)]
    fits = len(rows) == looks and all(len(row) == joints for row in rows)
    return np.array(rows) if fits else None


def _convergence_panel(
    joint: str, t: Array, spread: Array, noise: Array | None, unit: str
) -> Panel | None:
    seen = np.isfinite(spread) & (spread > 0)
    if seen.sum() < 2:
        return None
    (ax,) = draw.axes(1.9)
    ax.plot(t[seen], spread[seen], color=draw.FITTED, lw=1.3)
    said = f"{joint}: torque uncertainty falls to {v.quantity(spread[seen][-1], unit)}"
    if noise is not None and np.isfinite(noise).any():
        ax.plot(t, noise, color=draw.MEASURED, lw=1.0, ls=draw.DASHED)
        said += f", noise of a row {v.quantity(noise[np.isfinite(noise)][-1], unit)}"
    draw.log_y(ax)
    draw.over_time(ax, t, "torque [N·m]" if unit != "A" else "current [A]")
    return draw.panel(ax, said, v.shorten(joint, 44))
