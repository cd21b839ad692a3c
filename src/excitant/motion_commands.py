"""The commands about motions: design, check, simulate."""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from excitant.design import (
    CLEARANCE,
    Design,
    HermiteTrajectory,
    SplineTrajectory,
    Trajectory,
    approach,
    condition_number,
    design_link_by_link,
    design_result,
    design_series,
    information,
    link_by_link_design_result,
    link_by_link_design_series,
    link_by_link_files,
    load_trajectory,
    lower_bound,
    motion_csv,
    return_path,
    trajectory_csv,
    trajectory_json,
    write_formats,
)
from excitant.design import check as check_limits
from excitant.design import clearance as motion_clearance
from excitant.design import design as design_trajectory
from excitant.design.result import certified
from excitant.exceptions import BadInput, Infeasible
from excitant.output import finish, print_json, run_directory, table_bytes, write_atomically
from excitant.progress import progress_bar
from excitant.robot_arguments import robot_of
from excitant.robots import Array, Motion, Robot, load_limits, torque
from excitant.robots.geometry import Scene, scene
from excitant.robots.limits_file import require_limits
from excitant.robots.obstacles import load_obstacles
from excitant.robots.virtual_arm import virtual_arm

_DENSE_HZ = 100.0
_BOUND_TIME = 60.0  # s: much less leaves the bound near 1


def design(args: argparse.Namespace) -> None:
    """Design an excitation trajectory."""
    robot = _limited(args)
    if not 1 <= args.rate <= 10_000:
        raise BadInput(f"--rate {args.rate:g} Hz: give a control rate from 1 to 10000 Hz")
    if args.repeat < 1:
        raise BadInput(f"--repeat {args.repeat}: give the number of periods, at least 1")
    if args.bound and (args.noise or args.after):
        raise BadInput("--bound holds for one motion with equal noise; leave --noise and --after")
    if args.link_by_link:
        _design_link_by_link(args, robot)
        return
    start = _pose(args.start, robot) if args.start else None
    surroundings, least = _surroundings(args, robot)
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
    result = design_result(found) | {"periods": args.repeat}
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
        files |= write_formats(motion, robot, names, rate_hz=args.rate, stem=stem)
    finish(args, run_directory(args, "design", robot), result, design_series(found), files)


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
    surroundings, least = _surroundings(args, robot)
    with progress_bar("design") as advance:
        found = design_link_by_link(
            robot,
            **_options(args),
            scene=surroundings,
            clearance=least,
            progress=lambda share, link, best: advance(share, f"{link}, best κ {best:.4g}"),
        )
    result = link_by_link_design_result(found) | {"periods": args.repeat}
    files = link_by_link_files(found, args.rate, args.repeat)
    directory = run_directory(args, "design", robot)
    finish(args, directory, result, link_by_link_design_series(found), files)


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
            pool=[found.trajectory.motion(_DENSE_HZ)],
            progress=lambda spent, value, ceiling: advance(
                min(spent / _BOUND_TIME, 1.0), f"κ ≥ {value:.4g}"
            ),
        )
    condition = design_result(found)["condition_number"] | {"lower_bound": bound.value}
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

    def distance(pose: Array) -> float:
        assert surroundings is not None
        return float(surroundings.distances(pose[None]).min())

    clear = distance if surroundings is not None else None
    there = trajectory(0.0)[0]
    options: dict[str, Any] = {"clearance": clear, "margin": least, "rate_hz": rate}
    return {
        "approach": approach(robot, start, there, **options),
        "return": return_path(robot, there, start, **options),
    }


def _surroundings(args: argparse.Namespace, robot: Robot) -> tuple[Scene | None, float]:
    """Scene to keep clear of, if any, and the least distance [m]."""
    least = CLEARANCE if args.clearance is None else args.clearance
    if args.ignore_collisions:
        return None, least
    found = scene(robot, load_obstacles(args.obstacles) if args.obstacles else ())
    if found is None and (args.obstacles or args.clearance is not None):
        raise BadInput(
            f"{robot.source}: the robot has no collision shapes; add <collision> elements to its "
            "URDF, or leave --obstacles and --clearance out"
        )
    return found, least


def check(args: argparse.Namespace) -> None:
    """Check anybody's trajectory against the limits of a robot."""
    robot = _limited(args)
    trajectory = load_trajectory(args.trajectory, robot)
    surroundings, least = _surroundings(args, robot)
    report = check_limits(robot, trajectory)
    motion = sampled(trajectory)
    path = trajectory if isinstance(trajectory, Trajectory) else HermiteTrajectory(trajectory)
    near = motion_clearance(surroundings, path) if surroundings is not None else None
    result = {
        "verb": "check",
        "robot": robot.name,
        "trajectory": str(args.trajectory),
        "joints": list(robot.joints),
        "holds": report.hold and (near is None or near.distance >= least),
        "limits": {use.quantity: use.ratio for use in report.uses},
        "worst": {
            use.quantity: {"joint": use.joint, "t": use.time, "ratio": use.ratio}
            for use in report.uses
            if use.ratio > 0
        },
        "limit_values": {use.quantity: getattr(robot.limits, use.quantity) for use in report.uses},
        "certified": certified(
            robot, report, trajectory if isinstance(trajectory, Trajectory) else None
        ),
        "columns": args.columns,
        "condition_number": condition_number(information(robot, args.columns).matrix(motion)),
        "clearance_m": None if near is None else near.certified,
        "verdicts": [
            f"{use.quantity} limit of {use.joint} exceeded by {100 * (use.ratio - 1):.3g} % "
            f"at {use.time:.4g} s"
            for use in report.uses
            if use.ratio > 1
        ]
        + [
            f"{near.bodies[0]} and {near.bodies[1]} come within {1000 * near.distance:.3g} mm "
            f"at {near.time:.4g} s, required {1000 * least:.3g} mm"
            for near in [near]
            if near is not None and near.distance < least
        ]
        or ["all limits hold, between samples too"],
    }
    series = {
        "t": motion.t,
        "q": motion.q,
        "dq": motion.dq,
        "ddq": motion.ddq,
        "tau": torque(robot, motion),
    }
    finish(args, run_directory(args, "check", robot), result, series, {})


def simulate(args: argparse.Namespace) -> None:
    """Record a trajectory on a virtual arm."""
    robot = robot_of(args)
    target = Path(args.output)
    if target.suffix not in (".csv", ".parquet"):
        raise BadInput(f"{target}: name a .csv or .parquet file")
    trajectory = load_trajectory(args.trajectory, robot)
    path = trajectory if isinstance(trajectory, Trajectory) else HermiteTrajectory(trajectory)
    duration = float(sampled(trajectory).t[-1])
    rng = np.random.default_rng(args.seed)
    arm = virtual_arm(
        robot, rng, hidden=None if args.hidden else (), tolerance=0.03 if args.hidden else 0.0
    )
    with progress_bar("simulate") as advance:
        table = arm.record(path, duration, rng, lambda fraction: advance(fraction, ""))
    write_atomically(target, table_bytes(table, target.suffix))
    result = {
        "verb": "simulate",
        "robot": robot.name,
        "samples": len(table),
        "duration": duration,
        "hidden": [
            {"effect": h.effect, "joint": h.joint, "parameters": dict(h.parameters)}
            for h in arm.hidden
        ],
        "files": [str(target)],
    }
    if args.json:
        print_json(result)
    else:
        print(f"{target}  {len(table)} samples over {duration:g} s")


def _limited(args: argparse.Namespace) -> Robot:
    robot = robot_of(args)
    if args.limits:
        robot = robot.with_limits(load_limits(args.limits, robot))
    if args.verb == "design" and (note := require_limits(robot)):
        print(note, file=sys.stderr)
    if not 0 <= args.mass_uncertainty < 100:
        raise BadInput(f"--mass-uncertainty {args.mass_uncertainty:g}: give 0 to 100 [%]")
    return robot.with_limits(replace(robot.limits, mass_uncertainty=args.mass_uncertainty / 100))


def sampled(trajectory: Trajectory | Motion) -> Motion:
    """Samples of a trajectory, at 100 Hz where it has none of its own."""
    if isinstance(trajectory, Motion):
        return trajectory
    return trajectory.motion(_DENSE_HZ)
