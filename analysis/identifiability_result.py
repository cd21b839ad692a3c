"""An `Identifiability` as result.json, and as arrays for figures."""

from __future__ import annotations

from typing import Any

import numpy as np

from excitant.analysis.chain import chain
from excitant.analysis.directions import largest_correlations
from excitant.analysis.entries import Entry
from excitant.analysis.identifiability import Identifiability, UnderMotion
from excitant.analysis.structure import structure_values
from excitant.identify.prior_rule import KINDS
from excitant.robots.motion import Array


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
    arrays = {"chain": chain(found.robot)}
    if found.motion:
        arrays["correlation"] = found.motion.correlation
        arrays["singular_values"] = found.motion.singular_values
    return arrays
