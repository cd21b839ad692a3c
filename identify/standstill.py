"""Where a joint stands still: dry friction is then unknown, and encoder noise is not motion.

A joint at rest with dry friction holds any torque within ± Coulomb of what motion would need,
so its row says nothing and is left out. A row counts where the joint certainly moves within the
reach of the torque filter; a quick reversal counts too, because the filter spans both sides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import scipy

from excitant.identify.preprocessing import Segment
from excitant.robots.effects import Effect
from excitant.robots.motion import Motion
from excitant.robots.robot import Robot

Mask = npt.NDArray[np.bool_]

_TINY = 1e-12  # rad/s: either side of standstill
_SHARE = 0.02  # of a joint's fastest motion in all recordings, below which it stands still
_LEAST = 2e-3  # of its velocity limit, likewise: what a controller lets a held joint creep
_TRAVEL = 1e-2  # rad or m, over a segment, likewise
_FREE_SPEED = 3.0  # rad/s, where there is no limit


def dry_joints(effects: Sequence[Effect], joints: Sequence[str]) -> Mask:
    """Joints on which some effect jumps where the velocity changes sign, shape (nv,)."""
    return np.array([_jumps(effects, joint) for joint in joints])


def _jumps(effects: Sequence[Effect], joint: str) -> bool:
    zero = np.zeros(1)
    for effect in effects:
        if effect.law is not None and joint in effect.joints:
            ahead, behind = (effect.law(zero, zero + v, zero) for v in (_TINY, -_TINY))
            if any(abs(a[0] - b[0]) > 1e-6 for a, b in zip(ahead, behind, strict=True)):
                return True
    return False


def moving(robot: Robot, segments: Sequence[Segment]) -> list[Mask]:
    """Instants at which each joint moves, one mask of shape (n, nv) per segment.

    A joint moves where, within half a period of the filter's cut-off, it is faster than 2 % of
    its fastest and than 0.2 % of its velocity limit, in segments in which it travels at all.
    """
    speeds = [np.abs(segment.motion.dq) for segment in segments]
    fastest = np.max([speed.max(axis=0) for speed in speeds], axis=0)
    limit = robot.limits.velocity
    slow = np.maximum(_SHARE * fastest, _LEAST * np.where(limit < 1e3, limit, _FREE_SPEED))
    masks = []
    for segment, speed in zip(segments, speeds, strict=True):
        width = 2 * round(segment.rate_hz / (2 * segment.cutoff_hz)) + 1
        near = scipy.ndimage.maximum_filter1d(speed, width, axis=0)
        travels = np.ptp(segment.motion.q, axis=0) > _TRAVEL
        masks.append(np.asarray((near > slow) & travels, bool))
    return masks


def stilled(segment: Segment, moves: Mask) -> Segment:
    """The segment with joints that never move in it held exactly, at their mean position.

    Args:
        segment: A segment.
        moves: Instants at which each joint moves, shape (n, nv).
    """
    motion, still = segment.motion, ~moves.any(axis=0)
    q, dq, ddq = (np.array(values) for values in (motion.q, motion.dq, motion.ddq))
    q[:, still] = q[:, still].mean(axis=0)
    dq[:, still] = ddq[:, still] = 0.0
    return replace(segment, motion=Motion(motion.t, q, dq, ddq))
