"""An `Estimate` as result.json, as arrays for figures, and as files."""

from __future__ import annotations

from typing import Any

import numpy as np
import yaml

from excitant.identify.estimate import Estimate
from excitant.robots.base_parameters import categories
from excitant.robots.effects import effect_entries
from excitant.robots.motion import Array
from excitant.robots.parameters import UNITS, violations
from excitant.robots.robot import Robot
from excitant.robots.urdf import urdf_with_parameters

_PRIOR_DOMINATED = 0.5  # of the prior's standard deviation is left: the data say little


def identify_result(estimate: Estimate) -> dict[str, Any]:
    """Machine-readable result of `identify` (keys of DESIGN.md, section 5)."""
    robot = estimate.given
    broken = violations(estimate.phi, robot.links)
    return {
        "verb": "identify",
        "robot": robot.name,
        "estimator": "weighted least squares, then physically consistent semidefinite fit",
        "effects": [effect.name for effect in estimate.model.effects],
        "cutoff_hz": estimate.data.cutoff_hz,
        "unit": estimate.data.unit,
        "holdout": estimate.data.holdout,
        "drive_gain_Nm_per_A": list(estimate.gains) if estimate.data.unit == "A" else None,
        "joints": [
            {
                "name": joint,
                "train": estimate.train.entry(j),
                "validate": estimate.validate.entry(j),
                "baseline": estimate.baseline.entry(j),
            }
            for j, joint in enumerate(robot.joints)
        ],
        "parameters": _parameters(estimate),
        "base_parameters": _base_parameters(estimate),
        "physical": {
            "consistent": not broken,
            "violations": broken,
            "kkt": vars(estimate.physical.kkt),
        },
        "notes": list(estimate.notes),
    }


def _parameters(estimate: Estimate) -> list[dict[str, Any]]:
    robot, physical = estimate.given, estimate.physical
    names = estimate.base.names
    effects = [p for e in estimate.model.effects for p in e.parameters(robot)]
    units = [*UNITS * robot.nv, *(p.unit for p in effects)]
    owners = [link for link in robot.links for _ in UNITS]
    owners += [p.name.rpartition(".")[0] for p in effects]
    given = [*estimate.prior, *(None,) * len(effects)]
    std = np.sqrt(np.diag(physical.covariance))
    return [
        {
            "name": names[k],
            "link": owners[k],
            "value": float(physical.x[k]),
            "std": float(std[k]),
            "unit": units[k],
            "category": category,
            "prior": None if given[k] is None else float(given[k]),
            "prior_dominated": category == "unidentifiable"
            or bool(physical.prior_share[k] > _PRIOR_DOMINATED),
        }
        for k, category in enumerate(categories(estimate.base))
    ]


def _base_parameters(estimate: Estimate) -> list[dict[str, Any]]:
    fit = estimate.least_squares
    std = np.sqrt(np.diag(fit.covariance))
    return [
        {
            "expression": text,
            "value": float(value),
            "std": float(s),
            "rel_std": float(s / abs(value)) if value else None,
        }
        for text, value, s in zip(estimate.base.expressions, fit.beta, std, strict=True)
    ]


def identify_series(estimate: Estimate) -> dict[str, Array]:
    """Measured, given and identified torque on the hold-out, each of shape (n, nv)."""
    return {
        "t": estimate.series.t,
        "measured": estimate.series.measured,
        "given": estimate.predicted_given,
        "identified": estimate.predicted,
    }


def model_files(model: Robot, stem: str, yaml_name: str) -> dict[str, str]:
    """URDF and YAML of a robot; the YAML refers to the URDF and adds what that cannot hold.

    ``load_robot`` reads the YAML back to the same torque.
    """
    limits = model.limits
    content = {
        "model": f"{stem}.urdf",
        "joints": list(model.joints),
        "lock": dict(model.locked),
        "gravity": [float(g) for g in model.gravity],
        "limits": {
            name: getattr(limits, name).tolist()
            for name in ("position", "velocity", "acceleration", "torque")
        },
        "effects": effect_entries(model.effects),
    }
    return {
        f"{stem}.urdf": urdf_with_parameters(model, model.phi, _urdf_friction(model)),
        yaml_name: yaml.safe_dump(content, sort_keys=False, allow_unicode=True),
    }


def _urdf_friction(model: Robot) -> dict[str, tuple[float, float]]:
    """Viscous and Coulomb friction of every joint, as far as a URDF can say it."""
    viscous, coulomb = dict.fromkeys(model.joints, 0.0), dict.fromkeys(model.joints, 0.0)
    for effect in model.effects:
        kind = {"viscous_friction": viscous, "coulomb_friction": coulomb}.get(effect.name)
        if kind is not None and effect.values is not None:
            kind.update(zip(effect.joints, effect.values, strict=True))
    return {joint: (viscous[joint], coulomb[joint]) for joint in model.joints}
