"""The tool's path through the cell, with the arm in a few poses and the obstacles."""

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

_VIEWS = (("from above", 0, 1), ("from the side", 0, 2))
_MARGIN = 1.35  # of the arm's reach: what is shown of large obstacles
_FLAT = 0.02  # of the whole extent: a view on edge shows nothing
_ROUND = np.linspace(0, 2 * np.pi, 49)


@dataclass(frozen=True, eq=False)
class Solid:
    """An obstacle as what is drawn of it.

    Attributes:
        faces: Polygons, each of shape (corners, 3) [m].
        edges: Lines, each of shape (points, 3) [m].
        inside: Whether the tool stays inside, as in a workspace.
    """

    faces: tuple[Array, ...]
    edges: tuple[Array, ...]
    inside: bool = False


@dataclass(frozen=True, eq=False)
class _Cell:
    """What is drawn: paths (n, 3), the arm (poses, nodes, 3), its nearest pose, obstacles."""

    paths: tuple[Array, ...]
    arm: Array
    near: int | None
    solids: tuple[Solid, ...]
    low: Array
    high: Array


def space_figure(result: Result, series: Series) -> Figure | None:
    """The tool's path in perspective, and from above and from the side unless seen on edge."""
    tool, arm = v.array(series, "tool", None, 3), v.array(series, "arm", None, None, 3)
    if tool is None or not np.isfinite(tool).all():
        return None
    arm = np.empty((0, 1, 3)) if arm is None else arm
    others = v.array(series, "other_tools", None, None, 3)
    paths = (tool, *(() if others is None else np.swapaxes(others, 0, 1)))
    every = np.concatenate([*paths, arm.reshape(-1, 3), np.zeros((1, 3))])
    low, high = np.nanmin(every, axis=0), np.nanmax(every, axis=0)
    centre, reach = (low + high) / 2, _MARGIN * float(np.linalg.norm(high - low)) / 2
    obstacles = v.records(result, "obstacles")
    bounded = [o for o in obstacles if v.text(o, "shape") != "half_space"]
    low, high = _extent(low, high, [solid_of(o, centre, reach, low, high) for o in bounded])
    seen = [(v.text(o, "name"), solid_of(o, centre, reach, low, high)) for o in obstacles]
    solids = tuple(solid for _, solid in seen if solid is not None)
    low, high = _extent(low, high, solids)
    cell = _Cell(paths, arm, _near_pose(result, series, len(arm)), solids, low, high)
    names = [name for name, solid in seen if solid is not None]
    label = f"path of the tool with {len(arm)} poses of the arm"
    label += f" and obstacles {v.listing(names)}" if names else ""
    size = cell.high - cell.low
    panels = [_perspective(cell, label)]
    panels += [
        _view(cell, f"{name}: {label}", name, x, y)
        for name, x, y in _VIEWS
        if min(size[x], size[y]) > _FLAT * size.max()
    ]
    hidden = [name for name, solid in seen if solid is None]
    return Figure(tuple(panels), _caption(result, cell, hidden), _legend(cell))


def _legend(cell: _Cell) -> tuple[Key, ...]:
    some = len(cell.arm) > (cell.near is not None)
    inside = [solid.inside for solid in cell.solids]
    return (
        Key("line", draw.FITTED, "path of the tool"),
        *[Key("line", draw.LIGHT, "arm at some instants")] * some,
        *[Key("line", draw.MEASURED, "arm where the clearance is least")] * (cell.near is not None),
        *[Key("dash", draw.GREEN, "workspace of the tool")] * any(inside),
        *[Key("box", draw.AMBER, "obstacle")] * (not all(inside)),
    )


def _caption(result: Result, cell: _Cell, hidden: list[str]) -> str:
    span = " and ".join(
        " × ".join(f"{size:.2f}" for size in np.ptp(path, axis=0)) for path in cell.paths
    )
    tools = "tool" if len(cell.paths) == 1 else "tools"
    sentence = f"One period of the {tools} in the base frame, a space of {span}\u00a0m"
    distance, bodies = v.real(result, "closest", "distance_m"), v.at(result, "closest", "bodies")
    if distance is not None and isinstance(bodies, list) and len(bodies) == 2:
        sentence += (
            f"; the closest bodies are {bodies[0]} and {bodies[1]}, "
            f"{v.quantity(1000 * distance, 'mm')} apart "
            f"in the sampled pose at {v.quantity(v.at(result, 'closest', 't'), 's')}"
        )
    outside = f" Not in the picture, farther away: {v.listing(hidden)}." if hidden else ""
    return f"{sentence}.{outside}"


def _near_pose(result: Result, series: Series, poses: int) -> int | None:
    """The pose at the instant of least clearance, if one is."""
    when, t = v.real(result, "closest", "t"), v.array(series, "arm_t", poses)
    if when is None or t is None:
        return None
    k = int(np.abs(t - when).argmin())
    return k if abs(t[k] - when) < 0.05 else None


def solid_of(
    obstacle: Result, centre: Array, reach: float, low: Array, high: Array
) -> Solid | None:
    """What is drawn of an obstacle within reach of a point; None when nothing is.

    Args:
        obstacle: Its ``shape`` with the values of an obstacle file.
        centre: Middle of the picture, shape (3,) [m].
        reach: How far from there obstacles are drawn [m].
        low: Least coordinates of what else is drawn, shape (3,); a half-space has no end of
            its own.
        high: Greatest coordinates.
    """
    shape = v.text(obstacle, "shape")
    if shape == "box":
        return _box(obstacle, centre, reach)
    if shape == "sphere":
        return _sphere(obstacle, centre, reach)
    if shape == "workspace":
        first, last = _vector(obstacle, "low"), _vector(obstacle, "high")
        if first is None or last is None:
            return None
        _, edges = _block(np.maximum(first, centre - reach), np.minimum(last, centre + reach))
        return Solid((), tuple(edges), inside=True)
    return _plane(obstacle, low, high, reach) if shape == "half_space" else None


def _vector(obstacle: Result, key: str) -> Array | None:
    values = v.reals(obstacle, key)
    return values if values.shape == (3,) and np.isfinite(values).all() else None


def _box(obstacle: Result, centre: Array, reach: float) -> Solid | None:
    import pinocchio as pin

    size, position = _vector(obstacle, "size"), _vector(obstacle, "position")
    if size is None or position is None:
        return None
    rpy = _vector(obstacle, "rpy")
    R = np.eye(3) if rpy is None else pin.rpy.rpyToMatrix(rpy)
    middle = R.T @ (centre - position)
    low, high = np.maximum(-size / 2, middle - reach), np.minimum(size / 2, middle + reach)
    if (low >= high).any():
        return None
    faces, edges = ([position + each @ R.T for each in group] for group in _block(low, high))
    return Solid(tuple(faces), tuple(edges))


def _block(low: Array, high: Array) -> tuple[list[Array], list[Array]]:
    """Faces (4, 3) and edges (2, 3) of a block along the axes."""
    corner = {signs: np.where(signs, high, low) for signs in product((0, 1), repeat=3)}
    faces = []
    for axis, side in product(range(3), (0, 1)):
        loop = [(0, 0), (0, 1), (1, 1), (1, 0)]
        faces.append(np.array([corner[(*ab[:axis], side, *ab[axis:])] for ab in loop]))
    edges = [
        np.array([corner[a], corner[b]])
        for a, b in product(corner, corner)
        if a < b and sum(i != j for i, j in zip(a, b, strict=True)) == 1
    ]
    return faces, edges


def _sphere(obstacle: Result, centre: Array, reach: float) -> Solid | None:
    radius, position = v.real(obstacle, "radius"), _vector(obstacle, "position")
    if radius is None or position is None:
        return None
    if radius > reach or float(np.linalg.norm(position - centre)) > reach + radius:
        return None
    circle = np.stack([np.cos(_ROUND), np.sin(_ROUND), np.zeros_like(_ROUND)], axis=1)
    circles = tuple(position + radius * np.roll(circle, k, axis=1) for k in range(3))
    return Solid(circles, circles)


def _plane(obstacle: Result, low: Array, high: Array, reach: float) -> Solid | None:
    """The surface of a half-space beside a block; its sides run along the axes where they can."""
    normal, offset = _vector(obstacle, "normal"), v.real(obstacle, "offset")
    if normal is None or offset is None or not normal.any():
        return None
    n, d = normal / np.linalg.norm(normal), offset / float(np.linalg.norm(normal))
    corners = np.array(list(product(*zip(low, high, strict=True))))
    gap = corners @ n - d
    if min(abs(gap.min()), abs(gap.max())) > reach and gap.min() * gap.max() > 0:
        return None
    u = np.cross(n, np.eye(3)[int(np.abs(n).argmin())])
    u /= np.linalg.norm(u)
    w = np.cross(n, u)
    (a, b), (e, f) = (((corners @ side).min(), (corners @ side).max()) for side in (u, w))
    loop = np.array([d * n + x * u + y * w for x, y in ((a, e), (a, f), (b, f), (b, e))])
    return Solid((loop,), (np.vstack([loop, loop[:1]]),))


def _extent(low: Array, high: Array, solids: Sequence[Solid | None]) -> tuple[Array, Array]:
    corners = [edge for solid in solids if solid is not None for edge in solid.edges]
    points = np.concatenate([low[None], high[None], *corners])
    return points.min(axis=0), points.max(axis=0)


def _perspective(cell: _Cell, label: str) -> Panel:
    ax = draw.axes_3d(cell.low, cell.high)
    for solid in cell.solids:
        draw.fill_3d(ax, solid.faces, facecolor=draw.AMBER, alpha=0.13, lw=0)
    _draw(ax, cell, (0, 1, 2))
    for name in "xyz":
        getattr(ax, f"set_{name}label")(f"{name} [m]", labelpad=0 if name == "z" else -3)
    return draw.panel(ax, f"in perspective: {label}", "in perspective")


def _view(cell: _Cell, label: str, name: str, x: int, y: int) -> Panel:
    from matplotlib.collections import PolyCollection

    (ax,) = draw.axes(3.3)
    for solid in cell.solids:
        polygons = [face[:, [x, y]] for face in solid.faces]
        ax.add_collection(PolyCollection(polygons, facecolor=draw.AMBER, alpha=0.13, lw=0))
    _draw(ax, cell, (x, y))
    draw.equal_axes(ax, cell.low[[x, y]], cell.high[[x, y]], 1.06)
    ax.set_xlabel(f"{'xyz'[x]} [m]")
    draw.label_y(ax, f"{'xyz'[y]} [m]")
    return draw.panel(ax, label, name)


def _draw(ax: Any, cell: _Cell, keep: Sequence[int]) -> None:
    """Lines in the plane or in space, whichever coordinates are kept."""
    for solid in cell.solids:
        for edge in solid.edges:
            look = (
                {"color": draw.GREEN, "ls": (0, (5, 3))} if solid.inside else {"color": draw.AMBER}
            )
            ax.plot(*edge[:, keep].T, lw=0.9, **look)
    for k, pose in enumerate(cell.arm):
        colour, width = (draw.MEASURED, 2.0) if k == cell.near else (draw.LIGHT, 1.6)
        ax.plot(*pose[:, keep].T, "o-", ms=2.6, color=colour, lw=width, solid_joinstyle="round")
    for path in cell.paths:
        ax.plot(*draw.thin_path(path)[:, keep].T, color=draw.FITTED, lw=1.3)
        ax.plot(*path[:1, keep].T, marker="o", ms=5, mfc="white", mec=draw.FITTED, ls="none")
