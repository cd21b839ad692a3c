"""Least squares over bodies that can exist: the convex programme, its solver and its judge.

The unknowns y begin with the coordinates of the links (`excitant.identify.prior`). The minimum of

    f(y) = ‖A y − z‖² + ‖C y − d‖² − 2 log p(P(y)),   y restricted,

is reached along its central path (Nesterov and Nemirovskii 1994): −μ log of every determinant and
slack is added, and μ falls. A step of Newton's method is linear least squares, solved by a QR
factorisation, so that the condition number of the data counts once and not squared. Along a step
the slope of the objective is a sum of simple fractions without cancellation, and the step ends at
its zero. The end lies within √(ν μ) posterior standard deviations of the minimum, ν the number of
logarithms, whatever the scales of data, prior and restrictions are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import clarabel
import numpy as np
import scipy

from excitant.exceptions import Infeasible
from excitant.identify.prior import NORMS, UPPER, BodyPrior, matrices, relative_rows
from excitant.robots.motion import Array
from excitant.robots.parameters import pseudo_inertia

_COLUMNS = np.lexsort(UPPER)  # the conic solver takes the triangle column by column
_CONES = {
    "nonnegative": clarabel.NonnegativeConeT,
    "zero": clarabel.ZeroConeT,
    "second_order": clarabel.SecondOrderConeT,
    "semidefinite": lambda _: clarabel.PSDTriangleConeT(4),
}
_SOLVED = ("Solved", "AlmostSolved")  # states of the conic solver with a solution
_MARGINS = (1e-2, 1e-4, 1e-6)  # of a point inside all restrictions, in their units
_LEAST = 1e-10  # μ at the end: within 1e-4 standard deviations of the minimum
_FALL = 0.1  # of μ
# of μ: the decrement λ² from which Newton's method converges quadratically
_CENTRED = 0.1
_SETTLED = 1e-6  # decrement λ at the end, in standard deviations; the error is about its square
_STEPS = 60  # of Newton's method for one μ
_PRECISE = 1e-2  # posterior standard deviations from the minimum, or
_NEAR = 1e-4  # this part of the way from the start
_BORDER = 1e-9  # of the way to where a body or a slack vanishes
_ROUNDING = 1e-10  # of the largest force of a restriction


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


def possible(bodies: BodyPrior, p: int, margin: float) -> tuple[Restriction, ...]:
    """No link is less than a part of what is given, in any direction; y has p coordinates."""
    h = margin * np.eye(4)[UPPER]
    T = bodies.T
    rows = np.zeros((len(bodies.bodies), 10, p))
    for k, own in enumerate(relative_rows(bodies.bodies)):
        rows[k, :, : len(T)] = own @ T[10 * k : 10 * k + 10]
    return tuple(
        Restriction("semidefinite", each[_COLUMNS], h[_COLUMNS]) for each in rows
    )


@dataclass(frozen=True, eq=False)
class Program:
    """min ‖A y − z‖² + ‖C y − d‖² − 2 log p(bodies), y restricted.

    Data have shape (m, p), what is known of y beside the prior of the bodies (c, p).
    """

    A: Array
    z: Array
    C: Array
    d: Array
    bodies: BodyPrior
    restrictions: tuple[Restriction, ...]

    def prior(self, y: Array, barrier: float = 0.0) -> tuple[Array, Array]:
        """Rows J and r, ‖r + J dy‖² being the objective without data to second order at y.

        The distance of the bodies comes first, then their entropic distance, to which a barrier
        adds so many times −log det P of every link, then what else is known.
        """
        T = self.bodies.T
        residual, J = self.bodies.quadratic(T @ y[: len(T)], barrier)
        rows = np.pad(J @ T, ((0, 0), (0, len(y) - len(T))))
        return np.vstack([rows, self.C]), np.concatenate(
            [residual, self.C @ y - self.d]
        )

    def gradient(self, y: Array) -> Array:
        """Gradient of the objective, shape (p,)."""
        J, residual = self.prior(y)
        return np.asarray(
            2 * (self.A.T @ (self.A @ y - self.z) + J.T @ residual), float
        )


@dataclass(frozen=True)
class KktResiduals:
    """Gradient of the Lagrangian and multipliers times slacks, relative; violation, absolute."""

    stationarity: float
    complementarity: float
    primal: float


@dataclass(frozen=True, eq=False)
class Solution:
    """Minimiser y, shape (p,), with one array of multipliers per restriction.

    The error is the distance to the minimum in posterior standard deviations; it is settled where
    this is nothing beside what the data leave unexplained, or beside the way from the start.
    """

    y: Array
    multipliers: tuple[Array, ...]
    error: float
    settled: bool

    def kkt(self, program: Program) -> KktResiduals:
        """Residuals of the optimality conditions."""
        pairs = list(zip(program.restrictions, self.multipliers, strict=True))
        pull = sum((r.G.T @ push for r, push in pairs), np.zeros_like(self.y))
        slackness = sum(abs(float(push @ r.slack(self.y))) for r, push in pairs)
        size = float(np.linalg.norm(2 * program.A.T @ program.z)) + 1.0
        return KktResiduals(
            float(np.linalg.norm(program.gradient(self.y) - pull)) / size,
            slackness / size,
            max([0.0, *(r.violation(self.y) for r in program.restrictions)]),
        )


def solve(program: Program, centre: Array) -> Solution:
    """Minimiser and multipliers, on the way from the given bodies or close by; centre is (p,).

    Where floating point ends before the path does, its last point that Newton's method reached is
    the answer: inside all restrictions, with an error that is known.

    Raises:
        Infeasible: Restrictions that leave no room.
    """
    y = start = interior(program, centre)
    path = _CentralPath(program, start)
    barrier = max(1.0, path.squares(y) / path.logarithms)
    reached = y
    least = barrier
    error = np.inf
    while True:
        y, decrement = path.centred(y, barrier)
        if decrement <= np.sqrt(barrier) or not np.isfinite(error):
            reached = y
            least = barrier
            error = decrement + np.sqrt(path.logarithms * barrier)
        else:
            break
        if barrier <= _LEAST:
            break
        barrier = max(_FALL * barrier, _LEAST)
    unexplained = np.sqrt(max(1.0, path.squares(reached) / len(reached)))
    way = float(np.linalg.norm(path.U @ (reached - start)))
    settled = bool(error <= max(_PRECISE * unexplained, _NEAR * way))
    return Solution(reached, path.multipliers(reached, least), float(error), settled)


class _CentralPath:
    """Newton's method on the objective of a programme with logarithmic barriers."""

    def __init__(self, program: Program, start: Array) -> None:
        self.program = program
        self.bodies = program.bodies
        self.cones = [r for r in program.restrictions if r.cone != "zero"]
        self.exact = _equalities(program.restrictions, len(start))
        self.links = len(self.bodies.bodies)
        self.orders = [2 if r.cone == "second_order" else len(r.h) for r in self.cones]
        self.logarithms = 4 * self.links + sum(self.orders)
        J, residual = program.prior(start)
        fixed = np.r_[
            : 10 * self.links, 20 * self.links : len(J)
        ]  # rows that do not change
        rows = np.vstack([program.A, J[fixed]])
        goal = np.concatenate([program.z, J[fixed] @ start - residual[fixed]])
        both = np.asarray(np.linalg.qr(np.column_stack([rows, goal]), mode="r"), float)
        self.U, self.t = both[: len(start), :-1], both[: len(start), -1]
        self.N = (
            scipy.linalg.null_space(self.exact)
            if len(self.exact)
            else np.eye(len(start))
        )
        self.Q, self.R = np.linalg.qr(self.U @ self.N)

    def squares(self, y: Array) -> float:
        """The objective but for the entropic distance and a constant."""
        return float(np.sum((self.U @ y - self.t) ** 2))

    def centred(self, y: Array, barrier: float) -> tuple[Array, float]:
        """Minimiser of the objective with barriers, from inside, and the last decrement λ."""
        enough = np.sqrt(_CENTRED * barrier)
        decrement = np.inf
        for _ in range(_STEPS):
            step, decrement, length = self._newton(y, barrier)
            while not self._inside(y + length * step):  # for rounding
                length /= 2
            y = y + length * step
            if decrement <= (_SETTLED if barrier <= _LEAST else enough):
                break
        exact = _equal(y, self.program.restrictions)
        return exact if self._inside(exact) else y, decrement

    def multipliers(self, y: Array, barrier: float) -> tuple[Array, ...]:
        """Forces of the restrictions: along the slopes of the logarithms, in equilibrium."""
        pushes = [barrier * _logarithm(r, y)[2] for r in self.cones]
        # a slack as small as rounding has the right direction and a rough size
        parts = [
            np.diag(push) if r.cone == "nonnegative" else push[:, None]
            for r, push in zip(self.cones, pushes, strict=True)
        ]
        forces = [r.G.T @ part for r, part in zip(self.cones, parts, strict=True)]
        both = np.hstack([self.exact.T, *forces])
        left = self.program.gradient(y) - sum(force.sum(axis=1) for force in forces)
        size = np.linalg.lstsq(both, left, rcond=_ROUNDING)[0]
        exact = size[: len(self.exact)]
        size = 1 + size[len(self.exact) :]
        found = dict[int, Array]()
        for r, part in zip(self.cones, parts, strict=True):
            found[id(r)] = part @ size[: part.shape[1]]
            size = size[part.shape[1] :]
        for r in self.program.restrictions:
            if r.cone == "zero":
                found[id(r)], exact = exact[: len(r.h)], exact[len(r.h) :]
        return tuple(found[id(r)] for r in self.program.restrictions)

    def _inside(self, y: Array) -> bool:
        try:
            np.linalg.cholesky(
                pseudo_inertia((self.bodies.T @ y[: 10 * self.links]).reshape(-1, 10))
            )
        except np.linalg.LinAlgError:
            return False
        return all(r.violation(y) < 0 for r in self.cones)

    def _newton(self, y: Array, barrier: float) -> tuple[Array, float, float]:
        """Newton's step, its decrement λ, and the part of it after which the objective rises."""
        curved = slice(10 * self.links, 20 * self.links)
        J, residual = (part[curved] for part in self.program.prior(y, barrier))
        logarithms = [_logarithm(r, y) for r in self.cones]
        scale = np.sqrt(barrier / 2)
        rows = np.vstack([J, *(scale * B for B, _, _ in logarithms)])
        goal = np.concatenate([-residual, *(scale * g for _, g, _ in logarithms)])
        step = self.N @ _least_squares(
            self.R, self.Q.T @ (self.t - self.U @ y), rows @ self.N, goal
        )
        weight = self.bodies.draws + barrier
        S = matrices(
            (J @ step).reshape(-1, 10) / NORMS / np.sqrt(weight / 2)[:, None],
            self.links,
        )
        rates = [
            np.linalg.eigvalsh(S).ravel(),
            *(_rates(r, y, step) for r in self.cones),
        ]
        weights = np.repeat(
            [*weight, *[barrier] * len(self.cones)], [*[4] * self.links, *self.orders]
        )
        square = 2 * float(np.sum((self.U @ step) ** 2))
        return step, *_length(square, weights, np.concatenate(rates))


def _least_squares(R: Array, goal: Array, rows: Array, further: Array) -> Array:
    """Minimiser of ‖R d − goal‖² + ‖rows d − further‖²."""
    p = len(R)
    both = np.vstack([np.column_stack([R, goal]), np.column_stack([rows, further])])
    factor = np.asarray(np.linalg.qr(both, mode="r"), float)
    found: Array = scipy.linalg.solve_triangular(factor[:p, :p], factor[:p, p])
    return found


def _length(square: float, weights: Array, rates: Array) -> tuple[float, float]:
    """Decrement λ of a step and where on it ½ a² square − Σ w log(1 + a s) − a slope is least.

    The slope is λ² = square + Σ w s², as the step is Newton's, so that its derivative at a is
    a (square + Σ w s² / (1 + a s)) − λ².
    """
    curvature = weights * rates**2
    slope = square + float(curvature.sum())

    def rise(a: float) -> float:
        return a * (square + float((curvature / (1 + a * rates)).sum())) - slope

    end = -(1 - _BORDER) / min(float(rates.min()), -1e-9)
    if slope > 0 and rise(end) > 0:
        end = scipy.optimize.brentq(rise, 0.0, end, rtol=1e-6)
    return float(np.sqrt(slope)), float(end)


def _logarithm(restriction: Restriction, y: Array) -> tuple[Array, Array, Array]:
    """Rows B and g, ½ ‖B d − g‖² being −Σ log of the slacks at y + d, and the slopes of Σ log."""
    slack = restriction.slack(y)
    if restriction.cone == "nonnegative":
        return restriction.G / slack[:, None], np.ones_like(slack), 1 / slack
    # the root of its Hessian 2 (2 w wᵀ − J) / s², w = J slack / s, is √2 (2 v vᵀ − J) / s
    s = _size(slack)
    mirror = np.array([1.0, *-np.ones(len(slack) - 1)])
    w = mirror * slack / s
    unit = np.eye(len(slack))[0]
    v = (w + unit) / np.sqrt(2 * (w[0] + 1))
    root = np.sqrt(2) / s * (2 * np.outer(v, v) - np.diag(mirror))
    return root @ restriction.G, np.sqrt(2) * unit, 2 * w / s


def _size(slack: Array) -> float:
    """√(s₀² − s₁² − …) of a slack in the second-order cone."""
    rest = float(np.linalg.norm(slack[1:]))
    return float(np.sqrt((slack[0] - rest) * (slack[0] + rest)))


def _rates(restriction: Restriction, y: Array, step: Array) -> Array:
    """Rates s at which slacks change along a step, as Π (1 + a s) of what they are at y."""
    slack = restriction.slack(y)
    change = restriction.G @ step
    if restriction.cone == "nonnegative":
        return np.asarray(change / slack, float)
    w = slack / _size(slack)
    root = change / _size(slack)
    half = w[0] * root[0] - float(w[1:] @ root[1:])
    product = root[0] ** 2 - float(root[1:] @ root[1:])
    spread = np.sqrt(max(half**2 - product, 0.0))
    return np.array([half - spread, half + spread])


def interior(program: Program, centre: Array) -> Array:
    """A point inside all restrictions, the nearest to the centre but for a margin, shape (p,).

    Raises:
        Infeasible: There is none.
    """
    p = len(centre)
    restrictions = program.restrictions
    for margin in (0.0, *_MARGINS):
        bodies = possible(program.bodies, p, margin)
        y = centre
        if margin:
            near = _nearest([*bodies, *_narrowed(restrictions, margin)], centre)
            if near is None:
                continue
            y = near
        y = _equal(y, restrictions)
        if all(
            r.violation(y) < 0 for r in (*bodies, *restrictions) if r.cone != "zero"
        ):
            return np.asarray(y, float)
    raise Infeasible(
        "physically consistent fit",
        "what is known of the bodies leaves no room; widen it",
    )


def _narrowed(restrictions: Sequence[Restriction], margin: float) -> list[Restriction]:
    """The restrictions with slacks of at least a margin."""
    found = []
    for r in restrictions:
        least = np.zeros_like(r.h)
        least[: 1 if r.cone == "second_order" else None] = (
            0.0 if r.cone == "zero" else margin
        )
        found.append(replace(r, h=r.h + least))
    return found


def _equalities(restrictions: Sequence[Restriction], p: int) -> Array:
    """Rows of what holds exactly, shape (k, p)."""
    return np.vstack(
        [np.zeros((0, p)), *(r.G for r in restrictions if r.cone == "zero")]
    )


def _equal(y: Array, restrictions: Sequence[Restriction]) -> Array:
    """The nearest point at which what holds exactly does, shape (p,)."""
    G = _equalities(restrictions, len(y))
    h = np.concatenate([np.zeros(0), *(r.h for r in restrictions if r.cone == "zero")])
    return np.asarray(y - np.linalg.pinv(G) @ (G @ y - h), float)


def _nearest(restrictions: Sequence[Restriction], centre: Array) -> Array | None:
    """The point nearest to a centre, shape (p,), that fulfils restrictions; None without any."""
    P = scipy.sparse.identity(len(centre), format="csc")
    A = scipy.sparse.csc_matrix(-np.vstack([r.G for r in restrictions]))
    b = np.concatenate([r.slack(centre) for r in restrictions])
    cones = [_CONES[r.cone](len(r.h)) for r in restrictions]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    found = clarabel.DefaultSolver(
        P, np.zeros(len(centre)), A, b, cones, settings
    ).solve()
    return centre + np.array(found.x) if str(found.status) in _SOLVED else None


def contradiction(restrictions: Sequence[Restriction]) -> tuple[str, ...]:
    """Names of restrictions that no y fulfils together, none of which can be spared, if any.

    Those without a name always stay.
    """
    kept = list(restrictions)
    nowhere = np.zeros(restrictions[0].G.shape[1])
    if _nearest(kept, nowhere) is not None:
        return ()
    for each in restrictions:
        rest = [r for r in kept if r is not each]
        if each.name and _nearest(rest, nowhere) is None:
            kept = rest
    return tuple(r.name for r in kept if r.name)
