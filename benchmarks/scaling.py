"""Processor time of verbs over seconds, recordings, joints and arms; see README.md."""

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import common
import numpy as np
import startup
import streaming

LOGS = {
    "identify": "identify robot.yaml --force",
    "diagnose": "diagnose robot.yaml --no-experiments --force",
    "analyze": "analyze robot.yaml --recording",
}
FLEETS = {"fleet": "fleet arms --jobs 1"}
SIZES = {
    "seconds": (60, 150, 300, 600),
    "recordings": (1, 2, 4, 8, 16, 32),
    "joints": (2, 4, 7, 14),
    "arms": (2, 4, 8, 16),
}
BODY = """<body pos="0 0 .2"><joint name="joint{k}" axis="{axis}" range="-2 2"/>
<inertial pos=".03 .02 .1" mass="{mass}" diaginertia=".02 .015 .01"/>"""
ARM = """<mujoco><compiler angle="radian"/><worldbody>{}</worldbody></mujoco>"""


def times(*, joints: int = 7, seconds: int = 20, recordings: int = 1, arms: int = 0) -> np.ndarray:
    """Processor time of verbs, or of `fleet`, for arms whose axes turn up and across [s]."""
    axes = [("0 0 1", "0 1 0")[k % 2] for k in range(joints)]
    bodies = "".join(BODY.format(k=k, axis=axis, mass=4 / (k + 1)) for k, axis in enumerate(axes))
    logs = [f"log{k}.parquet" for k in range(0 if arms else recordings)]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for k, log in enumerate(logs or [f"arms/{k}/2026-01-05/log.parquet" for k in range(arms)]):
            place = (folder / log).parent
            place.mkdir(parents=True, exist_ok=True)
            (place / "arm.xml").write_text(ARM.format(bodies + "</body>" * joints))
            (place / "robot.yaml").write_text("model: arm.xml")
            streaming.write(folder / log, str(place / "arm.xml"), 1000 * seconds, first=4321 * k)
        python = [sys.executable, "-m", "excitant"]
        lines = [line.split() for line in (FLEETS if arms else LOGS).values()]
        runs = [[*python, *words, *logs, "-o", f"out-{words[0]}"] for words in lines]
        return np.array([startup.run(run, folder).cpu for run in runs])


def main(*, over: Sequence[str] = tuple(SIZES), sizes: Sequence[int] = ()) -> None:
    """Time verbs over growing logs of 1 kHz; beside a time stands the exponent of the step to it.

    Args:
        over: What grows; all by default.
        sizes: Of it.
    """
    for what in over:
        verbs = FLEETS if what == "arms" else LOGS
        print(f"{what:12}" + "".join(f"{verb:>10} s  exponent" for verb in verbs))
        before, last = np.nan, 1
        for size in sizes or SIZES[what]:
            taken = times(**{what: size})
            exponents = np.log(taken / before) / np.log(size / last)
            cells = (f"{s:12.2f}{x:10.2f}" for s, x in zip(taken, exponents, strict=True))
            print(f"{size:<12}" + "".join(cells), flush=True)
            before, last = taken, size


if __name__ == "__main__":
    common.run(main)
