"""Contestants as processes, with the time that they and their children take."""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from contestants import Settings
from figaroh_specification import Specification
from problem import Problem

HERE = Path(__file__).resolve().parent
_FIGAROH_TIMEOUT = 1800.0  # s
_ATTEMPTS = 3  # initial guesses per segment


@dataclass(frozen=True)
class Run:
    """One contestant's work.

    Attributes:
        method: ``"excitant"``, ``"a-optimal"`` and ``"spline"`` (ours too), ``"random"``,
            ``"l-bfgs"`` or ``"figaroh"``.
        setting: Harmonics ``H=5``, or segments and moves ``2x5``, or ``search``.
        files: Tables of motions, of which the best counts; with coefficients beside where the
            motion is a Fourier series.
        wall_s: Time by the clock, from the start of the processes to their end [s].
        cpu_s: Processor time of all processes together [s].
        note: What the contestant said.
    """

    method: str
    setting: str
    files: tuple[Path, ...]
    wall_s: float
    cpu_s: float
    note: str


def fourier_run(problem: Problem, given: argparse.Namespace, method: str, harmonics: int) -> Run:
    """A Fourier contestant of ``contestants.py``."""
    stem = problem.folder / f"{method}-{harmonics}"
    clear(stem)
    clock = Clock()
    settings = Settings(time.time(), given.time_limit, given.jobs, given.seed, harmonics)
    words = [method, str(problem.file), json.dumps(asdict(settings)), str(stem)]
    said = answer([sys.executable, str(HERE / "contestants.py"), *words])
    files = (stem.with_suffix(".csv"),) if stem.with_suffix(".csv").exists() else ()
    note = said["error"] if "error" in said else f"{said['runs']} starts"
    setting = "search" if method == "spline" else f"H={harmonics}"
    return Run(method, setting, files, *clock.read(), note)


def run_figaroh(problem: Problem, given: argparse.Namespace, moves: int) -> Run:
    """FIGAROH from several seeds, as many at a time as there are processes."""
    segments = given.figaroh_segments
    setting = f"{segments}x{moves}"
    python = given.figaroh_python or Path(sys.executable)
    if given.figaroh_python is None and importlib.util.find_spec("figaroh") is None:
        return Run("figaroh", setting, (), 0.0, 0.0, "not installed; give --figaroh-python")
    clock = Clock()
    work = partial(figaroh_seed, problem, given, moves, python)
    with ThreadPoolExecutor(given.jobs) as pool:
        tries = list(pool.map(work, range(given.seed, given.seed + given.figaroh_seeds)))
    notes = "; ".join(note for _, note in tries)
    files = tuple(file for file, _ in tries if file.exists())
    return Run("figaroh", setting, files, *clock.read(), notes)


def figaroh_seed(
    problem: Problem, given: argparse.Namespace, moves: int, python: Path, seed: int
) -> tuple[Path, str]:
    """One run of FIGAROH: the file it should have written, and what it said."""
    stem = problem.folder / f"figaroh-{moves}-{seed}"
    clear(stem)
    specification = Specification(
        urdf=str(problem.urdf.resolve()),
        limits=problem.limits,
        segment_s=problem.duration / given.figaroh_segments,
        segments=given.figaroh_segments,
        moves=moves,
        rate_hz=problem.rate_hz,
        frequency_hz=20,
        iterations=given.figaroh_iterations,
        attempts=_ATTEMPTS,
        seed=seed,
        csv=str(stem.with_suffix(".csv").resolve()),
    )
    file = stem.with_suffix(".json")
    file.write_text(json.dumps(asdict(specification), indent=1), encoding="utf-8")
    said = answer([str(python), str(HERE / "figaroh_driver.py"), str(file)])
    file.rename(stem.with_suffix(".specification.json"))
    if "error" in said:
        return stem.with_suffix(".csv"), f"seed {seed} failed: {said['error']}"
    solved = f"{said['solved']} of {given.figaroh_segments} segments"
    converged = f"{sum(said.get('converged', []))} converged"
    return stem.with_suffix(".csv"), f"seed {seed}: {solved}, {converged}"


def clear(stem: Path) -> None:
    """Forget the motion of an earlier run."""
    for suffix in (".csv", ".json"):
        stem.with_suffix(suffix).unlink(missing_ok=True)


def answer(words: Sequence[str]) -> dict[str, Any]:
    """The JSON object on the last line that a process prints, or ``error``."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            words,
            capture_output=True,
            text=True,
            env=environment,
            timeout=_FIGAROH_TIMEOUT,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return {"error": str(error)}
    try:
        content = json.loads(done.stdout.strip().splitlines()[-1])
    except (ValueError, IndexError):
        lines = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
        return {"error": lines[-1]}
    return dict(content)


class Clock:
    """Time by the clock and processor time of ended child processes, since it was made."""

    def __init__(self) -> None:
        self.wall, self.cpu = time.perf_counter(), _children()

    def read(self) -> tuple[float, float]:
        """Both times [s]."""
        return time.perf_counter() - self.wall, _children() - self.cpu


def _children() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime
