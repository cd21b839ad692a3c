"""Ctrl-C, SIGTERM and SIGHUP raise KeyboardInterrupt in the main thread of a command.

Python drops what a destructor or the callback of a weak reference raises, and import runs many of
these. So a signal counts until it was `heard`, and long work asks for it (`check`).
"""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_OF_POOLS = ("ExecutorManagerThread", "QueueFeederThread", "GeneratorExitThread")
"""Names of threads that loky and joblib run a pool with."""
_arrived = threading.Event()


class Interrupted(KeyboardInterrupt):
    """A signal that ends the command.

    Python ends itself by SIGINT, whoever caught it, where a KeyboardInterrupt proper
    leaves a text run by ``exec``, as that of a dataclass.
    """


def listen() -> None:
    """Let each of the signals raise `Interrupted`; under ``nohup``, SIGHUP stays ignored."""
    for number in SIGNALS:
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _interrupt)


def _interrupt(number: int, _: object) -> NoReturn:
    _arrived.set()
    threading.excepthook = _tell
    raise Interrupted


def _tell(error: threading.ExceptHookArgs) -> None:
    """Tell an error of a thread, unless its pool was ended amid its work."""
    if error.thread is None or error.thread.name not in _OF_POOLS:
        threading.__excepthook__(error)


def ignore() -> None:
    """Let none of the signals change how a command ends that is over."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def check() -> None:
    """Raise `Interrupted` after a signal that was not heard."""
    if _arrived.is_set():
        raise Interrupted


def heard() -> None:
    """Go on with less work after a signal."""
    _arrived.clear()


@contextmanager
def deferred(done: str = "") -> Iterator[None]:
    """Handle signals that arrive within the block at its end; what it did is their message.

    KeyboardInterrupt without a message means that nothing was done.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    arrived: list[int] = []
    before: dict[int, Any] = {
        number: signal.signal(number, lambda number, _: arrived.append(number))
        for number in SIGNALS
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
    try:
        for number in arrived:
            signal.raise_signal(number)
    except KeyboardInterrupt:
        raise Interrupted(done) from None
