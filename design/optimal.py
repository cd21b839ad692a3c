"""Design of excitation trajectories by sequential convex programming from many starts."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace

import joblib
import numpy as np
import numpy.typing as npt

from excitant.design.constraints import check, within_limits
from excitant.design.criterion import CRITERIA, condition_number, information, objective
from excitant.design.problem import DesignProblem
from excitant.design.result import Design, dense_motion
from excitant.design.search import Effort, SearchState, best_solutions, search
from excitant.design.trajectory import FourierSeries, Series, SplineSeries
from excitant.exceptions import BadInput, BadRobot, UnknownName
from excitant.processes import connect
from excitant.robots.geometry import CLEARANCE, Scene
from excitant.robots.loading import RobotLike, as_robot
from excitant.robots.motion import Motion
from excitant.robots.robot import Robot
from excitant.robots.threads import on_one_thread

Progress = Callable[[int, int | None, float, float], None]
"""Called with starts done, starts in all (None: until the time limit), best condition number
and its worst limit ratio."""

SERIES = ("fourier", "spline")
USE = 0.9  # of the limits; the rest is for what the model and the controller get wrong
TOP_HZ = 2.5  # a quarter of the cut-off that identification filters at
CANDIDATES = 4  # best searches whose exact figures decide

_STARTS = 16
_FEWEST = 5  # harmonics that a search for their number begins with
_CLEARANCE_MARGIN = 0.004  # m, for what happens between the instants of the optimiser


def build_design(
    robot: Robot,
    *,
    duration: float = 10.0,
    periods: int | None = None,
    harmonics: int | None = 5,
    series: str = "fourier",
    criterion: str = "condition",
    columns: str = "friction",
    noise: npt.ArrayLike | None = None,
    earlier: Sequence[Motion] = (),
    scene: Scene | None = None,
    clearance: float = CLEARANCE,
) -> DesignProblem:
    """State the problem that `design_trajectory` solves, as its search begins."""
    if not robot.phi[::10].any():
        why = "no link has a mass, so no torque is known; add <inertial> elements"
        raise BadRobot(robot.source or robot.name, why)
    if criterion not in CRITERIA:
        raise UnknownName("criterion", criterion, CRITERIA)
    if not np.isfinite(clearance) or clearance < 0:
        raise BadInput(f"clearance {clearance} m is not a distance")
    return DesignProblem(
        information(robot, columns, noise=noise, earlier=earlier, duration=duration),
        criterion,
        _series(
            series,
            duration,
            1 if periods is None else periods,
            _FEWEST if harmonics is None else harmonics,
        ),
        scene,
        clearance + _CLEARANCE_MARGIN,
    )


def _series(name: str, duration: float, periods: int, harmonics: int) -> Series:
    if name not in SERIES:
        raise UnknownName("series", name, SERIES)
    if not (np.isfinite(duration) and duration > 0):
        raise BadInput(f"duration {duration} s is not a positive number")
    if periods < 1:
        raise BadInput(f"{periods} periods: at least one is needed")
    fewest = 2 if name == "fourier" else 3
    if harmonics < fewest:
        raise BadInput(
            f"{harmonics} harmonics cannot move and be at rest at both ends; use at least {fewest}"
        )
    if name == "spline":
        return SplineSeries(float(duration), 2 * harmonics).split(periods)
    return FourierSeries(float(duration), harmonics).split(periods)


@on_one_thread
def design_trajectory(
    robot: RobotLike,
    *,
    duration: float = 10.0,
    periods: int | None = None,
    harmonics: int | None = 5,
    series: str = "fourier",
    use: float = USE,
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
        robot: The arm, its built-in name or file; its limits and effects count.
        duration: Length of the motion [s].
        periods: Number of equal periods that it has, each from rest to rest; None for as many as
            make the criterion least: the same harmonics are slow and wide in one long period, fast
            in several short ones.
        harmonics: Number of harmonics of a period, at least 2; None to add harmonics while κ
            falls.
        series: ``"fourier"``, or ``"spline"``: B-splines with twice as many pieces as there
            would be harmonics, whose local freedom suits tight cells.
        use: Share of the limits on velocity, acceleration, torque and jerk that is used (of 1).
        top_hz: Highest frequency that a search for periods or harmonics goes to [Hz].
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
        BadRobot: No link has a mass.
        BadInput: Duration, periods, use, harmonics or starts out of range, or no cluster there.
    """
    robot = as_robot(robot)
    began = time.time()
    held = robot.using(use)
    with effort_of(starts, _STARTS, jobs, cluster, seed, time_limit) as effort:
        first = build_design(
            held, duration=duration, periods=periods, harmonics=harmonics, series=series,
            criterion=criterion, columns=columns, noise=noise, earlier=earlier, scene=scene,
            clearance=clearance,
        )  # fmt: skip
        initial = first.random(
            np.random.default_rng([seed, 0])
        )  # refuses what no motion keeps
        if progress is not None:
            effort = replace(effort, report=_Teller(effort.starts, progress))
        free = {"periods": periods is None, "harmonics": harmonics is None}
        problem, searches = search(first, effort, **free, top_hz=top_hz)
    if problem.period != first.period:
        begun = replace(problem, series=problem.series.resized(first.series.terms))
        initial = begun.random(np.random.default_rng([seed, 0]))
    found = map(problem.trajectory, best_solutions(searches, CANDIDATES))
    kept = [within_limits(held, trajectory, scene, clearance) for trajectory in found]
    chosen = min(
        [initial, *(trajectory for trajectory in kept if trajectory is not None)],
        key=lambda x: objective(problem.information.matrix(dense_motion(x)), criterion),
    )
    wall_s = time.time() - began
    seen = replace(problem.information, robot=robot)
    return Design(seen, criterion, initial, chosen, scene, use, searches, wall_s)


@contextmanager
def effort_of(
    starts: int | None,
    default: int,
    jobs: int | None,
    cluster: str | None,
    seed: int,
    time_limit: float | None,
) -> Iterator[Effort]:
    """Budget of options: the default starts, or as many as fit into a time limit [s]."""
    if starts is not None and starts < 1:
        raise BadInput(f"{starts} starts: at least one is needed")
    if starts is None and time_limit is None:
        starts = default
    deadline = np.inf if time_limit is None else time.time() + time_limit
    with connect(cluster) if cluster else nullcontext() as client:
        yield Effort(starts, jobs or int(joblib.cpu_count()), seed, deadline, client)


class _Teller:
    """Turns the states of the searches into what a progress callback wants."""

    def __init__(self, total: int | None, progress: Progress) -> None:
        self.total = total
        self.progress = progress
        self.told = np.inf  # criterion of the search
        self.exact = np.inf  # and exactly
        self.ratio = np.inf
        self.condition = np.inf
        self.done = 0

    def __call__(self, problem: DesignProblem, states: Sequence[SearchState]) -> None:
        state = min(states, key=lambda s: s.best_value)
        if state.best is not None and state.best_value < self.told:
            self.told = state.best_value
            trajectory = problem.trajectory(state.best)
            M = problem.information.matrix(dense_motion(trajectory))
            exact = objective(M, problem.criterion)
            if exact < self.exact:
                self.exact, self.condition = exact, condition_number(M)
                self.ratio = check(problem.robot, trajectory).worst.ratio
        self.done = max(
            self.done, sum(state.ended for state in states)
        )  # periods are tried anew
        self.progress(self.done, self.total, self.condition, self.ratio)
