"""Many searches over processes, in rounds, so that their number does not change the result."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from excitant.design.problem import DesignProblem
from excitant.design.search import FINE, SearchState
from excitant.design.tasks import Effort, Task, results
from excitant.robots import Array

_SCREENING = 12  # iterations after which the worse half of the random starts is stopped
_ITERATIONS = 300
_ELITE = 3  # searches whose solutions are mixed with random trajectories to start again
_POLISHED = 4  # best searches that are driven to convergence
_RANDOM = 12  # random starts, at most, before the best of them are built upon
_ROUND = 6  # restarts that begin from the same knowledge
_ROUNDS = 2  # of restarts without a gain after which random starts begin anew
_WORTH = 1e-3  # decrease of the merit that counts as a gain


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

    def run(self) -> tuple[SearchState, ...]:
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
        self._work([self._first_task(k) for k in range(first, first + count)])
        ranked = self._ranked(first)
        keep = len(ranked) if len(ranked) < 4 else -(-len(ranked) // 2)
        for state in ranked[keep:]:
            self._end(state, "stopped", ("running",))
        self._work([Task(s, _ITERATIONS) for s in ranked[:keep] if s.status == "running"])

    def _first_task(self, index: int) -> Task:
        seed = self.seeds[index] if index < len(self.seeds) else None
        return Task(self._blank(index), _SCREENING, seed=seed)

    def _restarts(self) -> None:
        first = len(self.states)
        last = first + int(min(_ROUND, self._room))
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
        return SearchState(index, np.zeros((0, self.problem.robot.nv)))

    def _ranked(self, first: int = 0) -> list[SearchState]:
        """The searches from a start onwards, best first."""
        states = (state for state in self.states.values() if state.index >= first)
        return sorted(states, key=lambda s: (s.merit, s.index))

    def _work(self, tasks: Sequence[Task]) -> None:
        for state in results(self.problem, tasks, self.effort):
            self.states[state.index] = state
            self.effort.report(self.problem, tuple(self.states.values()))

    def _end(self, state: SearchState, status: str, among: tuple[str, ...]) -> None:
        if state.status in among:
            self.states[state.index] = replace(state, status=status)

    def _end_all(self, status: str) -> None:
        for state in tuple(self.states.values()):
            self._end(state, status, ("running", "stalled"))
