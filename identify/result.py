"""An `Estimate` as result.json and as arrays for figures."""

from __future__ import annotations

from typing import Any

import numpy as np

from excitant.identify.estimate import Estimate
from excitant.robots.base_parameters import categories
from excitant.robots.motion import Array
from excitant.robots.parameters import UNITS, violations

_PRIOR_DOMINATED = 0.5  # of the prior's standard deviation is left: the data say little


def identify_result(estimate: Estimate) -> dict[str, Any]:
    """Machine-readable result of `identify` (keys of DESIGN.md, section 5)."""
    robot = estimate.given
    broken = violations(estimate.phi, robot.links)
    return {
        "verb": "identify",
        "robot": robot.name,
        "estimator": f"{estimate.estimator}, then physically consistent semidefinite fit",
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
