"""Cost of a design against harmonics, joints and samples, and where it goes; see README.md."""

from __future__ import annotations

import argparse
import cProfile
import pstats
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from excitant.design import design_trajectory, problem, search
from excitant.robots import Robot
from excitant.robots.urdf import robot_from_urdf

HARMONICS = (2, 3, 5, 8, 12, 16, 24)
JOINTS = (2, 3, 4, 6, 8, 10, 14)
SAMPLES = (250, 500, 1000, 2000, 4000)
USUAL = {"joints": 6, "harmonics": 5, "samples": None}
SHOWN = 8  # functions of the profile


def chain(joints: int) -> Robot:
    """An arm of vertical and horizontal axes in turn, lighter towards its end."""
    words = ['<robot name="chain"><link name="link0"/>']
    for k in range(1, joints + 1):
        mass, length = 12.0 / k, 0.3
        about, along, axis = mass * 0.01, mass * (0.01 + length**2 / 12), ("0 1 0", "0 0 1")[k % 2]
        words += [
            f'<link name="link{k}"><inertial><origin xyz="0.02 0.01 {length / 2}"/>',
            f'<mass value="{mass}"/><inertia ixx="{along}" iyy="{along}" izz="{about}" ixy="0" ',
            f'ixz="0" iyz="0"/></inertial></link><joint name="joint{k}" type="revolute">',
            f'<parent link="link{k - 1}"/><child link="link{k}"/><axis xyz="{axis}"/>',
            f'<origin xyz="0 0 {length * (k > 1)}"/>',
            '<limit lower="-2" upper="2" velocity="2" effort="300"/></joint>',
        ]
    robot = robot_from_urdf("".join(words) + "</robot>", "chain")
    return robot.with_limits(replace(robot.limits, acceleration=np.full(joints, 8.0)))


def seconds(joints: int, harmonics: int, samples: int | None, seeds: int) -> float:
    """Processor time of one step of the search, the median of some searches."""
    usual = dict(problem._SAMPLES)
    if samples is not None:
        problem._SAMPLES |= dict.fromkeys(usual, samples / harmonics)
    search._unpacked.cache_clear()  # a problem keeps the bases at its samples
    each = []
    for seed in range(seeds):
        begun = time.process_time()
        found = design_trajectory(
            chain(joints), duration=10.0, harmonics=harmonics, starts=1, jobs=1, seed=seed
        )
        steps = sum(start.iterations for start in found.starts)
        each.append((time.process_time() - begun) / max(steps, 1))
    problem._SAMPLES |= usual
    return float(np.median(each))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3, help="searches of each size")
    args = parser.parse_args()
    with threadpool_limits(1):
        for name, sizes in (("harmonics", HARMONICS), ("joints", JOINTS), ("samples", SAMPLES)):
            took = [seconds(**USUAL | {name: size}, seeds=args.seeds) for size in sizes]
            upper = slice(len(sizes) // 2, None)  # what grows, not what is always there
            slope = np.polyfit(np.log(sizes[upper]), np.log(took[upper]), 1)[0]
            print(f"{name:<10}" + "".join(f"{size:>9}" for size in sizes))
            print(f"{'ms a step':<10}" + "".join(f"{1e3 * x:>9.1f}" for x in took))
            print(f"{'exponent':<10}{slope:>9.2f} over the upper half\n", flush=True)
        with cProfile.Profile() as profile:
            seconds(**USUAL, seeds=1)
    stats = pstats.Stats(profile)
    total = stats.total_tt  # type: ignore[attr-defined]
    rows = sorted(stats.stats.items(), key=lambda row: -row[1][2])  # type: ignore[attr-defined]
    for (file, _, function), (_, calls, own, _, _) in rows[:SHOWN]:
        print(f"{own / total:>5.0%}  {calls:>8} calls  {Path(file).stem}.{function}")


if __name__ == "__main__":
    main()
