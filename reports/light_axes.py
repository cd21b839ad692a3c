"""Axes for drawings that are written once: Matplotlib's, but without artists for each tick.

Matplotlib takes two thirds of the time of axes with a few curves for its ticks, each of which is
five artists that may be changed later. Here grid lines and labels are drawn straight from locator
and formatter. Import this where Matplotlib may be imported.
"""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import XAxis, YAxis
from matplotlib.path import Path
from matplotlib.text import Text
from matplotlib.transforms import IdentityTransform

_OUTSIDE = 0.5  # pixels by which a tick may lie outside the axes
_PADDING = 7.0  # pt between the axes and the labels of ticks


class _LightAxis:
    """An axis that draws its grid, labels and name, and keeps no ticks.

    It understands the locators, formatters and ``tick_params`` of Matplotlib; labels are below or
    on the left of the axes.
    """

    majorTicks = minorTicks = ()  # noqa: N815  # Matplotlib's names

    def get_major_ticks(self, numticks: int | None = None) -> list[Any]:
        return []

    get_minor_ticks = get_major_ticks

    def get_ticks_position(self) -> str:
        return "default"

    def get_tightbbox(self, *_: Any, **__: Any) -> None:
        return None

    def draw(self: Any, renderer: Any) -> None:
        if not self.get_visible():
            return
        name, ax, look = self.axis_name, self.axes, self.get_tick_params()
        k = "xy".index(name)  # its coordinate
        values = self.get_majorticklocs()
        ends = np.empty((len(values), 2, 2))
        ends[:, :, k], ends[:, :, 1 - k] = np.reshape(values, (-1, 1)), (0.0, 1.0)
        transform = ax.get_xaxis_transform() if name == "x" else ax.get_yaxis_transform()
        ends = transform.transform(ends.reshape(-1, 2)).reshape(ends.shape)
        low, high = ax.bbox.min[k] - _OUTSIDE, ax.bbox.max[k] + _OUTSIDE
        seen = (ends[:, 0, k] >= low) & (ends[:, 0, k] <= high)
        if look["gridOn"] and seen.any():
            self._draw_lines(renderer, ends[seen])
        if look.get("labelbottom" if name == "x" else "labelleft", True):
            words = np.array(self.major.formatter.format_ticks(values), dtype=object)
            size = look.get("labelsize", mpl.rcParams[f"{name}tick.labelsize"])
            self._draw_words(renderer, ends[seen, 0], words[seen], size)
        self.label.draw(renderer)
        self.stale = False

    def _draw_lines(self: Any, renderer: Any, ends: Any) -> None:
        context = renderer.new_gc()
        context.set_foreground(mpl.rcParams["grid.color"])
        context.set_linewidth(renderer.points_to_pixels(mpl.rcParams["grid.linewidth"]))
        codes = [Path.MOVETO, Path.LINETO] * len(ends)
        renderer.draw_path(context, Path(ends.reshape(-1, 2), codes), IdentityTransform())
        context.restore()

    def _draw_words(self: Any, renderer: Any, at: Any, words: Any, size: float) -> None:
        """Labels at points on the edge of the axes, and the name of an abscissa moved below."""
        below = self.axis_name == "x"
        way = np.array([0, 1] if below else [1, 0])
        text = Text(
            color=mpl.rcParams[f"{self.axis_name}tick.color"],
            ha="center" if below else "right",
            va="top" if below else "center_baseline",
            fontsize=size,
        )
        text.set_figure(self.get_figure(root=False))
        for point, said in zip(at - renderer.points_to_pixels(_PADDING) * way, words, strict=True):
            text.set_position(point)
            text.set_text(said)
            text.draw(renderer)
        if below and len(words):
            lowest = text.get_window_extent(renderer).y0
            x, _ = self.label.get_position()
            self.label.set_position((x, lowest - renderer.points_to_pixels(self.labelpad)))


class _LightX(_LightAxis, XAxis):
    pass


class _LightY(_LightAxis, YAxis):
    pass


class LightAxes(Axes):
    """Matplotlib's axes, the ticks of which are drawn in one go and cannot be changed one by one.

    Source: SkewXAxes of Matplotlib's gallery, which exchanges the axis in the same way.
    """

    def _init_axis(self) -> None:
        self.xaxis, self.yaxis = _LightX(self, clear=False), _LightY(self, clear=False)
        for side, axis in (("bottom", self.xaxis), ("left", self.yaxis)):
            self.spines[side].register_axis(axis)
            self.spines[side].set_position(("outward", 0))  # which a tick would do
