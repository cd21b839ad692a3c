"""Work on a stranger's file in a child process with bounded time and memory.

The child inherits the folders that Python imports from, never the working folder, and cannot write
files. What it costs is the start of an interpreter: about 0.1 s of processor time.
"""

import importlib
import os
import signal
import sys
from collections.abc import Callable, Iterable
from typing import Any

import msgspec

_MAIN = "from excitant.limited import serve; serve()"
_WAITING = 60  # wall time allowed, in processor times: the machine has other work
_TOO_MUCH = "takes too much time or memory"
_CRASHED = "takes too much memory or makes the library that reads it crash"


class Exceeded(ValueError):
    """The child process needed more than it may have, or a library crashed in it.

    Attributes:
        output: The parts of its result that it had finished.
    """

    def __init__(self, why: str, output: bytes = b"") -> None:
        super().__init__(why)
        self.output = output


def in_child(
    work: Callable[..., bytes | Iterable[bytes]] | str,
    *arguments: Any,
    seconds: int,
    memory: int,
    files: int | None = None,
) -> bytes:
    """Result of a function of a module, called in a child process.

    Args:
        work: The function, at the top of its module, or ``module.function`` where only the child
            is to import it. What it returns in parts is sent part by part.
        arguments: Its arguments, as msgpack holds them.
        seconds: Processor time that it may take [s].
        memory: Address space that it may take [bytes].
        files: How many files it may hold open once its module is imported; None for any number.

    Raises:
        ValueError: What the function raised, as text.
        Exceeded: It was ended.
    """
    if not isinstance(work, str):
        work = f"{work.__module__}.{work.__name__}"
    import subprocess  # which the child does without

    task = [work, arguments, seconds, memory, files]
    folders = os.pathsep.join(filter(None, sys.path))
    environment = {**os.environ, "PYTHONPATH": folders, "OMP_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-c", _MAIN],
            input=msgspec.msgpack.encode(task),
            capture_output=True,
            env=environment,
            timeout=_WAITING * seconds,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise Exceeded(_TOO_MUCH, error.output or b"") from None
    if done.returncode == 0:
        return done.stdout
    reason = done.stderr.decode(errors="replace").strip().rpartition("\n")[2]
    if done.returncode == 1 and reason != MemoryError.__name__:
        raise ValueError(reason)
    of_time = done.returncode == -signal.SIGXCPU
    limited = of_time or reason == MemoryError.__name__
    raise Exceeded(_TOO_MUCH if limited else _CRASHED, done.stdout)


def serve() -> None:
    """Do the task that standard input describes; its result is standard output."""
    work, arguments, seconds, memory, files = msgspec.msgpack.decode(
        sys.stdin.buffer.read()
    )
    _limit(CPU=seconds, AS=memory, FSIZE=0, CORE=0)
    module, _, name = work.rpartition(".")
    try:
        function = getattr(importlib.import_module(module), name)
        if files is not None:
            free = os.dup(0)  # the lowest number that a file would get
            os.close(free)
            _limit(NOFILE=free + files)
        result = function(*arguments)
        for part in [result] if isinstance(result, bytes) else result:
            sys.stdout.buffer.write(part)
            sys.stdout.buffer.flush()
    except Exception as error:
        sys.exit(" ".join(str(error).split()) or type(error).__name__)


def _limit(**limits: int) -> None:
    """Lower limits of this process, named as the system does."""
    import resource  # which the parent does without

    for name, limit in limits.items():
        kind = getattr(resource, f"RLIMIT_{name}")
        _, hard = resource.getrlimit(kind)
        allowed = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
        resource.setrlimit(kind, (allowed, hard))
