"""Faults of recordings: how many planted ones are found, how often a faultless one is accused.

``--real`` lists what is said about every recording of real arms (EXCITANT_DATA or ../shared/data)
as it is. Otherwise faults are planted in recordings of virtual arms that deviate from their model,
seed by seed, and each is counted as found when its name is among those returned. "Beside" counts
recordings in which other names were returned too.
"""

from __future__ import annotations

import argparse
import os
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from planted_faults import PLANTS, log_of_table, recorded
from threadpoolctl import threadpool_limits

from excitant.identify.dataset import load_dataset
from excitant.identify.faults import Log, find_copies, find_faults
from excitant.robots import Robot, load_robot

RATES_HZ = (100.0, 125.0, 250.0, 500.0)


def arguments(words: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", nargs="+", default=["planar_2r", "ur10", "panda"])
    parser.add_argument("--recordings", type=int, default=20, help="of each arm")
    parser.add_argument("--clean-only", action="store_true", help="false alarms only")
    parser.add_argument("--real", action="store_true", help="recordings of real arms instead")
    return parser.parse_args(words)


def real_recordings() -> Iterator[tuple[str, Robot, Log]]:
    """Every recording of real arms, by data set and name."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    for folder in sorted(Path(os.environ.get("EXCITANT_DATA", beside)).iterdir()):
        if not (folder / "robot.urdf").is_file():
            continue
        dataset = load_dataset(folder)
        for path in sorted(folder.glob("*.parquet")):
            table = pd.read_parquet(path)
            log = log_of_table(dataset.robot, table, dataset.torque_column or "tau")
            yield f"{folder.name}/{path.stem}", dataset.robot, log


def report_real() -> None:
    logs = {}
    for name, robot, log in real_recordings():
        logs[name] = log
        faults = find_faults(robot, log)
        print(f"{name:<28} {'no fault' if not faults else ''}", flush=True)
        for fault in faults:
            print(f"    {fault.fault:<18} {fault.detail}")
    for name, fault in find_copies(logs).items():
        print(f"{name:<28} {fault.detail}")


def report_simulated(robots: Sequence[str], count: int, clean_only: bool) -> None:
    arms = [load_robot(name) for name in robots]
    logs = [
        (robot, recorded(robot, seed, RATES_HZ[seed % len(RATES_HZ)]))
        for robot in arms
        for seed in range(count)
    ]
    accused = Counter[str]()
    alarms = 0
    for robot, log in logs:
        found = {fault.fault for fault in find_faults(robot, log)}
        alarms += bool(found)
        accused.update(found)
    print(f"faultless: {alarms} of {len(logs)} accused {dict(accused)}", flush=True)
    if clean_only:
        return
    for name, plant in PLANTS:
        hits, beside = 0, Counter[str]()
        for seed, (robot, log) in enumerate(logs):
            planted = plant(robot, log, np.random.default_rng(seed))
            found = {fault.fault for fault in find_faults(robot, planted)}
            hits += name in found
            beside.update(found - {name})
        print(
            f"{name:<18} {plant.__name__:<28} {hits:>3} of {len(logs)}  beside {dict(beside)}",
            flush=True,
        )


def main(words: Sequence[str] | None = None) -> None:
    args = arguments(words)
    with threadpool_limits(1):
        if args.real:
            report_real()
        else:
            report_simulated(args.robots, args.recordings, args.clean_only)


if __name__ == "__main__":
    main()
