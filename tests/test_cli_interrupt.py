"""Ctrl-C on real processes: a design keeps what it has, others say that nothing was written."""

from __future__ import annotations

import json
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from excitant.design import from_coefficients, trajectory_json
from excitant.robots import load_robot

pytestmark = pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="looks into /proc")

PATIENCE = 240.0  # s: machines may be slow, a process that hangs is not


def members(session: int) -> list[int]:
    """Living processes of a session."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = entry.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[3]) == session and fields[0] != "Z":
            found.append(int(entry.parent.name))
    return found


def wait(until: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + PATIENCE
    while not until():
        assert time.monotonic() < deadline, f"waited in vain: {what}"
        time.sleep(0.05)


def settle(loaded: Path) -> None:
    """Wait until imports are over: no library has been loaded for a while."""
    known, since = set[str](), time.monotonic()
    while time.monotonic() - since < 1.5:
        libraries = {line.split()[-1] for line in loaded.read_text().splitlines() if ".so" in line}
        if libraries - known:
            known, since = libraries, time.monotonic()
        time.sleep(0.1)


def _heed() -> None:
    """Shells start what runs in the background deaf to Ctrl-C; not so here."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def interrupted(words: list[str], folder: Path, processes: int, group: bool) -> tuple[int, str]:
    """Exit status and error stream of a command that was interrupted amid its work."""
    started = subprocess.Popen(
        [sys.executable, "-m", "excitant", *words], cwd=folder, start_new_session=True, text=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, preexec_fn=_heed,
    )  # fmt: skip
    loaded = Path(f"/proc/{started.pid}/maps")
    try:
        wait(lambda: "pinocchio" in loaded.read_text(), "the command at work")
        wait(lambda: len(members(started.pid)) >= processes, "its processes")
        settle(loaded)
        assert started.poll() is None
        os.killpg(started.pid, signal.SIGINT) if group else started.send_signal(signal.SIGINT)
        _, err = started.communicate(timeout=PATIENCE)
        wait(lambda: not members(started.pid), "the end of its processes")
    finally:
        for process in members(started.pid):
            os.kill(process, signal.SIGKILL)
    return started.returncode, err


@pytest.mark.parametrize("group", [True, False], ids=["at the terminal", "the process alone"])
def test_a_design_writes_the_best_so_far(group: bool, tmp_path: Path) -> None:
    words = shlex.split("design planar_2r --harmonics 3 --time-limit 1000 --jobs 2 -o out")
    status, err = interrupted(words, tmp_path, 3, group)
    assert (status, err) == (0, "")
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written >= {"result.json", "report.html", "trajectory.csv", "trajectory.json"}
    starts = json.loads((tmp_path / "out" / "result.json").read_text("utf-8"))["starts"]
    assert "interrupted" in {start["status"] for start in starts} or not starts


def test_others_say_that_nothing_was_written(tmp_path: Path) -> None:
    robot, rng = load_robot("ur10"), np.random.default_rng(0)
    coefficients = np.zeros((5, robot.nv))
    coefficients[0], coefficients[3], coefficients[4] = rng.uniform(-1, 1, (3, robot.nv))
    coefficients[3] = -2 * coefficients[4]  # at rest at both ends
    motion = from_coefficients(coefficients, 2000.0)
    (tmp_path / "slow.json").write_text(trajectory_json(motion, robot), encoding="utf-8")
    before = sorted(tmp_path.rglob("*"))
    status, err = interrupted(
        ["simulate", "ur10", "slow.json", "-o", "run.csv"], tmp_path, 1, group=True
    )
    assert (status, err) == (1, "excitant: interrupted; nothing was written\n")
    assert sorted(tmp_path.rglob("*")) == before
