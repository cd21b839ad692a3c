"""Figures drawn by Matplotlib, for notebooks, scripts and files."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from excitant.reports.figure import (
    COLOURS,
    Axes,
    Band,
    Figure,
    Key,
    Line,
    Mark,
    Panel,
    Points,
    Rule,
    Span,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Drawn
    from matplotlib.figure import Figure as Sheet

_COLUMNS = 2
_WIDTH = 4.2  # inch: panel
_PIXELS = 88  # px of a page for an inch
_HEADING = 0.3  # inch: title of a panel
_TICK = 35  # px of a page for a tick of the ordinate
_LETTER = 0.065  # inch: width of one in a legend
_FAINT = 0.13  # opacity of a strip
_DASHED = (0, (5, 3))
_STYLE: Any = {
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.linewidth": 0.7,
    "axes.edgecolor": "#8a8f94",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e4e6e8",
    "grid.linewidth": 0.6,
    "text.parse_math": False,
}


def draw(figure: Figure) -> list[Drawn]:
    """All axes of a figure, in one new figure of pyplot with a panel beside the other."""
    import matplotlib as mpl
    from matplotlib import pyplot

    columns = min(len(figure.panels), _COLUMNS)
    rows = [
        figure.panels[k : k + columns]
        for k in range(0, len(figure.panels), columns)
    ]
    heights = [max(map(_height, row)) for row in rows]
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        size = (columns * _WIDTH, sum(heights) + 0.25 * len(figure.legend) ** 0.5)
        sheet = pyplot.figure(figsize=size, layout="constrained")
        grid = sheet.add_gridspec(len(rows), columns, height_ratios=heights)
        drawn = []
        for k, panel in enumerate(figure.panels):
            place = grid[k // columns, k % columns]
            drawn += _draw_panel(panel, sheet, place)
        _draw_legend(sheet, figure.legend, columns * _WIDTH)
        sheet.draw_without_rendering()  # which makes ticks in this style
    return drawn


def draw_onto(ax: Drawn, figure: Figure) -> None:
    """The only axes of a figure, in axes that exist and in their style."""
    (panel,) = figure.panels
    (axes,) = panel.axes
    _draw_axes(axes, ax)
    ax.set_title(panel.title)
    ax.legend(handles=list(map(_handle, figure.legend)))


def _height(panel: Panel) -> float:
    return _HEADING + sum(axes.height for axes in panel.axes) / _PIXELS


def _draw_panel(panel: Panel, sheet: Sheet, place: Any) -> list[Drawn]:
    heights = [axes.height for axes in panel.axes]
    grid = place.subgridspec(len(heights), 1, height_ratios=heights)
    drawn: list[Drawn] = []
    for k, axes in enumerate(panel.axes):
        above = drawn[0] if panel.shared and drawn else None
        ax = sheet.add_subplot(grid[k], sharex=above)
        _draw_axes(axes, ax)
        inner = panel.shared and k < len(heights) - 1
        ax.tick_params(axis="x", labelbottom=not inner)
        drawn.append(ax)
    if panel.title:
        raised = 17 if panel.axes[0].title or panel.axes[0].remark else 4
        drawn[0].annotate(
            panel.title,
            (0, 1),
            (0, raised),
            xycoords="axes fraction",
            textcoords="offset points",
            fontweight="bold",
            annotation_clip=False,
        )
    return drawn


def _draw_legend(sheet: Sheet, legend: Sequence[Key], width: float) -> None:
    if legend:
        longest = 0.6 + _LETTER * max(len(key.label) for key in legend)
        sheet.legend(
            handles=list(map(_handle, legend)),
            ncols=max(1, int(width / longest)),
            loc="outside upper left",
            frameon=False,
        )


def _draw_axes(axes: Axes, ax: Drawn) -> None:
    for k, mark in enumerate(axes.marks):
        _draw_mark(mark, ax, 2 + 0.01 * k)
    for along, axis, scale in (("x", axes.x, ax.xaxis), ("y", axes.y, ax.yaxis)):
        if axis.log:
            getattr(ax, f"set_{along}scale")("log")
        elif axis.ticks:
            at, names = zip(*axis.ticks, strict=True)
            scale.set_ticks(at, names)
        else:
            from matplotlib.ticker import MaxNLocator

            count = 6 if along == "x" else min(5, axes.height // _TICK)
            scale.set_major_locator(
                MaxNLocator(count, steps=[1, 2, 2.5, 5, 10], integer=axis.whole)
            )
        if axis.label:
            getattr(ax, f"set_{along}label")(axis.label)
    ax.set_xlim(*axes.ends("x"))
    ax.set_ylim(*axes.ends("y"))
    ax.set_title(axes.title, loc="left", color=COLOURS[axes.colour][0])
    ax.set_title(axes.remark, loc="right", color="#5a626a")


def _draw_mark(mark: Mark, ax: Drawn, order: float) -> None:
    match mark:
        case Line():
            colour = COLOURS[mark.colour][0]
            ax.plot(mark.x, mark.y, color=colour, lw=mark.width, zorder=order)
        case Points():
            _draw_points(mark, ax, order)
        case Band():
            look: Any = {"color": COLOURS["band"][0], "lw": 0, "zorder": order}
            ax.fill_between(mark.x, mark.low, mark.high, **look)
        case Span():
            look = {"color": COLOURS[mark.colour][0], "lw": 0, "zorder": order}
            ax.axhspan(mark.low, mark.high, alpha=_FAINT, **look)
        case Rule():
            rule = ax.axvline if mark.along == "x" else ax.axhline
            stroke: Any = _DASHED if mark.dashed else "-"
            rule(mark.at, color=COLOURS[mark.colour][0], lw=0.9, ls=stroke)


def _draw_points(mark: Points, ax: Drawn, order: float) -> None:
    colour = COLOURS[mark.colour][0]
    if mark.style == "cloud":
        look: Any = {"s": mark.size**2, "c": colour, "alpha": 0.35, "lw": 0}
        ax.scatter(mark.x, mark.y, zorder=order, rasterized=True, **look)
        return
    fill = {"dot": colour, "ring": "none", "hole": "white"}[mark.style]
    look = {"ms": mark.size, "mec": colour, "mfc": fill, "color": colour}
    ax.plot(mark.x, mark.y, "o", zorder=order, **look)


def _handle(key: Key) -> Any:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    colour = COLOURS[key.colour][0]
    if key.mark == "box":
        return Patch(color=colour, label=key.label)
    looks: dict[str, dict[str, Any]] = {
        "line": {},
        "dash": {"ls": _DASHED},
        "dot": {"ls": "", "marker": "o"},
        "ring": {"ls": "", "marker": "o", "mfc": "none"},
    }
    return Line2D([], [], color=colour, label=key.label, **looks[key.mark])
