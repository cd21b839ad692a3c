"""Design of excitation trajectories by sequential convex programming from many starts."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from excitant.design.constraints import check, within_limits
from excitant.design.criterion import (
    CRITERIA,
    condition_number,
    information,
    objective,
)
from excitant.design.options import Search
from excitant.design.problem import DesignProblem
from excitant.design.result import Design, dense_motion
from excitant.design.search import (
    Effort,
    Report,
    SearchState,
    best_solutions,
    interrupted,
    search,
)
from excitant.design.trajectory import Trajectory, resting_series
from excitant.exceptions import BadInput, BadRobot, UnknownName
from excitant.processes import connect, processors
from excitant.robots.geometry import CLEARANCE, Scene, usual_scene
from excitant.robots.motion import Motion
from excitant.robots.robot import Robot
from excitant.robots.threads import on_one_thread

Progress = Callable[[int, int | None, float, float], None]
"""Called with starts done, starts in all (None: until the time limit), best condition number
and its worst limit ratio."""

CANDIDATES = 4  # best searches whose exact figures decide

STARTS = 16  # of a search without a time limit
FEWEST_HARMONICS = 5  # that a search for their number begins with
CLEARANCE_MARGIN = (
    0.004  # m, for what happens between the instants of the optimiser
)

SceneOption = Scene | tuple[()] | None
"""What to keep clear of; None: the arm's bodies and its floor; an empty tuple: nothing."""


@contextmanager
def effort_of(search: Search, starts: int = STARTS) -> Iterator[Effort]:
    """Budget: the default starts, or as many as fit into the time limit."""
    count = search.starts
    if count is not None and count < 1:
        raise BadInput(f"{count} starts: at least one is needed")
    deadline = np.inf
    if search.time_limit is not None:
        deadline = time.time() + search.time_limit
    elif count is None:
        count = starts
    jobs = search.jobs or processors()
    with connect(search.cluster) if search.cluster else nullcontext() as client:
        yield Effort(count, jobs, search.seed, deadline, client)


def build_design(
    robot: Robot,
    *,
    noise: npt.ArrayLike | None = None,
    after: Sequence[Motion] = (),
    scene: SceneOption = None,
    clearance: float = CLEARANCE,
    **options: Any,
) -> DesignProblem:
    """State the problem that `design_trajectory` solves, as its search begins."""
    asked = Search(**options)
    if not robot.phi[::10].any():
        why = "no link has a mass, so no torque is known; add <inertial> elements"
        raise BadRobot(robot.source or robot.name, why)
    UnknownName.refuse("criterion", [asked.criterion], CRITERIA)
    if not np.isfinite(clearance) or clearance < 0:
        raise BadInput(f"clearance {clearance} m is not a distance")
    begun = resting_series(
        asked.duration,
        FEWEST_HARMONICS if asked.harmonics == "search" else asked.harmonics,
        1 if asked.periods == "search" else asked.periods,
    )
    seen = information(
        robot, asked.columns, noise=noise, earlier=after, duration=asked.duration
    )
    around = usual_scene(robot, clearance) if scene is None else scene or None
    return DesignProblem(
        seen, asked.criterion, begun, around, clearance + CLEARANCE_MARGIN
    )


@on_one_thread
def design_trajectory(
    robot: Robot,
    *,
    noise: npt.ArrayLike | None = None,
    after: Sequence[Motion] = (),
    scene: SceneOption = None,
    clearance: float = CLEARANCE,
    progress: Progress | None = None,
    **options: Any,
) -> Design:
    """Excitation trajectory that makes the base parameters best visible within the limits.

    Minimises the criterion of M = WᵀW / n over periodic motions that are at rest at both ends
    and keep every limit of the robot in continuous time.

    Args:
        robot: The arm; its limits and effects count.
        noise: Standard deviation of each joint's torque noise, shape (nv,) [N·m or N], to
            weight its equations with; equal if not given.
        after: Motions recorded already, whose information counts: what should run next?
        scene: Bodies kept apart; the arm's own and the floor that it stands on when None; an
            empty tuple leaves clearance out.
        clearance: Smallest distance that they keep [m].
        progress: Called whenever a search has news.
        options: Fields of `Search`. Without a time limit the result does not depend on the number
            of processes. Ctrl-C, too, returns the best so far.

    Raises:
        Infeasible: No motion keeps the limits; names those in conflict.
        UnknownName: Another criterion, or other columns.
        BadRobot: No link has a mass.
        BadInput: Duration, periods, use, harmonics or starts out of range, or no cluster there.
    """
    asked = Search(**options)
    began = time.time()
    used = robot.with_limits(robot.limits.used(asked.use))
    with effort_of(asked) as effort:
        first = build_design(
            used,
            noise=noise,
            after=after,
            scene=scene,
            clearance=clearance,
            **options,
        )
        # refuses what no motion keeps
        initial = first.random(np.random.default_rng([asked.seed, 0]))
        if progress is not None:
            effort = replace(effort, report=_teller(effort.starts, progress))
        problem, searches = search(first, effort, asked)
    if problem.period != first.period:
        few = replace(problem.series, harmonics=first.series.harmonics)
        begun = replace(problem, series=few)
        initial = begun.random(np.random.default_rng([asked.seed, 0]))
    found = [*map(problem.trajectory, best_solutions(searches, CANDIDATES))]
    chosen = None
    if interrupted(searches):  # time is short
        chosen = best_within_limits(used, found[:1], problem, clearance)
    if chosen is None:
        chosen = best_within_limits(used, [initial, *found], problem, clearance)
    wall_s = time.time() - began
    seen = replace(problem.information, robot=robot)
    return Design(
        seen,
        asked.criterion,
        initial,
        chosen or initial,
        first.scene,
        asked.use,
        searches,
        wall_s,
    )


def best_within_limits(
    robot: Robot,
    motions: Sequence[Trajectory],
    problem: DesignProblem,
    clearance: float,
) -> Trajectory | None:
    """The best of motions by the exact criterion, each shrunk into all limits; None without any."""
    shrunk = (
        within_limits(robot, motion, problem.scene, clearance) for motion in motions
    )
    return min(
        (motion for motion in shrunk if motion is not None),
        key=lambda x: objective(
            problem.information.matrix(dense_motion(x)), problem.criterion
        ),
        default=None,
    )


def _teller(total: int | None, progress: Progress) -> Report:
    """Turns the states of the searches into what a progress callback wants."""
    told = np.inf  # criterion of the search
    condition = np.inf
    ratio = np.inf
    done = 0

    def tell(problem: DesignProblem, states: Sequence[SearchState]) -> None:
        nonlocal told, condition, ratio, done
        state = min(states, key=lambda s: s.best_value)
        if state.best is not None and state.best_value < told:
            told = state.best_value
            trajectory = problem.trajectory(state.best)
            M = problem.information.matrix(dense_motion(trajectory))
            condition = condition_number(M)
            ratio = check(problem.robot, trajectory).worst.ratio
        # periods are tried anew
        done = max(done, sum(state.ended for state in states))
        progress(done, total, condition, ratio)

    return tell
