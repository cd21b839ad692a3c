"""The main job, end to end, on a virtual arm that hides an effect from its user."""

from __future__ import annotations

from typing import Any

import numpy as np

from excitant.analysis.diagnosis import diagnose
from excitant.analysis.identifiability import analyze
from excitant.design import design_trajectory, random_trajectory, trajectory_csv, trajectory_json
from excitant.identify import identify_robot, model_files, recording_from_table
from excitant.motions import table_bytes
from excitant.progress import Advance
from excitant.robots import Array, Robot
from excitant.robots.virtual_arm import virtual_arm

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
    found = design_trajectory(
        robot, duration=_DURATION, harmonics=_HARMONICS, starts=_STARTS, seed=seed,
        progress=lambda done, total, kappa, ratio: advance(
            0.02 + 0.5 * done / (total or 1), f"designing the excitation, κ {kappa:.4g}"
        ),
    )  # fmt: skip
    advance(0.55, "running it on the virtual arm")
    excitation = arm.record(found.trajectory, _PERIODS * _DURATION, rng)
    holdout = arm.record(random_trajectory(robot, rng, _DURATION, _HARMONICS), _DURATION, rng)
    recording, held = (
        recording_from_table(table, robot.nv, file=f"{name}.parquet", name=name)
        for table, name in ((excitation, "excitation"), (holdout, "holdout"))
    )
    advance(0.75, "identifying")
    estimate = identify_robot(robot, [recording], validate=[held])
    advance(0.85, "diagnosing")
    diagnosis = diagnose(robot, [recording], validate=[held])
    known = analyze(robot, estimate=estimate)
    nouns: tuple[Any, ...] = (found, estimate, known, diagnosis)
    verbs = dict(zip(("design", "identify", "analyze", "diagnose"), nouns, strict=True))
    results = {verb: noun.result() for verb, noun in verbs.items()}
    series = {f"{v}/{key}": a for v, noun in verbs.items() for key, a in noun.series().items()}
    advance(0.95, "writing the report")
    [hidden] = arm.hidden
    nothing: dict[str, Any] = {"effect": None, "joints": [], "verdict": ""}
    lead = next(iter(results["diagnose"]["findings"]), nothing)
    named = (lead["effect"], lead["joints"], lead["verdict"])
    right = named == (hidden.effect, [hidden.joint], "named")
    about: dict[str, Any] = {"verb": "demo", "robot": robot.name, "seed": seed}
    about["truth"] = hidden.entry()
    about["verdict"] = {"effect": lead["effect"], "joints": lead["joints"], "correct": right}
    files: dict[str, str | bytes] = {
        "trajectory.csv": trajectory_csv(found.trajectory),
        "trajectory.json": trajectory_json(found.trajectory, robot),
        "excitation.parquet": table_bytes(excitation, ".parquet"),
        "holdout.parquet": table_bytes(holdout, ".parquet"),
        **model_files(estimate.model, "identified", "model.yaml"),
        **model_files(diagnosis.extension.model, "extended", "extended.yaml"),
    }
    return about | results, series, files
