"""excitant's design beside FIGAROH and random search, on one problem in one run; see README.md."""

import argparse
import importlib.util
import json
import math
import resource
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import contestants
import joblib
import numpy as np
import pandas as pd
import pinocchio as pin
from contestants import CONTESTANTS, Problem, Settings
from judge import DRAWS, ParameterError, conditioning, parameter_error, read_motion

from excitant.design import check, load_trajectory
from excitant.exceptions import ExcitantError

METHODS = (*CONTESTANTS, "figaroh")
SEARCHED = ("searched",)  # they choose how many harmonics
_REST = 1e-9
FIGAROH_SEGMENTS = 2  # as in its UR10 example
NOISE = {"equal": "1 N·m on every joint", "limit": "1% of each joint's torque limit"}


def arguments(words: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("--problem", default="fixture", help="problem file, or the name of one")
    add("--robot", help="another arm under the problem's limits: built-in name or URDF")
    add("--methods", nargs="+", choices=METHODS, default=METHODS)
    add("--harmonics", type=int, nargs="+", help="the problem's by default; the first is ours")
    add("--time-limit", type=float, default=30.0, help="of every contestant but FIGAROH [s]")
    add("--jobs", type=int, default=joblib.cpu_count(), help="processes of every contestant")
    add("--seed", type=int, default=0)
    add("--figaroh-python", type=Path, help="Python that has figaroh and cyipopt installed")
    add("--figaroh-seeds", type=int, default=2, help="runs of FIGAROH, of which the best counts")
    add("--figaroh-moves", type=int, nargs="+", help="moves per segment; as long as 2 s by default")
    add("-o", "--output", type=Path, help="folder of trajectories and result.json")
    return parser.parse_args(words)


@dataclass(frozen=True)
class Row:
    """A contestant's work and the judge's figures (README.md); infinite or empty without motion."""

    method: str  # contestant, of `METHODS`
    setting: str  # harmonics "H=5", or segments and moves "2x5", or "search"
    wall_s: float
    cpu_s: float  # of all processes together
    note: str  # what the contestant said
    left: float = np.inf
    proj: float = np.inf
    base: int = 0  # number of base parameters
    samples: int = 0  # judged
    worst: float = np.inf  # largest use of a limit
    worst_where: str = ""  # quantity and joint of it
    peak_ddq: float = np.inf  # [rad/s²]
    at_rest: bool = False
    errors: dict[str, ParameterError] | None = None  # by kind of noise

    @property
    def label(self) -> str:
        """Contestant with its setting."""
        return f"{self.method} {self.setting}"


def compete(problem: Problem, given: argparse.Namespace) -> list[Row]:
    """One contestant after the other, ours first, so that none takes time from another."""
    rows = []
    for method in (m for m in METHODS if m in given.methods):
        settings = given.harmonics or [problem.harmonics]
        if method == "figaroh":
            two_seconds = max(2, round(problem.duration / FIGAROH_SEGMENTS / 2.0))
            settings = given.figaroh_moves or [two_seconds]
        elif method in SEARCHED:
            settings = settings[:1]
        for setting in settings:
            row, files = run(problem, given, method, setting)
            tries = [judged(problem, row, file) for file in files]
            rows.append(min(tries, key=lambda tried: tried.left, default=row))
            print(f"{row.label} done after {row.wall_s:.0f} s", file=sys.stderr, flush=True)
    samples = {row.samples for row in rows if row.samples}
    if len(samples) > 1:
        raise ExcitantError(f"motions of {sorted(samples)} samples cannot be compared")
    return rows


def run(
    problem: Problem, given: argparse.Namespace, method: str, setting: int
) -> tuple[Row, tuple[Path, ...]]:
    """A contestant's row with its times, and tables of motions, of which the best counts."""
    wall, cpu = time.perf_counter(), _children()
    if method != "figaroh":
        label = "search" if method in SEARCHED else f"H={setting}"
        settings = Settings(time.time() + given.time_limit, given.jobs, given.seed, setting)
        tries = [contestants.run_contestant(problem, method, settings)]
    else:
        label, python = f"{FIGAROH_SEGMENTS}x{setting}", given.figaroh_python
        if python is None and importlib.util.find_spec("figaroh") is None:
            return Row(method, label, 0.0, 0.0, "not installed; give --figaroh-python"), ()
        common = (python or Path(sys.executable), setting, FIGAROH_SEGMENTS)
        seeds = range(given.seed, given.seed + given.figaroh_seeds)
        with ThreadPoolExecutor(given.jobs) as pool:
            tries = list(pool.map(partial(contestants.run_figaroh, problem, *common), seeds))
    times = time.perf_counter() - wall, _children() - cpu
    files = tuple(file for found, _ in tries for file in found)
    return Row(method, label, *times, "; ".join(note for _, note in tries)), files


def _children() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def judged(problem: Problem, row: Row, file: Path) -> Row:
    model = pin.buildModelFromUrdf(str(problem.urdf))
    states = read_motion(file)
    found = conditioning(model, problem.limits, states)
    exact = file.with_suffix(".json")
    motion = load_trajectory(exact if exact.exists() else file, problem.robot)
    use = check(problem.robot, motion).worst
    ends = np.abs(np.vstack([states.dq[[0, -1]], states.ddq[[0, -1]]])).max()
    torque = np.asarray(problem.limits["torque"], float)
    sigma = {"equal": np.ones_like(torque), "limit": 0.01 * torque}
    return replace(
        row,
        **found,
        samples=len(states.q),
        worst=use.ratio,
        worst_where=f"{use.quantity} {use.joint}",
        peak_ddq=float(np.abs(states.ddq).max()),
        at_rest=bool(ends <= _REST * np.abs(states.ddq).max()),
        errors={k: parameter_error(model, problem.limits, states, s) for k, s in sigma.items()},
    )


def conditioning_table(rows: Sequence[Row]) -> str:
    lines = {}
    for row in rows:
        figures = {"κ left": row.left, "κ proj": row.proj, "worst limit": row.worst}
        figures |= {"rest": "yes" if row.at_rest else "no", "ddq": row.peak_ddq}
        note = f"{row.note}; closest: {row.worst_where}" if row.samples else f"none; {row.note}"
        lines[row.label] = figures | {"wall s": row.wall_s, "CPU s": row.cpu_s, "note": note}
    return _table(lines)


def noise_table(rows: Sequence[Row], kind: str) -> str:
    """The three errors of every row under a kind of noise."""
    errors = {row.label: vars(row.errors[kind]) for row in rows if row.errors is not None}
    return _table(errors)


def _table(lines: dict[str, dict[str, Any]]) -> str:
    frame = pd.DataFrame.from_dict(lines, orient="index")
    return frame.to_string(float_format="{:.4g}".format, na_rep="")


def result(problem: Problem, rows: Sequence[Row]) -> dict[str, Any]:
    plain = [
        {k: None if isinstance(v, float) and math.isinf(v) else v for k, v in asdict(row).items()}
        for row in rows
    ]
    figures = {"duration": problem.duration, "rate_hz": problem.rate_hz, "rows": plain}
    return {"problem": problem.name, "robot": problem.robot.name, **figures}


def report(problem: Problem, rows: Sequence[Row], given: argparse.Namespace) -> str:
    top = (
        f"{problem.name}: {problem.robot.name}, {problem.robot.nv} joints, {problem.duration:g} s, "
        f"judged at {problem.rate_hz:g} Hz; {given.jobs} processes, seed {given.seed}, "
        f"time limit {given.time_limit:g} s"
    )
    errors = (
        f"Base parameters fitted to {DRAWS} draws of torque noise: rms error scaled to torque, rms "
        "error of torque on random states [N·m], std of the worst direction [SI]"
    )
    noise = (f"Noise {name}:\n{noise_table(rows, kind)}" for kind, name in NOISE.items())
    return "\n\n".join(["", top, conditioning_table(rows), errors, *noise])


def main(words: Sequence[str] | None = None) -> int:
    given = arguments(words)
    try:
        file = contestants.problem_file(given.problem)
        folder = given.output or Path("runs") / f"benchmark-design-{file.stem}"
        first = given.harmonics[0] if given.harmonics else None
        problem = contestants.load_problem(file, folder, given.robot, first)
        problem.write()
        rows = compete(problem, given)
    except ExcitantError as error:
        print(f"benchmark: {error}", file=sys.stderr)
        return 1
    content = json.dumps(result(problem, rows), indent=1) + "\n"
    (folder / "result.json").write_text(content, encoding="utf-8")
    print(report(problem, rows, given))
    return 0


if __name__ == "__main__":
    sys.exit(main())
