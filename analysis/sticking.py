"""Where a joint rests: dry friction then takes any value up to its level, and says nothing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import scipy.ndimage

from excitant.identify.preprocessing import Segment

Mask = npt.NDArray[np.bool_]

_SLOW = 0.015  # of a joint's fastest motion: below it rests
_RESTS_S = 0.04  # s, at least; a reversal without a rest is quicker
_REACH = 0.5  # of the period of the torque filter's cut-off: how far a rest is felt


def sliding(segments: Sequence[Segment]) -> Mask:
    """Rows at which each joint moves, or reverses without a rest, shape (rows, nv)."""
    fastest = np.max([np.abs(s.motion.dq).max(axis=0) for s in segments], axis=0)
    masks = []
    for s in segments:
        slow = np.abs(s.motion.dq) <= _SLOW * fastest
        least = max(1, round(_RESTS_S * s.rate_hz))
        rests = scipy.ndimage.binary_opening(slow, np.ones((least, 1), bool))
        reach = max(1, round(_REACH * s.rate_hz / s.cutoff_hz))
        masks.append(
            ~scipy.ndimage.binary_dilation(rests, np.ones((2 * reach + 1, 1), bool))[s.keep]
        )
    return np.concatenate(masks)
