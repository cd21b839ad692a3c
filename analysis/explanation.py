"""Findings in words: meaning, rival causes, and the experiment that decides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from excitant.analysis.candidates import TOLERANCE
from excitant.analysis.confirmation import DEVIATIONS, IDEAL
from excitant.analysis.evidence import are_placeholders
from excitant.analysis.residuals import Residual, explanatory
from excitant.analysis.selection import is_plain_friction
from excitant.identify.rows import told
from excitant.robots.effects import Size, plain, standard_effects
from excitant.robots.motion import Array

if TYPE_CHECKING:
    from excitant.analysis.confirmation import Finding
    from excitant.analysis.diagnosis import Diagnosis
    from excitant.robots.robot import Robot

_SMALL = 0.1  # of what a cause of roughly known shape, or another curve of friction, explains
_LITTLE = 0.05  # of the squared torque of a cause that acts on several joints
_MATTERS = 0.3  # of a cause's torque at the joint where it is largest
_LEFT = 0.5  # of the squared torque of either of two causes: less, and they take each other back
_MOSTLY = 0.5  # of what findings explain, or of a joint's squared error
_COMMON = 2.0  # standard deviations of the given masses, by which all may be off alike
_PLAINLY = 3.0  # times the noise
_DRAWN_OVER = {"": "time", "constant": "time", "direction": "velocity"}


def reason_to_downgrade(
    robot: Robot,
    found: Finding,
    others: Sequence[Finding],
    left: Sequence[Residual],
    tolerance: float,
) -> str:
    """Reason to downgrade a confirmed cause without rivals to undecided; half a sentence.

    The given bodies have a relative standard deviation ``tolerance``.
    """
    effect = found.effect
    torque = found.torque
    gains = {
        j
        for f in (found, *others)
        if f.effect.physics.on_given_torque
        for j in f.effect.joints
    }
    several_gains = effect.physics.on_given_torque and 2 * len(gains) > robot.nv
    if several_gains and np.abs(effect.values or 0.0).max() < _COMMON * tolerance:
        return "given masses that are all off by one factor would look the same"
    if found.share < IDEAL:
        small = f"{100 * found.share:.1f} % of the torque"
        return f"models are hardly better than to {small}, which it makes"
    # noise of positions makes such torque too, which unseen data take back
    asked = found.asked
    if effect.physics.on_model and 1 - asked.size > max(
        TOLERANCE, DEVIATIONS * asked.error
    ):
        return (
            f"unseen data show {asked.size:.2f} ± {asked.error:.2g} times as much of it"
        )
    # a cause on several joints has to explain them all, so a smaller residual counts
    several = bool(torque.any(axis=0).sum() > 1)
    scale = np.array([r.floor for r in left])
    if (scale > 0).all():
        unknown = np.array([r.structured if r.visible else 0.0 for r in left]) / scale
        size = np.sqrt((torque**2).mean(axis=0)) / scale
        main = size > (0.0 if several else _MATTERS * size.max())
        enough = _LITTLE if several else 1.0
        if (unknown[main] ** 2).sum() > enough * (size[main] ** 2).sum():
            if several:
                return "it acts on several joints at once, and the residual on some is not small"
            return "more is left unexplained on its joints than it explains"
    # the misfit of a large cause looks like a small cause
    if found.explained < TOLERANCE**2 and not is_plain_friction(effect):
        return (
            f"larger causes are hardly known to {100 * TOLERANCE:.0f} %, which leaves more than it "
            "explains"
        )
    for other in others:
        if other is found:
            continue
        name = plain(other.effect.name)
        same = {*effect.joints} <= {*other.effect.joints}
        if _taken_back(found, other):
            return f"it and {name} mostly take each other back"
        if (
            same
            and other.effect.search.shapes
            and found.explained < _SMALL * other.explained
        ):
            return (
                f"it is small compared with {name}, whose shape is only roughly known"
            )
        if same and _SMALL * found.explained < other.explained:
            if effect.curve == other.effect.curve == "velocity":
                return f"it shares the friction curve of the joint with {name}"
            if effect.curve == other.effect.curve == "position":
                return f"it shares the position curve of the joint with {name}"
    return ""


def _taken_back(one: Finding, other: Finding) -> bool:
    """Whether two causes together make much less torque than either; bodies may well do so."""
    apart = not {*one.effect.joints} & {*other.effect.joints}
    if apart or "torque" not in (one.effect.role, other.effect.role):
        return False
    both, *each = (
        float((x**2).sum())
        for x in (one.torque + other.torque, one.torque, other.torque)
    )
    return both < _LEFT * min(each)


def placeholders(diagnosis: Diagnosis) -> str:
    """Note on a given model whose links all weigh the same; else empty."""
    if not are_placeholders(diagnosis.robot):
        return ""
    return (
        f"All links of the given model weigh {diagnosis.robot.phi[0]:.3g} kg, which suggests "
        "placeholders: their inertias are fitted together with the causes. A payload or a wrong "
        "link cannot be distinguished from them."
    )


def at_rest(diagnosis: Diagnosis) -> str:
    """Note on joints whose error lies mostly at rest, which is not judged; else empty."""
    said = []
    for j, left in enumerate(diagnosis.residuals):
        squares = diagnosis.left[:, j] ** 2
        rests = ~diagnosis.held.series.moves[:, j]
        if squares[rests].sum() <= _MOSTLY * squares.sum():
            continue
        rms = float(np.sqrt(squares[rests].mean()))
        if rms > _PLAINLY * left.floor:
            said.append(
                f"{left.joint} has an error of {rms:.2g} {diagnosis.unit(j)} at rest"
            )
    if not said:
        return ""
    return (
        f"{'; '.join(said)}: static friction takes any value up to its limit, so these rows are "
        "not judged. A slow motion with many reversals would show what holds the joint."
    )


def shared_friction(diagnosis: Diagnosis) -> str:
    """Note on joints whose usual friction was found beside other effects; else empty."""
    usual = {effect.name for effect in standard_effects(diagnosis.robot.joints)}
    found: dict[str, list[str]] = {}
    for f in diagnosis.findings:
        for joint in f.effect.joints if f.effect.role == "torque" else ():
            found.setdefault(joint, []).append(f.effect.name)
    beside = {
        joint: [n for n in names if n not in usual] for joint, names in found.items()
    }
    shared = [
        joint
        for joint, more in beside.items()
        if more and set(found[joint]) - set(more)
    ]
    if not shared:
        return ""
    names = dict.fromkeys(plain(name) for joint in shared for name in beside[joint])
    return (
        f"At {', '.join(shared)}, other effects ({', '.join(names)}) share the torque with the "
        "usual friction: its coefficients are not those of identify, which fits it without them."
    )


def headline(diagnosis: Diagnosis) -> str:
    """The main finding in a sentence, its reservation, and the number of further findings."""
    order = diagnosis.ordered
    if not order:
        nothing = (
            "No cause stands out: the error of the given model lies within the tolerance of its "
            "values or within the noise."
        )
        return f"{nothing} {at_rest(diagnosis)}".rstrip()
    if not (lead := causes(order[0])):
        return unexplained(left_of(order[0]), diagnosis)
    more = (
        f" {len(order) - 1} more finding{'s' * (len(order) > 2)} below."
        if order[1:]
        else ""
    )
    if unknown := placeholders(diagnosis):
        apart = _apart_from("inertias", diagnosis.groups, diagnosis)
        return (
            f"{unknown.partition('. ')[0]}. With {_everything(diagnosis)}{apart}{more}"
        )
    if _lacks_friction(diagnosis):
        return _no_friction(diagnosis)
    before, after = diagnosis.before_and_after(lead)
    gain = f"hold-out error {before:.2g} → {after:.2g} {diagnosis.unit(lead[0].joint)}"
    return f"{sentence(lead, diagnosis)}; {gain}.{_reservation(lead, diagnosis)}{more}"


def main_cause(diagnosis: Diagnosis, findings: Sequence[Mapping[str, Any]]) -> str:
    """The main finding in a few words, with its verdict in brackets.

    ``findings`` are the entries of its result.
    """
    order = diagnosis.ordered
    if not order:
        return "none stands out; values are off within their tolerance"
    if not (lead := causes(order[0])):
        return "none that is known"
    if unknown := placeholders(diagnosis).partition(", which")[0]:
        return f"{unknown[0].lower()}{unknown[1:]}, as placeholders do"
    said = sentence(lead, diagnosis)
    joints = findings[0]["joints"]
    if len(lead) > 1:
        where = "all joints" if len(joints) == diagnosis.robot.nv else ", ".join(joints)
        said = f"{plain(findings[0]['effect'])} missing or wrong at {where}"
    rivals = [
        f"{plain(r['effect'])} at {', '.join(r['joints'])}"
        for r in findings[0]["rivals"]
    ]
    others = [*rivals[:1], *["more"] * (len(rivals) > 1)]
    alike = f": {' or '.join(others)} would look the same" if rivals else ""
    return f"{said} ({findings[0]['verdict']}{alike})"


def percent(share: float) -> str:
    """A share in per cent, to two digits."""
    return f"{100 * share:.0f}" if share >= 0.1 else f"{100 * share:.2g}"


def causes(item: Sequence[Finding] | Sequence[Residual]) -> list[Finding]:
    """The findings of an item of a diagnosis; empty where it is what no cause explains."""
    return [each for each in item if not isinstance(each, Residual)]


def left_of(item: Sequence[Finding] | Sequence[Residual]) -> list[Residual]:
    """The residuals of an item of a diagnosis; empty where it is a cause."""
    return [each for each in item if isinstance(each, Residual)]


def unexplained(left: Sequence[Residual], diagnosis: Diagnosis) -> str:
    """How much is left that no cause explains, joint by joint, and what it depends on."""

    def size(each: Residual) -> str:
        return (
            f"{each.rms:.2g} {diagnosis.unit(diagnosis.robot.joint_index(each.joint))}"
        )

    if len(left) == 1:
        (one,) = left
        return (
            f"{one.joint}: {size(one)} remain unexplained on the hold-out ({one.against_noise}); "
            f"no known cause describes them ({one.structure})."
        )
    said = "; ".join(
        f"{each.joint} {size(each)} ({each.structure.removeprefix('structured: ')})"
        for each in left
    )
    return f"No known cause describes what remains on the hold-out at {len(left)} joints: {said}."


def sentence(group: Sequence[Finding], diagnosis: Diagnosis) -> str:
    """A cause in words, with its size: ± one standard deviation, or its range over joints."""
    robot = diagnosis.robot
    effect = group[0].effect
    kinds: dict[str, list[Finding]] = {}
    for f in group:
        kinds.setdefault(f.effect.name, []).append(f)
    joints = list(dict.fromkeys(joint for f in group for joint in f.effect.joints))
    if len(kinds) > 1:
        return f"Friction of {len(joints)} joints is not in the model: " + ", ".join(
            _ranges(part, diagnosis) for part in kinds.values()
        )
    alike = group if len(joints) == 1 else group[:1]
    said = effect.words.sentence(
        effect, robot, joints, [s for f in alike for s in sizes(f, diagnosis)]
    )
    if len(joints) > 1 and len(group) > 1:
        return f"{said}: {_ranges(group, diagnosis).removeprefix(plain(effect.name)).lstrip()}"
    return said


def sizes(found: Finding, diagnosis: Diagnosis) -> tuple[Size, ...]:
    """How large a cause is, in amperes where nothing fixes the gains of the drives."""
    robot = diagnosis.robot
    parameters = found.effect.parameters(robot)
    if not parameters:  # a fault of the data
        return ()
    both = [told(p, robot, diagnosis.drive) for p in parameters]
    factors = np.array([factor for factor, _ in both])
    by_gains = np.where(factors == 1, found.by_gains, 0.0)
    covariance = found.covariance + np.outer(by_gains, by_gains)
    return found.effect.sizes(
        factors * np.array(found.effect.values),
        factors * np.array(found.given),
        np.outer(factors, factors) * covariance,
        [unit for _, unit in both],
    )


def _ranges(group: Sequence[Finding], diagnosis: Diagnosis) -> str:
    """One effect of several joints: the range of each of its sizes, and at which joints."""
    robot = diagnosis.robot
    lead = group[0].effect
    values = dict[tuple[str, str], list[float]]()
    for f in group:
        for s in sizes(f, diagnosis):
            values.setdefault((s.name, s.unit), []).append(abs(s.value))
    ranges = []
    for (name, unit), own in values.items():
        low = f"{min(own):.2g}"
        high = f"{max(own):.2g}"
        size = low if low == high else f"{low} to {high}"
        words = (name * (len(values) > 1), size, unit.removeprefix("1"))
        ranges.append(" ".join(filter(None, words)))
    size = ", ".join(ranges)
    joints = list(dict.fromkeys(joint for f in group for joint in f.effect.joints))
    few = f" at {', '.join(joints)}" if 2 * len(joints) <= robot.nv else ""
    return f"{plain(lead.name)} {size}{few}"


def _reservation(group: Sequence[Finding], diagnosis: Diagnosis) -> str:
    """Rivals of a group's cause in a sentence, or the reason why it is undecided."""
    rivals = {r.candidate.effect.name for f in group for r in f.rivals}
    if not rivals:
        reasons = dict.fromkeys(f.downgrade for f in group if f.downgrade)
        return "".join(f" This is not decided: {reason}." for reason in reasons)
    if len(group) == 1:
        rival = group[0].rivals[0].candidate.effect
        other = rival.words.noun(rival, diagnosis.robot)
        return f" {other[0].upper()}{other[1:]} would look the same."
    open_ = sum(bool(f.rivals) for f in group)
    some = "all of them" if open_ == len(group) else f"{open_} of them"
    names = " or ".join(plain(name) for name in sorted(rivals)[:2])
    return f" At {some}, {names} would look the same."


def _lacks_friction(diagnosis: Diagnosis) -> bool:
    parts = {f: max(f.explained, 0.0) for f in diagnosis.findings}
    friction = sum(size for f, size in parts.items() if f.effect.family == "friction")
    return bool(diagnosis.bare) and friction > _MOSTLY * sum(parts.values())


def _everything(diagnosis: Diagnosis) -> str:
    both = (diagnosis.simulation, diagnosis.extended)
    before, now = (percent(float(np.median(each.nrmse))) for each in both)
    return (
        f"all causes found, the hold-out error falls from {before} to {now} % of the torque's "
        "variation (median over joints)."
    )


def _no_friction(diagnosis: Diagnosis) -> str:
    groups = diagnosis.groups
    friction = [f for group in groups for f in group if f.effect.family == "friction"]
    joints = {joint for f in friction for joint in f.effect.joints}
    kinds = list(dict.fromkeys(plain(f.effect.name) for f in friction))
    named = ", ".join(kinds[:3]) + (" and more" if len(kinds) > 3 else "")
    nv = diagnosis.robot.nv
    where = "all" if len(joints) == nv else f"{len(joints)} of {nv}"
    has = (
        "has little"
        if any(e.family == "friction" for e in diagnosis.robot.effects)
        else "has no"
    )
    said = (
        f"The given model {has} friction, and {where} joints have it ({named}); "
        f"with {_everything(diagnosis)}"
    )
    others = [
        g for g in groups if g[0].effect.family != "friction" and g[0].explained > 0
    ]
    return said + _apart_from("friction", others, diagnosis)


def _apart_from(
    known: str, groups: Sequence[Sequence[Finding]], diagnosis: Diagnosis
) -> str:
    if not groups:
        return ""
    words = sentence(groups[0], diagnosis)
    if words.startswith(("A ", "The ")):
        words = words[0].lower() + words[1:]
    verdict = "" if all(f.verdict == "named" for f in groups[0]) else " (undecided)"
    return f" Besides {known}: {words}{verdict}."


@dataclass(frozen=True, eq=False)
class Curve:
    """One figure of evidence: the error without a cause over its characteristic quantity."""

    joint: int  # index of the joint that is shown
    x_label: str
    x: Array  # at the rows of the hold-out, NaN where not to be shown, shape (n,)
    residual: Array  # residual there without the cause, shape (n,) [torque unit]
    fit: Array | None = None  # torque of the cause; None where there is none
    # of its closest rival, fitted to the residual; None without one
    rival: Array | None = None


def curve_of(
    diagnosis: Diagnosis, item: Sequence[Finding] | Sequence[Residual]
) -> Curve:
    """The figure of a group of findings, by its first, or of the largest unexplained residual."""
    moves = diagnosis.held.series.moves
    if not (group := causes(item)):
        left = left_of(item)[0]
        j = diagnosis.robot.joint_index(left.joint)
        label, x = _abscissa(
            diagnosis, _DRAWN_OVER.get(left.dominant, left.dominant), j
        )
        return Curve(j, label, np.where(moves[:, j], x, np.nan), diagnosis.left[:, j])
    lead = group[0]
    j = lead.joint
    joints = lead.effect.rows(diagnosis.robot)
    other = next((k for k in joints if k != j), j)
    # all friction of a joint is one curve
    torque = np.sum([f.torque[:, j] for f in group], axis=0)
    if lead.effect.words.abscissa == "own torque":
        drawn = (
            f"torque of the fitted {plain(lead.effect.name)} [{diagnosis.unit(j)}]",
            torque,
        )
    else:
        drawn = _abscissa(diagnosis, lead.effect.words.abscissa, j, other)
    label, x = drawn
    if lead.effect.words.drawn is not None:
        label, x = lead.effect.words.drawn(lead.effect, label, x)
    x = np.where(moves[:, j], x, np.nan)
    residual = diagnosis.left[:, j] + torque
    rival = (
        _rival(diagnosis, lead, j, residual)
        if len({f.effect.name for f in group}) == 1
        else None
    )
    return Curve(j, label, x, residual, torque, rival)


def _rival(
    diagnosis: Diagnosis, finding: Finding, j: int, residual: Array
) -> Array | None:
    """Torque of the first rival fitted to a joint's residual, friction against friction."""
    effects = [finding.effect, *(r.candidate.effect for r in finding.rivals[:1])]
    alike = all(e.jointwise and e.family == "friction" for e in effects)
    if len(effects) < 2 or not alike:
        return None
    usual = standard_effects((diagnosis.robot.joints[j],))
    beside = [e for e in usual if e.export.joint_property in ("viscous", "offset")]
    held = diagnosis.extension.held
    columns = np.concatenate(
        [held.columns(e)[:, j] for e in (effects[1], *beside)], axis=1
    )
    rows = diagnosis.held.series.moves[:, j]
    sizes = np.sqrt((columns[rows] ** 2).sum(axis=0))
    unit = columns[:, sizes > 0] / sizes[sizes > 0]
    if not unit.shape[1]:
        return None
    fitted: Array = unit @ np.linalg.lstsq(unit[rows], residual[rows], rcond=1e-8)[0]
    return fitted


def _abscissa(
    diagnosis: Diagnosis, domain: str, j: int, other: int = 0
) -> tuple[str, Array]:
    unit = diagnosis.unit(j)
    name = diagnosis.robot.joints[other]
    way_unit, far_unit = (
        "rad" if diagnosis.robot.revolute[k] else "m" for k in (j, other)
    )
    q, dq, ddq = diagnosis.states
    t = diagnosis.held.series.t
    torque = diagnosis.extension.predicted[:, j]
    if domain == "reversal":
        where = explanatory(diagnosis.data.validate, diagnosis.extension.predicted)
        label = f"distance since the last reversal, signed by direction [{way_unit}]"
        return label, where.reversal[:, j]
    return {
        "velocity": (f"joint velocity [{way_unit}/s]", dq[:, j]),
        "other velocity": (f"velocity of {name} [{far_unit}/s]", dq[:, other]),
        "acceleration": (f"joint acceleration [{way_unit}/s²]", ddq[:, j]),
        "other acceleration": (
            f"acceleration of {name} [{far_unit}/s²]",
            ddq[:, other],
        ),
        "position": (f"joint position [{way_unit}]", q[:, j]),
        "torque": (
            f"torque of the given model [{unit}]",
            diagnosis.held.simulated[:, j],
        ),
        "torque rate": (f"rate of torque [{unit}/s]", np.gradient(torque, t)),
        "load": (
            f"magnitude of the joint's torque, signed by direction [{unit}]",
            abs(torque) * np.sign(dq[:, j]),
        ),
        "time": ("time [s]", t),
    }[domain]
