"""Work on a stranger's file in a child process with bounded time and memory.

The child inherits the folders that Python imports from, never the working folder, and cannot write
files. What it costs is the start of an interpreter: about 0.1 s of processor time.
"""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
from collections.abc import Callable
from typing import Any

_MAIN = "from excitant.limited import serve; serve()"
_WAITING = 60  # wall time allowed, in processor times: the machine has other work
_TOO_MUCH = "takes too much time or memory"


class Exceeded(ValueError):
    """The child process needed more than it may have, or a library crashed in it."""


def in_child(
    work: Callable[..., bytes], *arguments: Any, seconds: int, memory: int
) -> bytes:
    """Result of a function of a module, called in a child process.

    Args:
        work: The function, at the top of its module.
        arguments: Its arguments, as JSON holds them.
        seconds: Processor time that it may take [s].
        memory: Address space that it may take [bytes].

    Raises:
        ValueError: What the function raised, as text.
        Exceeded: It was ended.
    """
    task = [work.__module__, work.__name__, arguments, seconds, memory]
    folders = os.pathsep.join(filter(None, sys.path))
    environment = {**os.environ, "PYTHONPATH": folders, "OMP_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-c", _MAIN],
            input=json.dumps(task).encode(),
            capture_output=True,
            env=environment,
            timeout=_WAITING * seconds,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise Exceeded(_TOO_MUCH) from None
    if done.returncode == 0:
        return done.stdout
    reason = done.stderr.decode(errors="replace").strip().rpartition("\n")[2]
    if done.returncode == 1 and reason != MemoryError.__name__:
        raise ValueError(reason)
    raise Exceeded(_TOO_MUCH)


def serve() -> None:
    """Do the task that standard input describes; its result is standard output."""
    module, name, arguments, seconds, memory = json.load(sys.stdin)
    _limit(seconds, memory)
    try:
        result = getattr(importlib.import_module(module), name)(*arguments)
    except Exception as error:
        sys.exit(" ".join(str(error).split()) or type(error).__name__)
    sys.stdout.buffer.write(result)


def _limit(seconds: int, memory: int) -> None:
    """Limit this process, where the system can."""
    try:
        import resource
    except ImportError:
        return
    for kind, limit in (
        (resource.RLIMIT_CPU, seconds),
        (resource.RLIMIT_AS, memory),
        (resource.RLIMIT_FSIZE, 0),
        (resource.RLIMIT_CORE, 0),
    ):
        _, hard = resource.getrlimit(kind)
        allowed = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
        resource.setrlimit(kind, (allowed, hard))
