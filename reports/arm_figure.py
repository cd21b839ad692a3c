"""A picture of an arm: its solids, joints and axes, seen from several sides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull

from excitant.reports.drawing import FITTED, GIVEN, MEASURED, axes, label_y, panel
from excitant.reports.model import Figure, Key, Panel
from excitant.reports.reading import Series
from excitant.robots.motion import Array

_FILLS = ("#c3dcec", "#e3e7ea")  # by turns, so that neighbours differ
_EDGES = ("#7fb0cf", "#aab2b8")
_BASE = "#8a9299"
_ROUND = np.linspace(0, 2 * np.pi, 33)
_AXIS = 0.13  # of the picture: length of a joint's axis
_PAPER = {"boxstyle": "square,pad=0.08", "fc": "white", "ec": "none", "alpha": 0.75}
_TOGETHER = 0.09  # of the picture: joints nearer than this share a label
_HEIGHT = 3.3  # inch


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
        Key("line", MEASURED, "base, joints and tool in order"),
        Key("line", GIVEN, "axes of the joints, positive direction"),
        Key("dot", FITTED, "tool"),
    ]
    if len(zero.solids):
        legend.append(Key("box", _FILLS[0], "solids of the links"))
    return Figure(tuple(panels), caption, tuple(legend))


def _arm(series: Series, name: str) -> _Arm | None:
    found = []
    for key, width in (("points", 3), ("axes", 3), ("solids", 8)):
        values = series.get(f"{name}_{key}")
        if values is None or not np.issubdtype(np.asarray(values).dtype, np.number):
            return None
        array = np.asarray(values, float)
        if array.ndim != 2 or array.shape[1] != width or not np.isfinite(array).all():
            return None
        found.append(array)
    points, directions, solids = found
    if len(points) != len(directions) + 2:
        return None
    return _Arm(points, directions, solids)


def _panel(arm: _Arm, view: _View, title: str) -> Panel:
    (ax,) = axes(_HEIGHT, left=0.6 if view.labels else 0.12)
    low, high = _extent(arm, view)
    size = _frame(ax, low, high, view)
    _draw_solids(ax, arm, view)
    _draw_chain(ax, arm, view, size)
    joints = len(arm.axes)
    return panel(ax, f"the arm with {joints} joints {title}", title)


def _extent(arm: _Arm, view: _View) -> tuple[Array, Array]:
    flat = arm.points @ view.screen[:2].T
    low, high = flat.min(axis=0), flat.max(axis=0)
    for solid in arm.solids:
        ends = solid[1:7].reshape(2, 3) @ view.screen[:2].T
        low = np.minimum(low, ends.min(axis=0) - solid[7])
        high = np.maximum(high, ends.max(axis=0) + solid[7])
    return low, high


def _frame(ax: Any, low: Array, high: Array, view: _View) -> float:
    """One scale for both directions; how much of the arm's space the picture shows [m]."""
    box = ax.get_window_extent()
    middle, span = (low + high) / 2, np.maximum(high - low, 1e-3)
    scale = 1.14 * float(max(span[0] / box.width, span[1] / box.height))
    ax.set_xlim(middle[0] - scale * box.width / 2, middle[0] + scale * box.width / 2)
    ax.set_ylim(middle[1] - scale * box.height / 2, middle[1] + scale * box.height / 2)
    if view.labels is None:
        ax.axis("off")
    else:
        ax.set_xlabel(f"{view.labels[0]} [m]")
        label_y(ax, f"{view.labels[1]} [m]")
    return scale * float(min(box.width, box.height))


def _draw_solids(ax: Any, arm: _Arm, view: _View) -> None:
    """Outlines of the solids, far ones first."""
    depth = arm.solids[:, 1:7].reshape(-1, 2, 3).mean(axis=1) @ view.screen[2]
    for order, k in enumerate(np.argsort(depth)):
        joint, radius = int(arm.solids[k, 0]), float(arm.solids[k, 7])
        outline = _outline(arm.solids[k, 1:7].reshape(2, 3) @ view.screen.T, radius)
        fill, edge = (_BASE, MEASURED) if joint == 0 else (_FILLS[joint % 2], _EDGES[joint % 2])
        ax.fill(*outline.T, facecolor=fill, edgecolor=edge, lw=0.7, zorder=1 + 0.001 * order)


def _outline(ends: Array, radius: float) -> Array:
    """Outline in the picture of a cylinder between two points, or of a sphere, (points, 2).

    Args:
        ends: Both ends in coordinates of the screen, shape (2, 3) [m].
        radius: Radius [m].
    """
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
    ax.plot(*flat.T, color=MEASURED, lw=1.4, solid_joinstyle="round", zorder=3)
    for centre, axis in zip(flat[1:-1], arm.axes, strict=True):
        _draw_axis(ax, centre, view.screen @ axis, size)
    ax.plot(*flat[1:-1].T, "o", ms=4.0, mec=MEASURED, mfc="white", mew=1.0, zorder=5)
    ax.plot(*flat[-1], "o", ms=4.0, color=FITTED, zorder=5)
    for members in _clusters(flat[1:-1], _TOGETHER * size):
        x, y = flat[1:-1][members].mean(axis=0)
        label = ",".join(str(k + 1) for k in members)
        ax.annotate(label, (x, y), (6, 6), textcoords="offset points", fontsize=8.5,
                    color="#111111", zorder=6, bbox=_PAPER)  # fmt: skip


def _draw_axis(ax: Any, centre: Array, axis: Array, size: float) -> None:
    """An arrow along the axis, or a ring where it points to the eye or away from it."""
    if np.linalg.norm(axis[:2]) < 0.3:
        ax.plot(*centre, "o", ms=8.0, mfc="none", mec=GIVEN, mew=1.0, zorder=4)
        if axis[2] < 0:
            ax.plot(*centre, "x", ms=5.5, color=GIVEN, mew=1.0, zorder=4)
        return
    tip = centre + _AXIS * size * axis[:2]
    ax.annotate("", tip, centre, zorder=4,
                arrowprops={"arrowstyle": "-|>", "color": GIVEN, "lw": 1.1, "shrinkA": 0,
                            "shrinkB": 0, "mutation_scale": 7})  # fmt: skip


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


def joint_labels(names: Sequence[str]) -> list[str]:
    """Names with the numbers that the picture shows."""
    return [f"{k}.\u00a0{name}" for k, name in enumerate(names, start=1)]
