"""What findings mean, in words, and why each may be another cause after all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from excitant.analysis.evidence import Candidate, Evidence, Key, are_placeholders
from excitant.analysis.residuals import Residual
from excitant.analysis.selection import frictionless, is_plain_friction, plausible
from excitant.robots.effects import Effect, plain
from excitant.robots.motion import Array
from excitant.robots.robot import Robot

if TYPE_CHECKING:
    from excitant.analysis.confirmation import Finding
    from excitant.analysis.diagnosis import Diagnosis

_TIE = 2.0  # standard errors within which two causes explain the data alike
_TIE_ALIKE = 3.3  # the same where their signatures are alike
_ALIKE = 0.9  # |cos| of such signatures
_SAME = 0.999  # |cos| of a cause that is part of another
_HALF = 0.5  # of what a cause explains, at least, must a rival explain
_SMALL = 0.1  # of what a cause explains whose shape is known roughly
_LITTLE = 0.05  # of the squared torque of a cause that acts on several joints
_MATTERS = 0.3  # of what a cause does to the joint where it shows most
_MOSTLY = 0.5  # of what findings explain, or of a joint's squared error
_PLAINLY = 3.0  # times the noise


@dataclass(frozen=True)
class Rival:
    """Another cause that the data cannot tell from the one found.

    Attributes:
        candidate: The other cause.
        deviations: By how many standard errors the one found explains the data better.
        cosine: Largest |cos| between both signatures.
    """

    candidate: Candidate
    deviations: float
    cosine: float


def rivals(
    evidence: Evidence, robot: Robot, chosen: Sequence[Candidate], found: Candidate
) -> list[Rival]:
    """Causes that could stand in place of one that was found.

    A rival explains at least half of what the found cause explains, and leaves it less than half
    to explain. The two are compared by the squared error that each leaves, block by block of time
    (Vuong 1989): within two standard errors they tie; within 3.3 where their signatures are
    alike. On joints whose friction is all new, a rival may bring the standard model's along.
    """
    rest, taken = [c for c in chosen if c is not found], {c.key for c in chosen}
    bare, falls = frictionless(robot), evidence.additions(rest)
    own, errors = falls[evidence.candidates.index(found)], evidence.block_errors(chosen)
    best: dict[Key, Rival] = {}
    for k, other in enumerate(evidence.candidates):
        if other.key in taken or _only_more(evidence, found, other):
            continue
        friends = _friction(evidence, other, rest) if {*other.effect.joints} <= bare else []
        if falls[k] <= _HALF * own and not friends:
            continue
        instead = [*rest, other, *(c for c in friends if c is not other and c is not found)]
        left = evidence.cost(instead) - evidence.cost([*instead, found])
        if left > _HALF * own:
            continue
        difference = evidence.block_errors(instead) - errors
        z = float(difference.sum() / max(np.sqrt(len(difference)) * difference.std(ddof=1), 1e-12))
        cosine = evidence.cosine(found, other)
        if z >= (_TIE_ALIKE if cosine > _ALIKE else _TIE):
            continue
        known = best.get(other.key)
        if (known is None or z < known.deviations) and plausible(evidence, robot, instead, other):
            best[other.key] = Rival(other, z, cosine)
    return sorted(best.values(), key=lambda rival: rival.deviations)


def _friction(evidence: Evidence, other: Candidate, rest: Sequence[Candidate]) -> list[Candidate]:
    """Standard friction of a friction's joint, as far as it is not there."""
    if other.effect.family != "friction":
        return []
    return [
        c
        for c in evidence.candidates
        if is_plain_friction(c.effect) and c.effect.joints == other.effect.joints and c not in rest
    ]


def _only_more(evidence: Evidence, found: Candidate, other: Candidate) -> bool:
    """Whether another cause is the one found with more coefficients."""
    special = found.effect.name in other.effect.contains and other.size > found.size
    real = found.effect.name in other.effect.imitates
    return special and not real and evidence.cosine(found, other) > _SAME


def reason_to_downgrade(
    effect: Effect,
    torque: Array,
    explained: float,
    others: Sequence[tuple[Effect, float]],
    left: Sequence[Residual],
) -> str:
    """Why a finding without rivals is still not decided, as half a sentence; empty without one.

    Args:
        effect: The cause.
        torque: What it adds at the rows of the hold-out, shape (n, nv) [torque unit].
        explained: Share of the given model's squared error that it removes.
        others: All causes that pay, each with that share.
        left: What the extended model leaves, joint by joint.
    """
    # what a cause on several joints leaves on some counts sooner: it has to explain them all
    several = bool(torque.any(axis=0).sum() > 1)
    scale = np.array([r.floor for r in left])
    if (scale > 0).all():
        unknown = np.array([r.structured if r.visible else 0.0 for r in left]) / scale
        size = np.sqrt((torque**2).mean(axis=0)) / scale
        main = size > (0.0 if several else _MATTERS * size.max())
        enough = _LITTLE if several else 1.0
        if (unknown[main] ** 2).sum() > enough * (size[main] ** 2).sum():
            if several:
                return "it acts on several joints at once, and what it leaves on some is not small"
            return "more is left unexplained on its joints than it explains"
    # what a shape misses of a large cause looks like a small one
    for other, share in others:
        same = {*effect.joints} <= {*other.joints}
        if same and other.shapes and explained < _SMALL * share:
            return f"it is small beside {plain(other.name)}, whose shape is only roughly known"
    return ""


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
        left = order[0]
        return (
            f"{left.joint}: {left.rms:.2g} {diagnosis.data.unit} stay unexplained on the hold-out "
            f"({left.against_noise}); no known cause describes them ({left.structure})."
        )
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
    return (
        f"{placeholders(diagnosis).partition('. ')[0]}. With {_everything(diagnosis)}"
        f"{_apart_from('inertias', diagnosis.groups, diagnosis)}"
        f"{_more(len(diagnosis.ordered) - 1)}"
    )


def _everything(diagnosis: Diagnosis) -> str:
    """What all findings together bring."""
    given, after = (
        100 * float(np.median(each.nrmse)) for each in (diagnosis.simulation, diagnosis.extended)
    )
    before, now = (f"{x:.0f}" if x >= 10 else f"{x:.2g}" for x in (given, after))
    return (
        f"everything found, the hold-out error falls from {before} to {now} % of the torque's "
        "variation (median over joints)."
    )


def _no_friction(diagnosis: Diagnosis) -> str:
    """The first sentence for models without friction; kinds and joints are in the table."""
    groups = diagnosis.groups
    friction = [group for group in groups if group[0].effect.family == "friction"]
    joints = {joint for group in friction for f in group for joint in f.effect.joints}
    kinds = list(dict.fromkeys(plain(group[0].effect.name) for group in friction))
    named = ", ".join(kinds[:3]) + (" and more" if len(kinds) > 3 else "")
    nv = diagnosis.robot.nv
    where = "all" if len(joints) == nv else f"{len(joints)} of {nv}"
    said = (
        f"The given model has no friction, and {where} joints have it ({named}); "
        f"with {_everything(diagnosis)}"
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
