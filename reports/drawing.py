"""Drawing with Matplotlib, imported with the first figure: one style, compact SVG for a page.

All panels have one width, so that letters have the same size everywhere. Colours are those of
Okabe and Ito (2008), which the colour-blind can tell apart.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from excitant.reports import page
from excitant.reports.page import Key, Panel
from excitant.reports.values import power_of_ten
from excitant.robots.motion import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.figure import Figure

MEASURED = "#4d4d4d"
GIVEN = "#d55e00"
FITTED = "#0072b2"
GREEN = "#009e73"
PURPLE = "#b0558f"
AMBER = "#e69f00"
SKY = "#3a93c9"
LIGHT = "#b9bdc2"
BAND = "#c3dcec"
DASHED = (0, (5, 3))

WIDTH = 3.9  # inch: 281 pt, which a phone shows a little larger than drawn
_LEFT = 0.64
_RIGHT = 0.12
_TOP = 0.1
_BOTTOM = 0.42  # inch
_BINS = 200
_TITLE = 0.26
_COLUMNS = 2
_EVEN = 1e-6  # of a sheet: room above a panel [inch], columns
_EDGE = 0.12  # inch: between panels
_LETTER = 0.065  # inch: width of one in a legend
_LINE = 46  # letters of an abscissa's name that surely fit below it

_STYLE: Any = {
    "svg.fonttype": "none",
    "svg.hashsalt": "excitant",
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans", "Verdana"],  # alike in width
    "font.size": 9,
    "text.parse_math": False,
    "text.usetex": False,
    "text.color": "#222222",
    "axes.labelcolor": "#444444",
    "axes.labelsize": 9,
    "axes.edgecolor": "#8a8f94",
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.unicode_minus": True,
    "grid.color": "#e4e6e8",
    "grid.linewidth": 0.6,
    "xtick.color": "#444444",
    "ytick.color": "#444444",
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "xtick.bottom": False,
    "ytick.left": False,
    "xtick.minor.bottom": False,
    "ytick.minor.left": False,
    "lines.solid_capstyle": "round",
    "lines.linewidth": 1.1,
}


_open: ContextVar[ExitStack | None] = ContextVar("style of drawings", default=None)
_sheet: ContextVar[Sheet | None] = ContextVar("where drawings go", default=None)


@contextmanager
def style() -> Iterator[None]:
    """The report's style over Matplotlib's defaults, from the first drawing inside to the end."""
    with ExitStack() as stack:
        token = _open.set(stack)
        try:
            yield
        finally:
            _open.reset(token)


def _begin() -> None:
    import matplotlib as mpl

    stack = _open.get()
    if stack is not None:
        stack.enter_context(mpl.rc_context())
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        _open.set(None)


def axes(
    height: float,
    ratios: Sequence[float] = (1,),
    left: float = _LEFT,
    top: float = _TOP,
    space: float = 0.16,
    shared: bool = True,
) -> list[Axes]:
    """Axes with one abscissa if shared, heights in these ratios [inch]; ``space`` as share."""
    sheet = _sheet.get()
    if sheet is not None:
        height = height + _TITLE
        top = top + _TITLE
    if sheet is not None and sheet.onto is not None:
        sheet.panels.append(([sheet.onto], height, ""))
        return [sheet.onto]
    _begin()
    from matplotlib.figure import Figure

    from excitant.reports.light_axes import LightAxes

    figure = Figure(figsize=(WIDTH, height)) if sheet is None else sheet.blank(height)
    grid = figure.subplots(
        len(ratios),
        1,
        sharex=shared,
        squeeze=False,
        subplot_kw={"axes_class": LightAxes} if sheet is None else None,
        gridspec_kw={
            "height_ratios": list(ratios),
            "left": left / WIDTH,
            "right": 1 - _RIGHT / WIDTH,
            "top": 1 - top / height,
            "bottom": _BOTTOM / height,
            "hspace": space,
        },
    )
    found: list[Axes] = list(grid[:, 0])
    for ax in found:
        few_ticks(ax.yaxis, 4)
        few_ticks(ax.xaxis, 6)
        ax.yaxis.set_major_formatter(_tick)
        ax.xaxis.set_major_formatter(_tick)
    if sheet is not None:
        sheet.panels.append((found, height, ""))
    return found


def ink(colour: str) -> str:
    """A darker shade of a colour, for words: these need more contrast than lines do."""
    return "#" + "".join(
        f"{round(0.7 * int(colour[k : k + 2], 16)):02x}" for k in (1, 3, 5)
    )


def equal_axes(ax: Axes, low: Array, high: Array, room: float) -> float:
    """One scale that shows ``room`` times the box of two corners; the shorter side [m]."""
    frame = ax.get_window_extent()
    size = np.array([frame.width, frame.height])
    half = 0.5 * room * float(np.max(np.maximum(high - low, 1e-3) / size)) * size
    middle = (low + high) / 2
    ax.set_xlim(middle[0] - half[0], middle[0] + half[0])
    ax.set_ylim(middle[1] - half[1], middle[1] + half[1])
    return 2 * float(half.min())


def label_y(ax: Axes, words: str) -> None:
    """Name the ordinate at a fixed distance, so that panels line up."""
    ax.set_ylabel(words)
    if (sheet := _sheet.get()) is not None and sheet.onto is not None:
        return
    box = ax.get_position()
    ax.yaxis.set_label_coords((0.13 / WIDTH - box.x0) / box.width, 0.5)


def label_x(ax: Axes, words: str) -> None:
    """Name the abscissa, in two lines where one is too short; the axes make room."""
    lines = textwrap.wrap(words, _LINE)
    ax.set_xlabel("\n".join(lines), linespacing=1.1)
    room = 0.15 * (len(lines) - 1) / _figure(ax).get_figheight()
    box = ax.get_position()
    ax.set_position((box.x0, box.y0 + room, box.width, box.height - room))


def over_time(ax: Axes, t: Array, ordinate: str = "") -> None:
    """Make the abscissa time t [s] and name the ordinate."""
    ax.set_xlim(t[0], t[-1])
    ax.set_xlabel("time [s]")
    if ordinate:
        label_y(ax, ordinate)


def percent_x(ax: Axes) -> None:
    """Label the abscissa, which holds shares, in per cent."""
    ax.xaxis.set_major_formatter(lambda x, _: f"{100 * x:.6g}\u00a0%" if x else "0")


def log_y(ax: Axes) -> None:
    """Make the ordinate logarithmic, with powers of ten or plain numbers as labels."""
    from matplotlib.ticker import LogLocator, NullLocator

    ax.set_yscale("log")
    lower, upper = sorted(ax.get_ylim())
    decades = math.log10(upper / lower) if lower > 0 else 1.0
    ax.yaxis.set_major_locator(
        LogLocator(subs=(1.0,) if decades > 2 else (1.0, 2.0, 5.0))
    )
    ax.yaxis.set_minor_locator(NullLocator())
    ax.yaxis.set_major_formatter(_log_tick)


def _tick(value: float, _position: float | None = None) -> str:
    if abs(value) < 1e-12:
        return "0"
    if 1e-3 <= abs(value) < 1e5:
        return f"{value:.6g}".replace("-", "−")
    exponent = math.floor(math.log10(abs(value)) + 1e-9)
    return f"{value / 10.0**exponent:.3g}×{power_of_ten(exponent)}".replace("-", "−")


def _log_tick(value: float, _position: float | None = None) -> str:
    exponent = round(math.log10(value)) if value > 0 else 0
    if value > 0 and abs(exponent) > 3 and math.isclose(value, 10.0**exponent):
        return power_of_ten(exponent)
    return f"{value:g}"


def _figure(ax: Axes) -> Figure:
    return cast("Figure", ax.get_figure(root=True))


def panel(ax: Axes, label: str, title: str = "") -> Panel:
    """The finished drawing that holds these axes."""
    if (sheet := _sheet.get()) is not None:
        sheet.panels[-1] = (*sheet.panels[-1][:2], title)
        return Panel("", label, title)
    figure = _figure(ax)
    for each in figure.axes:
        for artist in (*each.lines, *each.patches, *each.collections):
            artist.set_clip_on(False)
    return Panel(_svg(figure, label), label, title)


class Sheet:
    """Panels of figures as axes of one figure of pyplot, or one panel in axes that exist.

    Attributes:
        onto: Axes to draw into, in their own style; None for a new figure in that of the pages.
        panels: Axes, height [inch] and title of each panel.
    """

    def __init__(self, onto: Axes | None = None) -> None:
        self.onto = onto
        self.panels: list[tuple[list[Axes], float, str]] = []
        self._figure: Figure | None = None

    def blank(self, height: float) -> Figure:
        """The figure, for now of the size of the next panel, which is drawn into it."""
        from matplotlib import pyplot

        self._figure = self._figure or pyplot.figure()
        self._figure.set_size_inches(WIDTH, height)
        return self._figure

    def drawn(self, draw: Callable[[], page.Figure | None]) -> list[Axes]:
        """All axes of what a function draws for a page, with legend and titles; none without."""
        token = _sheet.set(self)
        try:
            with style():
                figure = draw()
                if figure is not None and self.onto is not None:
                    self.onto.legend(handles=list(map(_handle, figure.legend)))
                    self.onto.set_title(figure.panels[0].title)
                elif figure is not None and self._figure is not None:
                    self._arrange(self._figure, figure.legend)
        finally:
            _sheet.reset(token)
        return [ax for axes, _, _ in self.panels for ax in axes]

    def _arrange(self, figure: Figure, legend: Sequence[Key]) -> None:
        """Place the panels in columns, one after the other, below the legend."""
        columns = min(len(self.panels), _COLUMNS)
        longest = 0.6 + _LETTER * max((len(key.label) for key in legend), default=0)
        abreast = max(1, int(columns * WIDTH / longest))
        strip = 0.2 * math.ceil(len(legend) / abreast) + 0.1 * bool(legend)
        total = sum(height for _, height, _ in self.panels)
        ends = [0.0] * columns
        places = []
        done = 0.0
        for axes, height, title in self.panels:
            column = min(
                int(columns * (done + height / 2) / total - _EVEN), columns - 1
            )
            places.append((axes, height, title, column, ends[column]))
            ends[column] = ends[column] + height
            done = done + height
        width = columns * (WIDTH + _EDGE)
        tall = strip + max(ends)
        figure.set_size_inches(width, tall)
        for axes, height, title, column, above in places:
            x = column * WIDTH + (column + 0.5) * _EDGE
            y = tall - strip - above  # of its corner
            for ax in axes:
                box = ax.get_position()
                low = (x + box.x0 * WIDTH) / width, (y - (1 - box.y0) * height) / tall
                ax.set_position(
                    (*low, box.width * WIDTH / width, box.height * height / tall)
                )
            at = (x + 0.1) / width, (y - 0.06) / tall
            figure.text(*at, title, va="top", fontsize=9.5, fontweight="bold")
        if legend:
            handles = list(map(_handle, legend))
            figure.legend(
                handles=handles, ncols=abreast, loc="upper left", frameon=False
            )
        figure.draw_without_rendering()  # which makes ticks in this style


def _handle(key: Key) -> Any:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    if key.mark == "box":
        return Patch(color=key.colour, label=key.label)
    looks: dict[str, dict[str, Any]] = {
        "line": {},
        "dash": {"ls": DASHED},
        "dot": {"ls": "", "marker": "o"},
        "ring": {"ls": "", "marker": "o", "mfc": "none"},
    }
    return Line2D([], [], color=key.colour, label=key.label, **looks[key.mark])


def single(
    ax: Axes, label: str, caption: str, legend: Sequence[Key] = (), title: str = ""
) -> page.Figure:
    """A figure of one drawing."""
    return page.Figure((panel(ax, label, title),), caption, tuple(legend))


def _svg(figure: Figure, label: str) -> str:
    from excitant.reports.svg import svg

    return svg(figure, label)


def timeline(t: Array) -> tuple[Array, list[int]]:
    """Time of joined recordings, each after the one before, and the first row of each later one."""
    step = np.diff(t)
    joins = [int(k) + 1 for k in np.flatnonzero(step <= 0)]
    usual = float(np.median(step[step > 0])) if (step > 0).any() else 1.0
    step[step <= 0] = usual
    start = t[0] if abs(t[0]) < 1e5 else 0.0
    return start + np.concatenate([[0.0], np.cumsum(step)]), joins


def thin(x: Array, y: Array, bins: int = _BINS) -> tuple[Array, Array]:
    """A curve (n,) with fewer points that looks the same: each bin's least and greatest value."""
    if len(y) <= 2 * bins:
        return x, y
    size = -(-len(y) // bins)
    padded = np.full(-(-len(y) // size) * size, np.nan)
    padded[: len(y)] = y
    rows = padded.reshape(-1, size)
    first = size * np.arange(len(rows))
    least = first + np.where(np.isnan(rows), np.inf, rows).argmin(axis=1)
    greatest = first + np.where(np.isnan(rows), -np.inf, rows).argmax(axis=1)
    keep = np.unique([0, *least, *greatest, len(y) - 1])
    return x[keep], y[keep]


def few_ticks(axis: Any, count: int, **look: Any) -> None:
    """Label an axis at no more than so many round numbers."""
    from matplotlib.ticker import MaxNLocator

    axis.set_major_locator(MaxNLocator(count, steps=[1, 2, 2.5, 5, 10], **look))


def draw_curve(ax: Axes, t: Array, joins: Sequence[int], y: Array, **look: Any) -> None:
    """A curve over time, broken where recordings were joined."""
    for first, last in zip([0, *joins], [*joins, len(t)], strict=True):
        share = max(20, round(_BINS * (last - first) / len(t)))
        ax.plot(*thin(t[first:last], y[first:last], share), **look)
