"""Trajectories within all limits to start from, and why there may be none."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from excitant.design.constraints import kinematic_limits, position_range
from excitant.design.trajectory import (
    FourierSeries,
    FourierTrajectory,
    Series,
    Trajectory,
    from_coefficients,
)
from excitant.exceptions import Infeasible
from excitant.robots import Array, Motion, Robot
from excitant.robots.torque import largest_torque

_POSES = 2000
_POLISH = 30
_DRAWS = 20
_SHRINKS = 40
_TORQUE_SAMPLES = 32  # per harmonic
_WAVES = 10  # highest harmonic of a random start
_TORQUE_SHARE = 0.99  # of the limit at the samples, which leaves room between them


PoseUse = Callable[[Array], Array]
"""Use of a limit on poses alone by each pose, (n, nv) to (n,); at most 1 where it holds."""


def random_trajectory(
    robot: Robot, rng: np.random.Generator, duration: float, harmonics: int
) -> FourierTrajectory:
    """A random Fourier series at rest at both ends and within all limits of the robot.

    Args:
        robot: The arm; its limits count.
        rng: Source of randomness.
        duration: Period [s].
        harmonics: Number of harmonics, at least 2.

    Raises:
        Infeasible: No pose, or no motion found, within position and torque limits.
    """
    drawn = random_start(robot, rng, FourierSeries(duration, harmonics))
    return from_coefficients(drawn.coefficients, duration)


def random_start(
    robot: Robot,
    rng: np.random.Generator,
    series: Series,
    pose_use: PoseUse | None = None,
) -> Trajectory:
    """A random trajectory at rest at both ends and within all limits of the robot.

    Args:
        robot: The arm; its limits count.
        rng: Source of randomness.
        series: Functions of time that it is a combination of.
        pose_use: A limit on poses, such as clearance.

    Raises:
        Infeasible: No pose, or no motion found, within position and torque limits.
    """
    t = series.instants(_TORQUE_SAMPLES)
    drawn: list[tuple[float, int, Trajectory]] = []
    for _ in range(_DRAWS):
        trajectory = _draw(robot, rng, series)
        ratio = max(
            float(torque_use(robot, trajectory.at(t)).max()),
            float(pose_use(trajectory(t)).max()) if pose_use else 0.0,
        )
        if ratio <= _TORQUE_SHARE:
            return trajectory
        drawn.append((ratio, len(drawn), trajectory))
    best = min(drawn)[2]
    X0 = series.constant(standstill(robot, rng, pose_use))
    for share in 0.7 ** np.arange(1, _SHRINKS):
        trajectory = series.trajectory(X0 + share * (best.coefficients - X0))
        use = torque_use(robot, trajectory.at(t))
        apart = float(pose_use(trajectory(t)).max()) if pose_use else 0.0
        if max(use.max(), apart) <= _TORQUE_SHARE:
            return trajectory
    if use.max() <= _TORQUE_SHARE:
        raise Infeasible(
            f"trajectory of {robot.name}",
            "every motion tried comes too close to an obstacle or to the arm itself; lower the "
            "required clearance or widen the position limits",
        )
    joint = robot.joints[int(use.argmax())]
    raise Infeasible(
        f"trajectory of {robot.name}",
        f"torque limit of joint {joint} is exceeded by every motion tried, however slow "
        f"(down to {use.max():.4g} times the limit); raise the torque limit",
    )


def torque_use(robot: Robot, motion: Motion) -> Array:
    """Largest torque over its limit per joint at the instants of a motion, shape (nv,)."""
    use: Array = (np.abs(largest_torque(robot, motion)) / robot.limits.torque).max(axis=0)
    return use


def _draw(robot: Robot, rng: np.random.Generator, series: Series) -> Trajectory:
    """Random waves, scaled joint by joint into the kinematic limits."""
    middle, half = position_range(robot.limits)
    half = np.where(np.isfinite(half), half, np.pi)
    bound = kinematic_limits(robot.limits)[1]
    waves = FourierSeries(series.period, min(series.terms, _WAVES))
    fade = 1 / np.arange(1, waves.harmonics + 1)[:, None] ** rng.uniform(0.0, 2.0)
    X = rng.normal(size=(waves.size, robot.nv))
    X[1:] *= np.vstack([fade, fade])
    X[0] = 0.0
    X = waves.rest @ (waves.rest.T @ X)
    X[0] = 0.0
    X = series.nearest(waves.trajectory(X))
    moved = series.trajectory(X)
    reach = [np.maximum(*(np.abs(e) for e in moved.extrema(k))) for k in range(len(bound))]
    shift = rng.uniform(0.0, 0.6, robot.nv) * rng.choice([-1.0, 1.0], robot.nv) * half
    room = [half - np.abs(shift), *bound[1:]]
    share = np.min([b / np.maximum(r, 1e-12) for b, r in zip(room, reach, strict=True)], axis=0)
    X = X * share * rng.uniform(0.5, 0.99, robot.nv)
    return series.trajectory(X + series.constant(middle + shift))


def standstill(robot: Robot, rng: np.random.Generator, pose_use: PoseUse | None = None) -> Array:
    """A pose within the position limits that the torque limits can hold, shape (nv,).

    The best of many random poses, improved by random search around it.

    Raises:
        Infeasible: Gravity needs more torque than the limit at every pose tried, or none keeps
            the clearance.
    """
    middle, half = position_range(robot.limits)
    half = np.where(np.isfinite(half), half, np.pi)
    width, pose, best = 1.0, middle, np.inf
    use = np.zeros(robot.nv)
    for _ in range(_POLISH):
        poses = pose + width * half * rng.uniform(-1, 1, (_POSES // _POLISH * 2, robot.nv))
        poses = np.clip(poses, middle - half, middle + half)
        zero = np.zeros_like(poses)
        held = Motion(np.arange(len(poses), dtype=float), poses, zero, zero)
        uses = np.abs(largest_torque(robot, held)) / robot.limits.torque
        apart = pose_use(poses) if pose_use else np.zeros(len(poses))
        worst = np.maximum(uses.max(axis=1), apart)
        k = int(worst.argmin())
        if worst[k] < best:
            best, pose, use = float(worst[k]), poses[k], uses[k]
        width *= 0.8
    if best < _TORQUE_SHARE:
        return pose
    if use.max() < _TORQUE_SHARE:
        raise Infeasible(
            f"trajectory of {robot.name}",
            "every pose tried is too close to an obstacle or to the arm itself; lower the "
            "required clearance, move the obstacles or widen the position limits",
        )
    tight = [robot.joints[j] for j in np.flatnonzero(use >= 0.999 * best)]
    limit = ", ".join(f"{robot.limits.torque[robot.joint_index(j)]:.4g} N·m" for j in tight)
    raise Infeasible(
        f"trajectory of {robot.name}",
        f"torque limit of {', '.join(tight)} ({limit}) is below what gravity needs at every "
        f"pose within the position limits (at least {best:.3g} times the limit); raise the "
        "torque limit or widen the position limits",
    )
