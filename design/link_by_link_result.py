"""Motions of a link-by-link design as plain values, curves and files."""

from __future__ import annotations

from typing import Any

import numpy as np

from excitant.design.export import trajectory_csv, trajectory_json
from excitant.design.link_by_link import LinkByLinkDesign, LinkMotion
from excitant.design.result import design_result, design_series
from excitant.robots import Array

_SHARED = ("joints", "revolute", "series", "limit_values", "obstacles")


def link_by_link_design_result(found: LinkByLinkDesign) -> dict[str, Any]:
    """The content of ``result.json``: the worst of all motions at the top, each in ``stages``."""
    single = [design_result(motion.design) for motion in found.motions]
    starts = np.cumsum([0.0, *(one["duration"] for one in single)])
    worst = int(np.argmax([motion.design.condition_final for motion in found.motions]))
    quantities = single[0]["limits"]
    lead = {
        quantity: max(range(len(single)), key=lambda k: single[k]["limits"][quantity] or 0.0)
        for quantity in quantities
    }
    return {
        "verb": "design",
        "robot": found.robot.name,
        **{key: single[0][key] for key in _SHARED},
        "duration": float(starts[-1]),
        "harmonics": max(one["harmonics"] for one in single),
        "columns": found.columns,
        "base_parameters": found.base,
        "criterion": found.criterion,
        "condition_number": single[worst]["condition_number"],
        "limits": {quantity: single[k]["limits"][quantity] for quantity, k in lead.items()},
        "worst": {
            quantity: _later(single[k]["worst"][quantity], float(starts[k]))
            for quantity, k in lead.items()
        },
        "clearance_m": _least([one["clearance_m"] for one in single]),
        "starts": [],
        "iterations": sum(one["iterations"] for one in single),
        "wall_s": found.wall_s,
        "notes": [
            "one motion per link, from the last inward; identify with --link-by-link from all of "
            f"their recordings. The condition number above is that of {found.motions[worst].name}, "
            "the worst"
        ],
        "link_by_link": {
            "stages": [
                _stage(motion, one) for motion, one in zip(found.motions, single, strict=True)
            ]
        },
        "files": {},
    }


def _stage(motion: LinkMotion, one: dict[str, Any]) -> dict[str, Any]:
    robot, design = motion.design.robot, motion.design
    return {
        "link": robot.links[motion.joint],
        "joint": robot.joints[motion.joint],
        "file": f"{motion.name}.csv",
        "moves": list(robot.joints[: motion.joint + 1]),
        "determines": list(design.base.expressions),
        **{
            key: one[key]
            for key in ("duration", "harmonics", "base_parameters", "condition_number", "limits",
                        "condition_number_scaled", "weakest", "clearance_m", "iterations")
        },
    }  # fmt: skip


def _later(entry: dict[str, Any] | None, start: float) -> dict[str, Any] | None:
    return None if entry is None else entry | {"t": entry["t"] + start}


def _least(values: list[float | None]) -> float | None:
    return min((value for value in values if value is not None), default=None)


def link_by_link_design_series(found: LinkByLinkDesign) -> dict[str, Array]:
    """Curves of all motions one after the other, keys as of `design_series`."""
    parts, start = [], 0.0
    for motion in found.motions:
        part = design_series(motion.design)
        for key in ("t", "arm_t"):
            part[key] = part[key] + start
        parts.append(part)
        start += motion.design.duration
    return {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}


def link_by_link_files(
    found: LinkByLinkDesign, rate_hz: float, periods: int = 1
) -> dict[str, str | bytes]:
    """``link<i>.csv`` and ``link<i>.json`` of every motion, the last link's first."""
    files: dict[str, str | bytes] = {}
    for motion in found.motions:
        trajectory = motion.design.trajectory
        files[f"{motion.name}.csv"] = trajectory_csv(trajectory, rate_hz, periods)
        files[f"{motion.name}.json"] = trajectory_json(trajectory, found.robot)
    return files
