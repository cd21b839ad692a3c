"""No programme of bodies ends without the optimum, however badly it is scaled."""

from dataclasses import dataclass

import clarabel
import numpy as np
import pytest
import scipy.linalg
import scipy.sparse
from marks import slow

from excitant.identify.knowledge import Box, Knowledge, LinkKnowledge, Quantity, known_rows
from excitant.identify.physical import PhysicalFit, agreement, fit_physical
from excitant.identify.prior import BodyPrior, EffectPrior, link_coordinates, link_weights
from excitant.robots.motion import Array
from excitant.robots.parameters import from_pseudo_inertia, nearest_consistent, pseudo_inertia

PROGRAMMES, BATCHES = 40, 4
FEASIBLE = 1e-12  # least eigenvalue of a pseudo-inertia relative to its norm
KNOWN = 1e-11  # violation of what is known, which would buy something, in units of given bodies
ROUNDING = 1e-15  # of the largest eigenvalue
BETTER = 1e-6  # of the objective: no feasible point is better by more
_CONE = {"nonnegative": clarabel.NonnegativeConeT, "zero": clarabel.ZeroConeT}
UPPER = np.triu_indices(4)
PLACE = {(i, j): n for n, (i, j) in enumerate(zip(*UPPER, strict=True))}


def body(rng: np.random.Generator) -> Array:
    """A body, as it is published: sound, almost without mass, a rod, a sheet."""
    kind, mass = rng.choice(["sound", "sound", "light", "rod", "sheet"]), 10 ** rng.uniform(-1, 1.3)
    root = 0.1 * rng.standard_normal((3, 3))
    spread = {"rod": np.diag([1e-12, 1e-12, 0.01]), "sheet": np.diag([1e-10, 5e-3, 0.01])}
    mass *= 1e-6 if kind == "light" else 1.0
    centre = rng.uniform(-0.3, 0.3, 3)
    P = np.eye(4)
    P[:3, 3] = centre
    P = P @ np.block([[spread.get(kind, root @ root.T), np.zeros((3, 1))], [0, 0, 0, 1]]) @ P.T
    return nearest_consistent(from_pseudo_inertia(mass * P))


@dataclass(frozen=True, eq=False)
class Case:
    """A programme as of `fit_physical`."""

    R: Array
    z: Array
    prior: BodyPrior
    effects: EffectPrior
    knowledge: Knowledge
    what: str

    @property
    def links(self) -> list[str]:
        return [f"link{k}" for k in range(len(self.prior.bodies))]

    def fit(self) -> PhysicalFit:
        return fit_physical(self.R, self.z, self.prior, self.effects, self.knowledge, self.links)


def case(seed: int) -> Case:
    """A programme with what makes solvers fail: scales, collinearity, silence, borders."""
    rng = np.random.default_rng(seed)
    links, e = int(rng.integers(1, 4)), int(rng.integers(0, 6))
    bodies = np.array([body(rng) for _ in range(links)])
    p = 10 * links + e
    m = int(rng.choice([1, 5, p, 3 * p]))
    kind = str(rng.choice(["dense", "deficient", "weak", "silent"]))
    U, s, V = np.linalg.svd(rng.standard_normal((m, p)), full_matrices=False)
    if kind == "deficient":
        s[len(s) // 2 :] *= 10 ** rng.uniform(-14, -5)
    if kind == "weak":
        s *= np.geomspace(1, 10 ** rng.uniform(-12, -3), len(s))
    R = U * s @ V
    if kind == "silent":
        R[:, rng.random(p) < 0.3] = R[rng.random(m) < 0.3] = 0.0
    R *= 10 ** rng.uniform(-6, 6, p) if rng.random() < 0.5 else 1.0
    given = R[:, : 10 * links] @ bodies.ravel()
    R *= 10 ** rng.uniform(-2, 9) / np.sqrt(np.mean(given**2) + 1e-30)
    if e >= 3 and rng.random() < 0.7:  # one column collinear with two others
        R[:, -1] = 1e3 * R[:, -2] + 10 * R[:, -3]
        R[:, -1] += 10 ** rng.uniform(-14, -6) * np.abs(R[:, -2]).max() * rng.standard_normal(m)
    true = (bodies * rng.uniform(0.5, 2, (links, 1))).ravel()
    torque = str(rng.choice(["true", "wrong sign", "zero", "noise", "given"]))
    z = {
        "true": R[:, : 10 * links] @ true,
        "wrong sign": -R[:, : 10 * links] @ true,
        "noise": 10 ** rng.uniform(-3, 4) * rng.standard_normal(m),
        "given": R[:, : 10 * links] @ bodies.ravel(),
        "zero": np.zeros(m),
    }[torque]
    z = z + (torque != "zero") * rng.standard_normal(m)
    size, most = np.sqrt((R[:, 10 * links :] ** 2).mean(axis=0)), np.sqrt((z**2).mean())
    std = np.where((size > 0) & (most > 0), 100 * most / np.where(size > 0, size, 1.0), 1e3)
    std[std == 0] = 1e3
    lower = np.where(rng.random(e) < 0.5, 0.0, -np.inf)
    known, said = knowledge(rng, bodies)
    sigma = [0.05, 1.0, 10.0, np.geomspace(0.05, 10, links), agreement(R, z, bodies)]
    prior = BodyPrior(bodies, sigma[rng.integers(len(sigma))])
    effects = EffectPrior(np.zeros(e), std, lower)
    return Case(R, z, prior, effects, known, f"{seed}: {links} links, {kind}, {torque}, {said}")


def knowledge(rng: np.random.Generator, bodies: Array) -> tuple[Knowledge, str]:
    said = str(rng.choice(["nothing", "mass", "total", "box", "box and mass"]))
    mass, centre = float(bodies[0, 0]), bodies[0, 1:4] / bodies[0, 0]
    off = float(rng.choice([1.0, 1.3, 3.0, 0.2]))
    low, high = centre - 10 ** rng.uniform(-6, -1, 3), centre + 10 ** rng.uniform(-3, -1, 3)
    total = Quantity(float(off * bodies[:, 0].sum()), float(rng.choice([0.0, 0.01])))
    box = Box(low.tolist(), high.tolist())
    first = {
        "mass": LinkKnowledge(mass=Quantity(off * mass)),
        "box": LinkKnowledge(com_box=box),
        "box and mass": LinkKnowledge(mass=Quantity(mass), com_box=box),
    }.get(said)
    return Knowledge(total if said == "total" else None, {"link0": first} if first else {}), said


class Reference:
    """The same programme for another solver: −log det P by a triangle and exponential cones.

    log det Q is the largest Σ t_i with t_i ≤ log Z_ii and [[Q, Z], [Zᵀ, diag Z]] ⪰ 0, Z lower
    triangular (Ben-Tal and Nemirovski 2001). Q is relative to the given body.
    """

    def __init__(self, case: Case) -> None:
        self.case, prior = case, case.prior
        self.n = prior.bodies.size
        roots = np.linalg.cholesky(pseudo_inertia(prior.bodies))
        unit = np.zeros((10, 4, 4))
        unit[np.arange(10), *UPPER] = unit[np.arange(10), UPPER[1], UPPER[0]] = 1.0
        of_bodies = (from_pseudo_inertia(L @ unit @ L.T).T for L in roots)
        self.T = scipy.linalg.block_diag(*of_bodies)
        metric = np.linalg.inv(link_coordinates(prior.bodies))
        distance = link_weights(len(roots), prior.sigma)[:, None] * metric
        known = case.effects
        C, d, self.cones = known_rows(case.knowledge, case.links)
        e = len(known.mean)
        self.units = np.sqrt(len(case.z) / ((case.R[:, self.n :] ** 2).sum(0) + known.std**-2.0))
        T = scipy.linalg.block_diag(self.T, np.diag(self.units))
        block = scipy.linalg.block_diag(distance @ self.T, np.diag(self.units / known.std))
        self.rows = np.vstack([case.R @ T, np.hstack([C @ self.T, np.zeros((len(C), e))]), block])
        means = distance @ prior.bodies.ravel(), known.mean / known.std
        self.goal = np.concatenate([case.z, d, *means])
        self.draws = np.minimum(1.0, np.broadcast_to(prior.sigma, (len(roots),)) ** -2.0)

    def coordinates(self, x: Array) -> Array:
        return np.concatenate([np.linalg.solve(self.T, x[: self.n]), x[self.n :] / self.units])

    def missed(self, y: Array) -> float:
        """By how much what is known is missed, in units of the given bodies."""
        phi = self.T @ y[: self.n]
        units = (np.linalg.norm(r.G @ self.T, axis=1).max() for r in self.cones)
        missed = [r.violation(phi) / unit for r, unit in zip(self.cones, units, strict=True)]
        return max(missed, default=0.0)

    def value(self, y: Array, allowed: float) -> float:
        """The objective; infinite where a body or a bound is missed, or what is known by more."""
        Q = np.zeros((len(self.draws), 4, 4))
        Q[:, *UPPER] = Q[:, UPPER[1], UPPER[0]] = y[: self.n].reshape(-1, 10)
        theta, sizes = self.units * y[self.n :], np.linalg.eigvalsh(Q)
        inside = (sizes[:, 0] >= -ROUNDING * sizes[:, -1]).all()
        if not inside or (theta < self.case.effects.lower).any() or self.missed(y) > allowed:
            return np.inf
        sizes = np.maximum(sizes, ROUNDING * sizes[:, -1:])
        entropy = (sizes - np.log(sizes)).sum(axis=1)
        return float(((self.rows @ y - self.goal) ** 2).sum() + self.draws @ entropy)

    def solved(self) -> tuple[Array, bool]:
        """Coordinates of the solution, and whether the solver holds it for one."""
        links, p = len(self.draws), self.rows.shape[1]
        total = p + 14 * links
        A, b, cones = [np.zeros((0, total))], [np.zeros(0)], []

        def add(rows: Array, right: Array, cone: object) -> None:
            A.append(-rows)
            b.append(right)
            cones.append(cone)

        diagonal = [PLACE[i, i] for i in range(4)]
        columns = [(i, j) for j in range(8) for i in range(j + 1)]  # of the upper triangle
        for k in range(links):
            Z, t = p + 14 * k, p + 14 * k + 10
            rows = np.zeros((36, total))
            for r, (i, j) in enumerate(columns):
                weight = 1.0 if i == j else np.sqrt(2.0)
                if j < 4:
                    rows[r, 10 * k + PLACE[i, j]] = weight
                elif i >= 4 and i == j:
                    rows[r, Z + diagonal[i - 4]] = 1.0
                elif i < 4 and j - 4 <= i:  # Z_ij, i ≥ j, is kept at (j, i)
                    rows[r, Z + PLACE[j - 4, i]] = weight
            add(rows, np.zeros(36), clarabel.PSDTriangleConeT(8))
            for n, at in enumerate(diagonal):
                rows = np.zeros((3, total))
                rows[0, t + n] = rows[2, Z + at] = 1.0
                add(rows, np.array([0.0, 1.0, 0.0]), clarabel.ExponentialConeT())
        bounded = np.isfinite(self.case.effects.lower)
        if bounded.any():
            rows = np.eye(p, total)[self.n :][bounded]
            add(rows, np.zeros(len(rows)), clarabel.NonnegativeConeT(len(rows)))
        for r in self.cones:
            rows = np.zeros((len(r.h), total))
            rows[:, : self.n] = r.G @ self.T
            size = np.linalg.norm(rows, axis=1).max()
            add(rows / size, -r.h / size, _CONE[r.cone](len(r.h)))
        root = np.linalg.qr(np.column_stack([self.rows, self.goal]), mode="r")[:p]
        size = max(1.0, float(np.abs(root[:, :-1]).max()))
        P, c = np.zeros((total, total)), np.zeros(total)
        P[:p, :p] = 2 * root[:, :-1].T @ root[:, :-1] / size
        c[:p] = -2 * root[:, :-1].T @ root[:, -1] / size
        for k, n in enumerate(self.draws):
            c[[10 * k + at for at in diagonal]] += n / size
            c[p + 14 * k + 10 : p + 14 * k + 14] = -n / size
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        solver = clarabel.DefaultSolver(
            scipy.sparse.csc_matrix(np.triu(P)), c, scipy.sparse.csc_matrix(np.vstack(A)),
            np.concatenate(b), cones, settings,
        )  # fmt: skip
        found = solver.solve()
        return np.array(found.x)[:p], str(found.status) == "Solved"


@pytest.mark.parametrize("batch", [0, *(slow(k) for k in range(1, BATCHES))])
@pytest.mark.filterwarnings("error")
def test_every_programme_ends_at_its_optimum(batch: int) -> None:
    """Inside every restriction, and not worse than what a general conic solver finds."""
    agreed = 0
    for seed in range(batch, PROGRAMMES, BATCHES):
        programme = case(seed)
        fit = programme.fit()
        bodies = pseudo_inertia(fit.x[: programme.prior.bodies.size].reshape(-1, 10))
        least = np.linalg.eigvalsh(bodies)[:, 0] / np.linalg.norm(bodies, axis=(1, 2))
        assert least.min() >= -FEASIBLE, programme.what
        assert np.isfinite(fit.covariance).all(), programme.what
        assert not fit.note, programme.what
        other = Reference(programme)
        mine, (theirs, solved) = other.coordinates(fit.x), other.solved()
        assert other.missed(mine) <= 1e-8, programme.what
        allowed = max(KNOWN, other.missed(mine))
        best = other.value(mine, allowed)
        # the objective is convex: along the way to a better point it falls at once
        for share in (1.0, 0.5, 0.1, 1e-2, 1e-4):
            there = other.value(mine + share * (theirs - mine), allowed)
            assert there >= best - BETTER * abs(best), (programme.what, share)
        agreed += solved and abs(other.value(theirs, KNOWN) - best) <= 1e-3 * abs(best)
    assert agreed >= 3  # the other solver is worth being asked
