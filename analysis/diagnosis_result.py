"""A `Diagnosis` as result.json, as arrays for figures, and in plain words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from excitant.analysis.confirmation import Finding
from excitant.analysis.diagnosis import Diagnosis
from excitant.analysis.discrimination_plan import Experiment, Plan
from excitant.analysis.residuals import Remainder
from excitant.robots.effects import GravityDirection, InertialParameters, JointwiseEffect, Payload
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

_PLAIN = {"coulomb_friction": "Coulomb friction", "stribeck_friction": "Stribeck friction"}
_DOMAIN = {
    "viscous_friction": "velocity",
    "coulomb_friction": "velocity",
    "asymmetric_friction": "velocity",
    "stribeck_friction": "velocity",
    "nonlinear_viscous_friction": "velocity",
    "load_dependent_friction": "velocity",
    "presliding_hysteresis": "velocity",
    "friction_coupling": "velocity",
    "rotor_inertia": "acceleration",
    "inertia_coupling": "acceleration",
    "torque_ripple": "position",
    "spring": "position",
    "torque_gain": "torque",
}
_LABEL = {
    "velocity": "joint velocity [rad/s]",
    "acceleration": "joint acceleration [rad/s²]",
    "position": "joint position [rad]",
    "torque": "torque of the given model",
    "time": "time [s]",
}
_SHOWN = {"position": "position", "velocity": "velocity", "load": "torque", "time": "time"}
_SHAPES = {"velocity": "rad/s", "distance": "rad", "order": "1/turn", "time": "s", "exponent": "1"}


def plain(name: str) -> str:
    """Name of an effect in a sentence."""
    return _PLAIN.get(name, name.replace("_", " "))


def grouped(diagnosis: Diagnosis) -> list[list[Finding]]:
    """Findings by cause: one group where most joints share it and its verdict, else by joint."""
    groups: dict[str, list[Finding]] = {}
    for finding in diagnosis.findings:
        name = finding.effect.name
        same = [f for f in diagnosis.findings if f.effect.name == name]
        common = (
            isinstance(finding.effect, JointwiseEffect) and 2 * len(same) > diagnosis.robot.nv > 2
        )
        key = f"{name} {finding.verdict if common else finding.effect.joints}"
        groups.setdefault(key, []).append(finding)
    return sorted(groups.values(), key=lambda group: -sum(f.explained for f in group))


def diagnose_result(diagnosis: Diagnosis, plan: Plan | None = None) -> dict[str, Any]:
    """Machine-readable result of `diagnose` (keys of DESIGN.md, section 5).

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
            if isinstance(item, Remainder)
            else _finding(diagnosis, item, plan)
            for item in ordered(diagnosis)
        ],
        "unexplained": [_unexplained(diagnosis, j) for j in range(robot.nv)],
        "extended": {"joints": _joints(robot, diagnosis.extended.entry)},
        "waterfall": [{"label": label, "rms": size} for label, size in diagnosis.waterfall],
        "notes": list(diagnosis.notes),
    }


def _joints(robot: Robot, entry: Any) -> list[dict[str, Any]]:
    return [{"name": joint, **entry(j)} for j, joint in enumerate(robot.joints)]


def _finding(diagnosis: Diagnosis, group: Sequence[Finding], plan: Plan) -> dict[str, Any]:
    lead, robot = group[0], diagnosis.robot
    before, after = (
        float(np.sqrt(np.mean([getattr(f, name) ** 2 for f in group])))
        for name in ("rms_before", "rms_after")
    )
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
        "doubt": "more is left unexplained on its joints than it explains"
        if any(f.overshadowed for f in group)
        else "",
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
        "figure": {
            "x_label": _LABEL[_DOMAIN.get(lead.effect.name, "time")],
            "y_label": f"torque [{diagnosis.data.unit}]",
            "joint": robot.joints[_shown_joint(diagnosis, lead)],
        },
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


def ordered(diagnosis: Diagnosis) -> list[list[Finding] | Remainder]:
    """Findings, and joints where more than noise stays unexplained, by the error they stand for."""
    found = [(sum(f.explained for f in group), group) for group in grouped(diagnosis)]
    open_ = [(_share(diagnosis, left), left) for left in diagnosis.remainders if left.visible]
    items: list[tuple[float, list[Finding] | Remainder]] = [*found, *open_]
    return [item for _, item in sorted(items, key=lambda pair: -pair[0])]


def _share(diagnosis: Diagnosis, left: Remainder) -> float:
    """Share of the given model's squared error that one joint's structure makes up."""
    rms = diagnosis.extended.rms
    given = ((diagnosis.series.measured - diagnosis.simulated) / rms) ** 2
    size = rms[diagnosis.robot.joint_index(left.joint)]
    return float((left.structured / size) ** 2 / given.mean(axis=0).sum())


def _unknown(diagnosis: Diagnosis, left: Remainder) -> dict[str, Any]:
    """What no candidate explains."""
    return {
        "effect": "unknown",
        "joints": [left.joint],
        "parameters": [],
        "explained": 0.0,
        "share": _share(diagnosis, left),
        "holdout": {"rms_before": left.rms, "rms_after": left.rms},
        "verdict": "unknown",
        "structure": left.structure,
        "rivals": [],
        "figure": {
            "x_label": _LABEL[_SHOWN[left.domain]],
            "y_label": f"torque [{diagnosis.data.unit}]",
            "joint": left.joint,
        },
    }


def _shown_joint(diagnosis: Diagnosis, finding: Finding) -> int:
    """The joint whose error the cause reduces most, relative to the given model's error."""
    if isinstance(finding.effect, JointwiseEffect):
        return diagnosis.robot.joint_index(finding.effect.joints[0])
    return int(np.argmax(np.sqrt((finding.torque**2).mean(axis=0)) / diagnosis.extended.rms))


def _unexplained(diagnosis: Diagnosis, j: int) -> dict[str, Any]:
    left = diagnosis.remainders[j]
    return {
        "joint": left.joint,
        "share": float(np.clip(1 - diagnosis.extended.r2[j], 0, 1)),
        "rms": left.rms,
        "noise_floor": left.floor,
        "structure": left.structure,
        "shows": dict(left.shows),
    }


def diagnose_series(diagnosis: Diagnosis) -> dict[str, Array]:
    """Measured, simulated and extended torque on the hold-out, and the evidence per finding."""
    arrays = {
        "t": diagnosis.series.t,
        "measured": diagnosis.series.measured,
        "simulated": diagnosis.simulated,
        "extended": diagnosis.predicted,
    }
    domains = {
        "position": diagnosis.position,
        "velocity": diagnosis.velocity,
        "acceleration": diagnosis.acceleration,
        "torque": diagnosis.simulated,
        "time": np.repeat(diagnosis.series.t[:, None], diagnosis.robot.nv, axis=1),
    }
    error = diagnosis.series.measured - diagnosis.predicted
    for k, item in enumerate(ordered(diagnosis)):
        if isinstance(item, Remainder):
            j, domain = diagnosis.robot.joint_index(item.joint), _SHOWN[item.domain]
            arrays[f"finding{k}_x"] = domains[domain][:, j]
            arrays[f"finding{k}_residual"] = error[:, j]
            continue
        lead = item[0]
        j = _shown_joint(diagnosis, lead)
        domain = _DOMAIN.get(lead.effect.name, "time")
        arrays[f"finding{k}_x"] = domains[domain][:, j]
        arrays[f"finding{k}_residual"] = error[:, j] + lead.torque[:, j]
        arrays[f"finding{k}_fit"] = lead.torque[:, j]
    return arrays


def headline(diagnosis: Diagnosis) -> str:
    """The most important finding in one sentence."""
    unit = diagnosis.data.unit
    groups = grouped(diagnosis)
    order = ordered(diagnosis)
    if order and isinstance(order[0], Remainder):
        left = order[0]
        return (
            f"{left.joint}: {left.rms:.2g} {unit} stay unexplained on the hold-out, "
            f"{left.rms / left.floor:.1f} times the noise; no known cause describes them "
            f"({left.structure})."
        )
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
        name = plain(other.name)
        doubt = f" {name[0].upper()}{name[1:]} at {', '.join(other.joints)} would look the same."
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
    if isinstance(effect, GravityDirection):
        true = diagnosis.robot.gravity + values
        return (
            f"Gravity points along ({', '.join(f'{x:.2f}' for x in true)}) m/s² in the base frame"
        )
    name = plain(effect.name)
    if len(joints) > 1:
        return f"{name[0].upper()}{name[1:]} of {len(joints)} joints is missing or wrong"
    unit = effect.parameters(diagnosis.robot)[0].unit
    if finding.given[0]:
        return (
            f"{joints[0]}: {name} is {values[0]:.3g} {unit}, the model says {finding.given[0]:.3g}"
        )
    return f"{joints[0]}: {name} of {values[0]:.3g} {unit} is not in the model"
