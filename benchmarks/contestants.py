"""The contestants that make Fourier series, each in a process of its own.

Called as ``python contestants.py NAME PROBLEM.json SETTINGS STEM``, SETTINGS being a JSON object
of `Settings`; writes ``STEM.json`` and ``STEM.csv``, and prints a JSON object with ``runs``, the
number of starts or draws.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pinocchio as pin
from gradient import Descent, descend
from joblib.externals.loky import get_reusable_executor
from judge import Array
from problem import Problem, load_problem

from excitant.design import (
    FourierTrajectory,
    check,
    design,
    random_trajectory,
    trajectory_csv,
    trajectory_json,
)

_SHRINKS = 60


@dataclass(frozen=True)
class Settings:
    """What is common to the contestants.

    Attributes:
        began: `time.time` at which the clock was started [s].
        time_limit: Time from then on [s].
        jobs: Number of processes.
        seed: Seed of all randomness.
        harmonics: Number of harmonics.
    """

    began: float
    time_limit: float
    jobs: int
    seed: int
    harmonics: int

    @property
    def deadline(self) -> float:
        """`time.time` at which to stop [s]."""
        return self.began + self.time_limit


Found = tuple[float, Any, int]
"""Condition number, the trajectory (None if there is none), and the number of starts or draws."""


def excitant(
    problem: Problem,
    settings: Settings,
    *,
    series: str = "fourier",
    criterion: str = "condition",
    search: bool = False,
) -> Found:
    """Our own design; with a search for the number of harmonics if wanted."""
    found = design(
        problem.robot,
        duration=problem.duration,
        harmonics=None if search else problem.harmonics,
        series=series,
        criterion=criterion,
        columns="inertial",
        jobs=settings.jobs,
        seed=settings.seed,
        time_limit=max(settings.deadline - time.time(), 0.1),
    )
    return found.condition_final, found.trajectory, len(found.starts)


def random_search(problem: Problem, settings: Settings, job: int) -> Found:
    """The best of random Fourier series within the limits."""
    rng = np.random.default_rng([settings.seed, job])
    best, draws = _Best(_descent(problem)), 0
    while not draws or time.time() < settings.deadline:
        best.offer(random_trajectory(problem.robot, rng, problem.duration, problem.harmonics))
        draws += 1
    return best.condition, best.trajectory, draws


def gradient_search(problem: Problem, settings: Settings, job: int) -> Found:
    """The best of many descents by L-BFGS, shrunk into the limits."""
    rng = np.random.default_rng([settings.seed, job])
    descent, starts = _descent(problem), 0
    best = _Best(descent)
    while not starts or time.time() < settings.deadline:
        start = random_trajectory(problem.robot, rng, problem.duration, problem.harmonics)
        X = descend(descent, start.coefficients, settings.deadline)
        kept = shrunk(problem, X)
        best.offer(start if kept is None else kept)
        starts += 1
    return best.condition, best.trajectory, starts


def shrunk(problem: Problem, coefficients: Array) -> FourierTrajectory | None:
    """The series shrunk towards its offset until it keeps the limits; None if that fails."""
    amplitude = np.ones((len(coefficients), 1))
    for _ in range(_SHRINKS):
        X, H = amplitude * coefficients, len(coefficients) // 2
        trajectory = FourierTrajectory(X[0], X[1 : 1 + H], X[1 + H :], problem.duration)
        excess = check(problem.robot, trajectory).worst.ratio - 1
        if excess <= 0:
            return trajectory
        amplitude[1:] *= 1 - min(1.05 * excess + 1e-7, 0.5)
    return None


class _Best:
    """The best of the trajectories offered."""

    def __init__(self, descent: Descent) -> None:
        self.descent = descent
        self.condition: float = np.inf
        self.trajectory: FourierTrajectory | None = None

    def offer(self, trajectory: FourierTrajectory) -> None:
        condition = self.descent.condition(trajectory.coefficients)
        if condition < self.condition:
            self.condition, self.trajectory = condition, trajectory


def _descent(problem: Problem) -> Descent:
    model = pin.buildModelFromUrdf(str(problem.urdf))
    return Descent(model, problem.limits, problem.harmonics, problem.duration)


def _parallel(search: Callable[[Problem, Settings, int], Found]) -> Callable[..., Found]:
    """The best of one search per process."""
    return partial(_searched, search)


def _searched(
    search: Callable[[Problem, Settings, int], Found], problem: Problem, settings: Settings
) -> Found:
    work = joblib.Parallel(settings.jobs)
    file = problem.file
    found = work(joblib.delayed(_loaded)(search, file, settings, k) for k in range(settings.jobs))
    condition, trajectory, _ = min(found, key=lambda f: f[0])
    return condition, trajectory, sum(runs for _, _, runs in found)


def _loaded(
    search: Callable[[Problem, Settings, int], Found], file: Path, settings: Settings, job: int
) -> Found:
    """A search in another process, which reads the problem anew: models are not sent."""
    return search(load_problem(file, harmonics=settings.harmonics), settings, job)


CONTESTANTS: dict[str, Callable[[Problem, Settings], Found]] = {
    "excitant": excitant,
    "a-optimal": partial(excitant, criterion="a"),
    "spline": partial(excitant, series="spline", search=True),
    "random": _parallel(random_search),
    "l-bfgs": _parallel(gradient_search),
}


def main() -> int:
    """Run one contestant."""
    name, file, text, stem = sys.argv[1:5]
    settings = Settings(**json.loads(text))
    problem = load_problem(Path(file), harmonics=settings.harmonics)
    _, trajectory, runs = CONTESTANTS[name](problem, settings)
    get_reusable_executor().shutdown(wait=True)
    if trajectory is None:
        print(json.dumps({"runs": runs}))
        return 3
    contents = {
        "json": trajectory_json(trajectory, problem.robot),
        "csv": trajectory_csv(trajectory, problem.rate_hz),
    }
    for suffix, content in contents.items():
        Path(f"{stem}.{suffix}").write_text(content, encoding="utf-8")
    print(json.dumps({"runs": runs}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
