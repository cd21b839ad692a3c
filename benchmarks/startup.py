"""Time and peak memory of each command as a process; see README.md.

Imports nothing but the standard library: a child's peak memory is no less than its parent's.
"""

import argparse
import os
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
    "robots panda": "robots panda",
    "analyze panda": "analyze panda -o analyzed",
    "design planar_2r": "design planar_2r --starts 1 --jobs 1 --duration 8 --harmonics 3 -o motion",
    "check planar_2r": "check planar_2r motion/trajectory.csv",
    "simulate planar_2r": "simulate planar_2r motion/trajectory.csv -o run.csv",
    "identify planar_2r": "identify planar_2r run.csv --force -o model",
    f"identify {RECORDED.name} set": f"identify {shlex.quote(str(RECORDED))} -o recorded",
    "identify 60 s at 1 kHz": "identify panda log.parquet --force -o logged",
    f"go {RECORDED.name} set": f"go {shlex.quote(str(RECORDED))} -o gone",
    "diagnose planar_2r": "diagnose planar_2r run.csv --no-experiments -o diagnosis",
    "diagnose 60 s at 1 kHz": "diagnose panda log.parquet --no-experiments -o diagnosed",
    "report": "report model",
}
UNIT = "import numpy, scipy.linalg, pinocchio"
MOST = {"analyze panda": 3.0, f"identify {RECORDED.name} set": 8.0, f"go {RECORDED.name} set": 30.0}
"""Ratio of a command's processor time, children included, to that of `UNIT`."""
LOG = "import sys, pathlib, streaming; streaming.write(pathlib.Path(sys.argv[1]), 'panda', 60_000)"


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


def least(words: list[str], folder: Path, repeats: int) -> Took:
    """What the quickest of some repeats took."""
    return min((run(words, folder) for _ in range(repeats)), key=lambda took: took.wall)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=3, help="of which the least counts")
    parser.add_argument("--only", default="", help="commands with this in their name")
    args = parser.parse_args()
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # byte code is there after `make`
    python = [sys.executable, "-c"]
    print(f"{'command':24s}  wall s   CPU s   ratio  peak MB")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        log = [*python, LOG, str(folder / "log.parquet")]
        subprocess.run(log, cwd=Path(__file__).parent, check=True)
        unit = least([*python, UNIT], folder, args.repeats).cpu
        for command in [command for command in COMMANDS if args.only in command]:
            words = [sys.executable, "-m", "excitant", *shlex.split(COMMANDS[command])]
            if command.endswith(" set") and not RECORDED.is_dir():
                print(f"{command:24s} {RECORDED} is not there; set EXCITANT_DATA")
                continue
            took = least(words, folder, args.repeats)
            ratio = took.cpu / unit
            cells = f"{took.wall:7.2f} {took.cpu:7.2f} {ratio:7.1f} {took.memory:8.0f}"
            wanted = f"  wanted: at most {MOST[command]:g}" if command in MOST else ""
            exceeded = " EXCEEDED" if ratio > MOST.get(command, ratio) else ""
            print(f"{command:24s} {cells}{wanted}{exceeded}", flush=True)


if __name__ == "__main__":
    main()
