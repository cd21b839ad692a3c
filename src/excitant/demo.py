"""The main job, end to end, on a virtual arm that hides an effect from its user."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from excitant.analysis.examination import examine
from excitant.design.feasible import random_trajectory
from excitant.design.optimal import design_trajectory
from excitant.identify.reading.logs import recording_from_table
from excitant.motions import table_bytes
from excitant.progress import Advance
from excitant.robots.motion import Array
from excitant.robots.robot import Robot
from excitant.robots.virtual_arm import HiddenEffect, virtual_arm

_DURATION = 10.0  # s, of the excitation and of the hold-out
_HARMONICS = 5
_STARTS = 8
_PERIODS = 2  # recorded of the excitation


def run_demo(
    robot: Robot, seed: int, advance: Advance
) -> tuple[dict[str, Any], dict[str, Array], dict[str, str | bytes]]:
    """Design, run, identify, analyze and diagnose on an arm that hides something.

    It differs from the robot by some per cent in every value and by one effect drawn from the seed;
    nothing but its recordings reaches the other steps. Result, arrays (``verb/key``) and files.
    """
    rng = np.random.default_rng(seed)
    arm = virtual_arm(robot, rng)
    advance(0.02, "designing the excitation")
    design = design_trajectory(
        robot, duration=_DURATION, harmonics=_HARMONICS, starts=_STARTS, seed=seed,
        progress=lambda done, total, kappa, ratio: advance(
            0.02 + 0.5 * done / (total or 1), f"designing the excitation, κ {kappa:.4g}"
        ),
    )  # fmt: skip
    if design.interrupted:
        raise KeyboardInterrupt
    advance(0.55, "running it on the virtual arm")
    excitation = arm.record(design.trajectory, _PERIODS * _DURATION, rng)
    holdout = arm.record(
        random_trajectory(robot, rng, _DURATION, _HARMONICS), _DURATION, rng
    )
    recording, held = (
        recording_from_table(table, robot.nv, file=f"{name}.parquet", name=name)
        for table, name in ((excitation, "excitation"), (holdout, "holdout"))
    )
    examined = examine(
        robot, [recording], validate=[held],
        progress=lambda done, words: advance(0.7 + 0.25 * done, words),
    )  # fmt: skip
    advance(0.95, "writing the report")
    [hidden] = arm.hidden
    result = examined.result() | {
        "verb": "demo",
        "seed": seed,
        "truth": hidden.entry(),
    }
    result["design"] = design.result()
    truth = truth_of(hidden, result["diagnose"]["findings"])
    result["verdict"] |= {"truth": truth, "correct": truth == "named"}
    series = examined.series() | {
        f"design/{key}": a for key, a in design.series().items()
    }
    files: dict[str, str | bytes] = {
        **design.files(),
        "excitation.parquet": table_bytes(excitation, ".parquet"),
        "holdout.parquet": table_bytes(holdout, ".parquet"),
        **examined.files,
    }
    return result, series, files


def truth_of(hidden: HiddenEffect, findings: Sequence[Mapping[str, Any]]) -> str:
    """Whether what is hidden was ``named``, is among what is ``undecided``, or was ``missed``."""

    def is_it(entry: Mapping[str, Any]) -> bool:
        return bool(
            entry["effect"] == hidden.effect and hidden.joint in entry["joints"]
        )

    entries = [
        part
        for finding in findings
        for part in (finding, *finding.get("parts", ()))
    ]
    if any(is_it(entry) and entry["verdict"] == "named" for entry in entries):
        return "named"
    rivals = [rival for entry in entries for rival in entry["rivals"]]
    return "undecided" if any(map(is_it, (*entries, *rivals))) else "missed"
