"""The command that designs: a motion, or one per link, with its files."""

from __future__ import annotations

import argparse
import sys
import time
from typing import Any

import numpy as np

from excitant.design import (
    Design,
    SplineTrajectory,
    Trajectory,
    approach,
    design_link_by_link,
    lower_bound,
    motion_csv,
    trajectory_csv,
    trajectory_json,
    write_formats,
)
from excitant.design import design as design_trajectory
from excitant.exceptions import BadInput, Infeasible
from excitant.motion_commands import DENSE_HZ, robot_within_limits, surroundings_of
from excitant.output import finish, run_directory
from excitant.progress import progress_bar
from excitant.robots import Array, Motion, Robot
from excitant.robots.geometry import Scene
from excitant.robots.limits_file import require_limits

_BOUND_TIME = 60.0  # s: much less leaves the bound near 1


def design(args: argparse.Namespace) -> None:
    """Design an excitation trajectory."""
    robot = robot_within_limits(args)
    if note := require_limits(robot):
        print(note, file=sys.stderr)
    if not 1 <= args.rate <= 10_000:
        raise BadInput(f"--rate {args.rate:g} Hz: give a control rate from 1 to 10000 Hz")
    if args.repeat < 1:
        raise BadInput(f"--repeat {args.repeat}: give the number of periods, at least 1")
    if args.bound and args.criterion != "condition":
        raise BadInput(
            f"--bound is one of the condition number, not of criterion {args.criterion}; "
            "leave one out"
        )
    if args.bound and (args.noise or args.after):
        raise BadInput("--bound holds for one motion with equal noise; leave --noise and --after")
    if args.link_by_link:
        _design_link_by_link(args, robot)
        return
    start = _pose(args.start, robot) if args.start else None
    surroundings, least = surroundings_of(args, robot)
    began = time.monotonic()
    with progress_bar("design") as advance:

        def tell(done: int, total: int | None, condition: float, ratio: float) -> None:
            if total is None:  # as many starts as fit into the time limit
                share = min((time.monotonic() - began) / args.time_limit, 1.0)
            else:
                share = done / total
            advance(
                share,
                f"{done} starts, best κ {condition:.4g}, worst limit {100 * ratio:.1f} %",
            )

        found = design_trajectory(
            robot,
            **_options(args),
            noise=args.noise,
            earlier=_earlier(args, robot),
            scene=surroundings,
            clearance=least,
            progress=tell,
        )
    files: dict[str, str | bytes] = {
        "trajectory.csv": trajectory_csv(found.trajectory, args.rate, args.repeat),
        "trajectory.json": trajectory_json(found.trajectory, robot),
    }
    motions = {"trajectory": found.trajectory.motion(args.rate, args.repeat)}
    result = found.result() | {"periods": args.repeat}
    if args.bound:
        result |= _bound(found, args.seed)
    if start is not None:
        try:
            ways = _ways(robot, start, found.trajectory, args.rate, surroundings, least)
            files |= {f"{name}.csv": motion_csv(motion) for name, motion in ways.items()}
            motions |= ways
        except Infeasible as error:  # the design stands without them
            result["notes"] = [*result.get("notes", []), str(error)]
    names = [word.strip() for word in (args.formats or "").split(",") if word.strip()]
    for stem, motion in motions.items():
        files |= write_formats(motion, robot, names, stem)
    finish(args, run_directory(args, "design", robot), result, found.series(), files)


def _options(args: argparse.Namespace) -> dict[str, Any]:
    """What a design of one motion and one of a sequence are both told."""
    return {
        "duration": args.duration,
        "harmonics": args.harmonics,
        "series": args.series,
        "top_hz": args.max_frequency,
        "criterion": args.criterion,
        "columns": args.columns,
        "starts": args.starts,
        "jobs": args.jobs,
        "cluster": args.cluster,
        "seed": args.seed,
        "time_limit": args.time_limit,
    }


def _design_link_by_link(args: argparse.Namespace, robot: Robot) -> None:
    """One motion per link instead of one for all."""
    for option, value in (("--bound", args.bound), ("--noise", args.noise),
                          ("--after", args.after), ("--from", args.start),
                          ("--formats", args.formats)):  # fmt: skip
        if value:
            raise BadInput(f"--link-by-link designs each link by its own row; leave {option} out")
    surroundings, least = surroundings_of(args, robot)
    with progress_bar("design") as advance:
        found = design_link_by_link(
            robot,
            **_options(args),
            scene=surroundings,
            clearance=least,
            progress=lambda share, link, best: advance(share, f"{link}, best κ {best:.4g}"),
        )
    result = found.result() | {"periods": args.repeat}
    files = found.files(args.rate, args.repeat)
    directory = run_directory(args, "design", robot)
    finish(args, directory, result, found.series(), files)


def _earlier(args: argparse.Namespace, robot: Robot) -> list[Motion]:
    """Motions of recordings made already."""
    if not args.after:
        return []
    from excitant.identify.dataset import Dataset  # takes a second to import
    from excitant.identify.preprocessing import prepare

    recordings = Dataset(robot).recordings(args.after)
    return [part.motion[part.keep] for recording in recordings for part in prepare(recording)]


def _bound(found: Design, seed: int) -> dict[str, Any]:
    """Numerical lower bound on what any such motion could reach, as entries of the result."""
    with progress_bar("bound") as advance:
        bound = lower_bound(
            found.robot,
            duration=found.duration,
            harmonics=None if isinstance(found.trajectory, SplineTrajectory) else found.harmonics,
            columns=found.columns,
            criterion=found.criterion,
            seed=seed,
            time_limit=_BOUND_TIME,
            pool=[found.trajectory.motion(DENSE_HZ)],
            progress=lambda spent, value, ceiling: advance(
                min(spent / _BOUND_TIME, 1.0), f"κ ≥ {value:.4g}"
            ),
        )
    condition = found.result()["condition_number"] | {"lower_bound": bound.value}
    ratio = found.condition_final / bound.value
    note = f"within ×{ratio:.2g} of the best possible: {bound.assumptions}"
    return {"condition_number": condition, "notes": [note]}


def _pose(text: str, robot: Robot) -> Array:
    try:
        pose = np.array([float(word) for word in text.split(",")])
    except ValueError:
        raise BadInput(f"--from {text}: give one number per joint, as in 0,-1.57,0") from None
    if len(pose) != robot.nv:
        raise BadInput(f"--from has {len(pose)} numbers, {robot.name} has {robot.nv} joints")
    return pose


def _ways(
    robot: Robot,
    start: Array,
    trajectory: Trajectory,
    rate: float,
    surroundings: Scene | None,
    least: float,
) -> dict[str, Motion]:
    """Approach from a pose to the trajectory, and return from it."""
    there = trajectory(0.0)[0]
    options: dict[str, Any] = {"scene": surroundings, "clearance": least, "rate_hz": rate}
    return {
        "approach": approach(robot, start, there, **options),
        "return": approach(robot, there, start, name="return", **options),
    }
