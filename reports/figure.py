"""A figure as data: panels of axes with marks, which a page and Matplotlib draw alike.

Colours are named by what they stand for. They are those of Okabe and Ito (2008), which the
colour-blind can tell apart, and lighter ones on dark ground.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from excitant.robots.motion import Array

COLOURS = {  # on light, on dark ground
    "measured": ("#4d4d4d", "#c6ccd2"),
    "given": ("#d55e00", "#ef8a45"),
    "fitted": ("#0072b2", "#57b0ea"),
    "green": ("#009e73", "#3cc79b"),
    "purple": ("#b0558f", "#d88cbd"),
    "amber": ("#e69f00", "#e9b23f"),
    "sky": ("#3a93c9", "#7cc4ef"),
    "cloud": ("#9aa0a6", "#7f8891"),
    "band": ("#c3dcec", "#234a63"),
    "zero": ("#8a8f94", "#7b848c"),
    "ink": ("#1d2125", "#e4e7ea"),
    "paper": ("#ffffff", "#16191c"),
}
MEASURED = "measured"
GIVEN = "given"
FITTED = "fitted"
GREEN = "green"
PURPLE = "purple"
AMBER = "amber"
SKY = "sky"
CLOUD = "cloud"
BAND = "band"
ZERO = "zero"

MARGIN = 0.04  # of the extent of the marks: room on either side of them
EPOCH = 1e5  # s from which on times count from an epoch, and are drawn from zero


@dataclass(frozen=True, eq=False)
class Line:
    """A curve through points x, y of shape (n,), broken where NaN stands; width in points."""

    x: Array
    y: Array
    colour: str
    name: str = ""
    width: float = 1.1


@dataclass(frozen=True, eq=False)
class Points:
    """Points x, y of shape (n,); ``size`` is their diameter [pt].

    A ``ring`` is empty, a ``hole`` filled with the ground's colour, a ``cloud`` faint.
    """

    x: Array
    y: Array
    colour: str
    name: str = ""
    size: float = 4.0
    style: Literal["dot", "ring", "hole", "cloud"] = "dot"


@dataclass(frozen=True, eq=False)
class Band:
    """What lies between two curves over x, all of shape (n,)."""

    x: Array
    low: Array
    high: Array


@dataclass(frozen=True)
class Span:
    """A faint strip across the whole axes, between two values of the ordinate."""

    low: float
    high: float
    colour: str


@dataclass(frozen=True)
class Rule:
    """A line across the whole axes, at a value of the axis ``along``."""

    at: float
    colour: str = ZERO
    along: Literal["x", "y"] = "y"
    dashed: bool = False


Mark = Line | Points | Band | Span | Rule


@dataclass(frozen=True)
class Axis:
    """Name with unit, ends (None: those of the marks with a margin) and scale of an axis.

    Ticks are values with their names; without any, the writer places them.
    """

    label: str = ""
    low: float | None = None
    high: float | None = None
    log: bool = False
    whole: bool = False
    ticks: Sequence[tuple[float, str]] = ()


@dataclass(frozen=True, eq=False)
class Axes:
    """Marks over two axes, of a height on the page [px].

    Attributes:
        title: Heading on the left, in its colour.
        remark: Heading on the right.
    """

    marks: Sequence[Mark]
    x: Axis
    y: Axis
    height: int = 170
    title: str = ""
    remark: str = ""
    colour: str = "ink"

    def ends(self, along: Literal["x", "y"]) -> tuple[float, float]:
        """Least and greatest value shown along an axis."""
        axis = self.x if along == "x" else self.y
        if axis.low is not None and axis.high is not None:
            return axis.low, axis.high
        values = np.concatenate(
            [np.empty(0), *(_along(m, along) for m in self.marks)]
        )
        values = values[np.isfinite(values)]
        if axis.log:
            values = np.log10(values[values > 0])
        low = float(values.min()) if len(values) else 0.0
        high = float(values.max()) if len(values) else 1.0
        room = MARGIN * (high - low) or 0.5 * abs(high) or 1.0
        low = low - room
        high = high + room
        if axis.log:
            low = 10.0**low
            high = 10.0**high
        return (
            low if axis.low is None else axis.low,
            high if axis.high is None else axis.high,
        )


def _along(mark: Mark, along: str) -> Array:
    match mark:
        case Band() if along == "y":
            return np.concatenate([mark.low, mark.high])
        case Line() | Points() | Band():
            return np.asarray(getattr(mark, along), float)
        case Span() if along == "y":
            return np.array([mark.low, mark.high])
        case Rule() if mark.along == along:
            return np.array([mark.at])
    return np.empty(0)


@dataclass(frozen=True, eq=False)
class Panel:
    """Axes above each other, with one abscissa if ``shared``; the label says what they show."""

    axes: Sequence[Axes]
    label: str
    title: str = ""
    shared: bool = True


@dataclass(frozen=True)
class Key:
    """One item of a legend: a mark (``line``, ``dash``, ``box``, ``dot``, ``ring``) in a colour."""

    mark: str
    colour: str
    label: str


@dataclass(frozen=True, eq=False)
class Figure:
    """Panels beside each other that share a legend; the caption says what to see."""

    panels: Sequence[Panel]
    caption: str
    legend: Sequence[Key] = ()


def figure(
    panels: Sequence[Panel | None], caption: str, legend: Sequence[Key] = ()
) -> Figure | None:
    """A figure of the panels that have data; None without any."""
    present = list(filter(None, panels))
    return Figure(present, caption, legend) if present else None


@dataclass(frozen=True, eq=False)
class Timeline:
    """Time of joined recordings, each after the one before, and curves broken where they join."""

    t: Array
    joins: tuple[int, ...]

    @classmethod
    def of(cls, t: Array) -> Timeline:
        """From times [s], which run back where a recording ends; from zero if of an epoch."""
        step = np.diff(t)
        joins = tuple(int(k) + 1 for k in np.flatnonzero(step <= 0))
        usual = float(np.median(step[step > 0])) if (step > 0).any() else 1.0
        step[step <= 0] = usual
        start = t[0] if abs(t[0]) < EPOCH else 0.0
        time = start + np.concatenate([[0.0], np.cumsum(step)])
        return cls(np.insert(time, joins, time[list(joins)]), joins)

    def broken(self, values: Array) -> Array:
        """Values at these times, NaN where recordings join."""
        return np.insert(np.asarray(values, float), self.joins, np.nan)

    def axis(self, label: str = "time [s]") -> Axis:
        """The abscissa from the first to the last time."""
        return Axis(label, float(self.t[0]), float(self.t[-1]))


def bars(low: Array, high: Array) -> Array:
    """A coordinate of a curve of bars, NaN after the ends of each, shape (n,) to (3 n,)."""
    return np.column_stack([low, high, np.full_like(low, np.nan)]).ravel()


def thinned(mark: Mark, bins: int) -> Mark:
    """A curve or band with fewer points that looks the same, any other mark as it is.

    Of each bin the least and the greatest value is kept; a band has half as many bins.
    """
    match mark:
        case Line():
            names = ["y"]
        case Band():
            names = ["low", "high"]
            bins = bins // 2
        case _:
            return mark
    if len(mark.x) <= 2 * bins:
        return mark
    keep = [0, len(mark.x) - 1]
    for values in (getattr(mark, name) for name in names):
        low = np.nan_to_num(values, nan=np.inf)
        high = np.nan_to_num(values, nan=-np.inf)
        for first, last in pairwise(np.linspace(0, len(low), bins + 1).astype(int)):
            keep.append(first + int(low[first:last].argmin()))
            keep.append(first + int(high[first:last].argmax()))
    rows = np.unique(keep)
    return replace(
        mark, **{name: getattr(mark, name)[rows] for name in ("x", *names)}
    )
