"""The best-conditioned mixture of given states: a semidefinite programme with its dual.

It is the master problem of the column generation in `excitant.design.bound`, solved dozens of
times with several hundred states. The linear system of a general conic solver has a row for
every entry of M; the one here has a row for every state, and is 50 times faster.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from excitant.robots.motion import Array

_STEP = 0.95  # of the way to the boundary
_ITERATIONS = 60
_START = 10.0  # the dual slacks begin at this multiple of the identity
_FEASIBLE = 1e2  # residuals weigh so much more than the gap
_PATIENCE = 5  # steps without progress


@dataclass(frozen=True, eq=False)
class Multipliers:
    """Dual variables of `best_mixture`: a lower bound tr P on κ, when all states agree.

    Attributes:
        P: Of Σ w M ⪰ I, per block, positive semidefinite.
        Q: Of Σ w M ⪯ κ I, per block, positive semidefinite, traces adding to 1.
        y: Of the equality rows, shape (m,).
    """

    P: tuple[Array, ...]
    Q: tuple[Array, ...]
    y: Array

    @property
    def value(self) -> float:
        """The bound on κ, tr P."""
        return float(sum(np.trace(P) for P in self.P))


@dataclass(frozen=True, eq=False)
class Mixture:
    """Solution of `best_mixture`.

    Attributes:
        weights: Weight of each state, not negative, shape (n,).
        multipliers: The dual solution.
        gap: Primal less dual value, relative to the latter.
        iterations: Steps taken.
    """

    weights: Array
    multipliers: Multipliers
    gap: float
    iterations: int


def best_mixture(
    M: Sequence[Array],
    rows: Array,
    *,
    bound: float = 10.0,
    tolerance: float = 1e-6,
) -> Mixture:
    """Minimise κ over weights w ≥ 0 of states.

        I ⪯ Σ w_k M_k ⪯ κ I,   Σ w_k a_k = 0 (softly)

    The dual maximises tr P over P, Q ⪰ 0, tr Q = 1, |y| ≤ bound with ⟨P − Q, M_k⟩ + y·a_k ≤ 0
    for every k. An equality row may be violated at the price ``bound`` per unit, which is what
    bounds its multiplier. Primal-dual interior-point method, HKM direction with Mehrotra's
    corrector (Helmberg, Rendl, Vanderbei, Wolkowicz 1996). Stopped at a loose tolerance, the
    multipliers are well inside the optimal face, as column generation likes it.

    Args:
        M: Diagonal blocks of the states' information, each of shape (n, p_b, p_b).
        rows: a, shape (n, m).
        bound: Largest multiplier of an equality row.
        tolerance: Relative gap to stop at.
    """
    programme = _programme(M, rows, bound)
    point = _start(programme)
    best, least, stalled, done = point, _residual(programme, point), 0, 0
    for _ in range(_ITERATIONS):
        residual = _residual(programme, point)
        if residual.merit < least.merit:
            best, least, stalled = point, residual, 0
        else:
            stalled += 1
        if residual.merit < tolerance or stalled == _PATIENCE:
            break
        try:
            step = _newton(programme, point, residual)
        except np.linalg.LinAlgError:
            break
        point, done = _moved(point, step, *_reaches(point, step)), done + 1
    return _mixture(programme, best, least.gap, done)


@dataclass(frozen=True, eq=False)
class _Programme:
    """min ⟨C, X⟩ over A X = b, X ⪰ 0 with X = (P, Q) and x = (s, y⁺, y⁻, u) ≥ 0.

    Equation k: ⟨M_k, Q − P⟩ − a_k·(y⁺ − y⁻) − s_k = 0; equation n: tr Q = 1; the
    others: y⁺ + y⁻ + u = bound. The dual variables v are the weights, −κ and the prices paid.
    """

    A: list[Array]
    C: list[Array]
    L: Array
    b: Array
    n: int
    m: int
    blocks: int

    def traced(self, k: int) -> bool:
        """Whether a block is one of Q."""
        return k >= self.blocks

    def forward(self, X: Sequence[Array], x: Array) -> Array:
        """A X, shape (equations,)."""
        out: Array = self.L @ x
        for k, (A, block) in enumerate(zip(self.A, X, strict=True)):
            out[: self.n] += A.reshape(self.n, -1) @ block.ravel()
            if self.traced(k):
                out[self.n] += np.trace(block)
        return out

    def adjoint(self, v: Array) -> tuple[list[Array], Array]:
        """Aᵀ v, for the blocks and for the rest."""
        blocks = [np.tensordot(v[: self.n], A, axes=1) for A in self.A]
        for k, block in enumerate(blocks):
            if self.traced(k):
                block[np.diag_indices_from(block)] += v[self.n]
        return blocks, self.L.T @ v

    def schur(self, X: Sequence[Array], inverse: Sequence[Array], ratio: Array) -> Array:
        """A (X ⊗ S⁻¹) Aᵀ, shape (equations, equations)."""
        H: Array = (self.L * ratio) @ self.L.T
        n = self.n
        for k, (A, block, S) in enumerate(zip(self.A, X, inverse, strict=True)):
            left, right = _root(S), _root(block)
            F = (left.T @ A @ right).reshape(n, -1)
            H[:n, :n] += F @ F.T
            if self.traced(k):
                trace = (left.T @ right).ravel()
                H[n, :n] += F @ trace
                H[:n, n] += F @ trace
                H[n, n] += trace @ trace
        H[np.diag_indices_from(H)] *= 1 + 1e-13
        return H


@dataclass(frozen=True, eq=False)
class _Point:
    """Primal (X, x), dual slacks (S, s) and dual variables v; or a direction of them."""

    X: list[Array]
    x: Array
    S: list[Array]
    s: Array
    v: Array

    def product(self) -> float:
        """⟨X, S⟩ + x·s."""
        inner = sum(float(np.vdot(a, b)) for a, b in zip(self.X, self.S, strict=True))
        return inner + float(self.x @ self.s)

    @property
    def degree(self) -> int:
        """Order of the cone."""
        return len(self.x) + sum(len(block) for block in self.X)


@dataclass(frozen=True, eq=False)
class _Residual:
    """Dual residuals of the blocks and of the rest, largest residual, and relative gap."""

    blocks: list[Array]
    rest: Array
    size: float
    gap: float

    @property
    def merit(self) -> float:
        """Distance from optimality."""
        return max(self.gap, _FEASIBLE * self.size)


def _programme(M: Sequence[Array], rows: Array, bound: float) -> _Programme:
    n, m = rows.shape
    L = np.zeros((n + 1 + m, n + 3 * m))
    L[:n, :n] = -np.eye(n)
    L[:n, n : n + m], L[:n, n + m : n + 2 * m] = -rows, rows
    L[n + 1 :, n:] = np.tile(np.eye(m), 3)
    A = [*(-block for block in M), *M]
    C = [-np.eye(a.shape[1]) * (k < len(M)) for k, a in enumerate(A)]
    b = np.concatenate([np.zeros(n), [1.0], np.full(m, bound)])
    return _Programme(A, C, L, b, n, m, len(M))


def _start(programme: _Programme) -> _Point:
    sizes = [a.shape[1] for a in programme.A]
    x = np.ones(programme.L.shape[1])
    x[programme.n :] = programme.b[-1] / 3
    X, S = [np.eye(p) / p for p in sizes], [_START * np.eye(p) for p in sizes]
    return _Point(X, x, S, np.full(len(x), _START), np.zeros(len(programme.b)))


def _residual(programme: _Programme, point: _Point) -> _Residual:
    back, rest = programme.adjoint(point.v)
    blocks = [C - S - A for C, S, A in zip(programme.C, point.S, back, strict=True)]
    rest = -point.s - rest
    primal = programme.b - programme.forward(point.X, point.x)
    size = max(float(np.abs(r).max()) for r in (primal, rest, *blocks))
    value = sum(float(np.vdot(X, C)) for X, C in zip(point.X, programme.C, strict=True))
    return _Residual(blocks, rest, size, point.product() / max(1.0, abs(value)))


def _newton(programme: _Programme, point: _Point, residual: _Residual) -> _Point:
    """Predictor, then corrector, with one factorisation."""
    inverse: list[Array] = [np.asarray(np.linalg.inv(S), float) for S in point.S]
    H = programme.schur(point.X, inverse, point.x / point.s)
    factor = scipy.linalg.cho_factor(H, lower=True, check_finite=False)
    mu = point.product() / point.degree

    def direction(target: float, second: list[Array], second_rest: Array) -> _Point:
        R, r = residual.blocks, residual.rest
        T = [
            target * i - X @ d @ i - e
            for i, X, d, e in zip(inverse, point.X, R, second, strict=True)
        ]
        t = target / point.s - point.x * r / point.s - second_rest
        right = programme.b - programme.forward([_symmetric(a) for a in T], t)
        v = scipy.linalg.cho_solve(factor, right, check_finite=False)
        v += scipy.linalg.cho_solve(factor, right - H @ v, check_finite=False)
        back, rest = programme.adjoint(v)
        X = [
            _symmetric(a + X @ A @ i) - X
            for a, X, A, i in zip(T, point.X, back, inverse, strict=True)
        ]
        S = [d - A for d, A in zip(R, back, strict=True)]
        return _Point(X, t + point.x * rest / point.s - point.x, S, r - rest, v)

    first = direction(0.0, [np.zeros_like(X) for X in point.X], np.zeros_like(point.x))
    after = _moved(point, first, *_reaches(point, first)).product() / point.degree
    target = mu * min(1.0, max(after / mu, 0.0)) ** 3
    second = [a @ b @ i for a, b, i in zip(first.X, first.S, inverse, strict=True)]
    return direction(target, second, first.x * first.s / point.s)


def _moved(point: _Point, step: _Point, primal: float, dual: float) -> _Point:
    return _Point(
        [a + primal * d for a, d in zip(point.X, step.X, strict=True)],
        point.x + primal * step.x,
        [a + dual * d for a, d in zip(point.S, step.S, strict=True)],
        point.s + dual * step.s,
        point.v + dual * step.v,
    )


def _reaches(point: _Point, step: _Point) -> tuple[float, float]:
    """Primal and dual step lengths that stay inside the cone."""
    primal = [_reach(a, d) for a, d in zip(point.X, step.X, strict=True)]
    dual = [_reach(a, d) for a, d in zip(point.S, step.S, strict=True)]
    primal.append(_reach_line(point.x, step.x))
    dual.append(_reach_line(point.s, step.s))
    return min(1.0, _STEP * min(primal)), min(1.0, _STEP * min(dual))


def _reach(A: Array, D: Array) -> float:
    """Largest step along D that keeps A + step·D positive semidefinite."""
    R = np.linalg.inv(_root(A))
    low = float(np.linalg.eigvalsh(_symmetric(R @ D @ R.T))[0])
    return np.inf if low >= 0 else -1 / low


def _reach_line(x: Array, dx: Array) -> float:
    down = dx < 0
    return float(np.min(-x[down] / dx[down])) if down.any() else np.inf


def _mixture(programme: _Programme, point: _Point, gap: float, iterations: int) -> Mixture:
    n, m, k = programme.n, programme.m, programme.blocks
    total = sum(float(np.trace(Q)) for Q in point.X[k:])
    X = [a / total for a in point.X]
    y = (point.x[n : n + m] - point.x[n + m : n + 2 * m]) / total
    multipliers = Multipliers(tuple(X[:k]), tuple(X[k:]), y)
    return Mixture(np.maximum(point.v[:n], 0.0), multipliers, gap, iterations)


def _symmetric(A: Array) -> Array:
    S: Array = (A + A.T) / 2
    return S


def _root(A: Array) -> Array:
    """R with R Rᵀ = A."""
    try:
        return np.asarray(np.linalg.cholesky(A), float)
    except np.linalg.LinAlgError:
        e, V = np.linalg.eigh(A)
        R: Array = V * np.sqrt(np.maximum(e, 1e-14 * max(float(e[-1]), 1e-300)))
        return R
