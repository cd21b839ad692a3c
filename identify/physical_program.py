"""The semidefinite least-squares programme behind the physically consistent fit, and its judge."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cvxpy as cp
import numpy as np
import scipy.linalg

from excitant.exceptions import Infeasible
from excitant.identify.physical_coordinates import matrices, slopes, symmetric
from excitant.robots.motion import Array

FIT = "physically consistent fit"


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
class Restriction:
    """G y − h lies in a cone.

    Attributes:
        cone: ``"nonnegative"``, ``"zero"`` or ``"second_order"`` (first entry ≥ norm of the rest).
        G: Shape (m, p).
        h: Shape (m,).
        name: What it says, for messages; empty where it cannot be in contradiction.
    """

    cone: str
    G: Array
    h: Array
    name: str = ""

    def condition(self, slack: cp.Expression) -> cp.Constraint:
        """The restriction of an expression for G y − h."""
        if self.cone == "zero":
            return slack == 0
        if self.cone == "nonnegative":
            return slack >= 0
        return cp.SOC(slack[0], slack[1:])

    def multiplier(self, dual: Any) -> Array:
        """λ with the gradient of the objective = Σ Gᵀ λ, from the solver's dual value."""
        if self.cone == "second_order":
            return np.concatenate([np.ravel(part) for part in dual])
        values = np.ravel(np.asarray(dual, float))
        return -values if self.cone == "zero" else values

    def violation(self, y: Array) -> float:
        """By how much it is missed, in its own units; negative where there is room."""
        slack = self.G @ y - self.h
        if self.cone == "zero":
            return float(np.abs(slack).max())
        if self.cone == "nonnegative":
            return float(-slack.min())
        return float(np.linalg.norm(slack[1:]) - slack[0])


@dataclass(frozen=True, eq=False)
class Program:
    """min ‖A y − z‖² + ‖C y − d‖² + Σ_k w_k (tr Q_k − log det Q_k), y restricted.

    Attributes:
        A: Data, shape (m, p).
        z: Shape (m,).
        C: What is known beforehand, shape (c, p).
        d: Shape (c,).
        links: Number of matrices Q_k that y begins with.
        margin: Smallest eigenvalue of every Q_k.
        restrictions: Further restrictions.
        entropy: Weights w of the log-determinants, shape (links,); None without.
    """

    A: Array
    z: Array
    C: Array
    d: Array
    links: int
    margin: float
    restrictions: tuple[Restriction, ...] = ()
    entropy: Array | None = None

    def value(self, y: Array) -> float:
        """The objective; infinite where a matrix with a log-determinant is not positive."""
        total = float(np.sum((self.A @ y - self.z) ** 2) + np.sum((self.C @ y - self.d) ** 2))
        if self.entropy is None:
            return total
        Q = matrices(y, self.links)
        lowest = np.linalg.eigvalsh(Q)[:, 0]
        if lowest.min() <= 0:
            return np.inf
        divergence = np.trace(Q, axis1=1, axis2=2) - np.linalg.slogdet(Q)[1]
        return total + float(self.entropy @ divergence)

    def gradient(self, y: Array) -> Array:
        """Gradient of the objective, shape (p,)."""
        total = 2 * self.A.T @ (self.A @ y - self.z) + 2 * self.C.T @ (self.C @ y - self.d)
        if self.entropy is not None:
            G = np.eye(4) - np.linalg.inv(matrices(y, self.links))
            total[: 10 * self.links] += slopes(self.entropy[:, None, None] * G)
        return np.asarray(total, float)


@dataclass(frozen=True, eq=False)
class Solution:
    """Minimiser with its multipliers.

    Attributes:
        y: Shape (p,).
        matrices: Multipliers of Q_k ⪰ margin, shape (links, 4, 4).
        others: Multipliers of the restrictions, in order.
    """

    y: Array
    matrices: Array
    others: tuple[Array, ...]


def solve(program: Program, centre: Array, *, definite: bool = True) -> Solution:
    """Minimiser and multipliers of a programme without log-determinants.

    With U a QR factor of data and prior together and y₀ the minimum without constraints, the
    objective is ‖U (y − y₀)‖² plus a constant. It is solved for U (y − y₀), which no
    quality of data makes ill-conditioned.

    Args:
        program: What to solve; its quadratic part must have one minimum.
        centre: The prior, shape (p,); gives the scale.
        definite: Whether Q_k ⪰ margin is demanded.

    Raises:
        Infeasible: Restrictions without a common point, or the solver did not converge.
    """
    links, p = program.links, len(centre)
    stacked = np.column_stack(
        [np.vstack([program.A, program.C]), np.concatenate([program.z, program.d])]
    )
    factor = np.asarray(np.linalg.qr(stacked, mode="r"), float)[:p]
    U, free = factor[:, :-1], scipy.linalg.solve_triangular(factor[:, :-1], factor[:, -1])
    size = max(1.0, float(np.linalg.norm(U @ (centre - free))))
    step = size * scipy.linalg.solve_triangular(U, np.eye(p))
    v = cp.Variable(p)
    semidefinite = [
        cp.reshape((M @ step) @ v + M @ free, (4, 4), order="C") >> program.margin * np.eye(4)
        for M in (symmetric(10 * k, p) for k in range(links if definite else 0))
    ]
    others = [r.condition((r.G @ step) @ v + (r.G @ free - r.h)) for r in program.restrictions]
    if semidefinite or others:
        solve_tightly(cp.Problem(cp.Minimize(cp.sum_squares(v)), [*semidefinite, *others]))
        free = free + step @ np.asarray(v.value, float)
    duals = [np.asarray(c.dual_value, float) * size**2 for c in semidefinite]
    pushes = [
        r.multiplier(c.dual_value) * size**2
        for r, c in zip(program.restrictions, others, strict=True)
    ]
    return Solution(free, np.array(duals).reshape(-1, 4, 4), tuple(pushes))


def solve_tightly(problem: cp.Problem) -> None:
    """Solve to the tightest tolerance that rounding allows."""
    for tolerance in (1e-10, 1e-8, 1e-7):
        names = ("tol_gap_abs", "tol_gap_rel", "tol_feas")
        try:
            with warnings.catch_warnings(action="ignore"):  # the status says it
                problem.solve(solver=cp.CLARABEL, **dict.fromkeys(names, tolerance))
        except cp.SolverError:
            continue
        if problem.status == cp.OPTIMAL:
            return
    raise Infeasible(FIT, f"the semidefinite solver ended '{problem.status}'")


def kkt(program: Program, solution: Solution) -> KktResiduals:
    """How well a solution satisfies the optimality conditions of a programme."""
    y, pull = solution.y, np.zeros_like(solution.y)
    slackness, missed = [], [0.0]
    Q = matrices(y, program.links)
    if len(solution.matrices):
        Z = (solution.matrices + solution.matrices.transpose(0, 2, 1)) / 2
        pull[: 10 * program.links] = slopes(Z)
        slack = Q - program.margin * np.eye(4)
        slackness += [abs(float(np.sum(a * b))) for a, b in zip(Z, slack, strict=True)]
        missed.append(float(program.margin - np.linalg.eigvalsh(Q)[:, 0].min()))
    for each, push in zip(program.restrictions, solution.others, strict=True):
        pull += each.G.T @ push
        slackness.append(abs(float(push @ (each.G @ y - each.h))))
        missed.append(each.violation(y))
    size = float(np.linalg.norm(2 * program.A.T @ program.z)) + 1.0
    return KktResiduals(
        float(np.linalg.norm(program.gradient(y) - pull)) / size,
        float(sum(slackness)) / size,
        max(missed),
    )


def fulfillable(program: Program, restrictions: Sequence[Restriction]) -> bool:
    """Whether bodies exist that fulfil restrictions, whatever the data say."""
    p = program.A.shape[1]
    y = cp.Variable(p)
    conditions = [
        cp.reshape(symmetric(10 * k, p) @ y, (4, 4), order="C") >> program.margin * np.eye(4)
        for k in range(program.links)
    ]
    conditions += [r.condition(r.G @ y - r.h) for r in restrictions]
    problem = cp.Problem(cp.Minimize(0), conditions)
    try:
        with warnings.catch_warnings(action="ignore"):
            problem.solve(solver=cp.CLARABEL)
    except cp.SolverError:
        return False
    return problem.status in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE)


def contradiction(program: Program) -> tuple[str, ...]:
    """Names of restrictions that no body fulfils together, none of which can be spared.

    Those without a name always stay. Empty when all can be fulfilled.
    """
    kept = list(program.restrictions)
    if fulfillable(program, kept):
        return ()
    for each in program.restrictions:
        rest = [r for r in kept if r is not each]
        if each.name and not fulfillable(program, rest):
            kept = rest
    return tuple(r.name for r in kept if r.name)
