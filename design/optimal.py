"""Design of excitation trajectories by sequential convex programming from many starts."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import joblib
import numpy as np

from excitant.design.clearance import Clearance
from excitant.design.clearance import clearance as motion_clearance
from excitant.design.constraints import LimitReport, check
from excitant.design.criterion import CRITERIA, condition_number, information, objective
from excitant.design.multistart import MultiStart
from excitant.design.problem import DesignProblem
from excitant.design.search import SearchState
from excitant.design.trajectory import FourierTrajectory, from_coefficients
from excitant.exceptions import BadInput, UnknownName
from excitant.robots import Array, BaseParameters, Motion, Robot
from excitant.robots.geometry import Scene
from excitant.robots.motion import read_only

Progress = Callable[[int, int | None, float, float], None]
"""Called with starts done, starts in all (None: until the time limit), best condition number
and its worst limit ratio."""

_STARTS = 16
CLEARANCE = 0.01  # m
_CLEARANCE_MARGIN = 0.004  # m, for what happens between the instants of the optimiser
_DENSE_HZ, _DENSE = 100.0, 1000  # samples of the figures reported: rate, and at least so many
_SHRINKS = 30
_CANDIDATES = 4  # best searches whose exact figures decide


@dataclass(frozen=True, eq=False)
class StartRecord:
    """How one search went.

    Attributes:
        index: Number of the start; its seed is (seed, index).
        parent: Start whose solution it began from, or None for a random one.
        condition: Condition number it ended with, at the samples of the search (with the
            smooth sign of velocity, for ``"friction"``).
        status: ``"converged"``, ``"stopped"`` (not worth going on beside others),
            ``"iteration limit"``, ``"time limit"``, ``"interrupted"`` or ``"infeasible"``.
        iterations: Steps taken.
        history: Condition number at the beginning and after every step.
    """

    index: int
    parent: int | None
    condition: float
    status: str
    iterations: int
    history: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Design:
    """An excitation trajectory and what it achieves.

    Condition numbers and eigenvalues are those of the base columns, unscaled, at 100 Hz or at
    1000 samples if that is denser, with the true sign of velocity.

    Attributes:
        robot: The arm.
        trajectory: The excitation trajectory, at rest at both ends.
        base: Base parameters of the columns.
        columns: ``"friction"`` or ``"inertial"``.
        criterion: ``"condition"``, ``"d"``, ``"a"`` or ``"e"``.
        duration: Period [s].
        harmonics: Number of harmonics.
        condition_initial: Condition number of the first random feasible trajectory.
        condition_final: Condition number of the trajectory.
        eigenvalues_initial: Eigenvalues of M = WᵀW / n before, ascending, shape (r,).
        eigenvalues_final: Eigenvalues of M after.
        limits: Worst use of every limit over the continuous motion.
        clearance: Smallest distance over the continuous motion; None without a scene.
        starts: How each search went.
        wall_s: Time taken [s].
    """

    robot: Robot
    trajectory: FourierTrajectory
    base: BaseParameters
    columns: str
    criterion: str
    duration: float
    harmonics: int
    condition_initial: float
    condition_final: float
    eigenvalues_initial: Array
    eigenvalues_final: Array
    limits: LimitReport
    clearance: Clearance | None
    starts: tuple[StartRecord, ...]
    wall_s: float

    @property
    def iterations(self) -> int:
        """Steps taken in all searches together."""
        return sum(start.iterations for start in self.starts)


def build_design(
    robot: Robot,
    *,
    duration: float = 10.0,
    harmonics: int = 5,
    criterion: str = "condition",
    columns: str = "friction",
    scene: Scene | None = None,
    clearance: float = CLEARANCE,
) -> DesignProblem:
    """State the design problem without solving it; see `design`."""
    if criterion not in CRITERIA:
        raise UnknownName("criterion", criterion, CRITERIA)
    if not (np.isfinite(duration) and duration > 0):
        raise BadInput(f"duration {duration} s is not a positive number")
    if harmonics < 2:
        raise BadInput(
            f"{harmonics} harmonics cannot move and be at rest at both ends; use at least 2"
        )
    if not np.isfinite(clearance) or clearance < 0:
        raise BadInput(f"clearance {clearance} m is not a distance")
    return DesignProblem(
        information(robot, columns),
        criterion,
        float(duration),
        harmonics,
        scene,
        clearance + _CLEARANCE_MARGIN,
    )


def design(
    robot: Robot,
    *,
    duration: float = 10.0,
    harmonics: int = 5,
    criterion: str = "condition",
    columns: str = "friction",
    scene: Scene | None = None,
    clearance: float = CLEARANCE,
    starts: int | None = None,
    jobs: int | None = None,
    seed: int = 0,
    time_limit: float | None = None,
    progress: Progress | None = None,
) -> Design:
    """Excitation trajectory that makes the base parameters best visible within the limits.

    Minimises the criterion of M = WᵀW / n over finite Fourier series that are at rest at both
    ends and keep every limit of the robot in continuous time.

    Args:
        robot: The arm; its limits and effects count.
        duration: Period [s].
        harmonics: Number of harmonics, at least 2.
        criterion: ``"condition"`` (cond₂ W), ``"d"`` (det M), ``"a"`` (tr M⁻¹), ``"e"`` (λmin).
        columns: ``"friction"`` or ``"inertial"``.
        scene: The arm's bodies among obstacles, kept apart; None to leave clearance out.
        clearance: Smallest distance that they keep [m].
        starts: Number of searches; 16 by default, or as many as fit in a time limit.
        jobs: Number of processes; as many as processors by default. Without a time limit the
            result does not depend on it.
        seed: Seed of all randomness.
        time_limit: Time after which the best so far is returned [s]. Ctrl-C does the same.
        progress: Called whenever a search has news.

    Raises:
        Infeasible: No motion keeps the limits; names those in conflict.
        UnknownName: Another criterion or other columns.
        BadInput: Duration, harmonics or starts out of range.
    """
    began = time.time()
    if starts is not None and starts < 1:
        raise BadInput(f"{starts} starts: at least one is needed")
    if starts is None and time_limit is None:
        starts = _STARTS
    problem = build_design(
        robot,
        duration=duration,
        harmonics=harmonics,
        criterion=criterion,
        columns=columns,
        scene=scene,
        clearance=clearance,
    )
    initial = problem.random(np.random.default_rng([seed, 0]))
    deadline = np.inf if time_limit is None else began + time_limit
    tell = _Teller(problem, starts, progress)
    searches = MultiStart(
        problem, starts, jobs or int(joblib.cpu_count()), seed, deadline, tell
    ).run()
    trajectory = _best(problem, initial, searches)
    before, after = (_information(problem, x) for x in (initial, trajectory))
    return Design(
        robot=robot,
        trajectory=trajectory,
        base=problem.information.base,
        columns=columns,
        criterion=criterion,
        duration=problem.period,
        harmonics=harmonics,
        condition_initial=condition_number(before),
        condition_final=condition_number(after),
        eigenvalues_initial=read_only(np.linalg.eigvalsh(before)),
        eigenvalues_final=read_only(np.linalg.eigvalsh(after)),
        limits=check(robot, trajectory),
        clearance=None if problem.scene is None else motion_clearance(problem.scene, trajectory),
        starts=tuple(_record(state) for state in searches),
        wall_s=time.time() - began,
    )


def dense_motion(trajectory: FourierTrajectory) -> Motion:
    """The samples on which condition numbers are reported, first and last included."""
    return trajectory.sample(max(_DENSE, round(_DENSE_HZ * trajectory.period)) + 1)


def _information(problem: DesignProblem, trajectory: FourierTrajectory) -> Array:
    return problem.information.matrix(dense_motion(trajectory))


def _record(state: SearchState) -> StartRecord:
    condition = state.history[-1] if state.history else np.inf
    return StartRecord(
        state.index, state.parent, condition, state.status, state.iterations, state.history
    )


def _best(
    problem: DesignProblem, initial: FourierTrajectory, searches: Sequence[SearchState]
) -> FourierTrajectory:
    """The best trajectory within all limits by its exact figures; at worst the initial one."""
    found = sorted((s.best_value, s.index, s.best) for s in searches if s.best is not None)
    candidates = [initial]
    for _, _, z in found[:_CANDIDATES]:
        kept = within_limits(problem.robot, problem.trajectory(z))
        if kept is not None and _keeps_apart(problem, kept):
            candidates.append(kept)
    return min(candidates, key=lambda x: objective(_information(problem, x), problem.criterion))


def _keeps_apart(problem: DesignProblem, trajectory: FourierTrajectory) -> bool:
    if problem.scene is None:
        return True
    least = problem.required - _CLEARANCE_MARGIN
    return motion_clearance(problem.scene, trajectory).certified >= least


def within_limits(robot: Robot, trajectory: FourierTrajectory) -> FourierTrajectory | None:
    """The trajectory, shrunk towards its middle by what it exceeds a limit; None if that fails.

    Meant for an excess of a small share of a limit: the middle is a pose, and torque need not
    fall on the way there.
    """
    X = trajectory.coefficients
    centre = np.zeros_like(X)
    centre[0] = X[0]
    for _ in range(_SHRINKS):
        excess = check(robot, trajectory).worst.ratio - 1
        if excess <= 0:
            return trajectory
        X = centre + (1 - 2 * excess - 1e-7) * (X - centre)
        trajectory = from_coefficients(X, trajectory.period)
    return None


class _Teller:
    """Turns the states of the searches into what a progress callback wants."""

    def __init__(
        self, problem: DesignProblem, total: int | None, progress: Progress | None
    ) -> None:
        self.problem, self.total, self.progress = problem, total, progress
        self.best, self.ratio, self.condition = np.inf, np.inf, np.inf

    def __call__(self, states: Sequence[SearchState]) -> None:
        if self.progress is None:
            return
        state = min(states, key=lambda s: s.best_value)
        if state.best is not None and state.best_value < self.best:
            trajectory = self.problem.trajectory(state.best)
            self.best = state.best_value
            self.ratio = check(self.problem.robot, trajectory).worst.ratio
            self.condition = condition_number(_information(self.problem, trajectory))
        done = sum(s.status not in ("running", "stalled") for s in states)
        self.progress(done, self.total, self.condition, self.ratio)
