"""Work on processes of this machine or of a Dask cluster, and on one forked from a command.

Processes here leave Ctrl-C to the one that started them, and end with it.
"""

from __future__ import annotations

import atexit
import os
import pickle
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache, partial
from typing import Any, Generic, NoReturn, ParamSpec, TypeVar

from excitant.exceptions import BadInput, WorkerDied

P = ParamSpec("P")
T = TypeVar("T")
_LOOK = 0.5  # s between looks for the process that started this one
_PATIENCE = "20s"  # for a cluster to answer
_INTERRUPTS = (signal.SIGINT, signal.SIGTERM)
_NUMBER = 2  # bytes of a task's number
_forks = False  # whether this process is a command's


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
            address, timeout=_PATIENCE, set_as_default=False
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
    jobs = max(min(jobs, len(tasks)), 1 + apart)
    perform = owned(function)
    if client is not None:
        options = {"backend": "dask", "client": client}
        jobs = -1
        perform = function
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


def may_fork() -> None:
    """Let `ahead` and `together` fork this process, which is a command's; elsewhere they do not.

    They do so on Linux, where there is a second core, while the process has one thread.
    """
    global _forks
    _forks = True


def ahead(prepare: Callable[[], object], function: Callable[P, T]) -> Callable[P, T]:
    """A function for one call in another process, which prepares for it meanwhile.

    Arguments and result are pickled. Where there is no other process, or it fails, the function is
    called here.
    """
    asked, asking = os.pipe()

    def answer() -> T:
        os.close(asking)
        prepare()
        with os.fdopen(asked, "rb") as stream:
            args, kwargs = pickle.load(stream)
        return function(*args, **kwargs)

    other = _forked(answer)
    os.close(asked)
    if other is None:
        os.close(asking)
        return function

    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        with suppress(BrokenPipeError), os.fdopen(asking, "wb") as stream:
            pickle.dump((args, kwargs), stream, pickle.HIGHEST_PROTOCOL)
        found = other.result()
        return function(*args, **kwargs) if found is None else found[0]

    return call


def together(tasks: Sequence[Callable[[], T]]) -> list[T]:
    """Results of tasks in their order; two processes share the tasks where this one may fork.

    Results are pickled. What the other process fails to do is done here. A task forks nothing.
    """
    global _forks
    left, numbers = os.pipe()

    def share() -> dict[int, T]:
        global _forks
        _forks = False
        found = {}
        while number := os.read(left, _NUMBER):
            k = int.from_bytes(number)
            found[k] = tasks[k]()
        return found

    os.write(numbers, b"".join(k.to_bytes(_NUMBER) for k in range(len(tasks))))
    os.close(numbers)
    before = _forks
    other = _forked(share) if len(tasks) > 1 else None
    try:
        done = share()
        if other is not None and (found := other.result()):
            done |= found[0]
    finally:
        _forks = before
        os.close(left)
        if other is not None:
            other.end()
    return [done[k] if k in done else task() for k, task in enumerate(tasks)]


class _Fork(Generic[T]):
    """A process forked from this one for a piece of work; it ends with this one."""

    def __init__(self, work: Callable[[], T]) -> None:
        reader, writer = os.pipe()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, _INTERRUPTS)  # none is lost
        try:
            self._pid = os.fork()
            if not self._pid:
                signal.signal(signal.SIGINT, signal.SIG_IGN)
                signal.signal(signal.SIGTERM, signal.SIG_DFL)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if not self._pid:
            os.close(reader)
            _answer(work, writer)
        os.close(writer)
        self._reader = reader
        atexit.register(self.end)

    def result(self) -> tuple[T] | None:
        """What came of the work; None where it failed."""
        try:
            with os.fdopen(self._reader, "rb") as stream:
                return (pickle.load(stream),)
        except (EOFError, pickle.UnpicklingError):
            return None
        finally:
            self.end()

    def end(self) -> None:
        """End the process, if it has not ended yet."""
        if self._pid:
            with suppress(
                ProcessLookupError, ChildProcessError
            ):  # nobody waits if SIGCHLD is ignored
                os.kill(self._pid, signal.SIGKILL)
                os.waitpid(self._pid, 0)
            self._pid = 0
            atexit.unregister(self.end)


def _forked(work: Callable[[], T]) -> _Fork[T] | None:
    """Work begun in a process forked now; None where that may not or cannot be."""
    if not _forks or sys.platform != "linux" or threading.active_count() > 1:
        return None
    if len(os.sched_getaffinity(0)) < 2:
        return None
    try:
        return _Fork(work)
    except OSError:
        return None


def _answer(work: Callable[[], Any], writer: int) -> NoReturn:
    status = 1
    try:
        answer = pickle.dumps(work(), pickle.HIGHEST_PROTOCOL)
        with os.fdopen(writer, "wb") as stream:
            stream.write(answer)
        status = 0
    finally:  # whatever was raised: the process it was forked from does the work
        os._exit(status)


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
