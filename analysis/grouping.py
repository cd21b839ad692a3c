"""Findings of a diagnosis by cause, in order of importance."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from excitant.analysis.confirmation import Finding
from excitant.analysis.residuals import Residual
from excitant.analysis.thresholds import EVIDENCE, VERDICT

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


def is_slight(group: Sequence[Finding]) -> bool:
    """Whether a group is undecided, without rivals, and within the misfit of larger causes."""
    undecided = all(f.downgrade and not f.rivals for f in group)
    return undecided and explained_by(group) < EVIDENCE.tolerance**2


def lacking_friction(diagnosis: Diagnosis) -> frozenset[str]:
    """Joints of which the nominal model has less than half the friction, if they are most."""
    robot = diagnosis.robot
    holdout = diagnosis.holdout
    rms = holdout.series.rms
    nominal = np.zeros_like(holdout.simulated)
    for effect in robot.effects:
        if effect.family == "friction":
            nominal += holdout.observed.columns(effect) @ np.array(effect.values)
    friction = [f for f in diagnosis.findings if f.effect.family == "friction"]
    added = sum((f.torque for f in friction), np.zeros_like(nominal))
    threshold = VERDICT.lacking_friction * rms(added)
    lacking = rms(nominal / holdout.gains) < threshold
    joints = {joint for f in friction for joint in f.effect.joints}
    joints &= {j for j, yes in zip(robot.joints, lacking, strict=True) if yes}
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
        if effect.family == "friction" and {*effect.joints} <= diagnosis.no_friction:
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
