"""A numerical lower bound on the condition number of any motion within a robot's limits."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy

from excitant.design.feasible import random_trajectory
from excitant.design.relaxation import Multipliers, Relaxation, numbered, relaxation
from excitant.exceptions import BadInput
from excitant.robots.motion import Array, Motion
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
    seed_harmonics: int = 5
    "Their harmonics, where the motion has no band."
    seed_period: float = 10.0
    "Their period [s], where the motion has no band."
    starts: int = 120
    "Starts of the ascent, from states of large weight and from random ones each."
    steps: int = 8
    "Steps of every ascent."
    polished: int = 80
    "Best points of the ascent that are polished."
    polish_steps: int = 24
    "Further steps of these."
    final_starts: int = 300
    "Starts of the last search for a violation."
    final_steps: int = 16
    "Steps of that search."
    final_rounds: int = 5
    "Times that it is repeated, at most, until it finds nothing worse."
    final_time: float = 0.1
    "Share of the time limit that is kept for it."
    loose_rounds: int = 6
    "First rounds, with `loose_gap` and without polishing."
    loose_gap: float = 1e-2
    "Relative gap at which the master problem stops in these rounds."
    gap: float = 1e-3
    "The same in later rounds."
    spare_states: int = 80
    "States kept beyond twice those with weight."
    added: float = 0.02
    "Share of the worst violation above which a state is added."
    support: float = 1e-3
    "Share of the largest weight above which a state has weight."
    closed: float = 2e-3
    "Relative distance of bound and ceiling at which the search ends."
    largest_multiplier: float = 0.1
    "Largest multiplier of an equality row, in units of the typical tr M; 0.03 occurs."


PRICING = PricingSettings()


@dataclass(frozen=True)
class InteriorPoint:
    """Settings of the primal-dual interior-point method of the master problem."""

    step: float = 0.95
    "Share of the way to the boundary of the cone."
    iterations: int = 60
    "Largest number of iterations."
    slack: float = 10.0
    "Multiple of the identity at which the dual slacks begin."
    residual_weight: float = 1e2
    "Weight of the residuals beside the duality gap."
    patience: int = 5
    "Iterations without progress after which it stops."


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
    harmonics: int | None = 5,
    columns: str = "inertial",
    seed: int = 0,
    time_limit: float = 60.0,
    progress: BoundProgress | None = None,
    pool: Sequence[Motion] = (),
) -> Bound:
    """Numerical lower bound on cond₂(W) of every motion within the limits of a robot.

    cond² is at least the smallest κ with I ⪯ Σ w_k M(x_k) ⪯ κ I, w ≥ 0 over the feasible states
    x = (q, q̇, q̈). Those of finite Fourier series obey Bernstein's and Szegő's inequalities too,
    and their mixtures the rows of `TestFunctions`. Column generation adds the states that violate
    the multipliers of the best mixture most. P, Q ⪰ 0, tr Q = 1 with ⟨P − Q, M(x)⟩ + y·dφ/dt ≤ 0
    for every x prove cond² ≥ tr P; a remaining violation e is repaired by Q + e R, tr R = 1.

    Args:
        robot: The arm; its limits on position, velocity, acceleration and torque count.
        period: Period of the motion [s].
        harmonics: Of its Fourier series; None for any motion whatever.
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
    if not (np.isfinite(period) and period > 0):
        raise BadInput(f"period {period} s is not a positive number")
    if harmonics is not None and harmonics < 2:
        raise BadInput(
            f"{harmonics} harmonics cannot be at rest at both ends; use at least 2"
        )
    if not time_limit > 0:
        raise BadInput(f"time limit {time_limit} s is not positive")
    top = np.inf if harmonics is None else 2 * np.pi * harmonics / period
    problem = relaxation(robot, columns, top, stationary=harmonics is not None)
    rng = np.random.default_rng(seed)
    states = _seeds(robot, rng, period, harmonics, pool)
    kind = "any motion"
    if harmonics is not None:
        kind += f" of period {period:g} s with {harmonics} harmonics"
    search = _Search(problem, rng, states)
    search.run(began, time_limit, progress)
    multipliers = search.certify()
    return Bound(
        value=max(1.0, float(np.sqrt(multipliers.value))),
        without_repair=max(1.0, float(np.sqrt(search.best.value))),
        relaxation=problem,
        multipliers=multipliers,
        assumptions=f"Holds for {kind} of {robot.name} within its position, velocity, acceleration "
        f"and torque limits, for the unscaled {columns} base columns; numerical, not a proof: "
        "states that would violate it are searched for by ascent from many starts, not "
        "exhaustively.",
    )


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


class _Search:
    """Column generation with the best multipliers so far."""

    def __init__(
        self, problem: Relaxation, rng: np.random.Generator, states: Motion
    ) -> None:
        self.problem = problem
        self.rng = rng
        self.states = states
        self.rounds = 0
        self.archive = states
        self.best: Multipliers
        self.weights: Array
        self.bound = 0.0
        self.violation = np.inf

    def run(
        self, began: float, time_limit: float, progress: BoundProgress | None
    ) -> None:
        longest = 0.0
        while True:
            started = time.time()
            ceiling = self.round()
            now = time.time()
            if progress is not None:
                progress(now - began, self.bound, ceiling)
            longest = max(longest, now - started)
            late = now + longest > began + (1 - PRICING.final_time) * time_limit
            if late or self.bound > (1 - PRICING.closed) * ceiling:
                return

    def round(self) -> float:
        early = self.rounds < PRICING.loose_rounds
        tolerance, polish = (
            (PRICING.loose_gap, 0) if early else (PRICING.gap, PRICING.polish_steps)
        )
        self.weights, multipliers = mixture_of(self.problem, self.states, tolerance)
        starts = self.starts(multipliers, PRICING.starts)
        states, price = self.problem.worst(
            multipliers, starts, PRICING.steps, PRICING.polished, polish
        )
        violation = float(price.max(initial=0.0))
        bound = float(np.sqrt(multipliers.value / (1 + violation)))
        if bound > self.bound:
            self.best = multipliers
            self.bound = bound
            self.violation = violation
        ceiling = float(np.sqrt(multipliers.value))
        self.rounds += 1
        self.exchange(multipliers, states[price > PRICING.added * violation])
        return ceiling

    def exchange(self, multipliers: Multipliers, states: Motion) -> None:
        self.archive = _together([self.archive, states])
        w = self.weights
        room = 2 * int((w > PRICING.support * w.max()).sum()) + PRICING.spare_states
        if len(w) > room:
            order = np.argsort(-self.problem.price(multipliers, self.states))[:room]
            self.states = self.states[np.sort(order)]
        self.states = _together([self.states, states])

    def starts(self, multipliers: Multipliers, n: int) -> Array:
        """Points of the cube: the best-priced n of all ever found, and n random ones."""
        price = self.problem.price(multipliers, self.archive)
        near = self.problem.space.cube(self.archive[np.argsort(-price)[:n]])
        known = near[: len(near) // 2]
        return np.concatenate(
            [near, self.problem.promising(multipliers, known, self.rng, n)]
        )

    def certify(self) -> Multipliers:
        """The best multipliers, repaired by the violation that a longer search finds."""
        for _ in range(PRICING.final_rounds):
            starts = self.starts(self.best, PRICING.final_starts)
            states, price = self.problem.worst(
                self.best,
                starts,
                PRICING.final_steps,
                PRICING.polished,
                PRICING.polish_steps,
            )
            worst = float(price.max(initial=0.0))
            if worst <= self.violation:
                break
            self.violation, self.archive = worst, _together([self.archive, states])
        return self.best.repaired(self.violation)


def _seeds(
    robot: Robot,
    rng: np.random.Generator,
    period: float,
    harmonics: int | None,
    pool: Sequence[Motion],
) -> Motion:
    if harmonics is None:
        period = PRICING.seed_period
        harmonics = PRICING.seed_harmonics
    t = (np.arange(PRICING.seed_states) + 0.5) / PRICING.seed_states * period
    motions = [
        random_trajectory(robot, rng, period, harmonics).at(t)
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
    return _together(motions)


def _together(motions: Sequence[Motion]) -> Motion:
    names = ("q", "dq", "ddq")
    return numbered(
        *(np.concatenate([getattr(m, name) for m in motions]) for name in names)
    )


def mixture_of(
    problem: Relaxation, states: Motion, tolerance: float
) -> tuple[Array, Multipliers]:
    """Weights of the best mixture of states, shape (n,), and its multipliers."""
    M = problem.matrices(states)
    size = np.trace(M, axis1=1, axis2=2) + 1e-9 * problem.unit
    rows = problem.tests.rates(states) * (problem.unit / size)[:, None]
    M = M / size[:, None, None]
    weights, mixture = best_mixture(
        M, rows, bound=PRICING.largest_multiplier, tolerance=tolerance
    )
    return weights / size, replace(mixture, y=mixture.y * problem.unit)


def best_mixture(
    M: Array, rows: Array, *, bound: float = 10.0, tolerance: float = 1e-6
) -> tuple[Array, Multipliers]:
    """Minimise κ over weights w ≥ 0 of states.

        I ⪯ Σ w_k M_k ⪯ κ I,   Σ w_k a_k = 0 (softly)

    M has the shape (n, r, r), the rows a (n, m), the weights (n,). The dual maximises tr P over
    P, Q ⪰ 0, tr Q = 1, |y| ≤ bound with ⟨P − Q, M_k⟩ + y·a_k ≤ 0. Primal-dual interior-point
    method, HKM direction with Mehrotra's corrector (Helmberg, Rendl, Vanderbei, Wolkowicz 1996):
    its linear system has a row for every state, that of a general conic solver one for every
    entry of M, which is 50 times slower. Stopped at the tolerance of the relative gap.
    """
    n, m = rows.shape
    programme = _Programme(M, rows, bound)
    point = best = programme.start()
    least = np.inf
    stalled = 0
    for _ in range(SOLVER.iterations):
        residual, merit = programme.residual(point)
        if merit < least:
            best = point
            least = merit
            stalled = 0
        else:
            stalled += 1
        if merit < tolerance or stalled == SOLVER.patience:
            break
        try:
            point = point.moved(programme.newton(point, residual))
        except np.linalg.LinAlgError:  # as near to the boundary as numbers go
            break
    P, Q = best.X / np.trace(best.X[1])
    y = (best.x[n : n + m] - best.x[n + m : n + 2 * m]) / np.trace(best.X[1])
    return np.maximum(best.v[:n], 0.0), Multipliers(P, Q, y)


@dataclass(frozen=True, eq=False)
class _Point:
    """Primal X = (P, Q) and x, dual slacks S and s, dual variables v; or a direction of them."""

    X: Array
    x: Array
    S: Array
    s: Array
    v: Array

    def mu(self) -> float:
        order = len(self.x) + 2 * len(self.X[0])
        return float(np.vdot(self.X, self.S) + self.x @ self.s) / order

    def moved(self, d: _Point) -> _Point:
        """As far along a direction as it stays inside the cone, primal and dual apart."""
        primal = min(
            1.0, SOLVER.step * min(_reach(self.X, d.X), _reach_line(self.x, d.x))
        )
        dual = min(
            1.0, SOLVER.step * min(_reach(self.S, d.S), _reach_line(self.s, d.s))
        )
        X = self.X + primal * d.X
        x = self.x + primal * d.x
        return _Point(
            X, x, self.S + dual * d.S, self.s + dual * d.s, self.v + dual * d.v
        )


class _Programme:
    """min ⟨C, X⟩ over A X + L x = b, X ⪰ 0 with X = (P, Q) and x = (s, y⁺, y⁻, u) ≥ 0.

    Equation k: ⟨M_k, Q − P⟩ − a_k·(y⁺ − y⁻) − s_k = 0; equation n: tr Q = 1; the
    others: y⁺ + y⁻ + u = bound. The dual variables v are the weights, −κ and the prices paid.
    """

    def __init__(self, M: Array, rows: Array, bound: float) -> None:
        n, m = rows.shape
        self.M = M
        self.n = n
        self.flat = M.reshape(n, -1)
        self.L = np.zeros((n + 1 + m, n + 3 * m))
        self.L[:n, :n] = -np.eye(n)
        self.L[:n, n : n + 2 * m] = np.hstack([-rows, rows])
        self.L[n + 1 :, n:] = np.tile(np.eye(m), 3)
        self.b = np.concatenate([np.zeros(n), [1.0], np.full(m, bound)])
        self.C = np.stack([-np.eye(M.shape[1]), np.zeros(M.shape[1:])])

    def start(self) -> _Point:
        r = self.M.shape[1]
        x = np.ones(self.L.shape[1])
        x[self.n :] = self.b[-1] / 3
        one = np.stack([np.eye(r)] * 2)
        return _Point(
            one / r,
            x,
            SOLVER.slack * one,
            np.full(len(x), SOLVER.slack),
            np.zeros(len(self.b)),
        )

    def forward(self, X: Array, x: Array) -> Array:
        out: Array = self.L @ x
        out[: self.n] += self.flat @ (X[1] - X[0]).ravel()
        out[self.n] += np.trace(X[1])
        return out

    def adjoint(self, v: Array) -> tuple[Array, Array]:
        """Aᵀ v and Lᵀ v."""
        total = (v[: self.n] @ self.flat).reshape(self.M.shape[1:])
        return np.stack(
            [-total, total + v[self.n] * np.eye(len(total))]
        ), self.L.T @ v

    def residual(self, point: _Point) -> tuple[tuple[Array, Array], float]:
        """Dual residuals of X and of x, and the distance from optimality."""
        back, rest = self.adjoint(point.v)
        dual = self.C - point.S - back
        line = -point.s - rest
        primal = self.b - self.forward(point.X, point.x)
        size = max(float(np.abs(part).max()) for part in (primal, line, dual))
        product = float(np.vdot(point.X, point.S) + point.x @ point.s)
        gap = product / max(1.0, abs(float(np.vdot(point.X, self.C))))
        return (dual, line), max(gap, SOLVER.residual_weight * size)

    def schur(self, X: Array, inverse: Array, ratio: Array) -> Array:
        """A (X ⊗ S⁻¹) Aᵀ + L diag(ratio) Lᵀ, shape (equations, equations)."""
        H: Array = (self.L * ratio) @ self.L.T
        n = self.n
        for left, right in zip(_root(inverse), _root(X), strict=True):
            F = (left.T @ self.M @ right).reshape(n, -1)
            H[:n, :n] += F @ F.T
        trace = (left.T @ right).ravel()  # of Q, the second block
        H[n, :n] += F @ trace
        H[:n, n] += F @ trace
        H[n, n] += trace @ trace
        H[np.diag_indices_from(H)] *= 1 + 1e-13
        return H

    def newton(self, point: _Point, residual: tuple[Array, Array]) -> _Point:
        """Predictor, then corrector, with one factorisation."""
        dual, line = residual
        inverse: Array = np.asarray(np.linalg.inv(point.S), float)
        H = self.schur(point.X, inverse, point.x / point.s)
        factor = scipy.linalg.cho_factor(H, lower=True, check_finite=False)

        def direction(
            target: float, second: Array | float, second_line: Array | float
        ) -> _Point:
            T = target * inverse - point.X @ dual @ inverse - second
            t = target / point.s - point.x * line / point.s - second_line
            right = self.b - self.forward(_symmetric(T), t)
            v = scipy.linalg.cho_solve(factor, right, check_finite=False)
            v += scipy.linalg.cho_solve(factor, right - H @ v, check_finite=False)
            back, rest = self.adjoint(v)
            X = _symmetric(T + point.X @ back @ inverse) - point.X
            x = t + point.x * rest / point.s - point.x
            return _Point(X, x, dual - back, line - rest, v)

        first = direction(0.0, 0.0, 0.0)
        mu = point.mu()
        after = point.moved(first).mu()
        target = mu * min(1.0, max(after / mu, 0.0)) ** 3
        return direction(
            target, first.X @ first.S @ inverse, first.x * first.s / point.s
        )


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
    S: Array = (A + np.swapaxes(A, 1, 2)) / 2
    return S


def _root(A: Array) -> Array:
    """R with R Rᵀ = A, shape (2, r, r)."""
    return np.asarray(np.linalg.cholesky(A), float)
