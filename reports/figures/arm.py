"""An arm from several sides, with its joints numbered."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from excitant.reports import values as v
from excitant.reports.figure import (
    FITTED,
    GIVEN,
    MEASURED,
    Axes,
    Axis,
    Figure,
    Key,
    Line,
    Mark,
    Panel,
    Points,
    Polygon,
    Words,
)
from excitant.reports.values import Series
from excitant.robots.motion import Array

_ROUND = np.linspace(0, 2 * np.pi, 33)
_CIRCLE = np.column_stack([np.cos(_ROUND), np.sin(_ROUND), np.zeros_like(_ROUND)])
_AXIS = 0.13  # of the picture: length of a joint's axis
_HEAD = 0.028  # of the picture: length of its arrow's head
_TOGETHER = 0.09  # of the picture: joints nearer than this share a label
_ROOM = 1.14  # times the arm's extent: what is shown
_HEIGHT = 300  # px


@dataclass(frozen=True, eq=False)
class View:
    """A direction to look from: right, up and toward the eye as rows of ``screen`` (3, 3)."""

    name: str
    screen: Array
    labels: tuple[str, str] | None = None  # of abscissa and ordinate

    def flat(self, points: Array) -> Array:
        """Points (..., 3) on the screen, shape (..., 2)."""
        projected: Array = points @ self.screen[:2].T
        return projected

    def axes(self, marks: list[Mark], points: Array, room: float) -> Axes:
        """Axes with one scale that show ``room`` times the box of these points (n, 3)."""
        flat = self.flat(points)
        low = flat.min(axis=0)
        high = flat.max(axis=0)
        middle = (low + high) / 2
        half = room * np.maximum(high - low, 1e-3) / 2
        low = middle - half
        high = middle + half
        across, up = self.labels or ("", "")
        framed = self.labels is not None
        return Axes(
            marks,
            Axis(f"{across} [m]" if framed else "", float(low[0]), float(high[0])),
            Axis(f"{up} [m]" if framed else "", float(low[1]), float(high[1])),
            _HEIGHT,
            equal=True,
            framed=framed,
        )


def _oblique(azimuth: float, elevation: float) -> Array:
    a, e = np.radians([azimuth, elevation])
    eye = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    return np.array([right, np.cross(eye, right), eye])


_SIDE = View(
    "from the side", np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), ("x", "z")
)
_FRONT = View(
    "from the front", np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]), ("y", "z")
)
_ABOVE = View("from above", np.eye(3), ("x", "y"))
_CORNER = View("obliquely", _oblique(-50.0, 22.0))


@dataclass(frozen=True, eq=False)
class _Arm:
    """One pose: points (k, 3), axes (nv, 3), solids (n, 8) as in ``Sketch``."""

    points: Array
    axes: Array
    solids: Array

    def outermost(self, view: View) -> Array:
        """Points between which all of it lies in a view, shape (n, 3)."""
        sides = np.vstack([view.screen[:2], -view.screen[:2]])
        ends = self.solids[:, 1:7].reshape(-1, 2, 1, 3)
        radii = self.solids[:, 7]
        rims = ends + radii[:, None, None, None] * sides
        return np.vstack([self.points, rims.reshape(-1, 3)])

    def area(self, view: View) -> float:
        """Area of the box around it in a view [m²]."""
        return float(np.prod(np.ptp(view.flat(self.outermost(view)), axis=0)))


def arm_figure(series: Series) -> Figure | None:
    """The arm at zero from the two sides that show most, and bent; None without data."""
    zero = _arm(series, "zero")
    bent = _arm(series, "bent")
    if zero is None:
        return None
    views = [_SIDE, _FRONT, _ABOVE]
    views.remove(min(views, key=zero.area))
    panels = [_arm_panel(zero, view, f"at zero, {view.name}") for view in views]
    if bent is not None:
        panels.append(_arm_panel(bent, _CORNER, f"bent, {_CORNER.name}"))
    solids = "and its collision solids" if len(zero.solids) else "as lines"
    caption = (
        f"The arm with its {len(zero.axes)} joints numbered from the base, {solids}: at zero, or "
        "as near to it as its ranges allow, and bent. Compare it with the maker's drawing."
    )
    legend = (
        Key("line", MEASURED, "base, joints and tool in order"),
        Key("line", GIVEN, "axes of the joints, positive direction"),
        Key("dot", FITTED, "tool"),
        *[Key("box", "solid", "solids of the links")] * bool(len(zero.solids)),
    )
    return Figure(panels, caption, legend)


def _arm(series: Series, name: str) -> _Arm | None:
    points, directions = (
        v.array(series, f"{name}_{key}", None, 3) for key in ("points", "axes")
    )
    solids = np.asarray(series.get(f"{name}_solids", np.empty((0, 8))), dtype=float)
    if points is None or directions is None or len(points) != len(directions) + 2:
        return None
    if solids.ndim != 2 or solids.shape[1] != 8:
        return None
    parts = (points, directions, solids)
    return _Arm(*parts) if all(np.isfinite(x).all() for x in parts) else None


def _arm_panel(arm: _Arm, view: View, title: str) -> Panel:
    outermost = arm.outermost(view)
    size = _ROOM * float(np.ptp(view.flat(outermost), axis=0).max())
    depth = arm.solids[:, 1:7].reshape(-1, 2, 3).mean(axis=1) @ view.screen[2]
    marks: list[Mark] = []
    for solid in arm.solids[np.argsort(depth)]:
        joint = int(solid[0])
        outline = _outline(solid[1:7].reshape(2, 3) @ view.screen.T, solid[7])
        colour = ("solid", "band")[joint % 2] if joint else "base"
        marks.append(Polygon(outline[:, 0], outline[:, 1], colour, "edge"))
    flat = view.flat(arm.points)
    x, y = flat.T
    marks.append(Line(x, y, MEASURED, width=1.4))
    for centre, axis in zip(flat[1:-1], arm.axes @ view.screen.T, strict=True):
        marks += _joint_axis(centre, axis, size)
    marks.append(Points(x[1:-1], y[1:-1], MEASURED, "joint", style="hole"))
    marks.append(Points(x[-1:], y[-1:], FITTED, "tool"))
    marks += _numbers(flat[1:-1], _TOGETHER * size)
    axes = view.axes(marks, outermost, _ROOM)
    return Panel((axes,), f"the arm with {len(arm.axes)} joints {title}", title)


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


def _joint_axis(centre: Array, axis: Array, size: float) -> list[Mark]:
    """An arrow in the positive direction; a ring where it points to the eye, crossed if away."""
    length = float(np.linalg.norm(axis[:2]))
    if length < 0.3:
        x, y = centre.tolist()
        cross = [Words(x, y, "×")] * bool(axis[2] < 0)
        return [Points(centre[:1], centre[1:], GIVEN, "", 8.0, "ring"), *cross]
    along = axis[:2] / length
    across = np.array([-along[1], along[0]])
    tip = centre + _AXIS * size * axis[:2]
    foot = tip - _HEAD * size * along
    side = 0.4 * _HEAD * size * across
    head = np.array([tip, foot + side, foot - side]).T
    shaft = np.array([centre, foot]).T
    return [
        Line(shaft[0], shaft[1], GIVEN),
        Polygon(head[0], head[1], GIVEN),
    ]


def _numbers(points: Array, near: float) -> list[Mark]:
    """Number the joints, those that lie together in the picture with one label."""
    groups: list[list[int]] = []
    for k, point in enumerate(points):
        close = (g for g in groups if np.linalg.norm(points[g[0]] - point) < near)
        group = next(close, None)
        if group is None:
            groups.append(group := [])
        group.append(k)
    return [
        Words(
            float(points[group, 0].mean()),
            float(points[group, 1].mean()),
            ",".join(str(k + 1) for k in group),
            (6.0, 6.0),
        )
        for group in groups
    ]
