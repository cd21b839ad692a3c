"""Preprocessing and the choice of the estimator as entries of result.json."""

from __future__ import annotations

from typing import Any

from excitant.identify.cutoff import CutoffChoice
from excitant.identify.cutoff_sensitivity import Sensitivity
from excitant.identify.cutoff_study import Study
from excitant.identify.estimator_choice import EstimatorChoice
from excitant.identify.shapes import Shapes


def study_entries(
    study: Study | None, found: Sensitivity | None, joints: tuple[str, ...]
) -> dict[str, Any]:
    """Entries of the study, ``cutoff_hz_per_joint`` and more; none without one."""
    if study is None or found is None:
        return {}
    choice = study.choice
    return {
        "cutoff_hz_per_joint": [
            {
                "name": joint,
                "cutoff_hz": float(choice.cutoffs_hz[j]),
                "reason": choice.reasons[j],
                "explained_up_to_hz": float(choice.explained_hz[j]),
                "residual_densest_at_hz": float(choice.noise_hz[j]),
                "highest_harmonic_hz": _harmonic(choice, j),
            }
            for j, joint in enumerate(joints)
        ],
        "dead_zone": {
            "left_out": choice.dead_zone,
            "joints": [
                {
                    "name": joint,
                    "slower_than": max(0.0, float(choice.slowest[j])),
                    "share": float(choice.left_out[j]),
                }
                for j, joint in enumerate(joints)
            ],
        },
        "sensitivity": _sensitivity(found, choice.cutoffs_hz.tolist(), joints),
        **_shape_entries(study.shapes),
    }


def _harmonic(choice: CutoffChoice, joint: int) -> float | None:
    """The highest harmonic of a joint's motion where it is known."""
    return None if choice.harmonics is None else float(choice.harmonics.highest_hz[joint])


def _shape_entries(shapes: Shapes | None) -> dict[str, Any]:
    """Entry ``shapes``: each with its standard deviation; none where no effect has any."""
    if shapes is None:
        return {}
    return {
        "shapes": {
            "refined": shapes.better,
            "objective": {"given": shapes.before, "refined": shapes.after},
            "effects": [each.entry for each in shapes.found],
        }
    }


def _sensitivity(
    found: Sensitivity, cutoffs_hz: list[float], joints: tuple[str, ...]
) -> list[dict[str, Any]]:
    return [
        {
            "factor": float(factor),
            "joints": [
                {
                    "name": joint,
                    "cutoff_hz": factor * cutoffs_hz[j],
                    "rms": float(found.rms[k, j]),
                    "nrmse": float(found.nrmse[k, j]),
                }
                for j, joint in enumerate(joints)
            ],
            "largest_change": {
                "standard_deviations": float(found.moved[k]),
                "expression": found.parameters[k] or None,
            },
        }
        for k, factor in enumerate(found.factors)
    ]


def contest_entries(contest: EstimatorChoice | None) -> dict[str, Any]:
    """Entries ``estimators`` and ``estimators_not_compared``; none without a contest."""
    if contest is None:
        return {}
    return {
        "estimators_not_compared": [{"name": name, "why": why} for name, why in contest.absent],
        "estimators": [
            {
                "name": each.name,
                "chosen": each.name == contest.name,
                "nrmse": each.nrmse,
                "lower_by": each.fall,
                "lower_by_std": each.error,
            }
            for each in contest.contestants
        ],
    }
