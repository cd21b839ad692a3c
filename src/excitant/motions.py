"""The commands about motions: design, check, simulate, rehearse."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from excitant.exceptions import BadInput, Infeasible, OutsideLimits
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
    print_json,
)
from excitant.progress import progress_bar

if TYPE_CHECKING:
    from pandas import DataFrame

    from excitant.design import Design, HermiteTrajectory, Trajectory
    from excitant.robots import Motion, Robot
    from excitant.robots.geometry import Scene

DENSE_HZ = 100.0
_BOUND_TIME = 60.0  # s: much less leaves the bound near 1


def design(
    robot: RobotName,
    /,
    *,
    duration: str = "10",
    harmonics: str = "5",
    series: Literal["fourier", "spline"] = "fourier",
    max_frequency: float = 2.5,
    criterion: Literal["condition", "d", "a", "e"] = "condition",
    columns: Columns = "friction",
    noise: Numbers = None,
    after: Files = None,
    link_by_link: bool = False,
    bound: bool = False,
    start: Annotated[Numbers, Parameter(name="--from")] = None,
    formats: Names = None,
    rate: float = 100.0,
    repeat: int = 1,
    starts: int | None = None,
    jobs: int | None = None,
    cluster: str | None = None,
    seed: Seed = 0,
    time_limit: float | None = None,
    surroundings: Surroundings = Surroundings(),
    part: Part = Part(),
    run: Run = Run(),
) -> None:
    """An excitation trajectory within all limits.

    Args:
        robot: Built-in name, URDF, xacro, MJCF or robot.yaml.
        duration: Period [s], or the shortest and the longest to choose from as S:S.
        harmonics: Fourier terms, or 'search' to add them while they pay.
        series: spline: B-splines of 2 H pieces, for tight cells.
        max_frequency: Highest frequency [Hz] that a search for harmonics adds.
        criterion: What to make small: the condition number, or of the covariance the determinant
            (d), the trace (a) or the largest eigenvalue (e).
        columns: What to make visible: all that identify estimates, or the links only.
        noise: Torque noise of each joint, S1,S2,..., which weights its equations.
        after: Recordings made already: design what should run next.
        link_by_link: One motion per link, from the last inward, each of this duration.
        bound: Also a numerical lower bound on the condition number of any such motion.
        start: Present pose, Q1,Q2,...: writes approach.csv and return.csv too.
        formats: Further files: ros2 (YAML), mcap, urscript, npz.
        rate: Rate of trajectory.csv [Hz].
        repeat: Periods in trajectory.csv, for averaging.
        starts: Number of searches; default: 16.
        jobs: Processes; default: all processors.
        cluster: Dask scheduler to search on, such as tcp://10.0.0.5:8786.
        seed: Draws the starts.
        time_limit: Return the best so far after this time [s].
    """
    from excitant.design import (
        design_link_by_link,
        design_trajectory,
        motion_csv,
        trajectory_csv,
        trajectory_json,
        write_formats,
    )
    from excitant.robots.limits import require_limits

    arm = surroundings.robot(part, robot)
    if note := require_limits(arm):
        print(note, file=sys.stderr)
    if not 1 <= rate <= 10_000:
        raise BadInput(f"--rate {rate:g} Hz: give a control rate from 1 to 10000 Hz")
    if repeat < 1:
        raise BadInput(f"--repeat {repeat}: give the number of periods, at least 1")
    if bound and criterion != "condition":
        raise BadInput(
            f"--bound is one of the condition number, not of criterion {criterion}; leave one out"
        )
    if bound and (noise or after):
        raise BadInput("--bound holds for one motion with equal noise; leave --noise and --after")
    if start is not None and len(start) != arm.nv:
        raise BadInput(f"--from has {len(start)} numbers, {arm.name} has {arm.nv} joints")
    scene, least = surroundings.scene(arm)
    asked: dict[str, Any] = {
        "duration": _span(duration),
        "harmonics": None if harmonics == "search" else _integer("--harmonics", harmonics),
        "series": series,
        "top_hz": max_frequency,
        "criterion": criterion,
        "columns": columns,
        "starts": starts,
        "jobs": jobs,
        "cluster": cluster,
        "seed": seed,
        "time_limit": time_limit,
        "scene": scene,
        "clearance": least,
    }
    folder = run.folder("design", arm.name)
    if link_by_link:
        alone = {"bound": bound, "noise": noise, "after": after, "from": start, "formats": formats}
        for option, value in alone.items():
            if value:
                raise BadInput(
                    f"--link-by-link designs each link by its own row; leave --{option} out"
                )
        with progress_bar("design") as advance:
            links = design_link_by_link(
                arm,
                **asked,
                progress=lambda share, link, best: advance(share, f"{link}, best κ {best:.4g}"),
            )
        result = links.result() | {"periods": repeat}
        files = links.files(rate, repeat)
        run.finish(folder, result, links.series(), files)
        return
    began = time.monotonic()
    with progress_bar("design") as advance:

        def tell(done: int, total: int | None, condition: float, ratio: float) -> None:
            spent = time.monotonic() - began
            share = done / total if total else min(spent / (time_limit or spent), 1.0)
            words = f"{done} starts, best κ {condition:.4g}, worst limit {100 * ratio:.1f} %"
            advance(share, words)

        found = design_trajectory(
            arm, **asked, noise=noise, earlier=_earlier(arm, after), progress=tell
        )
    trajectory = found.trajectory
    files = {
        "trajectory.csv": trajectory_csv(trajectory, rate, repeat),
        "trajectory.json": trajectory_json(trajectory, arm),
    }
    written = {"trajectory": trajectory.motion(rate, repeat)}
    result = found.result() | {"periods": repeat}
    if bound:
        result |= _bound(found, seed)
    if start is not None:
        try:
            ways = _ways(arm, start, trajectory, rate, scene, least)
            files |= {f"{name}.csv": motion_csv(motion) for name, motion in ways.items()}
            written |= ways
        except Infeasible as error:  # the design stands without them
            result["notes"] = [*result.get("notes", []), str(error)]
    for stem, motion in written.items():
        files |= write_formats(motion, arm, formats or [], stem)
    run.finish(folder, result, found.series(), files)


def _span(text: str) -> float | tuple[float, float]:
    """One number, or two as ``S:S``."""
    try:
        shortest, _, longest = text.partition(":")
        return (float(shortest), float(longest)) if longest else float(text)
    except ValueError:
        raise BadInput(f"--duration {text}: give seconds, as in 10 or 5:20") from None


def _integer(option: str, text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise BadInput(f"{option} {text}: give a whole number, or 'search'") from None


def _earlier(robot: Robot, recordings: Sequence[str] | None) -> list[Motion]:
    """Motions of recordings made already."""
    if not recordings:
        return []
    from excitant.identify.dataset import Dataset
    from excitant.identify.preprocessing import prepare

    read = Dataset(robot).recordings(recordings)
    return [part.motion[part.keep] for recording in read for part in prepare(recording)]


def _bound(found: Design, seed: int) -> dict[str, Any]:
    """Numerical lower bound on what any such motion could reach, as entries of the result."""
    from excitant.design import lower_bound

    with progress_bar("bound") as advance:
        bound = lower_bound(
            found.robot,
            duration=found.duration,
            harmonics=None if found.trajectory.series.name == "spline" else found.harmonics,
            columns=found.columns,
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


def _ways(
    robot: Robot,
    start: Sequence[float],
    trajectory: Trajectory,
    rate: float,
    scene: Scene | None,
    least: float,
) -> dict[str, Motion]:
    """Approach from a pose to the trajectory, and return from it."""
    import numpy as np

    from excitant.design import approach

    there, here = trajectory(0.0)[0], np.array(start)
    options: dict[str, Any] = {"scene": scene, "clearance": least, "rate_hz": rate}
    return {
        "approach": approach(robot, here, there, **options),
        "return": approach(robot, there, here, name="return", **options),
    }


def check(
    robot: RobotName,
    trajectory: str,
    /,
    *,
    columns: Columns = "friction",
    surroundings: Surroundings = Surroundings(),
    part: Part = Part(),
    run: Run = Run(),
) -> None:
    """Limits between samples, clearance and conditioning of any trajectory.

    Args:
        robot: Built-in name, URDF, xacro, MJCF or robot.yaml.
        trajectory: CSV or JSON.
        columns: Whose conditioning: all that identify estimates, or the links only.

    Raises:
        OutsideLimits: A limit is exceeded, or bodies come too close; after the run is saved.
    """
    from excitant.design import check as check_limits
    from excitant.design import clearance as motion_clearance
    from excitant.design import (
        condition_number,
        information,
        load_trajectory,
    )
    from excitant.robots import torque

    arm = surroundings.robot(part, robot)
    planned = load_trajectory(trajectory, arm)
    scene, least = surroundings.scene(arm)
    report = check_limits(arm, planned)
    motion = sampled(planned)
    near = None if scene is None else motion_clearance(scene, path_of(planned))
    touched = near is not None and near.distance < least
    verdicts = [
        f"{use.quantity} limit of {use.joint} exceeded by {100 * (use.ratio - 1):.3g} % "
        f"at {use.time:.4g} s"
        for use in report.uses
        if use.ratio > 1
    ]
    if near is not None and touched:
        verdicts.append(
            f"{near.bodies[0]} and {near.bodies[1]} come within {1000 * near.distance:.3g} mm "
            f"at {near.time:.4g} s, required {1000 * least:.3g} mm"
        )
    result = {
        "verb": "check",
        "robot": arm.name,
        "trajectory": trajectory,
        "joints": list(arm.joints),
        "holds": report.hold and not touched,
        "limits": {use.quantity: use.ratio for use in report.uses},
        "worst": {
            use.quantity: {"joint": use.joint, "t": use.time, "ratio": use.ratio}
            for use in report.uses
            if use.ratio > 0
        },
        "limit_values": {use.quantity: getattr(arm.limits, use.quantity) for use in report.uses},
        "certified": {use.quantity: use.certified() for use in report.uses},
        "columns": columns,
        "condition_number": condition_number(information(arm, columns).matrix(motion)),
        "clearance_m": None if near is None else near.certified,
        "verdicts": verdicts or ["all limits hold, between samples too"],
    }
    series = {
        "t": motion.t,
        "q": motion.q,
        "dq": motion.dq,
        "ddq": motion.ddq,
        "tau": torque(arm, motion),
    }
    run.finish(run.folder("check", arm.name), result, series, {})
    report.worst.require()
    if near is not None and touched:
        raise OutsideLimits(" and ".join(near.bodies), "distance", near.distance, least, near.time)


def simulate(
    robot: RobotName,
    trajectory: str,
    /,
    *,
    output: Annotated[str, Parameter(name=("--output", "-o"))],
    seed: Seed = 0,
    hidden: bool = False,
    json: bool = False,
    part: Part = Part(),
) -> None:
    """What a virtual arm would record.

    Args:
        robot: Built-in name, URDF, xacro, MJCF or robot.yaml.
        trajectory: CSV or JSON.
        output: File to write, .parquet or .csv.
        seed: Draws noise and what is hidden.
        hidden: Let the arm differ from its model: values off by some per cent, and one effect that
            is not in the model.
        json: Print the result as JSON and nothing else.
    """
    import numpy as np

    from excitant.design import load_trajectory
    from excitant.reports.run import write_all
    from excitant.robots.virtual_arm import virtual_arm

    arm = part.robot(robot)
    target = Path(output)
    if target.suffix not in (".csv", ".parquet"):
        raise BadInput(f"{target}: name a .csv or .parquet file")
    planned = load_trajectory(trajectory, arm)
    duration = float(sampled(planned).t[-1])
    rng = np.random.default_rng(seed)
    tolerance = 0.03 if hidden else 0.0
    virtual = virtual_arm(arm, rng, hidden=None if hidden else (), tolerance=tolerance)
    with progress_bar("simulate") as advance:
        table = virtual.record(path_of(planned), duration, rng, lambda share: advance(share, ""))
    write_all(target.parent, {target.name: table_bytes(table, target.suffix)})
    if json:
        effects = [
            {"effect": h.effect, "joint": h.joint, "parameters": dict(h.parameters)}
            for h in virtual.hidden
        ]
        result = {"verb": "simulate", "robot": arm.name, "samples": len(table)}
        print_json(result | {"duration": duration, "hidden": effects, "files": [str(target)]})
    else:
        print(f"{target}  {len(table)} samples over {duration:g} s")


def rehearse(
    robot: RobotName,
    trajectory: str,
    /,
    *,
    limits: str | None = None,
    seed: Seed = 0,
    part: Part = Part(),
    run: Run = Run(),
) -> int:
    """A motion tried on a virtual arm, up to what it recovers.

    Args:
        robot: Built-in name, URDF, xacro, MJCF or robot.yaml.
        trajectory: CSV or JSON, from rest to rest.
        limits: YAML or JSON with limits to use instead.
        seed: Draws the arm, its noise and the effect to name.
    """
    import numpy as np

    from excitant.analysis.rehearsal import rehearse as rehearse_motion
    from excitant.design import load_trajectory

    arm = part.robot(robot, limits)
    planned = load_trajectory(trajectory, arm)
    duration = float(sampled(planned).t[-1])
    with progress_bar("rehearse") as advance:
        found = rehearse_motion(
            arm, path_of(planned), duration, np.random.default_rng(seed), advance
        )
    result = found.result() | {"trajectory": trajectory, "seed": seed}
    run.finish(run.folder("rehearse", arm.name), result, found.series(), {})
    return 0 if found.passed else 1


def table_bytes(table: DataFrame, suffix: str) -> bytes:
    """A table as the content of a ``.csv`` or ``.parquet`` file."""
    if suffix == ".csv":
        return table.to_csv(index=False).encode()
    return bytes(table.to_parquet(index=False))


def sampled(trajectory: Trajectory | Motion) -> Motion:
    """Samples of a trajectory, at 100 Hz where it has none of its own."""
    from excitant.robots import Motion

    return trajectory if isinstance(trajectory, Motion) else trajectory.motion(DENSE_HZ)


def path_of(trajectory: Trajectory | Motion) -> Trajectory | HermiteTrajectory:
    """A trajectory as a function of time, between its samples too."""
    from excitant.design import HermiteTrajectory
    from excitant.robots import Motion

    return HermiteTrajectory(trajectory) if isinstance(trajectory, Motion) else trajectory
