"""Processes forked from a command: they share its work, and nothing depends on them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from excitant.processes import ahead, together

pytestmark = pytest.mark.skipif(
    sys.platform != "linux" or len(os.sched_getaffinity(0)) < 2, reason="needs Linux and two cores"
)

BEGIN = """
import os, time
from functools import partial
from excitant.processes import ahead, may_fork, together
may_fork()
me = os.getpid()

def slow(k):
    time.sleep(0.2)
    return k, os.getpid()

def only_here(k):
    if os.getpid() != me:
        os._exit(3)
    return slow(k)

def refused(k):
    raise ValueError(f"task {k}")

fork, ahead = ahead, partial(ahead, partial(time.sleep, 0.1))
"""


def said(script: str) -> list[str]:
    """Lines that a script prints, and the last one of an error."""
    words, limit = [sys.executable, "-c", BEGIN + script], 60.0
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=limit)
    return done.stdout.splitlines() + done.stderr.splitlines()[-1:]


@pytest.mark.parametrize("ended", ["SIG_DFL", "SIG_IGN"])
def test_two_processes_share_tasks(ended: str) -> None:
    script = f"import signal; signal.signal(signal.SIGCHLD, signal.{ended})"
    script += """
found = together([partial(slow, k) for k in range(6)])
print([k for k, _ in found], len({pid for _, pid in found}))
print(together([]), [k for k, pid in together([partial(slow, 7)]) if pid == me])
"""
    assert said(script) == ["[0, 1, 2, 3, 4, 5] 2", "[] [7]"]


def test_what_the_other_process_fails_to_do_is_done_here() -> None:
    script = """
found = together([partial(only_here, k) for k in range(4)])
print([k for k, pid in found if pid == me])
print(ahead(only_here)(5) == (5, me))
dying = fork(partial(os._exit, 3), slow)
time.sleep(0.5)
print(dying(6) == (6, me))
unpicklable = together([partial(lambda k: (slow(k), lambda: k), k) for k in range(4)])
print([k for (k, pid), _ in unpicklable if pid == me])
"""
    assert said(script) == ["[0, 1, 2, 3]", "True", "True", "[0, 1, 2, 3]"]


def test_errors_are_those_of_a_call_here() -> None:
    assert said("together([partial(refused, k) for k in range(2)])")[0].startswith("ValueError: ta")
    assert said("ahead(refused)(5)") == ["ValueError: task 5"]


def test_another_process_gets_ready_meanwhile_and_ends_with_this_one() -> None:
    script = """
call, unused = ahead(slow), fork(partial(time.sleep, 1000), slow)
k, pid = call(8)
print(k, pid != me)
"""
    assert said(script) == ["8 True"]


def test_only_a_command_is_forked() -> None:
    assert together([os.getpid, os.getpid]) == 2 * [os.getpid()]
    assert ahead(os.getpid, os.getpid)() == os.getpid()


EXAMPLE = Path(__file__).parents[1] / "examples" / "cell3"
COMMAND = """
import atexit, os, sys
import excitant.__main__ as process
cores, *words = sys.argv[1:]
os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:int(cores)])
sys.argv = ["excitant", *words]
atexit.register(lambda: print("matplotlib" in sys.modules))
process.run()
"""


def test_a_page_is_drawn_by_another_process(tmp_path: Path) -> None:
    """Where there is a core for it; the page is the same."""
    pages = []
    for cores in (1, 2):
        out = tmp_path / str(cores)
        words = f"{cores} identify {EXAMPLE} -o {out}".split()
        done = subprocess.run(
            [sys.executable, "-c", COMMAND, *words], capture_output=True, text=True, check=True
        )
        assert done.stdout.splitlines()[-1] == str(cores == 1)
        pages.append((out / "report.html").read_text("utf-8"))
    assert pages[0] == pages[1]
    assert pages[0].count("<svg") > 9
