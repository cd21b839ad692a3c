"""Shapes of effects, in which torque is not linear, as they were and as they are refined.

`excitant.identify.shape_search` finds them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import scipy.stats

from excitant.identify.least_squares import LeastSquares
from excitant.identify.physical import PhysicalFit
from excitant.identify.rows import FitRows, observation, open_prior
from excitant.robots.base_parameters import BaseParameters, base_parameters
from excitant.robots.effects import Effect
from excitant.robots.motion import Array, freeze
from excitant.robots.robot import Robot

_CHANCE = 0.01  # that shapes change where the ones they had are right


@dataclass(frozen=True)
class Shape:
    """One number of an effect that its torque is not linear in.

    Attributes:
        effect: Name of the effect.
        joint: The joint it acts on.
        field: What it is called there.
        unit: Its unit.
        given: What it was.
        value: What it is now.
        std: Standard deviation, from the logarithm's [unit].
    """

    effect: str
    joint: str
    field: str
    unit: str
    given: float
    value: float
    std: float

    @property
    def entry(self) -> dict[str, str | float]:
        """As an entry of result.json."""
        return dict(vars(self))


@dataclass(frozen=True, eq=False)
class Shapes:
    """Shapes of all effects that have one, each joint with its own.

    Attributes:
        found: The shapes.
        effects: Effects with these shapes, in the order of their columns, without values.
        before: Objective with the shapes given.
        after: Objective with these.
        spread: How parameters of links and effects move with one standard deviation of each
            independent combination of shapes, shape (p, k).
    """

    found: tuple[Shape, ...]
    effects: tuple[Effect, ...]
    before: float
    after: float
    spread: Array

    def __post_init__(self) -> None:
        freeze(self, "spread")

    @property
    def better(self) -> bool:
        """Whether the objective falls by more than chance has it fall."""
        return self.before - self.after > float(scipy.stats.chi2.isf(_CHANCE, len(self.found)))

    @property
    def sentence(self) -> str:
        """What was found."""
        fall = f"misfit with its prior {self.before:.4g} → {self.after:.4g}"
        if not self.better:
            return f"shapes of effects are those given: no others fit better beyond chance ({fall})"
        each = ", ".join(
            f"{s.joint} {s.effect.replace('_', ' ')} {s.field} {s.value:.3g} ± {s.std:.2g}"
            f"{f' {s.unit}' if s.unit != '1' else ''}"
            for s in self.found
        )
        return f"shapes of effects refined together with bodies and coefficients: {each}; {fall}"

    def rows(self, robot: Robot, rows: FitRows) -> FitRows:
        """The rows with columns of these shapes.

        Args:
            robot: The arm that effects take their torque from.
            rows: Those with the shapes given.
        """
        W = observation(robot, self.effects, rows.data.to_fit)
        base = base_parameters(robot, self.effects)
        known = open_prior(robot, self.effects, W, rows.tau)
        return replace(rows, effects=self.effects, base=base, W=W, open_prior=known)

    def widened(
        self, fit: LeastSquares, physical: PhysicalFit, base: BaseParameters
    ) -> tuple[LeastSquares, PhysicalFit]:
        """Fits with these shapes, their covariances those of shapes that are not known exactly."""
        moved = base.regrouping @ self.spread
        return (
            replace(fit, covariance=fit.covariance + moved @ moved.T),
            replace(physical, covariance=physical.covariance + self.spread @ self.spread.T),
        )
