"""What several benchmarks share: recordings, seeds, command lines, cases on all processes."""

import json
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any

import joblib
import numpy as np
from cyclopts import App, Parameter
from threadpoolctl import threadpool_limits

from excitant.processes import owned

_BESIDE = Path(__file__).resolve().parents[2] / "shared"
DATA = Path(os.environ.get("EXCITANT_DATA", _BESIDE / "data"))  # recordings of real arms
PROBLEMS = Path(os.environ.get("EXCITANT_PROBLEMS", _BESIDE / "problems"))  # of design

Output = Annotated[
    Path | None,
    Parameter(alias="-o", help="File to which every answer is appended as a line of JSON."),
]


def run(main: Callable[..., Any]) -> None:
    """Call a function with the words of the command line, linear algebra on one thread."""
    app = App(
        help=sys.modules["__main__"].__doc__,
        help_format="plaintext",
        default_parameter=Parameter(consume_multiple=True),
        result_action="return_value",
    )
    app.default(main)
    with threadpool_limits(1):
        sys.exit(app())


def printed_seed(seed: int | None) -> int:
    """A seed as given, else a new one; printed, so that a run can be repeated."""
    if seed is None:
        seed = int(np.random.SeedSequence().generate_state(1)[0])
    print(f"seed {seed}", flush=True)
    return seed


def answers(
    case: Callable[..., dict[str, Any]],
    inputs: Iterable[Sequence[Any]],
    jobs: int,
    output: Path | None,
) -> list[dict[str, Any]]:
    """What a function answers to each of its inputs, each appended to a file as a line of JSON."""
    results: list[dict[str, Any]] = []
    work = joblib.Parallel(jobs, return_as="generator_unordered")
    for result in work(joblib.delayed(owned(case))(*words) for words in inputs):
        note(result, results, output)
    return results


def note(result: dict[str, Any], results: list[dict[str, Any]], output: Path | None) -> None:
    """Append a result to the others and to a file, and count them on a terminal."""
    results.append(result)
    if output:
        with output.open("a", encoding="utf-8") as lines:
            lines.write(json.dumps(result) + "\n")
    if sys.stderr.isatty():
        print(f"\r{len(results)} done", end="", file=sys.stderr, flush=True)


def wilson(hits: Sequence[Any], digits: int = 0) -> str:
    """A share with its 95 % interval, in per cent."""
    if not (n := len(hits)):
        return "-"
    p = float(np.mean([bool(hit) for hit in hits]))
    z = 1.96
    middle = p + z**2 / (2 * n)
    half = z * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    low, high = (100 * (middle + s * half) / (1 + z**2 / n) for s in (-1, 1))
    return f"{100 * p:3.{digits}f} ({abs(low):.{digits}f}-{high:.{digits}f})"
