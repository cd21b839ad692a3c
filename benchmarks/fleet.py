"""A fleet of simulated arms, some odd, some changing, some with faulty data; see README.md."""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from datetime import date, timedelta
from pathlib import Path
from typing import Any

import common
import joblib
import numpy as np
import pandas as pd

from excitant.design import random_trajectory
from excitant.robots import Robot, load_robot
from excitant.robots.parameters import STANDARD
from excitant.robots.virtual_arm import HiddenEffect, typical_torque, virtual_arm

ARM, DATES, SECONDS, RATE = "ur10", 5, 12.0, 125.0
ODD, RISING = 6, 3  # arms
SHARE = 0.1  # of a joint's typical torque: what odd and changing arms have more of friction
PAYLOAD = 1.5  # kg, 0.1 m before the flange's frame
START = date(2026, 1, 5)

Faulty = Callable[[pd.DataFrame, Path], pd.DataFrame | None]


def broken_robot(table: pd.DataFrame, folder: Path) -> pd.DataFrame:
    (folder / "robot.urdf").write_text("<robot name='lost'>")
    return table


def cut_file(table: pd.DataFrame, folder: Path) -> None:
    table.to_parquet(folder / "run.parquet", index=False)
    content = (folder / "run.parquet").read_bytes()
    (folder / "run.parquet").write_bytes(content[: len(content) // 2])


FAULTS: dict[str, Faulty] = {
    "broken URDF": broken_robot,
    "file cut in half": cut_file,
    "no recording": lambda table, folder: None,
    "dead torque": lambda table, _: table.assign(tau2=0.0),
    "torque of the other sign": lambda table, _: table.assign(tau3=-table.tau3),
    "position of the other sign": lambda table, _: table.assign(q2=-table.q2),
    "torques swapped": lambda table, _: table.assign(tau2=table.tau3, tau3=table.tau2),
    "degrees": lambda table, _: table.assign(**np.degrees(table.filter(regex="^d?q"))),
    "holes": lambda table, _: table.assign(q2=table.q2.mask(table.index // 30 == 11)),
    "time goes back": lambda table, _: table.assign(t=table.t.where(table.index != 700, 1.0)),
    "column missing": lambda table, _: table.drop(columns="tau4"),
    "no rows": lambda table, _: table[:0],
}


def planted(robot: Robot, arm: int, part: float) -> list[HiddenEffect]:
    """What an arm has beside what its siblings have, at a part of the time, 0 to 1."""
    if arm >= ODD + RISING:
        return []
    joint, share = arm % robot.nv, SHARE if arm < ODD else SHARE * part
    more = float(share * typical_torque(robot)[joint])
    if arm == 0:
        about = 0.012 * PAYLOAD
        x = [PAYLOAD, 0.0, 0.0, 0.1 * PAYLOAD, about, 0.0, about, 0.0, 0.0, 0.002]
        return [HiddenEffect("payload", robot.joints[-1], tuple(zip(STANDARD, x, strict=True)))]
    if arm == 1:
        return [HiddenEffect("viscous_friction", robot.joints[joint], (("Fv", more),))]
    return [HiddenEffect("coulomb_friction", robot.joints[joint], (("Fc", more),))] * (more > 0)


def write_set(folder: Path, robot: Robot, seed: int, arm: int, k: int, fault: str) -> None:
    """The data set of an arm at one of its dates."""
    rng = np.random.default_rng([seed, arm])
    true = virtual_arm(robot, rng, hidden=planted(robot, arm, k / (DATES - 1)))
    rng = np.random.default_rng([seed, arm, k])
    table = true.record(random_trajectory(robot, rng, SECONDS, 5), SECONDS, rng)
    table = table[:: round(1 / (RATE * (table.t[1] - table.t[0])))].reset_index(drop=True)
    folder.mkdir(parents=True)
    (folder / "robot.urdf").write_text(robot.urdf)
    table = FAULTS[fault](table, folder) if fault else table
    if table is not None:
        table.to_parquet(folder / "run.parquet", index=False)


def write_fleet(root: Path, arms: int, seed: int, jobs: int) -> dict[str, str]:
    """Data sets of all arms and dates; the faults of those that are faulty."""
    robot, rng = load_robot(ARM), np.random.default_rng(seed)
    names = [(arm, k) for arm in range(arms) for k in range(DATES)]
    sound = [at for at in range(len(names)) if names[at][0] >= ODD + RISING]
    chosen = rng.choice(sound, len(FAULTS), replace=False)
    fault = dict(zip(chosen.tolist(), FAULTS, strict=True))
    tasks, faulty = [], {}
    for at, (arm, k) in enumerate(names):
        name = f"cell{arm:02}/{START + timedelta(days=73 * k)}"
        tasks.append((root / name, robot, seed, arm, k, fault.get(at, "")))
        if at in fault:
            faulty[name] = fault[at]
    joblib.Parallel(jobs)(joblib.delayed(write_set)(*task) for task in tasks)
    return faulty


def judged(result: dict[str, Any], faulty: dict[str, str]) -> None:
    """Print what was found of what was planted, and what else was said."""
    sets = {each["name"]: each for each in result["data_sets"]}
    told = {
        name: each["failed"] or next((x for x in each["found"] if "fault" in x), "")
        for name, each in sets.items()
    }
    missed = [fault for name, fault in faulty.items() if not told[name]]
    accused = [name for name, said in told.items() if said and name not in faulty]
    print(f"faulty data sets told        {len(faulty) - len(missed)} of {len(faulty)} {missed}")
    print(f"sound data sets accused      {len(accused)} of {len(sets) - len(faulty)} {accused[:5]}")
    for kind, arms in (("deviations", range(ODD)), ("drifts", range(ODD, ODD + RISING))):
        said = {each["arm"] for each in result[kind]}
        wanted = {f"cell{arm:02}" for arm in arms}
        print(f"{kind} found{'':<{22 - len(kind)}} {len(wanted & said)} of {len(wanted)}")
        if wanted - said:
            print(f"  missed: {sorted(wanted - said)}")
        others = {name.partition("/")[0] for name in sets} - wanted
        print(f"{kind} of other arms{'':<{14 - len(kind)}} {len(said - wanted)} of {len(others)}")
        for each in result[kind]:
            if each["arm"] not in wanted:
                print(f"  {each['arm']}: {each['parameter']}")


def main(*, arms: int = 40, jobs: int = 2, seed: int | None = None) -> None:
    """Write a fleet, examine it and judge what is told.

    Args:
        arms: Number of arms.
    """
    seed = common.printed_seed(seed)
    with tempfile.TemporaryDirectory() as temporary:
        here = Path(temporary)
        folder, out = here / "arms", here / "out"
        faulty, sets = write_fleet(folder, arms, seed, jobs), arms * DATES
        begun = time.monotonic()
        words = ["-m", "excitant", "fleet", str(folder), "-o", str(out), "--jobs", str(jobs)]
        process = subprocess.Popen([sys.executable, *words], stdout=subprocess.DEVNULL)
        _, _, usage = os.wait4(process.pid, 0)  # of the head; the workers are its children
        took = time.monotonic() - begun
        print(f"{sets} data sets in {took:.0f} s, {took * jobs / sets:.2f} s of a process each")
        judged(json.loads((out / "result.json").read_text()), faulty)
        size = sum(path.stat().st_size for path in (out / "arms").rglob("*") if path.is_file())
        print(f"results                      {size / sets / 1e6:.2f} MB a data set")
        print(f"peak memory of one process   {usage.ru_maxrss / 1024:.0f} MB")


if __name__ == "__main__":
    common.run(main)
