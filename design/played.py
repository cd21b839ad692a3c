"""A design as it is played: at a rate, repeated, slowly at first, from a pose and back to it."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from excitant.design.constraints import check
from excitant.design.export import FIRST_SPEED, PROGRAMS, motion_csv, write_formats
from excitant.design.result import Design
from excitant.design.timing import approach
from excitant.exceptions import BadInput, Infeasible
from excitant.robots.geometry import CLEARANCE
from excitant.robots.motion import Motion
from excitant.robots.robot import Robot

LOWEST_RATE = 1.0  # Hz
HIGHEST_RATE = 10_000.0  # Hz


@dataclass
class Played:
    """Files of a design, and what is to be said of them.

    Attributes:
        files: Content by name.
        notes: Remarks, as sentences.
        first_run: Entry of the slow motion for ``result.json``; None without one.
        complete: Whether every file that was asked for is there.
    """

    files: dict[str, str | bytes]
    notes: list[str] = field(default_factory=list)
    first_run: dict[str, float] | None = None
    complete: bool = True


def require_playable(
    robot: Robot,
    *,
    start: Sequence[float] | None,
    formats: Sequence[str] | None,
    rate: float,
    repeat: int,
    speed: float | None,
) -> None:
    """Refuse, as BadInput or UnknownName, what `play` could not write of any design."""
    if not LOWEST_RATE <= rate <= HIGHEST_RATE:
        raise BadInput(
            f"--rate {rate:g} Hz: give a control rate from 1 to 10000 Hz"
        )
    if repeat < 1:
        raise BadInput(
            f"--repeat {repeat}: give how often the motion runs, at least 1"
        )
    still = np.zeros((2, robot.nv))
    write_formats(
        {"": Motion(np.arange(2.0), still, still, still)}, robot, formats or ()
    )
    if speed is not None and not 0 < speed <= 1:
        raise BadInput(
            f"--speed {speed:g}: give the share of the speed, above 0 and up to 1"
        )
    if start is not None and len(start) != robot.nv:
        raise BadInput(
            f"--from has {len(start)} numbers, {robot.name} has {robot.nv} joints"
        )


def play(
    design: Design,
    *,
    start: Sequence[float] | None = None,
    formats: Sequence[str] | None = None,
    rate: float = 100.0,
    repeat: int = 1,
    speed: float | None = None,
    clearance: float = CLEARANCE,
) -> Played:
    """Files with which a design is played.

    Args:
        design: Its trajectory, which is checked at a lower speed too.
        start: Present pose of the arm: approach and return as well.
        formats: Further files; see `write_formats`.
        rate: Control rate [Hz].
        repeat: How often the motion runs.
        speed: Share of the speed of a first run; a fifth with a program among the formats.
        clearance: Least distance on the way there and back [m].

    Errors are those of `require_playable`.
    """
    require_playable(
        design.robot,
        start=start,
        formats=formats,
        rate=rate,
        repeat=repeat,
        speed=speed,
    )
    played = Played(dict(design.files(rate, repeat)))
    motions = {"trajectory": design.trajectory.motion(rate, repeat)}
    names = list(formats or ())
    programs = [name for name in names if name in PROGRAMS]
    data = [name for name in names if name not in PROGRAMS]
    if start is not None:
        try:
            first, last = _approach_and_return(design, start, rate, clearance)
            motions = {"approach": first, **motions, "return": last}
            played.files["approach.csv"] = motion_csv(first)
            played.files["return.csv"] = motion_csv(last)
        except Infeasible as error:  # the design stands without them
            played.notes.append(str(error))
            played.complete = False
    if speed is None and programs:
        speed = FIRST_SPEED
    if speed is not None and not _add_first_run(
        played, design, speed, rate, data, programs
    ):
        names = data
        played.complete = False
    played.files |= write_formats(motions, design.robot, names)
    return played


def _approach_and_return(
    design: Design, start: Sequence[float], rate: float, clearance: float
) -> tuple[Motion, Motion]:
    """Motions from the present pose to the first of the design, and back."""
    there = design.trajectory(0.0)[0]
    here = np.array(start)
    robot = design.robot.with_limits(design.robot.limits.used(design.use))
    options: dict[str, Any] = {
        "scene": design.scene,
        "clearance": clearance,
        "rate_hz": rate,
    }
    return (
        approach(robot, here, there, name="approach", **options),
        approach(robot, there, here, name="return", **options),
    )


def _add_first_run(
    played: Played,
    design: Design,
    speed: float,
    rate: float,
    data: Sequence[str],
    programs: Sequence[str],
) -> bool:
    """Add the same path at a share of the speed; whether it is within all limits."""
    slow = design.trajectory.slowed(speed)
    used = check(design.robot, slow).worst
    played.first_run = {
        "speed": speed,
        "duration": slow.duration,
        "limit": used.ratio,
    }
    note = (
        f"the same path in {slow.duration:.4g} s; it uses up to {100 * used.ratio:.3g} % of a "
        f"limit ({used.quantity} of {used.joint})"
    )
    within = used.ratio <= 1
    if within:
        motion = slow.motion(rate)
        played.files["first_run.csv"] = motion_csv(motion)
        played.files |= write_formats({"first_run": motion}, design.robot, data)
    else:  # what holds the arm is not less at a lower speed
        note += ", so it is not written"
        note += f" nor are programs ({', '.join(programs)})" if programs else ""
    played.notes.append(f"first_run.csv: {note}")
    return within
