"""Work on processes of this machine or of a Dask cluster.

Processes here leave Ctrl-C to the one that started them, and end with it.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache, partial
from typing import Any, ParamSpec, TypeVar

from excitant.exceptions import BadInput, WorkerDied

P = ParamSpec("P")
T = TypeVar("T")
_LOOK = 0.5  # s between looks for the process that started this one
_PATIENCE = "20s"  # for a cluster to answer


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
    from concurrent.futures import BrokenExecutor

    import joblib

    if not tasks:
        return
    options: dict[str, Any] = {"backend": "loky", "inner_max_num_threads": 1}
    jobs, perform = max(min(jobs, len(tasks)), 1 + apart), owned(function)
    if client is not None:
        options, jobs, perform = {"backend": "dask", "client": client}, -1, function
    elif jobs == 1:
        options = {"backend": "sequential"}
    try:
        with joblib.parallel_config(**options):
            parallel = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")
            with deaf_to_interrupts(jobs != 1):  # here the processes start
                found = parallel(joblib.delayed(perform)(*task) for task in tasks)
            yield from found
    except Exception as error:
        if isinstance(error, BrokenExecutor) or type(error).__name__ == "KilledWorker":
            raise WorkerDied() from None
        raise


def owned(function: Callable[P, T]) -> Callable[P, T]:
    """A function for a worker process of this one, which ends soon after this one has died."""
    return partial(_run, os.getpid(), function)


def _run(owner: int, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    _end_with(owner)
    return function(*args, **kwargs)


@cache
def _end_with(owner: int) -> None:
    if os.getpid() == owner:
        return

    def watch() -> None:
        while os.getppid() == owner:
            time.sleep(_LOOK)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def deaf_to_interrupts(wanted: bool = True) -> Iterator[None]:
    """Processes started meanwhile never hear Ctrl-C, which is left to this one."""
    if not wanted or threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.SIG_DFL if before is None else before)
