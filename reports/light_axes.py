"""Axes for drawings that are written once: Matplotlib's, but without artists for each tick.

Matplotlib takes two thirds of the time of axes with a few curves for its ticks, each of which is
five artists that may be changed later. Here grid lines and labels are drawn straight from locator
and formatter. Import this where Matplotlib may be imported.
"""

from __future__ import annotations

from typing import Any, Literal

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis, Tick, XAxis, YAxis
from matplotlib.path import Path
from matplotlib.text import Text
from matplotlib.transforms import IdentityTransform

from excitant.robots.motion import Array

_OUTSIDE = 0.5  # pixels by which a tick may lie outside the axes
_PADDING = 7.0  # pt between the axes and the labels of ticks


class _LightAxis(Axis):
    """An axis that draws its grid, labels and name, and keeps no ticks.

    It heeds locators, formatters and ``tick_params`` (``labelbottom``, ``labelleft``,
    ``labelsize``, ``gridOn``). Labels stand below or on the left of the axes.
    """

    majorTicks: list[Tick] = []  # noqa: N815, RUF012  # Matplotlib's name; never appended to
    minorTicks: list[Tick] = []  # noqa: N815, RUF012

    def get_major_ticks(self, numticks: int | None = None) -> list[Tick]:
        return []

    def get_minor_ticks(self, numticks: int | None = None) -> list[Tick]:
        return []

    def get_ticks_position(self) -> Literal["default"]:
        return "default"

    def get_tightbbox(self, *_: Any, **__: Any) -> Any:
        return None

    def draw(self, renderer: Any) -> None:
        if not self.get_visible():
            return
        below = isinstance(self, XAxis)
        ax = self.axes
        look = self.get_tick_params()
        along = 0 if below else 1
        values = self.get_majorticklocs()
        ends = np.empty((len(values), 2, 2))
        ends[:, :, along] = np.reshape(values, (-1, 1))
        ends[:, :, 1 - along] = (0.0, 1.0)
        transform = ax.get_xaxis_transform() if below else ax.get_yaxis_transform()
        ends = np.reshape(transform.transform(ends.reshape(-1, 2)), ends.shape)
        low = ax.bbox.min[along] - _OUTSIDE
        high = ax.bbox.max[along] + _OUTSIDE
        seen = (ends[:, 0, along] >= low) & (ends[:, 0, along] <= high)
        if look["gridOn"] and seen.any():
            _draw_lines(renderer, ends[seen])
        if look.get("labelbottom" if below else "labelleft", True):
            words = np.array(
                self.get_major_formatter().format_ticks(list(values)), dtype=object
            )
            size = look.get("labelsize", mpl.rcParams["xtick.labelsize"])
            self._draw_words(renderer, ends[seen, 0], words[seen], size, below)
        self.label.draw(renderer)

    def _draw_words(
        self, renderer: Any, at: Array, words: Any, size: float, below: bool
    ) -> None:
        """Labels at points on the edge of the axes, shape (n, 2), and below them the name."""
        text = Text(color=mpl.rcParams["xtick.color"], fontsize=size)
        text.set(
            ha="center" if below else "right", va="top" if below else "center_baseline"
        )
        text.set_figure(self.get_figure(root=True))  # type: ignore[arg-type]
        apart = renderer.points_to_pixels(_PADDING) * np.array([not below, below])
        for point, said in zip(at - apart, words, strict=True):
            text.set_position(point)
            text.set_text(said)
            text.draw(renderer)
        if below and len(words):
            beneath = text.get_window_extent(renderer).y0 - renderer.points_to_pixels(
                self.labelpad
            )
            self.label.set_position((self.label.get_position()[0], beneath))


def _draw_lines(renderer: Any, ends: Array) -> None:
    """Lines of the grid by their ends, shape (n, 2, 2) [pixels]."""
    context = renderer.new_gc()
    context.set_foreground(mpl.rcParams["grid.color"])
    context.set_linewidth(renderer.points_to_pixels(mpl.rcParams["grid.linewidth"]))
    path = Path(ends.reshape(-1, 2), [Path.MOVETO, Path.LINETO] * len(ends))
    renderer.draw_path(context, path, IdentityTransform())
    context.restore()


class _LightX(_LightAxis, XAxis):
    pass


class _LightY(_LightAxis, YAxis):
    pass


class LightAxes(Axes):
    """Matplotlib's axes, the ticks of which are drawn in one go and cannot be changed one by one.

    Source: SkewXAxes in Matplotlib's gallery, which exchanges an axis in the same way.
    """

    def _init_axis(self) -> None:
        self.xaxis, self.yaxis = _LightX(self, clear=False), _LightY(self, clear=False)
        for side, axis in (("bottom", self.xaxis), ("left", self.yaxis)):
            self.spines[side].register_axis(axis)
            self.spines[side].set_position(("outward", 0))  # which a tick would do
