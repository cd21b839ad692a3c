"""The path of the tool through the cell, with poses of the arm and obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from excitant.reports import figure as fig
from excitant.reports import values as v
from excitant.reports.figure import Figure, Key, Mark, Panel
from excitant.reports.figures.arm import (
    ABOVE,
    CIRCLE,
    CORNER,
    SIDE,
    View,
    area,
    dots,
    line,
    words,
)
from excitant.reports.values import Series
from excitant.results import Box, HalfSpace, Motion, Obstacle, Sphere, Workspace
from excitant.robots.motion import Array

_FACES_OF_BLOCK = np.array(
    [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
)
_EDGES_OF_BLOCK = [(k, k | bit) for bit in (1, 2, 4) for k in range(8) if not k & bit]
_MARGIN = 1.35  # of the arm's reach: what is shown of large obstacles
# of the whole extent: below it there is nothing to see in that direction
_ON_EDGE = 0.02
_ROOM = 1.06  # times the extent: what is shown
_SAMPLES = 400  # drawn of a path
_NEAR = 0.05  # s between the least clearance and the pose that is drawn for it


@dataclass(frozen=True, eq=False)
class Solid:
    """Polygons and lines of an obstacle, (points, 3) [m]; the tool stays ``inside`` of some."""

    faces: tuple[Array, ...]
    edges: tuple[Array, ...]
    inside: bool = False


def space_figure(result: Motion, series: Series) -> Figure | None:
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
    obstacles = result.obstacles
    # half-spaces have no end of their own: they are drawn beside all the rest
    bounded = [o for o in obstacles if not isinstance(o, HalfSpace)]
    for drawn in (bounded, obstacles):
        within = [solid_of(obstacle, centre, reach, *box) for obstacle in drawn]
        solids = [solid for solid in within if solid is not None]
        box = _box([box, *(edge for solid in solids for edge in solid.edges)])
    nearest = _nearest_pose(result, series, len(arm))
    names = [obstacle.name for obstacle in obstacles]
    visible = [n for n, solid in zip(names, within, strict=True) if solid is not None]
    hidden = [n for n, solid in zip(names, within, strict=True) if solid is None]
    label = f"path of the tool with {len(arm)} poses of the arm"
    label += f" and obstacles {v.listing(visible)}" if visible else ""
    extent = float(np.max(box[1] - box[0]))
    corners = np.array(list(product(*zip(*box, strict=True))))
    panels = []
    for view in (CORNER, ABOVE, SIDE):
        size = np.ptp(view.flat(box), axis=0)
        if view is CORNER or size.min() > _ON_EDGE * extent:
            marks = _cell(view, paths, arm, nearest, solids)
            remark = ""
            if view is CORNER:
                length = _base_length(extent)
                marks += _base(view, length)
                remark = f"base frame, axes of {length:g} [m]"
            axes = replace(view.axes(marks, corners, _ROOM), remark=remark)
            panels.append(Panel((axes,), f"{view.name}: {label}", view.name))
    inside = [solid.inside for solid in solids]
    legend = [Key("line", fig.FITTED, "path of the tool")]
    if len(arm) > (nearest is not None):
        legend.append(Key("line", fig.LIGHT, "arm at some instants"))
    if nearest is not None:
        legend.append(Key("line", fig.MEASURED, "arm where the clearance is least"))
    if any(inside):
        legend.append(Key("dash", fig.GREEN, "workspace of the tool"))
    if not all(inside):
        legend.append(Key("box", fig.AMBER, "obstacle"))
    return Figure(tuple(panels), _caption(result, paths, hidden), tuple(legend))


def _nearest_pose(result: Motion, series: Series, poses: int) -> int | None:
    """The pose drawn at the instant of least clearance, if there is one."""
    t = v.array(series, "arm_t", poses)
    if result.closest is None or t is None:
        return None
    apart = np.abs(t - result.closest.t)
    return int(apart.argmin()) if apart.min() < _NEAR else None


def _cell(
    view: View,
    paths: Sequence[Array],
    arm: Array,
    nearest: int | None,
    solids: Sequence[Solid],
) -> list[Mark]:
    marks: list[Mark] = []
    for solid in solids:
        for face in solid.faces:
            marks.append(area(view.flat(face), fig.AMBER, opacity=0.13))
        colour = fig.GREEN if solid.inside else fig.AMBER
        for edge in solid.edges:
            marks.append(view.line(edge, colour, width=0.9, dashed=solid.inside))
    for k, pose in enumerate(arm):
        colour = fig.MEASURED if k == nearest else fig.LIGHT
        marks.append(view.line(pose, colour, width=2.0 if k == nearest else 1.6))
        marks.append(dots(view.flat(pose), colour, size=2.6))
    for path in paths:
        rows = np.linspace(0, len(path) - 1, min(len(path), _SAMPLES)).round()
        marks.append(view.line(path[rows.astype(int)], fig.FITTED, width=1.3))
        start = view.flat(path[:1])
        name = "start of the tool"
        marks.append(dots(start, fig.FITTED, name=name, size=5.0, style="hole"))
    return marks


def _box(points: Sequence[Array]) -> Array:
    every = np.vstack(points)
    return np.array([np.nanmin(every, axis=0), np.nanmax(every, axis=0)])


def _base_length(extent: float) -> float:
    """Length of the base frame's axes, round and at most a third of the extent [m]."""
    lengths = np.outer(10.0 ** np.arange(-6, 4), [1, 2, 5])
    return float(lengths[3 * lengths <= extent].max())


def _base(view: View, length: float) -> list[Mark]:
    marks: list[Mark] = []
    for name, tip in zip("xyz", view.flat(length * np.eye(3)), strict=True):
        shaft = np.array([np.zeros(2), tip])
        marks.append(line(shaft, "ink", width=1.2))
        marks.append(words(1.12 * tip, name))
    return marks


def _caption(result: Motion, paths: Sequence[Array], hidden: list[str]) -> str:
    span = " and ".join(
        " × ".join(f"{x:.2f}" for x in np.ptp(path, axis=0)) for path in paths
    )
    tools = "tool" if len(paths) == 1 else "tools"
    sentence = f"One period of the {tools} in the base frame, a space of {span}\u00a0m"
    if result.closest is not None:
        first, second = result.closest.bodies
        sentence += (
            f"; the closest bodies are {first} and {second}, "
            f"{v.quantity(1000 * result.closest.distance_m, 'mm')} apart "
            f"in the sampled pose at {v.quantity(result.closest.t, 's')}"
        )
    outside = (
        f" Not in the picture, farther away: {v.listing(hidden)}." if hidden else ""
    )
    return f"{sentence}.{outside}"


def solid_of(
    obstacle: Obstacle, centre: Array, reach: float, low: Array, high: Array
) -> Solid | None:
    """Drawn part of an obstacle within reach; a half-space ends beside low to high."""
    import pinocchio as pin

    match obstacle:
        case Box():
            R = pin.rpy.rpyToMatrix(np.array(obstacle.rpy))
            position = np.array(obstacle.position)
            half = np.array(obstacle.size) / 2
            middle = R.T @ (centre - position)
            first = np.maximum(-half, middle - reach)
            last = np.minimum(half, middle + reach)
            return None if (first >= last).any() else _block(first, last, R, position)
        case Workspace():
            first = np.maximum(obstacle.low, centre - reach)
            last = np.minimum(obstacle.high, centre + reach)
            cell = _block(first, last, np.eye(3), np.zeros(3))
            return Solid((), cell.edges, inside=True)
        case Sphere():
            position = np.array(obstacle.position)
            radius = obstacle.radius
            distance = float(np.linalg.norm(position - centre))
            if radius > reach or distance > reach + radius:
                return None
            circles = tuple(
                position + radius * np.roll(CIRCLE, k, axis=1) for k in range(3)
            )
            return Solid(circles, circles)
        case HalfSpace():
            return _plane(np.array(obstacle.normal), obstacle.offset, low, high, reach)


def _block(low: Array, high: Array, R: Array, origin: Array) -> Solid:
    corners = origin + np.array(list(product(*zip(low, high, strict=True)))) @ R.T
    return Solid(tuple(corners[_FACES_OF_BLOCK]), tuple(corners[_EDGES_OF_BLOCK]))


def _plane(
    normal: Array, offset: float, low: Array, high: Array, reach: float
) -> Solid | None:
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
