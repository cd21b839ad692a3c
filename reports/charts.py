"""Figures as JSON, which the script of a page draws with uPlot."""

import json
from base64 import b64encode
from typing import Any

import numpy as np
from markupsafe import Markup

from excitant.reports.figure import Axes, Band, Figure, Line, Mark, thinned
from excitant.robots.motion import Array

_SAMPLES = 200_000  # of all curves of a figure; longer ones are thinned
_ENDS = ("low", "high")


def packed(figure: Figure) -> Markup:
    """A figure as JSON for a script element; what many marks share is in it once."""
    stacks = [panel.axes for panel in figure.panels]
    marks = [mark for axes in stacks for one in axes for mark in one.marks]
    curves = sum(isinstance(mark, Line | Band) for mark in marks)
    bins = max(2, _SAMPLES // max(1, 2 * curves))
    arrays: list[Any] = []
    places: dict[bytes, int] = {}

    def entries(value: Axes | Mark | Array) -> Any:
        if isinstance(value, Axes):
            return {
                "x": vars(value.x) | dict(zip(_ENDS, value.ends("x"), strict=True)),
                "y": vars(value.y) | dict(zip(_ENDS, value.ends("y"), strict=True)),
                "height": value.height,
                "marks": value.marks,
            }
        if not isinstance(value, np.ndarray):
            kind = type(value).__name__.lower()
            return {"kind": kind} | vars(thinned(value, bins))
        place = places.setdefault(value.tobytes(), len(arrays))
        if place == len(arrays):
            arrays.append(_steps(value))
        return place

    panels = [
        {"shared": panel.shared, "axes": panel.axes} for panel in figure.panels
    ]
    content = {"panels": panels, "arrays": arrays}
    text = json.dumps(
        content, default=entries, separators=(",", ":"), ensure_ascii=False
    )
    return Markup(text.replace("<", "\\u003c"))


def _steps(values: Array) -> dict[str, Any]:
    """Numbers as 16-bit steps from the least, -32768 for NaN."""
    finite = np.isfinite(values)
    low = float(values[finite].min()) if finite.any() else 0.0
    high = float(values[finite].max()) if finite.any() else 0.0
    step = (high - low) / 65534 or 1.0
    steps = np.round((np.where(finite, values, low) - low) / step) - 32767
    k = np.where(finite, steps, -32768)
    return {
        "low": low,
        "step": step,
        "k": b64encode(k.astype("<i2").tobytes()).decode(),
    }
