"""A link's place in the chain, and how base parameters go together."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.colors import LinearSegmentedColormap

from excitant.reports.drawing import FITTED, GIVEN, LIGHT, MEASURED, axes, panel
from excitant.reports.model import Figure, Key
from excitant.reports.reading import Series
from excitant.robots.motion import Array

_FLAT = 0.05  # of the arm's extent: below it there is nothing to see in that direction
_MARGIN = 0.09
_NEGATIVE, _POSITIVE = FITTED, GIVEN
_COLOURS = LinearSegmentedColormap.from_list("signed", [_NEGATIVE, "#ffffff", _POSITIVE])


def side_view(chain: Array) -> tuple[Array, str]:
    """An arm in the plane that shows most of it, upright where it has any height.

    Args:
        chain: Points of base, joints and tip, shape (points, 3) [m].

    Returns:
        Points in the picture, shape (points, 2), and the view in words.
    """
    size = float(np.ptp(chain, axis=0).max())
    level = chain[:, :2] - chain[:, :2].mean(axis=0)
    along = np.linalg.svd(level)[2][0]
    along = along * np.sign(along[np.argmax(np.abs(along))])
    if np.ptp(chain[:, 2]) > _FLAT * size:
        return np.column_stack([chain[:, :2] @ along, chain[:, 2]]), "from the side"
    return chain[:, :2], "from above"


def chain_figure(series: Series, index: int, name: str, caption: str) -> Figure | None:
    """The arm as a line with one link in colour.

    Args:
        series: With ``chain``, points of base, joints and tip, shape (nv + 2, 3) [m].
        index: Which link, from 0.
        name: Of the link.
        caption: One sentence that says what to see.
    """
    chain = _chain(series)
    if chain is None or index + 2 >= len(chain):
        return None
    points, view = side_view(chain)
    (ax,) = axes(1.75, left=0.12)
    ax.plot(*points.T, color=LIGHT, lw=4, solid_joinstyle="round")
    ax.plot(*points[1:-1].T, "o", ms=4.2, mec=MEASURED, mfc="white", mew=1.0)
    own = points[index + 1 : index + 3]
    ax.plot(*own.T, color=FITTED, lw=5.5, zorder=3)
    ax.plot(*own[0], "o", ms=6.5, mec="white", mfc=FITTED, mew=1.0, zorder=4)
    _ground(ax, points)
    legend = [Key("line", FITTED, "this link"), Key("dot", FITTED, "its joint")]
    if np.ptp(own, axis=0).max() < 0.01 * np.ptp(points, axis=0).max():
        caption += " It has no length in this view: the next joint lies at the same place."
        legend = legend[1:]
    return Figure((panel(ax, f"{name} in the chain, {view}"),), caption, tuple(legend))


def _ground(ax: Any, points: Array) -> None:
    """Equal scales without axes, and a mark for the base."""
    low, high = points.min(axis=0), points.max(axis=0)
    size = max(float((high - low).max()), 1e-9)
    width = 0.06 * size
    ax.plot(points[0, 0] + np.array([-width, width]), points[[0, 0], 1], color=MEASURED, lw=3)
    ax.set_xlim(low[0] - _MARGIN * size, high[0] + _MARGIN * size)
    ax.set_ylim(low[1] - _MARGIN * size, high[1] + _MARGIN * size)
    ax.set_aspect("equal", adjustable="box", anchor="C")
    ax.axis("off")
    ax.set_position((0.03, 0.03, 0.94, 0.94))


def _chain(series: Series) -> Array | None:
    values = series.get("chain")
    if values is None or not np.issubdtype(np.asarray(values).dtype, np.number):
        return None
    chain = np.asarray(values, float)
    right = chain.ndim == 2 and chain.shape[1] == 3 and len(chain) > 2
    return chain if right and np.isfinite(chain).all() else None


def correlation_figure(series: Series) -> Figure | None:
    """Correlations of the base parameters as a map of colours."""
    values = series.get("correlation")
    if values is None or not np.issubdtype(np.asarray(values).dtype, np.number):
        return None
    matrix = np.asarray(values, float)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or not matrix.size:
        return None
    r = len(matrix)
    (ax,) = axes(3.75, left=0.42)
    ends = (0.5, r + 0.5)
    ax.imshow(
        np.nan_to_num(matrix), cmap=_COLOURS, vmin=-1, vmax=1, interpolation="nearest",
        extent=(*ends, *ends[::-1]), aspect="equal",
    )  # fmt: skip
    ax.grid(visible=False)
    ax.set_xlabel("number of the base parameter")
    strong = int((np.abs(np.triu(matrix, 1)) > 0.9).sum())
    caption = (
        "Correlation of the estimates of each two base parameters, numbered as in the table of "
        "all: a strong colour off the diagonal means that this motion shows the two mostly "
        "together, so that one can make up for the other."
    )
    return Figure(
        (panel(ax, f"correlations of {r} base parameters; {strong} pairs beyond 0.9"),),
        caption,
        (
            Key("box", _POSITIVE, "rise together (+1)"),
            Key("box", _NEGATIVE, "one rises, the other falls (−1)"),
        ),
    )
