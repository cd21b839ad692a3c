"""The commands about motions: check, simulate; and what those that design or rehearse share."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from excitant.design import (
    CLEARANCE,
    HermiteTrajectory,
    Trajectory,
    condition_number,
    information,
    load_trajectory,
)
from excitant.design import check as check_limits
from excitant.design import clearance as motion_clearance
from excitant.exceptions import BadInput, OutsideLimits
from excitant.output import finish, print_json, run_directory, table_bytes, write_atomically
from excitant.progress import progress_bar
from excitant.robot_arguments import robot_of
from excitant.robots import Motion, Robot, torque
from excitant.robots.geometry import Scene, scene
from excitant.robots.obstacles import load_obstacles
from excitant.robots.virtual_arm import virtual_arm

DENSE_HZ = 100.0


def surroundings_of(args: argparse.Namespace, robot: Robot) -> tuple[Scene | None, float]:
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
    """Check anybody's trajectory against the limits of a robot.

    Raises:
        OutsideLimits: A limit is exceeded, or bodies come too close; after the run is saved.
    """
    robot = robot_within_limits(args)
    trajectory = load_trajectory(args.trajectory, robot)
    surroundings, least = surroundings_of(args, robot)
    report = check_limits(robot, trajectory)
    motion = sampled(trajectory)
    near = motion_clearance(surroundings, path_of(trajectory)) if surroundings is not None else None
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
        "certified": {use.quantity: use.certified() for use in report.uses},
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
    report.worst.require()
    if near is not None and near.distance < least:
        raise OutsideLimits(" and ".join(near.bodies), "distance", near.distance, least, near.time)


def simulate(args: argparse.Namespace) -> None:
    """Record a trajectory on a virtual arm."""
    robot = robot_of(args)
    target = Path(args.output)
    if target.suffix not in (".csv", ".parquet"):
        raise BadInput(f"{target}: name a .csv or .parquet file")
    trajectory = load_trajectory(args.trajectory, robot)
    duration = float(sampled(trajectory).t[-1])
    rng = np.random.default_rng(args.seed)
    arm = virtual_arm(
        robot, rng, hidden=None if args.hidden else (), tolerance=0.03 if args.hidden else 0.0
    )
    with progress_bar("simulate") as advance:
        table = arm.record(
            path_of(trajectory), duration, rng, lambda fraction: advance(fraction, "")
        )
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


def robot_within_limits(args: argparse.Namespace) -> Robot:
    """The robot, whose torque limits are to hold as far as its masses are uncertain."""
    robot = robot_of(args)
    if not 0 <= args.mass_uncertainty < 100:
        raise BadInput(f"--mass-uncertainty {args.mass_uncertainty:g}: give 0 to 100 [%]")
    return robot.with_limits(replace(robot.limits, mass_uncertainty=args.mass_uncertainty / 100))


def sampled(trajectory: Trajectory | Motion) -> Motion:
    """Samples of a trajectory, at 100 Hz where it has none of its own."""
    if isinstance(trajectory, Motion):
        return trajectory
    return trajectory.motion(DENSE_HZ)


def path_of(trajectory: Trajectory | Motion) -> Trajectory | HermiteTrajectory:
    """A trajectory as a function of time, between its samples too."""
    return HermiteTrajectory(trajectory) if isinstance(trajectory, Motion) else trajectory
