"""The regression that every estimator solves, and what estimators are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from excitant.exceptions import BadInput
from excitant.identify.least_squares import LeastSquares
from excitant.robots.motion import Array, freeze


@dataclass(frozen=True, eq=False)
class Regression:
    """Rows τ ≈ W β, one block of nv rows per instant.

    Attributes:
        W: Columns of the base parameters, shape (n, nv, r).
        tau: Torque, shape (n, nv) [torque unit].
        names: What the columns stand for, r of them, for messages.
        starts: First instant of every uninterrupted segment; the first is 0.
        instruments: Columns that move with the true motion, with errors independent of those of
            W, shape (n, nv, k) with k ≥ r; None where there are none.
        simulated: The columns on the motion that the model with parameters β makes, as β → (n, nv,
            r); None where nothing is simulated.
        noise: Covariance of the torque of the joints at one instant, one for every segment, shape
            (segments, nv, nv) [torque unit²]; None where only the residual shows it.
    """

    W: Array
    tau: Array
    names: tuple[str, ...]
    starts: tuple[int, ...] = (0,)
    instruments: Array | None = None
    simulated: Callable[[Array], Array] | None = None
    noise: Array | None = None

    def __post_init__(self) -> None:
        given = [name for name in ("instruments", "noise") if getattr(self, name) is not None]
        freeze(self, "W", "tau", *given)
        n, nv, r = self.W.shape
        if self.tau.shape != (n, nv) or len(self.names) != r:
            raise BadInput(
                f"regression: columns of shape {self.W.shape} with torque of shape "
                f"{self.tau.shape} and {len(self.names)} names; give (n, nv, r), (n, nv) and r"
            )
        if self.instruments is not None and self.instruments.shape[:2] != (n, nv):
            raise BadInput(
                f"regression: instruments of shape {self.instruments.shape} for {n} instants of "
                f"{nv} joints; give one row for each row of the columns"
            )
        if self.starts[:1] != (0,) or not (np.diff([*self.starts, n]) > 0).all():
            raise BadInput(
                f"regression: segments start at {self.starts} of {n} instants; begin with 0, rise"
            )
        if self.noise is not None and self.noise.shape != (len(self.starts), nv, nv):
            raise BadInput(
                f"regression: noise of shape {self.noise.shape} for {len(self.starts)} segments of "
                f"{nv} joints; give one covariance matrix for each segment"
            )
        if not all(np.isfinite(getattr(self, name)).all() for name in ("W", "tau", *given)):
            raise BadInput("regression: values that are no finite numbers; remove their instants")

    @property
    def Z(self) -> Array:
        """The instruments.

        Raises:
            BadInput: There are none.
        """
        if self.instruments is None:
            raise BadInput(
                "instrumental variables need instruments: columns on a reference motion, or on "
                "samples whose noise is independent of that of the fitted ones"
            )
        return self.instruments

    def columns_of_model(self, beta: Array) -> Array:
        """The columns on the motion that the model with parameters β makes, shape (n, nv, r).

        Raises:
            BadInput: Nothing is simulated.
        """
        if self.simulated is None:
            raise BadInput(
                "output error needs a simulation: columns on the motion of the model for any "
                "parameters"
            )
        return self.simulated(beta)

    @property
    def segments(self) -> tuple[slice, ...]:
        """Instants of every uninterrupted segment."""
        ends = (*self.starts[1:], len(self.tau))
        return tuple(slice(*pair) for pair in zip(self.starts, ends, strict=True))


Estimator: TypeAlias = Callable[[Regression], LeastSquares]
"""From a regression to β with its covariance; raises RankDeficient where β is not determined."""
