"""Time that the on-line estimator takes per sample of a control loop.

    OMP_NUM_THREADS=1 python benchmarks/online.py [--robot panda] [--rate 1000] [--seconds 20]

``push`` is what runs in every cycle of the loop. Most cycles take in a sample; one in a block
makes the rows of all joints, the next one lets one joint's triangle take them in. ``estimate``
solves for the parameters with their covariance, ``look`` judges convergence and excitation; both
belong beside the loop.
"""

from __future__ import annotations

import argparse
import gc
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from excitant.design import random_trajectory
from excitant.identify import Monitor, OnlineEstimator
from excitant.identify.base_prior import base_prior
from excitant.robots import Motion, Robot, load_robot, torque
from excitant.robots.effects import Effect, standard_effects

_WARM_UP = 500  # samples
_ASKED = 30  # calls of estimate and look


def arguments(words: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robot", default="panda")
    parser.add_argument("--rate", type=float, default=1000.0, help="of the loop [Hz]")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--seed", type=int, default=0)
    return parser.parse_args(words)


@dataclass(frozen=True, eq=False)
class Pushes:
    """Times of every push after the warm-up [µs], and whether it made rows.

    Attributes:
        clock: By the clock; includes being interrupted by other processes.
        processor: Of this thread on the processor.
        rows: Whether a block ended.
    """

    clock: np.ndarray
    processor: np.ndarray
    rows: np.ndarray


def pushed(online: OnlineEstimator, motion: Motion, tau: np.ndarray) -> Pushes:
    """Push a whole motion, timed sample by sample."""
    times, rows = np.empty((2, len(motion))), np.empty(len(motion), bool)
    gc.collect()
    for k in range(len(motion)):
        t, q, measured, before = float(motion.t[k]), motion.q[k], tau[k], online.rows
        start, busy = time.perf_counter(), time.thread_time()
        online.push(t, q, measured)
        times[:, k] = time.perf_counter() - start, time.thread_time() - busy
        rows[k] = online.rows > before
    late = slice(_WARM_UP, None)
    return Pushes(1e6 * times[0, late], 1e6 * times[1, late], rows[late])


def repeated(call: Callable[[], object]) -> np.ndarray:
    """Times of a call [µs]."""
    times = []
    for _ in range(_ASKED):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return 1e6 * np.array(times)


def line(name: str, times: np.ndarray) -> str:
    low, high = np.percentile(times, [50, 99])
    return (
        f"  {name:<42}{times.mean():9.1f}{low:9.1f}{high:9.1f}"
        f"{np.percentile(times, 99.9):9.1f}{times.max():9.1f}"
    )


def report(robot: Robot, effects: tuple[Effect, ...], rate: float, motion: Motion) -> None:
    noise = 0.05 * np.random.default_rng(0).standard_normal(motion.q.shape)
    tau = torque(robot, motion) + noise
    online = OnlineEstimator(robot, effects, rate_hz=rate)
    times = pushed(online, motion, tau)
    print(
        f"{robot.name}: {robot.nv} joints, {len(online.base)} parameters, {rate:g} Hz, "
        f"block of {online.block}, {len(times.clock)} samples"
    )
    print(f"  {'[µs]':<42}{'mean':>9}{'median':>9}{'p99':>9}{'p99.9':>9}{'worst':>9}")
    print(line("push, by the clock", times.clock))
    print(line("push, on the processor", times.processor))
    print(line("  cycles that make rows (1 in a block)", times.processor[times.rows]))
    print(line("  all other cycles", times.processor[~times.rows]))
    print(line("estimate with covariance", repeated(online.estimate)))
    monitor = Monitor(online, base_prior(robot, effects, online.base))
    print(line("look of the monitor", repeated(monitor.look)))


def main(words: Sequence[str] | None = None) -> None:
    args = arguments(words)
    robot = load_robot(args.robot)
    rng = np.random.default_rng(args.seed)
    trajectory = random_trajectory(robot, rng, 10.0, 5)
    t = np.arange(0, args.seconds, 1 / args.rate)
    motion = Motion(t, *(trajectory(t, order) for order in range(3)))
    with threadpool_limits(1):
        report(robot.with_effects(()), (), args.rate, motion)
        report(robot, standard_effects(robot.joints), args.rate, motion)


if __name__ == "__main__":
    main()
