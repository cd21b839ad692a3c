"""What a motion shows."""

import numpy as np

from excitant.reports import values as v
from excitant.reports.figure import (
    FITTED,
    GIVEN,
    MEASURED,
    Axes,
    Axis,
    Figure,
    Key,
    Mark,
    Panel,
    Points,
)
from excitant.reports.values import Series
from excitant.robots.motion import Array

_ENDS = (
    ("initial", GIVEN, "start of the search"),
    ("final", FITTED, "designed motion"),
)


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
