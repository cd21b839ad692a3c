"""Geometric paths through joint space: straight, around obstacles, or through waypoints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline, CubicSpline

from excitant.robots import Array, Motion, Robot, torque
from excitant.robots.torque import largest_torque

Clearance = Callable[[Array], float]
Edge = Callable[[Array, Array], bool]

HOLDING = 0.95  # share of a torque limit that holding the arm may take; the rest moves it

_RESOLUTION = 0.02, 0.005  # between checked poses: rad of a revolute joint, m of a prismatic one
_REACH = 0.4  # rad or m: longest branch that the search grows at once
_SHORTCUTS = 60
_SPACINGS = (1.0, 0.5, 0.25, 0.1, 0.05, 0.02, 0.01)  # rad or m between control points


@dataclass(frozen=True, eq=False)
class Path:
    """Twice continuously differentiable curve q(s), 0 ≤ s ≤ 1.

    Attributes:
        spline: Piecewise polynomial of SciPy, evaluated as ``spline(s, derivative)``.
        pieces: Number of its pieces.
    """

    spline: Any
    pieces: int

    def __call__(self, s: npt.ArrayLike, order: int = 0) -> Array:
        """Evaluate the path or its derivative with respect to s, shape (n, nv)."""
        values: Array = self.spline(np.asarray(s, float), order)
        return values

    @property
    def dof(self) -> int:
        """Number of joints."""
        return int(self(0.0).shape[0])

    @property
    def path_interval(self) -> Array:
        """First and last value of s."""
        return np.array([0.0, 1.0])


def rounded_path(waypoints: Array, spacing: float) -> Path:
    """Polyline with rounded corners: the variation-diminishing cubic spline (Schoenberg 1967).

    Its control points lie on the polyline, about ``spacing`` apart, at the Greville abscissae
    of a clamped uniform knot vector. So it starts and ends where the polyline does, is straight
    at constant speed where four neighbours lie on one segment, and never leaves their hull.

    Args:
        waypoints: Corners, neighbours differing, shape (k, nv).
        spacing: Distance of control points along the polyline [rad or m].
    """
    length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(waypoints, axis=0), axis=1)))
    pieces = 1 if len(waypoints) == 2 else max(4, int(np.ceil(length[-1] / spacing)))
    knots = np.concatenate([np.zeros(3), np.linspace(0, 1, pieces + 1), np.ones(3)])
    greville = (knots[1:-3] + knots[2:-2] + knots[3:-1]) / 3
    control = np.stack(
        [np.interp(greville, length / length[-1], column) for column in waypoints.T], axis=1
    )
    control[0], control[-1] = waypoints[0], waypoints[-1]
    return Path(BSpline(knots, control, 3), pieces)


def spline_path(waypoints: Array) -> Path:
    """Natural cubic spline through all waypoints, in their chord length.

    Args:
        waypoints: Poses, neighbours differing, shape (k, nv) with k ≥ 2.
    """
    if len(waypoints) == 2:
        return rounded_path(waypoints, 1.0)
    length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(waypoints, axis=0), axis=1)))
    spline = CubicSpline(length / length[-1], waypoints, bc_type="natural")
    return Path(spline, len(waypoints) - 1)


def static_torque(robot: Robot, q: Array, direction: Array) -> Array:
    """Torque that holds poses while they begin to move in a direction, shape (n, nv) [N·m].

    Gravity and everything that does not vanish with the speed, as Coulomb friction.

    Args:
        robot: Arm with its effects.
        q: Poses, shape (n, nv).
        direction: Velocities of which only the direction counts, shape (n, nv).
    """
    return torque(robot, _creeping(q, direction))


def _creeping(q: Array, direction: Array) -> Motion:
    creep = 1e-6 * direction / max(float(np.abs(direction).max(initial=0.0)), 1e-300)
    return Motion(np.arange(float(len(q))), q, creep, np.zeros_like(q))


@dataclass(frozen=True, eq=False)
class Obstruction:
    """The first pose of a path that the arm may not take.

    Attributes:
        share: Where along the path, 0 to 1.
        why: What is wrong there.
    """

    share: float
    why: str


def obstruction(
    robot: Robot, path: Path, clearance: Clearance | None, margin: float
) -> Obstruction | None:
    """Where the path comes too close to an obstacle or needs too much torque to hold still.

    Args:
        robot: Arm with limits.
        path: The path.
        clearance: Distance of a pose (nv,) to the nearest obstacle [m]; None without obstacles.
        margin: Smallest distance allowed [m].
    """
    s = np.linspace(0.0, 1.0, _poses(robot, path) + 1)
    q = path(s)
    if np.isfinite(robot.limits.torque).any():
        excess = np.abs(largest_torque(robot, _creeping(q, path(s, 1)))) / robot.limits.torque
        k, j = np.unravel_index(int(excess.argmax()), excess.shape)
        if excess[k, j] > HOLDING:
            return Obstruction(float(s[k]), holding_refusal(robot, int(j), float(excess[k, j])))
    if clearance is not None:
        for share, pose in zip(s, q, strict=True):
            distance = float(clearance(pose))
            if not distance >= margin:
                return Obstruction(
                    float(share), f"clearance is {distance:.4g} m, needed are {margin:.4g} m"
                )
    return None


def holding_refusal(robot: Robot, j: int, share: float) -> str:
    """Why a pose is out of reach: joint ``j`` needs this share of its torque limit to hold it."""
    bound = robot.limits.torque[j]
    return (
        f"joint {robot.joints[j]} needs {share * bound:.4g} N·m to hold the arm, more than "
        f"{100 * HOLDING:.0f} % of its torque limit of {bound:.4g} N·m"
    )


def _poses(robot: Robot, path: Path) -> int:
    """Number of intervals at which a path is checked."""
    coarse = path(np.linspace(0.0, 1.0, 20 * path.pieces + 1))
    travel = np.abs(np.diff(coarse, axis=0)) / np.where(robot.revolute, *_RESOLUTION)
    return max(8, int(np.ceil(travel.max(axis=1).sum())))


def detour(
    robot: Robot, start: Array, goal: Array, free: Edge, rng: np.random.Generator, samples: int
) -> Array | None:
    """Waypoints from start to goal over free straight segments, shape (k, nv), or None.

    Two trees grow towards random poses and towards each other (RRT-Connect, Kuffner and
    LaValle 2000); the result is shortened by random shortcuts.

    Args:
        robot: Arm; poses are drawn inside its position limits, at most half a turn beyond the
            box of start and goal.
        start: First pose, shape (nv,).
        goal: Last pose, shape (nv,).
        free: Whether the straight segment between two poses is allowed.
        rng: Source of the poses.
        samples: Number of poses drawn before giving up.
    """
    around = np.stack([np.minimum(start, goal) - np.pi, np.maximum(start, goal) + np.pi])
    low, high = np.clip(around, *robot.limits.position.T)
    trees: list[tuple[list[Array], list[int]]] = [([start], [-1]), ([goal], [-1])]
    for count in range(samples):
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


def _grow(
    tree: tuple[list[Array], list[int]], target: Array, free: Edge, *, once: bool
) -> int | None:
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


def _branch(tree: tuple[list[Array], list[int]], leaf: int) -> list[Array]:
    nodes, parents = tree
    branch = []
    while leaf >= 0:
        branch.append(nodes[leaf])
        leaf = parents[leaf]
    return branch


def _shortened(waypoints: Array, free: Edge, rng: np.random.Generator) -> Array:
    """The polyline with free shortcuts between random points of it."""
    for _ in range(_SHORTCUTS):
        length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(waypoints, axis=0), axis=1)))
        cut = np.sort(rng.uniform(0.0, length[-1], 2))
        a, b = (np.array([np.interp(c, length, column) for column in waypoints.T]) for c in cut)
        if free(a, b):
            before, after = waypoints[length < cut[0]], waypoints[length > cut[1]]
            waypoints = np.vstack([before, a, b, after])
    kept = np.append(True, np.linalg.norm(np.diff(waypoints, axis=0), axis=1) > 1e-9)
    shortened: Array = waypoints[kept]
    return shortened


def free_path(
    robot: Robot,
    start: Array,
    goal: Array,
    clearance: Clearance | None,
    margin: float,
    rng: np.random.Generator,
    samples: int,
) -> Path | Obstruction:
    """The straight path, else one around what obstructs it, else what obstructs it.

    Args:
        robot: Arm with limits.
        start: First pose, shape (nv,).
        goal: Last pose, another one, shape (nv,).
        clearance: See `obstruction`.
        margin: See `obstruction`.
        rng: Source of via points.
        samples: Number of via points tried before giving up.
    """
    straight = rounded_path(np.stack([start, goal]), 1.0)
    blocked = obstruction(robot, straight, clearance, margin)
    if blocked is None:
        return straight

    def free(a: Array, b: Array) -> bool:
        if np.array_equal(a, b):
            return True
        segment = rounded_path(np.stack([a, b]), 1.0)
        return obstruction(robot, segment, clearance, margin) is None

    waypoints = detour(robot, start, goal, free, rng, samples)
    if waypoints is None:
        return blocked
    for spacing in _SPACINGS:
        path = rounded_path(waypoints, spacing)
        if obstruction(robot, path, clearance, margin) is None:
            return path
    return blocked
