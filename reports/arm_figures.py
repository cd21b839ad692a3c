"""An arm, and the path of its tool through the cell, from several sides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from excitant.reports import drawing as draw
from excitant.reports import values as v
from excitant.reports.page import Figure, Key, Panel
from excitant.reports.values import Result, Series
from excitant.robots.motion import Array

_FILLS = (
    ("#c3dcec", "#7fb0cf"),
    ("#e3e7ea", "#aab2b8"),
)  # by turns, so that neighbours differ
_BASE = ("#8a9299", draw.MEASURED)
_ROUND = np.linspace(0, 2 * np.pi, 33)
_CIRCLE = np.column_stack([np.cos(_ROUND), np.sin(_ROUND), np.zeros_like(_ROUND)])
_FACES_OF_BLOCK = np.array(
    [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
)
_EDGES_OF_BLOCK = [(k, k | bit) for bit in (1, 2, 4) for k in range(8) if not k & bit]
_AXIS = 0.13  # of the picture: length of a joint's axis
_TOGETHER = 0.09  # of the picture: joints nearer than this share a label
_MARGIN = 1.35  # of the arm's reach: what is shown of large obstacles
# of the whole extent: below it there is nothing to see in that direction
_ON_EDGE = 0.02
_HEIGHT = 3.3  # inch
_SAMPLES = 400  # drawn of a path


@dataclass(frozen=True, eq=False)
class _View:
    """A direction to look from: right, up and toward the eye as rows of ``screen`` (3, 3)."""

    name: str
    screen: Array
    labels: tuple[str, str] | None = None  # of abscissa and ordinate

    def axes(self, points: Array, room: float) -> tuple[draw.Axes, float]:
        """Axes with one scale in which these points (n, 3) fit, and their shorter side [m]."""
        (ax,) = draw.axes(_HEIGHT, left=0.6 if self.labels else 0.12)
        flat = points @ self.screen[:2].T
        size = draw.equal_axes(ax, flat.min(axis=0), flat.max(axis=0), room)
        if self.labels is None:
            ax.axis("off")
        else:
            ax.set_xlabel(f"{self.labels[0]} [m]")
            draw.label_y(ax, f"{self.labels[1]} [m]")
        return ax, size


def _oblique(azimuth: float, elevation: float) -> Array:
    a, e = np.radians([azimuth, elevation])
    eye = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    return np.array([right, np.cross(eye, right), eye])


_SIDE = _View(
    "from the side", np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), ("x", "z")
)
_FRONT = _View(
    "from the front", np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]), ("y", "z")
)
_ABOVE = _View("from above", np.eye(3), ("x", "y"))
_CORNER = _View("obliquely", _oblique(-50.0, 22.0))


@dataclass(frozen=True, eq=False)
class _Arm:
    """One pose: points (k, 3), axes (nv, 3), solids (n, 8) as in ``Sketch``."""

    points: Array
    axes: Array
    solids: Array

    def outermost(self, view: _View) -> Array:
        """Points between which all of it lies in a view, shape (n, 3)."""
        sides = np.vstack([view.screen[:2], -view.screen[:2]])
        ends = self.solids[:, 1:7].reshape(-1, 2, 1, 3)
        radii = self.solids[:, 7]
        return np.vstack(
            [self.points, (ends + radii[:, None, None, None] * sides).reshape(-1, 3)]
        )


def arm_figure(series: Series) -> Figure | None:
    """The arm at zero from the two sides that show most, and bent; None without data."""
    zero = _arm(series, "zero")
    bent = _arm(series, "bent")
    if zero is None:
        return None
    views = [_SIDE, _FRONT, _ABOVE]
    views.remove(
        min(
            views,
            key=lambda x: np.prod(np.ptp(zero.outermost(x) @ x.screen[:2].T, axis=0)),
        )
    )
    panels = [_arm_panel(zero, view, f"at zero, {view.name}") for view in views]
    if bent is not None:
        panels.append(_arm_panel(bent, _CORNER, f"bent, {_CORNER.name}"))
    solids = "and its collision solids" if len(zero.solids) else "as lines"
    caption = (
        f"The arm with its {len(zero.axes)} joints numbered from the base, {solids}: at zero, or "
        "as near to it as its ranges allow, and bent. Compare it with the maker's drawing."
    )
    legend = (
        Key("line", draw.MEASURED, "base, joints and tool in order"),
        Key("line", draw.GIVEN, "axes of the joints, positive direction"),
        Key("dot", draw.FITTED, "tool"),
        *[Key("box", _FILLS[0][0], "solids of the links")] * bool(len(zero.solids)),
    )
    return Figure(tuple(panels), caption, legend)


def _arm(series: Series, name: str) -> _Arm | None:
    points, directions = (
        v.array(series, f"{name}_{key}", None, 3) for key in ("points", "axes")
    )
    solids = np.asarray(series.get(f"{name}_solids", np.empty((0, 8))), dtype=float)
    if points is None or directions is None or len(points) != len(directions) + 2:
        return None
    parts = (points, directions, solids)
    known = (
        solids.ndim == 2
        and solids.shape[1] == 8
        and all(np.isfinite(x).all() for x in parts)
    )
    return _Arm(*parts) if known else None


def _arm_panel(arm: _Arm, view: _View, title: str) -> Panel:
    ax, size = view.axes(arm.outermost(view), 1.14)
    depth = arm.solids[:, 1:7].reshape(-1, 2, 3).mean(axis=1) @ view.screen[2]
    for order, solid in enumerate(arm.solids[np.argsort(depth)]):
        joint = int(solid[0])
        outline = _outline(solid[1:7].reshape(2, 3) @ view.screen.T, solid[7])
        fill, edge = _FILLS[joint % 2] if joint else _BASE
        ax.fill(
            *outline.T, facecolor=fill, edgecolor=edge, lw=0.7, zorder=1 + 0.001 * order
        )
    flat = arm.points @ view.screen[:2].T
    ax.plot(*flat.T, color=draw.MEASURED, lw=1.4, solid_joinstyle="round", zorder=3)
    for centre, axis in zip(flat[1:-1], arm.axes @ view.screen.T, strict=True):
        _draw_axis(ax, centre, axis, size)
    ax.plot(
        *flat[1:-1].T, "o", ms=4.0, mec=draw.MEASURED, mfc="white", mew=1.0, zorder=5
    )
    ax.plot(*flat[-1], "o", ms=4.0, color=draw.FITTED, zorder=5)
    _number_joints(ax, flat[1:-1], _TOGETHER * size)
    return draw.panel(ax, f"the arm with {len(arm.axes)} joints {title}", title)


def _outline(ends: Array, radius: float) -> Array:
    """Outline (points, 2) of a cylinder between two ends (2, 3) on the screen, or of a sphere."""
    from scipy.spatial import ConvexHull

    along = ends[1] - ends[0]
    length = float(np.linalg.norm(along))
    z = along / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])
    x = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
    x /= np.linalg.norm(x)
    circle = radius * _CIRCLE @ np.array([x, np.cross(z, x), z])
    rim = (ends[:, None] + circle)[..., :2].reshape(-1, 2)
    outline: Array = rim[ConvexHull(rim).vertices]
    return outline


def _draw_axis(ax: Any, centre: Array, axis: Array, size: float) -> None:
    if np.linalg.norm(axis[:2]) < 0.3:
        ax.plot(*centre, "o", ms=8.0, mfc="none", mec=draw.GIVEN, mew=1.0, zorder=4)
        if axis[2] < 0:
            ax.plot(*centre, "x", ms=5.5, color=draw.GIVEN, mew=1.0, zorder=4)
        return
    look = {"arrowstyle": "-|>", "color": draw.GIVEN, "lw": 1.1, "mutation_scale": 7}
    tip = centre + _AXIS * size * axis[:2]
    ax.annotate(
        "", tip, centre, zorder=4, arrowprops={**look, "shrinkA": 0, "shrinkB": 0}
    )


def _number_joints(ax: draw.Axes, points: Array, near: float) -> None:
    """Number the joints, those that lie together in the picture with one label."""
    groups: list[list[int]] = []
    for k, point in enumerate(points):
        close = (g for g in groups if np.linalg.norm(points[g[0]] - point) < near)
        group = next(close, None)
        if group is None:
            groups.append(group := [])
        group.append(k)
    paper = {"boxstyle": "square,pad=0.08", "fc": "white", "ec": "none", "alpha": 0.75}
    look: Any = {
        "textcoords": "offset points",
        "fontsize": 8.5,
        "color": "#111111",
        "bbox": paper,
    }
    for group in groups:
        x, y = points[group].mean(axis=0)
        ax.annotate(
            ",".join(str(k + 1) for k in group), (x, y), (6, 6), zorder=6, **look
        )


@dataclass(frozen=True, eq=False)
class Solid:
    """Polygons and lines of an obstacle, (points, 3) [m]; the tool stays ``inside`` of some."""

    faces: tuple[Array, ...]
    edges: tuple[Array, ...]
    inside: bool = False


def space_figure(result: Result, series: Series) -> Figure | None:
    """The tool's path with poses of the arm, obliquely and from the sides not seen on edge."""
    tool = v.array(series, "tool", None, 3)
    arm = v.array(series, "arm", None, None, 3)
    if tool is None or not np.isfinite(tool).all():
        return None
    arm = np.empty((0, 1, 3)) if arm is None else arm
    others = v.array(series, "other_tools", None, None, 3)
    paths = (tool, *(() if others is None else np.swapaxes(others, 0, 1)))
    box = _box([*paths, arm.reshape(-1, 3), np.zeros((1, 3))])
    centre = box.mean(axis=0)
    reach = _MARGIN * float(np.linalg.norm(box[1] - box[0])) / 2
    obstacles = v.records(result, "obstacles")
    # half-spaces have no end of their own: they are drawn beside all the rest
    bounded = [o for o in obstacles if v.text(o, "shape") != "half_space"]
    for drawn in (bounded, obstacles):
        found = [solid_of(obstacle, centre, reach, *box) for obstacle in drawn]
        solids = [solid for solid in found if solid is not None]
        box = _box([box, *(edge for solid in solids for edge in solid.edges)])
    when = v.real(result, "closest", "t")
    t = v.array(series, "arm_t", len(arm))
    near = None  # the pose at the instant of least clearance
    if when is not None and t is not None and np.abs(t - when).min() < 0.05:
        near = int(np.abs(t - when).argmin())
    seen = [
        (v.text(o, "name"), s is not None)
        for o, s in zip(obstacles, found, strict=True)
    ]
    names = [name for name, shown in seen if shown]
    label = f"path of the tool with {len(arm)} poses of the arm"
    label += f" and obstacles {v.listing(names)}" if names else ""
    panels = []
    for view in (_CORNER, _ABOVE, _SIDE):
        size = np.ptp(box @ view.screen[:2].T, axis=0)
        if view is _CORNER or size.min() > _ON_EDGE * float(np.max(box[1] - box[0])):
            ax, _ = view.axes(np.array(list(product(*zip(*box, strict=True)))), 1.06)
            _draw_cell(ax, view, paths, arm, near, solids)
            if view is _CORNER:
                _draw_base(ax, view, float(np.max(box[1] - box[0])))
            panels.append(draw.panel(ax, f"{view.name}: {label}", view.name))
    inside = [solid.inside for solid in solids]
    legend = (
        Key("line", draw.FITTED, "path of the tool"),
        *[Key("line", draw.LIGHT, "arm at some instants")]
        * (len(arm) > (near is not None)),
        *[Key("line", draw.MEASURED, "arm where the clearance is least")]
        * (near is not None),
        *[Key("dash", draw.GREEN, "workspace of the tool")] * any(inside),
        *[Key("box", draw.AMBER, "obstacle")] * (not all(inside)),
    )
    hidden = [name for name, shown in seen if not shown]
    return Figure(tuple(panels), _caption(result, paths, hidden), legend)


def _draw_cell(
    ax: Any,
    view: _View,
    paths: Sequence[Array],
    arm: Array,
    near: int | None,
    solids: list[Solid],
) -> None:
    from matplotlib.collections import PolyCollection

    flat = view.screen[:2].T
    for solid in solids:
        polygons = [face @ flat for face in solid.faces]
        ax.add_collection(
            PolyCollection(polygons, facecolor=draw.AMBER, alpha=0.13, lw=0)
        )
        colour, stroke = (
            (draw.GREEN, (0, (5, 3))) if solid.inside else (draw.AMBER, "-")
        )
        for edge in solid.edges:
            ax.plot(*(edge @ flat).T, lw=0.9, color=colour, ls=stroke)
    for k, pose in enumerate(arm):
        colour, width = (draw.MEASURED, 2.0) if k == near else (draw.LIGHT, 1.6)
        ax.plot(
            *(pose @ flat).T,
            "o-",
            ms=2.6,
            color=colour,
            lw=width,
            solid_joinstyle="round",
        )
    for path in paths:
        keep = (
            np.linspace(0, len(path) - 1, min(len(path), _SAMPLES)).round().astype(int)
        )
        ax.plot(*(path[keep] @ flat).T, color=draw.FITTED, lw=1.3)
        ax.plot(
            *(path[:1] @ flat).T,
            marker="o",
            ms=5,
            mfc="white",
            mec=draw.FITTED,
            ls="none",
        )


def _box(points: Sequence[Array]) -> Array:
    every = np.vstack(points)
    return np.array([np.nanmin(every, axis=0), np.nanmax(every, axis=0)])


def _draw_base(ax: Any, view: _View, extent: float) -> None:
    """The axes of the base frame with their length, round and at most a third of the extent."""
    length = max(
        x for x in np.outer(10.0 ** np.arange(-6, 4), [1, 2, 5]).flat if 3 * x <= extent
    )
    for name, tip in zip("xyz", length * view.screen[:2].T, strict=True):
        ax.plot([0, tip[0]], [0, tip[1]], color="#222222", lw=1.2, zorder=4)
        ax.text(*(1.12 * tip), name, ha="center", va="center", fontsize=8, zorder=4)
    ax.set_title(f"base frame, axes of {length:g} [m]", loc="left", fontsize=8, y=0.0)


def _caption(result: Result, paths: Sequence[Array], hidden: list[str]) -> str:
    span = " and ".join(
        " × ".join(f"{x:.2f}" for x in np.ptp(path, axis=0)) for path in paths
    )
    tools = "tool" if len(paths) == 1 else "tools"
    sentence = f"One period of the {tools} in the base frame, a space of {span}\u00a0m"
    distance = v.real(result, "closest", "distance_m")
    bodies = v.words(result, "closest", "bodies")
    if distance is not None and len(bodies) == 2:
        sentence += (
            f"; the closest bodies are {bodies[0]} and {bodies[1]}, "
            f"{v.quantity(1000 * distance, 'mm')} apart "
            f"in the sampled pose at {v.quantity(v.at(result, 'closest', 't'), 's')}"
        )
    outside = (
        f" Not in the picture, farther away: {v.listing(hidden)}." if hidden else ""
    )
    return f"{sentence}.{outside}"


def solid_of(
    obstacle: Result, centre: Array, reach: float, low: Array, high: Array
) -> Solid | None:
    """Drawn part of an obstacle within reach; a half-space ends beside low to high."""
    import pinocchio as pin

    def vector(key: str, default: Any = None) -> Array | None:
        values = v.reals(obstacle, key)
        return values if values.shape == (3,) and np.isfinite(values).all() else default

    position = vector("position")
    radius = v.real(obstacle, "radius")
    match v.text(obstacle, "shape"):
        case "box" if (size := vector("size")) is not None and position is not None:
            R = pin.rpy.rpyToMatrix(vector("rpy", np.zeros(3)))
            middle = R.T @ (centre - position)
            first = np.maximum(-size / 2, middle - reach)
            last = np.minimum(size / 2, middle + reach)
            return None if (first >= last).any() else _block(first, last, R, position)
        case "workspace" if (first := vector("low")) is not None and (
            last := vector("high")
        ) is not None:
            ends = np.maximum(first, centre - reach), np.minimum(last, centre + reach)
            return Solid((), _block(*ends, np.eye(3), np.zeros(3)).edges, inside=True)
        case "sphere" if radius is not None and position is not None:
            if (
                radius > reach
                or float(np.linalg.norm(position - centre)) > reach + radius
            ):
                return None
            circles = tuple(
                position + radius * np.roll(_CIRCLE, k, axis=1) for k in range(3)
            )
            return Solid(circles, circles)
        case "half_space" if (normal := vector("normal")) is not None and normal.any():
            return _plane(normal, v.real(obstacle, "offset"), low, high, reach)
    return None


def _block(low: Array, high: Array, R: Array, origin: Array) -> Solid:
    corners = origin + np.array(list(product(*zip(low, high, strict=True)))) @ R.T
    return Solid(tuple(corners[_FACES_OF_BLOCK]), tuple(corners[_EDGES_OF_BLOCK]))


def _plane(
    normal: Array, offset: float | None, low: Array, high: Array, reach: float
) -> Solid | None:
    if offset is None:
        return None
    n = normal / np.linalg.norm(normal)
    d = offset / float(np.linalg.norm(normal))
    corners = np.array(list(product(*zip(low, high, strict=True))))
    gap = corners @ n - d
    if min(abs(gap.min()), abs(gap.max())) > reach and gap.min() * gap.max() > 0:
        return None
    u = np.cross(n, np.eye(3)[int(np.abs(n).argmin())])
    u /= np.linalg.norm(u)
    w = np.cross(n, u)
    (a, b), (e, f) = (
        ((corners @ side).min(), (corners @ side).max()) for side in (u, w)
    )
    loop = np.array(
        [d * n + x * u + y * w for x, y in ((a, e), (a, f), (b, f), (b, e))]
    )
    return Solid((loop,), (np.vstack([loop, loop[:1]]),))
