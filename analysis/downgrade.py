"""Reasons to call a confirmed cause undecided although it has no rival."""

from collections.abc import Sequence

import numpy as np

from excitant.analysis.confirmation import Finding, cancelling
from excitant.analysis.residuals import Residual
from excitant.analysis.selection import is_plain_friction
from excitant.analysis.thresholds import CONFIRMATION, EVIDENCE, VERDICT
from excitant.robots.effects import Effect, plain
from excitant.robots.motion import root_mean_square
from excitant.robots.robot import Robot


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
    if cancelling(finding, other):
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
