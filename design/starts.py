"""Searches from many starts, here, over processes or over a Dask cluster, with one result."""

from __future__ import annotations

import pickle
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import joblib
import numpy as np
from threadpoolctl import threadpool_limits

from excitant.design.constraints import within_limits
from excitant.design.problem import DesignProblem
from excitant.design.search import COARSE, FINE, SearchState, advance, best_solutions
from excitant.exceptions import BadInput, Infeasible
from excitant.robots import Array

_MIX = (0.3, 0.5)  # share of the random trajectory in a restart
_PATIENCE = "20s"  # for a cluster to answer

_SCREENING = 12  # iterations after which the worse half of the random starts is stopped
_ITERATIONS = 300
_ELITE = 3  # searches whose solutions are mixed with random trajectories to start again
_POLISHED = 4  # best searches that are driven to convergence
_RANDOM = 12  # random starts, at most, before the best of them are built upon
_ROUND = 6  # restarts that begin from the same knowledge
_ROUNDS = 2  # of restarts without a gain after which random starts begin anew
_WORTH = 1e-3  # decrease of the merit that counts as a gain

_FACTOR = 1.5  # by which the number of harmonics grows
_GROWTH = 0.02  # least decrease of the criterion for which it grows on
_FAMILY = 4  # best solutions that go on with more harmonics
_FIRST, _SHARE = 0.1, 0.35  # of the remaining time for the first and each further number
_SAMPLED = 6  # starts that compare periods
_PERIODS, _COMPARING = 5, 0.3  # periods compared, and the share of the time for that

Searches = tuple[SearchState, ...]


@dataclass(frozen=True, eq=False)
class Effort:
    """What a design may spend, and where.

    Attributes:
        starts: Number of starts; None for as many as fit until the deadline.
        jobs: Number of processes.
        seed: Seed of start k is (seed, k).
        deadline: `time.time` at which to stop [s].
        report: Called with the problem and the states so far whenever one changes.
        client: Dask cluster to use instead of processes here.
    """

    starts: int | None
    jobs: int
    seed: int
    deadline: float
    report: Callable[[DesignProblem, Sequence[SearchState]], None]
    client: Any = None


@dataclass(frozen=True, eq=False)
class Task:
    """A piece of one search.

    Attributes:
        state: Where it stands; before the first iteration its z may still be missing.
        iterations: Number of iterations to do.
        target: Merit that another search has reached.
        parent: Solution to be mixed with a random trajectory, for a restart.
        seed: Solution to begin from as it is.
        least: Decrease of the merit below which the search stalls.
    """

    state: SearchState
    iterations: int
    target: float = -np.inf
    parent: Array | None = None
    seed: Array | None = None
    least: float = COARSE


def search(
    problem: DesignProblem, effort: Effort, shortest: float, top_hz: float | None
) -> tuple[DesignProblem, Searches]:
    """All searches for a problem, and the problem with the period and harmonics chosen.

    Args:
        problem: With the longest period, and the least number of harmonics.
        effort: For all of it.
        shortest: Shortest period to choose [s].
        top_hz: Highest frequency up to which harmonics are added [Hz]; None to keep their number.
    """
    if shortest < problem.period:
        problem = _best_period(problem, effort, shortest)
    if top_hz is None:
        return problem, MultiStart(problem, effort).run()
    return _grow(problem, effort, top_hz)


@dataclass
class MultiStart:
    """Searches from many starts: random ones first, then restarts from the best found.

    Random starts are screened: after a few iterations the better half goes on. Restarts begin
    at a mixture of one of the best solutions and a random trajectory; the kinematic limits are
    convex, so it keeps them. Searches run until they become slow; only the best are then
    driven to convergence. When restarts bring nothing more, all this begins anew.

    Attributes:
        problem: The design problem.
        effort: How many starts, where and until when.
        seeds: Solutions to begin from as they are, instead of random starts.
        states: The searches by number.
    """

    problem: DesignProblem
    effort: Effort
    seeds: tuple[Array, ...] = ()
    states: dict[int, SearchState] = field(default_factory=dict)
    _first: int = 0

    def run(self) -> Searches:
        """All searches, ended one way or another; Ctrl-C ends them early."""
        try:
            self._island()
            while self._more():
                self._island()
            self._work(self._polishing(_POLISHED))
            for state in self._ranked()[_POLISHED:]:
                self._end(state, "stopped", ("stalled",))
            late = time.time() > self.effort.deadline
            self._end_all("time limit" if late else "iteration limit")
        except KeyboardInterrupt:
            self._end_all("interrupted")
        return tuple(self.states[k] for k in sorted(self.states))

    def _island(self) -> None:
        """Random starts, and restarts for as long as they bring something."""
        self._random_starts()
        idle = 0
        while self._more() and idle < _ROUNDS:
            before = self._merit()
            self._restarts()
            idle = 0 if self._merit() < before - _WORTH else idle + 1

    def _merit(self) -> float:
        """Best merit of this island."""
        return min((s.merit for s in self._ranked(self._first)), default=np.inf)

    @property
    def _room(self) -> float:
        """Starts still to be made."""
        return np.inf if self.effort.starts is None else self.effort.starts - len(self.states)

    def _more(self) -> bool:
        return self._room > 0 and time.time() < self.effort.deadline

    def _random_starts(self) -> None:
        self._first = first = len(self.states)
        count = int(min(self._room, max(3, min(_RANDOM, self._room / 2))))
        if first < len(self.seeds):
            count = len(self.seeds)
        seeds = dict(enumerate(self.seeds))
        self._work(
            [
                Task(self._blank(k), _SCREENING, seed=seeds.get(k))
                for k in range(first, first + count)
            ]
        )
        ranked = self._ranked(first)
        keep = len(ranked) if len(ranked) < 4 else -(-len(ranked) // 2)
        for state in ranked[keep:]:
            self._end(state, "stopped", ("running",))
        self._work([Task(s, _ITERATIONS) for s in ranked[:keep] if s.status == "running"])

    def _restarts(self) -> None:
        first = len(self.states)
        elite = [s for s in self._ranked(self._first) if np.isfinite(s.merit)][:_ELITE]
        tasks = self._polishing(_POLISHED // 2, self._first)
        for k in range(first, first + int(min(_ROUND, self._room))):
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
        return SearchState(index, np.zeros((0, self.problem.robot.nv)))

    def _ranked(self, first: int = 0) -> list[SearchState]:
        """The searches from a start onwards, best first."""
        states = (state for state in self.states.values() if state.index >= first)
        return sorted(states, key=lambda s: (s.merit, s.index))

    def _work(self, tasks: Sequence[Task]) -> None:
        for state in _results(self.problem, tasks, self.effort):
            self.states[state.index] = state
            self.effort.report(self.problem, tuple(self.states.values()))

    def _end(self, state: SearchState, status: str, among: tuple[str, ...]) -> None:
        if state.status in among:
            self.states[state.index] = replace(state, status=status)

    def _end_all(self, status: str) -> None:
        for state in tuple(self.states.values()):
            self._end(state, status, ("running", "stalled"))


def _grow(problem: DesignProblem, effort: Effort, top_hz: float) -> tuple[DesignProblem, Searches]:
    """The design with harmonics added up to a frequency [Hz], for as long as they pay.

    The best solutions for few harmonics are, or are near, trajectories with more: the search
    goes on from them.
    """
    searches = MultiStart(problem, _share(effort, effort.starts, _FIRST)).run()
    while time.time() < effort.deadline and not _interrupted(searches):
        terms = int(np.ceil(_FACTOR * problem.series.terms))
        larger = replace(problem, series=problem.series.resized(terms))
        seeds = _seeds(larger, problem, searches)
        if larger.series.terms / larger.period > top_hz or not seeds:
            break
        found = MultiStart(larger, _share(effort, len(seeds)), seeds).run()
        gain = _value(searches) - _value(found)
        if not gain > 0:
            break
        problem, searches = larger, found
        if gain < _GROWTH:
            break
    seeds = _seeds(problem, problem, searches)
    if seeds and effort.starts is None and not _interrupted(searches):
        searches = MultiStart(problem, effort, seeds).run()
    return problem, searches


def _best_period(problem: DesignProblem, effort: Effort, shortest: float) -> DesignProblem:
    """The problem with the period, among some from the shortest [s], that few starts like best."""
    began, tried = time.time(), []
    span = _COMPARING * (effort.deadline - began) / _PERIODS
    for k, period in enumerate(np.geomspace(shortest, problem.period, _PERIODS)):
        series = problem.series.resized(problem.series.terms, float(period))
        candidate = replace(problem, series=series)
        until = began + (k + 1) * span
        searches = MultiStart(candidate, replace(effort, starts=_SAMPLED, deadline=until)).run()
        tried.append((_value(searches), k, candidate))
        if _interrupted(searches):
            break
    return min(tried, key=lambda row: row[:2])[2]


def _share(effort: Effort, starts: int | None, share: float = _SHARE) -> Effort:
    now = time.time()
    return replace(effort, starts=starts, deadline=now + share * (effort.deadline - now))


def _seeds(problem: DesignProblem, before: DesignProblem, searches: Searches) -> tuple[Array, ...]:
    """The best solutions of a search as unknowns of a problem, within its limits."""
    near = (
        problem.trajectory(problem.unknowns(before.trajectory(z)))
        for z in best_solutions(searches, _FAMILY)
    )
    kept = (within_limits(problem.robot, trajectory) for trajectory in near)
    return tuple(problem.unknowns(trajectory) for trajectory in kept if trajectory is not None)


def _value(searches: Searches) -> float:
    return min((s.best_value for s in searches), default=np.inf)


def _interrupted(searches: Searches) -> bool:
    return any(s.status == "interrupted" for s in searches)


def connect(address: str) -> Any:
    """Client of the Dask scheduler at an address such as ``tcp://10.0.0.5:8786``.

    Raises:
        BadInput: Dask is not installed, nothing answers there, or it has no workers.
    """
    try:
        from distributed import Client
    except ImportError:
        raise BadInput("--cluster needs Dask: pip install 'excitant[cluster]'") from None
    try:
        client: Any = Client(  # type: ignore[no-untyped-call]
            address, timeout=_PATIENCE, set_as_default=False
        )
    except (OSError, ValueError, TimeoutError) as error:
        raise BadInput(f"cluster {address}: no Dask scheduler answers there ({error})") from None
    if not client.scheduler_info()["workers"]:
        client.close()
        raise BadInput(f"cluster {address}: the scheduler has no workers; start 'dask worker'")
    return client


def _results(
    problem: DesignProblem, tasks: Sequence[Task], effort: Effort
) -> Iterable[SearchState]:
    """States after their tasks, as they come."""
    if not tasks:
        return
    packed = pickle.dumps(problem)
    options: dict[str, Any] = {"backend": "loky", "inner_max_num_threads": 1}
    jobs = min(effort.jobs, len(tasks))
    if effort.client is not None:
        options, jobs = {"backend": "dask", "client": effort.client}, -1
    elif jobs == 1:
        options = {"backend": "sequential"}
    with joblib.parallel_config(**options):
        parallel = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")
        with _deaf_to_interrupts(jobs != 1):  # here the processes start
            found = parallel(
                joblib.delayed(_perform)(packed, task, effort.seed, effort.deadline)
                for task in tasks
            )
        yield from found


@contextmanager
def _deaf_to_interrupts(wanted: bool) -> Iterator[None]:
    """Processes started meanwhile never hear Ctrl-C, which is left to this one."""
    if not wanted or threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.SIG_DFL if before is None else before)


@lru_cache(maxsize=1)
def _unpacked(packed: bytes) -> DesignProblem:
    problem: DesignProblem = pickle.loads(packed)
    return problem


def _perform(packed: bytes, task: Task, seed: int, deadline: float) -> SearchState:
    """The state of a search after its task, on one thread; the problem is packed once for all."""
    problem, state = _unpacked(packed), task.state
    with threadpool_limits(1):
        if not state.history:
            try:
                state = _begin(problem, task, seed)
            except Infeasible:
                return replace(state, status="infeasible")
        return advance(
            problem,
            state,
            task.iterations,
            deadline=deadline,
            target=task.target,
            least=task.least,
        )


def _begin(problem: DesignProblem, task: Task, seed: int) -> SearchState:
    if task.seed is not None:
        return task.state.at(problem, task.seed)
    rng = np.random.default_rng([seed, task.state.index])
    z = problem.unknowns(problem.random(rng))
    if task.parent is not None:
        share = rng.uniform(*_MIX)
        z = (1 - share) * task.parent + share * z
    return task.state.at(problem, z)
