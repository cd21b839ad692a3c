"""Motion to an excitation and back, and along a path of the user's own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from excitant.design.paths import (
    HOLDING,
    Clearance,
    Obstruction,
    free_path,
    holding_refusal,
    obstruction,
    spline_path,
)
from excitant.design.timing import timed
from excitant.exceptions import BadInput, Infeasible
from excitant.robots import Array, Motion, Robot
from excitant.robots.motion import read_only
from excitant.robots.torque import largest_torque

_SAMPLES = 1000  # via points tried


def approach(
    robot: Robot,
    start: npt.ArrayLike,
    goal: npt.ArrayLike,
    *,
    clearance: Clearance | None = None,
    margin: float = 0.0,
    rate_hz: float = 100.0,
    slowdown: float = 1.0,
    rng: np.random.Generator | None = None,
) -> Motion:
    """Fastest motion from rest at the present pose to rest at the first pose of an excitation.

    The path is the straight line in joint space. Where that comes too close to an obstacle, or
    through a pose that the motors cannot hold, it leads around (`excitant.design.paths.detour`).
    Its speed is that of TOPP-RA (Pham and Pham 2018) under the limits on velocity, acceleration
    and torque, the robot's effects included; see `retime` for limits that are missing. At both
    ends q̇ = q̈ = 0. All limits hold between samples too, in the sense of
    `excitant.design.constraints.check`.

    Args:
        robot: Arm with its limits and effects.
        start: Present pose, shape (nv,) [rad or m].
        goal: Pose to reach, shape (nv,) [rad or m].
        clearance: Distance of a pose (nv,) to the nearest obstacle [m], negative inside.
        margin: Smallest clearance allowed [m].
        rate_hz: Control rate of the samples [Hz].
        slowdown: Factor ≥ 1 on the shortest duration.
        rng: Source of via points; seeded with 0 by default.

    Raises:
        BadInput: Poses of another size or outside the limits, or an option that makes no sense.
        Infeasible: No way was found, or a pose needs more torque than the limit against gravity.
    """
    rng = np.random.default_rng(0) if rng is None else rng
    options = _Options("approach", clearance, margin, rate_hz, slowdown)
    return _travel(robot, start, goal, options, rng)


def return_path(
    robot: Robot,
    start: npt.ArrayLike,
    goal: npt.ArrayLike,
    *,
    clearance: Clearance | None = None,
    margin: float = 0.0,
    rate_hz: float = 100.0,
    slowdown: float = 1.0,
    rng: np.random.Generator | None = None,
) -> Motion:
    """Fastest motion from rest at the last pose of an excitation back to rest elsewhere.

    The same as `approach`, named so that an error tells which of the two has failed.
    """
    rng = np.random.default_rng(0) if rng is None else rng
    options = _Options("return", clearance, margin, rate_hz, slowdown)
    return _travel(robot, start, goal, options, rng)


def retime(
    robot: Robot,
    path: npt.ArrayLike,
    *,
    clearance: Clearance | None = None,
    margin: float = 0.0,
    rate_hz: float = 100.0,
    slowdown: float = 1.0,
) -> Motion:
    """Fastest motion, from rest to rest, along a natural cubic spline through given poses.

    A joint without acceleration limit is held by its torque limit alone; with neither, 10 rad/s²
    or m/s² applies (`excitant.design.timing.DEFAULT_ACCELERATION`). A joint without velocity
    limit may become as fast as the others allow.

    Args:
        robot: Arm with its limits and effects.
        path: Poses in order, shape (k, nv) [rad or m]; equal neighbours count once.
        clearance: See `approach`; a path that comes too close is refused, not changed.
        margin: Smallest clearance allowed [m].
        rate_hz: Control rate of the samples [Hz].
        slowdown: Factor ≥ 1 on the shortest duration.

    Raises:
        BadInput: Fewer than two poses, poses of another size or outside the limits, also
            between the given ones, or an option that makes no sense.
        Infeasible: Obstructed, or a pose needs more torque than the limit against gravity.
    """
    options = _Options("retiming", clearance, margin, rate_hz, slowdown)
    poses = _numbers(path)
    if poses.ndim != 2 or poses.shape[1] != robot.nv or len(poses) < 2:
        raise BadInput(
            f"retiming: path has shape {poses.shape}, expected (poses, {robot.nv}) with at least "
            f"two poses of the {robot.nv} joints of {robot.name}"
        )
    for k, pose in enumerate(poses):
        _inside(robot, pose, f"retiming: pose {k}")
    poses = poses[np.append(True, np.any(np.diff(poses, axis=0) != 0, axis=1))]
    if len(poses) == 1:
        return _standstill(robot, poses[0], options)
    curve = spline_path(poses)
    for s in np.linspace(0.0, 1.0, 20 * curve.pieces + 1)[1:-1]:
        _inside(robot, curve(s), f"retiming: the spline through the poses at {100 * s:.3g} %")
    blocked = obstruction(robot, curve, clearance, margin)
    if blocked is not None:
        raise Infeasible("retiming", _where(blocked, "path"))
    return timed(robot, curve, rate_hz, slowdown, problem="retiming")


@dataclass(frozen=True)
class _Options:
    problem: str
    clearance: Clearance | None
    margin: float
    rate_hz: float
    slowdown: float

    def __post_init__(self) -> None:
        if not 1 <= self.rate_hz <= 10_000:
            raise BadInput(f"{self.problem}: rate {self.rate_hz:g} Hz: give 1 to 10000 Hz")
        if not 1 <= self.slowdown < np.inf:
            raise BadInput(f"{self.problem}: slowdown {self.slowdown:g}: give a factor from 1 up")


def _travel(
    robot: Robot,
    start: npt.ArrayLike,
    goal: npt.ArrayLike,
    options: _Options,
    rng: np.random.Generator,
) -> Motion:
    poses = {"start": _numbers(start), "goal": _numbers(goal)}
    for name, pose in poses.items():
        if pose.shape != (robot.nv,):
            raise BadInput(
                f"{options.problem}: {name} has shape {pose.shape}, expected ({robot.nv},) for "
                f"the {robot.nv} joints of {robot.name}"
            )
        _inside(robot, pose, f"{options.problem}: {name}")
        _holdable(robot, pose, name, options)
    q0, q1 = poses["start"], poses["goal"]
    if np.array_equal(q0, q1):
        return _standstill(robot, q0, options)
    path = free_path(robot, q0, q1, options.clearance, options.margin, rng, _SAMPLES)
    if isinstance(path, Obstruction):
        raise Infeasible(
            options.problem,
            f"{_where(path, 'straight line')} and no way around was found with {_SAMPLES} via "
            "points; choose another pose",
        )
    return timed(robot, path, options.rate_hz, options.slowdown, problem=options.problem)


def _numbers(values: npt.ArrayLike) -> Array:
    try:
        return read_only(values)
    except (TypeError, ValueError):
        raise BadInput("a pose or path is not a regular table of numbers") from None


def _inside(robot: Robot, pose: Array, what: str) -> None:
    low, high = robot.limits.position.T
    hair = 1e-9 * np.maximum(1.0, np.abs(pose))
    bad = ~((pose >= low - hair) & (pose <= high + hair) & np.isfinite(pose))
    if bad.any():
        j = int(bad.argmax())
        raise BadInput(
            f"{what}: joint {robot.joints[j]} at {pose[j]:.6g} is outside its limits "
            f"{low[j]:.6g} to {high[j]:.6g}"
        )


def _holdable(robot: Robot, pose: Array, name: str, options: _Options) -> None:
    """Refuse an end pose that the motors cannot hold or that touches an obstacle."""
    share = np.abs(largest_torque(robot, _still(pose, np.zeros(1)))[0]) / robot.limits.torque
    j = int(share.argmax())
    if share[j] > HOLDING:
        why = f"{holding_refusal(robot, j, float(share[j]))} in the {name} pose"
        raise Infeasible(options.problem, f"{why}; choose another pose")
    distance = np.inf if options.clearance is None else float(options.clearance(pose))
    if not distance >= options.margin:
        raise Infeasible(
            options.problem,
            f"the {name} pose has a clearance of {distance:.4g} m, needed are "
            f"{options.margin:.4g} m; choose another pose",
        )


def _still(pose: Array, t: Array) -> Motion:
    q = np.tile(pose, (len(t), 1))
    return Motion(t, q, np.zeros_like(q), np.zeros_like(q))


def _standstill(robot: Robot, pose: Array, options: _Options) -> Motion:
    _holdable(robot, pose, "only", options)
    return _still(pose, np.array([0.0, 1.0 / options.rate_hz]))


def _where(blocked: Obstruction, line: str) -> str:
    return f"{blocked.why} at {100 * blocked.share:.3g} % of the {line}"
