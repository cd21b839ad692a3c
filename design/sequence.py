"""Motions for identification link by link: one per link, from the last inward.

Motion i moves joints 1 to i and holds the others; its row τ_i, with the links further out known,
shows all base parameters of link i (Property 4, Khosla 1987). So it is designed for the arm with
the outer joints locked and the columns of link i in row i; limits are kept on the whole arm.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from excitant.design.constraints import check, position_range
from excitant.design.criterion import Information
from excitant.design.optimal import (
    CANDIDATES,
    SceneOption,
    best_within_limits,
    build_design,
    effort_of,
)
from excitant.design.options import Search
from excitant.design.problem import DesignProblem
from excitant.design.result import Design
from excitant.design.search import Report, SearchState, best_solutions, search
from excitant.design.trajectory import Trajectory
from excitant.exceptions import Infeasible
from excitant.robots.base_parameters import last_rows
from excitant.robots.geometry import CLEARANCE, Scene
from excitant.robots.geometry import scene as scene_of
from excitant.robots.loading import hold
from excitant.robots.motion import Array, Mask, read_only
from excitant.robots.robot import Robot
from excitant.robots.threads import on_one_thread

_STARTS = 6  # per motion
_POSES = 200  # drawn for one that keeps clear
_SHARED = (
    "joints",
    "revolute",
    "limit_use",
    "limit_values",
    "obstacles",
    "unchecked",
    "appearance",
    "bodies",
)
_OWN = (
    "duration",
    "periods",
    "harmonics",
    "base_parameters",
    "condition_number",
    "limits",
    "condition_number_scaled",
    "weakest",
    "clearance_m",
    "iterations",
)

Progress = Callable[[float, str, float], None]
"""Called with the fraction done, the link, and its best condition number so far."""


@dataclass(frozen=True, eq=False)
class LinkByLinkDesign:
    """A motion for every link."""

    robot: Robot  # the arm
    columns: str  # ``"friction"`` or ``"inertial"``
    criterion: str  # what was minimised
    base: int  # number of base parameters of the arm
    # by the link's joint, the last first; their information is that of row τ_i on it
    motions: dict[int, Design]
    wall_s: float  # time taken [s]

    def result(self) -> dict[str, Any]:
        """The content of ``result.json``: the worst of all at the top, each in ``stages``."""
        designs = list(self.motions.values())
        single = [design.result() for design in designs]
        starts = np.cumsum(
            [0.0, *(design.trajectory.period for design in designs)]
        ).tolist()
        worst = int(np.argmax([design.condition_final for design in designs]))
        limits = {}
        when = {}
        for quantity in single[0]["limits"]:
            used = [one["limits"][quantity] for one in single]
            k = int(np.argmax(used))
            limits[quantity] = used[k]
            row = single[k]["worst"][quantity]
            when[quantity] = row and row | {"t": row["t"] + starts[k]}
        distances = [
            one["clearance_m"] for one in single if one["clearance_m"] is not None
        ]
        stages = [
            {
                "link": self.robot.links[joint],
                "joint": self.robot.joints[joint],
                "file": f"{_stem(joint)}.csv",
                "moves": list(self.robot.joints[: joint + 1]),
                **{key: one[key] for key in _OWN},
            }
            for joint, one in zip(self.motions, single, strict=True)
        ]
        return {
            "verb": "design",
            "robot": self.robot.name,
            **{key: single[0][key] for key in _SHARED},
            "duration": sum(one["duration"] for one in single),
            "harmonics": max(one["harmonics"] for one in single),
            "columns": self.columns,
            "base_parameters": self.base,
            "criterion": self.criterion,
            "condition_number": single[worst]["condition_number"],
            "limits": limits,
            "worst": when,
            "clearance_m": min(distances, default=None),
            "starts": [],
            "iterations": sum(one["iterations"] for one in single),
            "wall_s": self.wall_s,
            "notes": [
                *dict.fromkeys(note for one in single for note in one["notes"]),
                "one motion per link, from the last inward; identify with --link-by-link from all "
                "of their recordings. The condition number above is that of "
                f"{_stem(list(self.motions)[worst])}, the worst",
            ],
            "link_by_link": {"stages": stages},
            "files": [],
        }

    def series(self) -> dict[str, Array]:
        """Curves of a period of each motion one after the other, as of `Design.series`."""
        parts = []
        start = 0.0
        for design in self.motions.values():
            part = design.series()
            parts.append(part | {key: part[key] + start for key in ("t", "play_t")})
            start += design.trajectory.period
        curves = [key for key in parts[0] if not key.startswith("mesh")]
        return parts[0] | {
            key: np.concatenate([part[key] for part in parts]) for key in curves
        }

    def files(self, rate_hz: float, repetitions: int = 1) -> dict[str, str | bytes]:
        """``link<i>.csv`` and ``link<i>.json`` of every motion, the last link's first."""
        return {
            name.replace("trajectory", _stem(joint)): text
            for joint, design in self.motions.items()
            for name, text in design.files(rate_hz, repetitions).items()
        }


def _stem(joint: int) -> str:
    return f"link{joint + 1}"


@on_one_thread
def design_link_by_link(
    robot: Robot,
    *,
    scene: SceneOption = None,
    clearance: float = CLEARANCE,
    progress: Progress | None = None,
    **options: Any,
) -> LinkByLinkDesign:
    """Motions at rest at both ends that show link after link best within all limits.

    Options and errors are those of `design_trajectory`, for each motion; the criterion is that of
    each link's columns in its own row. ``starts`` counts the searches per motion, 6 by default;
    the time limit [s] is that of all motions together.
    """
    asked = Search(**options)
    began = time.time()
    held = robot.with_limits(robot.limits.used(asked.use))
    common = options | {"clearance": clearance}
    motions: dict[int, Design] = {}
    with effort_of(asked, _STARTS) as effort:
        whole = build_design(robot, scene=scene, **common)
        goal = whole.information
        around = whole.scene
        last = last_rows(robot, goal.effects, goal.base)
        joints = [j for j in reversed(range(robot.nv)) if (last == j).any()]
        pose = _resting_pose(robot, around, clearance)
        for k, joint in enumerate(joints):
            part = effort.share(effort.starts, 1 / (len(joints) - k))
            if progress is not None:
                tell = _teller(progress, robot.links[joint], k, len(joints))
                part = replace(part, report=tell)
            problem = _problem(held, joint, pose, around, common)
            problem, searches = search(problem, part, asked)
            drawn = [
                problem.random(np.random.default_rng([asked.seed, 0])),
                *map(problem.trajectory, best_solutions(searches, CANDIDATES)),
            ]
            entire = [_whole(x, pose) for x in drawn]
            seen = _of_link(goal, joint, last == joint)
            aim = replace(whole, information=seen)
            chosen = best_within_limits(held, entire, aim, clearance)
            if chosen is None:
                worst = check(held, entire[0]).worst
                raise Infeasible(
                    "link-by-link design",
                    f"{worst.joint} reaches {100 * worst.ratio:.3g} % of its {worst.quantity} "
                    "limit, or bodies come too close, while the outer joints are held; relax "
                    "limits or clearance",
                )
            motions[joint] = Design(
                seen,
                asked.criterion,
                entire[0],
                chosen,
                around,
                asked.use,
                searches,
                0.0,
            )
    wall_s = time.time() - began
    return LinkByLinkDesign(
        robot, asked.columns, asked.criterion, len(last), motions, wall_s
    )


def _problem(
    robot: Robot,
    joint: int,
    pose: Array,
    scene: Scene | None,
    options: dict[str, Any],
) -> DesignProblem:
    beyond = slice(joint + 1, None)
    held = zip(robot.joints[beyond], pose[beyond].tolist(), strict=True)
    arm = hold(robot, dict(held))
    around = None if scene is None else scene_of(arm, scene.obstacles)
    problem = build_design(arm, scene=around or (), **options)
    seen = problem.information
    last = last_rows(arm, seen.effects, seen.base)
    return replace(problem, information=_of_link(seen, joint, last == joint))


def _of_link(information: Information, joint: int, chosen: Mask) -> Information:
    """Information of row τ_i alone on some of the base parameters."""
    robot = information.robot
    base = information.base
    part = replace(
        base,
        columns=tuple(np.array(base.columns)[chosen].tolist()),
        regrouping=read_only(base.regrouping[chosen]),
    )
    blank = np.zeros((len(part), len(part)))
    return Information(
        robot, information.columns, part, np.eye(robot.nv)[joint], blank
    )


def _teller(progress: Progress, link: str, stage: int, stages: int) -> Report:
    def tell(problem: DesignProblem, states: Sequence[SearchState]) -> None:
        share = sum(state.ended for state in states) / max(len(states), 1)
        best = min((s.history[-1] for s in states if s.history), default=np.inf)
        progress((stage + share) / stages, link, float(best))

    return tell


def _resting_pose(robot: Robot, scene: Scene | None, clearance: float) -> Array:
    """Positions of held outer joints: zero or mid-range, unless that collides."""
    low, high = robot.limits.position.T
    middle = position_range(robot.limits)[0]
    pose = np.where((low <= 0) & (high >= 0), 0.0, middle)
    if scene is None:
        return read_only(pose)
    drawn = robot.random_motion(0, _POSES)[0]
    for candidate in (pose, *drawn):
        if scene.distances(candidate[None]).min(initial=np.inf) > 2 * clearance:
            return read_only(candidate)
    raise Infeasible(
        "link-by-link design", "no pose keeps the arm clear; give it more room"
    )


def _whole(trajectory: Trajectory, pose: Array) -> Trajectory:
    X = trajectory.series.constant(pose)
    X[:, : trajectory.nv] = trajectory.coefficients
    return trajectory.series.trajectory(X)
