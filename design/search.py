"""Searches for a trajectory: sequential convex programming from many starting points."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from excitant import interrupts
from excitant.design.constraints import within_limits
from excitant.design.criterion import condition_number, objective
from excitant.design.options import Search
from excitant.design.peaks import worst_use
from excitant.design.problem import DesignProblem
from excitant.design.step import PENALTY, local_model, solve_step
from excitant.design.trajectory import FourierSeries
from excitant.exceptions import Infeasible
from excitant.processes import unordered
from excitant.robots.motion import Array
from excitant.robots.threads import on_one_thread


@dataclass(frozen=True)
class Convergence:
    """When the search from one start shrinks its steps, slows down or ends.

    Merits are logarithms of the criterion with a penalty: 0.01 is a change by 1 %. All values
    move `benchmarks/design.py`.
    """

    torque_excess: float = 5e-5
    "Share by which torque may exceed its bound: the margin of the problem covers it."
    radius: float = 0.3
    "First trust region, as a share of each coefficient's reach."
    smallest_radius: float = 1e-5
    "Trust region below which a search cannot improve any more."
    largest_radius: float = 1.0
    "Trust region that covers the reach of each coefficient."
    promised_gain: float = 1e-4
    "A search has converged when a step promises to lower the merit by less."
    coarse_pace: float = 1.5e-2
    "Decrease of the merit over `window` iterations below which a search stalls."
    fine_pace: float = 2e-3
    "The same for the searches that are driven to convergence."
    window: int = 8
    "Iterations over which the decrease of the merit is judged."
    hopeless: float = 4.0
    "Distance to the target over the recent decrease beyond which a search is stopped."
    iterations: int = 300
    "Largest number of iterations of one search."


@dataclass(frozen=True)
class Restarts:
    """How many searches begin at random motions, and how restarts build upon the best."""

    random_starts: int = 12
    "Random starts, at most, before the best of them are built upon."
    fewest_starts: int = 3
    "Starts that are drawn even after the time limit."
    screening_iterations: int = 12
    "Iterations after which the worse half of the random starts is stopped."
    elite: int = 3
    "Searches whose solutions are mixed with random motions to start again."
    random_shares: tuple[float, float] = (0.3, 0.5)
    "Range of the share of the random motion in a restart."
    round_size: int = 6
    "Restarts that begin from the same solutions."
    rounds_without_gain: int = 2
    "Rounds without a gain after which random starts begin anew."
    gain: float = 1e-3
    "Decrease of the merit that counts as a gain."
    polished: int = 4
    "Best searches that are driven to convergence."


@dataclass(frozen=True)
class SeriesChoice:
    """How the numbers of periods and harmonics are chosen."""

    periods: tuple[int, ...] = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)
    "Numbers of periods that are compared, in this order."
    period_starts: int = 4
    "Starts that compare two numbers of periods."
    period_time: float = 0.1
    "Share of the remaining time for each number of periods."
    clear_loss: float = 0.2
    "Increase of the criterion's logarithm that a few starts can tell: more periods are not tried."
    gain: float = 0.02
    "Least decrease of the criterion's logarithm that more periods or harmonics are worth."
    seeds: int = 2
    "Best solutions that go on with more harmonics."
    first_time: float = 0.1
    "Share of the remaining time for the first number of harmonics."
    growth_time: float = 0.35
    "Share of the remaining time for each further number."


CONVERGENCE = Convergence()
RESTARTS = Restarts()
SERIES_CHOICE = SeriesChoice()


@dataclass(frozen=True, eq=False)
class SearchState:
    """State of a search from one start."""

    index: int  # number of the start
    z: Array  # unknowns, shape (c − 2, nv); before the first iteration those to begin from, if any
    value: float = np.inf  # criterion to be minimised, at z
    # torque beyond its bound at z, as a share of it; or clearance missing
    excess: float = np.inf
    # unknowns of the lowest value within all limits, if there is one yet
    best: Array | None = None
    best_value: float = np.inf  # that value
    radius: float = CONVERGENCE.radius  # trust region
    # "running", "stalled" (slow; may go on), "stopped" (not worth it beside others), "converged",
    # "iteration limit", "time limit", "interrupted" or "infeasible"
    status: str = "running"
    # start whose solution, mixed with a random one, this began from
    parent: int | None = None
    # condition number at the samples of the search, with the smooth sign of velocity, at the
    # beginning and after every iteration
    history: tuple[float, ...] = ()
    merits: tuple[float, ...] = field(default=(), repr=False)  # merit likewise

    @property
    def merit(self) -> float:
        """Criterion with the penalty on torque beyond its bound."""
        return self.value + PENALTY * self.excess

    @property
    def iterations(self) -> int:
        """Steps taken."""
        return max(len(self.history) - 1, 0)

    @property
    def ended(self) -> bool:
        """Whether it will not go on."""
        return self.status not in ("running", "stalled")

    @property
    def recent_gain(self) -> float:
        """Decrease of the merit over the last iterations."""
        return (
            self.merits[-CONVERGENCE.window - 1] - self.merit
            if len(self.merits) > CONVERGENCE.window
            else np.inf
        )

    def at(self, problem: DesignProblem, z: Array) -> SearchState:
        """The search moved to z, and that entered into its history."""
        M = problem.information_matrix(z)
        value = objective(M, problem.criterion)
        excess = max(0.0, worst_use(problem, z) - 1.0)
        new = replace(self, z=z, value=value, excess=excess)
        if excess <= CONVERGENCE.torque_excess and value < self.best_value:
            new = replace(new, best=z, best_value=value)
        history = (*self.history, condition_number(M))
        return replace(new, history=history, merits=(*self.merits, new.merit))

    def exhausted(self) -> SearchState:
        """The search at a point that it cannot improve."""
        return replace(
            self, status="infeasible" if self.best is None else "converged"
        )


Searches = tuple[SearchState, ...]
Report = Callable[[DesignProblem, Sequence[SearchState]], None]


def best_solutions(searches: Iterable[SearchState], count: int) -> list[Array]:
    """Unknowns of the best that searches found within all limits, best first."""
    solutions = sorted(
        (s.best_value, s.index, s.best) for s in searches if s.best is not None
    )
    return [z for _, _, z in solutions[:count]]


@dataclass(frozen=True, eq=False)
class Task:
    """Iterations of one search, to a least decrease of the merit, while a target is in reach."""

    state: SearchState
    iterations: int = CONVERGENCE.iterations
    pace: float = CONVERGENCE.coarse_pace
    target: float = -np.inf


def _advance(problem: DesignProblem, task: Task, deadline: float) -> SearchState:
    """Continue a search until it stalls, is hopeless or time is up."""
    state = task.state
    if state.status == "stalled":
        state = replace(state, status="running")
    for _ in range(task.iterations):
        if state.status != "running":
            break
        if time.time() > deadline:
            return replace(state, status="time limit")
        state = _iterate(problem, state)
        if state.status != "running":
            break
        if state.recent_gain < task.pace:
            slow = task.pace > CONVERGENCE.fine_pace
            state = replace(state, status="stalled") if slow else state.exhausted()
        elif (
            state.merit - task.target > CONVERGENCE.hopeless * state.recent_gain
            and task.target > -np.inf
        ):
            state = replace(state, status="stopped")
    return state


def _iterate(problem: DesignProblem, state: SearchState) -> SearchState:
    """One linearisation, with the trust region shrunk until the merit decreases."""
    model = local_model(problem, state.z)
    radius = state.radius
    while radius > CONVERGENCE.smallest_radius:
        step = solve_step(problem, model, radius)
        if step is None:
            radius /= 4
            continue
        dz, promised = step
        if promised < CONVERGENCE.promised_gain:
            break
        moved = state.at(problem, state.z + dz)
        share = (state.merit - moved.merit) / promised
        if share > 0.05:
            factor = 2.0 if share > 0.6 else 1.0 if share > 0.25 else 0.5
            return replace(
                moved, radius=min(factor * radius, CONVERGENCE.largest_radius)
            )
        radius *= 0.4
    return state.exhausted()


@dataclass(frozen=True, eq=False)
class Effort:
    """Budget of a design: starts, processes, time."""

    # number of starts; None for as many as fit until the deadline
    starts: int | None
    jobs: int  # number of processes
    seed: int  # seed of start k is (seed, k)
    deadline: float  # `time.time` at which to stop [s]
    client: Any  # Dask cluster to use instead of processes here
    report: Report = lambda problem, states: None  # called whenever a state changes

    def share(self, starts: int | None, share: float) -> Effort:
        """Other starts within a share of the time left."""
        now = time.time()
        return replace(
            self, starts=starts, deadline=now + share * (self.deadline - now)
        )


def search(
    problem: DesignProblem, effort: Effort, asked: Search
) -> tuple[DesignProblem, Searches]:
    """All searches for a problem, and the problem with the periods and harmonics chosen.

    It comes with one period if the number of periods is to be chosen, and with the fewest harmonics
    if theirs is; neither goes beyond the highest frequency.
    """
    if asked.periods == "search":
        first = _most_telling(problem, effort, asked.max_frequency)
    else:
        first = _MultiStart(problem, effort)
    if asked.harmonics != "search":
        return first.problem, first.run()
    first.go_on(effort.share(effort.starts, SERIES_CHOICE.first_time))
    return _grow(first.problem, first.run(), effort, asked)


def _most_telling(
    problem: DesignProblem, effort: Effort, top_hz: float
) -> _MultiStart:
    """A few starts on the motion in one period, in two and more while that is better.

    They go on with the whole effort.
    """
    best = None
    for count in SERIES_CHOICE.periods:
        candidate = replace(problem, series=problem.series.split(count))
        if (
            best is not None
            and _most_harmonics(candidate.series, top_hz)
            < candidate.series.harmonics
        ):
            break
        starts = (
            SERIES_CHOICE.period_starts
            if effort.starts is None
            else max(1, effort.starts // SERIES_CHOICE.period_starts)
        )
        tried = _MultiStart(
            candidate, effort.share(starts, SERIES_CHOICE.period_time)
        )
        searches = tried.begin()
        loss = -np.inf if best is None else _value(searches) - _value(best.searches)
        if best is None or loss < -SERIES_CHOICE.gain:
            best = tried
        elif interrupted(searches):
            best.interrupt()
        if interrupted(best.searches) or not loss < SERIES_CHOICE.clear_loss:
            break
    assert best is not None
    best.go_on(effort)
    return best


def _grow(
    problem: DesignProblem,
    searches: Searches,
    effort: Effort,
    asked: Search,
) -> tuple[DesignProblem, Searches]:
    """Searches with harmonics added while κ falls, each from the best solutions before."""
    gain = np.inf
    while (
        gain > SERIES_CHOICE.gain
        and time.time() < effort.deadline
        and not interrupted(searches)
    ):
        gain = 0.0
        for series in _larger(problem.series, asked):
            larger = replace(problem, series=series)
            seeds = _seeds(larger, problem, searches)
            starts = effort.starts and len(seeds)
            grown = _MultiStart(
                larger, effort.share(starts, SERIES_CHOICE.growth_time), seeds
            ).run()
            gain = _value(searches) - _value(grown)
            if gain > 0:
                problem = larger
                searches = grown
                break
    seeds = _seeds(problem, problem, searches)
    if seeds and effort.starts is None and not interrupted(searches):
        searches = _MultiStart(problem, effort, seeds).run()
    return problem, searches


def _larger(series: FourierSeries, asked: Search) -> Iterator[FourierSeries]:
    """More harmonics: to a higher frequency, and to the same in longer and so fewer periods."""
    most = _most_harmonics(series, asked.max_frequency)
    harmonics = min(2 * series.harmonics, most)
    if harmonics > series.harmonics:
        yield replace(series, harmonics=harmonics)
    if asked.periods == "search" and series.periods > 1:
        times = 2 if series.periods % 2 == 0 else 3
        finer = replace(series, harmonics=times * series.harmonics)
        yield finer.split(series.periods // times)


def _most_harmonics(series: FourierSeries, top_hz: float) -> int:
    """Number of harmonics that reach a highest frequency [Hz], which may be off by rounding."""
    return int(top_hz * series.period * (1 + 1e-9))


def _seeds(
    problem: DesignProblem, before: DesignProblem, searches: Searches
) -> tuple[Array, ...]:
    """The best solutions of a search as unknowns of a problem, within its limits."""
    near = (
        problem.trajectory(problem.unknowns(before.trajectory(z)))
        for z in best_solutions(searches, SERIES_CHOICE.seeds)
    )
    kept = (within_limits(problem.robot, trajectory) for trajectory in near)
    return tuple(
        problem.unknowns(trajectory)
        for trajectory in kept
        if trajectory is not None
    )


def _value(searches: Searches) -> float:
    return min((s.best_value for s in searches), default=np.inf)


def interrupted(searches: Searches) -> bool:
    """Whether a signal ended them."""
    return any(s.status == "interrupted" for s in searches)


class _MultiStart:
    """Searches from many starts: random ones (or given seeds) first, then restarts from the best.

    The better half of the random starts goes on after a few iterations. Restarts begin at a
    mixture of one of the best and a random trajectory, which keeps the convex kinematic limits.
    Slow searches stop; the best are driven to convergence in the end. When restarts bring
    nothing more, all this begins anew: an island.
    """

    def __init__(
        self, problem: DesignProblem, effort: Effort, seeds: tuple[Array, ...] = ()
    ) -> None:
        self.problem = problem
        self.effort = effort
        self.seeds = seeds
        self.states: dict[int, SearchState] = {}
        self.nothing = np.zeros((0, problem.robot.nv))  # unknowns still to be drawn
        self.first = 0  # start of the island

    def begin(self) -> Searches:
        """What the random starts find before they are slow."""
        with self.interruptible():
            self.random_starts()
        return self.searches

    def run(self) -> Searches:
        """What was found by the end of the effort, from what there is already."""
        if interrupted(self.searches):
            return self.searches
        with self.interruptible():
            self.island(0)
            while self.more():
                self.island(len(self.states))
            self.work(self.polishing(RESTARTS.polished, 0))
            self.end(
                "stopped",
                [
                    s
                    for s in self.ranked(0)[RESTARTS.polished :]
                    if s.status == "stalled"
                ],
            )
            late = time.time() > self.effort.deadline
            self.end("time limit" if late else "iteration limit", self.ranked(0))
        return self.searches

    def go_on(self, effort: Effort) -> None:
        """Let another effort take up what the time limit of the last one ended."""
        self.effort = effort
        for k, state in self.states.items():
            if state.status == "time limit" and state.history:
                self.states[k] = replace(state, status="stalled")

    @contextmanager
    def interruptible(self) -> Iterator[None]:
        try:
            yield
        except KeyboardInterrupt:
            interrupts.heard()
            self.interrupt()

    def interrupt(self) -> None:
        """End all searches, and one more that had not begun, as interrupted."""
        last = len(self.states)
        self.states[last] = SearchState(last, self.nothing)
        self.end("interrupted", self.ranked(0))

    @property
    def searches(self) -> Searches:
        return tuple(self.states[k] for k in sorted(self.states))

    def island(self, first: int) -> None:
        self.first = first
        self.random_starts()
        idle = 0
        while self.more() and idle < RESTARTS.rounds_without_gain:
            before = self.merit()
            self.restarts()
            idle = 0 if self.merit() < before - RESTARTS.gain else idle + 1

    def random_starts(self) -> None:
        first = len(self.states)
        count = int(
            min(self.room, max(3, min(RESTARTS.random_starts, self.room / 2)))
        )
        begun: dict[int, Array] = {}
        if first < len(self.seeds):
            count = len(self.seeds)
            begun = dict(enumerate(self.seeds))
        new = [
            SearchState(k, begun.get(k, self.nothing))
            for k in range(first, first + count)
        ]
        self.work([Task(state, RESTARTS.screening_iterations) for state in new])
        ranked = self.ranked(first)
        keep = len(ranked) if len(ranked) < 4 else -(-len(ranked) // 2)
        self.end("stopped", [s for s in ranked[keep:] if s.status == "running"])
        self.work([Task(s) for s in ranked[:keep] if s.status == "running"])

    def restarts(self) -> None:
        first = len(self.states)
        elite = [s for s in self.ranked(self.first) if np.isfinite(s.merit)][
            : RESTARTS.elite
        ]
        tasks = self.polishing(RESTARTS.polished // 2, self.first)
        for k in range(first, first + int(min(RESTARTS.round_size, self.room))):
            task = Task(SearchState(k, self.nothing))
            if elite:
                parent = elite[k % len(elite)]
                state = SearchState(k, parent.z, parent=parent.index)
                task = Task(state, target=elite[0].merit)
            tasks.append(task)
        self.work(tasks)

    @property
    def room(self) -> float:
        return (
            np.inf
            if self.effort.starts is None
            else self.effort.starts - len(self.states)
        )

    def more(self) -> bool:
        return self.room > 0 and time.time() < self.effort.deadline

    def merit(self) -> float:
        return min((s.merit for s in self.ranked(self.first)), default=np.inf)

    def ranked(self, first: int) -> list[SearchState]:
        states = (state for state in self.states.values() if state.index >= first)
        return sorted(states, key=lambda s: (s.merit, s.index))

    def polishing(self, count: int, first: int) -> list[Task]:
        slow = [s for s in self.ranked(first)[:count] if s.status == "stalled"]
        return [Task(state, pace=CONVERGENCE.fine_pace) for state in slow]

    def work(self, tasks: Sequence[Task]) -> None:
        effort = self.effort
        each = [
            (self.problem, task, effort.seed, effort.deadline) for task in tasks
        ]
        for state in unordered(_perform, each, effort.jobs, effort.client):
            self.states[state.index] = state
            effort.report(self.problem, tuple(self.states.values()))

    def end(self, status: str, states: Iterable[SearchState]) -> None:
        for state in states:
            if not state.ended:
                self.states[state.index] = replace(state, status=status)


@on_one_thread
def _perform(
    problem: DesignProblem, task: Task, seed: int, deadline: float
) -> SearchState:
    """The state of a search after its task, on one thread."""
    if not task.state.history:
        if task.state.index >= RESTARTS.fewest_starts and time.time() > deadline:
            # a pose takes long in a big scene
            return replace(task.state, status="time limit")
        try:
            task = replace(task, state=_begun(problem, task.state, seed))
        except Infeasible:
            return replace(task.state, status="infeasible")
    return _advance(problem, task, deadline)


def _begun(problem: DesignProblem, state: SearchState, seed: int) -> SearchState:
    if len(state.z) and state.parent is None:
        return state.at(problem, state.z)
    rng = np.random.default_rng([seed, state.index])
    z = problem.unknowns(problem.random(rng))
    if state.parent is not None:
        share = rng.uniform(*RESTARTS.random_shares)
        z = (1 - share) * state.z + share * z
    return state.at(problem, z)
