"""Light axes look as Matplotlib's own do, drawn to pixels."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from excitant.reports import drawing as draw
from excitant.reports.light_axes import LightAxes

X = np.linspace(-3.0, 17.0, 50)


def curves(first: Axes, last: Axes) -> None:
    first.plot(X, 300 * np.sin(X))
    draw.label_y(first, "torque [N·m]")
    draw.over_time(last, X, "residual [N·m]")


def densities(first: Axes, last: Axes) -> None:
    for ax in (first, last):
        ax.plot(X, np.exp(X / 3))
        draw.log_y(ax)
    last.set_xlabel("frequency [Hz]", labelpad=1)


def categories(first: Axes, last: Axes) -> None:
    first.set_title("above", loc="left")
    last.set_yticks(range(3), ["one", "two", "three"])
    last.tick_params(axis="y", labelsize=8)
    last.set_ylim(2.6, -0.6)
    last.grid(visible=False, axis="y")
    draw.percent_x(last)
    draw.label_x(last, "a name of the abscissa that is too long to be written in one line only")


def no_frame(first: Axes, last: Axes) -> None:
    first.axis("off")
    last.set_xticks([])
    last.spines["left"].set_visible(False)


@pytest.mark.parametrize("content", [curves, densities, categories, no_frame])
@pytest.mark.parametrize("shared", [True, False])
def test_they_look_as_those_of_matplotlib(
    content: Callable[[Axes, Axes], None], shared: bool
) -> None:
    seen = []
    for kind in (Axes, LightAxes):
        with draw.style():
            draw.axes(1.0)  # which begins the style
            figure = Figure(figsize=(4, 4), dpi=100)
            canvas = FigureCanvasAgg(figure)
            both = figure.subplots(2, 1, sharex=shared, subplot_kw={"axes_class": kind})
            figure.subplots_adjust(left=0.2, hspace=0.5)
            for ax in both:
                draw.few_ticks(ax.xaxis, 6)
                draw.few_ticks(ax.yaxis, 4)
            content(*both)
            canvas.draw()
            seen.append(np.asarray(canvas.buffer_rgba(), float)[..., :3].mean(axis=2))
    theirs, ours = seen
    differs, drawn = np.abs(ours - theirs) > 20, theirs < 240
    assert drawn.sum() > 500
    assert differs.sum() < 0.05 * drawn.sum()  # a line of the grid on the edge is not clipped
