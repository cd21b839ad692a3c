"""Worker processes: they leave Ctrl-C to the process that started them, and end with it."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")
_LOOK = 0.5  # s between looks for the process that started this one


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
