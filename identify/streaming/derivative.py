"""The differentiator of recordings, for the inside of long ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.ndimage

from excitant.identify.differentiators import ZeroPhaseButterworth, low_pass, step_of
from excitant.robots.motion import Array, Motion


@dataclass(frozen=True)
class InnerButterworth(ZeroPhaseButterworth):
    """`ZeroPhaseButterworth` with its quintic spline by recursion, three times as fast.

    The coefficients c of the spline on regular time come from a recursive filter and the
    derivatives at the samples from their neighbours (Unser 1999, box 2),

        T q̇_i = (10 (c_{i+1} − c_{i−1}) + c_{i+2} − c_{i−2}) / 24,
        T² q̈_i = (c_{i+2} + c_{i−2} + 2 (c_{i+1} + c_{i−1}) − 6 c_i) / 6.

    Only what is assumed beyond the ends differs; it is forgotten at 0.43 per sample.
    """

    def __call__(self, t: Array, q: Array) -> Motion:
        """Motion at the samples of regular time."""
        rate = 1 / step_of(t, self.name)
        smooth = low_pass(q, self.cutoff_hz, rate)
        c = scipy.ndimage.spline_filter1d(smooth.T, 5, axis=1, mode="mirror")
        c = np.pad(c, ((0, 0), (2, 2)), mode="reflect")
        near, far = c[:, 3:-1] - c[:, 1:-3], c[:, 4:] - c[:, :-4]
        dq = (10 * near + far) * (rate / 24)
        near, far = c[:, 3:-1] + c[:, 1:-3], c[:, 4:] + c[:, :-4]
        ddq = (far + 2 * near - 6 * c[:, 2:-2]) * (rate**2 / 6)
        return Motion(t, smooth, dq.T, ddq.T)
