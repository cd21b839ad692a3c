"""Least squares over bodies that can exist: the convex programme, its solver and its judge.

With the pseudo-inertia of link k written P_k = L_k Q_k L_kᵀ, L_k L_kᵀ that of a reference body, the
coordinates y begin with the upper triangles of all Q_k. They have no units, and ‖Q − 1‖_F is the
coordinate-invariant distance to the reference (the constant pull-back of the affine-invariant
metric: Lee, Wensing, Park 2020).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import clarabel
import numpy as np
import scipy

from excitant.exceptions import Infeasible
from excitant.robots.motion import Array
from excitant.robots.parameters import from_pseudo_inertia, pseudo_inertia

MARGIN = 1e-4  # smallest eigenvalue of Q: no link shrinks below this part of its reference
FIT = "physically consistent fit"
_UPPER = np.triu_indices(4)
_SVEC = np.where(_UPPER[0] == _UPPER[1], 1.0, np.sqrt(2.0))  # Σ (w · upper(Q))² = ‖Q‖_F²
_UNITS = np.zeros((10, 4, 4))
for _k, (_i, _j) in enumerate(zip(*_UPPER, strict=True)):
    _UNITS[_k, _i, _j] = _UNITS[_k, _j, _i] = 1.0
# the solver's triangle of a symmetric matrix, column by column, as a vector of the same norm
_TRIANGLE = np.tril_indices(4)
_OF_TRIANGLE = np.where(_TRIANGLE[0] == _TRIANGLE[1], 1.0, np.sqrt(2.0))

_CONES = {
    "nonnegative": clarabel.NonnegativeConeT,
    "zero": clarabel.ZeroConeT,
    "second_order": clarabel.SecondOrderConeT,
    "semidefinite": lambda _: clarabel.PSDTriangleConeT(4),
}
_TOLERANCES = (1e-10, 1e-8, 1e-7)  # of the conic solver: the tightest that rounding allows
_SCALINGS = ((1.0, True), (1e-3, True), (1e-3, False))  # of the unit of length; equilibration
_PRECISE = 1e-2  # posterior standard deviations from the optimum, or
_NEAR = 1e-4  # this part of the way from the fit without restrictions
_FEASIBLE = 1e-6  # violation in units of the restriction; far below the margin
_SOLVED, _ALMOST = "Solved", "AlmostSolved"  # states of the solver with a solution
_STEPS = 100  # Newton steps with log-determinants
_EXACT = 1e-8  # squared Newton decrement, from which one more full step is exact to rounding
_NEARLY = 0.1  # the same, while log-determinants weigh more than they should
_FACTOR = 8.0  # by which they weigh less then
_STATIONARY = 1e-3  # gradient left at what counts as an optimum, relative to that of the data
_ROUNDING = 1e-13  # of the objective
_ENOUGH = 1e-3  # of the decrease that the slope promises
_SHORTEST = 1e-6  # share of a step
_ADVICE = (
    "the data call for bodies far from any that can exist: look for wrong units or signs of torque"
)


def link_weights(links: int, sigma: float | Array) -> Array:
    """Square roots of the precision 1/σ² of the coordinates y, shape (10 links,)."""
    each = np.broadcast_to(np.asarray(sigma, float), (links,))
    return np.concatenate([_SVEC / s for s in each])


def link_coordinates(reference: Array) -> Array:
    """Map T from coordinates to standard parameters, φ = T y, shape (10 links, 10 links).

    Args:
        reference: Consistent standard parameters, which lie at Q = 1, shape (links, 10).
    """
    roots = np.linalg.cholesky([pseudo_inertia(values) for values in reference])
    blocks = (from_pseudo_inertia(L @ _UNITS @ L.T).T for L in roots)
    return np.asarray(scipy.linalg.block_diag(*blocks), float)


def matrices(y: Array, links: int) -> Array:
    """The matrices Q_k of the coordinates, shape (links, 4, 4)."""
    return np.tensordot(y[: 10 * links].reshape(links, 10), _UNITS, 1)


@dataclass(frozen=True, eq=False)
class Restriction:
    """G y − h lies in a cone.

    Attributes:
        cone: ``"nonnegative"``, ``"zero"``, ``"second_order"`` (first value ≥ norm of the rest) or
            ``"semidefinite"`` (triangle of a 4×4 matrix, off-diagonal terms times √2, shape (10,)).
        G: Shape (m, p).
        h: Shape (m,).
        name: What it says, for messages; empty where it cannot be in contradiction.
    """

    cone: str
    G: Array
    h: Array
    name: str = ""

    def slack(self, y: Array) -> Array:
        """G y − h, shape (m,)."""
        return np.asarray(self.G @ y - self.h)

    def violation(self, y: Array) -> float:
        """By how much it is missed, in its own units; negative where there is room."""
        slack = self.slack(y)
        if self.cone == "semidefinite":
            Q = np.zeros((4, 4))
            Q[_TRIANGLE] = slack / _OF_TRIANGLE
            return -float(np.linalg.eigvalsh(Q)[0])
        if self.cone == "second_order":
            return float(np.linalg.norm(slack[1:]) - slack[0])
        return float(np.abs(slack).max() if self.cone == "zero" else -slack.min())


def definite(links: int, margin: float, p: int) -> tuple[Restriction, ...]:
    """Q_k ⪰ margin for the links that p coordinates begin with."""
    triangle = _OF_TRIANGLE[:, None] * _UNITS[:, *_TRIANGLE].T
    h = margin * np.eye(4)[_TRIANGLE]
    G = [np.pad(triangle, ((0, 0), (10 * k, p - 10 * k - 10))) for k in range(links)]
    return tuple(Restriction("semidefinite", each, h) for each in G)


@dataclass(frozen=True, eq=False)
class Program:
    """min ‖A y − z‖² + ‖C y − d‖² + Σ_k w_k (tr Q_k − log det Q_k), y restricted.

    The Bregman divergence of −log det, D(P ‖ P̄) = tr(P̄⁻¹ P) − log det(P̄⁻¹ P) − 4, is the relative
    entropy of two densities and keeps every body possible by itself (Lee and Park 2018).

    Attributes:
        A: Data, shape (m, p).
        z: Shape (m,).
        C: What is known beforehand, shape (c, p).
        d: Shape (c,).
        restrictions: What y must satisfy.
        entropy: Weights w of the log-determinants, shape (links,); empty without.
    """

    A: Array
    z: Array
    C: Array
    d: Array
    restrictions: tuple[Restriction, ...]
    entropy: Array

    def triangle(self) -> tuple[Array, Array]:
        """F and t with ‖F y − t‖² the sum of squares, F upper triangular."""
        rows, targets = np.vstack([self.A, self.C]), np.concatenate([self.z, self.d])
        both = np.asarray(np.linalg.qr(np.column_stack([rows, targets]), mode="r"), float)
        return both[:, :-1], both[:, -1]

    def value(self, y: Array) -> float:
        """The objective; infinite where a matrix with a log-determinant is not positive."""
        total = float(np.sum((self.A @ y - self.z) ** 2) + np.sum((self.C @ y - self.d) ** 2))
        Q = matrices(y, len(self.entropy))
        if np.linalg.eigvalsh(Q).min(initial=np.inf) <= 0:
            return np.inf
        divergence = np.trace(Q, axis1=1, axis2=2) - np.linalg.slogdet(Q)[1]
        return total + float(self.entropy @ divergence)

    def gradient(self, y: Array) -> Array:
        """Gradient of the objective, shape (p,)."""
        total = 2 * self.A.T @ (self.A @ y - self.z) + 2 * self.C.T @ (self.C @ y - self.d)
        links = len(self.entropy)
        slopes = self.entropy[:, None, None] * (np.eye(4) - np.linalg.inv(matrices(y, links)))
        total[: 10 * links] += (_SVEC**2 * slopes[:, *_UPPER]).ravel()
        return np.asarray(total, float)

    def local(self, y: Array) -> Program:
        """The programme with its log-determinants to second order around y.

        Around Q = X Xᵀ the divergence is ½‖X⁻¹ (Q' − Q) X⁻ᵀ‖² beside its slope: the pull-back
        metric at the present body.
        """
        if not len(self.entropy):
            return self
        blocks, targets = [], []
        for w, Q in zip(self.entropy, matrices(y, len(self.entropy)), strict=True):
            X = np.linalg.cholesky(Q)
            K = np.linalg.inv(X)
            weights = np.sqrt(w / 2) * _SVEC
            blocks.append(weights[:, None] * (K @ _UNITS @ K.T)[:, *_UPPER].T)
            targets.append(weights * (2 * np.eye(4) - X.T @ X)[_UPPER])
        rows = np.zeros((10 * len(blocks), len(y)))
        rows[:, : len(rows)] = scipy.linalg.block_diag(*blocks)
        return replace(
            self,
            C=np.vstack([self.C, rows]),
            d=np.concatenate([self.d, *targets]),
            entropy=np.zeros(0),
        )


@dataclass(frozen=True)
class KktResiduals:
    """How well the solution satisfies the optimality conditions, relative to the gradient.

    Attributes:
        stationarity: Gradient of the Lagrangian.
        complementarity: Inner products of multipliers and slacks.
        primal: Violation of the constraints, absolute in Q and θ.
    """

    stationarity: float
    complementarity: float
    primal: float


@dataclass(frozen=True, eq=False)
class Solution:
    """Minimiser of a programme with its multipliers.

    Attributes:
        y: Shape (p,).
        multipliers: One array for each restriction, in order.
    """

    y: Array
    multipliers: tuple[Array, ...]

    def kkt(self, program: Program) -> KktResiduals:
        """How well it satisfies the optimality conditions."""
        pairs = list(zip(program.restrictions, self.multipliers, strict=True))
        rest = program.gradient(self.y) - sum(r.G.T @ push for r, push in pairs)
        size = float(np.linalg.norm(2 * program.A.T @ program.z)) + 1.0
        return KktResiduals(
            float(np.linalg.norm(rest)) / size,
            sum(abs(float(push @ r.slack(self.y))) for r, push in pairs) / size,
            max([0.0, *(r.violation(self.y) for r, _ in pairs)]),
        )


def solve(program: Program, centre: Array) -> Solution:
    """Minimiser and multipliers of a programme.

    Args:
        program: What to solve; its quadratic part must have one minimum.
        centre: The prior, shape (p,), where all Q_k with log-determinants are 1.

    Raises:
        Infeasible: Restrictions without a common point, or no solution that passes its own check.
    """
    if not len(program.entropy):
        return _quadratic(program, centre)
    # log-determinants are weighed ever less, from where their second order at the centre holds
    F, t = program.triangle()
    program = replace(program, A=F, z=t, C=np.zeros((0, len(centre))), d=np.zeros(0))
    excess = float(np.sum((F @ centre - t)[: len(centre)] ** 2))
    factor = max(1.0, excess / float(program.entropy.min()))
    heavier = replace(program, entropy=factor * program.entropy)
    bodies = definite(len(program.entropy), MARGIN, len(centre))
    restrictions = (*bodies, *program.restrictions)
    y = _quadratic(replace(heavier.local(centre), restrictions=restrictions), centre).y
    while factor > 1.0:
        y = _newton(replace(program, entropy=factor * program.entropy), y, _NEARLY).y
        factor /= _FACTOR
    found = _newton(program, y, _EXACT)
    if found.kkt(program).stationarity > _STATIONARY:
        raise Infeasible(
            FIT, "Newton's method reaches no optimum of the log-determinants; " + _ADVICE
        )
    return found


def _newton(program: Program, y: Array, precision: float) -> Solution:
    """Minimiser with log-determinants to a squared Newton decrement, from a feasible point."""
    for _ in range(_STEPS):
        found = _quadratic(program.local(y), y)
        step = found.y - y
        decrease, value = -float(program.gradient(y) @ step), program.value(y)
        if decrease <= max(precision * float(program.entropy.min()), _ROUNDING * abs(value)):
            return found if np.isfinite(program.value(found.y)) else Solution(y, found.multipliers)
        share = 1.0
        while program.value(y + share * step) > value - _ENOUGH * share * decrease:
            share /= 2
            if share < _SHORTEST:
                return Solution(y, found.multipliers)
        y = y + share * step
    return Solution(y, found.multipliers)


def _quadratic(program: Program, centre: Array) -> Solution:
    """Minimiser without log-determinants.

    With U a QR factor of data and prior together and y₀ the minimum without restrictions, the
    objective is ‖U (y − y₀)‖² plus a constant. It is solved for U (y − y₀), which no quality of
    data makes ill-conditioned. Where the solver does not reach its tolerance, other scalings are
    tried, and the solution nearest to the optimum is taken if it passes a check of its own.
    """
    U, target = (x[: len(centre)] for x in program.triangle())
    free = scipy.linalg.solve_triangular(U, target)
    if all(r.violation(free) <= 0 for r in program.restrictions):
        return Solution(free, tuple(np.zeros_like(r.h) for r in program.restrictions))
    size = max(1.0, float(np.linalg.norm(U @ (centre - free))))
    checked: list[tuple[float, Solution]] = []
    for scale, equilibrate in _SCALINGS:
        for status, found in _attempts(program, U, free, scale * size, equilibrate):
            error = _distance_to_optimum(program, U, free, found)
            moved = float(np.linalg.norm(U @ (found.y - free)))
            missed = max(r.violation(found.y) for r in program.restrictions)
            done = status == _SOLVED and scale == 1.0
            if done or (missed <= _FEASIBLE and error <= max(_PRECISE, _NEAR * moved)):
                checked.append((error, found))
            if done:
                return min(checked, key=lambda pair: pair[0])[1]
    if checked:
        return min(checked, key=lambda pair: pair[0])[1]
    raise Infeasible(
        FIT,
        "the semidefinite solver reaches no solution near the optimum under any scaling; "
        + _ADVICE,
    )


def _attempts(
    program: Program, U: Array, free: Array, unit: float, equilibrate: bool
) -> Iterator[tuple[str, Solution]]:
    """Status and solution at ever looser tolerances, in units of U (y − y₀)."""
    step = unit * scipy.linalg.solve_triangular(U, np.eye(len(free)))
    for tolerance in _TOLERANCES:
        settings = clarabel.DefaultSettings()
        settings.equilibrate_enable = equilibrate
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
        status, v, pushes = _conic(program.restrictions, step, free, 2.0, settings)
        if status in (_SOLVED, _ALMOST):
            yield status, Solution(free + step @ v, tuple(push * unit**2 for push in pushes))


def _conic(
    restrictions: Sequence[Restriction],
    step: Array,
    start: Array,
    curvature: float,
    settings: clarabel.DefaultSettings,
) -> tuple[str, Array, list[Array]]:
    """Status, v and multipliers of min ½ curvature ‖v‖² with y = start + step v restricted."""
    n = step.shape[1]
    P = scipy.sparse.csc_matrix(curvature * scipy.sparse.identity(n))
    A = scipy.sparse.csc_matrix(-np.vstack([r.G for r in restrictions]) @ step)
    b = np.concatenate([r.slack(start) for r in restrictions])
    sizes = [len(r.h) for r in restrictions]
    cones = [_CONES[r.cone](size) for r, size in zip(restrictions, sizes, strict=True)]
    settings.verbose = False
    found = clarabel.DefaultSolver(P, np.zeros(n), A, b, cones, settings).solve()
    return str(found.status), np.array(found.x), np.split(np.array(found.z), np.cumsum(sizes)[:-1])


def _distance_to_optimum(program: Program, U: Array, free: Array, found: Solution) -> float:
    """Bound of ‖U (y − y*)‖, in posterior standard deviations, by the duality gap.

    The objective grows with ‖U (y − y*)‖² from its optimum y* on, and a feasible y with multipliers
    λ lies ‖U (y − y₀) − ½ U⁻ᵀ Σ Gᵀλ‖² + Σ λᵀ(G y − h) above the dual value.
    """
    pairs = list(zip(program.restrictions, found.multipliers, strict=True))
    pull = np.asarray(sum(r.G.T @ push for r, push in pairs))
    dual = 0.5 * scipy.linalg.solve_triangular(U, pull, trans=1)
    slackness = sum(abs(float(push @ r.slack(found.y))) for r, push in pairs)
    return float(np.sqrt(np.sum((U @ (found.y - free) - dual) ** 2) + slackness))


def contradiction(restrictions: Sequence[Restriction]) -> tuple[str, ...]:
    """Names of restrictions that no y fulfils together, none of which can be spared.

    Those without a name always stay. Empty when all can be fulfilled.
    """
    kept = list(restrictions)
    if _fulfillable(kept):
        return ()
    for each in restrictions:
        rest = [r for r in kept if r is not each]
        if each.name and not _fulfillable(rest):
            kept = rest
    return tuple(r.name for r in kept if r.name)


def _fulfillable(restrictions: Sequence[Restriction]) -> bool:
    p = restrictions[0].G.shape[1]
    settings = clarabel.DefaultSettings()
    status, *_ = _conic(restrictions, np.eye(p), np.zeros(p), 0.0, settings)
    return status in (_SOLVED, _ALMOST)
