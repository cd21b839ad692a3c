"""Which base parameters a motion shows worst, and how alike the others it shows them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from excitant.design.criterion import condition_number
from excitant.design.outcome import Design, dense_motion
from excitant.robots import Array
from excitant.robots.effects import standard_effects
from excitant.robots.parameters import UNITS
from excitant.robots.torque import effect_values

_WEAKEST = 10  # base parameters listed
_DIRECTIONS = 3  # combinations of base parameters listed
_MEMBER = 0.3  # coefficient of a unit vector from which a base parameter is named


def visibility(design: Design) -> dict[str, Any]:
    """How well a design shows the base parameters, before and after, as plain values.

    Returns:
        ``condition_number_scaled`` with ``initial`` and ``final``; ``weakest``, the base
        parameters with the least torque of their own after the design, least first; and
        ``weak_directions`` of the ``initial`` and the ``final`` motion.
    """
    motion, names = dense_motion(design.trajectory), _names(design)
    after = design.information.matrix(motion)
    before = design.information.matrix(dense_motion(design.initial))
    return {
        "condition_number_scaled": {
            "initial": scaled_condition_number(before),
            "final": scaled_condition_number(after),
        },
        "joint_weights": design.information.weights.tolist(),
        "weakest": _weakest(design, before, after, len(motion)),
        "weak_directions": {
            "initial": weak_directions(names, before, after),
            "final": weak_directions(names, after, before),
        },
    }


def _names(design: Design) -> list[str]:
    return [design.base.names[k] for k in design.base.columns]


def scaled_condition_number(M: Array) -> float | None:
    """cond₂ of W with columns scaled to unit length, from M = WᵀW / n; None with a zero column."""
    length = np.sqrt(np.diag(M))
    return condition_number(M / np.outer(length, length)) if length.all() else None


def lone_torque(M: Array) -> Array:
    """Torque that only one base parameter explains, root mean square per its unit, shape (r,).

    1 / √(M⁻¹)ₖₖ is the length of column k of W / √n outside the span of the other columns. From
    n instants with white noise of standard deviation σ, least squares estimates the parameter
    with the standard deviation σ / (√n · this); with weighted joints σ is the geometric mean
    of theirs.

    Args:
        M: Information WᵀW / n, shape (r, r).
    """
    values, V = np.linalg.eigh(M)
    floor = max(float(values[-1]), 1e-300) * np.finfo(float).eps
    lone: Array = 1 / np.sqrt((V**2 / np.maximum(values, floor)).sum(axis=1))
    return lone


def weak_directions(
    names: Sequence[str], M: Array, other: Array, count: int = _DIRECTIONS
) -> list[dict[str, Any]]:
    """Combinations of base parameters that a motion shows worst, weakest first.

    They are the last right singular vectors v of W. ``strength`` is ‖W v‖ / √n [N·m], the root
    mean square torque per unit; ``other`` is that of the same direction in another motion;
    ``members`` are the coefficients of size 0.3 and more, and ``share`` their part of v (of 1).

    Args:
        names: Names of the base parameters, r of them.
        M: Information WᵀW / n of the motion, shape (r, r).
        other: Information of the other motion, same shape.
        count: How many.
    """
    found = []
    for v in np.linalg.eigh(M)[1].T[:count]:
        order = np.argsort(-np.abs(v), kind="stable")
        v = v * np.sign(v[order[0]])
        kept = [k for k in order if abs(v[k]) >= _MEMBER] or [order[0]]
        found.append(
            {
                "strength": _strength(M, v),
                "other": _strength(other, v),
                "members": [{"name": names[k], "coefficient": float(v[k])} for k in kept],
                "share": float((v[kept] ** 2).sum()),
            }
        )
    return found


def _strength(M: Array, v: Array) -> float:
    return float(np.sqrt(max(float(v @ M @ v), 0.0)))


def _weakest(design: Design, before: Array, after: Array, n: int) -> list[dict[str, Any]]:
    base, robot = design.base, design.robot
    lone = {"initial": lone_torque(before), "final": lone_torque(after)}
    given = dict(zip(robot.parameter_names, robot.phi.tolist(), strict=True))
    given |= effect_values(robot)
    beta = base.regrouping @ np.array([given.get(name, 0.0) for name in base.names])
    names, units, expressions = _names(design), _units(design), base.expressions
    return [
        {
            "name": names[k],
            "expression": expressions[k],
            "unit": units[base.columns[k]],
            "value": float(beta[k]),
            **{f"information_{when}": float(size[k]) for when, size in lone.items()},
            **{
                f"std_per_unit_noise_{when}": 1 / (math.sqrt(n) * float(size[k]))
                for when, size in lone.items()
            },
        }
        for k in np.argsort(lone["final"], kind="stable")[:_WEAKEST]
    ]


def _units(design: Design) -> list[str]:
    """Units of all columns."""
    effects = standard_effects(design.robot.joints) if design.columns == "friction" else ()
    added = [p.unit for effect in effects for p in effect.parameters(design.robot)]
    return [*UNITS * design.robot.nv, *added]
