"""Processor time of verbs over seconds, recordings and joints, with exponents; see README.md."""

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import common
import numpy as np
import startup
import streaming

VERBS = {"identify": "--force", "diagnose": "--no-experiments --force", "analyze": "--recording"}
SIZES = {
    "seconds": (60, 150, 300, 600),
    "recordings": (1, 2, 4, 8, 16, 32),
    "joints": (2, 4, 7, 14),
}
BODY = """<body pos="0 0 .2"><joint name="joint{k}" axis="{axis}" range="-2 2"/>
<inertial pos=".03 .02 .1" mass="{mass}" diaginertia=".02 .015 .01"/>"""


def times(*, joints: int = 7, seconds: int = 20, recordings: int = 1) -> np.ndarray:
    """Processor time of each verb for an arm whose axes turn up and across in turns [s]."""
    axes = [("0 0 1", "0 1 0")[k % 2] for k in range(joints)]
    bodies = "".join(BODY.format(k=k, axis=axis, mass=4 / (k + 1)) for k, axis in enumerate(axes))
    world = f"<worldbody>{bodies}{'</body>' * joints}</worldbody>"
    logs = [f"log{k}.parquet" for k in range(recordings)]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        arm = folder / "arm.xml"
        arm.write_text(f"<mujoco><compiler angle='radian'/>{world}</mujoco>")
        for k, log in enumerate(logs):
            streaming.write(folder / log, str(arm), 1000 * seconds, first=4321 * k)
        words = [[verb, "arm.xml", *how.split(), *logs, "-o", verb] for verb, how in VERBS.items()]
        runs = [[sys.executable, "-m", "excitant", *each] for each in words]
        return np.array([startup.run(run, folder).cpu for run in runs])


def main(*, over: Sequence[str] = tuple(SIZES)) -> None:
    """Time verbs over growing logs; beside each time stands the exponent of the step to it."""
    for what in over:
        print(f"{what:12}" + "".join(f"{verb:>10} s  exponent" for verb in VERBS))
        before, sizes = np.full(len(VERBS), np.nan), SIZES[what]
        for size, last in zip(sizes, (1, *sizes), strict=False):
            taken = times(**{what: size})
            exponents = np.log(taken / before) / np.log(size / last)
            cells = (f"{s:12.2f}{x:10.2f}" for s, x in zip(taken, exponents, strict=True))
            print(f"{size:<12}" + "".join(cells), flush=True)
            before = taken


if __name__ == "__main__":
    common.run(main)
