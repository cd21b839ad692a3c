"""The commands about motions: design, check, show, simulate, rehearse."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from excitant.exceptions import BadInput, Infeasible
from excitant.files import write_file
from excitant.names import printable
from excitant.options import (
    Columns,
    Files,
    Names,
    Numbers,
    Part,
    RobotName,
    Run,
    Seed,
    Surroundings,
    TrajectoryFile,
    Window,
    print_json,
)
from excitant.progress import progress_bar

if TYPE_CHECKING:
    from pandas import DataFrame

    from excitant.design import Design, HermiteTrajectory, Trajectory
    from excitant.robots import Motion, Robot

_DENSE_HZ = 100.0
_BOUND_TIME = 60.0  # s: much less leaves the bound near 1


@Parameter(name="*")
@dataclass(frozen=True)
class Search:
    """Options of the motion and its optimisation."""

    duration: float = 10.0
    "Length of the motion [s]."
    periods: int | Literal["search"] = "search"
    "Equal periods that it has; 'search' for as many as lower the condition number."
    harmonics: int | Literal["search"] = 5
    "Harmonics of a period, or 'search' to add them as long as they lower the condition number."
    series: Literal["fourier", "spline"] = "fourier"
    "spline: B-splines of 2 H pieces, for tight cells."
    max_frequency: float = 2.5
    "Highest frequency [Hz] that a search for periods or harmonics goes to."
    criterion: Literal["condition", "d", "a", "e"] = "condition"
    (
        "What to make small: the condition number, or of the covariance the determinant (d), the "
        "trace (a) or the largest eigenvalue (e)."
    )
    columns: Columns = "friction"
    "What to make visible: all that identify estimates, or the links only."
    use: float = 0.9
    "Share of the limits on velocity, acceleration, torque and jerk that is used."
    starts: int | None = None
    "Number of searches; default: 16."
    jobs: int | None = None
    "Processes; default: all processors."
    cluster: str | None = None
    "Dask scheduler to search on, such as tcp://10.0.0.5:8786."
    seed: Seed = 0
    "Draws the starts."
    time_limit: float | None = None
    "Return the best so far after this time [s]."

    def options(self) -> dict[str, Any]:
        """Arguments of the functions that design."""
        given = {
            key: None if value == "search" else value
            for key, value in vars(self).items()
        }
        given["top_hz"] = given.pop("max_frequency")
        return given


def design(
    robot: RobotName,
    /,
    *,
    search: Search = Search(),
    noise: Numbers = None,
    after: Files = None,
    link_by_link: bool = False,
    bound: bool = False,
    start: Annotated[Numbers, Parameter(name="--from")] = None,
    formats: Names = None,
    rate: float = 100.0,
    repeat: int = 1,
    speed: float | None = None,
    surroundings: Surroundings = Surroundings(),
    part: Part = Part(),
    run: Run = Run(),
) -> int:
    """An excitation trajectory within all limits.

    Args:
        noise: Torque noise of each joint, S1,S2,..., which weights its equations.
        after: Recordings made already: design what should run next.
        link_by_link: One motion per link, from the last inward, each of this duration.
        bound: Also a numerical lower bound on the condition number of any such motion.
        start: Present pose, Q1,Q2,...: writes approach.csv and return.csv too.
        formats: Further files: ros2 (YAML), mcap, npz, and the programs urscript and ros2_client,
            which run at a fifth of the speed until told otherwise.
        rate: Rate of trajectory.csv [Hz].
        repeat: How often trajectory.csv has the motion, for averaging.
        speed: Also first_run.csv, the same path at this share of the speed (of 1), checked itself;
            default: 0.2 with a program among the formats, else none.
    """
    import numpy as np

    import excitant.design as designs
    from excitant.design.export import FIRST_SPEED, PROGRAMS
    from excitant.robots import Motion
    from excitant.robots.limits import require_limits

    arm = surroundings.robot(part, robot)
    if note := require_limits(arm):
        print(note, file=sys.stderr)
    if not 1 <= rate <= 10_000:
        raise BadInput(f"--rate {rate:g} Hz: give a control rate from 1 to 10000 Hz")
    if repeat < 1:
        raise BadInput(f"--repeat {repeat}: give how often the motion runs, at least 1")
    names = formats or []
    still = np.zeros((2, arm.nv))
    designs.write_formats(
        {"": Motion(np.arange(2.0), *3 * [still])}, arm, names
    )  # may refuse
    programs = [name for name in names if name in PROGRAMS]
    if programs and speed is None:
        speed = FIRST_SPEED
    if speed is not None and not 0 < speed <= 1:
        raise BadInput(
            f"--speed {speed:g}: give the share of the speed, above 0 and up to 1"
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
    if start is not None and len(start) != arm.nv:
        raise BadInput(
            f"--from has {len(start)} numbers, {arm.name} has {arm.nv} joints"
        )
    alone: dict[str, object] = {
        "bound": bound,
        "noise": noise,
        "after": after,
        "from": start,
    }
    alone |= {"formats": formats, "speed": speed}
    for option in (name for name, value in alone.items() if value and link_by_link):
        raise BadInput(
            f"--link-by-link designs each link by its own row; leave --{option} out"
        )
    scene, least = surroundings.scene(arm)
    asked = search.options() | {"scene": scene, "clearance": least}
    if link_by_link:
        with progress_bar("design") as advance:
            asked["progress"] = lambda done, link, best: advance(
                done, f"{link}, best κ {best:.4g}"
            )
            links = designs.design_link_by_link(arm, **asked)
        result = links.result() | {"repeat": repeat}
        run.finish(result, links.series(), links.files(rate, repeat))
        if any(motion.interrupted for motion in links.motions.values()):
            raise KeyboardInterrupt("the best motions so far were written")
        return 0
    began = time.monotonic()
    with progress_bar("design") as advance:

        def tell(done: int, total: int | None, condition: float, ratio: float) -> None:
            spent = time.monotonic() - began
            share = (
                done / total
                if total
                else min(spent / (search.time_limit or spent), 1.0)
            )
            words = f"{done} starts, best κ {condition:.4g}, worst limit {100 * ratio:.1f} %"
            advance(share, words)

        found = designs.design_trajectory(
            arm, **asked, noise=noise, earlier=_earlier(arm, after), progress=tell
        )
    trajectory = found.trajectory
    files: dict[str, str | bytes] = {**found.files(rate, repeat)}
    way = {
        "trajectory": trajectory.motion(rate, repeat)
    }  # in the order in which it runs
    result = found.result() | {"repeat": repeat}
    missing = False
    if bound and not found.interrupted:
        result["condition_number"]["lower_bound"], note = _bound(found, search.seed)
        result["notes"].append(note)
    if start is not None:
        there = trajectory(0.0)[0]
        here = np.array(start)
        near: dict[str, Any] = {"scene": scene, "clearance": least, "rate_hz": rate}
        held = arm.using(search.use)
        try:
            first, last = (
                designs.approach(held, *ends, name=name, **near)
                for name, ends in (
                    ("approach", (here, there)),
                    ("return", (there, here)),
                )
            )
            way = {"approach": first, **way, "return": last}
            files |= {
                f"{k}.csv": designs.motion_csv(way[k]) for k in ("approach", "return")
            }
        except Infeasible as error:  # the design stands without them
            result["notes"].append(str(error))
            missing = True
    if speed is not None:
        slow = trajectory.slowed(speed)
        used = designs.check(arm, slow).worst
        result["first_run"] = {
            "speed": speed,
            "duration": slow.duration,
            "limit": used.ratio,
        }
        said = (
            f"the same path in {slow.duration:.4g} s; it uses up to {100 * used.ratio:.3g} % of a "
            f"limit ({used.quantity} of {used.joint})"
        )
        if used.ratio > 1:  # what holds the arm is not less at a lower speed
            missing = True
            names = [name for name in names if name not in programs]
            left = f" nor are programs ({', '.join(programs)})" if programs else ""
            said += f", so it is not written{left}"
        else:
            first_run = slow.motion(rate)
            files["first_run.csv"] = designs.motion_csv(first_run)
            data = [name for name in names if name not in programs]
            files |= designs.write_formats({"first_run": first_run}, arm, data)
        result["notes"].append(f"first_run.csv: {said}")
    files |= designs.write_formats(way, arm, names)
    run.finish(result, found.series(), files)
    if found.interrupted:
        raise KeyboardInterrupt("the best motion so far was written")
    return int(missing)


def _earlier(robot: Robot, recordings: Sequence[str] | None) -> list[Motion]:
    if not recordings:
        return []
    from excitant.identify.dataset import Dataset
    from excitant.identify.preprocessing import prepare

    read = Dataset(robot).recordings(recordings)
    return [part.motion[part.keep] for recording in read for part in prepare(recording)]


def _bound(found: Design, seed: int) -> tuple[float, str]:
    """The lower bound of the condition number, and what it says."""
    from excitant.design import lower_bound

    with progress_bar("bound") as advance:
        bound = lower_bound(
            found.robot.using(found.use),
            period=found.trajectory.period,
            harmonics=None
            if found.trajectory.series.name == "spline"
            else found.harmonics,
            columns=found.information.columns,
            seed=seed,
            time_limit=_BOUND_TIME,
            pool=[found.trajectory.motion(_DENSE_HZ)],
            progress=lambda spent, value, ceiling: advance(
                min(spent / _BOUND_TIME, 1.0), f"κ ≥ {value:.4g}"
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
    surroundings: Surroundings = Surroundings(),
    part: Part = Part(),
    run: Run = Run(),
) -> None:
    """Limits between samples, clearance and conditioning of any trajectory.

    Args:
        columns: Whose conditioning: all that identify estimates, or the links only.

    Raises:
        OutsideLimits: A limit is exceeded, or bodies come too close; after the run is saved.
    """
    import excitant.design as designs
    from excitant.identify import persistency
    from excitant.robots.effects import standard_effects

    arm = surroundings.robot(part, robot)
    motion, path = path_of(designs.load_trajectory(trajectory, arm))
    effects = standard_effects(arm.joints) if columns == "friction" else ()
    shown = persistency(arm, _evenly(path, motion), effects, window=window)
    scene, least = surroundings.scene(arm)
    asked = designs.information(arm, columns)
    found = designs.TrajectoryCheck(arm, motion, path, scene, least, asked)
    result = found.result() | {"trajectory": trajectory, "persistency": shown.result()}
    run.finish(result, found.series())
    found.require()


def _evenly(path: Trajectory | HermiteTrajectory, motion: Motion) -> Motion:
    """A motion at even steps, whatever those of its samples are."""
    import numpy as np

    from excitant.robots import Motion

    steps = max(4, int((motion.t[-1] - motion.t[0]) * _DENSE_HZ))
    t = np.linspace(motion.t[0], motion.t[-1], steps + 1)
    return Motion(t, path(t), path(t, 1), path(t, 2))


def show(
    robot: RobotName,
    trajectory: TrajectoryFile,
    /,
    *,
    output: Annotated[str | None, Parameter(name=("--output", "-o"))] = None,
    json: bool = False,
    surroundings: Surroundings = Surroundings(),
    part: Part = Part(),
) -> None:
    """The arm in motion, to watch before it runs: limits touched, and what comes close.

    Args:
        output: File to write, .html; default: runs/show-<robot>-<time>.html.
        json: Print the result as JSON and nothing else.
    """
    from excitant.design import TrajectoryCheck, load_trajectory
    from excitant.reports import brief, html, page_of
    from excitant.reports.run import as_saved

    arm = surroundings.robot(part, robot)
    target = Path(output or f"{Run().folder({'verb': 'show', 'robot': arm.name})}.html")
    if target.suffix != ".html":
        raise BadInput(f"{target}: name a .html file")
    motion, path = path_of(load_trajectory(trajectory, arm))
    around = surroundings.around(arm)
    found = TrajectoryCheck(arm, motion, path, *surroundings.seen(arm, around))
    result = found.result() | {
        "verb": "show",
        "trajectory": trajectory,
        "files": [str(target)],
    }
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
    import numpy as np

    from excitant.design import load_trajectory
    from excitant.robots.virtual_arm import virtual_arm

    arm = part.robot(robot)
    target = Path(output)
    if target.suffix not in (".csv", ".parquet"):
        raise BadInput(f"{target}: name a .csv or .parquet file")
    motion, path = path_of(load_trajectory(trajectory, arm))
    duration = float(motion.t[-1])
    rng = np.random.default_rng(seed)
    tolerance = 0.03 if hidden else 0.0
    virtual = virtual_arm(arm, rng, hidden=None if hidden else (), tolerance=tolerance)
    with progress_bar("simulate") as advance:
        table = virtual.record(path, duration, rng, lambda share: advance(share, ""))
    write_file(target, table_bytes(table, target.suffix))
    if json:
        result = {"verb": "simulate", "robot": arm.name, "samples": len(table)}
        hides = [effect.entry() for effect in virtual.hidden]
        print_json(
            result | {"duration": duration, "hidden": hides, "files": [str(target)]}
        )
    else:
        print(f"{printable(str(target))}  {len(table)} samples over {duration:g} s")


def rehearse(
    robot: RobotName,
    trajectory: TrajectoryFile,
    /,
    *,
    limits: str | None = None,
    seed: Seed = 0,
    part: Part = Part(),
    run: Run = Run(),
) -> int:
    """A motion tried on a virtual arm, up to what it recovers; from rest to rest.

    Args:
        limits: YAML or JSON with limits to use instead.
        seed: Draws the arm, its noise and the effect to name.
    """
    import numpy as np

    from excitant.analysis.rehearsal import rehearse as rehearse_motion
    from excitant.design import load_trajectory

    arm = part.robot(robot, limits)
    motion, path = path_of(load_trajectory(trajectory, arm))
    with progress_bar("rehearse") as advance:
        rng = np.random.default_rng(seed)
        found = rehearse_motion(arm, path, float(motion.t[-1]), rng, advance)
    run.finish(
        found.result() | {"trajectory": trajectory, "seed": seed}, found.series()
    )
    return 0 if found.passed else 1


def table_bytes(table: DataFrame, suffix: str) -> bytes:
    """A table as the content of a ``.csv`` or ``.parquet`` file."""
    csv = suffix == ".csv"
    return (
        table.to_csv(index=False).encode()
        if csv
        else bytes(table.to_parquet(index=False))
    )


def path_of(
    trajectory: Trajectory | Motion,
) -> tuple[Motion, Trajectory | HermiteTrajectory]:
    """Samples of a trajectory, at 100 Hz where it has none of its own, and what it is between."""
    from excitant.design import HermiteTrajectory
    from excitant.robots import Motion

    if isinstance(trajectory, Motion):
        return trajectory, HermiteTrajectory(trajectory)
    return trajectory.motion(_DENSE_HZ), trajectory
