"""Findings of a diagnosis by cause, in order of importance and in words, doubts included."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from excitant.analysis.confirmation import Finding, cancelling
from excitant.analysis.evidence import are_placeholders
from excitant.analysis.residuals import Residual
from excitant.analysis.selection import is_plain_friction
from excitant.analysis.thresholds import CONFIRMATION, EVIDENCE, VERDICT
from excitant.identify.rows import told
from excitant.robots.effects import Effect, Size, plain, standard_effects
from excitant.robots.motion import Array, root_mean_square
from excitant.robots.robot import Robot

if TYPE_CHECKING:
    from excitant.analysis.diagnosis import Diagnosis


@dataclass(frozen=True, eq=False)
class Item:
    """Findings of one cause, or else what no cause explains."""

    findings: Sequence[Finding] = ()
    residuals: Sequence[Residual] = ()


def explained_by(group: Sequence[Finding]) -> float:
    """Share of the nominal model's squared error that a group removes."""
    return sum(finding.explained for finding in group)


def joints_of(group: Sequence[Finding]) -> list[str]:
    """Joints of findings, each once."""
    return list(dict.fromkeys(joint for f in group for joint in f.effect.joints))


def is_slight(group: Sequence[Finding]) -> bool:
    """Whether a group is undecided, without rivals, and within the misfit of larger causes."""
    undecided = all(f.downgrade and not f.rivals for f in group)
    return undecided and explained_by(group) < EVIDENCE.tolerance**2


def lacking_friction(diagnosis: Diagnosis) -> frozenset[str]:
    """Joints of which the nominal model has less than half the friction, if they are most."""
    robot = diagnosis.robot
    holdout = diagnosis.holdout
    rms = holdout.series.rms
    nominal = np.zeros_like(holdout.nominal)
    for effect in robot.effects:
        if effect.family == "friction":
            nominal += holdout.observed.columns(effect) @ np.array(effect.values)
    friction = [f for f in diagnosis.findings if f.effect.family == "friction"]
    added = sum((f.torque for f in friction), np.zeros_like(nominal))
    threshold = VERDICT.lacking_friction * rms(added)
    lacking = rms(nominal / holdout.gains) < threshold
    joints = {joint for f in friction for joint in f.effect.joints}
    joints &= {*np.array(robot.joints)[lacking].tolist()}
    most = 2 * len(joints) > robot.nv > 2
    return frozenset(joints if most else ())


def grouped(diagnosis: Diagnosis) -> list[list[Finding]]:
    """Findings by cause: all friction that the model lacks, else an effect of one verdict."""
    groups: dict[Hashable, list[Finding]] = {}
    for finding in diagnosis.findings:
        effect = finding.effect
        cause: Hashable = (
            effect.name,
            finding.verdict,
            effect.jointwise or effect.joints,
        )
        if (
            effect.family == "friction"
            and {*effect.joints} <= diagnosis.no_friction
        ):
            cause = "friction"
        revolute = diagnosis.robot.revolute[finding.joint]
        groups.setdefault((revolute, cause), []).append(finding)
    return sorted(groups.values(), key=lambda group: -explained_by(group))


def ordered(diagnosis: Diagnosis) -> list[Item]:
    """Groups of findings by their gain, the set-up first, and what remains visibly."""
    set_up = diagnosis.set_up
    changes = () if set_up is None else (*set_up.faults, *set_up.effects)
    first = {(effect.name, joint) for effect in changes for joint in effect.joints}
    items = list[tuple[float, Item]]()
    for group in diagnosis.groups:
        effect = group[0].effect
        is_first = (effect.name, effect.joints[0]) in first
        items.append((np.inf if is_first else explained_by(group), Item(group)))

    def share(residual: Residual) -> float:
        return share_of(diagnosis, residual)

    visible = [residual for residual in diagnosis.residuals if residual.visible]
    if visible:
        visible = sorted(visible, key=share)[::-1]
        items.append((sum(map(share, visible)), Item((), visible)))
    return [item for _, item in sorted(items, key=lambda pair: -pair[0])]


def share_of(diagnosis: Diagnosis, residual: Residual) -> float:
    """One joint's residual beyond noise as a share of the nominal model's squared error."""
    rms = diagnosis.extended.rms
    nominal = (diagnosis.simulation.rms / rms) ** 2
    size = rms[diagnosis.robot.joint_index(residual.joint)]
    return float((residual.structured / size) ** 2 / nominal.sum())


def placeholders(diagnosis: Diagnosis) -> str:
    """Note on a nominal model whose links all weigh the same; else empty."""
    if not are_placeholders(diagnosis.robot):
        return ""
    return (
        f"All links of the given model weigh {diagnosis.robot.phi[0]:.3g} kg, which suggests "
        "placeholders: their inertias are fitted together with the causes. A payload or a wrong "
        "link cannot be distinguished from them."
    )


def at_rest(diagnosis: Diagnosis) -> str:
    """Note on joints whose error lies mostly at rest, which is not judged; else empty."""
    errors = []
    for j, residual in enumerate(diagnosis.residuals):
        squares = diagnosis.error[:, j] ** 2
        rests = ~diagnosis.holdout.series.moves[:, j]
        if squares[rests].sum() <= VERDICT.at_rest * squares.sum():
            continue
        rms = np.sqrt(squares[rests].mean())
        if rms > VERDICT.above_noise * residual.floor:
            size = f"{rms:.2g} {diagnosis.unit(j)}"
            errors.append(f"{residual.joint} has an error of {size} at rest")
    if not errors:
        return ""
    return (
        f"{'; '.join(errors)}: static friction takes any value up to its limit, so these rows are "
        "not judged. A slow motion with many reversals would show what holds the joint."
    )


def shared_friction(diagnosis: Diagnosis) -> str:
    """Note on joints whose usual friction was found beside other effects; else empty."""
    usual = {effect.name for effect in standard_effects(diagnosis.robot.joints)}
    by_joint: dict[str, list[str]] = {}
    for finding in diagnosis.findings:
        effect = finding.effect
        for joint in effect.joints if effect.role == "torque" else ():
            by_joint.setdefault(joint, []).append(effect.name)
    shared = [
        j for j, names in by_joint.items() if usual & {*names} and {*names} - usual
    ]
    if not shared:
        return ""
    names = (
        name for joint in shared for name in by_joint[joint] if name not in usual
    )
    others = dict.fromkeys(map(plain, names))
    return (
        f"At {', '.join(shared)}, other effects ({', '.join(others)}) share the torque with the "
        "usual friction: its coefficients are not those of identify, which fits it without them."
    )


def too_slight(diagnosis: Diagnosis) -> str:
    """Note on causes that are no findings of their own; else empty."""
    names = [
        f"{plain(group[0].effect.name)} at {', '.join(f.effect.joints[0] for f in group)}"
        for group in grouped(diagnosis)[VERDICT.listed :]
        if is_slight(group)
    ]
    listed = "; ".join(names)
    return (
        listed
        and f"Too slight to distinguish from the misfit of larger causes: {listed}."
    )


def headline(diagnosis: Diagnosis) -> str:
    """The main finding in a sentence, its reservation, and the number of further findings."""
    items = diagnosis.ordered
    if not items:
        nothing = (
            "No cause stands out: the error of the given model lies within the tolerance of its "
            "values or within the noise."
        )
        return f"{nothing} {at_rest(diagnosis)}".rstrip()
    lead = items[0].findings
    if not lead:
        return unexplained(items[0].residuals, diagnosis)
    further = len(items) - 1
    more = f" {further} more finding{'s' * (further > 1)} below." if further else ""
    before, after = diagnosis.before_and_after(lead)
    unit = diagnosis.unit(lead[0].joint)
    cause = (
        f"{sentence(lead, diagnosis)}; hold-out error {before:.2g} → {after:.2g} {unit}."
        f"{_reservation(lead, diagnosis)}{more}"
    )
    if note := placeholders(diagnosis):
        return f"{note.partition(':')[0]}. Besides inertias: {cause}"
    return cause


def unexplained(residuals: Sequence[Residual], diagnosis: Diagnosis) -> str:
    """How much remains that no cause explains, joint by joint, and what it depends on."""

    def size(residual: Residual) -> str:
        unit = diagnosis.unit(diagnosis.robot.joint_index(residual.joint))
        return f"{residual.rms:.2g} {unit}"

    if len(residuals) == 1:
        (residual,) = residuals
        return (
            f"{residual.joint}: {size(residual)} remain unexplained on the hold-out "
            f"({residual.against_noise}); no known cause describes them ({residual.structure})."
        )
    joints = "; ".join(
        f"{r.joint} {size(r)} ({r.structure.removeprefix('structured: ')})"
        for r in residuals
    )
    return (
        f"No known cause describes what remains on the hold-out at {len(residuals)} joints: "
        f"{joints}."
    )


def sentence(group: Sequence[Finding], diagnosis: Diagnosis) -> str:
    """A cause in words, with its size: ± one standard deviation, or its range over joints."""
    lead = group[0].effect
    joints = joints_of(group)
    if len({f.effect.name for f in group}) > 1:
        sure = {f.effect.name for f in group if f.verdict == "named"}
        named = [f for f in group if f.effect.name in sure] or group
        # effects one by one, the range of each of their sizes
        kinds = ", ".join(
            _ranges([f for f in named if f.effect.name == kind], diagnosis)
            for kind in dict.fromkeys(f.effect.name for f in named)
        )
        where = joints[0] if len(joints) == 1 else f"{len(joints)} joints"
        return f"Friction of {where} is not in the model: {kinds}"
    alike = group if len(joints) == 1 else group[:1]
    of_all = [size for f in alike for size in sizes(f, diagnosis)]
    text = lead.words.sentence(lead, diagnosis.robot, joints, of_all)
    if len(joints) > 1 and len(group) > 1:
        ranges = _ranges(group, diagnosis).removeprefix(plain(lead.name)).lstrip()
        return f"{text}: {ranges}"
    return text


class Coefficients(NamedTuple):
    """Coefficients of a cause, in amperes where nothing fixes the gains of the drives."""

    value: Array  # shape (k,)
    nominal: Array  # shape (k,)
    covariance: Array  # shape (k, k)
    units: list[str]


def coefficients(finding: Finding, diagnosis: Diagnosis) -> Coefficients:
    """The coefficients of a cause; none of a fault of the data, or of another law."""
    robot = diagnosis.robot
    values = np.array(finding.effect.values or ())
    parameters = finding.effect.parameters(robot)[: len(values)]
    scales = [told(p, robot, diagnosis.drive) for p in parameters]
    factors = np.array([factor for factor, _ in scales])
    # amperes do not depend on the gain
    by_gains = np.where(factors == 1, finding.by_gains, 0.0)
    covariance = replace(finding, by_gains=by_gains).total
    return Coefficients(
        factors * values,
        factors * finding.nominal,
        np.outer(factors, factors) * covariance,
        [unit for _, unit in scales],
    )


def sizes(finding: Finding, diagnosis: Diagnosis) -> tuple[Size, ...]:
    """How large a cause is."""
    if not finding.effect.values:
        return ()
    found = finding.effect.sizes(*coefficients(finding, diagnosis))
    if finding.verdict == "named":
        return found
    return tuple(replace(size, std=np.nan) for size in found)


def _ranges(group: Sequence[Finding], diagnosis: Diagnosis) -> str:
    """One effect of several joints: the range of each of its sizes, and at which joints."""
    values: dict[tuple[str, str], list[float]] = {}
    for f in group:
        for size in sizes(f, diagnosis):
            values.setdefault((size.name, size.unit), []).append(abs(size.value))
    ranges = []
    for (name, unit), of_joints in values.items():
        low = f"{min(of_joints):.2g}"
        high = f"{max(of_joints):.2g}"
        size_range = low if low == high else f"{low} to {high}"
        words = (name * (len(values) > 1), size_range, unit.removeprefix("1"))
        ranges.append(" ".join(filter(None, words)))
    joints = joints_of(group)
    few = 2 * len(joints) <= diagnosis.robot.nv
    where = f" at {', '.join(joints)}" if few else ""
    sizes_told = f" {', '.join(ranges)}" if ranges else ""
    return f"{plain(group[0].effect.name)}{sizes_told}{where}"


def _reservation(group: Sequence[Finding], diagnosis: Diagnosis) -> str:
    """Rivals of a group's cause in a sentence, or the reason why it is undecided."""
    rivals = Counter(r.candidate.effect.name for f in group for r in f.rivals)
    if not rivals:
        reasons = dict.fromkeys(f.downgrade for f in group if f.downgrade)
        return "".join(f" This is not decided: {reason}." for reason in reasons)
    if len(group) == 1:
        rival = group[0].rivals[0].candidate.effect
        other = rival.words.noun(rival, diagnosis.robot)
        return f" {other[0].upper()}{other[1:]} would look the same."
    joints = joints_of(group)
    open_at = len(joints_of([f for f in group if f.rivals]))
    count = "all" if open_at == len(joints) else str(open_at)
    where = f"{count} of these joints" if len(joints) > 1 else joints[0]
    name = plain(rivals.most_common(1)[0][0])
    other = name if len(rivals) == 1 else f"another effect, such as {name},"
    return f" At {where}, {other} would look the same."


def reason_to_downgrade(
    robot: Robot,
    finding: Finding,
    findings: Sequence[Finding],
    residuals: Sequence[Residual],
    body_std: float,
) -> str:
    """Reason to downgrade a confirmed cause without rivals to undecided; half a sentence.

    The nominal bodies have a relative standard deviation ``body_std``.
    """
    effect = finding.effect
    if finding.by_chance(VERDICT.chance):
        return "its values are the given ones within their uncertainty"
    # a payload has mass
    if effect.role == "link" and len(effect.joints) == 1 and finding.is_open:
        return "the sign of its mass is not known to two standard deviations"
    if effect.role == "link" and (link := _losing_mass(robot, effect)):
        return f"it would leave {link} less than half of its given mass"
    values = np.array(effect.values or ())
    if why := effect.search.doubt(effect, robot, values, finding.std):
        return why
    if finding.is_vague:
        return "its size is less than its standard deviation"
    if _like_wrong_masses(robot, finding, findings, body_std):
        return "given masses that are all off by one factor would look the same"
    if finding.share < CONFIRMATION.ideal:
        size = f"{100 * finding.share:.1f} % of the total"
        return f"its torque is {size}, below the accuracy of models"
    # noise of positions makes such torque too, which is smaller on unseen data
    scale = finding.scale
    missing = 1 - scale.size
    if effect.physics.on_model and missing > max(
        EVIDENCE.tolerance, CONFIRMATION.deviations * scale.std
    ):
        ratio = f"{scale.size:.2f} ± {scale.std:.2g}"
        return f"on the hold-out its size is {ratio} of the fitted one"
    if reason := _below_residual(finding, residuals):
        return reason
    if finding.part < EVIDENCE.tolerance**2 and not is_plain_friction(effect):
        uncertainty = f"{100 * EVIDENCE.tolerance:.0f} % uncertainty"
        return f"it is smaller than the {uncertainty} of the larger causes"
    others = [other for other in findings if other is not finding]
    return next(filter(None, (_confused(finding, other) for other in others)), "")


def rivals_of(finding: Finding, findings: Sequence[Finding]) -> list[Effect]:
    """What an undecided cause may be instead: its rivals, or else another cause found."""
    if finding.rivals or not finding.downgrade:
        return [rival.candidate.effect for rival in finding.rivals]
    others = (other for other in findings if other is not finding)
    return [other.effect for other in others if _confused(finding, other)][:1]


def _losing_mass(robot: Robot, effect: Effect) -> str:
    """A link inside the arm, where no tool can be missing, that loses most of its mass; or ""."""
    added = (effect.values or ())[::10]
    for row, mass in zip(effect.rows(robot), added, strict=True):
        most = VERDICT.lost_mass * robot.phi[10 * row]
        if row < robot.nv - 1 and -mass > most:
            return robot.links[row]
    return ""


def _like_wrong_masses(
    robot: Robot, finding: Finding, findings: Sequence[Finding], body_std: float
) -> bool:
    """Whether it is a gain that most joints have, small as the error of nominal masses."""
    effect = finding.effect
    if not effect.physics.on_given_torque:
        return False
    gains = {
        joint
        for f in (finding, *findings)
        if f.effect.physics.on_given_torque
        for joint in f.effect.joints
    }
    largest = np.abs(effect.values or 0.0).max()
    small = largest < VERDICT.common_masses * body_std
    return bool(2 * len(gains) > robot.nv and small)


def _below_residual(finding: Finding, residuals: Sequence[Residual]) -> str:
    """Reason if the structured residual on its joints is larger than a cause, in noise units."""
    noise = np.array([residual.floor for residual in residuals])
    if not (noise > 0).all():
        return ""
    # a cause on several joints has to explain them all, so a smaller residual counts
    several = finding.torque.any(axis=0).sum() > 1
    unknown = (
        np.array(
            [r.structured if r.visible or not several else 0.0 for r in residuals]
        )
        / noise
    )
    size = root_mean_square(finding.torque) / noise
    main = size > (0.0 if several else VERDICT.main_joint * size.max())
    share = VERDICT.residual_share if several else VERDICT.own_residual_share
    if (unknown[main] ** 2).sum() <= share * (size[main] ** 2).sum():
        return ""
    if several:
        return "it acts on several joints at once, and the residual on some is not small"
    unexplained = f"{100 * VERDICT.own_residual_share:.0f} %"
    return (
        f"over {unexplained} of the square of its torque remain unexplained there"
    )


def _confused(finding: Finding, other: Finding) -> str:
    """Reason if the torque of one cause may belong to the other."""
    name = plain(other.effect.name)
    # of given friction, a finer law would have been chosen before both kinds that are off
    of_given = all(
        is_plain_friction(f.effect) and any(f.nominal) for f in (finding, other)
    )
    if cancelling(finding, other) and not of_given:
        return f"it and {name} mostly cancel"
    effect = finding.effect
    if not {*effect.joints} <= {*other.effect.joints}:
        return ""
    minor = VERDICT.minor
    if other.effect.search.shapes and finding.explained < minor * other.explained:
        return (
            f"it is small compared with {name}, whose shape is only roughly known"
        )
    curve = effect.curve
    shared = curve and curve == other.effect.curve
    if shared and minor * finding.explained < other.explained:
        return f"it shares the {curve} curve of the joint with {name}"
    return ""
