"""Identify a log larger than memory: peak memory and samples per second."""

import tempfile
import time
from multiprocessing import get_context
from pathlib import Path

import common
import numpy as np
import pyarrow as pa
import pyarrow.parquet

from excitant.design import random_trajectory
from excitant.identify import identify_robot, read_recordings
from excitant.robots import Motion, Robot, load_robot, torque
from excitant.robots.effects import standard_effects

_RATE, _PERIOD = 1000.0, 20.0  # Hz; s, after which the motion repeats, the noise never
_NOISE = 1e-5, 0.3  # rad, N·m
_PIECE = 100_000  # samples written at once


def period(robot: Robot, rng: np.random.Generator) -> Motion:
    """One period of the random motion of a log."""
    return random_trajectory(robot, rng, _PERIOD, 5).at(np.arange(_PERIOD * _RATE) / _RATE)


def write(path: Path, name: str, samples: int, first: int = 0) -> None:
    """Write a log of a robot, never whole in memory, that begins with a sample of its motion."""
    robot = load_robot(name)
    rng = np.random.default_rng(0)
    motion = period(robot, rng)
    arm = robot.with_effects(
        e.with_values(rng.uniform(0.1, 1.0, len(e.parameters(robot))))
        for e in standard_effects(robot.joints)
    )
    tau = torque(arm, motion)
    noises = np.random.default_rng([1, first])
    names = ["t", *(f"{what}{j + 1}" for what in ("q", "tau") for j in range(robot.nv))]
    schema = pa.schema([(name, pa.float64()) for name in names])
    with pa.parquet.ParquetWriter(path, schema) as writer:
        for start in range(0, samples, _PIECE):
            k = np.arange(start, min(start + _PIECE, samples))
            q, measured = (
                x[(first + k) % len(motion)] + noises.normal(0, noise, (len(k), robot.nv))
                for x, noise in zip((motion.q, tau), _NOISE, strict=True)
            )
            writer.write_table(pa.table([k / _RATE, *q.T, *measured.T], schema))


def main(*, samples: int = 10_000_000) -> None:
    """Write, read and identify a log of a panda at 1 kHz.

    Args:
        samples: Number of samples of the log.
    """
    robot = load_robot("panda")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.parquet"
        # in a process of its own, whose memory does not count
        writing = get_context("spawn").Process(target=write, args=(path, "panda", samples))
        writing.start()
        writing.join()
        start = time.process_time()
        accuracy = identify_robot(robot, read_recordings([path], robot)).validate
        speed = samples / (time.process_time() - start)
        size = path.stat().st_size / 1e6
    memory = Path("/proc/self/status").read_text("utf-8")  # getrusage counts its parent's, too
    peak = int(memory.partition("VmHWM:")[2].split()[0]) / 1024
    print(f"log             {samples} samples of {robot.nv} joints, {size:.0f} MB")
    print(f"identify        {samples / speed:.1f} s, {speed:.0f} samples/s")
    print(f"peak memory     {peak:.0f} MB")
    print(f"hold-out        rms {accuracy.rms.max():.3g} N·m, nrmse {accuracy.nrmse.max():.3g}")


if __name__ == "__main__":
    common.run(main)
