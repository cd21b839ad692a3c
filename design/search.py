"""Sequential convex programming from one starting point."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from excitant.design.criterion import condition_number, objective
from excitant.design.peaks import worst_use
from excitant.design.problem import DesignProblem
from excitant.design.step import PENALTY, local_model, solve_step
from excitant.robots import Array

FEASIBLE = 5e-5  # torque excess that the margin kept in the bounds covers

_RADIUS = 0.3  # of each coefficient's reach
_RADIUS_MIN, _RADIUS_MAX = 1e-5, 1.0
_GAIN = 1e-4  # predicted decrease of the merit at which a search has converged
COARSE, FINE = 1.5e-2, 2e-3  # least decrease of the merit over `_STALL` iterations

_STALL = 8
_HOPELESS = 4.0  # gap to the target over the decrease in as many iterations


@dataclass(frozen=True, eq=False)
class SearchState:
    """Where a search from one start stands.

    Attributes:
        index: Number of the start.
        z: Unknowns, shape (c − 2, nv).
        value: Criterion to be minimised, at z.
        excess: Torque beyond its bound at z, as a share of it; or clearance missing.
        best: Unknowns of the lowest value within all limits; None before there is one.
        best_value: That value.
        radius: Trust region.
        status: ``"running"``, ``"stalled"`` (slow; may go on), ``"converged"``, ``"stopped"``
            (not worth going on beside others), ``"iteration limit"``, ``"time limit"``,
            ``"interrupted"`` or ``"infeasible"``.
        parent: Start whose solution this one began from, mixed with a random one; or None.
        history: Condition number at the beginning and after every iteration.
        merits: Merit likewise.
    """

    index: int
    z: Array
    value: float = np.inf
    excess: float = np.inf
    best: Array | None = None
    best_value: float = np.inf
    radius: float = _RADIUS
    status: str = "running"
    parent: int | None = None
    history: tuple[float, ...] = ()
    merits: tuple[float, ...] = field(default=(), repr=False)

    @property
    def merit(self) -> float:
        """Criterion with the penalty on torque beyond its bound."""
        return self.value + PENALTY * self.excess

    @property
    def condition(self) -> float:
        """Condition number at the samples of the search, with the smooth sign of velocity."""
        return self.history[-1] if self.history else np.inf

    @property
    def iterations(self) -> int:
        """Steps taken."""
        return max(len(self.history) - 1, 0)

    def at(self, problem: DesignProblem, z: Array) -> SearchState:
        """The search moved to z, and that entered into its history."""
        M = problem.information_matrix(z)
        value = objective(M, problem.criterion)
        excess = max(0.0, worst_use(problem, z) - 1.0)
        new = replace(self, z=z, value=value, excess=excess)
        if excess <= FEASIBLE and value < self.best_value:
            new = replace(new, best=z, best_value=value)
        history = (*self.history, condition_number(M))
        return replace(new, history=history, merits=(*self.merits, new.merit))

    def stalled(self, least: float) -> bool:
        """Whether the last iterations decreased the merit by less than this."""
        return self._recent_gain() < least

    def hopeless(self, target: float) -> bool:
        """Whether the target is out of reach at the recent pace."""
        return bool(np.isfinite(target)) and self.merit - target > _HOPELESS * self._recent_gain()

    def _recent_gain(self) -> float:
        return self.merits[-_STALL - 1] - self.merit if len(self.merits) > _STALL else np.inf

    def ended(self) -> SearchState:
        """The search at a point that it cannot improve."""
        return replace(self, status="infeasible" if self.best is None else "converged")


def best_solutions(searches: Iterable[SearchState], count: int) -> list[Array]:
    """Unknowns of the best that searches found within all limits, best first."""
    found = sorted((s.best_value, s.index, s.best) for s in searches if s.best is not None)
    return [z for _, _, z in found[:count]]


def advance(
    problem: DesignProblem,
    state: SearchState,
    iterations: int,
    *,
    deadline: float = np.inf,
    target: float = -np.inf,
    least: float = FINE,
) -> SearchState:
    """Continue a search by some iterations, until it stalls, is hopeless or time is up.

    Args:
        problem: The design problem.
        state: Where it stands.
        iterations: Number of linearisations.
        deadline: `time.time` at which to stop [s].
        target: Merit that another search has reached.
        least: `FINE` to converge, `COARSE` to see what a start is worth.
    """
    if state.status == "stalled":
        state = replace(state, status="running")
    for _ in range(iterations):
        if state.status != "running":
            break
        if time.time() > deadline:
            return replace(state, status="time limit")
        state = _iterate(problem, state)
        if state.status == "running" and state.stalled(least):
            state = state.ended() if least <= FINE else replace(state, status="stalled")
        elif state.status == "running" and state.hopeless(target):
            state = replace(state, status="stopped")
    return state


def _iterate(problem: DesignProblem, state: SearchState) -> SearchState:
    """One linearisation, with the trust region shrunk until the merit decreases."""
    model = local_model(problem, state.z)
    radius = state.radius
    while radius > _RADIUS_MIN:
        step = solve_step(problem, model, radius)
        if step is None:
            radius /= 4
            continue
        if step.gain < _GAIN:
            break
        moved = state.at(problem, state.z + step.dz)
        share = (state.merit - moved.merit) / step.gain
        if share > 0.05:
            factor = 2.0 if share > 0.6 else 1.0 if share > 0.25 else 0.5
            return replace(moved, radius=min(factor * radius, _RADIUS_MAX))
        radius *= 0.4
    return state.ended()
