"""The torque filter as an impulse response that is evaluated where rows are kept, nowhere else.

The response h of the zero-phase filter is even and short: y_i = Σ_k h_k x_{i+k} over |k| ≤ m. What
is smooth (the regressor of filtered positions) is known from every d-th instant, with d h_k in
place of h_k: columns are evaluated there only. What jumps (friction where a joint turns back) is
taken at all instants.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from excitant.identify.preprocessing import Segment
from excitant.identify.streaming.windows import RESPONSE
from excitant.robots.motion import Array, freeze

_OVERSAMPLING = 10.0  # instants per period of the cut-off, at which smooth columns are evaluated
_LONGEST = 20.0  # periods of the cut-off: longer than any response


@dataclass(frozen=True, eq=False)
class Response:
    """Impulse response of the torque filter.

    Attributes:
        h: From −m to m, shape (2 m + 1,).
        every: Instants from one at which smooth columns are evaluated to the next.
        stride: Instants from row to row.
    """

    h: Array
    every: int
    stride: int
    _bands: dict[int, tuple[Array, int]] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        freeze(self, "h")

    @property
    def half(self) -> int:
        """m, instants on either side."""
        return len(self.h) // 2

    def rows(self, X: Array, count: int, every: int = 1) -> Array:
        """Filtered rows of columns.

        Args:
            X: Columns at every ``every``-th instant, from m instants before the first row
                to m after the last one, shape (n, k).
            count: Number of rows.
            every: 1, or `every`.

        Returns:
            Shape (rows, k).
        """
        band, step = self._band(every)
        at_once, width = band.shape
        rows = np.empty((count, X.shape[1]))
        for k, i in enumerate(range(0, count, at_once)):
            part = X[k * step : k * step + width]
            rows[i : i + at_once] = band[: count - i, : len(part)] @ part
        return rows

    def _band(self, every: int) -> tuple[Array, int]:
        """Matrix from columns to so many rows at once, and how far the next ones are."""
        if every not in self._bands:
            period = every // math.gcd(every, self.stride)  # rows until phases are the same
            at_once = period * max(1, self.half // (self.stride * period))
            lag = every * np.arange(((at_once - 1) * self.stride + 2 * self.half) // every + 1)
            lag = lag - self.stride * np.arange(at_once)[:, None]
            inside = (lag >= 0) & (lag < len(self.h))
            band = np.where(inside, every * self.h[np.where(inside, lag, 0)], 0.0)
            self._bands[every] = band, at_once * self.stride // every
        return self._bands[every]


def responses(segment: Segment) -> tuple[Response, ...]:
    """Response of each joint's torque filter, all as long as the longest one.

    Smooth columns are evaluated as often as the segment's own cut-off needs, whatever those of
    joints.
    """
    nv = int(segment.tau.shape[1])
    common = response(replace(segment, joint_cutoffs=None, silent=None))
    if segment.joint_cutoffs is None:
        return tuple(common for _ in range(nv))
    own = {
        float(hz): response(replace(segment, cutoff_hz=float(hz), joint_cutoffs=None, silent=None))
        for hz in np.unique(segment.joint_cutoffs)
    }
    half = max(each.half for each in own.values())
    long = {
        hz: Response(np.pad(each.h, half - each.half), common.every, common.stride)
        for hz, each in own.items()
    }
    return tuple(long[float(hz)] for hz in segment.joint_cutoffs.tolist())


def response(segment: Segment) -> Response:
    """Response of the torque filter of a segment, seen by an impulse."""
    centre = int(np.ceil(_LONGEST * segment.rate_hz / segment.cutoff_hz))
    impulse = np.zeros((2 * centre + 1, 1))
    impulse[centre] = 1.0
    h = segment.filtered(impulse)[:, 0]
    beyond = np.cumsum(np.abs(h[::-1]))[::-1][centre + 1 :]  # Σ |h_i| over i > k, for k ≥ 0
    half = int(np.argmax(beyond <= RESPONSE * np.abs(h).sum()))
    every = max(1, int(segment.rate_hz / (_OVERSAMPLING * segment.cutoff_hz)))
    return Response(h[centre - half : centre + half + 1], every, int(segment.keep.step or 1))
