"""Pictures of an arm, of one link in it, and of how its base parameters go together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from excitant.reports import drawing as draw
from excitant.reports.page import Figure, Key, Panel
from excitant.reports.values import Series, array
from excitant.robots.motion import Array

_FILLS = ("#c3dcec", "#e3e7ea")  # by turns, so that neighbours differ
_EDGES = ("#7fb0cf", "#aab2b8")
_BASE = "#8a9299"
_ROUND = np.linspace(0, 2 * np.pi, 33)
_AXIS = 0.13  # of the picture: length of a joint's axis
_PAPER = {"boxstyle": "square,pad=0.08", "fc": "white", "ec": "none", "alpha": 0.75}
_TOGETHER = 0.09  # of the picture: joints nearer than this share a label
_HEIGHT, _LINK_HEIGHT = 3.3, 1.75  # inch
_FLAT = 0.05  # of the arm's extent: below it there is nothing to see in that direction


@dataclass(frozen=True, eq=False)
class _View:
    """A direction to look from.

    Attributes:
        name: In words.
        screen: Right, up and toward the eye as rows, shape (3, 3).
        labels: What the abscissa and the ordinate are; empty in perspective.
    """

    name: str
    screen: Array
    labels: tuple[str, str] | None = None


@dataclass(frozen=True, eq=False)
class _Arm:
    """One pose: points (k, 3), axes (nv, 3), solids (n, 8) as in ``Sketch``."""

    points: Array
    axes: Array
    solids: Array


def _oblique(azimuth: float, elevation: float) -> Array:
    a, e = np.radians([azimuth, elevation])
    eye = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    return np.array([right, np.cross(eye, right), eye])


_SIDES = (
    _View("from the side", np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), ("x", "z")),
    _View("from the front", np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]), ("y", "z")),
    _View("from above", np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]]), ("x", "y")),
)
_CORNER = _View("obliquely", _oblique(-50.0, 22.0))


def arm_figure(series: Series) -> Figure | None:
    """The arm at zero from the two sides that show most, and bent; None without data."""
    zero, bent = _arm(series, "zero"), _arm(series, "bent")
    if zero is None:
        return None
    count = len(zero.axes)
    areas = [float(np.prod(np.subtract(*_extent(zero, view)[::-1]))) for view in _SIDES]
    views = [view for k, view in enumerate(_SIDES) if k != int(np.argmin(areas))]
    panels = [_panel(zero, view, f"at zero, {view.name}") for view in views]
    if bent is not None:
        panels.append(_panel(bent, _CORNER, f"bent, {_CORNER.name}"))
    solids = "and its collision solids" if len(zero.solids) else "as lines"
    caption = (
        f"The arm with its {count} joints numbered from the base, {solids}: at zero, or as near to "
        "it as its ranges allow, and in a bent pose. Compare the zero pose with the maker's "
        "drawing: a joint that bends the other way or a link that lies elsewhere shows here."
    )
    legend = [
        Key("line", draw.MEASURED, "base, joints and tool in order"),
        Key("line", draw.GIVEN, "axes of the joints, positive direction"),
        Key("dot", draw.FITTED, "tool"),
    ]
    if len(zero.solids):
        legend.append(Key("box", _FILLS[0], "solids of the links"))
    return Figure(tuple(panels), caption, tuple(legend))


def _arm(series: Series, name: str) -> _Arm | None:
    points, directions = (array(series, f"{name}_{key}", None, 3) for key in ("points", "axes"))
    solids = np.asarray(series.get(f"{name}_solids", np.empty((0, 8))), dtype=float)
    if points is None or directions is None or len(points) != len(directions) + 2:
        return None
    parts = (points, directions, solids)
    known = solids.ndim == 2 and solids.shape[1] == 8 and all(np.isfinite(x).all() for x in parts)
    return _Arm(*parts) if known else None


def _panel(arm: _Arm, view: _View, title: str) -> Panel:
    (ax,) = draw.axes(_HEIGHT, left=0.6 if view.labels else 0.12)
    size = draw.equal_axes(ax, *_extent(arm, view), 1.14)
    if view.labels is None:
        ax.axis("off")
    else:
        ax.set_xlabel(f"{view.labels[0]} [m]")
        draw.label_y(ax, f"{view.labels[1]} [m]")
    _draw_solids(ax, arm, view)
    _draw_chain(ax, arm, view, size)
    return draw.panel(ax, f"the arm with {len(arm.axes)} joints {title}", title)


def _extent(arm: _Arm, view: _View) -> tuple[Array, Array]:
    flat = arm.points @ view.screen[:2].T
    low, high = flat.min(axis=0), flat.max(axis=0)
    for solid in arm.solids:
        ends = solid[1:7].reshape(2, 3) @ view.screen[:2].T
        low = np.minimum(low, ends.min(axis=0) - solid[7])
        high = np.maximum(high, ends.max(axis=0) + solid[7])
    return low, high


def _draw_solids(ax: Any, arm: _Arm, view: _View) -> None:
    """Outlines of the solids, far ones first."""
    depth = arm.solids[:, 1:7].reshape(-1, 2, 3).mean(axis=1) @ view.screen[2]
    for order, k in enumerate(np.argsort(depth)):
        joint, radius = int(arm.solids[k, 0]), float(arm.solids[k, 7])
        outline = _outline(arm.solids[k, 1:7].reshape(2, 3) @ view.screen.T, radius)
        fill, edge = (
            (_BASE, draw.MEASURED) if joint == 0 else (_FILLS[joint % 2], _EDGES[joint % 2])
        )
        ax.fill(*outline.T, facecolor=fill, edgecolor=edge, lw=0.7, zorder=1 + 0.001 * order)


def _outline(ends: Array, radius: float) -> Array:
    """Outline in the picture of a cylinder between two points, or of a sphere, (points, 2).

    Args:
        ends: Both ends in coordinates of the screen, shape (2, 3) [m].
        radius: Radius [m].
    """
    from scipy.spatial import ConvexHull

    along = ends[1] - ends[0]
    length = float(np.linalg.norm(along))
    z = along / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])
    x = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
    x /= np.linalg.norm(x)
    circle = radius * (np.outer(np.cos(_ROUND), x) + np.outer(np.sin(_ROUND), np.cross(z, x)))
    rim = (ends[:, None] + circle)[..., :2].reshape(-1, 2)
    outline: Array = rim[ConvexHull(rim).vertices]
    return outline


def _draw_chain(ax: Any, arm: _Arm, view: _View, size: float) -> None:
    flat = arm.points @ view.screen[:2].T
    ax.plot(*flat.T, color=draw.MEASURED, lw=1.4, solid_joinstyle="round", zorder=3)
    for centre, axis in zip(flat[1:-1], arm.axes, strict=True):
        _draw_axis(ax, centre, view.screen @ axis, size)
    ax.plot(*flat[1:-1].T, "o", ms=4.0, mec=draw.MEASURED, mfc="white", mew=1.0, zorder=5)
    ax.plot(*flat[-1], "o", ms=4.0, color=draw.FITTED, zorder=5)
    for members in _clusters(flat[1:-1], _TOGETHER * size):
        x, y = flat[1:-1][members].mean(axis=0)
        label = ",".join(str(k + 1) for k in members)
        ax.annotate(
            label,
            (x, y),
            (6, 6),
            textcoords="offset points",
            fontsize=8.5,
            color="#111111",
            zorder=6,
            bbox=_PAPER,
        )


def _draw_axis(ax: Any, centre: Array, axis: Array, size: float) -> None:
    """An arrow along the axis, or a ring where it points to the eye or away from it."""
    if np.linalg.norm(axis[:2]) < 0.3:
        ax.plot(*centre, "o", ms=8.0, mfc="none", mec=draw.GIVEN, mew=1.0, zorder=4)
        if axis[2] < 0:
            ax.plot(*centre, "x", ms=5.5, color=draw.GIVEN, mew=1.0, zorder=4)
        return
    tip = centre + _AXIS * size * axis[:2]
    ax.annotate(
        "",
        tip,
        centre,
        zorder=4,
        arrowprops={
            "arrowstyle": "-|>",
            "color": draw.GIVEN,
            "lw": 1.1,
            "shrinkA": 0,
            "shrinkB": 0,
            "mutation_scale": 7,
        },
    )


def _clusters(points: Array, near: float) -> list[list[int]]:
    """Indices of points that lie together in the picture."""
    groups: list[list[int]] = []
    for k, point in enumerate(points):
        for group in groups:
            if np.linalg.norm(points[group[0]] - point) < near:
                group.append(k)
                break
        else:
            groups.append([k])
    return groups


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
    chain = array(series, "chain", None, 3)
    if chain is None or not np.isfinite(chain).all() or index + 2 >= len(chain):
        return None
    flat, view = side_view(chain)
    width, height = 72 * draw.WIDTH, 72 * _LINK_HEIGHT
    low, size = flat.min(axis=0), np.maximum(np.ptp(flat, axis=0), 1e-9)
    scale = 0.85 * float(np.min(np.array([width, height]) / np.maximum(size, 1e-3 * size.max())))
    points = (flat - low - size / 2) * [scale, -scale] + [width / 2, height / 2]
    own = points[index + 1 : index + 3]
    shapes = [
        _line(points[[0, 0]] + [[-8.0, 0.0], [8.0, 0.0]], draw.MEASURED, 3.0),
        _line(points, draw.LIGHT, 4.0),
        *(_disc(point, 2.1, "#ffffff", draw.MEASURED) for point in points[1:-1]),
        _line(own, draw.FITTED, 5.5),
        _disc(own[0], 3.3, draw.FITTED, "#ffffff"),
    ]
    legend = [Key("line", draw.FITTED, "this link"), Key("dot", draw.FITTED, "its joint")]
    if np.ptp(own, axis=0).max() < 0.01 * np.ptp(points, axis=0).max():
        caption += " It has no length in this view: the next joint lies at the same place."
        legend = legend[1:]
    label = f"{name} in the chain, {view}"
    return Figure((draw.svg_panel(shapes, width, height, label),), caption, tuple(legend))


def _line(points: Array, colour: str, width: float) -> str:
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return (
        f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="{width}" '
        'stroke-linejoin="round" stroke-linecap="round"/>'
    )


def _disc(centre: Array, radius: float, fill: str, edge: str) -> str:
    x, y = centre
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius}" fill="{fill}" stroke="{edge}"/>'


def correlation_figure(series: Series) -> Figure | None:
    """Correlations of the base parameters as a map of colours."""
    matrix = array(series, "correlation", None, None)
    if matrix is None or matrix.shape[0] != matrix.shape[1]:
        return None
    from matplotlib.colors import LinearSegmentedColormap

    r = len(matrix)
    (ax,) = draw.axes(3.75, left=0.42)
    ends = (0.5, r + 0.5)
    ax.imshow(
        np.nan_to_num(matrix),
        cmap=LinearSegmentedColormap.from_list("signed", [draw.FITTED, "#ffffff", draw.GIVEN]),
        vmin=-1,
        vmax=1,
        interpolation="nearest",
        extent=(*ends, *ends[::-1]),
        aspect="equal",
    )
    ax.grid(visible=False)
    ax.set_xlabel("number of the base parameter")
    strong = int((np.abs(np.triu(matrix, 1)) > 0.9).sum())
    return Figure(
        (draw.panel(ax, f"correlations of {r} base parameters; {strong} pairs beyond 0.9"),),
        "Correlation of the estimates of each two base parameters, numbered as in the table of "
        "all: a strong colour off the diagonal means that this motion shows the two mostly "
        "together, so that one can make up for the other.",
        (
            Key("box", draw.GIVEN, "rise together (+1)"),
            Key("box", draw.FITTED, "one rises, the other falls (−1)"),
        ),
    )
