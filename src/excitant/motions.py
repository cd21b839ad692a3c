"""The commands about motions: design, check, show, simulate, rehearse."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

import excitant as ex
from excitant.design.options import Columns, Search
from excitant.exceptions import BadInput
from excitant.files import require_file, write_file
from excitant.names import printable
from excitant.options import (
    OUTPUT,
    Around,
    Files,
    Names,
    Numbers,
    Part,
    RobotName,
    Run,
    Seed,
    TrajectoryFile,
    print_json,
)
from excitant.progress import Advance, progress_bar
from excitant.surroundings import Surroundings

if TYPE_CHECKING:
    from pandas import DataFrame

    from excitant.design import Design

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
    arm = ex.api.within(part.robot(robot), surroundings)
    if note := ex.robots.require_limits(arm):
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
    ex.design.require_playable(arm, **vars(play))
    # an interrupted search ends the sooner
    import_module("scipy.interpolate")
    ex.reports.load_templates()
    if link_by_link:
        _design_link_by_link(arm, search, surroundings, play, run)
        return 0
    with progress_bar("design") as advance:
        designed = ex.design_trajectory(
            arm,
            noise=noise,
            after=after or (),
            surroundings=surroundings,
            progress=_teller(advance, search.time_limit),
            **vars(search),
        )
    result = designed.result() | {"repeat": play.repeat}
    if bound and not designed.interrupted:
        result["condition_number"]["lower_bound"], note = _bound(
            designed, search.seed
        )
        result["notes"].append(note)
    played = ex.design.play(
        designed, clearance=ex.api.clearance_of(surroundings), **vars(play)
    )
    result["notes"] += played.notes
    if played.first_run is not None:
        result["first_run"] = played.first_run
    run.finish(result, designed.series(), played.files)
    if designed.interrupted:
        raise KeyboardInterrupt("the best motion so far was written")
    return 0 if played.complete else 1


def _teller(advance: Advance, time_limit: float | None) -> Any:
    """Progress of a design on a bar: of its starts, or of its time."""
    began = time.monotonic()

    def tell(done: int, total: int | None, condition: float, ratio: float) -> None:
        spent = time.monotonic() - began
        share = done / total if total else min(spent / (time_limit or spent), 1.0)
        words = f"{done} starts, best κ {condition:.4g}, worst limit {100 * ratio:.1f} %"
        advance(share, words)

    return tell


def _design_link_by_link(
    robot: ex.Robot,
    search: Search,
    surroundings: Surroundings,
    play: Play,
    run: Run,
) -> None:
    with progress_bar("design") as advance:
        links = ex.design_link_by_link(
            robot,
            surroundings=surroundings,
            progress=lambda done, link, best: advance(
                done, f"{link}, best κ {best:.4g}"
            ),
            **vars(search),
        )
    result = links.result() | {"repeat": play.repeat}
    run.finish(result, links.series(), links.files(play.rate, play.repeat))
    if any(motion.interrupted for motion in links.motions.values()):
        raise KeyboardInterrupt("the best motions so far were written")


def _bound(designed: Design, seed: int) -> tuple[float, str]:
    """The lower bound of the condition number, and what it says."""
    with progress_bar("bound") as advance:
        bound = ex.design.bound_of(
            designed,
            seed=seed,
            time_limit=BOUND_TIME_S,
            progress=lambda spent, value, ceiling: advance(
                min(spent / BOUND_TIME_S, 1.0), f"κ ≥ {value:.4g}"
            ),
        )
    ratio = designed.condition_final / bound.value
    return bound.value, (
        f"within ×{ratio:.2g} of the best possible (no bound that looks at single states is above "
        f"{bound.without_repair:.3g}, which a mixture of them reaches): {bound.assumptions}"
    )


def check(
    robot: RobotName,
    trajectory: TrajectoryFile,
    /,
    *,
    columns: Columns = "friction",
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
    checked = ex.check(
        part.robot(robot), trajectory, columns=columns, surroundings=surroundings
    )
    arm = checked.robot
    effects = ex.design.estimated_effects(arm, columns)
    motion = checked.evenly(ex.api.SAMPLE_HZ)
    excited = ex.identify.persistency(
        arm, motion, effects, sigma=ex.analysis.default_noise(arm)
    )
    result = checked.result()
    result |= {"trajectory": trajectory, "persistency": excited.result()}
    run.finish(result, checked.series())
    checked.require()


def show(
    robot: RobotName,
    trajectory: TrajectoryFile,
    /,
    *,
    output: Annotated[str | None, OUTPUT] = None,
    json: bool = False,
    surroundings: Around = Surroundings(),
    part: Part = Part(),
) -> None:
    """The arm in motion, to watch before it runs: limits touched, and what comes close.

    Args:
        output: File to write, .html; default: runs/show-<robot>-<time>.html.
        json: Print the result as JSON and nothing else.
    """
    arm = part.robot(robot)
    folder = Run().folder({"verb": "show", "robot": arm.name})
    target = require_file(output or f"{folder}.html", [".html"])
    checked = ex.show(arm, trajectory, surroundings=surroundings)
    around = ex.api.obstacles_around(checked.robot, surroundings)
    result = checked.result() | {
        "verb": "show",
        "trajectory": trajectory,
        "files": [str(target)],
        "obstacles": [obstacle.plain() for obstacle in around],
    }
    plain, series = ex.reports.as_saved(result, checked.series())
    page = ex.reports.page_of(plain, series)
    write_file(target, ex.reports.html(page, saved=False))
    if json:
        print_json(plain)
    else:
        print(ex.reports.brief(page), "", printable(str(target)), sep="\n")


def simulate(
    robot: RobotName,
    trajectory: TrajectoryFile,
    /,
    *,
    output: Annotated[str, OUTPUT],
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
    arm = part.robot(robot)
    target = require_file(output, [".csv", ".parquet"])
    with progress_bar("simulate") as advance:
        table, duration, effects = ex.simulate(
            arm,
            trajectory,
            seed=seed,
            hidden=hidden,
            progress=lambda share: advance(share, ""),
        )
    write_file(target, table_bytes(table, target.suffix))
    if json:
        print_json(
            {
                "verb": "simulate",
                "robot": arm.name,
                "samples": len(table),
                "duration": duration,
                "hidden": [effect.entry() for effect in effects],
                "files": [str(target)],
            }
        )
    else:
        print(f"{printable(str(target))}  {len(table)} samples over {duration:g} s")


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
    arm = part.robot(robot)
    with progress_bar("rehearse") as advance:
        rehearsal = ex.rehearse(
            arm, trajectory, seed=seed, surroundings=surroundings, progress=advance
        )
    result = rehearsal.result() | {"trajectory": trajectory, "seed": seed}
    run.finish(result, rehearsal.series())
    return 0 if rehearsal.passed else 1


def table_bytes(table: DataFrame, suffix: str) -> bytes:
    """A table as the content of a ``.csv`` or ``.parquet`` file."""
    if suffix == ".csv":
        return table.to_csv(index=False).encode()
    return bytes(table.to_parquet(index=False))
