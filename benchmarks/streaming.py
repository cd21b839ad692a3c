"""Identify a log larger than memory: peak memory, and samples per second against a bare loop."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

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
_NOISE = 1e-5, 0.3  # rad, N·m
_PIECE = 100_000  # samples written at once


def write(path: Path, robot: Robot, samples: int, rng: np.random.Generator) -> Motion:
    """A log, never whole in memory; one period of its random motion."""
    motion = random_trajectory(robot, rng, _PERIOD, 5).at(np.arange(_PERIOD * _RATE) / _RATE)
    arm = robot.with_effects(
        e.with_values(rng.uniform(0.1, 1.0, len(e.parameters(robot))))
        for e in standard_effects(robot.joints)
    )
    tau = torque(arm, motion)
    names = ["t", *(f"{what}{j + 1}" for what in ("q", "tau") for j in range(robot.nv))]
    schema = pa.schema([(name, pa.float64()) for name in names])
    with pa.parquet.ParquetWriter(path, schema) as writer:
        for start in range(0, samples, _PIECE):
            k = np.arange(start, min(start + _PIECE, samples))
            q, measured = (
                x[k % len(motion)] + rng.normal(0, noise, (len(k), robot.nv))
                for x, noise in zip((motion.q, tau), _NOISE, strict=True)
            )
            writer.write_table(pa.table([k / _RATE, *q.T, *measured.T], schema))
    return motion


def bare_loop(robot: Robot, motion: Motion) -> float:
    """Regressors of a motion per second of processor time."""
    data, compute = robot.model.createData(), pin.computeJointTorqueRegressor
    states = list(zip(motion.q, motion.dq, motion.ddq, strict=True))
    with threadpool_limits(1):
        start = time.process_time()
        for q, dq, ddq in states:
            compute(robot.model, data, q, dq, ddq)
        return len(states) / (time.process_time() - start)


def identified(path: Path) -> dict[str, float]:
    robot = load_robot("panda")
    with threadpool_limits(1):
        start = time.process_time()
        found = identify_robot(robot, read_recordings([path], robot)).validate
        seconds = time.process_time() - start
    status = Path("/proc/self/status").read_text().splitlines()
    peak = int(next(line.split()[1] for line in status if "VmHWM" in line)) / 1024
    worst = {"rms": float(found.rms.max()), "nrmse": float(found.nrmse.max())}
    return worst | {"seconds": seconds, "peak_MB": peak}


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=10_000_000)
    parser.add_argument("--identify", type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args(words)
    if args.identify:
        print(json.dumps(identified(args.identify)))
        return
    robot = load_robot("panda")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.parquet"
        motion = write(path, robot, args.samples, np.random.default_rng(0))
        command = [sys.executable, __file__, "--identify", str(path)]
        before = bare_loop(robot, motion)
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        size = path.stat().st_size / 1e6
    found = json.loads(done.stdout.splitlines()[-1])
    alone, speed = max(before, bare_loop(robot, motion)), args.samples / found["seconds"]
    print(f"log             {args.samples} samples of {robot.nv} joints, {size:.0f} MB")
    print(f"identify        {found['seconds']:.1f} s, {speed:.0f} samples/s")
    print(f"peak memory     {found['peak_MB']:.0f} MB")
    print(f"bare regressor  {alone:.0f} samples/s: ratio {speed / alone:.2f}")
    print(f"hold-out        rms {found['rms']:.3g} N·m, nrmse {found['nrmse']:.3g}")


if __name__ == "__main__":
    main()
