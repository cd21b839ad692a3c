"""A `Diagnosis` as result.json and as arrays for figures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from excitant.analysis.confirmation import Finding
from excitant.analysis.diagnosis import Diagnosis
from excitant.analysis.discrimination_plan import Experiment, Plan
from excitant.analysis.evidence_curves import curve_of
from excitant.analysis.headline import at_rest, headline, placeholders
from excitant.analysis.residuals import Residual
from excitant.exceptions import ExcitantError
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

_SHAPES = {"velocity": "rad/s", "distance": "rad", "order": "1/turn", "time": "s", "exponent": "1"}


def diagnose_result(diagnosis: Diagnosis, plan: Plan | None = None) -> dict[str, Any]:
    """Machine-readable result of `diagnose` (keys of DESIGN.md, section 5).

    What wrong inertias alone would explain and the simulations forward are computed here.

    Args:
        diagnosis: What was found.
        plan: Experiments that settle what is undecided; general actions without one.
    """
    plan = plan or Plan()
    robot = diagnosis.robot
    return {
        "verb": "diagnose",
        "robot": robot.name,
        "headline": headline(diagnosis),
        "unit": diagnosis.data.unit,
        "cutoff_hz": diagnosis.data.cutoff_hz,
        "holdout": diagnosis.data.holdout,
        "simulation": {"joints": _joints(robot, diagnosis.simulation.entry)},
        "faults": [],
        "findings": [
            _unknown(diagnosis, item)
            if isinstance(item, Residual)
            else _finding(diagnosis, item, plan)
            for item in diagnosis.ordered
        ],
        "unexplained": [_unexplained(diagnosis, j) for j in range(robot.nv)],
        "extended": {"joints": _joints(robot, diagnosis.extended.entry)},
        "error": {"joints": _errors(diagnosis)},
        "refit": _refit(diagnosis),
        "forward": _forward(diagnosis),
        "waterfall": [{"label": label, "rms": size} for label, size in diagnosis.waterfall],
        "notes": [
            *diagnosis.notes,
            *filter(None, [placeholders(diagnosis), at_rest(diagnosis)]),
        ],
    }


def _joints(robot: Robot, entry: Any) -> list[dict[str, Any]]:
    return [{"name": joint, **entry(j)} for j, joint in enumerate(robot.joints)]


def _finding(diagnosis: Diagnosis, group: Sequence[Finding], plan: Plan) -> dict[str, Any]:
    lead, robot = group[0], diagnosis.robot
    before, after = diagnosis.before_and_after(group)
    others = {
        (r.candidate.effect.name, r.candidate.effect.joints): (f, r)
        for f in group
        for r in f.rivals
    }
    return {
        "effect": lead.effect.name,
        "joints": [joint for f in group for joint in f.effect.joints],
        "parameters": [
            {"name": p.name, "value": value, "std": std, "unit": p.unit, "given": given}
            for f in group
            for p, value, std, given in zip(
                f.effect.parameters(robot), f.effect.values or (), f.std, f.given, strict=True
            )
        ]
        + [
            {
                "name": f"{f.effect.joints[0]}.{shape}",
                "value": getattr(f.effect, shape),
                "std": None,
                "unit": unit,
            }
            for f in group
            for shape, unit in _SHAPES.items()
            if hasattr(f.effect, shape)
        ],
        "explained": sum(f.explained for f in group),
        "holdout": {"rms_before": before, "rms_after": after},
        "verdict": lead.verdict if len(group) == 1 else _verdict(group),
        "doubt": "; ".join(dict.fromkeys(f.downgrade for f in group if f.downgrade)),
        "rivals": [
            {
                "effect": name,
                "joints": list(joints),
                "why": f"explains this motion as well (within {max(rival.deviations, 0.0):.1f} "
                f"standard errors, signatures alike to |cos| = {rival.cosine:.2f})",
                **_experiment(plan.of(finding.effect, rival.candidate.effect)),
            }
            for (name, joints), (finding, rival) in others.items()
        ],
        "figure": _figure(diagnosis, lead),
    }


def _experiment(settles: Experiment) -> dict[str, Any]:
    """What to do about a rival, the expected difference in standard deviations, and the runs."""
    return {
        "experiment": settles.sentence,
        "separation": settles.separation,
        "repetitions": settles.repetitions,
        "file": settles.file,
    }


def _verdict(group: Sequence[Finding]) -> str:
    return "named" if all(f.verdict == "named" for f in group) else "undecided"


def _unknown(diagnosis: Diagnosis, left: Residual) -> dict[str, Any]:
    """What no candidate explains."""
    return {
        "effect": "unknown",
        "joints": [left.joint],
        "parameters": [],
        "explained": 0.0,
        "share": diagnosis.share_of(left),
        "holdout": {"rms_before": left.rms, "rms_after": left.rms},
        "verdict": "unknown",
        "structure": left.structure,
        "rivals": [],
        "figure": _figure(diagnosis, left),
    }


def _figure(diagnosis: Diagnosis, item: Finding | Residual) -> dict[str, str]:
    shown = curve_of(diagnosis, item)
    return {
        "x_label": shown.x_label,
        "y_label": f"torque [{diagnosis.data.unit}]",
        "joint": diagnosis.robot.joints[shown.joint],
    }


def _unexplained(diagnosis: Diagnosis, j: int) -> dict[str, Any]:
    left = diagnosis.residuals[j]
    return {
        "joint": left.joint,
        "share": float(np.clip(1 - diagnosis.extended.r2[j], 0, 1)),
        "rms": left.rms,
        "noise_floor": left.floor,
        "against_noise": left.against_noise,
        "structure": left.structure,
        "shows": dict(left.shares),
    }


def _errors(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """Rms of both models per joint, and the share of its square that each quantity explains."""

    def entry(left: Residual) -> dict[str, Any]:
        return {
            "rms": left.rms,
            "shares": dict(left.shares),
            "bands": dict(left.bands),
            "telling": left.dominant,
        }

    return [
        {
            "name": given.joint,
            **entry(given),
            "left": entry(left),
            "motion_hz": list(given.motion_hz),
        }
        for given, left in zip(diagnosis.given_residuals, diagnosis.residuals, strict=True)
    ]


def _refit(diagnosis: Diagnosis) -> dict[str, Any]:
    """What inertias alone would explain."""
    robot = diagnosis.robot
    try:
        found = diagnosis.refit
    except ExcitantError as error:
        return {"sentence": f"Inertias could not be fitted alone: {error}"}
    wrong = {
        robot.links[robot.joint_index(f.effect.joints[0])]
        for f in diagnosis.findings
        if f.effect.role != "torque"
    }
    said = found.sentence(robot.joints, diagnosis.data.unit, bool(diagnosis.findings), wrong)
    return {"sentence": said, **found.result(robot.joints)}


def _forward(diagnosis: Diagnosis) -> dict[str, Any]:
    """Both models simulated forward."""
    try:
        return diagnosis.forward.result(diagnosis.robot)
    except ExcitantError as error:
        return {"joints": [], "notes": [f"Not simulated forward: {error}"]}


def diagnose_series(diagnosis: Diagnosis) -> dict[str, Array]:
    """Measured, simulated and extended torque on the hold-out, and the evidence per finding."""
    arrays = {
        "t": diagnosis.series.t,
        "measured": diagnosis.series.measured,
        "simulated": diagnosis.simulated,
        "extended": diagnosis.predicted,
    }
    for k, item in enumerate(diagnosis.ordered):
        shown = curve_of(diagnosis, item if isinstance(item, Residual) else item[0])
        arrays[f"finding{k}_x"] = shown.x
        arrays[f"finding{k}_residual"] = shown.residual
        for name in ("fit", "rival"):
            if (values := getattr(shown, name)) is not None:
                arrays[f"finding{k}_{name}"] = values
    return arrays
