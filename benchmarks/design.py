"""excitant's design beside FIGAROH, random search and L-BFGS, on one problem in one run.

Every contestant gets the same arm, limits and duration, runs in processes of its own, and is
judged by the same code, which is none of theirs: see README.md for what each column means.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import joblib
from problem import Problem, load_problem, problem_file
from runs import Run, fourier_run, run_figaroh
from table import conditioning_table, noise_table
from verdict import Verdict, external_judge, failed, judged

from excitant.exceptions import ExcitantError

METHODS = ("excitant", "a-optimal", "spline", "random", "l-bfgs", "figaroh")


def arguments(words: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("--problem", default="fixture", help="problem file, or the name of one")
    add("--robot", help="another arm under the problem's limits: built-in name or URDF")
    add("--methods", nargs="+", choices=METHODS, default=METHODS)
    add("--harmonics", type=int, nargs="+", help="the problem's by default; the first is ours")
    add("--time-limit", type=float, help="of every Fourier contestant [s] (30; quick: 5)")
    add("--jobs", type=int, default=joblib.cpu_count(), help="processes of every contestant")
    add("--seed", type=int, default=0)
    add("--figaroh-python", type=Path, help="Python that has figaroh and cyipopt installed")
    add("--figaroh-seeds", type=int, help="runs of FIGAROH, of which the best counts (2; quick: 1)")
    add("--figaroh-segments", type=int, default=2, help="as in its UR10 example")
    add("--figaroh-moves", type=int, nargs="+", help="moves per segment; as long as 2 s by default")
    add("--figaroh-iterations", type=int, help="of IPOPT per segment (100; quick: 10)")
    add("--quick", action="store_true", help="small budgets, to see that it runs")
    add("--judge", type=Path, help="evaluate.py; the one of the shared problems by default")
    add("-o", "--output", type=Path, help="folder of trajectories and result.json")
    add("--json", action="store_true", help="print result.json and nothing else")
    given = parser.parse_args(words)
    for name, usual, quick in (
        ("time_limit", 30.0, 5.0),
        ("figaroh_seeds", 2, 1),
        ("figaroh_iterations", 100, 10),
    ):
        if getattr(given, name) is None:
            setattr(given, name, quick if given.quick else usual)
    return given


def compete(problem: Problem, given: argparse.Namespace) -> list[Run]:
    """One run after the other, ours first, so that none takes time from another."""
    runs: list[Run] = []
    for method in (m for m in METHODS if m in given.methods):
        settings = given.harmonics or [problem.harmonics]
        if method == "figaroh":
            settings = figaroh_moves(problem, given)
        elif method == "spline":  # searches the number of its pieces
            settings = settings[:1]
        for setting in settings:
            runs.append(run(problem, given, method, setting))
            tell(given, f"{method} {runs[-1].setting} done after {runs[-1].wall_s:.0f} s")
    return runs


def run(problem: Problem, given: argparse.Namespace, method: str, setting: int) -> Run:
    if method == "figaroh":
        return run_figaroh(problem, given, setting)
    return fourier_run(problem, given, method, setting)


def figaroh_moves(problem: Problem, given: argparse.Namespace) -> list[int]:
    """Moves per segment: given, or of 2 s as in FIGAROH's example."""
    return given.figaroh_moves or [max(2, round(problem.duration / given.figaroh_segments / 2.0))]


def tell(given: argparse.Namespace, line: str) -> None:
    if not given.json:
        print(line, file=sys.stderr, flush=True)


def judged_runs(problem: Problem, runs: Sequence[Run], judge: Path | None) -> list[Verdict]:
    """A verdict on every run, on that of its tries which has the lowest condition number.

    Raises:
        ExcitantError: Two motions differ in duration or rate, or the judges in their figures.
    """
    verdicts = []
    for run in runs:
        tries = [judged(problem, run, file, judge) for file in run.files]
        verdicts.append(min(tries, key=lambda v: v.left) if tries else failed(run))
    samples = {verdict.samples for verdict in verdicts if verdict.samples}
    if len(samples) > 1:
        raise ExcitantError(f"motions of {sorted(samples)} samples cannot be compared")
    return verdicts


def result(problem: Problem, verdicts: Sequence[Verdict], judge: Path | None) -> dict[str, Any]:
    return {
        "problem": problem.name,
        "robot": problem.robot.name,
        "duration": problem.duration,
        "rate_hz": problem.rate_hz,
        "judge": "evaluate.py" if judge else "judge.py",
        "rows": [finite(asdict(verdict)) for verdict in verdicts],
    }


def finite(row: dict[str, Any]) -> dict[str, Any]:
    """The row with null for what there is no figure of, as JSON wants it."""
    lost = {key for key, value in row.items() if isinstance(value, float) and math.isinf(value)}
    return {key: None if key in lost else value for key, value in row.items()}


def report(problem: Problem, verdicts: Sequence[Verdict], given: argparse.Namespace) -> str:
    judge = "evaluate.py, confirmed by judge.py" if given.judge else "judge.py (no evaluate.py)"
    top = (
        f"{problem.name}: {problem.robot.name}, {problem.robot.nv} joints, {problem.duration:g} s, "
        f"judged at {problem.rate_hz:g} Hz by {judge}; {given.jobs} processes, seed {given.seed}, "
        f"time limit {given.time_limit:g} s"
    )
    return "\n".join(["", top, "", *conditioning_table(verdicts), "", *noise_table(verdicts)])


def main(words: Sequence[str] | None = None) -> int:
    given = arguments(words)
    try:
        given.judge = external_judge(given.judge)
        file = problem_file(given.problem)
        usual = Path("runs") / f"benchmark-design-{file.stem}"
        folder = given.output or usual
        first = given.harmonics[0] if given.harmonics else None
        problem = load_problem(file, folder, given.robot, first)
        problem.write()
        verdicts = judged_runs(problem, compete(problem, given), given.judge)
    except ExcitantError as error:
        print(f"benchmark: {error}", file=sys.stderr)
        return 1
    content = json.dumps(result(problem, verdicts, given.judge), indent=1) + "\n"
    (folder / "result.json").write_text(content, encoding="utf-8")
    print(content if given.json else report(problem, verdicts, given))
    return 0


if __name__ == "__main__":
    sys.exit(main())
