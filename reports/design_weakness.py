"""What a designed motion shows worst: base parameters and combinations of them."""

from __future__ import annotations

import numpy as np

from excitant.reports.design_figures import BEFORE_AFTER
from excitant.reports.drawing import FITTED, GIVEN, LIGHT, axes, log_x, panel
from excitant.reports.model import Cell, Figure, Key, Table, table
from excitant.reports.reading import Result, at, real, reals, records, text
from excitant.reports.wording import combination, number, shorten


def weakest_figure(result: Result) -> Figure | None:
    """Torque that only the weakest base parameters explain, before and after the design."""
    rows = [r for r in records(result, "weakest") if (real(r, "information_final") or 0) > 0]
    if not rows:
        return None
    (ax,) = axes(0.62 + 0.22 * len(rows), left=1.75)
    for k, row in enumerate(rows):
        before, after = (real(row, f"information_{key}") or 0.0 for key in ("initial", "final"))
        if before > 0:
            ax.plot([before, after], [k, k], color=LIGHT, lw=1.6, zorder=1)
            ax.plot(before, k, "o", ms=5, mec=GIVEN, mfc="white", mew=1.1)
        ax.plot(after, k, "o", ms=5, color=FITTED)
    log_x(ax)
    ax.set_ylim(len(rows) - 0.4, -0.6)
    ax.set_yticks(range(len(rows)), [shorten(text(row, "name"), 27) for row in rows], fontsize=8)
    ax.set_xlabel("torque of its own [N·m per SI unit]", x=0.25)
    started = any((real(row, "information_initial") or 0) > 0 for row in rows)
    legend = [
        Key("dot" if key == "final" else "ring", colour, name)
        for key, colour, name in BEFORE_AFTER
        if started or key == "final"
    ]
    worst = [f"{text(row, 'name')} {number(real(row, 'information_final'))}" for row in rows[:3]]
    caption = (
        f"The {len(rows)} base parameters that the designed motion shows worst, each by the torque "
        "per unit that no other parameter can imitate (root mean square over the motion): "
        "far left means an uncertain estimate. Fv is viscous and Fc Coulomb friction, Ia the "
        "rotor's inertia."
    )
    label = f"torque that only one parameter explains; least: {', '.join(worst)}"
    return Figure((panel(ax, label),), caption, tuple(legend))


def weakest_table(result: Result) -> Table | None:
    """The weakest base parameters in full, with the standard deviation to expect."""
    rows: list[list[Cell | str]] = []
    for row in records(result, "weakest"):
        unit = text(row, "unit")
        noise = [at(row, f"std_per_unit_noise_{key}") for key in ("initial", "final")]
        rows.append(
            [text(row, "expression"), *(number(x) for x in noise), unit, number(at(row, "value"))]
        )
    if not rows:
        return None
    weights = reals(result, "joint_weights")
    equal = not len(weights) or bool(np.all(weights == weights[0]))
    weighted = "" if equal else " (joints differ as their noise given for the design)"
    return table(
        "expression:Base parameter | number:Std at start | number:Std designed | name:Unit | "
        "number:Value in the model",
        rows,
        "Standard deviation (std) by least squares from one period at 100 Hz, or 1000 samples if "
        f"more, for white torque noise of 1 N·m{weighted}; it grows with the noise.",
        "The same parameters in full, with the standard deviation to expect",
    )


def direction_table(result: Result) -> Table | None:
    """The combinations of base parameters that show worst, before and after."""
    rows: list[list[Cell | str]] = []
    for key, name in (("final", "designed motion"), ("initial", "start of the search")):
        for row in records(result, "weak_directions", key):
            own, other = number(at(row, "strength")), number(at(row, "other"))
            before, after = (other, own) if key == "final" else (own, other)
            rows.append([name, combination(row), before, after])
    if not rows:
        return None
    return table(
        "text:Worst seen by the | expression:Combination of base parameters | "
        "number:Torque at start [N·m] | number:Torque designed [N·m]",
        rows,
        "Combinations by which torque changes least (the weakest right singular vectors of W), and "
        "by how much: members with a weight below 0.3 are behind the dots.",
    )
