"""Pieces of searches, performed here, over processes, or over a Dask cluster."""

from __future__ import annotations

import pickle
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import joblib
import numpy as np
from joblib.externals.loky import get_reusable_executor
from threadpoolctl import threadpool_limits

from excitant.design.problem import DesignProblem
from excitant.design.search import COARSE, SearchState, advance
from excitant.exceptions import BadInput, Infeasible
from excitant.robots import Array

_MIX = (0.3, 0.5)  # share of the random trajectory in a restart
_PATIENCE = "20s"  # for a cluster to answer


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


def results(problem: DesignProblem, tasks: Sequence[Task], effort: Effort) -> Iterable[SearchState]:
    """States after their tasks, as they come."""
    if not tasks:
        return
    if effort.client is not None:
        yield from _over_cluster(effort.client, problem, tasks, effort)
        return
    if effort.jobs == 1 or len(tasks) < 2:
        for task in tasks:
            yield perform(problem, task, effort.seed, effort.deadline)
        return
    packed = pickle.dumps(problem)
    with joblib.parallel_config(backend="loky", inner_max_num_threads=1):
        parallel = joblib.Parallel(n_jobs=effort.jobs, return_as="generator_unordered")
        apart = joblib.delayed(_perform_apart)
        try:
            with _deaf_to_interrupts():  # here the processes start
                found = parallel(
                    apart(packed, task, effort.seed, effort.deadline) for task in tasks
                )
            yield from found
        except KeyboardInterrupt:
            get_reusable_executor().shutdown(wait=False, kill_workers=True)
            raise


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Processes started meanwhile never hear Ctrl-C, not even before their first task."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.SIG_DFL if before is None else before)


def _over_cluster(
    client: Any, problem: DesignProblem, tasks: Sequence[Task], effort: Effort
) -> Iterable[SearchState]:
    from distributed import as_completed

    shared = client.scatter(pickle.dumps(problem), broadcast=True, hash=False)
    futures = [
        client.submit(_perform_packed, shared, task, effort.seed, effort.deadline, pure=False)
        for task in tasks
    ]
    try:
        for future in as_completed(futures, loop=client.loop):  # type: ignore[no-untyped-call]
            yield future.result()
    except KeyboardInterrupt:
        client.cancel(futures)
        raise


def _perform_apart(packed: bytes, task: Task, seed: int, deadline: float) -> SearchState:
    """A task in a process of its own, where Ctrl-C is left to the parent."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    return _perform_packed(packed, task, seed, deadline)


def _perform_packed(packed: bytes, task: Task, seed: int, deadline: float) -> SearchState:
    """A task of a problem that was packed once, before others use and so change its caches."""
    return perform(_unpacked(packed), task, seed, deadline)


@lru_cache(maxsize=1)
def _unpacked(packed: bytes) -> DesignProblem:
    problem: DesignProblem = pickle.loads(packed)
    return problem


def perform(problem: DesignProblem, task: Task, seed: int, deadline: float) -> SearchState:
    """The state of a search after its task, on one thread."""
    with threadpool_limits(1):
        state = task.state
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
    drawn = problem.random(rng)
    z = problem.unknowns(drawn)
    if task.parent is not None:
        share = rng.uniform(*_MIX)
        z = (1 - share) * task.parent + share * z
    return task.state.at(problem, z)
