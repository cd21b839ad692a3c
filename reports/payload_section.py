"""What the arm carries: mass, centre of mass and inertia of the payload, and how sure they are."""

from __future__ import annotations

import numpy as np
from matplotlib.patches import Ellipse

from excitant.reports.drawing import FITTED, GIVEN, MEASURED, axes, label_y, panel
from excitant.reports.model import (
    FAIR,
    GOOD,
    Block,
    Cell,
    Fact,
    Facts,
    Figure,
    Key,
    Notes,
    Panel,
    Table,
    table,
)
from excitant.reports.reading import Result, at, real, reals, records, text, words
from excitant.reports.wording import NONE, number, quantity, value_and_std
from excitant.robots.motion import Array
from excitant.robots.parameters import pseudo_inertia

_VIEWS = ((0, 2), (0, 1))  # side and top: coordinates across and up
_BAND = 2.0  # standard deviations
_FRAME = 0.35  # of the drawing: length of the frame's axes
_ROOM = 0.12  # of the drawing: margin around what it shows
_UNIFORM = 5.0  # squared semi-axis of a uniform ellipsoid over its variance

Parts = list[tuple[str, list[Block | None]]]


def payload_parts(result: Result) -> Parts:
    """Parts of the page that `identify --payload` adds; none without its result."""
    payload = at(result, "payload")
    if payload is None:
        return []
    notes, lacking = words(payload, "notes"), words(payload, "shortcomings")
    return [
        (
            "Payload",
            [
                _facts(payload),
                Notes(tuple(_sentence(each) for each in lacking), FAIR) if lacking else None,
                Notes(tuple(_sentence(each) for each in notes)) if notes else None,
                _drawing(payload),
                _parameters(payload),
            ],
        )
    ]


def _sentence(words: str) -> str:
    return words[:1].upper() + words[1:] + ("" if words.endswith(".") else ".")


def _facts(payload: Result) -> Facts | None:
    mass, spread = value_and_std(at(payload, "mass", "value"), at(payload, "mass", "std"))
    m, s = real(payload, "mass", "value"), real(payload, "mass", "std")
    facts = [
        Fact(
            "Mass",
            f"{mass} ± {spread}\u00a0kg",
            f"one standard deviation; held by {text(payload, 'link')}",
            "" if m is None or s is None else GOOD if _BAND * s <= 0.02 * abs(m) else FAIR,
        )
    ]
    centre, std = (1e3 * reals(payload, "centre_of_mass", key) for key in ("value", "std"))
    for k, (c, each) in enumerate(zip(centre, std, strict=False)):
        value, spread = value_and_std(c, each)
        facts.append(
            Fact(
                f"Centre of mass, {'xyz'[k]}",
                f"{value} ± {spread}\u00a0mm",
                "in the frame of its joint",
                GOOD if _BAND * each <= 3 else FAIR,
            )
        )
    return Facts(tuple(facts)) if m is not None else None


def _parameters(payload: Result) -> Table | None:
    rows: list[list[Cell | str]] = [
        [
            text(row, "name"),
            *value_and_std(at(row, "value"), at(row, "std")),
            text(row, "unit") or NONE,
            "expectation" if at(row, "prior_dominated") is True else "data",
        ]
        for row in records(payload, "parameters")
    ]
    if not rows:
        return None
    return table(
        "name:Parameter | number:Value | number:Std | name:Unit | text:Value comes from",
        rows,
        "Standard parameters of the body about the frame of its joint, physically consistent. "
        "Those that come from the expectation (a ball at the flange) were not seen in the motion.",
    )


def _phi(payload: Result) -> Array | None:
    values = [real(row, "value") for row in records(payload, "parameters")]
    if len(values) != 10 or any(value is None for value in values):
        return None
    phi = np.array(values, float)
    return phi if phi[0] > 0 else None


def _drawing(payload: Result) -> Figure | None:
    phi, std = _phi(payload), reals(payload, "centre_of_mass", "std")
    mass, spread = (real(payload, "mass", key) or 0.0 for key in ("value", "std"))
    if phi is None or std.shape != (3,) or not np.isfinite(std).all() or mass < _BAND * spread:
        return None
    panels = tuple(_view(phi, std, across, up) for across, up in _VIEWS)
    caption = (
        "The payload in the frame of its joint, from the side and from above: the centre of mass "
        "with a cross of ± 2 standard deviations, and the uniform ellipsoid of the same mass and "
        "inertia, which shows about how large the body is. Axes of the frame start at the joint."
    )
    legend = (
        Key("dot", GIVEN, "centre of mass, ± 2 standard deviations"),
        Key("box", "#c3dcec", "uniform ellipsoid of the same inertia"),
        Key("line", MEASURED, "frame of the joint"),
    )
    return Figure(panels, caption, legend)


def _view(phi: Array, std: Array, across: int, up: int) -> Panel:
    P = pseudo_inertia(phi)
    centre = P[:3, 3] / phi[0]
    S = (P[:3, :3] / phi[0] - np.outer(centre, centre))[np.ix_([across, up], [across, up])]
    variance, turn = np.linalg.eigh(S)
    semi = np.sqrt(_UNIFORM * np.maximum(variance, 0))
    c, s = centre[[across, up]], _BAND * std[[across, up]]
    reach = np.array([np.sqrt(_UNIFORM * max(S[k, k], 0)) for k in range(2)])
    low, high = (np.minimum(0, c - np.maximum(reach, s)), np.maximum(0, c + np.maximum(reach, s)))
    size = max(float((high - low).max()), 0.02)
    low, high = low - _ROOM * size, np.maximum(high, 1.2 * _FRAME * size)
    (ax,) = axes(3.0)
    angle = float(np.degrees(np.arctan2(turn[1, 1], turn[0, 1])))
    ax.add_patch(
        Ellipse(
            (c[0], c[1]), 2 * semi[1], 2 * semi[0], angle=angle, fc="#c3dcec", ec=FITTED, lw=0.9
        )
    )
    for tip, name in (((_FRAME * size, 0), "xyz"[across]), ((0, _FRAME * size), "xyz"[up])):
        ax.annotate("", tip, (0, 0), arrowprops={"arrowstyle": "->", "color": MEASURED, "lw": 1.2})
        ax.text(1.1 * tip[0], 1.1 * tip[1], name, ha="center", va="center", color=MEASURED)
    ax.errorbar(c[0], c[1], xerr=s[0], yerr=s[1], fmt="o", ms=4, color=GIVEN, lw=1.2, capsize=2)
    middle = (low + high) / 2
    box = ax.get_window_extent()
    scale = 1.06 * float(max((high - low) / (box.width, box.height)))
    ax.set_xlim(middle[0] - scale * box.width / 2, middle[0] + scale * box.width / 2)
    ax.set_ylim(middle[1] - scale * box.height / 2, middle[1] + scale * box.height / 2)
    ax.set_xlabel(f"{'xyz'[across]} [m]")
    label_y(ax, f"{'xyz'[up]} [m]")
    said = ", ".join(
        f"{'xyz'[k]} {quantity(1e3 * centre[k], 'mm')} ± {number(1e3 * std[k], 2)}"
        for k in (across, up)
    )
    title = "from the side" if up == 2 else "from above"
    return panel(ax, f"payload {title}: centre of mass {said}", title)
