"""What an `OnlineEstimator` gives: the estimate of an instant, and its recent rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from excitant.identify.information import Information
from excitant.robots.base_parameters import BaseParameters
from excitant.robots.motion import Array, Motion, freeze


@dataclass(frozen=True, eq=False)
class OnlineEstimate:
    """What is known at an instant.

    Attributes:
        t: Instant it speaks about: the newest block [s].
        base: The base parameters.
        information: Data and prior together, rows of unit noise.
        data: Data alone, the same rows.
        beta: Estimate, shape (r,).
        covariance: Its covariance, shape (r, r).
        sigma: Standard deviation of each joint's row, shape (nv,) [torque unit].
        inflation: Integrated autocorrelation time of recent residuals [rows], shape (nv,).
    """

    t: float
    base: BaseParameters
    information: Information
    data: Information
    beta: Array
    covariance: Array
    sigma: Array
    inflation: Array

    def __post_init__(self) -> None:
        freeze(self, "beta", "covariance", "sigma", "inflation")

    @property
    def std(self) -> Array:
        """Standard deviations, shape (r,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)), float)


@dataclass(frozen=True, eq=False)
class Rows:
    """Recent rows of the estimator.

    Attributes:
        motion: State in the middle of each block, n blocks.
        W: Columns of the base parameters, shape (n, nv, r).
        tau: Torque, shape (n, nv).
        used: Rows that count, shape (n, nv); the others are of joints at rest.
    """

    motion: Motion
    W: Array
    tau: Array
    used: npt.NDArray[np.bool_]
