"""Why a cause that pays may still be another: reasons that lie in what is beside it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from excitant.analysis.confirmation import Finding
from excitant.analysis.proposals import has_shape
from excitant.analysis.residuals import Remainder
from excitant.robots.effects import Effect, plain

_SMALL = 0.1  # of what a cause explains whose shape is known roughly
_LITTLE = 0.05  # of the squared torque of a cause that acts on several joints
_MATTERS = 0.3  # of what a cause does to the joint where it shows most


def doubt(finding: Finding, findings: Sequence[Finding], left: Sequence[Remainder]) -> str:
    """The reason to doubt a finding, as half a sentence; empty without one.

    Args:
        finding: What is doubted.
        findings: All causes that pay.
        left: What the extended model leaves, joint by joint.
    """
    if _overshadowed(finding, left):
        if _several(finding):
            return "it acts on several joints at once, and what it leaves on some is not small"
        return "more is left unexplained on its joints than it explains"
    if (other := _beside(finding, findings)) is not None:
        return f"it is small beside {plain(other.name)}, whose shape is only roughly known"
    return ""


def _several(finding: Finding) -> bool:
    """Whether the same coefficients make torque at several joints."""
    return bool(finding.torque.any(axis=0).sum() > 1)


def _overshadowed(finding: Finding, left: Sequence[Remainder]) -> bool:
    """Whether what nothing explains is larger than what this cause explains, in noise.

    A cause that acts on several joints has to explain them all: little that it leaves is enough.
    """
    scale = np.array([r.floor for r in left])
    if not (scale > 0).all():
        return False
    unknown = np.array([r.structured if r.visible else 0.0 for r in left]) / scale
    size = np.sqrt((finding.torque**2).mean(axis=0)) / scale
    several = _several(finding)
    main = size > (0.0 if several else _MATTERS * size.max())
    enough = _LITTLE if several else 1.0
    return bool((unknown[main] ** 2).sum() > enough * (size[main] ** 2).sum())


def _beside(finding: Finding, findings: Sequence[Finding]) -> Effect | None:
    """A cause on the same joint that explains far more, if its shape was searched for.

    What a shape misses of a large cause looks like a small one.
    """
    for other in findings:
        same = {*finding.effect.joints} <= {*other.effect.joints}
        if same and has_shape(other.effect) and finding.explained < _SMALL * other.explained:
            return other.effect
    return None
