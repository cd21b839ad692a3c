"""Both runs of a comparison in one drawing."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from excitant.reports.comparison import drawn
from excitant.reports.comparison_rows import APART
from excitant.reports.drawing import (
    GREEN,
    LIGHT,
    PURPLE,
    axes,
    draw_curve,
    label_y,
    log_x,
    log_y,
    panel,
    timeline,
    whole_ticks,
)
from excitant.reports.model import Figure, Key, Panel
from excitant.reports.reading import Result, Series, at, curve, items, part, real, records, text
from excitant.reports.torque_figures import Change, Curves, error_bars, torque_figure
from excitant.reports.wording import number, percent, shorten
from excitant.robots.motion import Array

COLOURS = {"a": PURPLE, "b": GREEN}
_MOST = 16  # rows of a drawing
_ALIKE = 0.01  # relative difference of standard deviations that is not drawn


def side_keys(mark: str) -> tuple[Key, ...]:
    """The legend that all these drawings share."""
    return tuple(Key(mark, colour, side.upper()) for side, colour in COLOURS.items())


def error_figure(result: Result, model: str, where: str) -> Figure | None:
    """Error per joint of both runs."""
    unit = text(result, "unit")
    changes = [
        Change(
            text(row, "name"),
            *(real(row, model, side, "rms") for side in "ab"),
            *(real(row, model, side, "nrmse") for side in "ab"),
        )
        for row in records(result, "errors")
    ]
    caption = (
        f"Error of both runs per joint {where}, as a share of the measured torque's standard "
        f"deviation; beside each bar the rms [{unit}]: shorter is better."
    )
    return error_bars(changes, unit, ("A", "B"), caption, (PURPLE, GREEN))


def torque_figures(result: Result, series: Series, model: str) -> list[Figure | None]:
    """Both models against the reading they share, or each against its own."""
    joints, unit = [str(name) for name in items(result, "joints")], text(result, "unit")
    own = {side: part(series, side) for side in "ab"}
    if at(result, "same_rows") is True:
        both: dict[str, Array] = {
            key: own["a"][key] for key in ("t", "measured") if key in own["a"]
        }
        both |= {side: own[side][model] for side in "ab" if model in own[side]}
        caption = (
            "Measured torque and the prediction of both runs over the hold-out they share, below "
            "it what each leaves: the one that lies closer to zero predicts better."
        )
        return [torque_figure(joints, both, unit, Curves("a", "A", "b", "B", caption),
                              (PURPLE, GREEN))]  # fmt: skip
    return [
        torque_figure(
            joints,
            own[side],
            unit,
            Curves("", "", model, side.upper(), f"Measured torque and the prediction of "
                   f"{side.upper()} over its own hold-out, below it what the model leaves."),
            (LIGHT, colour),
        )
        for side, colour in COLOURS.items()
    ]  # fmt: skip


def leader(expression: str) -> str:
    """A combination named by its first member."""
    first, *others = re.split(r" [+−-] ", expression, maxsplit=1)
    return f"{first} + …" if others else first


def motion_figure(result: Result, series: Series) -> Figure | None:
    """Position and velocity of every joint in both motions."""
    turns = items(result, "revolute")
    panels = [
        _motion_panel(k, str(joint), series, "m" if turns[k : k + 1] == [False] else "rad")
        for k, joint in enumerate(items(result, "joints"))
    ]
    present = tuple(each for each in panels if each is not None)
    caption = (
        "The two motions joint by joint: a wider swing shows inertia and gravity, a faster one "
        "friction and the products of velocities."
    )
    return Figure(present, caption, side_keys("line")) if present else None


def _motion_panel(k: int, joint: str, series: Series, unit: str) -> Panel | None:
    rows = [(key, {s: c for s in "ab" if (c := drawn(series, s, key, k))}) for key in ("q", "dq")]
    rows = [row for row in rows if row[1]]
    if not rows:
        return None
    said, found = [], axes(1.1 + 0.8 * len(rows), (1,) * len(rows))
    for ax, (key, curves) in zip(found, rows, strict=True):
        for side, (t, values) in curves.items():
            time, joins = timeline(t)
            draw_curve(ax, time, joins, values, color=COLOURS[side], lw=1.1)
            name = "position" if key == "q" else "velocity"
            said.append(
                f"{name} of {side.upper()} {number(values.min())} to {number(values.max())}"
            )
        label_y(ax, f"position [{unit}]" if key == "q" else f"velocity [{unit}/s]")
    found[-1].set_xlabel("time [s]")
    return panel(found[0], f"{joint}: {'; '.join(said)}", joint)


def spectrum_figure(series: Series) -> Figure | None:
    """Singular values of both observation matrices, greatest first."""
    found = {side: values for side in "ab" if (values := _spectrum(series, side)) is not None}
    if not found:
        return None
    (ax,) = axes(2.5)
    said = []
    for side, values in found.items():
        colour = COLOURS[side]
        filled = colour if side == "b" else "none"
        ax.plot(1 + np.arange(len(values)), values, "o", ms=3.6, mew=0.9, mec=colour, mfc=filled)
        said.append(f"{side.upper()}: {len(values)} values, ratio {number(values[0] / values[-1])}")
    log_y(ax)
    ax.set_xlim(left=0)
    whole_ticks(ax)
    ax.set_xlabel("direction in parameter space, best seen first")
    absolute = any(f"{side}/eigenvalues_final" in series for side in "ab")
    label_y(ax, "singular value [N·m]" if absolute else "singular value [–]")
    caption = (
        "Singular values of both observation matrices: the motion whose weakest, on the right, "
        "lies higher leaves less uncertain; first over last is the condition number."
    )
    legend = [Key("dot" if s == "b" else "ring", COLOURS[s], s.upper()) for s in found]
    return Figure((panel(ax, f"singular values; {'; '.join(said)}"),), caption, tuple(legend))


def _spectrum(series: Series, side: str) -> Array | None:
    squares = curve(series, f"{side}/eigenvalues_final")
    values = curve(series, f"{side}/singular_values") if squares is None else squares
    if values is None:
        return None
    kept = np.sort(values[np.isfinite(values) & (values > 0)])[::-1]
    return (np.sqrt(kept) if squares is not None else kept) if len(kept) else None


def _stems(
    rows: Sequence[Mapping[str, Any]], key: str, alike: float, colour: Callable[[float], str]
) -> Axes:
    """A named line per row, from the value of runs that agree to its own, ending in a dot."""
    (ax,) = axes(0.62 + 0.22 * len(rows), left=1.75)
    for k, row in enumerate(rows):
        x = float(row[key])
        ax.plot([alike, x], [k, k], color=LIGHT, lw=1.4, zorder=1)
        ax.plot(x, k, "o", ms=5, color=colour(x))
    ax.set_ylim(len(rows) - 0.4, -0.6)
    names = [shorten(leader(text(row, "name")), 24) for row in rows]
    ax.set_yticks(range(len(rows)), names, fontsize=8)
    return ax


def deviation_figure(rows: Sequence[Mapping[str, Any]]) -> Figure | None:
    """How many standard deviations the estimates of two runs lie apart, the furthest first."""
    shown = [row for row in rows if real(row, "deviations") is not None][:_MOST]
    if not shown:
        return None
    ax = _stems(shown, "deviations", 0.0, lambda z: GREEN if z > APART else LIGHT)
    ax.axvspan(0, APART, color="#eceff1", lw=0, zorder=0)
    ax.set_xlim(0, max(1.6 * APART, 1.08 * max(float(row["deviations"]) for row in shown)))
    ax.set_xlabel("difference [standard deviations]", x=0.3)
    said = ", ".join(f"{leader(text(r, 'name'))} {number(r['deviations'], 2)}" for r in shown[:3])
    caption = (
        f"The {len(shown)} estimates that lie furthest apart, in standard deviations of their "
        "difference: inside the grey band, two runs agree."
    )
    drawing = panel(ax, f"difference of estimates in standard deviations, furthest: {said}")
    legend = (Key("dot", GREEN, "apart"), Key("dot", LIGHT, "within their uncertainty"))
    return Figure((drawing,), caption, legend)


def precision_figure(rows: Sequence[Mapping[str, Any]]) -> Figure | None:
    """Standard deviation of each base parameter with the one motion over the other's."""
    shown = [row for row in rows if abs((real(row, "ratio") or 1.0) - 1.0) > _ALIKE][:_MOST]
    if not shown:
        return None
    ax = _stems(shown, "ratio", 1.0, lambda ratio: GREEN if ratio < 1 else PURPLE)
    ax.axvline(1, color="#8a8f94", lw=0.7)
    log_x(ax)
    ax.set_xlabel("std of B over std of A [–]", x=0.3)
    said = ", ".join(f"{leader(text(r, 'name'))} {percent(r['ratio'])}" for r in shown[:3])
    caption = (
        f"The {len(shown)} base parameters whose standard deviation differs most: left of one, B "
        "determines them better, right of it A does."
    )
    legend = (Key("dot", GREEN, "B is surer"), Key("dot", PURPLE, "A is surer"))
    return Figure((panel(ax, f"standard deviation of B over A: {said}"),), caption, legend)
