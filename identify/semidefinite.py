"""Least squares over bodies that can exist: the convex programme, its solver and its judge.

The unknowns y begin with the coordinates of the links (`excitant.identify.prior`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import clarabel
import numpy as np
import scipy

from excitant.exceptions import Infeasible
from excitant.identify.prior import NORMS, UPPER, matrices
from excitant.robots.motion import Array

_COLUMNS = np.lexsort(UPPER)  # the solver takes the triangle column by column
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


@dataclass(frozen=True, eq=False)
class Restriction:
    """G y − h, shape (m,), lies in a cone; the name is for contradictions.

    Cones: ``"nonnegative"``, ``"zero"``, ``"second_order"`` (first value ≥ norm of the rest) or
    ``"semidefinite"`` (triangle of a 4×4 matrix, off-diagonal terms times √2, shape (10,)).
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
            y = np.empty(10)
            y[_COLUMNS] = slack
            return -float(np.linalg.eigvalsh(matrices(y / NORMS, 1))[0, 0])
        if self.cone == "second_order":
            return float(np.linalg.norm(slack[1:]) - slack[0])
        return float(np.abs(slack).max() if self.cone == "zero" else -slack.min())


def definite(rows: Array, margin: float) -> tuple[Restriction, ...]:
    """Q_k ⪰ margin for matrices whose triangles, times `NORMS`, are rows of y, (links, 10, p)."""
    h = margin * np.eye(4)[UPPER]
    return tuple(Restriction("semidefinite", each[_COLUMNS], h[_COLUMNS]) for each in rows)


@dataclass(frozen=True, eq=False)
class Program:
    """min ‖A y − z‖² + ‖C y − d‖², y restricted: data, shape (m, p), and what is known, (c, p)."""

    A: Array
    z: Array
    C: Array
    d: Array
    restrictions: tuple[Restriction, ...]

    def triangle(self) -> tuple[Array, Array]:
        """F and t with ‖F y − t‖² the objective but for a constant, F upper triangular, (p, p)."""
        rows, targets = np.vstack([self.A, self.C]), np.concatenate([self.z, self.d])
        both = np.asarray(np.linalg.qr(np.column_stack([rows, targets]), mode="r"), float)
        p = rows.shape[1]
        return both[:p, :p], both[:p, p]


@dataclass(frozen=True)
class KktResiduals:
    """Gradient of the Lagrangian and multipliers times slacks, relative; violation, absolute."""

    stationarity: float
    complementarity: float
    primal: float


@dataclass(frozen=True, eq=False)
class Solution:
    """Minimiser y, shape (p,), with one array of multipliers per restriction."""

    y: Array
    multipliers: tuple[Array, ...]

    def forces(self, program: Program) -> tuple[Array, float]:
        """Σ Gᵀλ, shape (p,), and Σ |λᵀ(G y − h)|."""
        pairs = list(zip(program.restrictions, self.multipliers, strict=True))
        pull = np.asarray(sum(r.G.T @ push for r, push in pairs))
        return pull, sum(abs(float(push @ r.slack(self.y))) for r, push in pairs)

    def kkt(self, program: Program) -> KktResiduals:
        """Residuals of the optimality conditions."""
        pull, slackness = self.forces(program)
        size = float(np.linalg.norm(2 * program.A.T @ program.z)) + 1.0
        parts = (program.A, program.z), (program.C, program.d)
        gradient = sum(2 * M.T @ (M @ self.y - target) for M, target in parts)
        return KktResiduals(
            float(np.linalg.norm(gradient - pull)) / size,
            slackness / size,
            max([0.0, *(r.violation(self.y) for r in program.restrictions)]),
        )


def solve(program: Program, centre: Array) -> Solution:
    """Minimiser and multipliers of a programme with one minimum; centre is the prior, shape (p,).

    With U a QR factor of data and prior together and y₀ the minimum without restrictions, the
    objective is ‖U (y − y₀)‖² plus a constant. It is solved for U (y − y₀), which no quality of
    data makes ill-conditioned. Where the solver does not reach its tolerance, other scalings are
    tried, and the solution nearest to the optimum is taken if it passes a check of its own.

    Raises:
        Infeasible: Restrictions without a common point, or no solution that passes its own check.
    """
    U, target = program.triangle()
    free = scipy.linalg.solve_triangular(U, target)
    if all(r.violation(free) <= 0 for r in program.restrictions):
        return Solution(free, tuple(np.zeros_like(r.h) for r in program.restrictions))
    size = max(1.0, float(np.linalg.norm(U @ (centre - free))))
    checked: list[tuple[float, Solution]] = []
    for trusted, found in _attempts(program, U, free, size):
        error = _distance_to_optimum(program, U, free, found)
        moved = float(np.linalg.norm(U @ (found.y - free)))
        missed = max(r.violation(found.y) for r in program.restrictions)
        if trusted or (missed <= _FEASIBLE and error <= max(_PRECISE, _NEAR * moved)):
            checked.append((error, found))
        if trusted:
            break
    if not checked:
        raise Infeasible(
            "physically consistent fit",
            "the semidefinite solver reaches no solution near the optimum under any scaling; the "
            "data fit only bodies far from any that can exist: look for wrong units or signs of "
            "torque",
        )
    return min(checked, key=lambda pair: pair[0])[1]


def _attempts(
    program: Program, U: Array, free: Array, size: float
) -> Iterator[tuple[bool, Solution]]:
    """Solutions under ever other scalings and looser tolerances, and whether to trust them."""
    inverse = scipy.linalg.solve_triangular(U, np.eye(len(free)))
    for (scale, equilibrate), tolerance in product(_SCALINGS, _TOLERANCES):
        unit, settings = scale * size, clarabel.DefaultSettings()
        settings.equilibrate_enable = equilibrate
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
        step = unit * inverse
        status, v, pushes = _conic(program.restrictions, step, free, 2.0, settings)
        if status in (_SOLVED, _ALMOST):
            found = Solution(free + step @ v, tuple(push * unit**2 for push in pushes))
            yield status == _SOLVED and scale == 1.0, found


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

    A feasible y with multipliers λ lies ‖U (y − y₀) − ½ U⁻ᵀ Σ Gᵀλ‖² + Σ λᵀ(G y − h) above the dual.
    """
    pull, slackness = found.forces(program)
    dual = 0.5 * scipy.linalg.solve_triangular(U, pull, trans=1)
    return float(np.sqrt(np.sum((U @ (found.y - free) - dual) ** 2) + slackness))


def contradiction(restrictions: Sequence[Restriction]) -> tuple[str, ...]:
    """Names of restrictions that no y fulfils together, none of which can be spared, if any.

    Those without a name always stay.
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
