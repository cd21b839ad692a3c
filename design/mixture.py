"""The best-conditioned mixture of given states: a semidefinite programme with its dual.

A mixture weighs states k = 1 … n. It is the master problem of the column generation in
`excitant.design.bound`, solved many times over with a few hundred states; a general conic solver
needs 10 to 20 s each time (its linear system has p² rows), this one works on n × n.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from excitant.robots.motion import Array

_STEP = 0.95
_ITERATIONS = 60


@dataclass(frozen=True, eq=False)
class Mixture:
    """Solution of `best_mixture` and its dual certificate.

    Attributes:
        value: κ of the mixture, largest over smallest eigenvalue.
        weights: Weight of each state, not negative, shape (n,).
        P: Multiplier of Σ w M ⪰ I per block, positive semidefinite.
        Q: Multiplier of Σ w M ⪯ κ I per block, positive semidefinite, traces adding to 1.
        y: Multiplier of each equality row, shape (m,).
        B: Multiplier of each matrix row, positive semidefinite.
        gap: Primal less dual value, relative.
        iterations: Steps taken.
    """

    value: float
    weights: Array
    P: tuple[Array, ...]
    Q: tuple[Array, ...]
    y: Array
    B: tuple[Array, ...]
    gap: float
    iterations: int


def best_mixture(
    M: Sequence[Array],
    rows: Array,
    cones: Sequence[Array],
    *,
    bound: float = 10.0,
    tolerance: float = 1e-6,
) -> Mixture:
    """Minimise κ over weights w ≥ 0 of states.

        I ⪯ Σ w_k M_k ⪯ κ I,   Σ w_k a_k = 0 (softly),   Σ w_k N_k ⪰ 0

    The dual maximises tr P over P, Q, B ⪰ 0, tr Q = 1, |y| ≤ bound with
    ⟨P − Q, M_k⟩ + y·a_k + ⟨B, N_k⟩ ≤ 0 for every k. An equality row may be violated at the
    price ``bound`` per unit, which is what bounds its multiplier. Primal-dual interior-point
    method with the HKM direction and Mehrotra's corrector (Helmberg et al. 1996).

    Args:
        M: Diagonal blocks of the states' information, each of shape (n, p_b, p_b).
        rows: a, shape (n, m).
        cones: N, each of shape (n, s_b, s_b).
        bound: Largest multiplier of an equality row.
        tolerance: Relative gap to stop at.
    """
    return _InteriorPoint(M, rows, cones, bound).run(tolerance)


class _InteriorPoint:
    """min ⟨C, X⟩ over A X = b, X ⪰ 0 with X = (P, Q, B; s, y⁺, y⁻, u ≥ 0).

    Row k: ⟨M_k, Q − P⟩ − a_k·(y⁺ − y⁻) − ⟨N_k, B⟩ − s_k = 0; row n: tr Q = 1; then
    y⁺ + y⁻ + u = bound.
    """

    def __init__(
        self, M: Sequence[Array], rows: Array, cones: Sequence[Array], bound: float
    ) -> None:
        n, m = rows.shape
        self.n, self.m, self.blocks, self.cones = n, m, len(M), len(cones)
        self.A = [-block for block in M] + list(M) + [-cone for cone in cones]
        size = n + 1 + m
        self.b = np.concatenate([np.zeros(n), [1.0], np.full(m, bound)])
        L = np.zeros((size, n + 3 * m))
        L[:n, :n] = -np.eye(n)
        L[:n, n : n + m], L[:n, n + m : n + 2 * m] = -rows, rows
        for part in range(3):
            L[n + 1 :, n + part * m : n + (part + 1) * m] = np.eye(m)
        self.L, self.c = L, np.zeros(n + 3 * m)
        self.C = [-np.eye(A.shape[1]) * (k < self.blocks) for k, A in enumerate(self.A)]
        self.traced = range(self.blocks, 2 * self.blocks)

    def forward(self, X: Sequence[Array], x: Array) -> Array:
        """A X."""
        out = self.L @ x
        for k, (A, block) in enumerate(zip(self.A, X, strict=True)):
            out[: self.n] += np.einsum("kij,ij->k", A, block, optimize=True)
            if k in self.traced:
                out[self.n] += np.trace(block)
        return out

    def adjoint(self, v: Array) -> tuple[list[Array], Array]:
        """Aᵀ v."""
        blocks = [np.tensordot(v[: self.n], A, axes=1) for A in self.A]
        for k in self.traced:
            blocks[k] = blocks[k] + v[self.n] * np.eye(len(blocks[k]))
        return blocks, self.L.T @ v

    def schur(self, X: Sequence[Array], inverse: Sequence[Array], x: Array, s: Array) -> Array:
        """The matrix A (X ⊗ S⁻¹) Aᵀ."""
        H = (self.L * (x / s)) @ self.L.T
        n = self.n
        for k, (A, block, S) in enumerate(zip(self.A, X, inverse, strict=True)):
            left, right = _root(S), _root(block)
            F = (left.T @ A @ right).reshape(n, -1)
            H[:n, :n] += _gram(F)
            if k in self.traced:
                trace = (left.T @ right).ravel()
                H[n, :n] += F @ trace
                H[:n, n] += F @ trace
                H[n, n] += trace @ trace
        return H

    def run(self, tolerance: float) -> Mixture:
        """Iterate from multiples of the identity."""
        X = [np.eye(A.shape[1]) / A.shape[1] for A in self.A]
        S = [10*np.eye(A.shape[1]) for A in self.A]
        x, s, v = np.ones(len(self.c)), 10*np.ones(len(self.c)), np.zeros(len(self.b))
        x[self.n :] = self.b[-1] / 3 if self.m else 1.0
        degree = len(x) + sum(len(block) for block in X)
        best: Mixture | None = None
        ap = ad = 1.0
        for iteration in range(_ITERATIONS):
            back, back_lin = self.adjoint(v)
            Rd = [C - Sb - Ab for C, Sb, Ab in zip(self.C, S, back, strict=True)]
            rd = self.c - s - back_lin
            rp = self.b - self.forward(X, x)
            mu = (sum(np.vdot(a, b) for a, b in zip(X, S, strict=True)) + x @ s) / degree
            primal = sum(np.vdot(a, b) for a, b in zip(X, self.C, strict=True))
            gap = degree * mu / max(1.0, abs(float(primal)))
            infeasible = max(
                float(np.abs(rp).max()), float(np.abs(rd).max()), *(np.abs(R).max() for R in Rd)
            )
            best = self.mixture(X, x, v, gap, iteration)
            if (gap < tolerance and infeasible < 1e-6) or max(ap, ad) < 1e-4:
                break
            inverse = [np.linalg.inv(Sb) for Sb in S]
            H = self.schur(X, inverse, x, s)
            H[np.diag_indices_from(H)] *= 1 + 1e-13
            try:
                factor = scipy.linalg.cho_factor(H, lower=True, check_finite=False)
            except np.linalg.LinAlgError:
                break
            E = [_sym(0 * R) for R in Rd]
            e = np.zeros_like(x)
            for sigma in (0.0, -1.0):
                if sigma < 0:
                    ap, ad = self.steps(X, S, x, s, dX, dS, dx, ds)
                    after = sum(
                        np.vdot(a + ap * da, b + ad * db)
                        for a, da, b, db in zip(X, dX, S, dS, strict=True)
                    ) + (x + ap * dx) @ (s + ad * ds)
                    sigma = min(1.0, (float(after) / degree / mu)) ** 3
                    E = [da @ db @ i for da, db, i in zip(dX, dS, inverse, strict=True)]
                    e = dx * ds / s
                T = [
                    sigma * mu * i - a @ R @ i - c
                    for i, a, R, c in zip(inverse, X, Rd, E, strict=True)
                ]
                t = sigma * mu / s - x * rd / s - e
                rhs = self.b - self.forward([_sym(a) for a in T], t)
                dv = scipy.linalg.cho_solve(factor, rhs, check_finite=False)
                back, back_lin = self.adjoint(dv)
                dS = [R - a for R, a in zip(Rd, back, strict=True)]
                ds = rd - back_lin
                dX = [
                    _sym(a + Xb @ Ab @ i) - Xb
                    for a, Xb, Ab, i in zip(T, X, back, inverse, strict=True)
                ]
                dx = t + x * back_lin / s - x
            ap, ad = self.steps(X, S, x, s, dX, dS, dx, ds)
            X = [a + ap * d for a, d in zip(X, dX, strict=True)]
            S = [a + ad * d for a, d in zip(S, dS, strict=True)]
            x, s, v = x + ap * dx, s + ad * ds, v + ad * dv
        assert best is not None
        return best

    def steps(self, X, S, x, s, dX, dS, dx, ds):
        ap = min(_reach_line(x, dx), *(_reach(a, d) for a, d in zip(X, dX, strict=True)))
        ad = min(_reach_line(s, ds), *(_reach(a, d) for a, d in zip(S, dS, strict=True)))
        return min(1.0, _STEP * ap), min(1.0, _STEP * ad)

    def mixture(self, X, x, v, gap, iteration) -> Mixture:
        n, m, k = self.n, self.m, self.blocks
        total = sum(float(np.trace(Q)) for Q in X[k : 2 * k])
        return Mixture(
            value=-float(v[n]),
            weights=np.maximum(v[:n], 0.0),
            P=tuple(a / total for a in X[:k]),
            Q=tuple(a / total for a in X[k : 2 * k]),
            y=(x[n : n + m] - x[n + m : n + 2 * m]) / total,
            B=tuple(a / total for a in X[2 * k :]),
            gap=gap,
            iterations=iteration,
        )


def _gram(F: Array) -> Array:
    return F @ F.T


def _sym(A: Array) -> Array:
    return (A + A.T) / 2


def _root(A: Array) -> Array:
    """R with R Rᵀ = A."""
    try:
        return np.linalg.cholesky(A)
    except np.linalg.LinAlgError:
        e, V = np.linalg.eigh(A)
        return V * np.sqrt(np.maximum(e, 1e-300))


def _reach(A: Array, D: Array) -> float:
    """Largest step along D that keeps A + step·D positive semidefinite."""
    R = np.linalg.inv(_chol(A))
    low = float(np.linalg.eigvalsh(_sym(R @ D @ R.T))[0])
    return np.inf if low >= 0 else -1 / low


def _chol(A: Array) -> Array:
    return _root(A + 1e-16 * np.trace(A) / len(A) * np.eye(len(A)))


def _reach_line(x: Array, dx: Array) -> float:
    down = dx < 0
    return float(np.min(-x[down] / dx[down])) if down.any() else np.inf
