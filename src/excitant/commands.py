"""The commands about arms, recordings and runs: load, call the verb, save the run."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from excitant.analysis import (
    diagnosis,
    diagnosis_result,
    discrimination_plan,
    identifiability,
    identifiability_result,
    identify_shown,
)
from excitant.demo import Demo, run_demo
from excitant.design import load_trajectory, trajectory_csv, trajectory_json
from excitant.exceptions import BadInput, RankDeficient
from excitant.identify import Estimate, Recording, model_files
from excitant.identify import identify as identify_robot
from excitant.identify.faults import read_checked
from excitant.identify.recording import MINIMUM_DURATION
from excitant.identify.rows import held_out
from excitant.motion_commands import sampled
from excitant.output import finish, print_json, print_paths, run_directory, show_import
from excitant.progress import progress_bar
from excitant.reports import SavedRun, compare, load_run, save_run
from excitant.robot_arguments import dataset_of, robot_of
from excitant.robots import Robot
from excitant.robots.effects import Effect, standard_effects


def demo(args: argparse.Namespace) -> None:
    """Run the main job on a virtual arm."""
    robot = robot_of(args)
    with progress_bar("demo") as advance:
        outcome: Demo = run_demo(robot, args.seed, advance)
    directory = run_directory(args, "demo", robot)
    finish(args, directory, outcome.result, outcome.series, outcome.files)


def analyze(args: argparse.Namespace) -> None:
    """Say what can be known of an arm's parameters."""
    dataset = dataset_of(args)
    robot = dataset.robot
    effects = standard_effects(robot.joints) if args.columns == "friction" else ()
    given: dict[str, Any] = {}
    brief: list[Recording] = []
    if args.recording:
        recordings = dataset.recordings(args.recording)
        brief = [r for r in recordings if held_out(r).duration < MINIMUM_DURATION]
        show_import(recordings)
        given["estimate"] = _as_far_as_shown(robot, recordings, effects, brief)
        given["rng"] = np.random.default_rng(0)
    elif args.trajectory:
        given["motion"] = sampled(load_trajectory(args.trajectory, robot))
    given |= {"noise": args.noise, "moving": args.moving, "measured": args.measured}
    found = identifiability.analyze(robot, effects=effects, **given)
    result = identifiability_result.analyze_result(found)
    result["notes"] += [_too_short(r) for r in brief]
    directory = run_directory(args, "analyze", robot)
    finish(args, directory, result, identifiability_result.analyze_series(found), {})


def _as_far_as_shown(
    robot: Robot,
    recordings: Sequence[Recording],
    effects: Sequence[Effect],
    brief: Sequence[Recording],
) -> Estimate:
    """An estimate even where the recorded motion leaves parameters open.

    Where recordings are too brief to hold a part of them back, all rows are fitted: only what they
    show is asked for, not how well the estimate predicts.
    """
    validate = recordings if brief else ()
    try:
        return identify_robot(robot, recordings, validate=validate, effects=effects)
    except RankDeficient:
        return identify_shown(robot, recordings, effects, validate=validate)


def _too_short(recording: Recording) -> str:
    return (
        f"{recording.name} lasts {recording.duration:.3g} s, too short to hold a part of it back: "
        "all of it is analysed, and what so few rows say of the noise is rough; record longer"
    )


def diagnose(args: argparse.Namespace) -> None:
    """Name what the given model gets wrong."""
    dataset = dataset_of(args)
    checked = read_checked(dataset, args.recordings, without=args.validate, repaired=args.repair)
    recordings = checked.recordings
    validate = dataset.recordings(args.validate) if args.validate else []
    imported = show_import([*recordings, *validate])
    with progress_bar("diagnose"):
        found = diagnosis.diagnose(
            dataset.robot, recordings, validate=validate, cutoff_hz=args.cutoff
        )
    directory = run_directory(args, "diagnose", dataset.robot)
    files = model_files(found.extension.model, "extended", "extended.yaml")
    plan = _plan(args, found)
    result = diagnosis_result.diagnose_result(found, plan) | {"import": imported}
    result["faults"] = checked.entries()
    result["notes"] += checked.notes
    result["extended"]["files"] = [str(directory / name) for name in files]
    for k, motion in enumerate(plan.motions, start=1):
        files[f"separate-{k}.csv"] = trajectory_csv(motion)
        files[f"separate-{k}.json"] = trajectory_json(motion, dataset.robot)
    finish(args, directory, result, diagnosis_result.diagnose_series(found), files)


def _plan(args: argparse.Namespace, found: diagnosis.Diagnosis) -> discrimination_plan.Plan:
    """Experiments that settle what is undecided, unless none are wanted."""
    if args.no_experiments:
        return discrimination_plan.Plan()
    return discrimination_plan.plan(
        found, np.random.default_rng(0), time_limit=args.experiment_time
    )


def report(args: argparse.Namespace) -> None:
    """Render a run's report again, or compare it with another run."""
    if len(args.directory) > 1:
        result = compare(*(SavedRun(each, *load_run(each)) for each in args.directory))
        stamp = time.strftime("%Y%m%d-%H%M%S")
        directory = Path(args.output or f"runs/compare-{result['of']}-{stamp}")
        finish(args, directory, result, {}, {})
        return
    if args.output is not None:
        raise BadInput("-o is where runs are compared; name a second run, or leave -o out")
    (directory,) = args.directory
    result, series = load_run(directory)
    paths, _ = save_run(directory, result, series)
    if args.json:
        print_json(result)
    else:
        print_paths(paths)
