"""Where the given model's error shows, and what wrong inertias alone would explain."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.patches import Rectangle

from excitant.reports.drawing import FITTED, GIVEN, axes, panel
from excitant.reports.model import Block, Cell, Figure, Notes, Panel, Table, table
from excitant.reports.reading import Result, at, real, records, text, words
from excitant.reports.torque_figures import waterfall
from excitant.reports.wording import listing, number, percent, plain, quantity, shorten
from excitant.robots.motion import Array

_DOMAINS = ("constant", "direction", "velocity", "position", "load", "reversal", "time")
_BANDS = ("slower", "motion", "faster")
_ROW, _GAP = 0.29, 0.35  # inch, cells
_LEFT, _TOP, _BELOW, _LEAST = 1.3, 0.64, 0.06, 0.4  # inch
_DARK = 0.55  # share from which on letters are white
_STEPS = 12  # of the waterfall that are drawn one by one


def given_error_blocks(result: Result, unit: str, changed: bool = True) -> list[Block | None]:
    """What is wrong with the given model: where it shows, what inertias alone would explain.

    Args:
        result: Of a diagnosis.
        unit: Of the torque.
        changed: Whether the extended model differs; else only the given one is shown.
    """
    return [
        share_figure(result, unit, changed),
        _sentence(result),
        _refit_table(result, unit),
        _moves_table(result),
        *forward_blocks(result, changed),
    ]


def share_figure(result: Result, unit: str, changed: bool = True) -> Figure | None:
    """Joints by quantities: share of the squared error, as given and left over."""
    joints = records(result, "error", "joints")
    if not joints:
        return None
    given, left = _values(joints, left=False), _values(joints, left=True)
    panels = [_panel(joints, given, "model as given", GIVEN, unit)]
    if changed:
        panels.append(_panel(joints, left, "left by the extended model", FITTED, unit))
    caption = (
        "Percentage of each joint's squared error that goes with one quantity alone; the simplest "
        "that tells it is framed: an offset, the direction of motion (dry friction), velocity "
        "(viscous friction), position (springs, ripple), load (gain, load-dependent friction), "
        "distance since the last reversal (hysteresis, play) or time (drift). Shares overlap. "
        "The last three columns divide the error by frequency: slower than the motion, as fast, "
        "faster. A dash: not judged. "
    )
    said = "Orange is what the model misses, blue what is left when everything found is added; its "
    caption += said if changed else "The "
    caption += "rms stands beside each row, over rows at which the joint moves."
    return Figure(tuple(panels), caption)


def _values(joints: list[Result], left: bool) -> Array:
    """Shares, shape (joints, quantities); NaN where not judged."""
    rows = []
    for joint in joints:
        source = at(joint, "left") if left else joint
        found = [real(source, "shares", name) for name in _DOMAINS]
        found += [real(source, "bands", name) for name in _BANDS]
        rows.append([float("nan") if x is None else x for x in found])
    return np.array(rows, dtype=float)


def _panel(joints: list[Result], values: Array, title: str, colour: str, unit: str) -> Panel:
    count, columns = values.shape
    height = max(_ROW * count, _LEAST) + _TOP + _BELOW
    (ax,) = axes(height, left=_LEFT, top=_TOP)
    box = ax.get_position()
    rows = _ROW * count / height
    ax.set_position((box.x0, 1 - _TOP / height - rows, box.width, rows))
    ax.grid(False)
    for side in ax.spines.values():
        side.set_visible(False)
    left = colour == FITTED
    for row, joint in enumerate(joints):
        source = at(joint, "left") if left else joint
        said = f"{shorten(text(joint, 'name'), 20)}\n{_size(joint, source, unit)}"
        ax.text(-0.15, row + 0.5, said, ha="right", va="center", fontsize=7.2, linespacing=1.05)
        telling = text(source, "telling")
        for column in range(columns):
            name = (*_DOMAINS, *_BANDS)[column]
            _cell(ax, column, row, float(values[row, column]), colour, name == telling)
    for column, name in enumerate((*_DOMAINS, *_BANDS)):
        ax.text(_at(column) + 0.35, -0.12, name, rotation=50, ha="left", va="bottom", fontsize=7.5)
    ax.set_xlim(0, _at(columns - 1) + 1)
    ax.set_ylim(count, 0)
    ax.set_xticks([])
    ax.set_yticks([])
    worst = "; ".join(f"{text(j, 'name')} by {text(j, 'telling') or 'unknown'}" for j in joints)
    return panel(ax, f"share of the squared error by quantity, {title}: {worst}", title)


def _size(joint: Result, source: object, unit: str) -> str:
    """Error of one row, and for what is left its part of the given model's."""
    before, after = real(joint, "rms"), real(source, "rms")
    said = quantity(after, unit, 2)
    if source is joint or not before or after is None:
        return said
    return f"{said}, {percent(after / before)} of it"


def _at(column: int) -> float:
    return column + (_GAP if column >= len(_DOMAINS) else 0.0)


def _cell(ax: Axes, column: int, row: int, share: float, colour: str, framed: bool) -> None:
    known = bool(np.isfinite(share))
    depth = float(np.clip(share, 0, 1)) if known else 0.0
    mixed = [1 - depth * (1 - part) for part in to_rgb(colour)]
    box = (_at(column) + 0.03, row + 0.05)
    ax.add_patch(
        Rectangle(
            box, 0.94, 0.9, facecolor=mixed, edgecolor="#222222" if framed else "#d8dadd",
            lw=1.5 if framed else 0.5, zorder=3 if framed else 2,
        )
    )  # fmt: skip
    said = "–" if not known else f"{100 * share:.0f}" if share < 9.995 else ">999"
    ax.text(
        _at(column) + 0.5, row + 0.52, said, ha="center", va="center", fontsize=7, zorder=4,
        color="white" if depth > _DARK else "#222222", fontweight="bold" if framed else "normal",
    )  # fmt: skip


def _sentence(result: Result) -> Notes | None:
    said = text(result, "refit", "sentence")
    return Notes((said,)) if said else None


def _refit_table(result: Result, unit: str) -> Table | None:
    rows: list[list[Cell | str]] = [
        [
            text(row, "name"),
            *(number(at(row, key)) for key in ("given", "inertias", "bodies", "extended")),
        ]
        for row in records(result, "refit", "joints")
    ]
    if not rows:
        return None
    return table(
        f"name:Joint | number:Given, rms [{unit}] | number:Inertias free, rms [{unit}] | "
        f"number:Nearest bodies, rms [{unit}] | number:With the findings, rms [{unit}]",
        rows,
        "What inertias alone would explain on the hold-out, all given effects kept, while joints "
        "move: fitted freely, and as the closest bodies that positive mass can have.",
        "What re-fitting the inertias alone would bring, joint by joint",
    )


def _moves_table(result: Result) -> Table | None:
    rows: list[list[Cell | str]] = []
    for row in records(result, "refit", "links"):
        factor = real(row, "inertia")
        rows.append(
            [
                text(row, "link"),
                *(
                    value
                    for key, part in (("mass_kg", "mass"), ("centre_mm", "centre"))
                    for value in (number(at(row, key)), number(at(row, "deviations", part), 2))
                ),
                number(None if factor is None else 100 * (np.exp(factor) - 1), 2),
                number(at(row, "deviations", "inertia"), 2),
            ]
        )
    if not rows:
        return None
    return table(
        "name:Link | number:Mass [kg] | number:in std | number:Centre of mass [mm] | "
        "number:in std | number:Inertia [%] | number:in std",
        rows,
        "How far each link would have to move for that, most moved first; a given value is taken "
        "as right to two of these standard deviations.",
        "Which link would have to move, and how far",
    )


def forward_blocks(result: Result, changed: bool = True) -> list[Block | None]:
    """Both models simulated forward under the recorded torque."""
    models = ("given", "extended") if changed else ("given",)
    rows: list[list[Cell | str]] = [
        [
            text(row, "name"),
            *(_milli(row, key) for key in models),
            *(_milli(at(row, "velocity"), key) for key in models),
        ]
        for row in records(result, "forward", "joints")
    ]
    if not rows:
        return []
    notes = words(result, "forward", "notes")
    joints = records(result, "forward", "joints")
    units = listing(list(dict.fromkeys(text(joint, "unit") for joint in joints)))
    count, length = (real(result, "forward", key) for key in ("windows", "window_s"))
    loop = quantity(at(result, "forward", "bandwidth_hz"), "Hz", 1)
    caption = (
        f"Simulated forward under the recorded torque over {count or 0:.0f} windows of "
        f"{quantity(length, 's', 2)} of the hold-out: rms by which the model leaves the recorded "
        f"motion, held on it by {'the same' if changed else 'a'} loop of {loop}."
    )
    caption += f" {_closer(joints)}" if changed else ""
    heads = [f"number:Position, {model} [m{units}]" for model in models]
    heads += [f"number:Velocity, {model} [m{units}/s]" for model in models]
    return [
        table(
            " | ".join(["name:Joint", *heads]),
            rows,
            caption,
        ),
        Notes(tuple(notes)) if notes else None,
    ]


def _closer(joints: list[Result]) -> str:
    """On which joints the extended model does not stay closer to the motion."""
    worse = [
        text(joint, "name")
        for joint in joints
        if (given := real(joint, "given")) is not None
        and (real(joint, "extended") or float("inf")) > given
    ]
    if not worse:
        return "The extended model stays closer on every joint."
    return (
        f"The extended model is no closer at {listing(worse)}: there its dry friction near "
        "rest, or what it has too much of, moves the joint more than what was found helps."
    )


def _milli(row: Result, key: str) -> str:
    value = real(row, key)
    return "diverges" if value is None else number(1e3 * value)


def step_figure(result: Result) -> Figure | None:
    """Error after each cause, the smaller ones at the end as one step."""
    steps = [
        (_step(text(row, "label")), rms)
        for row in records(result, "waterfall")
        if (rms := real(row, "rms")) is not None
    ]
    small = len(steps) - _STEPS
    if small > 1:
        merged = (f"+ {small} smaller causes", steps[-2][1])
        steps = [*steps[: _STEPS - 1], merged, steps[-1]]
    return waterfall(
        steps,
        "Error on the hold-out after each effect that was added, every joint relative to the "
        "model as given: long grey pieces are effects that matter.",
    )


def _step(label: str) -> str:
    effect, at_, joints = label.partition(" at ")
    return plain(effect) + at_ + joints
