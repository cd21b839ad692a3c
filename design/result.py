"""A design as plain values for files and reports."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from excitant.design.constraints import LimitReport, position_range
from excitant.design.outcome import Design, dense_motion
from excitant.design.splines import SplineTrajectory
from excitant.design.trajectory import Trajectory
from excitant.design.visibility import visibility
from excitant.robots import Array, Robot, torque

_DERIVATIVES = ("position", "velocity", "acceleration", "jerk")
_POSES = 4  # of the arm, drawn along the motion


def design_result(design: Design) -> dict[str, Any]:
    """The content of ``result.json``: numbers, names and lists only, null where unlimited."""
    uses = design.limits.uses
    return {
        "verb": "design",
        "robot": design.robot.name,
        "joints": list(design.robot.joints),
        "revolute": [bool(turns) for turns in design.robot.revolute],
        "duration": design.duration,
        "harmonics": design.harmonics,
        "series": "spline" if isinstance(design.trajectory, SplineTrajectory) else "fourier",
        "columns": design.columns,
        "base_parameters": len(design.base),
        "criterion": design.criterion,
        "condition_number": {
            "initial": _number(design.condition_initial),
            "final": _number(design.condition_final),
            "lower_bound": None,
        },
        **visibility(design),
        "limits": {use.quantity: use.ratio for use in uses},
        "limit_values": {
            use.quantity: _nested(getattr(design.robot.limits, use.quantity)) for use in uses
        },
        "worst": {
            use.quantity: {"joint": use.joint, "t": use.time, "ratio": use.ratio}
            if use.ratio > 0
            else None
            for use in uses
        },
        "certified": certified(design.robot, design.limits, design.trajectory),
        "clearance_m": None if design.clearance is None else design.clearance.certified,
        "closest": None
        if design.clearance is None
        else {
            "bodies": list(design.clearance.bodies),
            "t": design.clearance.time,
            "distance_m": design.clearance.distance,
        },
        "obstacles": []
        if design.scene is None
        else [obstacle.plain() for obstacle in design.scene.obstacles],
        "starts": [
            {
                "start": start.index,
                "parent": start.parent,
                "condition_number": _number(start.condition),
                "status": start.status,
                "iterations": start.iterations,
                "history": [_number(value) for value in start.history],
            }
            for start in design.starts
        ],
        "iterations": design.iterations,
        "wall_s": design.wall_s,
        "files": {},
    }


def design_series(design: Design) -> dict[str, Array]:
    """Curves of a design: one period of the motion with its torque, path and eigenvalues.

    Returns:
        ``t`` (n,), ``q``, ``dq``, ``ddq``, ``tau`` (n, nv), ``eigenvalues_initial``,
        ``eigenvalues_final`` (r,), and in the base frame [m] ``tool`` (n, 3), the origin of
        the tool's frame, and ``arm`` (poses, nodes, 3), the arm as a line from the base through
        the joints to the tool at the instants ``arm_t`` (poses,). A branched arm has
        ``other_tools`` (n, ends − 1, 3) too, and its lines are parted by NaN. With a limit on
        jerk also ``dddq`` (n, nv).
    """
    robot, motion = design.robot, dense_motion(design.trajectory)
    tool, others, arm = _skeleton(robot, motion.q)
    near = None if design.clearance is None else design.clearance.time
    poses = _telling_poses(tool, motion.t, near)
    series = {
        "t": motion.t,
        "q": motion.q,
        "dq": motion.dq,
        "ddq": motion.ddq,
        "tau": torque(robot, motion),
        "eigenvalues_initial": design.eigenvalues_initial,
        "eigenvalues_final": design.eigenvalues_final,
        "tool": tool,
        "arm": arm[poses],
        "arm_t": motion.t[poses],
    }
    if others.size:
        series["other_tools"] = others
    if robot.limits.orders > 3:
        series["dddq"] = design.trajectory(motion.t, 3)
    return series


def certified(
    robot: Robot, report: LimitReport, trajectory: Trajectory | None = None
) -> dict[str, list[dict[str, float] | None]]:
    """What each limited quantity of each joint provably stays within, between samples too.

    Args:
        robot: The arm.
        report: Use of its limits by a continuous motion.
        trajectory: That motion, if its extrema are known exactly; without it the range is as
            wide on both sides of the limits' middle.

    Returns:
        By quantity and joint ``low`` and ``high`` in the quantity's unit, the largest ``ratio``
        to the limit and when it occurs, ``t`` [s]; None where the joint has no limit.
    """
    found = {}
    for use in report.uses:
        half = np.asarray(getattr(robot.limits, use.quantity), float)
        middle = np.zeros(robot.nv)
        if use.quantity == "position":
            middle, half = position_range(robot.limits)
        reach = use.ratios * np.where(np.isfinite(half), half, 0.0)
        low, high = middle - reach, middle + reach
        if trajectory is not None and use.quantity in _DERIVATIVES:
            low, high = trajectory.extrema(_DERIVATIVES.index(use.quantity))
        rows = zip(*(x.tolist() for x in (half, low, high, use.ratios, use.times)), strict=True)
        found[use.quantity] = [
            {"low": lo, "high": hi, "ratio": ratio, "t": t} if np.isfinite(h) else None
            for h, lo, hi, ratio, t in rows
        ]
    return found


def _skeleton(robot: Robot, q: Array) -> tuple[Array, Array, Array]:
    """Path of the tool (n, 3), those of further ends (n, ends − 1, 3), arm (n, nodes, 3) [m]."""
    model, data = robot.model, robot.model.createData()
    chains = [list(model.supports[leaf]) for leaf in _leaves(robot)]
    ends = [_last_body(robot, chain[-1]) for chain in chains]
    further = [end for end in ends if end != robot.tip]
    gap = np.full((1, 3), np.nan)
    tool, others, arm = np.empty((len(q), 3)), np.empty((len(q), len(further), 3)), []
    for k, pose in enumerate(q):
        pin.framesForwardKinematics(model, data, pose)
        lines = []
        for chain, end in zip(chains, ends, strict=True):
            nodes = [*(data.oMi[j].translation for j in chain), data.oMf[end].translation]
            lines += [np.array(nodes), gap]
        arm.append(np.concatenate(lines[:-1]))
        tool[k] = data.oMf[robot.tip].translation
        for i, end in enumerate(further):
            others[k, i] = data.oMf[end].translation
    return tool, others, np.array(arm)


def _leaves(robot: Robot) -> list[int]:
    """The joints that carry no other joint."""
    parents = set(list(robot.model.parents)[1:])
    return [j for j in range(1, robot.nv + 1) if j not in parents]


def _last_body(robot: Robot, joint: int) -> int:
    """Frame of the last body fixed to a joint's link; the tool's if it is."""
    frames = list(robot.model.frames)
    if frames[robot.tip].parentJoint == joint:
        return robot.tip
    fixed = [k for k, f in enumerate(frames) if f.parentJoint == joint]
    return max((k for k in fixed if frames[k].type == pin.FrameType.BODY), default=max(fixed))


def _telling_poses(tool: Array, t: Array, near: float | None) -> list[int]:
    """Indices of few instants with the tool far apart, in time order, and of that of an event.

    They begin with the first instant; each further one is farthest from those before it.
    """
    chosen = [0]
    if near is not None:
        chosen.append(int(np.abs(t - near).argmin()))
    while len(chosen) < _POSES + (near is not None):
        away = np.linalg.norm(tool[:, None] - tool[chosen], axis=2).min(axis=1)
        chosen.append(int(away.argmax()))
    return sorted(set(chosen))


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _nested(values: Array) -> list[Any]:
    if values.ndim > 1:
        return [_nested(row) for row in values]
    return [_number(value) for value in values]
