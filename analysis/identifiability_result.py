"""An `Identifiability` as result.json, and as arrays for figures."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from excitant.analysis.directions import largest_correlations
from excitant.analysis.identifiability import Identifiability, UnderMotion
from excitant.analysis.structure import structure_values
from excitant.analysis.uncertainty import Entry
from excitant.identify.prior_rule import KINDS
from excitant.robots.motion import Array, read_only
from excitant.robots.robot import Robot

_POSES = 400  # tried
_BELOW = 0.3  # of the arm's size, how strongly points under the base count against a pose


def analyze_result(found: Identifiability) -> dict[str, Any]:
    """Machine-readable result of `analyze` (keys of DESIGN.md, section 5)."""
    base, robot = found.base, found.robot
    links = zip(robot.links, robot.joints, strict=True)
    return {
        "verb": "analyze",
        "robot": robot.name,
        "standard_parameters": len(base.names),
        "base_parameters": len(base),
        "gap": list(base.gap),
        "structure": _structure(found),
        "links": [_link(found, link, joint) for link, joint in links],
        "follow_each_other": [list(group) for group in found.follow],
        "condition_number": None,
        "practical": [],
        "basis": "",
        **(_motion(found, found.motion) if found.motion else {}),
        "notes": list(found.notes),
    }


def _structure(found: Identifiability) -> dict[str, Any]:
    values = structure_values(found.structure)
    return {key: values[key] for key in ("circumstances", "close", "by_a_hair", "lengths_m")}


def _link(found: Identifiability, link: str, joint: str) -> dict[str, Any]:
    base, table = found.base, found.entries
    own = [k for k, entry in enumerate(table) if entry.owner in (link, joint)]
    of = {
        category: [table[k].name for k in own if table[k].category == category]
        for category in ("unique", "unidentifiable")
    }
    combined = []
    for row, text in zip(base.regrouping, base.expressions, strict=True):
        members = [base.names[k] for k in np.flatnonzero(row)]
        if len(members) > 1 and any(row[k] for k in own):
            combined.append({"expression": text, "members": members})
    return {
        "link": link,
        "joint": joint,
        "unique": of["unique"],
        "combined": combined,
        "unidentifiable": of["unidentifiable"],
        "parameters": [_entry(found, k) for k in own],
    }


def _entry(found: Identifiability, k: int) -> dict[str, Any]:
    entry: Entry = found.entries[k]
    influence = found.motion.influence if found.motion else None
    return {
        "name": entry.name,
        "unit": entry.unit,
        "category": entry.category,
        "value": entry.value,
        "std": entry.std,
        "rel_std": entry.rel_std,
        "std_data": _finite(entry.std_data),
        "verdict": entry.verdict or None,
        "prior": entry.prior,
        "prior_influence": entry.influence,
        "decided_by": entry.decided_by or None,
        "prior_dominated": entry.prior_dominated,
        "prior_moves": None
        if influence is None
        else {
            kind.replace(" ", "_"): _finite(ratio)
            for kind, ratio in zip(KINDS, influence.ratio[:, k].tolist(), strict=True)
        },
        "expression": "; ".join(entry.expressions) or None,
        "margin": float(found.structure.margin[k]),
        "needed": entry.needed or None,
    }


def _motion(found: Identifiability, under: UnderMotion) -> dict[str, Any]:
    names = [found.base.names[k] for k in found.base.columns]
    influence = under.influence
    return {
        "condition_number": _finite(under.condition_number),
        "practical": [
            {
                "name": p.expression,
                "value": p.value,
                "std": _finite(p.std),
                "rel_std": p.rel_std,
                "verdict": p.verdict,
                "needed": what or None,
            }
            for p, what in zip(under.practical, under.needed, strict=True)
        ],
        "basis": under.basis,
        "noise": under.noise.tolist(),
        "resting_joints": list(under.rests),
        "not_shown": [
            {"name": p.expression, "needed": what or None}
            for p, what in zip(under.practical, under.needed, strict=True)
            if np.isinf(p.std)
        ],
        "directions": [
            {
                "expression": d.expression,
                "meaning": d.meaning,
                "rel_std": _finite(d.std),
                "members": [
                    {"name": name, "change": change, "unit": unit}
                    for name, change, unit in d.members
                ],
                "share": d.share,
            }
            for d in under.directions
        ],
        "correlations": [
            {"first": names[i], "second": names[j], "correlation": rho}
            for i, j, rho in largest_correlations(under.correlation)
        ],
        "persistency": under.persistency,
        "prior_perturbation": None
        if influence is None
        else {
            "refits": influence.refits,
            "largest_base_move_in_std": float(influence.base_move.max(initial=0.0)),
        },
    }


def _finite(value: float | None) -> float | None:
    return float(value) if value is not None and np.isfinite(value) else None


def analyze_series(found: Identifiability) -> dict[str, Array]:
    """Arrays for figures: where the joints are, and how base parameters go together.

    Returns:
        ``chain``, points of base, joints and tip, shape (nv + 2, 3) [m]; with a motion also
        ``correlation``, shape (r, r), and ``singular_values``, shape (r,).
    """
    arrays = {"chain": _chain(found.robot)}
    if found.motion:
        arrays["correlation"] = found.motion.correlation
        arrays["singular_values"] = found.motion.singular_values
    return arrays


def _chain(robot: Robot) -> Array:
    """Base, joints in order, and tip of an arm in a clear pose, shape (nv + 2, 3) [m].

    Of random poses within the limits, always the same ones, the one whose joints are farthest
    from those that are not their neighbours, with the arm above its base.
    """
    rng = np.random.default_rng(0)
    q, _, _ = robot.random_motion(rng, _POSES)
    poses = np.array([_points(robot, each) for each in q])
    return read_only(poses[int(np.argmax([_clarity(points) for points in poses]))])


def _points(robot: Robot, q: Array) -> Array:
    model, data = robot.model, robot.model.createData()
    pin.framesForwardKinematics(model, data, np.asarray(q, float))
    joints = [data.oMi[j].translation.copy() for j in range(1, robot.nv + 1)]
    return np.array([np.zeros(3), *joints, data.oMf[robot.tip].translation.copy()])


def _clarity(points: Array) -> float:
    """Least distance of points that are two or more apart, from the side, relative to the arm."""
    distances = np.linalg.norm(points[:, None, [0, 2]] - points[None, :, [0, 2]], axis=2)
    apart = distances[np.triu_indices(len(points), 2)]
    true = np.linalg.norm(points[:, None] - points[None], axis=2)[np.triu_indices(len(points), 2)]
    size = max(float(true.max(initial=0.0)), 1e-9)
    meant = true > 1e-3 * size  # joints that meet in a point stay together in every pose
    least = float(apart[meant].min(initial=size)) / size
    return least + _BELOW * float(min(points[:, 2].min(), 0.0)) / size
