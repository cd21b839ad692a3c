"""A design problem and the contestants that solve it, each in processes of its own: `main`."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pinocchio as pin
from common import PROBLEMS
from joblib.externals.loky import get_reusable_executor
from judge import States, left_columns, observation, random_states

from excitant import design
from excitant.design.options import Search
from excitant.exceptions import BadInput, BadRobot
from excitant.processes import owned
from excitant.robots import Robot, builtin_robots, load_limits, load_robot

HERE = Path(__file__).resolve().parent
_FIGAROH_TIMEOUT, _ITERATIONS = 1800.0, 100  # s; of IPOPT per segment, as in its example
_ATTEMPTS = 3  # initial guesses of FIGAROH per segment
_PER_HARMONIC = 16  # samples by which random search judges
_LIMITS = ("position", "velocity", "acceleration", "torque")


@dataclass(frozen=True, eq=False)
class Problem:
    """A design problem, inertial columns, rigid bodies only."""

    name: str  # of its file
    robot: Robot  # the arm with the problem's limits and without effects
    duration: float  # of the motion [s]
    harmonics: int  # of the Fourier contestants
    rate_hz: float  # at which motions are judged [Hz]
    folder: Path  # where ``robot.urdf`` and ``problem.json`` are written for the contestants

    @property
    def urdf(self) -> Path:
        """The arm as a file."""
        return self.folder / "robot.urdf"

    @property
    def limits(self) -> dict[str, Any]:
        """Limits in SI units, as lists; without those that there are not."""
        named = {name: getattr(self.robot.limits, name) for name in _LIMITS}
        return {name: value.tolist() for name, value in named.items() if np.isfinite(value).all()}

    def write(self) -> None:
        """Write the files that contestants and judges read."""
        self.folder.mkdir(parents=True, exist_ok=True)
        self.urdf.write_text(self.robot.urdf, encoding="utf-8")
        content = {"model": self.urdf.name, "duration": self.duration, "harmonics": self.harmonics}
        content |= {"limits": self.limits, "evaluate_hz": self.rate_hz}
        _write_json(self.folder / "problem.json", content)


def _write_json(path: Path, content: dict[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def problem_file(name: str) -> Path:
    """File of a problem given by path, or by name among the shared ones and our own."""
    folders = (PROBLEMS, HERE / "problems")
    for file in (Path(name), *(folder / f"{Path(name).stem}.json" for folder in folders)):
        if file.is_file():
            return file
    known = sorted(path.stem for folder in folders for path in folder.glob("*.json"))
    missing = "" if PROBLEMS.is_dir() else f"; no shared problems in {PROBLEMS}"
    raise BadInput(
        f"problem '{name}' is no file and none of {', '.join(known)}{missing}; give a file or set "
        "EXCITANT_PROBLEMS"
    )


def load_problem(
    path: Path, folder: Path | None = None, robot: str | None = None, harmonics: int | None = None
) -> Problem:
    """Problem of a JSON file, perhaps with another arm or another number of harmonics."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        model, duration = str(content["model"]), float(content["duration"])
        given = content.get("harmonics") or duration * content["max_frequency_hz"]
        harmonics = harmonics or int(given + 1e-9)
        rate_hz = float(content.get("evaluate_hz", 100.0))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BadInput(f"problem {path}: {type(error).__name__} {error}") from None
    if model not in builtin_robots():
        model = str(path.parent / model)
    arm = load_robot(robot or model).with_effects(())
    arm = arm.with_limits(load_limits(path, arm)) if "limits" in content else arm
    if arm.locked:
        raise BadRobot(arm.source, "has locked joints; give a URDF without them")
    problem = Problem(path.stem, arm, duration, harmonics, rate_hz, folder or path.parent)
    unlimited = {"position", "velocity", "torque"} - problem.limits.keys()
    if unlimited:
        raise BadInput(f"problem {path}: joints without limits on {', '.join(sorted(unlimited))}")
    return problem


@dataclass(frozen=True)
class Settings:
    """What is common to the contestants; see the options of ``design.py``."""

    deadline: float  # `time.time` at which to stop [s]
    jobs: int
    seed: int
    harmonics: int


Found = tuple[float, Any, int]  # condition number, trajectory, number of starts or draws


def excitant(
    problem: Problem, settings: Settings, *, criterion: str = "condition",
    searched: bool = False,
) -> Found:  # fmt: skip
    """Our own design, perhaps with a search for the number of harmonics or pieces."""
    left = max(settings.deadline - time.time(), 0.1)
    effort: Any = {"jobs": settings.jobs, "seed": settings.seed, "time_limit": left, "use": 1.0}
    found = design.design_trajectory(
        problem.robot,
        duration=problem.duration,
        harmonics="search" if searched else problem.harmonics,
        scene=(),
        criterion=criterion,
        columns="inertial",
        **effort,
    )
    return found.condition_final, found.trajectory, len(found.starts)


def random_search(problem: Problem, settings: Settings) -> Found:
    """The best of random series, drawn in each process until the deadline."""
    task, file = joblib.delayed(owned(_drawn)), problem.folder / "problem.json"
    drawn = joblib.Parallel(settings.jobs)(task(file, settings, k) for k in range(settings.jobs))
    condition, trajectory, _ = min(drawn, key=lambda best: best[0])
    return condition, trajectory, sum(runs for _, _, runs in drawn)


def _drawn(file: Path, settings: Settings, job: int) -> Found:
    """The best of one process, which reads the problem anew: models are not sent."""
    problem = load_problem(file, harmonics=settings.harmonics)
    model, rng = pin.buildModelFromUrdf(str(problem.urdf)), np.random.default_rng(0)
    columns = left_columns(observation(model, random_states(problem.limits, rng)))
    rng = np.random.default_rng([settings.seed, job])
    least, best, runs = np.inf, None, 0
    most = max(1, int(Search.max_frequency * problem.duration / problem.harmonics))
    while not runs or time.time() < settings.deadline:
        periods = int(rng.integers(1, most, endpoint=True))
        period = problem.duration / periods
        series = design.random_trajectory(problem.robot, rng, period, problem.harmonics)
        motion = series.sample(_PER_HARMONIC * problem.harmonics + 1)
        states = States(motion.q[:-1], motion.dq[:-1], motion.ddq[:-1])
        reached = float(np.linalg.cond(observation(model, states)[:, columns]))
        if reached < least:
            least, best = reached, design.Trajectory(series.coefficients, period, periods)
        runs += 1
    return least, best, runs


CONTESTANTS: dict[str, Callable[[Problem, Settings], Found]] = {
    "excitant": excitant,
    "a-optimal": partial(excitant, criterion="a"),
    "searched": partial(excitant, searched=True),
    "random": random_search,
}


def answer(words: Sequence[object], stem: Path) -> tuple[tuple[Path, ...], dict[str, Any]]:
    """The table that a process wrote, if any, and the JSON object it said, or ``error``."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    options = {"capture_output": True, "text": True, "env": environment}
    for suffix in (".csv", ".json"):
        stem.with_suffix(suffix).unlink(missing_ok=True)
    try:
        done = subprocess.run(list(map(str, words)), timeout=_FIGAROH_TIMEOUT, **options)
        said = dict(json.loads(done.stdout.strip().splitlines()[-1]))
    except (OSError, subprocess.TimeoutExpired) as error:
        said = {"error": str(error)}
    except (ValueError, IndexError):
        lines = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
        said = {"error": lines[-1]}
    return tuple(filter(Path.exists, (stem.with_suffix(".csv"),))), said


def run_contestant(
    problem: Problem, method: str, settings: Settings
) -> tuple[tuple[Path, ...], str]:
    stem = problem.folder / f"{method}-{settings.harmonics}"
    file, text = problem.folder / "problem.json", json.dumps(asdict(settings))
    script = Path(__file__).resolve()
    files, said = answer([sys.executable, script, method, file, text, stem], stem)
    return files, said["error"] if "error" in said else f"{said['runs']} starts"


def run_figaroh(
    problem: Problem, python: Path, moves: int, segments: int, seed: int
) -> tuple[tuple[Path, ...], str]:
    stem = problem.folder / f"figaroh-{moves}-{seed}"
    specification = {
        "urdf": str(problem.urdf.resolve()),
        "limits": problem.limits,
        "segment_s": problem.duration / segments,
        "segments": segments,  # stacked in the regressor of the next one
        "moves": moves,  # from rest to rest per segment
        "rate_hz": problem.rate_hz,  # of the trajectory written
        "frequency_hz": 20,  # lowest rate of regressor and constraints inside the optimiser
        "iterations": _ITERATIONS,  # of IPOPT per segment, at most
        "attempts": _ATTEMPTS,
        "seed": seed,  # of NumPy's global generator, which FIGAROH draws from
        "csv": str(stem.with_suffix(".csv").resolve()),
    }
    file = stem.with_suffix(".specification.json")
    _write_json(file, specification)
    files, said = answer([python, HERE / "figaroh_driver.py", file], stem)
    if "error" in said:
        return files, f"seed {seed} failed: {said['error']}"
    converged = sum(said.get("converged", []))
    return files, f"seed {seed}: {said['solved']} of {segments} segments, {converged} converged"


def main() -> int:
    """Run one contestant: NAME PROBLEM.json SETTINGS (a JSON object) STEM; print its ``runs``."""
    name, file, text, stem = sys.argv[1:5]
    settings = Settings(**json.loads(text))
    problem = load_problem(Path(file), harmonics=settings.harmonics)
    _, trajectory, runs = CONTESTANTS[name](problem, settings)
    get_reusable_executor().shutdown(wait=True)
    exact = design.trajectory_json(trajectory, problem.robot)
    Path(f"{stem}.json").write_text(exact, encoding="utf-8")
    table = design.trajectory_csv(trajectory, problem.rate_hz)
    Path(f"{stem}.csv").write_text(table, encoding="utf-8")
    print(json.dumps({"runs": runs}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
