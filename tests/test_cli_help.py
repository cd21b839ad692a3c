"""Help at once with examples that work; completion at TAB; progress on a terminal."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from marks import slow

from excitant.cli import app
from excitant.robots import builtin_robots

UNIT = "import asyncio, http.server, multiprocessing, unittest, xml.dom.minidom"
UNITS = 4.0  # of that import, 0.3 s of processor where it takes 0.075 s: within which help comes
VERBS = [name for name in app if not name.startswith("-")]
HELP = "\n".join(app[name].help_epilogue for name in VERBS)
README = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"^ +(excitant .*)$", f"{HELP}\n{README}", re.MULTILINE)


@pytest.mark.parametrize("name", VERBS)
def test_help_begins_with_options_of_every_day_and_ends_with_examples(name: str, excitant: Any):
    """A dozen options at most stand before the rare ones."""
    ran = excitant(f"{name} --help")
    assert ran.status == 0
    assert re.search(rf"\nexamples?:\n  excitant {name}\b", ran.out)
    daily, _, rare = ran.out.partition("Rare options")
    first, others = (re.findall(r"^│ +(--[a-z-]+) ", x, re.MULTILINE) for x in (daily, rare))
    assert len(first) <= 12
    assert not {*first} & {*others}
    if name in ("go", "identify", "diagnose"):
        assert {"--map", "--validate", "--repair", "--output"} <= {*first}
        assert {"--cutoff", "--lock"} <= {*others}


@pytest.mark.parametrize("line", EXAMPLES)
def test_an_example_is_understood(line: str) -> None:
    _, *words = shlex.split(line.partition(" > ")[0], comments=True)
    command, *_ = app.parse_args(words, exit_on_error=False, print_error=False)
    assert command.__name__ == words[0]


RUN = ("robots", "robots panda", "analyze panda", "analyze cmu_dd_arm_ii --moving joint1,joint3")


@pytest.mark.parametrize("words", RUN)
def test_an_example_runs(words: str, here: Path, excitant: Any) -> None:
    assert f"excitant {words}" in EXAMPLES
    ran = excitant(words)
    assert (ran.status, bool(ran.out)) == (0, True)


@cache
def spent(*command: str) -> float:
    ended = [sum(os.times()[2:4])]  # of processes that have ended
    for _ in range(3):
        subprocess.run([sys.executable, *command], check=True, capture_output=True)
        ended.append(sum(os.times()[2:4]))
    return float(np.diff(ended).min())


@pytest.mark.parametrize("words", [slow(["--help"]), ["design", "--help"], slow(["--version"])])
def test_help_comes_at_once(words: list[str]) -> None:
    """In processor time, which does not count what else the machine does; the best of three."""
    assert spent("-m", "excitant", *words) < UNITS * spent("-c", UNIT)


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_a_script_that_the_shell_reads(shell: str, excitant: Any) -> None:
    script = excitant(f"completion {shell}").out
    assert [word for word in (*VERBS, "criterion", "condition") if word not in script] == []
    if (program := shutil.which(shell)) is not None:
        checked = subprocess.run([program, "-n"], input=script, text=True, capture_output=True)
        assert (checked.returncode, checked.stderr) == (0, "")


COMPLETED = {
    "des": {"design"},
    "design --crit": {"--criterion"},
    "design --criterion con": {"condition"},
    "design ur": {name for name in builtin_robots() if name.startswith("ur")},
    "identify ur10 --effects stri": {"stribeck_friction"},
    "rehearse traj": {"trajectory.csv"},
    "rehearse ur10 traj": set(),  # of these Bash itself completes names of files
}


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash completes itself only")
@pytest.mark.parametrize("line", [x if "stri" in x else slow(x) for x in COMPLETED])
def test_bash_completes(line: str, here: Path, excitant: Any) -> None:
    (here / "trajectory.csv").touch()
    program = Path(sys.executable).parent / "excitant"
    pressed = f"COMP_WORDS=({program} {line}) COMP_CWORD={len(line.split())}; _excitant"
    code = f"{excitant('completion bash').out}\n{pressed}; echo ${{COMPREPLY[@]}}"
    done = subprocess.run(["bash", "-c", code], text=True, capture_output=True)
    assert set(done.stdout.split()) == COMPLETED[line]
    assert "complete -o default -F _excitant" in code


PROGRESS = """
import time
from excitant.progress import progress_bar
with progress_bar("work") as advance:
    for k in range(8):
        advance(k / 16, "half way")
        time.sleep(0.1)
"""


def test_progress_on_a_terminal_says_the_time_left() -> None:
    pty = pytest.importorskip("pty")
    master, slave = pty.openpty()
    env = os.environ | {"TERM": "xterm", "NO_COLOR": "1", "COLUMNS": "120"}
    with os.fdopen(master, "rb", buffering=0) as terminal:
        subprocess.run([sys.executable, "-c", PROGRESS], stderr=slave, env=env, check=True)
        os.close(slave)
        shown = terminal.read(65536).decode(errors="replace")
    assert re.search(r"left.*0:00:0\d", shown)
    assert not re.search(r"\x1b\[[0-9;]*3[0-7]m", shown)
