"""Clearance: how near an arm comes to itself and to obstacles, between samples too."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from excitant.design.trajectory import HermiteTrajectory, Trajectory
from excitant.robots import Array
from excitant.robots.geometry import Scene

_RESOLUTION = 1e-3  # m: how sharply the smallest distance is bounded
_INTERVALS = 200
_LARGEST = 200_000  # poses; beyond them the bound stays looser than the resolution
SCALE = 0.1  # m of missing clearance that count like a limit exceeded by its own size


@dataclass(frozen=True)
class Clearance:
    """Smallest distance over a continuous motion.

    Attributes:
        distance: Smallest distance found [m]; negative where bodies overlap.
        certified: No instant has a smaller distance than this [m].
        bodies: The two bodies.
        time: When [s].
    """

    distance: float
    certified: float
    bodies: tuple[str, str]
    time: float


def clearance(scene: Scene, path: Trajectory | HermiteTrajectory) -> Clearance:
    """Smallest distance over a continuous motion, by branch and bound in time.

    Between two instants a pair's distance falls below neither end by more than half of what
    its bodies can approach each other in that time, a bound from joint speeds and lever arms.

    Args:
        scene: The arm among its obstacles.
        path: Trajectory (one period) or interpolated samples.
    """
    start, end, speed = _span(path)
    t = np.linspace(start, end, _INTERVALS + 1)
    distance = scene.distances(path(t))
    approach = scene.speeds() @ speed  # m/s, per pair
    left, right = distance[:-1], distance[1:]
    begin, length = t[:-1], t[1] - t[0]
    best, evaluated = _smallest(scene, distance, t), len(t)
    while True:
        bound = ((left + right - approach * length) / 2).min(axis=1)
        open_ = bound < best.distance - _RESOLUTION
        certified = min(best.distance - _RESOLUTION, float(bound.min(initial=np.inf)))
        if not open_.any() or evaluated > _LARGEST:
            return Clearance(best.distance, certified, best.bodies, best.time)
        left, right, begin, length = left[open_], right[open_], begin[open_], length / 2
        middle = scene.distances(path(begin + length))
        evaluated += len(middle)
        found = _smallest(scene, middle, begin + length)
        best = min(best, found, key=lambda c: c.distance)
        left, right = np.vstack([left, middle]), np.vstack([middle, right])
        begin = np.concatenate([begin, begin + length])


def _span(path: Trajectory | HermiteTrajectory) -> tuple[float, float, Array]:
    """First and last instant [s] and a bound on each joint's speed in between."""
    if isinstance(path, Trajectory):
        return 0.0, path.period, np.abs(path.extrema(1)).max(axis=0)
    t = path.samples.t
    fine = np.linspace(t[0], t[-1], 20 * len(t))
    return float(t[0]), float(t[-1]), 1.05 * np.abs(path(fine, 1)).max(axis=0)


def _smallest(scene: Scene, distance: Array, t: Array) -> Clearance:
    k, pair = np.unravel_index(int(np.argmin(distance)), distance.shape)
    value = float(distance[k, pair])
    return Clearance(value, value, scene.pairs[int(pair)], float(t[k]))


def pose_use(scene: Scene, required: float, q: Array) -> Array:
    """1 where a pose has the distance required; more where it has less, shape (n,)."""
    return np.asarray(1 + (required - scene.distances(q).min(axis=1)) / SCALE)
