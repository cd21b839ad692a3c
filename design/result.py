"""A design as plain values for files and reports."""

from __future__ import annotations

from typing import Any

import numpy as np

from excitant.design.optimal import Design, dense_motion
from excitant.robots import Array, torque


def design_result(design: Design) -> dict[str, Any]:
    """The content of ``result.json``: numbers, names and lists only, null where unlimited."""
    uses = design.limits.uses
    return {
        "verb": "design",
        "robot": design.robot.name,
        "joints": list(design.robot.joints),
        "duration": design.duration,
        "harmonics": design.harmonics,
        "columns": design.columns,
        "base_parameters": len(design.base),
        "criterion": design.criterion,
        "condition_number": {
            "initial": _number(design.condition_initial),
            "final": _number(design.condition_final),
            "lower_bound": None,
        },
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
        "clearance_m": None if design.clearance is None else design.clearance.certified,
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
    """Curves of a design: one period of the motion with its torque, and the eigenvalues.

    Returns:
        ``t`` (n,), ``q``, ``dq``, ``ddq``, ``tau`` (n, nv), and ``eigenvalues_initial``,
        ``eigenvalues_final`` (r,).
    """
    motion = dense_motion(design.trajectory)
    return {
        "t": motion.t,
        "q": motion.q,
        "dq": motion.dq,
        "ddq": motion.ddq,
        "tau": torque(design.robot, motion),
        "eigenvalues_initial": design.eigenvalues_initial,
        "eigenvalues_final": design.eigenvalues_final,
    }


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _nested(values: Array) -> list[Any]:
    if values.ndim > 1:
        return [_nested(row) for row in values]
    return [_number(value) for value in values]
