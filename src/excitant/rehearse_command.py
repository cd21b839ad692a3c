"""The command that tries a motion before an arm has to run it."""

from __future__ import annotations

import argparse

import numpy as np

from excitant.analysis.rehearsal import rehearse as rehearse_motion
from excitant.analysis.rehearsal_result import rehearse_result, rehearse_series
from excitant.design import load_trajectory
from excitant.motion_commands import path_of, sampled
from excitant.output import finish, run_directory
from excitant.progress import progress_bar
from excitant.robot_arguments import robot_of


def rehearse(args: argparse.Namespace) -> int:
    """Try a motion on a virtual arm; 0 when it would do, else 1."""
    robot = robot_of(args)
    trajectory = load_trajectory(args.trajectory, robot)
    path = path_of(trajectory)
    duration = float(sampled(trajectory).t[-1])
    with progress_bar("rehearse") as advance:
        found = rehearse_motion(robot, path, duration, np.random.default_rng(args.seed), advance)
    result = rehearse_result(found) | {"trajectory": str(args.trajectory), "seed": args.seed}
    finish(args, run_directory(args, "rehearse", robot), result, rehearse_series(found), {})
    return 0 if found.passed else 1
