"""Time, time spent on imports, and peak memory of each command as a process; see README.md."""

from __future__ import annotations

import argparse
import os
import re
import shlex
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

DATA = Path(os.environ.get("EXCITANT_DATA", Path(__file__).parents[2] / "shared" / "data"))
RECORDED = DATA / "ur10"
COMMANDS = {
    "--help": "--help",
    "robots": "robots",
    "robots panda": "robots panda",
    "analyze panda": "analyze panda -o analyzed",
    "design planar_2r": "design planar_2r --starts 1 --jobs 1 --duration 8 --harmonics 3 -o motion",
    "check planar_2r": "check planar_2r motion/trajectory.csv",
    "simulate planar_2r": "simulate planar_2r motion/trajectory.csv -o run.csv",
    "identify planar_2r": "identify planar_2r run.csv --force -o model",
    f"identify {RECORDED.name} set": f"identify {shlex.quote(str(RECORDED))} -o recorded",
    "identify 60 s at 1 kHz": "identify panda log.parquet --force -o logged",
    "diagnose planar_2r": "diagnose planar_2r run.csv --no-experiments -o diagnosis",
    "report": "report model",
}
LIBRARIES = (
    "import numpy, scipy.linalg, scipy.optimize, scipy.special, scipy.fft, scipy.interpolate",
    "import scipy.ndimage, pinocchio, pandas, pyarrow.parquet, clarabel, cyclopts, msgspec, yaml",
    "import jinja2",
)  # that identify needs
LOG = """
import sys, pathlib, numpy
from streaming import write
from excitant.robots import load_robot
write(pathlib.Path(sys.argv[1]), load_robot("panda"), 60_000, numpy.random.default_rng(0))
"""  # in a process of its own: a child's peak memory is no less than its parent's


class Took(NamedTuple):
    """What a process took."""

    wall: float  # s
    cpu: float  # s
    memory: float  # MB at the peak


def run(words: list[str], folder: Path) -> Took:
    begun = time.perf_counter()
    process = subprocess.Popen(words, cwd=folder, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        sys.exit(f"failed: {' '.join(words)}")
    wall = time.perf_counter() - begun
    return Took(wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)


def imports(words: list[str], folder: Path) -> float:
    """Time spent on imports [s], on one core, where no other process imports, too."""
    line = ["taskset", "--cpu-list", str(min(os.sched_getaffinity(0))), words[0]]
    line += ["-X", "importtime", *words[1:]]
    done = subprocess.run(line, cwd=folder, capture_output=True, text=True, check=False)
    return sum(map(int, re.findall(r"^import time: +(\d+) ", done.stderr, re.MULTILINE))) / 1e6


def line(command: str, words: list[str], folder: Path, repeats: int) -> str:
    """The least that a process took, and its imports."""
    least = min((run(words, folder) for _ in range(repeats)), key=lambda took: took.wall)
    share = imports(words, folder)
    cells = f"{least.wall:7.2f} {least.cpu:7.2f} {share:10.2f} {least.memory:8.0f}"
    return f"{command:24s} {cells}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=3, help="of which the least counts")
    args = parser.parse_args()
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # byte code is there after `make`
    print(f"{'command':24s} {'wall s':>7s} {'CPU s':>7s} {'imports s':>10s} {'peak MB':>8s}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        alone = [sys.executable, "-c", "\n".join(LIBRARIES)]
        print(line("libraries of identify", alone, folder, args.repeats))
        written = [sys.executable, "-c", LOG, str(folder / "log.parquet")]
        subprocess.run(written, cwd=Path(__file__).parent, check=True)
        for command, words in COMMANDS.items():
            if command.endswith(" set") and not RECORDED.is_dir():
                print(f"{command:24s} {RECORDED} is not there; set EXCITANT_DATA")
                continue
            excitant = [sys.executable, "-m", "excitant", *shlex.split(words)]
            print(line(command, excitant, folder, args.repeats))


if __name__ == "__main__":
    main()
