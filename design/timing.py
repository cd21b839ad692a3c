"""Time-optimal speed along a path under limits on velocity, acceleration and torque."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from excitant.design.constraints import LimitReport, LimitUse, check
from excitant.design.paths import Path
from excitant.design.profile import PathDynamics, Profile, path_dynamics, path_kinematics
from excitant.exceptions import Infeasible
from excitant.robots import Array, Motion, Robot

DEFAULT_ACCELERATION = 10.0  # rad/s² or m/s², of a joint with neither acceleration nor torque limit

_UNBOUNDED = 1e4  # of the joint speed in units of the path, where there is no limit
_STAGES = 300  # intervals of the path at least
_PASSES = 8  # of the linearisation of friction in the squared speed
_SETTLED = 5e-4  # relative change of the duration between passes
_STAGES_PER_PIECE = 8
_BLUR = 2.0  # samples over which a jump of acceleration is spread
_TIGHTENED = 6  # attempts to hold the limits between samples by lower limits
_SLOWER = 15  # and by a lower speed


def timed(
    robot: Robot, path: Path, rate_hz: float, slowdown: float = 1.0, *, problem: str = "timing"
) -> Motion:
    """The fastest or a slower motion along a path, with all limits held between samples too.

    Where the samples exceed a limit, the speed is computed again under a limit lower by the
    excess. Where that leaves no solution, because an arm barely holds its own weight, the motion
    is slowed down as a whole.

    Args:
        robot: Arm with its limits and effects.
        path: The path.
        rate_hz: Control rate of the samples [Hz].
        slowdown: Factor ≥ 1 on the shortest duration. Where a slower arm would need more
            torque, because it no longer swings past a pose that is hard to hold, it is slower.
        problem: What fails when there is no solution.

    Raises:
        Infeasible: No speed holds the limits.
    """
    tightened, profiles = robot, list[Profile]()
    for _ in range(_TIGHTENED):
        try:
            profiles.append(_profile(tightened, path, rate_hz, slowdown, problem))
        except Infeasible:
            if not profiles:
                raise
            break
        motion = profiles[-1].motion(path, rate_hz)
        report = check(robot, motion)
        if _holds(report):
            return motion
        tightened = _tightened(tightened, report)
    for factor in 1 + 1e-3 * 2.0 ** np.arange(_SLOWER):
        motion = profiles[0].slower(factor).motion(path, rate_hz)
        report = check(robot, motion)
        if _holds(report):
            return motion
    worst = max(_timely(report), key=lambda use: use.ratio)
    raise Infeasible(
        problem,
        f"the {worst.quantity} limit of joint {worst.joint} does not hold at any speed; choose "
        "another path or raise it",
    )


def _profile(robot: Robot, path: Path, rate_hz: float, slowdown: float, problem: str) -> Profile:
    blur = _BLUR / rate_hz
    profile = time_optimal(robot, path, blur=blur, problem=problem)
    if slowdown == 1:
        return profile
    cap = profile.slower(slowdown).speed
    return time_optimal(robot, path, cap, blur=blur, problem=problem)


def _timely(report: LimitReport) -> tuple[LimitUse, ...]:
    """The limits that depend on the speed along the path."""
    return (report.velocity, report.acceleration, report.torque)


def _holds(report: LimitReport) -> bool:
    return all(use.ratio <= 1 for use in _timely(report))


def _tightened(robot: Robot, report: LimitReport) -> Robot:
    """The robot with each exceeded limit lowered by the excess and a hair."""
    lower = {
        use.quantity: getattr(robot.limits, use.quantity)
        / np.where(use.ratios > 1, use.ratios + 1e-4, 1.0)
        for use in _timely(report)
    }
    return robot.with_limits(replace(robot.limits, **lower))


def time_optimal(
    robot: Robot,
    path: Path,
    cap: Array | None = None,
    *,
    blur: float = 0.0,
    problem: str = "timing",
) -> Profile:
    """Fastest speed along a path from rest to rest, by TOPP-RA (Pham and Pham 2018).

    Friction that depends on the speed is linearised in its square at the result before, until
    the duration settles or there is no solution any more. A joint without acceleration limit is
    held by its torque limit; with neither, by `DEFAULT_ACCELERATION`.

    Args:
        robot: Arm with its limits and effects.
        path: The path.
        cap: Largest speed ṡ at the positions of the result, shape (n,) [1/s].
        blur: See `path_dynamics` [s].
        problem: What fails when there is no solution.

    Raises:
        Infeasible: No speed holds the limits.
    """
    grid = np.linspace(0.0, 1.0, max(_STAGES, _STAGES_PER_PIECE * path.pieces) + 1)
    limits = robot.limits
    unlimited = np.isinf(limits.acceleration) & np.isinf(limits.torque)
    acceleration = np.where(unlimited, DEFAULT_ACCELERATION, limits.acceleration)
    kinematic = path_kinematics(path, grid)
    unit, profile = _time_scale(robot, path, acceleration), None
    for _ in range(_PASSES):
        speed = None if profile is None else profile.speed
        dynamics = path_dynamics(robot, path, grid, speed, blur)
        rows = [(kinematic, acceleration), (dynamics, limits.torque)]
        found = _topp(path, grid, limits.velocity, cap, rows, unit)
        if found is None:
            break
        settled = profile is not None and abs(found.duration / unit - 1) < _SETTLED
        profile, unit = found, found.duration
        if settled:
            break
    if profile is None:
        raise Infeasible(problem, "no speed along the path holds the limits; choose another path")
    return profile


def _time_scale(robot: Robot, path: Path, acceleration: Array) -> float:
    """Order of magnitude of the duration, the unit of time of the first pass [s]."""
    way = np.abs(np.diff(path(np.linspace(0, 1, 20 * path.pieces + 1)), axis=0)).sum(axis=0)
    finite = np.where(np.isinf(acceleration), DEFAULT_ACCELERATION, acceleration)
    return float(np.max(np.maximum(way / robot.limits.velocity, 2 * np.sqrt(way / finite))))


def _topp(
    path: Path,
    grid: Array,
    velocity: Array,
    cap: Array | None,
    rows: list[tuple[PathDynamics, Array]],
    unit: float,
) -> Profile | None:
    """Solve |q' ṡ| ≤ velocity, |a s̈ + b ṡ² + c| ≤ bound for the fastest ṡ, in a unit of time."""
    from toppra.algorithm import TOPPRA
    from toppra.constraint import JointVelocityConstraint

    limits = [JointVelocityConstraint(np.minimum(velocity * unit, _UNBOUNDED))]
    if cap is not None:
        limits.append(_speed_constraint(cap * unit))
    for dynamics, bound in rows:
        bounded = np.isfinite(bound)
        if bounded.any():
            limits.append(_linear_constraint(dynamics, bound, bounded, unit))
    problem = TOPPRA(limits, path, gridpoints=grid, solver_wrapper="seidel")
    speed = problem.compute_parameterization(0.0, 0.0)[1]
    if speed is None or not np.isfinite(speed).all():
        return None
    if np.any(speed[:-1] + speed[1:] <= 0):
        return None
    return Profile(grid, speed / unit)


def _speed_constraint(cap: Array) -> Any:
    """The constraint 0 ≤ ṡ ≤ cap as toppra takes it."""
    from toppra.constraint import LinearConstraint

    squared = np.stack([np.zeros(len(cap)), cap**2], axis=1)
    constraint = LinearConstraint()
    constraint.compute_constraint_params = lambda path, grid: (None,) * 6 + (squared,)
    return constraint


def _linear_constraint(
    dynamics: PathDynamics, bound: Array, rows: npt.NDArray[np.bool_], unit: float
) -> Any:
    """The constraint |a s̈ + b ṡ² + c| ≤ bound as toppra takes it, at both ends of each stage."""
    from toppra.constraint import DiscretizationType, LinearConstraint
    from toppra.constraint.linear_constraint import canlinear_colloc_to_interpolate

    a, b = ((x / unit**2 / bound)[:, rows] for x in (dynamics.a, dynamics.b))
    a, b = np.hstack([a, -a]), np.hstack([b, -b])
    c = np.hstack([(x / bound)[:, rows] for x in (dynamics.high, -dynamics.low)])
    F, g = np.eye(a.shape[1]), np.ones(a.shape[1])

    def parameters(path: Path, grid: Array) -> Any:
        return canlinear_colloc_to_interpolate(a, b, c, F, g, None, None, grid, identical=True)

    constraint = LinearConstraint()
    constraint.identical = True
    constraint.set_discretization_type(DiscretizationType.Interpolation)
    constraint.compute_constraint_params = parameters
    return constraint
