"""An `Estimate` as result.json and as arrays for figures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from excitant.identify.essential import Essential, essential_parameters
from excitant.identify.estimate import Estimate
from excitant.identify.prediction import Coverage, coverage
from excitant.robots.base_parameters import categories
from excitant.robots.motion import Array
from excitant.robots.parameters import UNITS, violations


def identify_result(estimate: Estimate) -> dict[str, Any]:
    """Machine-readable result of `identify` (keys of DESIGN.md, section 5)."""
    robot = estimate.given
    broken = violations(estimate.phi, robot.links)
    half_width = estimate.interval.half_width
    held = coverage(estimate.series.measured, estimate.predicted, half_width)
    essential = essential_parameters(estimate.least_squares.beta, estimate.least_squares.covariance)
    return {
        "verb": "identify",
        "robot": robot.name,
        "estimator": f"{estimate.estimator}, then physically consistent semidefinite fit",
        "effects": [effect.name for effect in estimate.model.effects],
        "cutoff_hz": estimate.data.cutoff_hz,
        **({} if estimate.shapes is None else {"shapes": estimate.shapes.entry()}),
        "unit": estimate.data.unit,
        "holdout": estimate.data.holdout,
        "drive_gain_Nm_per_A": list(estimate.gains) if estimate.data.unit == "A" else None,
        "joints": [
            {
                "name": joint,
                "train": estimate.train.entry(j),
                "validate": estimate.validate.entry(j)
                | {"interval95": _interval(estimate, held, j)},
                "baseline": estimate.baseline.entry(j),
            }
            for j, joint in enumerate(robot.joints)
        ],
        "parameters": _parameters(estimate),
        "base_parameters": _base_parameters(estimate),
        "essential": _essential(estimate, essential),
        "physical": {
            "consistent": not broken,
            "violations": broken,
            "kkt": vars(estimate.physical.kkt),
        },
        "knowledge": estimate.knowledge.entry(),
        "notes": [
            *estimate.notes,
            *([estimate.knowledge.sentence] if estimate.knowledge.sentence else []),
            *_missed(robot.joints, held),
        ],
    }


def _interval(estimate: Estimate, held: Coverage, joint: int) -> dict[str, float]:
    """Mean half width of the 95 % intervals of one joint, and how many readings they hold."""
    half, parameters = estimate.interval.half_width, estimate.interval.parameters
    return {
        "half_width": float(half[:, joint].mean()),
        "half_width_parameters": float(1.96 * parameters[:, joint].mean()),
        "coverage": float(held.share[joint]),
    }


def _missed(joints: Sequence[str], held: Coverage) -> list[str]:
    """What coverage far from 95 % says, as a sentence, where there is any."""
    low = np.flatnonzero(held.too_few)
    if not len(low):
        return []
    shares = ", ".join(f"{joints[int(j)]} {100 * held.share[j]:.0f} %" for j in low)
    return [
        f"95 % intervals of the predicted torque hold less of the hold-out ({shares}): the model "
        "misses something there; `excitant diagnose` looks for its cause"
    ]


def _essential(estimate: Estimate, essential: Essential) -> dict[str, Any]:
    """The fewest base parameters, and what the hold-out says of them (median over joints)."""
    expressions, gains = estimate.base.expressions, estimate.gains
    every, few = (
        float(np.nanmedian(estimate.series.accuracy(estimate.holdout_columns @ b / gains).nrmse))
        for b in (estimate.least_squares.beta, essential.beta)
    )
    return {
        "kept": [expressions[k] for k in essential.kept],
        "dropped": [expressions[k] for k in essential.dropped],
        "p_value": essential.p_value,
        "nrmse_all": every,
        "nrmse_essential": few,
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
            "prior_dominated": category == "unidentifiable" or physical.prior_dominated[k],
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
        "half_width": estimate.interval.half_width,
    }
