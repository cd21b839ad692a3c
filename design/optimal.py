"""Design of excitation trajectories by sequential convex programming from many starts."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace

import joblib
import numpy as np
import numpy.typing as npt

from excitant.design.constraints import check, within_limits
from excitant.design.constraints import clearance as motion_clearance
from excitant.design.criterion import CRITERIA, condition_number, information, objective
from excitant.design.problem import DesignProblem
from excitant.design.result import Design, dense_motion
from excitant.design.search import SearchState, best_solutions
from excitant.design.starts import Effort, connect, search
from excitant.design.trajectory import FourierSeries, Series, SplineSeries, Trajectory
from excitant.exceptions import BadInput, UnknownName
from excitant.robots import Array, Motion, Robot
from excitant.robots.geometry import Scene

Progress = Callable[[int, int | None, float, float], None]
"""Called with starts done, starts in all (None: until the time limit), best condition number
and its worst limit ratio."""

SERIES = ("fourier", "spline")
TOP_HZ = 2.5  # a quarter of the cut-off that identification filters at

_STARTS = 16
FEWEST = 5  # harmonics that a search for their number begins with
CLEARANCE = 0.01  # m
_CLEARANCE_MARGIN = 0.004  # m, for what happens between the instants of the optimiser
CANDIDATES = 4  # best searches whose exact figures decide


def build_design(
    robot: Robot,
    *,
    duration: float = 10.0,
    harmonics: int = 5,
    series: str = "fourier",
    criterion: str = "condition",
    columns: str = "friction",
    noise: npt.ArrayLike | None = None,
    earlier: Sequence[Motion] = (),
    scene: Scene | None = None,
    clearance: float = CLEARANCE,
) -> DesignProblem:
    """State the design problem without solving it; see `design`."""
    if criterion not in CRITERIA:
        raise UnknownName("criterion", criterion, CRITERIA)
    if not np.isfinite(clearance) or clearance < 0:
        raise BadInput(f"clearance {clearance} m is not a distance")
    return DesignProblem(
        information(robot, columns, noise=noise, earlier=earlier, duration=duration),
        criterion,
        _series(series, duration, harmonics),
        scene,
        clearance + _CLEARANCE_MARGIN,
    )


def _series(name: str, duration: float, harmonics: int) -> Series:
    if name not in SERIES:
        raise UnknownName("series", name, SERIES)
    if not (np.isfinite(duration) and duration > 0):
        raise BadInput(f"duration {duration} s is not a positive number")
    fewest = 2 if name == "fourier" else 3
    if harmonics < fewest:
        raise BadInput(
            f"{harmonics} harmonics cannot move and be at rest at both ends; use at least {fewest}"
        )
    if name == "spline":
        return SplineSeries(float(duration), 2 * harmonics)
    return FourierSeries(float(duration), harmonics)


def design_trajectory(
    robot: Robot,
    *,
    duration: float | tuple[float, float] = 10.0,
    harmonics: int | None = 5,
    series: str = "fourier",
    top_hz: float = TOP_HZ,
    criterion: str = "condition",
    columns: str = "friction",
    noise: npt.ArrayLike | None = None,
    earlier: Sequence[Motion] = (),
    scene: Scene | None = None,
    clearance: float = CLEARANCE,
    starts: int | None = None,
    jobs: int | None = None,
    cluster: str | None = None,
    seed: int = 0,
    time_limit: float | None = None,
    progress: Progress | None = None,
) -> Design:
    """Excitation trajectory that makes the base parameters best visible within the limits.

    Minimises the criterion of M = WᵀW / n over periodic motions that are at rest at both ends
    and keep every limit of the robot in continuous time.

    Args:
        robot: The arm; its limits and effects count.
        duration: Period [s], or the shortest and the longest to choose from.
        harmonics: Number of harmonics, at least 2; None to add harmonics while they pay.
        series: ``"fourier"``, or ``"spline"``: B-splines with twice as many pieces as there
            would be harmonics, whose local freedom suits tight cells.
        top_hz: Highest frequency up to which harmonics are added [Hz].
        criterion: ``"condition"`` (cond₂ W), ``"d"`` (det M), ``"a"`` (tr M⁻¹), ``"e"`` (λmin).
        columns: ``"friction"`` or ``"inertial"``.
        noise: Standard deviation of each joint's torque noise, shape (nv,) [N·m or N], to
            weight its equations with; equal if not given.
        earlier: Motions recorded already, whose information counts: what should run next?
        scene: The arm's bodies among obstacles, kept apart; None to leave clearance out.
        clearance: Smallest distance that they keep [m].
        starts: Number of searches; 16 by default, or as many as fit in a time limit.
        jobs: Number of processes; as many as processors by default. Without a time limit the
            result does not depend on it.
        cluster: Address of a Dask scheduler to search on instead.
        seed: Seed of all randomness.
        time_limit: Time after which the best so far is returned [s]. Ctrl-C does the same.
        progress: Called whenever a search has news.

    Raises:
        Infeasible: No motion keeps the limits; names those in conflict.
        UnknownName: Another criterion, other columns or another series.
        BadInput: Duration, harmonics or starts out of range, or no cluster there.
    """
    began = time.time()
    starts = number_of_starts(starts, time_limit, _STARTS)
    shortest, longest = period_range(duration)
    terms = FEWEST if harmonics is None else harmonics
    problem = build_design(
        robot,
        duration=longest,
        harmonics=terms,
        series=series,
        criterion=criterion,
        columns=columns,
        noise=noise,
        earlier=earlier,
        scene=scene,
        clearance=clearance,
    )
    problem.random(np.random.default_rng([seed, 0]))  # refuses at once what no motion keeps
    deadline = np.inf if time_limit is None else began + time_limit
    tell = _Teller(starts, progress)
    with ExitStack() as stack:
        client = stack.enter_context(connect(cluster)) if cluster else None
        effort = Effort(starts, jobs or int(joblib.cpu_count()), seed, deadline, tell, client)
        problem, searches = search(problem, effort, shortest, top_hz if harmonics is None else None)
    first = replace(problem, series=problem.series.resized(terms))
    initial = first.random(np.random.default_rng([seed, 0]))
    chosen = _best(problem, initial, searches)
    wall_s = time.time() - began
    return Design(problem.information, criterion, initial, chosen, scene, searches, wall_s)


def number_of_starts(starts: int | None, time_limit: float | None, default: int) -> int | None:
    """The starts asked for, else the default; None for as many as fit into a time limit."""
    if starts is not None and starts < 1:
        raise BadInput(f"{starts} starts: at least one is needed")
    return default if starts is None and time_limit is None else starts


def period_range(duration: float | tuple[float, float]) -> tuple[float, float]:
    """The shortest and the longest period [s]."""
    shortest, longest = duration if isinstance(duration, tuple) else (duration, duration)
    if not 0 < shortest <= longest:
        raise BadInput(f"duration {shortest:g} to {longest:g} s: give the shorter one first")
    return shortest, longest


def _information(problem: DesignProblem, trajectory: Trajectory) -> Array:
    return problem.information.matrix(dense_motion(trajectory))


def _best(
    problem: DesignProblem, initial: Trajectory, searches: Sequence[SearchState]
) -> Trajectory:
    """The best trajectory within all limits by its exact figures; at worst the initial one."""
    candidates = [initial]
    for z in best_solutions(searches, CANDIDATES):
        kept = within_limits(problem.robot, problem.trajectory(z))
        if kept is not None and _keeps_apart(problem, kept):
            candidates.append(kept)
    return min(candidates, key=lambda x: objective(_information(problem, x), problem.criterion))


def _keeps_apart(problem: DesignProblem, trajectory: Trajectory) -> bool:
    if problem.scene is None:
        return True
    least = problem.required - _CLEARANCE_MARGIN
    return motion_clearance(problem.scene, trajectory).certified >= least


class _Teller:
    """Turns the states of the searches into what a progress callback wants."""

    def __init__(self, total: int | None, progress: Progress | None) -> None:
        self.total, self.progress = total, progress
        self.told, self.exact = np.inf, np.inf  # criterion of the search, and exactly
        self.ratio, self.condition = np.inf, np.inf

    def __call__(self, problem: DesignProblem, states: Sequence[SearchState]) -> None:
        if self.progress is None:
            return
        state = min(states, key=lambda s: s.best_value)
        if state.best is not None and state.best_value < self.told:
            self.told = state.best_value
            trajectory = problem.trajectory(state.best)
            M = _information(problem, trajectory)
            exact = objective(M, problem.criterion)
            if exact < self.exact:
                self.exact, self.condition = exact, condition_number(M)
                self.ratio = check(problem.robot, trajectory).worst.ratio
        done = sum(s.status not in ("running", "stalled") for s in states)
        self.progress(done, self.total, self.condition, self.ratio)
