"""Motions for identification link by link: one per link, from the last inward.

Motion i moves joints 1 to i and holds the others; from its row τ_i, with the links further out
known, follow all base parameters of link i (Property 4, Khosla 1987). Nothing of the row depends
on where the outer joints stand as far as link i goes, so each motion is designed for the arm with
those joints locked: few unknowns, and the only columns that count are those of link i in row i.
Limits, those on the torque that holds the outer joints too, are then kept on the whole arm.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any

import joblib
import numpy as np
import numpy.typing as npt

from excitant.design.clearance import clearance as motion_clearance
from excitant.design.constraints import check, within_limits
from excitant.design.criterion import Information, objective
from excitant.design.growth import best_period, grow
from excitant.design.held_arm import held, resting_pose, whole
from excitant.design.multistart import MultiStart
from excitant.design.optimal import CANDIDATES, CLEARANCE, FEWEST, TOP_HZ, build_design
from excitant.design.outcome import Design, dense_motion, outcome
from excitant.design.problem import DesignProblem
from excitant.design.search import SearchState, best_solutions
from excitant.design.tasks import Effort, connect
from excitant.design.trajectory import Trajectory
from excitant.exceptions import BadInput, Infeasible
from excitant.robots import Array, Robot
from excitant.robots.effects import Effect, standard_effects
from excitant.robots.geometry import Scene
from excitant.robots.geometry import scene as scene_of
from excitant.robots.motion import read_only
from excitant.robots.torque_rows import last_rows

_STARTS = 6  # per motion

Progress = Callable[[float, str, float], None]
"""Called with the fraction done, the link, and its best condition number so far."""


@dataclass(frozen=True, eq=False)
class LinkMotion:
    """The motion of one link.

    Attributes:
        joint: Index of the link's joint.
        design: Of the whole arm; its information is that of row τ_i about link i.
    """

    joint: int
    design: Design

    @property
    def name(self) -> str:
        """Stem of its files, ``link1`` to ``link<nv>``."""
        return f"link{self.joint + 1}"


@dataclass(frozen=True, eq=False)
class LinkByLinkDesign:
    """A motion for every link.

    Attributes:
        robot: The arm.
        columns: ``"friction"`` or ``"inertial"``.
        criterion: What was minimised.
        base: Number of base parameters of the arm.
        motions: The last link's first.
        wall_s: Time taken [s].
    """

    robot: Robot
    columns: str
    criterion: str
    base: int
    motions: tuple[LinkMotion, ...]
    wall_s: float


def design_link_by_link(
    robot: Robot,
    *,
    duration: float | tuple[float, float] = 10.0,
    harmonics: int | None = 5,
    series: str = "fourier",
    top_hz: float = TOP_HZ,
    criterion: str = "condition",
    columns: str = "friction",
    scene: Scene | None = None,
    clearance: float = CLEARANCE,
    starts: int | None = None,
    jobs: int | None = None,
    cluster: str | None = None,
    seed: int = 0,
    time_limit: float | None = None,
    progress: Progress | None = None,
) -> LinkByLinkDesign:
    """Motions at rest at both ends that show link after link best within all limits.

    Args:
        robot: The arm; its limits and effects count.
        duration: Of each motion [s], or the shortest and the longest to choose from.
        harmonics: As for `excitant.design.design`, of each motion.
        series: ``"fourier"`` or ``"spline"``.
        top_hz: Highest frequency up to which harmonics are added [Hz].
        criterion: Of the columns of each link in its own row.
        columns: ``"friction"`` or ``"inertial"``.
        scene: The arm's bodies among obstacles; None to leave clearance out.
        clearance: Smallest distance that they keep [m].
        starts: Searches per motion; 6 by default, or as many as fit in the time limit.
        jobs: Number of processes; as many as processors by default.
        cluster: Address of a Dask scheduler to search on instead.
        seed: Seed of all randomness.
        time_limit: For all motions together, split evenly over those still to come [s].
        progress: Called whenever a search has news.

    Raises:
        Infeasible: No motion of some link keeps the limits.
        UnknownName: Another criterion, other columns or another series.
        BadInput: Duration, harmonics or starts out of range, or no cluster there.
    """
    began = time.time()
    if starts is not None and starts < 1:
        raise BadInput(f"{starts} starts: at least one is needed")
    if starts is None and time_limit is None:
        starts = _STARTS
    shortest, longest = duration if isinstance(duration, tuple) else (duration, duration)
    options: dict[str, Any] = {
        "duration": longest,
        "harmonics": FEWEST if harmonics is None else harmonics,
        "series": series,
        "criterion": criterion,
        "columns": columns,
        "clearance": clearance,
    }
    goal = build_design(robot, **options).information
    last = last_rows(robot, _effects(robot, columns), goal.base)
    joints = [j for j in reversed(range(robot.nv)) if (last == j).any()]
    pose = resting_pose(robot, scene, clearance)
    motions = []
    with ExitStack() as stack:
        client = stack.enter_context(connect(cluster)) if cluster else None
        for k, joint in enumerate(joints):
            problem = _problem(robot, joint, pose, scene, options)
            left = np.inf if time_limit is None else began + time_limit - time.time()
            effort = Effort(
                starts,
                jobs or int(joblib.cpu_count()),
                seed,
                time.time() + left / (len(joints) - k),
                _teller(progress, robot.links[joint], k, len(joints)),
                client,
            )
            if shortest < longest:
                problem = best_period(problem, effort, shortest, longest)
            if harmonics is None:
                problem, searches = grow(problem, effort, top_hz)
            else:
                searches = MultiStart(problem, effort).run()
            initial = problem.random(np.random.default_rng([seed, 0]))
            found = (problem.trajectory(z) for z in best_solutions(searches, CANDIDATES))
            drawn = [initial, *found]
            kept = _keeping(robot, [whole(x, pose) for x in drawn], scene, clearance)
            seen = _of_link(goal, joint, last == joint)
            motions.append(LinkMotion(joint, _best(kept, seen, criterion, scene, searches)))
    wall = time.time() - began
    return LinkByLinkDesign(robot, columns, criterion, len(last), tuple(motions), wall)


def _problem(
    robot: Robot, joint: int, pose: Array, scene: Scene | None, options: dict[str, Any]
) -> DesignProblem:
    """The design of one link's motion on the arm with the joints after it locked."""
    arm = held(robot, joint, pose)
    around = None if scene is None else scene_of(arm, scene.obstacles)
    problem = build_design(arm, scene=around, **options)
    base = problem.information.base
    last = last_rows(arm, _effects(arm, options["columns"]), base)
    return replace(problem, information=_of_link(problem.information, joint, last == joint))


def _effects(robot: Robot, columns: str) -> tuple[Effect, ...]:
    return standard_effects(robot.joints) if columns == "friction" else ()


def _of_link(information: Information, joint: int, chosen: npt.NDArray[np.bool_]) -> Information:
    """What row τ_i alone says about some of the base parameters."""
    robot, base = information.robot, information.base
    part = replace(
        base,
        columns=tuple(np.array(base.columns)[chosen].tolist()),
        regrouping=read_only(base.regrouping[chosen]),
    )
    blank = np.zeros((len(part), len(part)))
    return Information(robot, information.columns, part, np.eye(robot.nv)[joint], blank)


def _keeping(
    robot: Robot, motions: Sequence[Trajectory], scene: Scene | None, clearance: float
) -> list[Trajectory]:
    """Motions shrunk to keep all limits of the whole arm, without those that cannot."""
    shrunk = [within_limits(robot, motion) for motion in motions]
    kept = [
        motion
        for motion in shrunk
        if motion is not None
        and (scene is None or motion_clearance(scene, motion).certified >= clearance)
    ]
    if not kept:
        worst = check(robot, motions[0]).worst
        raise Infeasible(
            "link-by-link design",
            f"{worst.joint} reaches {100 * worst.ratio:.3g} % of its {worst.quantity} limit, or "
            "bodies come too close, while the outer joints are held; relax limits or clearance",
        )
    return kept


def _best(
    motions: Sequence[Trajectory],
    seen: Information,
    criterion: str,
    scene: Scene | None,
    searches: Sequence[SearchState],
) -> Design:
    """The motion with the best exact figures, as a design; the first one is where it began."""
    values = [objective(seen.matrix(dense_motion(motion)), criterion) for motion in motions]
    ends = (motions[0], motions[int(np.argmin(values))])
    return outcome(seen, criterion, ends, scene, searches, 0.0)


def _teller(
    progress: Progress | None, link: str, stage: int, stages: int
) -> Callable[[DesignProblem, Sequence[SearchState]], None]:
    def tell(problem: DesignProblem, states: Sequence[SearchState]) -> None:
        if progress is None:
            return
        done = sum(s.status not in ("running", "stalled") for s in states)
        share = done / max(len(states), 1)
        best = min((s.history[-1] for s in states if s.history), default=np.inf)
        progress((stage + min(share, 1.0)) / stages, link, float(best))

    return tell
