"""A `Diagnosis` in plain words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from excitant.analysis.confirmation import Finding
from excitant.analysis.evidence import are_placeholders
from excitant.analysis.residuals import Residual
from excitant.robots.effects import plain

if TYPE_CHECKING:
    from excitant.analysis.diagnosis import Diagnosis

_MOSTLY = 0.5  # of what findings explain, or of a joint's squared error
_PLAINLY = 3.0  # times the noise


def placeholders(diagnosis: Diagnosis) -> str:
    """What is done where all links of the given model weigh the same; else empty."""
    if not are_placeholders(diagnosis.robot):
        return ""
    return (
        f"All links of the given model weigh {diagnosis.robot.phi[0]:.3g} kg, which looks like "
        "placeholders: their inertias are fitted together with the causes. A payload or a wrong "
        "link cannot be told from them."
    )


def at_rest(diagnosis: Diagnosis) -> str:
    """Joints whose error lies mostly where they rest, which no finding rests on; else empty."""
    rests = ~diagnosis.held.moves
    squares = diagnosis.left**2
    said = []
    for j, left in enumerate(diagnosis.residuals):
        there = rests[:, j]
        share = squares[there, j].sum() / max(squares[:, j].sum(), np.finfo(float).tiny)
        if share <= _MOSTLY:
            continue
        rms = float(np.sqrt(squares[there, j].mean()))
        if rms > _PLAINLY * left.floor:
            said.append(f"{left.joint} errs by {rms:.2g} {diagnosis.data.unit} where it rests")
    if not said:
        return ""
    return (
        f"{'; '.join(said)}: friction at rest takes any value up to its limit, so these rows are "
        "not judged. A slow motion with many reversals would show what holds the joint."
    )


def headline(diagnosis: Diagnosis) -> str:
    """The most important finding in one sentence, what is doubtful about it, and what else."""
    order = diagnosis.ordered
    if not order:
        nothing = (
            "No cause stands out: what the given model misses lies within the tolerance of its own "
            "values or within the noise."
        )
        return f"{nothing} {at_rest(diagnosis)}".rstrip()
    if isinstance(order[0], Residual):
        return _open(diagnosis, order[0])
    if placeholders(diagnosis):
        return _no_inertias(diagnosis)
    if _lacks_friction(diagnosis):
        return _no_friction(diagnosis)
    lead = order[0]
    joints = [joint for f in lead for joint in f.effect.joints]
    before, after = diagnosis.before_and_after(lead)
    gain = f"hold-out error {before:.2g} → {after:.2g} {diagnosis.data.unit}"
    said = lead[0].effect.sentence(diagnosis.robot, joints, lead[0].given)
    return f"{said}; {gain}.{_reservation(lead, diagnosis)}{_more(len(order) - 1)}"


def _open(diagnosis: Diagnosis, left: Residual) -> str:
    return (
        f"{left.joint}: {left.rms:.2g} {diagnosis.data.unit} stay unexplained on the hold-out "
        f"({left.against_noise}); no known cause describes them ({left.structure})."
    )


def _reservation(group: Sequence[Finding], diagnosis: Diagnosis) -> str:
    """What else the first cause of a group may be; what a group's joints may each be is below."""
    rivals = {r.candidate.effect.name for f in group for r in f.rivals}
    if not rivals:
        reasons = dict.fromkeys(f.downgrade for f in group if f.downgrade)
        return "".join(f" This is not decided: {reason}." for reason in reasons)
    if len(group) == 1:
        other = group[0].rivals[0].candidate.effect.noun(diagnosis.robot)
        return f" {other[0].upper()}{other[1:]} would look the same."
    open_ = sum(bool(f.rivals) for f in group)
    some = "all of them" if open_ == len(group) else f"{open_} of them"
    names = " or ".join(plain(name) for name in sorted(rivals)[:2])
    return f" At {some}, {names} would look the same."


def _more(count: int) -> str:
    return f" {count} more finding{'s' if count > 1 else ''} below." if count > 0 else ""


def _lacks_friction(diagnosis: Diagnosis) -> bool:
    """Whether the given model has no friction at all, and that is most of what it misses."""
    if any(effect.family == "friction" for effect in diagnosis.robot.effects):
        return False
    parts = {f: max(f.explained, 0.0) for f in diagnosis.findings}
    friction = sum(size for f, size in parts.items() if f.effect.family == "friction")
    return len(diagnosis.robot.joints) > 1 and friction > _MOSTLY * sum(parts.values())


def _no_inertias(diagnosis: Diagnosis) -> str:
    before, after = _errors(diagnosis)
    return (
        f"{placeholders(diagnosis).partition('. ')[0]}. With everything found, the hold-out error "
        f"falls from {before} to {after} % of the torque's variation (median over joints)."
        f"{_apart_from('inertias', diagnosis.groups, diagnosis)}"
        f"{_more(len(diagnosis.ordered) - 1)}"
    )


def _errors(diagnosis: Diagnosis) -> tuple[str, str]:
    """Median error over joints, given and extended, in percent of the torque's variation."""
    given, after = (
        100 * float(np.median(each.nrmse)) for each in (diagnosis.simulation, diagnosis.extended)
    )
    said = [f"{x:.0f}" if x >= 10 else f"{x:.2g}" for x in (given, after)]
    return said[0], said[1]


def _no_friction(diagnosis: Diagnosis) -> str:
    """The first sentence for models without friction; kinds and joints are in the table."""
    groups = diagnosis.groups
    friction = [group for group in groups if group[0].effect.family == "friction"]
    joints = {joint for group in friction for f in group for joint in f.effect.joints}
    kinds = list(dict.fromkeys(plain(group[0].effect.name) for group in friction))
    named = ", ".join(kinds[:3]) + (" and more" if len(kinds) > 3 else "")
    nv = diagnosis.robot.nv
    where = "all" if len(joints) == nv else f"{len(joints)} of {nv}"
    before, after = _errors(diagnosis)
    said = (
        f"The given model has no friction, and {where} joints have it ({named}); with everything "
        f"found, the hold-out error falls from {before} to {after} % of "
        "the torque's variation (median over joints)."
    )
    others = [g for g in groups if g[0].effect.family != "friction" and g[0].explained > 0]
    return said + _apart_from("friction", others, diagnosis)


def _apart_from(known: str, groups: Sequence[Sequence[Finding]], diagnosis: Diagnosis) -> str:
    """The first of some causes, said after what makes up most."""
    if not groups:
        return ""
    lead = groups[0]
    joints = [joint for f in lead for joint in f.effect.joints]
    words = lead[0].effect.sentence(diagnosis.robot, joints, lead[0].given)
    if words.startswith(("A ", "The ")):
        words = words[0].lower() + words[1:]
    verdict = "" if all(f.verdict == "named" for f in lead) else " (undecided)"
    return f" Beside {known}: {words}{verdict}."
