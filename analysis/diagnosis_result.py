"""Contents of ``result.json`` of a diagnosis, figures of evidence, and experiments that decide.

A figure shows the error without a cause over the variable that characterises it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from excitant.analysis.confirmation import Finding
from excitant.analysis.explanation import (
    Item,
    at_rest,
    coefficients,
    explained_by,
    joints_of,
    placeholders,
    rivals_of,
    sentence,
    share_of,
    shared_friction,
    sizes,
    too_slight,
    unexplained,
)
from excitant.analysis.residuals import Residual, explanatory
from excitant.analysis.selection import Rival
from excitant.analysis.thresholds import DISCRIMINATION, VERDICT
from excitant.identify.rows import states
from excitant.robots.effects import (
    Effect,
    measuring_experiment,
    plain,
    separating_experiment,
)
from excitant.robots.motion import Array, root_mean_square

if TYPE_CHECKING:
    from excitant.analysis.diagnosis import Diagnosis
    from excitant.design import Trajectory

_DRAWN_OVER = {"": "time", "constant": "time", "direction": "velocity"}

Entry = dict[str, Any]
Pairing = tuple[str, tuple[str, ...], str, tuple[str, ...]]
"""Name and joints of the cause found, and of its rival."""


@dataclass(frozen=True)
class Advice:
    """Experiment that decides between two rivals, with the names of ``result.json``."""

    experiment: str  # what to do, as a sentence
    # expected, in standard deviations; None for an action
    separation: float | None = None
    repetitions: int | None = None  # runs that are needed
    file: str | None = None  # motion to run


@dataclass(frozen=True, eq=False)
class Plan:
    """Experiments that decide an undecided diagnosis; general actions when empty."""

    experiments: Mapping[Pairing, Advice] = field(default_factory=dict)
    # in the order of their files separate-1, …
    motions: tuple[Trajectory, ...] = ()
    # one of these, for causes without rivals or motions of their own; None where not needed
    general: Advice | None = None

    def of(self, found: Effect, rival: Effect) -> Advice:
        """Experiment for a pair; the general action where no motion was looked for."""
        advice = self.experiments.get(key(found, rival))
        return advice or Advice(separating_experiment(found, rival))


def key(found: Effect, rival: Effect) -> Pairing:
    """Names and joints of a pair."""
    return found.name, found.joints, rival.name, rival.joints


def _deciding(diagnosis: Diagnosis, group: Sequence[Finding], plan: Plan) -> str:
    """The one experiment for the largest undecided finding of a group, or why there is none.

    A motion that separates it from a rival, or shows all values better, else an action; what
    measures the cause where it has no rival.
    """
    undecided = [f for f in group if f.verdict == "undecided"]
    if not undecided:
        return ""
    finding = max(undecided, key=lambda f: f.explained)
    if not finding.matters:
        share = f"{100 * DISCRIMINATION.matters:.0f} % of its joints' squared error"
        return f"none is looked for, as it explains less than {share}"
    advices = [
        plan.of(finding.effect, rival)
        for rival in rivals_of(finding, diagnosis.findings)
    ]
    if advices:
        by_use = min(advices, key=lambda a: (a.separation is None, a.file is None))
        return by_use.experiment
    action = measuring_experiment(finding.effect)
    return (
        f"{plan.general.experiment}, or else: {action}" if plan.general else action
    )


def result_of(diagnosis: Diagnosis, plan: Plan) -> Entry:
    """All contents, with a plan's experiments or else general actions."""
    drive = diagnosis.drive
    joints = diagnosis.robot.joints
    notes = [
        *(each.sentence(diagnosis.robot) for each in diagnosis.differences),
        *diagnosis.notes,
        placeholders(diagnosis),
        at_rest(diagnosis),
        shared_friction(diagnosis),
        too_slight(diagnosis),
    ]
    return {
        "verb": "diagnose",
        "robot": diagnosis.robot.name,
        "headline": diagnosis.headline,
        "unit": diagnosis.unit(),
        "cutoff_hz": diagnosis.data.cutoff_hz,
        **({"drive_gain_Nm_per_A": None} if drive is None else drive.result()),
        "holdout": diagnosis.data.holdout,
        "simulation": {"joints": diagnosis.simulation.entries(joints)},
        "faults": [],
        "differences": [
            each.entry(diagnosis.robot) for each in diagnosis.differences
        ],
        "findings": [
            entry | {"figure": _figure(diagnosis, item)}
            for item, entry in zip(
                diagnosis.ordered, findings_of(diagnosis, plan), strict=True
            )
        ],
        "corrected": [
            p for f in diagnosis.corrected for p in _parameters(f, diagnosis)
        ],
        "unexplained": [
            {
                "joint": residual.joint,
                "share": float(np.clip(1 - r2, 0, 1)),
                "against_noise": residual.against_noise,
                "structure": residual.structure,
            }
            for residual, r2 in zip(
                diagnosis.residuals, diagnosis.extended.r2, strict=True
            )
        ],
        "extended": {"joints": diagnosis.extended.entries(joints)},
        "error": {
            "joints": [
                {
                    "name": residual.joint,
                    "rms": residual.rms,
                    "shares": dict(residual.shares),
                    "telling": residual.dominant,
                }
                for residual in diagnosis.nominal_residuals
            ]
        },
        "notes": [note for note in notes if note],
    }


def with_repairs(
    diagnosis: Diagnosis, faults: Sequence[Mapping[str, Any]]
) -> list[Entry]:
    """Faults of the recordings as `Checked.entries` tells them, with what is repaired here."""
    set_up = diagnosis.set_up
    return [
        {
            **f,
            "repaired": f["repaired"] or (set_up is not None and set_up.amends(f)),
        }
        for f in faults
    ]


def findings_of(diagnosis: Diagnosis, plan: Plan) -> list[Entry]:
    """Findings in order of importance."""
    return [
        _cause(diagnosis, item.findings, plan)
        if item.findings
        else _unknown(diagnosis, item.residuals)
        for item in diagnosis.ordered
    ]


def _cause(diagnosis: Diagnosis, group: Sequence[Finding], plan: Plan) -> Entry:
    """One cause at some joints; friction of several kinds with each kind as a part."""
    kinds = list(dict.fromkeys(f.effect.name for f in group))
    several = len(kinds) > 1
    before, after = diagnosis.before_and_after(group)
    explained = explained_by(group)
    least = several * VERDICT.minor_kind * explained
    rivals = {
        rival.candidate.key: (f.effect, rival)
        for f in group
        if f.explained > least
        for rival in f.rivals
        if not several or rival.candidate.effect.family != "friction"
    }
    named = all(f.verdict == "named" for f in group) or (several and not rivals)
    reasons = dict.fromkeys(f.downgrade for f in group if f.downgrade)
    torque = np.sum([f.torque for f in group], axis=0)
    rms = diagnosis.holdout.series.rms(torque).tolist()
    entry: Entry = {
        "effect": "friction" if several else kinds[0],
        "joints": joints_of(group),
        "sentence": sentence(group, diagnosis),
        "parameters": [p for f in group for p in _parameters(f, diagnosis)],
        "sizes": [s.entry() for f in group for s in sizes(f, diagnosis)],
        # causes may make up for one another
        "explained": min(explained, 1.0),
        "by_joint": dict(zip(diagnosis.robot.joints, rms, strict=True)),
        "holdout": {"rms_before": before, "rms_after": after},
        "unit": diagnosis.unit(group[0].joint),
        "verdict": "named" if named else "undecided",
        "doubt": "" if named else "; ".join(reasons),
        "experiment": "" if named else _deciding(diagnosis, group, plan),
        "rivals": [
            _rival(effect, rival, plan) for effect, rival in rivals.values()
        ],
    }
    if several:
        parts: dict[tuple[str, str], list[Finding]] = {}
        for f in group:
            parts.setdefault((f.effect.name, f.verdict), []).append(f)
        entry["parts"] = [_cause(diagnosis, part, plan) for part in parts.values()]
    return entry


def _rival(effect: Effect, rival: Rival, plan: Plan) -> Entry:
    other = rival.candidate.effect
    return {
        "effect": other.name,
        "joints": list(other.joints),
        "why": f"explains this motion equally well (to {max(rival.deviations, 0.0):.1f} "
        f"standard errors; |cos| between the signatures is {rival.cosine:.2f})",
        **asdict(plan.of(effect, other)),
    }


def _parameters(finding: Finding, diagnosis: Diagnosis) -> Iterator[Entry]:
    effect = finding.effect
    named = finding.verdict == "named"
    value, nominal, covariance, units = coefficients(finding, diagnosis)
    names = [p.name for p in effect.parameters(diagnosis.robot)][: len(value)]
    for k, name in enumerate(names):
        # torque shows a link only together with others; an undecided cause may be absent
        known = named and effect.role != "link"
        yield {
            "name": name,
            "value": float(value[k]),
            "given": float(nominal[k]),
            "unit": units[k],
            "std": float(np.sqrt(covariance[k, k])) if known else None,
        }
    for s in effect.search.shapes:
        if s.positive and not s.trial:
            yield {
                "name": f"{effect.joints[0]}.{s.name}",
                "value": getattr(effect, s.name),
                "std": vars(effect).get("std") or None if named else None,
                "unit": effect.shape_unit(diagnosis.robot, s),
            }


def _unknown(diagnosis: Diagnosis, residuals: Sequence[Residual]) -> Entry:
    """What no cause explains, of all joints at once."""
    rms = float(
        root_mean_square(np.array([residual.rms for residual in residuals]))
    )
    joint = diagnosis.robot.joint_index(residuals[0].joint)
    return {
        "effect": "unknown",
        "joints": [residual.joint for residual in residuals],
        "sentence": unexplained(residuals, diagnosis),
        "parameters": [],
        "explained": 0.0,
        "by_joint": {residual.joint: residual.structured for residual in residuals},
        "share": sum(share_of(diagnosis, residual) for residual in residuals),
        "holdout": {"rms_before": rms, "rms_after": rms},
        "unit": diagnosis.unit(joint),
        "verdict": "unknown",
        "structure": "; ".join(dict.fromkeys(r.structure for r in residuals)),
        "rivals": [],
    }


def _figure(diagnosis: Diagnosis, item: Item) -> Entry:
    curve = curve_of(diagnosis, item)
    return {
        "x_label": curve.x_label,
        "y_label": f"torque [{diagnosis.unit(curve.joint)}]",
        "joint": diagnosis.robot.joints[curve.joint],
    }


@dataclass(frozen=True, eq=False)
class Curve:
    """One figure of evidence."""

    joint: int  # index of the joint that is shown
    x_label: str
    x: Array  # at the rows of the hold-out, NaN where not to be shown, shape (n,)
    residual: Array  # residual there without the cause, shape (n,) [torque unit]
    fit: Array | None = None  # torque of the cause; None where there is none


def curve_of(diagnosis: Diagnosis, item: Item) -> Curve:
    """The figure of a group of findings, by its first, or of the largest unexplained residual."""
    moves = diagnosis.holdout.series.moves
    error = diagnosis.error
    if not item.findings:
        residual = item.residuals[0]
        j = diagnosis.robot.joint_index(residual.joint)
        domain = _DRAWN_OVER.get(residual.dominant, residual.dominant)
        label, x = _abscissa(diagnosis, domain, j)
        return Curve(j, label, np.where(moves[:, j], x, np.nan), error[:, j])
    lead = item.findings[0]
    effect = lead.effect
    j = lead.joint
    other = next((k for k in effect.rows(diagnosis.robot) if k != j), j)
    # all friction of a joint is one curve
    torque = np.sum([f.torque[:, j] for f in item.findings], axis=0)
    if effect.words.abscissa == "own torque":
        label = f"torque of the fitted {plain(effect.name)} [{diagnosis.unit(j)}]"
        x = torque
    else:
        label, x = _abscissa(diagnosis, effect.words.abscissa, j, other)
    if effect.words.drawn is not None:
        label, x = effect.words.drawn(effect, label, x)
    x = np.where(moves[:, j], x, np.nan)
    return Curve(j, label, x, error[:, j] + torque, torque)


def _abscissa(
    diagnosis: Diagnosis, domain: str, j: int, other: int = 0
) -> tuple[str, Array]:
    robot = diagnosis.robot
    unit = diagnosis.unit(j)
    name = robot.joints[other]
    own_unit, other_unit = ("rad" if robot.revolute[k] else "m" for k in (j, other))
    segments = diagnosis.data.validate
    predicted = diagnosis.extension.predicted
    torque = predicted[:, j]
    t = diagnosis.holdout.series.t
    if domain == "reversal":
        label = (
            f"distance since the last reversal, signed by direction [{own_unit}]"
        )
        return label, explanatory(segments, predicted).reversal[:, j]
    motion = states(segments)
    return {
        "velocity": (f"joint velocity [{own_unit}/s]", motion.dq[:, j]),
        "other velocity": (
            f"velocity of {name} [{other_unit}/s]",
            motion.dq[:, other],
        ),
        "acceleration": (f"joint acceleration [{own_unit}/s²]", motion.ddq[:, j]),
        "other acceleration": (
            f"acceleration of {name} [{other_unit}/s²]",
            motion.ddq[:, other],
        ),
        "position": (f"joint position [{own_unit}]", motion.q[:, j]),
        "torque": (
            f"torque of the given model [{unit}]",
            diagnosis.holdout.nominal[:, j],
        ),
        "torque rate": (f"rate of torque [{unit}/s]", np.gradient(torque, t)),
        "load": (
            f"magnitude of the joint's torque, signed by direction [{unit}]",
            abs(torque) * np.sign(motion.dq[:, j]),
        ),
        "time": ("time [s]", t),
    }[domain]
