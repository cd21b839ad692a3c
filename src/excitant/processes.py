"""Work on processes of this machine or of a Dask cluster.

Processes here leave Ctrl-C to the one that started them, and end with it.
"""

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager, nullcontext
from functools import cache, partial
from typing import Any, ParamSpec, TypeVar

from excitant.exceptions import BadInput, WorkerDied
from excitant.interrupts import check, deferred

P = ParamSpec("P")
T = TypeVar("T")

OWNER_CHECK_S = 0.5  # s between two looks whether the starting process lives
CLUSTER_TIMEOUT = "20s"  # for a scheduler to answer


def connect(address: str) -> Any:
    """Client of the Dask scheduler at an address such as ``tcp://10.0.0.5:8786``.

    Raises:
        BadInput: Dask is not installed, nothing answers there, or it has no workers.
    """
    try:
        from distributed import Client
    except ImportError:
        raise BadInput(
            "--cluster needs Dask: pip install 'excitant[cluster]'"
        ) from None
    try:
        client: Any = Client(  # type: ignore[no-untyped-call]
            address, timeout=CLUSTER_TIMEOUT, set_as_default=False
        )
    except (OSError, ValueError, TimeoutError) as error:
        raise BadInput(
            f"cluster {address}: no Dask scheduler answers there ({error})"
        ) from None
    if not client.scheduler_info()["workers"]:
        client.close()
        raise BadInput(
            f"cluster {address}: the scheduler has no workers; start 'dask worker'"
        )
    return client


def processors() -> int:
    """Number of processes that can work side by side here."""
    import joblib

    return int(joblib.cpu_count())


def unordered(
    function: Callable[..., T],
    tasks: Sequence[tuple[Any, ...]],
    jobs: int,
    client: Any = None,
    *,
    apart: bool = False,
) -> Iterator[T]:
    """A function of the arguments of each task, as they come, by processes here or of a cluster.

    One job or one task is done in this process, unless it has to be ``apart``.

    Raises:
        WorkerDied: A process ended; tasks without a result may have been done or not.
    """
    if not tasks:
        return
    if client is None:
        results = _here(function, tasks, max(min(jobs, len(tasks)), 1 + apart))
    else:
        results = _on_cluster(function, tasks, client)
    try:
        yield from results
    except Exception as error:
        if (
            isinstance(error, BrokenExecutor)
            or type(error).__name__ == "KilledWorker"
        ):
            raise WorkerDied() from None
        raise


def _here(
    function: Callable[..., T], tasks: Sequence[tuple[Any, ...]], jobs: int
) -> Iterator[T]:
    import joblib

    options: dict[str, Any] = {"backend": "sequential"}
    if jobs > 1:
        options = {"backend": "loky", "inner_max_num_threads": 1}
    perform = owned(function)
    with joblib.parallel_config(**options):
        parallel = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")
        with _interrupts_blocked() if jobs > 1 else nullcontext():
            results = parallel(joblib.delayed(perform)(*task) for task in tasks)
        check()
        yield from results


def _on_cluster(
    function: Callable[..., T], tasks: Sequence[tuple[Any, ...]], client: Any
) -> Iterator[T]:
    from distributed import as_completed

    futures = [client.submit(function, *task, pure=False) for task in tasks]
    try:
        completed = as_completed(futures, loop=client.loop)  # type: ignore[no-untyped-call]
        for future in completed:
            yield future.result()
    finally:
        client.cancel(futures)


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Processes that start within the block hear neither Ctrl-C nor SIGHUP; here signals wait.

    What libraries do to start processes is not made to be interrupted.
    """
    from multiprocessing import resource_tracker

    with deferred():
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGHUP})
        try:
            resource_tracker.ensure_running()  # unblocks SIGINT, in Python 3.11
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def owned(function: Callable[P, T]) -> Callable[P, T]:
    """A function for a worker process of this one, which ends soon after this one has died."""
    return partial(_run, os.getpid(), function)


def _run(
    owner: int, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs
) -> T:
    if os.getpid() != owner:
        _end_with(owner)
    return function(*args, **kwargs)


@cache
def _end_with(owner: int) -> None:
    def watch() -> None:
        while os.getppid() == owner:
            time.sleep(OWNER_CHECK_S)
        signal.raise_signal(signal.SIGTERM)

    threading.Thread(target=watch, daemon=True).start()
