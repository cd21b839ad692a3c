"""A run of the plant: the true arm follows a trajectory."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from excitant.exceptions import BadInput, BadRobot
from excitant.robots.motion import Array
from excitant.robots.plant.arm import Arm
from excitant.robots.plant.controller import Trajectory, tracking_controller
from excitant.robots.plant.physics import Drives, Truth
from excitant.robots.plant.sensors import Run
from excitant.robots.robot import Robot

Progress = Callable[[float], None]
"""Told from time to time which fraction is done."""

_STEP = 5e-4  # s: a hundredth of the controller's time constant
_CHUNK = 2000  # integration steps between two reports of progress
_STILL = 1e-3  # rad/s: what still counts as starting at rest


def simulate(
    robot: Robot,
    believed: tuple[pin.Model, Drives],
    truth: Truth,
    trajectory: Trajectory,
    duration: float,
    rate_hz: float,
    progress: Progress | None = None,
    *,
    warm: float = 0.0,
    fine: bool = False,
) -> Run:
    """Let the true arm follow a trajectory under a controller that believes another one.

    Args:
        robot: The arm, for its names and torque limits.
        believed: Model and friction of the controller.
        truth: The physics of the arm.
        trajectory: Desired motion; starts at rest, where the arm starts too.
        duration: Length of the run [s].
        rate_hz: Rate at which the state is kept [Hz].
        progress: Called with the fraction done.
        warm: How long the arm has been on before [s].
        fine: Keep every integration step.

    Raises:
        BadInput: The trajectory starts in motion, or the arm could not follow it at all.
        BadRobot: A joint moves nothing that has mass.
    """
    start = _start(robot, trajectory)
    substeps = int(np.ceil(1 / (rate_hz * _STEP) - 1e-9))
    steps = substeps * int(np.floor(duration * rate_hz + 1e-6))
    if not steps:
        raise BadInput(f"virtual arm: {duration:g} s is shorter than one sample")
    h = 1 / (rate_hz * substeps)
    every = 1 if fine else substeps
    arm, kept = Arm(truth, h), []
    x = arm.at_rest(start)
    _require_mass(robot, arm.inertia(x))
    state = (x, np.zeros(len(x)), np.zeros(len(x)))
    for first in range(0, steps, _CHUNK):
        count = min(_CHUNK, steps - first)
        t = np.minimum((first + np.arange(2 * count + 1) / 2) * h, duration)
        control = tracking_controller(robot, *believed, trajectory, t)
        for k in range(count):
            if (first + k) % every == 0:
                kept.append(arm.seen(state, control, 2 * k))
            state = arm.step(*state, control, 2 * k + 1, warm + (first + k + 0.5) * h)
        if not np.isfinite(state[0]).all():
            raise BadInput(
                f"trajectory: {robot.name} went unstable before t = {t[-1]:.3g} s; "
                "the motion asks more than its torque limits"
            )
        if progress is not None:
            progress((first + count) / steps)
    kept.append(arm.seen(state, control, 2 * count))
    channels = (np.array(values).reshape(-1, robot.nv) for values in zip(*kept, strict=True))
    return Run(np.arange(len(kept)) / rate_hz * every / substeps, *channels)


def _start(robot: Robot, trajectory: Trajectory) -> Array:
    position, speed = (trajectory(np.zeros(1), order)[0] for order in (0, 1))
    if np.abs(speed).max() > _STILL:
        j = int(np.argmax(np.abs(speed)))
        raise BadInput(
            f"trajectory: joint {robot.joints[j]} starts at {speed[j]:.3g} rad/s; "
            "a virtual arm starts at rest, so lead in from rest"
        )
    return np.array(position, dtype=float)


def _require_mass(robot: Robot, M: Array) -> None:
    values, vectors = np.linalg.eigh(M)
    if values[0] <= 1e-12 * values[-1]:
        joint = robot.joints[int(np.argmax(np.abs(vectors[: robot.nv, 0])))]
        raise BadRobot(
            robot.source, f"joint {joint} moves nothing that has inertia; give its link a mass"
        )
