"""A numerical lower bound on the condition number of any motion within a robot's limits."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from excitant.design.feasible import random_trajectory
from excitant.design.mixture import Mixture, Multipliers
from excitant.design.relaxation import Relaxation, relaxation
from excitant.design.states import numbered
from excitant.exceptions import BadInput
from excitant.robots.motion import Array, Motion, read_only
from excitant.robots.robot import Robot

BoundProgress = Callable[[float, float, float], None]
"""Called after every round with the time taken [s], the bound so far and its ceiling."""

_SEEDS, _SEED_STATES = 8, 40  # random trajectories to begin with, and states of each
_SEED_HARMONICS, _SEED_DURATION = 5, 10.0  # of those, where the motion has no band
_STARTS = 120  # of the ascent, from states of large weight and from random ones each
_STEPS, _KEPT, _POLISH = 8, 80, 24  # steps of all, how many go on, and their further steps
_FINAL_STARTS, _FINAL_STEPS = 300, 16  # of the last search for a violation
_FINAL_ROUNDS = 5  # of it at most: it is done again until it finds nothing worse
_FINAL_SHARE = 0.1  # of the time limit, kept for that search
_LOOSE_ROUNDS = 6  # with a loose master problem and no polish
_LOOSE, _TIGHT = 1e-2, 1e-3  # gaps at which the master problem stops
_SPARE = 80  # states kept beyond twice those with weight
_ADDED = 0.02  # of the worst violation: states that violate more are added
_SUPPORT = 1e-3  # of the largest weight
_CLOSED = 2e-3  # relative distance of bound and ceiling to stop at


@dataclass(frozen=True, eq=False)
class Bound:
    """A numerical lower bound on cond₂(W): certified at every state tried, not proved.

    Attributes:
        value: The bound.
        without_repair: What it would be, were no state to violate the certificate.
        history: Ceiling (best mixture of the states so far) and bound after each round, shape
            (rounds, 2); the relaxation cannot give more than the ceiling.
        relaxation: What was relaxed.
        multipliers: The certificate, repaired: P, Q ⪰ 0, tr Q = 1, value² = tr P, and
            `slack` ≥ 0 at every feasible state.
        states: States of the last master problem.
        weights: Their weights in the best mixture, shape (n,).
        iterations: Rounds of column generation.
        wall_s: Time taken [s].
        assumptions: One sentence: for which motions it holds, and how far it is certain.
    """

    value: float
    without_repair: float
    history: Array
    relaxation: Relaxation
    multipliers: Multipliers
    states: Motion
    weights: Array
    iterations: int
    wall_s: float
    assumptions: str

    def __post_init__(self) -> None:
        for name in ("history", "weights"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    def slack(self, motion: Motion) -> Array:
        """−⟨P − Q, M(x)⟩ − y·dφ/dt over the mean tr M at each state, shape (n,).

        The bound holds for motions through states where it is not negative.
        """
        M, rows = self.relaxation.matrices(motion), self.relaxation.rows(motion)
        g = rows @ self.multipliers.y
        for block, P, Q in zip(M, self.multipliers.P, self.multipliers.Q, strict=True):
            g = g + np.einsum("nij,ij->n", block, P - Q)
        slack: Array = -g / self.relaxation.unit
        return slack


def lower_bound(
    robot: Robot,
    *,
    duration: float = 10.0,
    harmonics: int | None = 5,
    columns: str = "inertial",
    criterion: str = "condition",
    seed: int = 0,
    time_limit: float = 60.0,
    progress: BoundProgress | None = None,
    pool: Sequence[Motion] = (),
) -> Bound:
    """Numerical lower bound on cond₂(W) of every motion within the limits of a robot.

    M of a motion is a mixture ∫ M(x) dξ(x) of those of its states x = (q, q̇, q̈), so cond² is
    at least the smallest κ with I ⪯ Σ w_k M(x_k) ⪯ κ I, w ≥ 0 over all feasible states. For
    finite Fourier series states obey Bernstein's and Szegő's inequalities besides the limits,
    and mixtures the rows of `TestFunctions`. Solved by column generation: the best mixture of
    the states found so far gives multipliers; states that violate these most are added.
    Multipliers P, Q ⪰ 0, tr Q = 1 with ⟨P − Q, M(x)⟩ + y·dφ/dt ≤ 0 for every feasible x prove
    cond² ≥ tr P; a remaining violation e is repaired by Q + e R, tr R = 1.

    Args:
        robot: The arm; its limits on position, velocity, acceleration and torque count.
        duration: Period of the motion [s].
        harmonics: Number of harmonics H of its Fourier series; None for any motion whatever.
        columns: ``"inertial"`` or ``"friction"``.
        criterion: Only ``"condition"`` has a bound.
        seed: Seed of all randomness.
        time_limit: Time after which the bound so far is returned [s].
        progress: Called after every round.
        pool: Feasible motions, for instance good trajectories, whose states to begin with.

    Raises:
        BadInput: Another criterion, an option out of range, or a joint without limits.
        Infeasible: No motion keeps the limits.
        UnknownName: Other columns.
    """
    began = time.time()
    _check(duration, harmonics, criterion, time_limit)
    top = np.inf if harmonics is None else 2 * np.pi * harmonics / duration
    problem = relaxation(robot, columns, top, stationary=harmonics is not None)
    rng = np.random.default_rng(seed)
    states = _seeds(robot, rng, duration, harmonics, pool)
    with threadpool_limits(1):
        search = _Search(problem, rng, states, began, time_limit, progress)
        search.run()
        multipliers = search.certify()
    return Bound(
        value=max(1.0, float(np.sqrt(multipliers.value))),
        without_repair=max(1.0, float(np.sqrt(search.best.value))),
        history=np.array(search.history),
        relaxation=problem,
        multipliers=multipliers,
        states=search.used,
        weights=search.mixture.weights,
        iterations=len(search.history),
        wall_s=time.time() - began,
        assumptions=_assumptions(robot, duration, harmonics, columns),
    )


class _Search:
    """Column generation with the best multipliers so far."""

    def __init__(
        self,
        problem: Relaxation,
        rng: np.random.Generator,
        states: Motion,
        began: float,
        time_limit: float,
        progress: BoundProgress | None,
    ) -> None:
        self.problem, self.rng, self.states = problem, rng, states
        self.began, self.time_limit, self.progress = began, time_limit, progress
        self.history: list[tuple[float, float]] = []
        self.used = self.archive = states
        self.best: Multipliers
        self.mixture: Mixture
        self.bound = 0.0
        self.violation = np.inf

    def run(self) -> None:
        """Rounds until the bound meets its ceiling or time is up."""
        deadline = self.began + (1 - _FINAL_SHARE) * self.time_limit
        longest = 0.0
        while True:
            started = time.time()
            ceiling = self.round()
            if self.progress is not None:
                self.progress(time.time() - self.began, self.bound, ceiling)
            longest = max(longest, time.time() - started)
            if self.bound > (1 - _CLOSED) * ceiling or time.time() + longest > deadline:
                return

    def round(self) -> float:
        """One master problem and one search for violating states; the ceiling."""
        early = len(self.history) < _LOOSE_ROUNDS
        tolerance, polish = (_LOOSE, 0) if early else (_TIGHT, _POLISH)
        self.used = self.states
        self.mixture = self.problem.mixture(self.used, tolerance)
        multipliers = self.mixture.multipliers
        ceiling = float(np.sqrt(multipliers.value))
        found, price = self.problem.worst(
            multipliers, self.starts(multipliers, _STARTS), _STEPS, _KEPT, polish
        )
        violation = float(price.max(initial=0.0))
        bound = np.sqrt(multipliers.value / (1 + max(violation, 0.0)))
        if bound > self.bound:
            self.best, self.bound, self.violation = multipliers, float(bound), violation
        self.history.append((ceiling, self.bound))
        found = found[price > _ADDED * violation]
        self.archive = _together([self.archive, found])
        self.exchange(multipliers, found)
        return ceiling

    def exchange(self, multipliers: Multipliers, found: Motion) -> None:
        """Add states; drop the worst-priced when there are many more than carry weight."""
        w = self.mixture.weights
        room = 2 * int((w > _SUPPORT * w.max()).sum()) + _SPARE
        if len(w) > room:
            order = np.argsort(-self.problem.price(multipliers, self.states))[:room]
            self.states = self.states[np.sort(order)]
        self.states = _together([self.states, found])

    def starts(self, multipliers: Multipliers, n: int) -> Array:
        """Points of the cube: the best-priced n of all ever found, and n random ones."""
        price = self.problem.price(multipliers, self.archive)
        near = self.problem.space.cube(self.archive[np.argsort(-price)[:n]])
        known = near[: len(near) // 2]
        return np.concatenate([near, self.problem.promising(multipliers, known, self.rng, n)])

    def certify(self) -> Multipliers:
        """The best multipliers, repaired by the violation that a longer search finds."""
        for _ in range(_FINAL_ROUNDS):
            starts = self.starts(self.best, _FINAL_STARTS)
            found, price = self.problem.worst(self.best, starts, _FINAL_STEPS, _KEPT, _POLISH)
            worst = float(price.max(initial=0.0))
            if worst <= self.violation:
                break
            self.violation, self.archive = worst, _together([self.archive, found])
        return self.problem.repaired(self.best, self.violation)


def _check(duration: float, harmonics: int | None, criterion: str, time_limit: float) -> None:
    if criterion != "condition":
        raise BadInput(f"no lower bound for criterion '{criterion}', only for 'condition'")
    if not (np.isfinite(duration) and duration > 0):
        raise BadInput(f"duration {duration} s is not a positive number")
    if harmonics is not None and harmonics < 2:
        raise BadInput(f"{harmonics} harmonics cannot be at rest at both ends; use at least 2")
    if not time_limit > 0:
        raise BadInput(f"time limit {time_limit} s is not positive")


def _seeds(
    robot: Robot,
    rng: np.random.Generator,
    duration: float,
    harmonics: int | None,
    pool: Sequence[Motion],
) -> Motion:
    """States of random trajectories, which obey every row together, and of those given."""
    period, H = (
        (_SEED_DURATION, _SEED_HARMONICS) if harmonics is None else (float(duration), harmonics)
    )
    t = (np.arange(_SEED_STATES) + 0.5) / _SEED_STATES * period
    motions = [random_trajectory(robot, rng, period, H).at(t) for _ in range(_SEEDS)]
    for motion in pool:
        if motion.nv != robot.nv:
            raise BadInput(f"motion has {motion.nv} joints, robot {robot.name} has {robot.nv}")
        rows = np.linspace(0, len(motion) - 1, min(len(motion), 2 * _SEED_STATES)).round()
        motions.append(motion[np.unique(rows.astype(np.intp))])
    return _together(motions)


def _together(motions: Sequence[Motion]) -> Motion:
    """All states of several motions."""
    q, dq, ddq = (
        np.concatenate([getattr(motion, name) for motion in motions]) for name in ("q", "dq", "ddq")
    )
    return numbered(q, dq, ddq)


def _assumptions(robot: Robot, duration: float, harmonics: int | None, columns: str) -> str:
    kind = (
        "any motion"
        if harmonics is None
        else f"any motion of period {duration:g} s with {harmonics} harmonics"
    )
    return (
        f"Holds for {kind} of {robot.name} within its position, velocity, acceleration and torque "
        f"limits, for the unscaled {columns} base columns; numerical, not a proof: states that "
        "would violate it are searched for by ascent from many starts, not exhaustively."
    )
