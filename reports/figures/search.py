"""What a motion shows, and how a design was found."""

from __future__ import annotations

import numpy as np

from excitant.reports import values as v
from excitant.reports.figure import (
    AMBER,
    FITTED,
    GIVEN,
    LIGHT,
    MEASURED,
    Axes,
    Axis,
    Figure,
    Key,
    Line,
    Mark,
    Panel,
    Points,
    Rule,
)
from excitant.reports.values import Series
from excitant.results import Design
from excitant.robots.motion import Array

_ENDS = (
    ("initial", GIVEN, "start of the search"),
    ("final", FITTED, "designed motion"),
)
_LOG_RATIO = 8  # of condition numbers from which on their axis is logarithmic


def spectrum_figure(series: Series) -> Figure | None:
    """Singular values of the observation matrix, before and after a design, greatest first."""
    spectra = [
        (key, np.sqrt(sizes), colour, name)
        for key, colour, name in _ENDS
        if len(sizes := _positive(series, f"eigenvalues_{key}"))
    ]
    designed = bool(spectra)
    if not designed and len(sizes := _positive(series, "singular_values")):
        spectra = [("final", sizes, MEASURED, "this motion")]
    if not spectra:
        return None
    marks: list[Mark] = []
    ratios = []
    legend = []
    for key, sizes, colour, name in spectra:
        final = key == "final"
        order = np.arange(1, len(sizes) + 1, dtype=float)
        marks.append(
            Points(order, sizes, colour, name, 3.6, "dot" if final else "ring")
        )
        ratio = v.number(sizes[0] / sizes[-1])
        ratios.append(f"{name}: {len(sizes)} values, ratio {ratio}")
        legend.append(Key("dot" if final else "ring", colour, name))
    unit = "N·m" if designed else "–"
    direction = Axis(
        "direction in parameter space, best seen first", 0.0, whole=True
    )
    axes = Axes(marks, direction, Axis(f"singular value [{unit}]", log=True), 190)
    caption = (
        "Singular values of the observation matrix W/√n, the torque that each direction of the "
        "base parameters makes; the ratio of the first to the last is the condition number."
        if designed
        else "Singular values of the normalised observation matrix: estimates along directions far "
        "below the others are uncertain."
    )
    panel = Panel((axes,), f"singular values; {'; '.join(ratios)}")
    return Figure((panel,), caption, legend * designed)


def _positive(series: Series, key: str) -> Array:
    values = v.curve(series, key)
    return np.empty(0) if values is None else np.sort(values[values > 0])[::-1]


def convergence_figure(result: Design) -> Figure | None:
    """Condition number over the iterations of each start; the best start stands out."""
    every = [(row.status, v.reals(row.history)) for row in result.starts]
    known = [(status, h[np.isfinite(h)]) for status, h in every]
    starts = [(status, h) for status, h in known if len(h) > 1]
    if not starts:
        return None
    ends = [h[-1] for _, h in starts]
    best = int(np.argmin(ends))
    marks: list[Mark] = []
    for k, (_, history) in sorted(
        enumerate(starts), key=lambda pair: pair[0] == best
    ):
        colour = FITTED if k == best else LIGHT
        iteration = np.arange(len(history), dtype=float)
        name = f"start {k + 1}"
        width = 1.6 if k == best else 1.0
        marks.append(Line(iteration, history, colour, name, width))
        marks.append(Points(iteration[-1:], history[-1:], colour, name, 3.0))
    legend = [Key("line", FITTED, "best start")]
    legend += [Key("line", LIGHT, "other starts")] * (len(starts) > 1)
    bound = result.condition_number.lower_bound
    if bound is not None and bound > 0:
        marks.append(Rule(bound, AMBER, dashed=True))
        legend.append(Key("dash", AMBER, "proven lower bound"))
    reached: Array = np.concatenate([h for _, h in starts])
    log = bool(reached.min() > 0 and reached.max() > _LOG_RATIO * reached.min())
    ordinate = Axis("condition number [–]", log=log)
    axes = Axes(marks, Axis("iteration", 0.0, whole=True), ordinate, 180)
    caption = "Each start of the optimisation, a dot where it ended: several that end at the same "
    caption += "value suggest that a much better motion does not exist."
    if cut := sum(status == "time limit" for status, _ in starts):
        caption += f" The time limit ended {cut} of these {len(starts)}: more time may find better."
    label = (
        f"condition number over iterations of {len(starts)} starts; "
        f"best ends at {v.number(ends[best])}"
    )
    return Figure((Panel((axes,), label),), caption, legend)
