"""The commands about motions: design, check, show, simulate, rehearse."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from excitant.design.options import Search
from excitant.exceptions import BadInput, Infeasible
from excitant.files import write_file
from excitant.names import printable
from excitant.options import (
    Around,
    Columns,
    Files,
    Names,
    Numbers,
    Part,
    RobotName,
    Run,
    Seed,
    TrajectoryFile,
    Window,
    print_json,
)
from excitant.progress import Advance, progress_bar
from excitant.surroundings import Surroundings

if TYPE_CHECKING:
    from pandas import DataFrame

    from excitant.design import Design, HermiteTrajectory, Trajectory
    from excitant.robots import Motion, Robot

SAMPLE_HZ = 100.0  # of a motion that is judged at even steps
BOUND_TIME_S = 60.0  # much less leaves the bound near 1


@Parameter(name="*")
@dataclass(frozen=True)
class Play:
    """How the motion is to be played."""

    start: Annotated[Numbers, Parameter(name="--from")] = None
    "Present pose, Q1,Q2,...: writes approach.csv and return.csv too."
    formats: Names = None
    (
        "Further files: ros2 (YAML), mcap, npz, and the programs urscript and ros2_client, "
        "which run at a fifth of the speed until told otherwise."
    )
    rate: float = 100.0
    "Rate of trajectory.csv [Hz]."
    repeat: int = 1
    "How often trajectory.csv has the motion, for averaging."
    speed: float | None = None
    (
        "Also first_run.csv, the same path at this share of the speed (of 1), checked itself; "
        "default: 0.2 with a program among the formats, else none."
    )

    @property
    def programs(self) -> list[str]:
        """Formats that are programs of robots."""
        from excitant.design.export import PROGRAMS

        return [name for name in self.formats or () if name in PROGRAMS]

    def checked(self, robot: Robot) -> Play:
        """The same with the default speed of programs; refuses what cannot be played."""
        import numpy as np

        from excitant.design.export import FIRST_SPEED, write_formats
        from excitant.robots.motion import Motion

        if not 1 <= self.rate <= 10_000:
            raise BadInput(
                f"--rate {self.rate:g} Hz: give a control rate from 1 to 10000 Hz"
            )
        if self.repeat < 1:
            raise BadInput(
                f"--repeat {self.repeat}: give how often the motion runs, at least 1"
            )
        still = np.zeros((2, robot.nv))
        at_rest = Motion(np.arange(2.0), still, still, still)
        write_formats({"": at_rest}, robot, self.formats or ())  # may refuse
        speed = FIRST_SPEED if self.programs and self.speed is None else self.speed
        if speed is not None and not 0 < speed <= 1:
            raise BadInput(
                f"--speed {speed:g}: give the share of the speed, above 0 and up to 1"
            )
        if self.start is not None and len(self.start) != robot.nv:
            raise BadInput(
                f"--from has {len(self.start)} numbers, {robot.name} has {robot.nv} joints"
            )
        return replace(self, speed=speed)


def design(
    robot: RobotName,
    /,
    *,
    search: Annotated[Search, Parameter(name="*")] = Search(),
    noise: Numbers = None,
    after: Files = None,
    link_by_link: bool = False,
    bound: bool = False,
    play: Play = Play(),
    surroundings: Around = Surroundings(),
    part: Part = Part(),
    run: Run = Run(),
) -> int:
    """An excitation trajectory within all limits.

    Args:
        noise: Torque noise of each joint, S1,S2,..., which weights its equations.
        after: Recordings made already: design what should run next.
        link_by_link: One motion per link, from the last inward, each of this duration.
        bound: Also a numerical lower bound on the condition number of any such motion.
    """
    from excitant import api
    from excitant.robots.limits import require_limits

    arm = api.within(part.robot(robot), surroundings)
    if note := require_limits(arm):
        print(note, file=sys.stderr)
    if search.seed < 0:
        raise BadInput(f"--seed {search.seed}: give 0 or more")
    alone: dict[str, object] = {"bound": bound, "noise": noise, "after": after}
    alone |= {"from": play.start, "formats": play.formats, "speed": play.speed}
    for option in (name for name, value in alone.items() if value and link_by_link):
        raise BadInput(
            f"--link-by-link designs each link by its own row; leave --{option} out"
        )
    if bound and search.criterion != "condition":
        raise BadInput(
            f"--bound is one of the condition number, not of criterion {search.criterion}; "
            "leave one out"
        )
    if bound and (noise or after):
        raise BadInput(
            "--bound holds for one motion with equal noise; leave --noise and --after"
        )
    play = play.checked(arm)
    if link_by_link:
        _design_link_by_link(arm, search, surroundings, play, run)
        return 0
    with progress_bar("design") as advance:
        found = api.design_trajectory(
            arm,
            noise=noise,
            after=after or (),
            surroundings=surroundings,
            progress=_teller(advance, search.time_limit),
            **vars(search),
        )
    result = found.result() | {"repeat": play.repeat}
    files: dict[str, str | bytes] = {**found.files(play.rate, play.repeat)}
    if bound and not found.interrupted:
        result["condition_number"]["lower_bound"], note = _bound(found, search.seed)
        result["notes"].append(note)
    done = _add_files(found, play, api.clearance_of(surroundings), result, files)
    run.finish(result, found.series(), files)
    if found.interrupted:
        raise KeyboardInterrupt("the best motion so far was written")
    return 0 if done else 1


def _teller(advance: Advance, time_limit: float | None) -> Any:
    """Progress of a design on a bar: of its starts, or of its time."""
    began = time.monotonic()

    def tell(done: int, total: int | None, condition: float, ratio: float) -> None:
        spent = time.monotonic() - began
        share = done / total if total else min(spent / (time_limit or spent), 1.0)
        words = (
            f"{done} starts, best κ {condition:.4g}, worst limit {100 * ratio:.1f} %"
        )
        advance(share, words)

    return tell


def _design_link_by_link(
    robot: Robot, search: Search, surroundings: Surroundings, play: Play, run: Run
) -> None:
    from excitant import api
    from excitant.design.sequence import design_link_by_link

    with progress_bar("design") as advance:
        links = design_link_by_link(
            robot,
            scene=api.scene_around(robot, surroundings) or (),
            clearance=api.clearance_of(surroundings),
            progress=lambda done, link, best: advance(
                done, f"{link}, best κ {best:.4g}"
            ),
            **vars(search),
        )
    result = links.result() | {"repeat": play.repeat}
    run.finish(result, links.series(), links.files(play.rate, play.repeat))
    if any(motion.interrupted for motion in links.motions.values()):
        raise KeyboardInterrupt("the best motions so far were written")


def _add_files(
    found: Design,
    play: Play,
    clearance: float,
    result: dict[str, Any],
    files: dict[str, str | bytes],
) -> bool:
    """Add approach, return, first run and further formats; whether nothing is missing."""
    from excitant.design.export import motion_csv, write_formats

    robot = found.robot
    names = list(play.formats or ())
    way = {"trajectory": found.trajectory.motion(play.rate, play.repeat)}
    complete = True
    if play.start is not None:
        try:
            way = _there_and_back(found, play, clearance, way)
            files |= {f"{k}.csv": motion_csv(way[k]) for k in ("approach", "return")}
        except Infeasible as error:  # the design stands without them
            result["notes"].append(str(error))
            complete = False
    if play.speed is not None:
        first_run, entry, note = _first_run(found, play)
        result["first_run"] = entry
        if first_run is None:  # what holds the arm is not less at a lower speed
            complete = False
            programs = ", ".join(play.programs)
            names = [name for name in names if name not in play.programs]
            note += ", so it is not written"
            note += f" nor are programs ({programs})" if programs else ""
        else:
            files["first_run.csv"] = motion_csv(first_run)
            data = [name for name in names if name not in play.programs]
            files |= write_formats({"first_run": first_run}, robot, data)
        result["notes"].append(f"first_run.csv: {note}")
    files |= write_formats(way, robot, names)
    return complete


def _there_and_back(
    found: Design, play: Play, clearance: float, way: dict[str, Motion]
) -> dict[str, Motion]:
    """Motions in the order in which they run, with those from and to the present pose."""
    import numpy as np

    from excitant.design.timing import approach

    there = found.trajectory(0.0)[0]
    here = np.array(play.start)
    robot = found.robot.using(found.use)
    options: dict[str, Any] = {"scene": found.scene, "clearance": clearance}
    options["rate_hz"] = play.rate
    first = approach(robot, here, there, name="approach", **options)
    last = approach(robot, there, here, name="return", **options)
    return {"approach": first, **way, "return": last}


def _first_run(
    found: Design, play: Play
) -> tuple[Motion | None, dict[str, float], str]:
    """The slow motion, None beyond a limit; its entry, and a note on it."""
    import excitant.design as designs

    assert play.speed is not None
    slow = found.trajectory.slowed(play.speed)
    used = designs.check(found.robot, slow).worst
    entry = {"speed": play.speed, "duration": slow.duration, "limit": used.ratio}
    note = (
        f"the same path in {slow.duration:.4g} s; it uses up to {100 * used.ratio:.3g} % of a "
        f"limit ({used.quantity} of {used.joint})"
    )
    return (slow.motion(play.rate) if used.ratio <= 1 else None), entry, note


def _bound(found: Design, seed: int) -> tuple[float, str]:
    """The lower bound of the condition number, and what it says."""
    from excitant.design.bound import lower_bound

    with progress_bar("bound") as advance:
        bound = lower_bound(
            found.robot.using(found.use),
            period=found.trajectory.period,
            harmonics=None
            if found.trajectory.series.name == "spline"
            else found.harmonics,
            columns=found.information.columns,
            seed=seed,
            time_limit=BOUND_TIME_S,
            pool=[found.trajectory.motion(SAMPLE_HZ)],
            progress=lambda spent, value, ceiling: advance(
                min(spent / BOUND_TIME_S, 1.0), f"κ ≥ {value:.4g}"
            ),
        )
    ratio = found.condition_final / bound.value
    mixed = bound.without_repair
    return bound.value, (
        f"within ×{ratio:.2g} of the best possible (no bound that looks at single states is above "
        f"{mixed:.3g}, which a mixture of them reaches): {bound.assumptions}"
    )


def check(
    robot: RobotName,
    trajectory: TrajectoryFile,
    /,
    *,
    columns: Columns = "friction",
    window: Window = None,
    surroundings: Around = Surroundings(),
    part: Part = Part(),
    run: Run = Run(),
) -> None:
    """Limits between samples, clearance and conditioning of any trajectory.

    Args:
        columns: Whose conditioning: all that identify estimates, or the links only.

    Raises:
        OutsideLimits: A limit is exceeded, or bodies come too close; after the run is saved.
    """
    from excitant import api
    from excitant.identify.excitation import persistency
    from excitant.robots.effects import standard_effects

    found = api.check(
        part.robot(robot), trajectory, columns=columns, surroundings=surroundings
    )
    effects = standard_effects(found.robot.joints) if columns == "friction" else ()
    motion = _evenly(found.path, found.motion)
    shown = persistency(found.robot, motion, effects, window=window)
    result = found.result() | {"trajectory": trajectory, "persistency": shown.result()}
    run.finish(result, found.series())
    found.require()


def _evenly(path: Trajectory | HermiteTrajectory, motion: Motion) -> Motion:
    """A motion at even steps, whatever those of its samples are."""
    import numpy as np

    from excitant.robots.motion import Motion

    steps = max(4, int((motion.t[-1] - motion.t[0]) * SAMPLE_HZ))
    t = np.linspace(motion.t[0], motion.t[-1], steps + 1)
    return Motion(t, path(t), path(t, 1), path(t, 2))


def show(
    robot: RobotName,
    trajectory: TrajectoryFile,
    /,
    *,
    output: Annotated[str | None, Parameter(name=("--output", "-o"))] = None,
    json: bool = False,
    surroundings: Around = Surroundings(),
    part: Part = Part(),
) -> None:
    """The arm in motion, to watch before it runs: limits touched, and what comes close.

    Args:
        output: File to write, .html; default: runs/show-<robot>-<time>.html.
        json: Print the result as JSON and nothing else.
    """
    from excitant import api
    from excitant.reports import brief, html, page_of
    from excitant.reports.run import as_saved

    arm = part.robot(robot)
    target = Path(output or f"{Run().folder({'verb': 'show', 'robot': arm.name})}.html")
    if target.suffix != ".html":
        raise BadInput(f"{target}: name a .html file")
    found = api.show(arm, trajectory, surroundings=surroundings)
    result = found.result() | {
        "verb": "show",
        "trajectory": trajectory,
        "files": [str(target)],
    }
    around = api.obstacles_around(found.robot, surroundings)
    result["obstacles"] = [obstacle.plain() for obstacle in around]
    plain, series = as_saved(result, found.series())
    page = page_of(plain, series)
    write_file(target, html(page, saved=False))
    if json:
        print_json(plain)
    else:
        print(brief(page), "", printable(str(target)), sep="\n")


def simulate(
    robot: RobotName,
    trajectory: TrajectoryFile,
    /,
    *,
    output: Annotated[str, Parameter(name=("--output", "-o"))],
    seed: Seed = 0,
    hidden: bool = False,
    json: bool = False,
    part: Part = Part(),
) -> None:
    """Recording of a virtual arm.

    Args:
        output: File to write, .parquet or .csv.
        seed: Draws noise and what is hidden.
        hidden: Let the arm differ from its model: values off by some per cent, and one effect that
            is not in the model.
        json: Print the result as JSON and nothing else.
    """
    from excitant import api

    arm = part.robot(robot)
    target = Path(output)
    if target.suffix not in (".csv", ".parquet"):
        raise BadInput(f"{target}: name a .csv or .parquet file")
    with progress_bar("simulate") as advance:
        found = api.simulate(
            arm,
            trajectory,
            seed=seed,
            hidden=hidden,
            progress=lambda share: advance(share, ""),
        )
    table = found.table
    write_file(target, table_bytes(table, target.suffix))
    if json:
        result = {"verb": "simulate", "robot": arm.name, "samples": len(table)}
        hides = [effect.entry() for effect in found.hidden]
        more = {"duration": found.duration, "hidden": hides, "files": [str(target)]}
        print_json(result | more)
    else:
        print(
            f"{printable(str(target))}  {len(table)} samples over {found.duration:g} s"
        )


def rehearse(
    robot: RobotName,
    trajectory: TrajectoryFile,
    /,
    *,
    seed: Seed = 0,
    surroundings: Around = Surroundings(),
    part: Part = Part(),
    run: Run = Run(),
) -> int:
    """A motion tried on a virtual arm, up to what it recovers; from rest to rest.

    Args:
        seed: Draws the arm, its noise and the effect to name.
    """
    from excitant import api

    arm = part.robot(robot)
    with progress_bar("rehearse") as advance:
        found = api.rehearse(
            arm, trajectory, seed=seed, surroundings=surroundings, progress=advance
        )
    result = found.result() | {"trajectory": trajectory, "seed": seed}
    run.finish(result, found.series())
    return 0 if found.passed else 1


def table_bytes(table: DataFrame, suffix: str) -> bytes:
    """A table as the content of a ``.csv`` or ``.parquet`` file."""
    if suffix == ".csv":
        return table.to_csv(index=False).encode()
    return bytes(table.to_parquet(index=False))
