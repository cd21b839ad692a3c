"""Why a cause that pays may still be another: reasons that lie in what is beside it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from excitant.analysis.agreement import is_common
from excitant.analysis.confirmation import Finding
from excitant.analysis.proposals import has_shape
from excitant.analysis.residuals import Remainder
from excitant.robots.effects import Effect
from excitant.robots.robot import Robot

_SMALL = 0.1  # of what a cause explains whose shape is known roughly
_LITTLE = 0.05  # of the squared torque of a cause that is common to all joints
_MATTERS = 0.3  # of what a cause does to the joint where it shows most


def doubt(
    robot: Robot, finding: Finding, findings: Sequence[Finding], left: Sequence[Remainder]
) -> str:
    """The reason to doubt a finding, as half a sentence; empty without one.

    Args:
        robot: The given robot.
        finding: What is doubted.
        findings: All causes that pay.
        left: What the extended model leaves, joint by joint.
    """
    if _overshadowed(robot, finding, left):
        if is_common(robot, finding.effect):
            return "it acts on all joints alike, and what stays unexplained on some is not small"
        return "more is left unexplained on its joints than it explains"
    if (other := _beside(finding, findings)) is not None:
        name = other.name.replace("_", " ")
        return f"it is small beside {name}, whose shape is only roughly known"
    return ""


def _overshadowed(robot: Robot, finding: Finding, left: Sequence[Remainder]) -> bool:
    """Whether what nothing explains is larger than what this cause explains, in noise.

    A cause that is common to all joints has to explain them all: little that it leaves is enough.
    """
    scale = np.array([r.floor for r in left])
    if not (scale > 0).all():
        return False
    unknown = np.array([r.structured if r.visible else 0.0 for r in left]) / scale
    size = np.sqrt((finding.torque**2).mean(axis=0)) / scale
    common = is_common(robot, finding.effect)
    main = size > (0.0 if common else _MATTERS * size.max())
    return bool((unknown[main] ** 2).sum() > (_LITTLE if common else 1.0) * (size[main] ** 2).sum())


def _beside(finding: Finding, findings: Sequence[Finding]) -> Effect | None:
    """A cause on the same joint that explains far more, if its shape was searched for.

    What a shape misses of a large cause looks like a small one.
    """
    for other in findings:
        same = {*finding.effect.joints} <= {*other.effect.joints}
        if same and has_shape(other.effect) and finding.explained < _SMALL * other.explained:
            return other.effect
    return None
