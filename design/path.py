"""Geometric paths through joint space, straight or around what obstructs them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline

from excitant.robots import Array, Motion, Robot, torque
from excitant.robots.geometry import Scene
from excitant.robots.torque import largest_torque

Edge = Callable[[Array, Array], bool]
Tree = tuple[list[Array], list[int]]  # poses, and the index of each one's parent

HOLDING = 0.95  # share of a torque limit that holding the arm may take; the rest moves it

_RESOLUTION = 0.02, 0.005  # between checked poses: rad of a revolute joint, m of a prismatic one
_SAMPLES = 1000  # via points tried
_REACH = 0.4  # rad or m: longest branch that the search grows at once
_SHORTCUTS = 60
_SPACINGS = (1.0, 0.5, 0.25, 0.1, 0.05, 0.02, 0.01)  # rad or m between control points


@dataclass(frozen=True, eq=False)
class Path:
    """Twice continuously differentiable curve q(s), 0 ≤ s ≤ 1, as toppra takes it.

    Attributes:
        spline: Piecewise polynomial.
        pieces: Number of its pieces.
    """

    spline: BSpline
    pieces: int

    def __call__(self, s: npt.ArrayLike, order: int = 0) -> Array:
        """Evaluate the path or its derivative with respect to s, shape (n, nv)."""
        values: Array = self.spline(np.asarray(s, float), order)
        return values

    @property
    def dof(self) -> int:
        """Number of joints."""
        return int(self.spline.c.shape[1])

    @property
    def path_interval(self) -> Array:
        """First and last value of s."""
        return np.array([0.0, 1.0])


def rounded_path(waypoints: Array, spacing: float = 1.0) -> Path:
    """Polyline with rounded corners: the variation-diminishing cubic spline (Schoenberg 1967).

    Its control points lie on the polyline, about ``spacing`` apart, at the Greville abscissae
    of a clamped uniform knot vector. So it starts and ends where the polyline does, is straight
    at constant speed where four neighbours lie on one segment, and never leaves their hull.

    Args:
        waypoints: Corners, neighbours differing, shape (k, nv).
        spacing: Distance of control points along the polyline [rad or m].
    """
    length = _lengths(waypoints)
    pieces = 1 if len(waypoints) == 2 else max(4, int(np.ceil(length[-1] / spacing)))
    knots = np.concatenate([np.zeros(3), np.linspace(0, 1, pieces + 1), np.ones(3)])
    greville = (knots[1:-3] + knots[2:-2] + knots[3:-1]) / 3
    control = np.stack(
        [np.interp(greville, length / length[-1], column) for column in waypoints.T], axis=1
    )
    control[0], control[-1] = waypoints[0], waypoints[-1]
    return Path(BSpline(knots, control, 3), pieces)


def static_torque(robot: Robot, q: Array, direction: Array) -> Array:
    """Torque that holds poses while they begin to move in a direction, shape (n, nv) [N·m].

    Gravity and everything that does not vanish with the speed, as Coulomb friction.

    Args:
        robot: Arm with its effects.
        q: Poses, shape (n, nv).
        direction: Velocities of which only the direction counts, shape (n, nv).
    """
    return torque(robot, _creeping(q, direction))


def obstruction(robot: Robot, path: Path, scene: Scene | None, clearance: float) -> str | None:
    """Where and why a path comes too close or needs too much torque to hold still, if it does.

    Args:
        robot: Arm with limits.
        path: The path.
        scene: The arm's bodies among obstacles; None to leave clearance out.
        clearance: Smallest distance that they keep [m].
    """
    coarse = path(np.linspace(0.0, 1.0, 20 * path.pieces + 1))
    travel = np.abs(np.diff(coarse, axis=0)) / np.where(robot.revolute, *_RESOLUTION)
    s = np.linspace(0.0, 1.0, max(8, int(np.ceil(travel.max(axis=1).sum()))) + 1)
    q = path(s)
    if np.isfinite(robot.limits.torque).any():
        use = np.abs(largest_torque(robot, _creeping(q, path(s, 1)))) / robot.limits.torque
        k, j = np.unravel_index(int(use.argmax()), use.shape)
        if use[k, j] > HOLDING:
            return f"{holding_refusal(robot, int(j), float(use[k, j]))} at {100 * s[k]:.3g} %"
    if scene is not None:
        distance = scene.distances(q).min(axis=1)
        for k in np.flatnonzero(~(distance >= clearance))[:1]:
            return (
                f"clearance is {distance[k]:.4g} m, needed are {clearance:.4g} m, "
                f"at {100 * s[k]:.3g} %"
            )
    return None


def holding_refusal(robot: Robot, j: int, share: float) -> str:
    """Why a pose is out of reach: joint ``j`` needs this share of its torque limit to hold it."""
    bound = robot.limits.torque[j]
    return (
        f"joint {robot.joints[j]} needs {share * bound:.4g} N·m to hold the arm, more than "
        f"{100 * HOLDING:.0f} % of its torque limit of {bound:.4g} N·m"
    )


def free_path(
    robot: Robot,
    start: Array,
    goal: Array,
    scene: Scene | None,
    clearance: float,
    rng: np.random.Generator,
) -> Path | str:
    """The straight path, else one around what obstructs it, else what obstructs it.

    Args:
        robot: Arm with limits.
        start: First pose, shape (nv,).
        goal: Last pose, another one, shape (nv,).
        scene: See `obstruction`.
        clearance: See `obstruction`.
        rng: Source of via points.
    """
    straight = rounded_path(np.stack([start, goal]))
    blocked = obstruction(robot, straight, scene, clearance)
    if blocked is None:
        return straight

    def free(a: Array, b: Array) -> bool:
        if np.array_equal(a, b):
            return True
        return obstruction(robot, rounded_path(np.stack([a, b])), scene, clearance) is None

    waypoints = _detour(robot, start, goal, free, rng)
    if waypoints is None:
        return blocked
    for spacing in _SPACINGS:
        path = rounded_path(waypoints, spacing)
        if obstruction(robot, path, scene, clearance) is None:
            return path
    return blocked


def _creeping(q: Array, direction: Array) -> Motion:
    creep = 1e-6 * direction / max(float(np.abs(direction).max(initial=0.0)), 1e-300)
    return Motion(np.arange(float(len(q))), q, creep, np.zeros_like(q))


def _lengths(waypoints: Array) -> Array:
    """Length of a polyline up to each waypoint, shape (k,)."""
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(waypoints, axis=0), axis=1)))


def _detour(
    robot: Robot, start: Array, goal: Array, free: Edge, rng: np.random.Generator
) -> Array | None:
    """Waypoints from start to goal over free straight segments, shape (k, nv), or None.

    Two trees grow towards random poses and towards each other (RRT-Connect, Kuffner and
    LaValle 2000); the result is shortened by random shortcuts. Poses are drawn inside the
    position limits, at most half a turn beyond the box of start and goal.
    """
    around = np.stack([np.minimum(start, goal) - np.pi, np.maximum(start, goal) + np.pi])
    low, high = np.clip(around, *robot.limits.position.T)
    trees: list[Tree] = [([start], [-1]), ([goal], [-1])]
    for count in range(_SAMPLES):
        here, there = trees[count % 2], trees[1 - count % 2]
        edges = (free, lambda a, b: free(b, a))  # the tree of the goal is travelled backwards
        edge, back = edges[count % 2], edges[1 - count % 2]
        grown = _grow(here, rng.uniform(low, high), edge, once=True)
        if grown is None:
            continue
        met = _grow(there, here[0][grown], back, once=False)
        if met is not None and np.array_equal(there[0][met], here[0][grown]):
            halves = [_branch(here, grown), _branch(there, met)]
            first, second = halves if count % 2 == 0 else halves[::-1]
            return _shortened(np.array(first[::-1] + second[1:]), free, rng)
    return None


def _grow(tree: Tree, target: Array, free: Edge, *, once: bool) -> int | None:
    """Grow the nearest branch towards a pose; index of the last node added."""
    nodes, parents = tree
    at = int(np.linalg.norm(np.array(nodes) - target, axis=1).argmin())
    added = None
    while True:
        ahead = target - nodes[at]
        distance = float(np.linalg.norm(ahead))
        pose = target if distance <= _REACH else nodes[at] + ahead * (_REACH / distance)
        if distance == 0 or not free(nodes[at], pose):
            return added
        nodes.append(pose)
        parents.append(at)
        added = at = len(nodes) - 1
        if once or pose is target:
            return added


def _branch(tree: Tree, leaf: int) -> list[Array]:
    nodes, parents = tree
    branch = []
    while leaf >= 0:
        branch.append(nodes[leaf])
        leaf = parents[leaf]
    return branch


def _shortened(waypoints: Array, free: Edge, rng: np.random.Generator) -> Array:
    """The polyline with free shortcuts between random points of it."""
    for _ in range(_SHORTCUTS):
        length = _lengths(waypoints)
        cut = np.sort(rng.uniform(0.0, length[-1], 2))
        a, b = (np.array([np.interp(c, length, column) for column in waypoints.T]) for c in cut)
        if free(a, b):
            before, after = waypoints[length < cut[0]], waypoints[length > cut[1]]
            waypoints = np.vstack([before, a, b, after])
    kept = np.append(True, np.linalg.norm(np.diff(waypoints, axis=0), axis=1) > 1e-9)
    shortened: Array = waypoints[kept]
    return shortened
