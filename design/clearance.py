"""Clearance: how near an arm comes to itself and to obstacles, between samples too."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from excitant.design.interpolation import HermiteTrajectory
from excitant.design.trajectory import Trajectory
from excitant.robots import Array
from excitant.robots.geometry import Scene

if TYPE_CHECKING:
    from excitant.design.problem import DesignProblem

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


def clearance_use(problem: DesignProblem, z: Array) -> float:
    """1 where the smallest distance at the problem's instants is what is required; above, less."""
    if problem.scene is None:
        return 0.0
    return float(pose_use(problem.scene, problem.required, problem.grid_bases[0] @ z).max())


def clearance_rows(problem: DesignProblem, z: Array, near: float) -> tuple[Array, Array]:
    """Linearised use of the clearance by the unknowns, at each pair's nearest instants.

    Args:
        problem: The design problem.
        z: Unknowns, shape (c − 2, nv).
        near: Use from which an instant becomes a row.

    Returns:
        Rows of shape (m, k), and the use at z, shape (m,).
    """
    if problem.scene is None:
        return np.zeros((0, problem.size)), np.zeros(0)
    q = problem.grid_bases[0] @ z
    distance = problem.scene.distances(q)
    use = 1 + (problem.required - distance) / SCALE
    nearest = (distance <= np.roll(distance, 1, axis=0)) & (
        distance < np.roll(distance, -1, axis=0)
    )
    rows, uses = [], []
    for k, pair in np.argwhere(nearest & (use > near)):
        _, gradient = problem.scene.gradient(q[k], int(pair))
        rows.append(-np.outer(problem.grid_bases[0][k], gradient).ravel() / SCALE)
        uses.append(use[k, pair])
    return np.reshape(rows, (-1, problem.size)), np.array(uses)
