"""Measured positions of the fitted segments, as they were before any filter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.interpolate

from excitant.identify.preprocessing import Segment
from excitant.identify.recording import Recording
from excitant.robots.motion import Array


def with_recordings(
    segments: Sequence[Segment], recordings: Sequence[Recording]
) -> list[tuple[Segment, Recording]]:
    """Every segment with the recording that it is a part of, both in order."""
    found, left = [], list(segments)
    for recording in recordings:
        last = -np.inf
        while left and left[0].name == recording.name and left[0].motion.t[0] > last:
            last = float(left[0].motion.t[-1])
            found.append((left.pop(0), recording))
    return found


def unfiltered_positions(segment: Segment, recording: Recording) -> Array:
    """Positions at the instants of a segment, through a cubic spline, shape (n, nv)."""
    grid = segment.motion.t
    part = (recording.t >= grid[0] - 1e-9) & (recording.t <= grid[-1] + 1e-6 + 1 / segment.rate_hz)
    return np.asarray(
        scipy.interpolate.make_interp_spline(recording.t[part], recording.q[part], k=3)(grid)
    )
