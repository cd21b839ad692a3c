"""Figures as JSON, which the script of a page draws with uPlot."""

from __future__ import annotations

import dataclasses
import json
from base64 import b64encode
from typing import Any

import numpy as np
from markupsafe import Markup

from excitant.reports.figure import Axes, Band, Figure, Line, Mark, thin
from excitant.robots.motion import Array

_SAMPLES = 200_000  # of all curves of a figure; longer ones are thinned
_SHORT = 8  # values that are written as numbers
_DIGITS = 7
_ENDS = ("low", "high")


def packed(figure: Figure) -> Markup:
    """A figure as JSON for a script element; what many marks share is in it once."""
    axes = [one for panel in figure.panels for one in panel.axes]
    curves = [
        mark for one in axes for mark in one.marks if isinstance(mark, Line | Band)
    ]
    most = max(2, _SAMPLES // max(1, 2 * len(curves)))
    store = _Store(most)
    content = {
        "panels": [
            {
                "shared": panel.shared,
                "axes": [store.axes(one) for one in panel.axes],
            }
            for panel in figure.panels
        ],
        "arrays": store.arrays,
    }
    text = json.dumps(content, separators=(",", ":"), ensure_ascii=False)
    return Markup(text.replace("<", "\\u003c"))


class _Store:
    """Arrays of a figure, each once; curves have at most 2 ``bins`` points."""

    def __init__(self, bins: int) -> None:
        self.arrays: list[Any] = []
        self._bins = bins
        self._places: dict[bytes, int] = {}

    def axes(self, axes: Axes) -> dict[str, Any]:
        return {
            "x": vars(axes.x) | dict(zip(_ENDS, axes.ends("x"), strict=True)),
            "y": vars(axes.y) | dict(zip(_ENDS, axes.ends("y"), strict=True)),
            "height": axes.height,
            "marks": [self._mark(mark) for mark in axes.marks],
        }

    def _mark(self, mark: Mark) -> dict[str, Any]:
        if isinstance(mark, Line):
            x, y = thin(mark.x, mark.y, self._bins)
            mark = dataclasses.replace(mark, x=x, y=y)
        elif isinstance(mark, Band) and len(mark.x) > 2 * self._bins:
            rows = np.linspace(0, len(mark.x) - 1, self._bins).astype(int)
            low = np.fmin.reduceat(mark.low, rows)
            high = np.fmax.reduceat(mark.high, rows)
            mark = dataclasses.replace(mark, x=mark.x[rows], low=low, high=high)
        entries: dict[str, Any] = {"kind": type(mark).__name__.lower()}
        for field in dataclasses.fields(mark):
            value = getattr(mark, field.name)
            if isinstance(value, np.ndarray):
                entries[field.name] = self._place(value)
            elif value != field.default:
                entries[field.name] = value
        return entries

    def _place(self, values: Array) -> int:
        """Number of an array in the store."""
        key = values.tobytes()
        if key not in self._places:
            self._places[key] = len(self.arrays)
            self.arrays.append(_numbers(values))
        return self._places[key]


def _numbers(values: Array) -> list[float | None] | dict[str, Any]:
    """Numbers with null for NaN; many as 16-bit steps from the least, -32768 for NaN."""
    finite = np.isfinite(values)
    if len(values) <= _SHORT:
        return [
            float(f"{x:.{_DIGITS}g}") if ok else None
            for x, ok in zip(values, finite, strict=True)
        ]
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
