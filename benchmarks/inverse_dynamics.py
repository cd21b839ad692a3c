"""Time per call of published inverse dynamics: Python module, C function, Pinocchio's rnea.

    OMP_NUM_THREADS=1 python benchmarks/inverse_dynamics.py [--robot ur10 panda] [--calls 20000]

The written code carries all effects of the robot; rnea only the rigid bodies. C is timed inside C
(a loop around the call), and called from Python as rnea is; ``batch`` is the Python module on
many states at once. Processor time; the best of five runs counts.
"""

from __future__ import annotations

import argparse
import ctypes
import importlib.util
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from excitant.identify.export import model_files
from excitant.robots import Motion, Robot, builtin_robots, load_robot, torque
from excitant.robots.effects import standard_effects

_RUNS = 5
_STATES = 500
_LOOP = """
#include "arm.h"
void repeated(long calls, long states, const double *q, const double *dq, const double *ddq,
    double *tau)
{{
    for (long k = 0; k < calls; k++) {{
        const long i = (k % states)*{n};
        {function}(q + i, dq + i, ddq + i, tau + i);
    }}
}}
"""


def arguments(words: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robot", nargs="+", default=builtin_robots())
    parser.add_argument("--calls", type=int, default=20000)
    return parser.parse_args(words)


def best(run: Callable[[], object], calls: int) -> float:
    """Time per call in the best of the runs [µs]."""
    times = []
    for _ in range(_RUNS):
        start = time.process_time()
        run()
        times.append(time.process_time() - start)
    return 1e6 * min(times) / calls


def with_effects(robot: Robot) -> Robot:
    """The robot with a value for friction, offset and rotor inertia of each joint."""
    effects = standard_effects(robot.joints)
    return robot.with_effects([e.with_values(np.ones(len(e.parameters(robot)))) for e in effects])


def compiled(folder: Path, robot: Robot) -> tuple[Any, Any] | None:
    """The C function and a loop around it; None without a compiler."""
    compiler = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    if compiler is None:
        return None
    header = (folder / "arm.h").read_text(encoding="utf-8")
    function = next(w.split("(")[0] for w in header.split() if "_inverse_dynamics(" in w)
    (folder / "loop.c").write_text(_LOOP.format(function=function, n=robot.nv), encoding="utf-8")
    files = [folder / "arm.c", folder / "loop.c"]
    flags = ["-std=c99", "-O2", "-shared", "-fPIC"]
    subprocess.run([compiler, *flags, *files, "-o", folder / "arm.so", "-lm"], check=True)
    library = ctypes.CDLL(str(folder / "arm.so"))
    return getattr(library, function), library.repeated


def module(folder: Path) -> Any:
    """The Python module, imported from its file."""
    spec = importlib.util.spec_from_file_location("arm", folder / "arm.py")
    if spec is None or spec.loader is None:
        raise ImportError(folder / "arm.py")
    arm = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(arm)
    return arm


def pointer(values: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(values.ctypes.data)


def python_times(folder: Path, motion: Motion, rounds: int) -> tuple[list[float], np.ndarray]:
    """Times of the module, single calls and batch [µs], and its torque."""
    arm, count = module(folder), rounds * len(motion)
    triples = list(zip(motion.q, motion.dq, motion.ddq, strict=True)) * rounds
    single = best(lambda: [arm.inverse_dynamics(*x) for x in triples], count)
    tau = arm.inverse_dynamics(motion.q, motion.dq, motion.ddq)
    batch = best(
        lambda: [arm.inverse_dynamics(motion.q, motion.dq, motion.ddq) for _ in range(rounds)],
        count,
    )
    return [single, batch], tau


def c_times(
    folder: Path, robot: Robot, motion: Motion, rounds: int
) -> tuple[list[float], np.ndarray | None]:
    """Times of the C function, called in C and through ctypes [µs], and its torque."""
    native = compiled(folder, robot)
    if native is None:
        return [np.nan, np.nan], None
    call, repeated = native
    states = [np.ascontiguousarray(x) for x in (motion.q, motion.dq, motion.ddq)]
    tau = np.zeros_like(states[0])
    held = [pointer(x) for x in (*states, tau)]
    count = 20 * rounds * len(motion)
    inside = best(lambda: repeated(ctypes.c_long(count), ctypes.c_long(len(motion)), *held), count)
    outside = best(lambda: [call(*held) for _ in range(rounds * len(motion))], count // 20)
    return [inside, outside], tau


def row(robot: Robot, calls: int) -> str:
    states = robot.random_motion(np.random.default_rng(0), _STATES)
    motion = Motion(np.arange(float(_STATES)), *states)
    expected, rounds = torque(robot, motion), max(1, calls // _STATES)
    model, data = robot.model, robot.model.createData()
    triples = list(zip(motion.q, motion.dq, motion.ddq, strict=True)) * rounds
    rnea = best(lambda: [pin.rnea(model, data, *x) for x in triples], len(triples))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, text in model_files(robot, "arm", "arm.yaml", ["python", "c"]).items():
            (folder / file).write_text(text, encoding="utf-8")
        python, found = python_times(folder, motion, rounds)
        native, other = c_times(folder, robot, motion, rounds)
    results = [x for x in (found, other) if x is not None]
    error = max(np.abs(x - expected).max() for x in results) / np.abs(expected).max()
    cells = "".join(f"{x:12.3f}" for x in (rnea, *python, *native))
    return f"{robot.name:<16}{robot.nv:>3}{cells}{error:12.1e}"


def main(words: Sequence[str] | None = None) -> None:
    args = arguments(words)
    heads = ("rnea", "Python", "batch", "C", "C by ctypes", "error")
    print(f"{'[µs per call]':<16}{'nv':>3}" + "".join(f"{head:>12}" for head in heads))
    for name in args.robot:
        print(row(with_effects(load_robot(name)), args.calls))


if __name__ == "__main__":
    main()
