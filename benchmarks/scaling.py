"""Exponents of processor time over samples, recordings and joints; see README.md."""

import sys
import tempfile
from pathlib import Path

import common
import numpy as np
import pandas as pd
import startup
import streaming

VERBS = {"identify": "--force", "diagnose": "--no-experiments --force", "analyze": ""}
SIZES = {
    "seconds at 1 kHz": (60, 150, 300, 600),
    "recordings of 5 s": (1, 2, 4, 8, 16, 32),
    "joints": (2, 4, 7, 14),
}
BODY = """<body pos="0 0 .2"><joint name="joint{k}" axis="{axis}" range="-2 2"/>
<inertial pos=".03 .02 .1" mass="{mass}" diaginertia=".02 .015 .01"/>"""


def chain(joints: int) -> str:
    """MJCF of an arm whose axes turn up and across in turns."""
    bodies = [
        BODY.format(k=k, axis=("0 0 1", "0 1 0")[k % 2], mass=4 / (k + 1)) for k in range(joints)
    ]
    world = f"<worldbody>{''.join(bodies)}{'</body>' * joints}</worldbody>"
    return f"<mujoco><compiler angle='radian'/>{world}</mujoco>"


def main(*, only: str = "", largest: float = np.inf, repeats: int = 1) -> None:
    """Time verbs over growing logs.

    Args:
        only: What grows, by a part of its name.
        largest: Size up to which it grows.
        repeats: Of each run, of which the quickest counts.
    """
    for what, sizes in SIZES.items():
        counts = [size for size in sizes if only in what and size <= largest]
        cpu = pd.DataFrame(index=pd.Index(counts, name=what), columns=[*VERBS], dtype=float)
        for count in counts:
            with tempfile.TemporaryDirectory() as name:
                folder = Path(name)
                arm = folder / "arm.xml"
                arm.write_text(chain(count if what == "joints" else 7))
                seconds = {"joints": 20, "recordings of 5 s": 5}.get(what, count)
                logs = [f"log{k}.parquet" for k in range(count if "recordings" in what else 1)]
                for k, log in enumerate(logs):
                    streaming.write(folder / log, str(arm), 1000 * seconds, 4321 * k)
                for verb, options in VERBS.items():
                    recorded = ["--recording", *logs] if verb == "analyze" else logs
                    words = [verb, str(arm), *recorded, *options.split(), "-o", verb]
                    run = [sys.executable, "-m", "excitant", *words]
                    cpu.loc[count, verb] = startup.least(run, folder, repeats).cpu
        steps = np.diff(np.log(cpu), axis=0) / np.diff(np.log(counts))[:, None]
        for count, exponents in zip(counts[1:], steps, strict=True):
            cpu.loc[count, [f"{verb} ^" for verb in VERBS]] = exponents
        if counts:
            print(cpu.to_string(float_format="{:.2f}".format, na_rep=""), flush=True)


if __name__ == "__main__":
    common.run(main)
