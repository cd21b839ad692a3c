"""Many searches over processes, in rounds, so that their number does not change the result."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

import joblib
import numpy as np
from joblib.externals.loky import get_reusable_executor
from threadpoolctl import threadpool_limits

from excitant.design.problem import DesignProblem
from excitant.design.search import COARSE, FINE, SearchState, advance
from excitant.exceptions import Infeasible
from excitant.robots import Array

_SCREENING = 12  # iterations after which the worse half of the random starts is stopped
_ITERATIONS = 300
_ELITE = 3  # searches whose solutions are mixed with random trajectories to start again
_MIX = (0.3, 0.5)  # share of the random trajectory
_POLISHED = 4  # best searches that are driven to convergence
_ISLAND = 24  # starts after which random ones begin anew
_ROUND = 6  # restarts that begin from the same knowledge


@dataclass(frozen=True, eq=False)
class Task:
    """A piece of one search.

    Attributes:
        state: Where it stands; before the first iteration its z may still be missing.
        iterations: Number of iterations to do.
        target: Merit that another search has reached.
        parent: Solution to be mixed with a random trajectory, for a restart.
        least: Decrease of the merit below which the search stalls.
    """

    state: SearchState
    iterations: int
    target: float = -np.inf
    parent: Array | None = None
    least: float = COARSE


@dataclass
class MultiStart:
    """Searches from many starts: random ones first, then restarts from the best found.

    Random starts are screened: after a few iterations the better half goes on. Restarts begin
    at a mixture of one of the best solutions and a random trajectory; the kinematic limits are
    convex, so it keeps them. Searches run until they become slow; only the best are then
    driven to convergence. After some restarts, which come to resemble each other, all this
    begins anew.

    Attributes:
        problem: The design problem.
        starts: Number of starts; None for as many as fit until the deadline.
        jobs: Number of processes.
        seed: Seed of start k is (seed, k).
        deadline: `time.time` at which to stop [s].
        report: Called with the finished states so far whenever one changes.
        states: The searches by number.
    """

    problem: DesignProblem
    starts: int | None
    jobs: int
    seed: int
    deadline: float
    report: Callable[[Sequence[SearchState]], None]
    states: dict[int, SearchState] = field(default_factory=dict)
    _first: int = 0

    def run(self) -> tuple[SearchState, ...]:
        """All searches, ended one way or another; Ctrl-C ends them early."""
        try:
            self._island()
            while self._more():
                self._island()
            self._work(self._polishing(_POLISHED))
            for state in self._ranked()[_POLISHED:]:
                self._end(state, "stopped", ("stalled",))
            late = time.time() > self.deadline
            self._end_all("time limit" if late else "iteration limit")
        except KeyboardInterrupt:
            self._end_all("interrupted")
        return tuple(self.states[k] for k in sorted(self.states))

    def _island(self) -> None:
        self._random_starts()
        while self._more() and self._room > 0:
            self._restarts()

    @property
    def _room(self) -> int:
        """Starts that this island still has."""
        left = _ISLAND if self.starts is None else self.starts - self._first
        return min(_ISLAND, left) - (len(self.states) - self._first)

    def _more(self) -> bool:
        enough = self.starts is not None and len(self.states) >= self.starts
        return not enough and time.time() < self.deadline

    def _random_starts(self) -> None:
        self._first = first = len(self.states)
        count = self._room if self._room < 4 else -(-self._room // 2)
        new = [self._blank(k) for k in range(first, first + count)]
        self._work([Task(state, _SCREENING) for state in new])
        ranked = self._ranked(first)
        keep = len(ranked) if len(ranked) < 4 else -(-len(ranked) // 2)
        for state in ranked[keep:]:
            self._end(state, "stopped", ("running",))
        self._work([Task(s, _ITERATIONS) for s in ranked[:keep] if s.status == "running"])

    def _restarts(self) -> None:
        first, last = len(self.states), len(self.states) + min(_ROUND, self._room)
        elite = [s for s in self._ranked(self._first) if np.isfinite(s.merit)][:_ELITE]
        tasks = self._polishing(_POLISHED // 2, self._first)
        for k in range(first, last):
            task = Task(self._blank(k), _ITERATIONS)
            if elite:
                parent = elite[k % len(elite)]
                state = replace(task.state, parent=parent.index)
                task = Task(state, _ITERATIONS, elite[0].merit, parent.z)
            tasks.append(task)
        self._work(tasks)

    def _polishing(self, count: int, first: int = 0) -> list[Task]:
        """Tasks that drive the best searches to convergence."""
        slow = [s for s in self._ranked(first)[:count] if s.status == "stalled"]
        return [Task(state, _ITERATIONS, least=FINE) for state in slow]

    def _blank(self, index: int) -> SearchState:
        return SearchState(index, np.zeros((2 * self.problem.harmonics - 1, 0)))

    def _ranked(self, first: int = 0) -> list[SearchState]:
        """The searches from a start onwards, best first."""
        states = (state for state in self.states.values() if state.index >= first)
        return sorted(states, key=lambda s: (s.merit, s.index))

    def _work(self, tasks: Sequence[Task]) -> None:
        for state in _results(self.problem, tasks, self.jobs, self.seed, self.deadline):
            self.states[state.index] = state
            self.report(tuple(self.states.values()))

    def _end(self, state: SearchState, status: str, among: tuple[str, ...]) -> None:
        if state.status in among:
            self.states[state.index] = replace(state, status=status)

    def _end_all(self, status: str) -> None:
        for state in tuple(self.states.values()):
            self._end(state, status, ("running", "stalled"))


def _results(
    problem: DesignProblem, tasks: Sequence[Task], jobs: int, seed: int, deadline: float
) -> Iterable[SearchState]:
    if jobs == 1 or len(tasks) < 2:
        with threadpool_limits(1):
            for task in tasks:
                yield _perform(problem, task, seed, deadline)
        return
    with joblib.parallel_config(backend="loky", inner_max_num_threads=1):
        parallel = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")
        try:
            yield from parallel(
                joblib.delayed(_perform_apart)(problem, task, seed, deadline) for task in tasks
            )
        except KeyboardInterrupt:
            get_reusable_executor().shutdown(wait=False, kill_workers=True)
            raise


def _perform_apart(problem: DesignProblem, task: Task, seed: int, deadline: float) -> SearchState:
    """`_perform` in a process of its own, where Ctrl-C is left to the parent."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    return _perform(problem, task, seed, deadline)


def _perform(problem: DesignProblem, task: Task, seed: int, deadline: float) -> SearchState:
    state = task.state
    if not state.history:
        try:
            state = _begin(problem, task, seed)
        except Infeasible:
            return replace(state, status="infeasible")
    return advance(
        problem, state, task.iterations, deadline=deadline, target=task.target, least=task.least
    )


def _begin(problem: DesignProblem, task: Task, seed: int) -> SearchState:
    rng = np.random.default_rng([seed, task.state.index])
    drawn = problem.random(rng)
    z = problem.unknowns(drawn)
    if task.parent is not None:
        share = rng.uniform(*_MIX)
        z = (1 - share) * task.parent + share * z
    return task.state.at(problem, z)
