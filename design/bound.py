"""A numerical lower bound on the condition number of any motion within a robot's limits."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy

from excitant.design.feasible import random_start
from excitant.design.relaxation import Multipliers, Relaxation, relaxation
from excitant.design.trajectory import FourierSeries, resting_series
from excitant.exceptions import BadInput
from excitant.robots.motion import Array, Motion, together
from excitant.robots.robot import Robot
from excitant.robots.threads import on_one_thread

if TYPE_CHECKING:
    from excitant.design.result import Design

BoundProgress = Callable[[float, float, float], None]
"""Called after every round with the time taken [s], the bound so far and its ceiling."""


@dataclass(frozen=True)
class PricingSettings:
    """Column generation: states that a mixture may use, and the search for those it lacks."""

    seed_motions: int = 8
    "Random motions whose states the mixture begins with."
    seed_states: int = 40
    "States of each of them."
    starts: int = 160
    "Starts of the ascent, from states found before and from random ones each."
    steps: int = 8
    "Steps of every ascent."
    final_starts: int = 300
    "The same of the last search for a violation."
    final_steps: int = 20
    "Steps of that search."
    final_rounds: int = 5
    "Times that it is repeated, at most, until it finds nothing worse."
    final_time: float = 0.1
    "Share of the time limit that is kept for it."
    spare_states: int = 80
    "States kept beyond twice those with weight."
    added: float = 0.02
    "Share of the worst violation above which a state is added."
    support: float = 1e-3
    "Share of the largest weight above which a state has weight."
    closed: float = 2e-3
    "Relative distance of bound and ceiling at which the search ends."


PRICING = PricingSettings()


@dataclass(frozen=True)
class InteriorPoint:
    """Settings of the primal-dual interior-point method of the master problem."""

    gap: float = 1e-3
    "Relative gap at which it stops."
    softness: float = 1e-2
    "Σ w a over its multiplier y: 0.03 occurs, so that Σ w a is 1e-5 of Σ w at most."
    step: float = 0.95
    "Share of the way to the boundary of the cone."
    iterations: int = 60
    "Largest number of iterations."


SOLVER = InteriorPoint()
POOL_HZ = 100.0  # rate of the states of a design that the search begins with


@dataclass(frozen=True, eq=False)
class Bound:
    """A numerical lower bound on cond₂(W): certified at every state tried, not proved."""

    value: float  # the bound
    without_repair: float  # were no state to violate it; a mixture of states reaches it (to 0.1 %)
    relaxation: Relaxation  # what was relaxed
    multipliers: (
        Multipliers  # the certificate, repaired: P, Q ⪰ 0, tr Q = 1, value² = tr P
    )
    assumptions: str  # for which motions it holds, and how far it is certain, in one sentence


@on_one_thread
def lower_bound(
    robot: Robot,
    *,
    period: float = 10.0,
    harmonics: int = 5,
    columns: str = "inertial",
    seed: int = 0,
    time_limit: float = 60.0,
    progress: BoundProgress | None = None,
    pool: Sequence[Motion] = (),
) -> Bound:
    """Numerical lower bound on cond₂(W) of every Fourier series within the limits of a robot.

    cond² is at least the smallest κ with I ⪯ Σ w_k M(x_k) ⪯ κ I, w ≥ 0 over the feasible states
    x = (q, q̇, q̈). Those of finite Fourier series obey Bernstein's and Szegő's inequalities too,
    and their mixtures the rows of `TestFunctions`. Column generation adds the states that violate
    the multipliers of the best mixture most. P, Q ⪰ 0, tr Q = 1 with ⟨P − Q, M(x)⟩ + y·dφ/dt ≤ 0
    for every x prove cond² ≥ tr P; a remaining violation e is repaired by Q + e R, tr R = 1.

    Args:
        robot: The arm; its limits on position, velocity, acceleration and torque count.
        period: Period of the motion [s].
        harmonics: Of its Fourier series.
        columns: ``"inertial"`` or ``"friction"``.
        seed: Seed of all randomness.
        time_limit: Time after which the bound so far is returned [s].
        progress: Called after every round.
        pool: Feasible motions, for instance good trajectories, whose states to begin with.

    Raises:
        BadInput: An option out of range, or a joint without limits.
        Infeasible: No motion keeps the limits.
        UnknownName: Other columns.
    """
    began = time.time()
    series = resting_series(period, harmonics)
    if not time_limit > 0:
        raise BadInput(f"time limit {time_limit} s is not positive")
    problem = relaxation(robot, columns, 2 * np.pi * harmonics / period)
    rng = np.random.default_rng(seed)
    found = _seeds(robot, rng, series, pool)
    states = found
    bound = 0.0
    longest = 0.0
    while True:
        started = time.time()
        weights, multipliers = mixture_of(problem, states)
        worse, price = problem.worst(
            multipliers, found, rng, PRICING.starts, PRICING.steps
        )
        violation = float(price.max(initial=0.0))
        ceiling = float(np.sqrt(multipliers.value))
        if ceiling > bound * np.sqrt(1 + violation):
            bound = ceiling / float(np.sqrt(1 + violation))
            best = multipliers
            least = violation
        worse = worse[price > PRICING.added * violation]
        support = int((weights > PRICING.support * weights.max()).sum())
        order = np.argsort(-problem.price(multipliers, states))
        kept = states[order[: 2 * support + PRICING.spare_states]]
        states = together([kept, worse])
        found = together([found, worse])
        now = time.time()
        if progress is not None:
            progress(now - began, bound, ceiling)
        longest = max(longest, now - started)
        late = now + longest > began + (1 - PRICING.final_time) * time_limit
        if late or bound > (1 - PRICING.closed) * ceiling:
            break
    multipliers = best.repaired(
        _largest_violation(problem, best, least, found, rng)
    )
    return Bound(
        value=max(1.0, float(np.sqrt(multipliers.value))),
        without_repair=max(1.0, float(np.sqrt(best.value))),
        relaxation=problem,
        multipliers=multipliers,
        assumptions=f"Holds for any motion of period {period:g} s with {harmonics} harmonics of "
        f"{robot.name} within its position, velocity, acceleration and torque limits, for the "
        f"unscaled {columns} base columns; numerical, not a proof: states that would violate it "
        "are searched for by ascent from many starts, not exhaustively.",
    )


def _largest_violation(
    problem: Relaxation,
    multipliers: Multipliers,
    violation: float,
    found: Motion,
    rng: np.random.Generator,
) -> float:
    """The violation of multipliers that a longer search finds."""
    for _ in range(PRICING.final_rounds):
        worse, price = problem.worst(
            multipliers, found, rng, PRICING.final_starts, PRICING.final_steps
        )
        worst = float(price.max(initial=0.0))
        if worst <= violation:
            break
        violation = worst
        found = together([found, worse])
    return violation


def bound_of(
    design: Design,
    *,
    seed: int = 0,
    time_limit: float = 60.0,
    progress: BoundProgress | None = None,
) -> Bound:
    """Lower bound for motions of a design's kind, whose states are those to begin with."""
    trajectory = design.trajectory
    return lower_bound(
        design.robot.with_limits(design.robot.limits.used(design.use)),
        period=trajectory.period,
        harmonics=design.harmonics,
        columns=design.information.columns,
        seed=seed,
        time_limit=time_limit,
        pool=[trajectory.motion(POOL_HZ)],
        progress=progress,
    )


def _seeds(
    robot: Robot,
    rng: np.random.Generator,
    series: FourierSeries,
    pool: Sequence[Motion],
) -> Motion:
    share = (np.arange(PRICING.seed_states) + 0.5) / PRICING.seed_states
    motions = [
        random_start(robot, rng, series).at(share * series.period)
        for _ in range(PRICING.seed_motions)
    ]
    for motion in pool:
        if motion.nv != robot.nv:
            raise BadInput(
                f"motion has {motion.nv} joints, robot {robot.name} has {robot.nv}"
            )
        rows = np.linspace(
            0, len(motion) - 1, min(len(motion), 2 * PRICING.seed_states)
        ).round()
        motions.append(motion[np.unique(rows.astype(np.intp))])
    return together(motions)


def mixture_of(problem: Relaxation, states: Motion) -> tuple[Array, Multipliers]:
    """Weights of the best mixture of states, shape (n,), and its multipliers."""
    M = problem.matrices(states)
    size = np.trace(M, axis1=1, axis2=2) + 1e-9 * problem.unit
    rows = problem.tests.rates(states) * (problem.unit / size)[:, None]
    weights, mixture = best_mixture(M / size[:, None, None], rows)
    return weights / size, replace(mixture, y=mixture.y * problem.unit)


def best_mixture(
    M: Array,
    rows: Array,
    *,
    softness: float = SOLVER.softness,
    tolerance: float = SOLVER.gap,
) -> tuple[Array, Multipliers]:
    """Minimise κ + |Σ w_k a_k|² / 2 softness over w ≥ 0 with I ⪯ Σ w_k M_k ⪯ κ I.

    M has the shape (n, r, r), the rows a (n, m), the weights (n,). The dual maximises
    tr P − softness |y|² / 2 over P, Q ⪰ 0, tr Q = 1 with ⟨P − Q, M_k⟩ + y·a_k ≤ 0. Primal-dual
    interior-point method, HKM direction with Mehrotra's corrector (Helmberg, Rendl, Vanderbei,
    Wolkowicz 1996): its linear system has a row for every state, that of a general conic solver
    one for every entry of M, which is 50 times slower. Stopped at the tolerance of the relative
    gap. The weights keep both inequalities all the time, P, Q and y come to keep theirs.
    """
    n, r, _ = M.shape
    one = np.eye(r)
    low, *_, high = np.linalg.eigvalsh(M.sum(axis=0))
    point = _Point(
        np.stack([one, one]) / r,
        np.ones(n),
        np.zeros(rows.shape[1]),
        np.full(n, 2.0 / low),
        4.0 * high / low,
    )
    for _ in range(SOLVER.iterations):
        total = np.tensordot(point.w, M, axes=1)
        S = np.stack([total - one, point.kappa * one - total])
        lack = point.slack + rows @ point.y - _against(M, point.X)
        away = point.w @ rows + softness * point.y
        gap = point.product(S) / max(1.0, float(np.trace(point.X[0])))
        if max(gap, np.abs(lack).max(), np.abs(away).max(initial=0.0)) < tolerance:
            break
        try:
            point = _newton_step(M, rows, softness, point, S)
        except np.linalg.LinAlgError:  # as near to the boundary as numbers go
            break
    size = np.trace(point.X[1])
    P, Q = point.X / size
    return point.w, Multipliers(P, Q, point.y / size)


@dataclass(frozen=True, eq=False)
class _Point:
    """P and Q in X, slack of the dual's inequalities, y, weights, κ; or a direction of them."""

    X: Array
    slack: Array
    y: Array
    w: Array
    kappa: float

    def moved(self, d: _Point, step: float) -> _Point:
        parts = zip(vars(self).values(), vars(d).values(), strict=True)
        return _Point(*(own + step * change for own, change in parts))

    def product(self, S: Array) -> float:
        """Complementarity, with S = Σ w M − I and κ I − Σ w M, shape (2, r, r)."""
        return float(np.vdot(self.X, S) + self.slack @ self.w)


def _newton_step(
    M: Array, rows: Array, softness: float, point: _Point, S: Array
) -> _Point:
    """The next point: predictor, then corrector, with one factorisation."""
    X = point.X
    slack = point.slack
    w = point.w
    n = len(w)
    inverse = np.asarray(np.linalg.inv(S), float)
    H = np.zeros((n + 1, n + 1))
    H[:n, :n] = rows @ rows.T / softness + np.diag(slack / w)
    for left, right in zip(_root(inverse), _root(X), strict=True):
        F = (left.T @ M @ right).reshape(n, -1)
        H[:n, :n] += F @ F.T
    trace = (left.T @ right).ravel()  # of Q and κ I, the second block
    H[n, :n] = -F @ trace
    H[:n, n] = -F @ trace
    H[n, n] = trace @ trace
    H[np.diag_indices_from(H)] *= 1 + 1e-13
    factor = scipy.linalg.cho_factor(H, lower=True, check_finite=False)

    def direction(
        mu: float, second: Array | float, second_line: Array | float
    ) -> tuple[_Point, Array]:
        """The direction to a complementarity of mu, and the change of S."""
        T = _symmetric(mu * inverse - second)
        t = mu / w - second_line
        right = t - w @ rows @ rows.T / softness - _against(M, T)
        right = np.append(right, np.trace(T[1]) - 1)
        v = scipy.linalg.cho_solve(factor, right, check_finite=False)
        v += scipy.linalg.cho_solve(factor, right - H @ v, check_finite=False)
        total = np.tensordot(v[:n], M, axes=1)
        dS = np.stack([total, v[n] * np.eye(len(total)) - total])
        dX = T - _symmetric(X @ dS @ inverse) - X
        dy = -(w + v[:n]) @ rows / softness - point.y
        return _Point(dX, t - slack * v[:n] / w - slack, dy, v[:n], float(v[n])), dS

    def step(d: _Point, dS: Array) -> float:
        matrices = min(_reach(X, d.X), _reach(S, dS))
        lines = min(_reach_line(slack, d.slack), _reach_line(w, d.w))
        return min(1.0, SOLVER.step * min(matrices, lines))

    first, dS = direction(0.0, 0.0, 0.0)
    length = step(first, dS)
    before = point.product(S)
    after = point.moved(first, length).product(S + length * dS)
    mu = before / (n + 2 * len(M[0])) * min(1.0, max(after / before, 0.0)) ** 3
    last, dS = direction(mu, first.X @ dS @ inverse, first.slack * first.w / w)
    return point.moved(last, step(last, dS))


def _against(M: Array, X: Array) -> Array:
    """⟨M_k, Q − P⟩ of every state, shape (n,)."""
    return np.tensordot(M, X[1] - X[0], axes=2)


def _reach(A: Array, D: Array) -> float:
    """Largest step along D that keeps A + step·D positive semidefinite, shapes (2, r, r)."""
    R = np.linalg.inv(_root(A))
    low = float(
        np.linalg.eigvalsh(_symmetric(R @ D @ np.swapaxes(R, 1, 2)))[:, 0].min()
    )
    return np.inf if low >= 0 else -1 / low


def _reach_line(x: Array, dx: Array) -> float:
    down = dx < 0
    return float(np.min(-x[down] / dx[down])) if down.any() else np.inf


def _symmetric(A: Array) -> Array:
    return (A + np.swapaxes(A, 1, 2)) / 2


def _root(A: Array) -> Array:
    """R with R Rᵀ = A, shape (2, r, r)."""
    return np.asarray(np.linalg.cholesky(A), float)
