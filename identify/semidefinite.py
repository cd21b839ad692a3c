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

from collections.abc import Sequence
from dataclasses import dataclass, replace

import clarabel
import numpy as np
import scipy

from excitant.exceptions import Infeasible
from excitant.identify.prior import NORMS, UPPER, BodyPrior, matrices, relative_rows
from excitant.identify.regression import triangle
from excitant.robots.motion import Array
from excitant.robots.parameters import pseudo_inertia

_COLUMNS = np.lexsort(UPPER)  # the conic solver takes the triangle column by column
_CONES = {
    "nonnegative": clarabel.NonnegativeConeT,
    "zero": clarabel.ZeroConeT,
    "semidefinite": lambda _: clarabel.PSDTriangleConeT(4),
}


@dataclass(frozen=True)
class PathSettings:
    """Settings of the central path, whose barriers have the weight μ.

    Attributes:
        margins: Slacks of an interior point that are tried, in the units of restrictions.
        least: μ at the end: within 1e-4 standard deviations of the minimum.
        fall: Factor by which μ falls.
        centred: Newton's method ends where its squared decrement λ² is at most this times μ, from
            where it converges quadratically;
        settled: at the least μ where λ is at most this, in standard deviations; the error is about
            its square.
        steps: Largest number of Newton steps for one μ.
        precise: Error of a settled solution, in posterior standard deviations, or
        near: as a share of the way from the start.
        border: Share of the way to a vanishing body or slack that a step leaves.
    """

    margins: tuple[float, ...] = (1e-2, 1e-4, 1e-6)
    least: float = 1e-10
    fall: float = 0.1
    centred: float = 0.1
    settled: float = 1e-6
    steps: int = 60
    precise: float = 1e-2
    near: float = 1e-4
    border: float = 1e-9


PATH = PathSettings()


@dataclass(frozen=True, eq=False)
class Restriction:
    """G y − h, shape (m,), lies in a cone; the name is for contradictions.

    Cones: ``"nonnegative"``, ``"zero"`` or ``"semidefinite"`` (triangle of a 4×4 matrix,
    off-diagonal terms times √2, shape (10,)).
    """

    cone: str
    G: Array
    h: Array
    name: str = ""

    def slack(self, y: Array) -> Array:
        """G y − h, shape (m,)."""
        return self.G @ y - self.h

    def violation(self, y: Array) -> float:
        """Constraint violation in the units of h; negative if slack."""
        slack = self.slack(y)
        if self.cone == "semidefinite":
            triangle = np.empty(10)
            triangle[_COLUMNS] = slack
            return -float(np.linalg.eigvalsh(matrices(triangle / NORMS, 1))[0, 0])
        return float(np.abs(slack).max() if self.cone == "zero" else -slack.min())


def possible(bodies: BodyPrior, p: int, margin: float) -> tuple[Restriction, ...]:
    """No link is less than a share of the nominal one, in any direction; y has p coordinates."""
    h = (margin * np.eye(4)[UPPER])[_COLUMNS]
    restrictions = []
    roots = np.asarray(np.linalg.cholesky(pseudo_inertia(bodies.bodies)), float)
    for k, rows in enumerate(relative_rows(roots)):
        link = slice(10 * k, 10 * k + 10)
        G = np.zeros((10, p))
        G[:, link] = (rows @ bodies.T[link, link])[_COLUMNS]
        restrictions.append(Restriction("semidefinite", G, h))
    return tuple(restrictions)


@dataclass(frozen=True, eq=False)
class Program:
    """min ‖A y − z‖² + ‖C y − d‖² − 2 log p(bodies), y restricted by halfspaces and planes.

    Data have shape (m, p), what is known of y beside the prior of the bodies (c, p).
    """

    A: Array
    z: Array
    C: Array
    d: Array
    bodies: BodyPrior
    restrictions: tuple[Restriction, ...]

    def prior(self, y: Array) -> tuple[Array, Array]:
        """Rows J and r, ‖r + J dy‖² being the objective without data to second order at y.

        The distance of the bodies comes first, then their entropic distance, then what else is
        known.
        """
        T = self.bodies.T
        residual, J = self.bodies.quadratic(T @ y[: len(T)])
        rows = np.pad(J @ T, ((0, 0), (0, len(y) - len(T))))
        deviation = self.C @ y - self.d
        return np.vstack([rows, self.C]), np.concatenate([residual, deviation])


@dataclass(frozen=True, eq=False)
class Solution:
    """Minimiser y, shape (p,).

    The error is the distance to the minimum in posterior standard deviations; it is settled where
    this is nothing beside what the data leave unexplained, or beside the way from the start.
    """

    y: Array
    error: float
    settled: bool


def solve(program: Program, centre: Array) -> Solution:
    """Minimiser, on the way from the given bodies or close by; centre is (p,).

    Where floating point ends before the path does, its last point that Newton's method reached is
    the answer: inside all restrictions, with an error that is known.

    Raises:
        Infeasible: Restrictions that leave no room.
    """
    start = interior(program, centre)
    path = _CentralPath(program, start)
    barrier = max(1.0, path.squares(start) / path.logarithms)
    guess = start
    solution = start
    error = np.inf
    while True:
        y, decrement = path.centred(guess, barrier)
        if decrement > np.sqrt(barrier) and np.isfinite(error):
            break
        # as far as μ falls: the path is smooth in it
        onward = (y - solution) * PATH.fall
        guess = y + onward if np.isfinite(error) and path.inside(y + onward) else y
        solution = y
        error = float(decrement + np.sqrt(path.logarithms * barrier))
        if barrier <= PATH.least:
            break
        barrier = max(PATH.fall * barrier, PATH.least)
    unexplained = np.sqrt(max(1.0, path.squares(solution) / len(solution)))
    way = float(np.linalg.norm(path.U @ (solution - start)))
    settled = error <= max(PATH.precise * unexplained, PATH.near * way)
    return Solution(solution, error, bool(settled))


class _CentralPath:
    """Newton's method on the objective of a programme with logarithmic barriers."""

    def __init__(self, program: Program, start: Array) -> None:
        self.program = program
        self.bodies = program.bodies
        self.bounds = together(program.restrictions, "nonnegative", len(start))
        self.links = len(self.bodies.bodies)
        self.logarithms = 4 * self.links + len(self.bounds.h)
        J, residual = program.prior(start)
        # rows of the quadratic part, which do not change
        fixed = np.r_[: 10 * self.links, 20 * self.links : len(J)]
        A = np.vstack([program.A, J[fixed]])
        z = np.concatenate([program.z, J[fixed] @ start - residual[fixed]])
        R = triangle(np.column_stack([A, z]))[: len(start)]
        self.U = R[:, :-1]
        self.t = R[:, -1]
        self.N = free_directions(program.restrictions, len(start))
        self.Q, self.R = np.linalg.qr(self.U @ self.N)
        T = self.bodies.T
        # φ of each link by the free directions
        self.moved = (T @ self.N[: len(T)]).reshape(self.links, 10, -1)

    def squares(self, y: Array) -> float:
        """The objective but for the entropic distance and a constant."""
        return float(np.sum((self.U @ y - self.t) ** 2))

    def centred(self, y: Array, barrier: float) -> tuple[Array, float]:
        """Minimiser of the objective with barriers, from inside, and the last decrement λ."""
        enough = np.sqrt(PATH.centred * barrier)
        if barrier <= PATH.least:
            enough = PATH.settled
        for _ in range(PATH.steps):
            step, decrement, length = self._newton(y, barrier)
            while not self.inside(y + length * step):  # for rounding
                length /= 2
            y = y + length * step
            if decrement <= enough:
                break
        exact = _equal(y, self.program.restrictions)
        return exact if self.inside(exact) else y, decrement

    def inside(self, y: Array) -> bool:
        """Whether every body and every slack is positive."""
        phi = self.bodies.T @ y[: 10 * self.links]
        try:
            np.linalg.cholesky(pseudo_inertia(phi.reshape(-1, 10)))
        except np.linalg.LinAlgError:
            return False
        return bool((self.bounds.slack(y) > 0).all())

    def _newton(self, y: Array, barrier: float) -> tuple[Array, float, float]:
        """Newton's step, its decrement λ, and the part of it after which the objective rises."""
        T = self.bodies.T
        residual, rows = self.bodies.entropic(T @ y[: len(T)], barrier)
        J = (rows @ self.moved).reshape(len(T), -1)
        # ½ ‖B d − 1‖² is −Σ log of the slacks at y + d to second order
        B = self.bounds.G / self.bounds.slack(y)[:, None]
        scale = np.sqrt(barrier / 2)
        p = len(self.R)
        # rows of the barriers below a triangle, to be one again
        above = np.zeros((p + 1, p + 1))
        above[:p, :p] = self.R
        above[:p, p] = self.Q.T @ (self.t - self.U @ y)
        goal = np.append(-residual, np.full(len(B), scale))
        below = np.column_stack([np.vstack([J, scale * B @ self.N]), goal])
        factor = scipy.linalg.lapack.dtpqrt(0, 8, above, below)[0]
        free, _ = scipy.linalg.lapack.dtrtrs(factor[:p, :p], factor[:p, p])
        step = self.N @ free
        weight = self.bodies.draws + barrier
        unit = NORMS * np.sqrt(weight / 2)[:, None]
        change = matrices((J @ free).reshape(-1, 10) / unit, self.links)
        rates = np.append(np.linalg.eigvalsh(change), B @ step)
        weights = np.append(np.repeat(weight, 4), np.full(len(B), barrier))
        square = 2 * float(np.sum((self.U @ step) ** 2))
        return step, *_length(square, weights, rates)


def _length(square: float, weights: Array, rates: Array) -> tuple[float, float]:
    """Decrement λ of a step and where on it ½ a² square − Σ w log(1 + a s) − a slope is least.

    The slope is λ² = square + Σ w s², as the step is Newton's, so that its derivative at a is
    a (square + Σ w s² / (1 + a s)) − λ².
    """
    curvature = weights * rates**2
    slope = square + float(curvature.sum())

    def rise(a: float) -> float:
        return a * (square + float((curvature / (1 + a * rates)).sum())) - slope

    end = -(1 - PATH.border) / min(float(rates.min()), -1e-9)
    if slope > 0 and rise(end) > 0:
        end = scipy.optimize.brentq(rise, 0.0, end, rtol=1e-6)
    return float(np.sqrt(slope)), float(end)


def interior(program: Program, centre: Array) -> Array:
    """A point inside all restrictions, the nearest to the centre but for a margin, shape (p,).

    Raises:
        Infeasible: There is none.
    """
    p = len(centre)
    restrictions = program.restrictions
    bounds = together(restrictions, "nonnegative", p)
    # the nearest where each bounds one coordinate
    missing = np.maximum(PATH.margins[0] - bounds.slack(centre), 0.0)
    for margin in (0.0, *PATH.margins):
        bodies = possible(program.bodies, p, margin)
        near: Array | None = centre + bounds.G.T @ missing
        if margin:
            narrowed = [
                replace(r, h=r.h + margin * (r.cone != "zero"))
                for r in restrictions
            ]
            near = _nearest([*bodies, *narrowed], centre)
        if near is None:
            continue
        y = _equal(near, restrictions)
        open_cones = [r for r in (*bodies, *restrictions) if r.cone != "zero"]
        if all(r.violation(y) < 0 for r in open_cones):
            return y
    raise Infeasible(
        "physically consistent fit",
        "what is known of the bodies leaves no room; widen it",
    )


def together(restrictions: Sequence[Restriction], cone: str, p: int) -> Restriction:
    """All restrictions of a cone as one; without rows where there are none."""
    own = [r for r in restrictions if r.cone == cone]
    G = np.vstack([np.zeros((0, p)), *(r.G for r in own)])
    return Restriction(cone, G, np.concatenate([np.zeros(0), *(r.h for r in own)]))


def free_directions(restrictions: Sequence[Restriction], p: int) -> Array:
    """Orthonormal directions of y in which nothing holds exactly, shape (p, free)."""
    return scipy.linalg.null_space(together(restrictions, "zero", p).G)


def _equal(y: Array, restrictions: Sequence[Restriction]) -> Array:
    """The nearest point at which what holds exactly does, shape (p,)."""
    exact = together(restrictions, "zero", len(y))
    return y - np.linalg.pinv(exact.G) @ exact.slack(y)


def _nearest(restrictions: Sequence[Restriction], centre: Array) -> Array | None:
    """The point nearest to a centre, shape (p,), that fulfils restrictions; None without any."""
    p = len(centre)
    A = -np.vstack([r.G for r in restrictions])
    b = np.concatenate([r.slack(centre) for r in restrictions])
    cones = [_CONES[r.cone](len(r.h)) for r in restrictions]
    sparse = scipy.sparse.csc_matrix
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    problem = sparse(np.eye(p)), np.zeros(p), sparse(A), b, cones, settings
    solution = clarabel.DefaultSolver(*problem).solve()
    solved = str(solution.status) in ("Solved", "AlmostSolved")
    return centre + np.array(solution.x) if solved else None


def contradiction(restrictions: Sequence[Restriction]) -> tuple[str, ...]:
    """Names of restrictions that no y fulfils together, none of which can be spared, if any.

    Those without a name always stay.
    """
    needed = list(restrictions)
    origin = np.zeros(restrictions[0].G.shape[1])
    if _nearest(needed, origin) is not None:
        return ()
    for restriction in restrictions:
        rest = [r for r in needed if r is not restriction]
        if restriction.name and _nearest(rest, origin) is None:
            needed = rest
    return tuple(r.name for r in needed if r.name)
