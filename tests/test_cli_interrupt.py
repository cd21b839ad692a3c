"""Ctrl-C on real processes: a design keeps what it has, others say that nothing was written."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import psutil
import pytest

from excitant.design import random_trajectory, trajectory_json
from excitant.robots import load_robot

pytestmark = pytest.mark.skipif(not psutil.LINUX, reason="asks for loaded libraries")

PATIENCE = 240.0  # s: machines may be slow, a process that hangs is not
EXCITANT = [sys.executable, "-m", "excitant"]
SEARCH = "design planar_2r --harmonics 3 --time-limit 1000 --jobs 2 -o out"  # without an end


def wait(until: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + PATIENCE
    while not until():
        assert time.monotonic() < deadline, f"waited in vain: {what}"
        time.sleep(0.05)


def libraries(process: psutil.Process) -> set[str]:
    return {file.path for file in process.memory_maps() if ".so" in file.path}


def settle(process: psutil.Process) -> None:
    """Wait until imports are over: Pinocchio is there, and nothing was loaded for a while."""
    wait(lambda: any("pinocchio" in path for path in libraries(process)), "the command at work")
    known: set[str] = set()
    while found := libraries(process) - known:
        known |= found
        time.sleep(1.5)


def interrupted(words: str, folder: Path, children: int, group: bool) -> tuple[int, str]:
    """Exit status and error stream of a command that was interrupted amid its work."""
    started = psutil.Popen(
        [*EXCITANT, *words.split()], cwd=folder, start_new_session=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        # shells start what runs in the background deaf to Ctrl-C; not so here
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    family = [started]
    try:
        settle(started)
        wait(lambda: len(started.children(recursive=True)) >= children, "its processes")
        settle(started)
        family += started.children(recursive=True)
        assert started.poll() is None
        os.killpg(started.pid, signal.SIGINT) if group else started.send_signal(signal.SIGINT)
        _, err = started.communicate(timeout=PATIENCE)
        assert not psutil.wait_procs(family, PATIENCE)[1]
    finally:
        for process in family:
            if process.is_running():
                process.kill()
    return started.returncode, err


@pytest.mark.slow
@pytest.mark.parametrize("group", [True, False])
def test_a_design_writes_the_best_so_far(group: bool, tmp_path: Path) -> None:
    """At the terminal, and where the process alone is interrupted."""
    line = "excitant: interrupted; the best motion so far was written\n"
    assert interrupted(SEARCH, tmp_path, 3, group) == (130, line)
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written >= {"result.json", "report.html", "trajectory.csv", "trajectory.json"}
    result = json.loads((tmp_path / "out" / "result.json").read_text("utf-8"))
    assert "interrupted" in {start["status"] for start in result["starts"]}
    assert any(note.startswith("interrupted: ") for note in result["notes"])


@pytest.mark.slow
def test_others_say_that_nothing_was_written(tmp_path: Path) -> None:
    robot = load_robot("ur10")
    motion = random_trajectory(robot, np.random.default_rng(0), 2000.0, 2)
    (tmp_path / "slow.json").write_text(trajectory_json(motion, robot), encoding="utf-8")
    found = interrupted("simulate ur10 slow.json -o run.csv", tmp_path, 0, group=True)
    assert found == (130, "excitant: interrupted; nothing was written\n")
    assert [path.name for path in tmp_path.rglob("*")] == ["slow.json"]


@pytest.mark.slow
def test_a_command_that_is_done_leaves_no_process(tmp_path: Path) -> None:
    """It ends without waiting for what ends with it."""
    words = "design planar_2r --harmonics 2 --periods 1 --duration 4 --starts 2 --jobs 2 -o out"
    known = {"cwd": tmp_path, "env": {**os.environ, "OF_TEST": str(tmp_path)}}
    done = subprocess.run([*EXCITANT, *words.split()], capture_output=True, text=True, **known)
    assert (done.returncode, done.stdout.splitlines()[-1]) == (0, "out/report.html")

    def ours(process: psutil.Process) -> bool:
        try:
            return process.environ().get("OF_TEST") == str(tmp_path)
        except psutil.Error:
            return False

    wait(lambda: not any(map(ours, psutil.process_iter())), "the end of its processes")


def test_a_full_disk_behind_the_output_is_told() -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run([*EXCITANT, "robots"], stdout=full, stderr=subprocess.PIPE, text=True)
    assert (done.returncode, done.stderr) == (1, "excitant: file: No space left on device\n")


def ran_amid(code: str, folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """A command in whose process this code comes first."""
    (folder / "amid.py").write_text(code)
    command = [sys.executable, "-m", "amid", *words]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True)


def test_ctrl_c_amid_exec_ends_with_the_status_all_the_same(tmp_path: Path) -> None:
    """Python ends itself by the signal where that came while exec() ran a text, caught or not."""
    code = (
        "import os, signal, excitant.cli, excitant.__main__\n"
        "def main():\n"
        "    try: exec('os.kill(os.getpid(), signal.SIGINT)')\n"
        "    except KeyboardInterrupt: return 130\n"
        "excitant.cli.main = main\n"
        "excitant.__main__.run()\n"
    )
    assert ran_amid(code, tmp_path).returncode == 130


def test_a_command_under_nohup_outlives_its_terminal(tmp_path: Path) -> None:
    imports = "import os, signal, excitant.cli, excitant.__main__ as command"
    deaf = "signal.signal(signal.SIGHUP, signal.SIG_IGN)"
    left = "excitant.cli.main = lambda: os.kill(os.getpid(), signal.SIGHUP)"
    assert ran_amid(f"{imports}\n{deaf}\n{left}\ncommand.run()", tmp_path).returncode == 0


@pytest.mark.slow
def test_ctrl_c_amid_a_destructor_ends_the_next_step(tmp_path: Path) -> None:
    """Python drops what a destructor raises, also the interrupt that came while it ran."""
    code = (
        "import os, signal, excitant.__main__, excitant.demo\n"
        "class Dying:\n"
        "    def __del__(self): os.kill(os.getpid(), signal.SIGINT)\n"
        "def run_demo(arm, seed, advance):\n"
        "    Dying()\n"
        "    advance(0.5, 'the next step')\n"
        "    os.abort()\n"
        "excitant.demo.run_demo = run_demo\n"
        "excitant.__main__.run()\n"
    )
    done = ran_amid(code, tmp_path, "demo", "--robot", "planar_2r")
    assert done.returncode == 130
    assert done.stderr.endswith("excitant: interrupted; nothing was written\n")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_demo_ends_amid_its_design(name: str, tmp_path: Path) -> None:
    """Its design does not go on with the best motion so far."""
    code = (
        "import os, signal, excitant.__main__, excitant.design.search\n"
        f"signal.signal(signal.{name}, signal.SIG_DFL)\n"
        "def unordered(*_):\n"
        f"    yield os.kill(os.getpid(), signal.{name})\n"
        "excitant.design.search.unordered = unordered\n"
        "excitant.__main__.run()\n"
    )
    done = ran_amid(code, tmp_path, "demo", "--robot", "planar_2r", "-o", "out")
    assert (done.returncode, done.stderr) == (130, "excitant: interrupted; nothing was written\n")
    assert [path.name for path in tmp_path.iterdir() if path.is_dir()] == []


@pytest.mark.slow
def test_workers_end_with_a_process_that_is_killed(tmp_path: Path) -> None:
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    started = psutil.Popen([*EXCITANT, *SEARCH.split()], cwd=tmp_path, **quiet)
    wait(lambda: len(started.children(recursive=True)) >= 2, "its processes")
    settle(started)
    family = started.children(recursive=True)
    started.kill()
    started.wait()
    left = psutil.wait_procs(family, 20)[1]
    for process in left:
        process.kill()
    assert not left
    assert list(tmp_path.iterdir()) == []
