"""Identify a log larger than memory: peak memory, and samples per second against a bare loop.

    OMP_NUM_THREADS=1 python benchmarks/streaming.py [--samples 10000000]

A log of the built-in panda at 1 kHz, with friction, offsets, rotor inertia and noise, is written
piece by piece and identified in a process of its own, whose peak memory is read when it has ended:
reading in pieces, decimation, filtering, fitting, judging. In
the same run the same processor evaluates Pinocchio's regressor in a bare loop over samples whose
derivatives are there already: the calls alone, and with normal equations accumulated. Ratios are of
processor time (user and system; one thread), which other work on the machine disturbs least.
"""

from __future__ import annotations

import argparse
import itertools
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pyarrow as pa
import pyarrow.parquet
from threadpoolctl import threadpool_limits

from excitant.design import random_trajectory
from excitant.identify import identify_robot, read_recordings
from excitant.robots import Motion, Robot, load_robot, torque
from excitant.robots.effects import standard_effects

_RATE = 1000.0  # Hz
_PERIOD = 20.0  # s, after which the motion repeats; the noise never does
_POSITION_NOISE, _TORQUE_NOISE = 1e-5, 0.3  # rad, N·m
_LOOP = 20_000  # samples of the bare loop
_PIECE = 100_000  # samples written at once


def arguments(words: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=10_000_000)
    parser.add_argument("--robot", default="panda")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--identify", type=Path, help=argparse.SUPPRESS)
    return parser.parse_args(words)


def period(robot: Robot, rng: np.random.Generator) -> tuple[Motion, np.ndarray]:
    """One period of a random motion, and the torque of an arm with effects."""
    trajectory = random_trajectory(robot, rng, _PERIOD, 5)
    t = np.arange(round(_PERIOD * _RATE)) / _RATE
    motion = Motion(t, *(trajectory(t, order) for order in range(3)))
    effects = [
        e.with_values(rng.uniform(0.1, 1.0, len(e.parameters(robot))))
        for e in standard_effects(robot.joints)
    ]
    return motion, torque(robot.with_effects(effects), motion)


def pieces(
    motion: Motion, tau: np.ndarray, samples: int, rng: np.random.Generator
) -> Iterator[pa.Table]:
    """The log as tables, never whole."""
    for start in range(0, samples, _PIECE):
        k = np.arange(start, min(start + _PIECE, samples))
        q = motion.q[k % len(motion)]
        q = q + rng.normal(0, _POSITION_NOISE, q.shape)
        measured = tau[k % len(motion)] + rng.normal(0, _TORQUE_NOISE, q.shape)
        columns = {"t": k / _RATE}
        columns |= {f"q{j + 1}": q[:, j] for j in range(motion.nv)}
        columns |= {f"tau{j + 1}": measured[:, j] for j in range(motion.nv)}
        yield pa.table(columns)


def bare_loop(robot: Robot, motion: Motion, tau: np.ndarray) -> tuple[float, float]:
    """Samples per second of the regressor alone, and with normal equations."""
    model, data = robot.model, robot.model.createData()
    states = list(zip(motion.q, motion.dq, motion.ddq, tau, strict=True))[:_LOOP]
    compute = pin.computeJointTorqueRegressor
    start = time.process_time()
    for q, dq, ddq, _ in states:
        compute(model, data, q, dq, ddq)
    alone = len(states) / (time.process_time() - start)
    G, g = np.zeros((10 * robot.nv, 10 * robot.nv)), np.zeros(10 * robot.nv)
    start = time.process_time()
    for q, dq, ddq, measured in states:
        Y = compute(model, data, q, dq, ddq)
        G += Y.T @ Y
        g += Y.T @ measured
    return alone, len(states) / (time.process_time() - start)


def identified(name: str, path: Path) -> dict[str, Any]:
    """What the child process does and prints."""
    robot = load_robot(name)
    with threadpool_limits(1):
        clock, start = time.perf_counter(), time.process_time()
        estimate = identify_robot(robot, read_recordings([path], robot))
        seconds, clock = time.process_time() - start, time.perf_counter() - clock
    status = Path("/proc/self/status")
    peak = [x.split()[1] for x in status.read_text().splitlines() if "VmHWM" in x]
    return {
        "seconds": seconds,
        "clock": clock,
        "peak_MB": int(peak[0]) / 1024,
        "nrmse": estimate.validate.nrmse.tolist(),
        "rms": estimate.validate.rms.tolist(),
    }


def main(words: Sequence[str] | None = None) -> None:
    args = arguments(words)
    if args.identify:
        print(json.dumps(identified(args.robot, args.identify)))
        return
    robot, rng = load_robot(args.robot), np.random.default_rng(args.seed)
    motion, tau = period(robot, rng)
    with tempfile.TemporaryDirectory() as folder:
        path, tables = Path(folder) / "log.parquet", pieces(motion, tau, args.samples, rng)
        first = next(tables)
        with pa.parquet.ParquetWriter(path, first.schema) as writer:
            for table in itertools.chain([first], tables):
                writer.write_table(table)
        size = path.stat().st_size / 1e6
        with threadpool_limits(1):
            before = bare_loop(robot, motion, tau)
        command = [sys.executable, __file__, "--robot", args.robot, "--identify", str(path)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        with threadpool_limits(1):
            after = bare_loop(robot, motion, tau)
    found = json.loads(done.stdout.splitlines()[-1])
    alone, normal = np.maximum(before, after)
    speed = args.samples / found["seconds"]
    print(f"log                  {args.samples} samples of {robot.nv} joints, {size:.0f} MB")
    print(
        f"identify             {found['seconds']:.1f} s ({found['clock']:.1f} s by the clock), "
        f"{speed:.0f} samples/s"
    )
    print(f"peak memory          {found['peak_MB']:.0f} MB")
    print(f"bare regressor       {alone:.0f} samples/s: ratio {speed / alone:.2f}")
    print(f"  + normal equations {normal:.0f} samples/s: ratio {speed / normal:.2f}")
    print(f"hold-out             rms {max(found['rms']):.3g} N·m, nrmse {max(found['nrmse']):.3g}")


if __name__ == "__main__":
    main()
