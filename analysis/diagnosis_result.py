"""A `Diagnosis` as result.json, as arrays for figures, and in plain words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from excitant.analysis.diagnosis import Diagnosis, Finding
from excitant.analysis.experiments import experiment
from excitant.robots.effects import InertialParameters, JointEffect, Payload
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

_NOISE_LIKE_S = 0.1  # s: residuals that forget faster than this look like noise

_PLAIN = {
    "viscous_friction": "viscous friction",
    "coulomb_friction": "Coulomb friction",
    "stribeck_friction": "Stribeck friction",
    "rotor_inertia": "rotor inertia",
    "torque_offset": "torque offset",
}
_DOMAIN = {
    "viscous_friction": "velocity",
    "coulomb_friction": "velocity",
    "stribeck_friction": "velocity",
    "rotor_inertia": "acceleration",
}
_LABEL = {
    "velocity": "joint velocity [rad/s]",
    "acceleration": "joint acceleration [rad/s²]",
    "time": "time [s]",
}


def grouped(diagnosis: Diagnosis) -> list[list[Finding]]:
    """Findings by cause: one group where most joints share it and its verdict, else by joint."""
    groups: dict[str, list[Finding]] = {}
    for finding in diagnosis.findings:
        name = finding.effect.name
        same = [f for f in diagnosis.findings if f.effect.name == name]
        common = isinstance(finding.effect, JointEffect) and 2 * len(same) > diagnosis.robot.nv > 2
        key = f"{name} {finding.verdict if common else finding.effect.joints}"
        groups.setdefault(key, []).append(finding)
    return sorted(groups.values(), key=lambda group: -sum(f.explained for f in group))


def diagnose_result(diagnosis: Diagnosis) -> dict[str, Any]:
    """Machine-readable result of `diagnose` (keys of DESIGN.md, section 5)."""
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
        "findings": [_finding(diagnosis, group) for group in grouped(diagnosis)],
        "unexplained": [_unexplained(diagnosis, j) for j in range(robot.nv)],
        "extended": {"joints": _joints(robot, diagnosis.extended.entry)},
        "waterfall": [{"label": label, "rms": size} for label, size in diagnosis.waterfall],
        "notes": list(diagnosis.notes),
    }


def _joints(robot: Robot, entry: Any) -> list[dict[str, Any]]:
    return [{"name": joint, **entry(j)} for j, joint in enumerate(robot.joints)]


def _finding(diagnosis: Diagnosis, group: Sequence[Finding]) -> dict[str, Any]:
    lead, robot = group[0], diagnosis.robot
    before, after = (
        float(np.sqrt(np.mean([getattr(f, name) ** 2 for f in group])))
        for name in ("rms_before", "rms_after")
    )
    others = {
        (r.candidate.effect.name, r.candidate.effect.joints): r for f in group for r in f.rivals
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
            {"name": f"{f.effect.joints[0]}.velocity", "value": speed, "std": None, "unit": "rad/s"}
            for f in group
            if (speed := getattr(f.effect, "velocity", None)) is not None
        ],
        "explained": sum(f.explained for f in group),
        "holdout": {"rms_before": before, "rms_after": after},
        "verdict": "undecided" if others else "named",
        "rivals": [
            {
                "effect": name,
                "joints": list(joints),
                "why": f"explains this motion as well (odds {rival.odds:.3g} : 1, "
                f"signatures alike to |cos| = {rival.cosine:.2f})",
                "experiment": experiment(lead.effect.name, name),
            }
            for (name, joints), rival in others.items()
        ],
        "figure": {
            "x_label": _LABEL[_DOMAIN.get(lead.effect.name, "time")],
            "y_label": f"torque [{diagnosis.data.unit}]",
            "joint": robot.joints[_shown_joint(diagnosis, lead)],
        },
    }


def _shown_joint(diagnosis: Diagnosis, finding: Finding) -> int:
    """The joint whose error the cause reduces most, relative to the given model's error."""
    if isinstance(finding.effect, JointEffect):
        return diagnosis.robot.joint_index(finding.effect.joints[0])
    return int(np.argmax(np.sqrt((finding.torque**2).mean(axis=0)) / diagnosis.extended.rms))


def _unexplained(diagnosis: Diagnosis, j: int) -> dict[str, Any]:
    seconds = float(diagnosis.correlation_s[j])
    slow = f"structured: stays correlated over {seconds:.2g} s"
    return {
        "joint": diagnosis.robot.joints[j],
        "share": float(np.clip(1 - diagnosis.extended.r2[j], 0, 1)),
        "structure": "noise-like" if seconds < _NOISE_LIKE_S else slow,
    }


def diagnose_series(diagnosis: Diagnosis) -> dict[str, Array]:
    """Measured, simulated and extended torque on the hold-out, and the evidence per finding."""
    arrays = {
        "t": diagnosis.series.t,
        "measured": diagnosis.series.measured,
        "simulated": diagnosis.simulated,
        "extended": diagnosis.predicted,
    }
    domains = {"velocity": diagnosis.velocity, "acceleration": diagnosis.acceleration}
    error = diagnosis.series.measured - diagnosis.predicted
    for k, (lead, *_) in enumerate(grouped(diagnosis)):
        j = _shown_joint(diagnosis, lead)
        domain = _DOMAIN.get(lead.effect.name, "time")
        arrays[f"finding{k}_x"] = diagnosis.series.t if domain == "time" else domains[domain][:, j]
        arrays[f"finding{k}_residual"] = error[:, j] + lead.torque[:, j]
        arrays[f"finding{k}_fit"] = lead.torque[:, j]
    return arrays


def headline(diagnosis: Diagnosis) -> str:
    """The most important finding in one sentence."""
    unit = diagnosis.data.unit
    groups = grouped(diagnosis)
    if not groups:
        return (
            "No cause stands out: what the given model misses lies within the tolerance of its "
            "own values or within the noise."
        )
    lead = groups[0][0]
    joints = [joint for f in groups[0] for joint in f.effect.joints]
    before, after = (
        float(np.sqrt(np.mean([getattr(f, n) ** 2 for f in groups[0]])))
        for n in ("rms_before", "rms_after")
    )
    gain = f"hold-out error {before:.2g} → {after:.2g} {unit}"
    doubt = ""
    if lead.rivals:
        other = lead.rivals[0].candidate.effect
        name = _PLAIN.get(other.name, other.name.replace("_", " "))
        doubt = f" {name.capitalize()} at {', '.join(other.joints)} would look the same."
    more = len(groups) - 1
    also = f" {more} more cause{'s' if more > 1 else ''} below." if more else ""
    return f"{_in_words(lead, joints, diagnosis)}; {gain}.{doubt}{also}"


def _in_words(finding: Finding, joints: Sequence[str], diagnosis: Diagnosis) -> str:
    effect, values = finding.effect, finding.effect.values or ()
    if isinstance(effect, Payload):
        return f"A payload of {values[0]:.2f} kg on the last link is missing from the model"
    if isinstance(effect, InertialParameters):
        link = diagnosis.robot.links[diagnosis.robot.joint_index(joints[0])]
        return f"The inertial parameters of {link} are wrong (mass {values[0]:+.2f} kg)"
    name = _PLAIN[effect.name]
    if len(joints) > 1:
        return f"{name[0].upper()}{name[1:]} of {len(joints)} joints is missing or wrong"
    unit = effect.parameters(diagnosis.robot)[0].unit
    if finding.given[0]:
        return (
            f"{joints[0]}: {name} is {values[0]:.3g} {unit}, the model says {finding.given[0]:.3g}"
        )
    return f"{joints[0]}: {name} of {values[0]:.3g} {unit} is not in the model"
