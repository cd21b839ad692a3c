"""An arm and what looks wrong in its description, as plain values and arrays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from excitant.robots.base_parameters import base_parameters
from excitant.robots.model_check import total_mass
from excitant.robots.model_check_bodies import Body, bodies
from excitant.robots.model_check_joints import gravity_peaks
from excitant.robots.model_check_sketch import bent_pose, sketch, zero_pose
from excitant.robots.model_check_warning import ModelWarning
from excitant.robots.motion import Array
from excitant.robots.robot import Robot


def robot_result(
    robot: Robot, warnings: Sequence[ModelWarning], mass: float | None = None
) -> dict[str, Any]:
    """Joints, links, limits, effects and warnings of an arm, for ``result.json``.

    Args:
        robot: The arm.
        warnings: What `excitant.robots.model_check.check_model` found.
        mass: What the whole arm is said to weigh [kg].
    """
    links = bodies(robot)
    moving, total = total_mass(robot, links)
    return {
        "verb": "robots",
        "robot": robot.name,
        "name": robot.name,
        "mass": moving,
        "total_mass": total,
        "stated_mass": mass,
        "gravity": robot.gravity.tolist(),
        "base_parameters": len(base_parameters(robot)),
        "effects": [effect.name for effect in robot.effects],
        "effect_values": _effect_values(robot),
        "warnings": [
            {"check": w.check, "where": list(w.where), "sentence": w.sentence, "hint": w.hint}
            for w in warnings
        ],
        "joints": _joints(robot),
        "links": [_link(body) for body in links],
        "locked": dict(robot.locked),
        "parameters": dict(zip(robot.parameter_names, robot.phi.tolist(), strict=True)),
        "notes": list(robot.notes),
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _joints(robot: Robot) -> list[dict[str, Any]]:
    limits, (peak, _) = robot.limits, gravity_peaks(robot)
    return [
        {
            "name": joint,
            "link": robot.links[j],
            "kind": "revolute" if robot.revolute[j] else "prismatic",
            "position": [_finite(x) for x in limits.position[j]],
            **{
                name: _finite(getattr(limits, name)[j])
                for name in ("velocity", "acceleration", "torque")
            },
            "gravity_torque": _finite(peak[j]),
            "mass": float(robot.phi[10 * j]),
        }
        for j, joint in enumerate(robot.joints)
    ]


def _link(body: Body) -> dict[str, Any]:
    moments = np.linalg.eigvalsh(body.inertia)
    spread = np.linalg.eigvalsh(body.second_moment)[-1] if body.mass > 0 else 0.0
    return {
        "link": body.link,
        "moves_with": body.carrier or None,
        "mass": body.mass,
        "com": body.com.tolist(),
        "principal_moments": moments.tolist(),
        "radius_of_gyration": float(np.sqrt(max(spread, 0.0))),
        "size": body.size,
        "solids": len(body.shapes),
    }


def _effect_values(robot: Robot) -> list[dict[str, Any]]:
    return [
        {"effect": effect.name, "name": parameter.name, "value": value, "unit": parameter.unit}
        for effect in robot.effects
        if effect.values is not None
        for parameter, value in zip(effect.parameters(robot), effect.values, strict=True)
    ]


def robot_series(robot: Robot) -> dict[str, Array]:
    """What a picture of the arm needs, in its zero pose and in a bent one.

    Returns:
        ``zero_`` and ``bent_`` with ``pose``, ``points``, ``axes`` and ``solids`` of
        `excitant.robots.model_check_sketch.Sketch`.
    """
    arrays = {}
    for name, q in (("zero", zero_pose(robot)), ("bent", bent_pose(robot))):
        drawn = sketch(robot, q)
        for key in ("pose", "points", "axes", "solids"):
            arrays[f"{name}_{key}"] = getattr(drawn, key)
    return arrays
