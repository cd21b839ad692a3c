"""Evidence for candidate causes: how much better they explain the data.

The residual of the given model is r = N η + C θ + e. The nuisance N η is the error of the given
model's own values within their tolerance, η ~ N(0, tolerance²); a candidate adds columns C with
coefficients θ that only the data decide; e is noise with one level per joint. For a set S of
candidates

    J(S) = min over η, θ_S of  ‖r − N η − C_S θ_S‖²_Λ + ‖η‖²_prior.

A candidate of k columns that is not present lowers J by λ χ²_k; residuals are far from white, so λ
is estimated from sums of its score over blocks of time (Rao and Scott 1984). Given values are taken
as correct to ±10 %, or as the median of their deviations says (empirical Bayes), up to 80 %, for
published inertias are rough, and so is friction from a data sheet; noise is what bodies and usual
effects leave when free.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy

from excitant.analysis.thresholds import EVIDENCE, SELECTION
from excitant.identify.least_squares import autocorrelation_time, believed
from excitant.identify.prior import placeholder_links
from excitant.identify.regression import Regression, weighted
from excitant.robots.effects import Effect
from excitant.robots.motion import Array, Indices, frozen
from excitant.robots.robot import Robot

Key = tuple[str, tuple[str, ...]]
"""Effect and joints."""

_NOISE_ITERATIONS = 3
LEAST_LEVERAGE = (
    1e-3  # of a candidate's information that other blocks hold, at least
)
_ROUNDING = (
    1e-12  # of a column, below which it cannot be distinguished from those before
)
_FREE = 1e-6  # times the prior precision: where only the noise is estimated, bodies are free
CHI2_MEDIAN = 0.4549  # of one degree of freedom


@dataclass(frozen=True, eq=False)
class Candidate:
    """A cause that may be present."""

    effect: Effect  # its shape fixed
    columns: slice  # among those of the evidence
    scale: Array  # coefficient in units of the effect per unit of the column's coordinate, (k, k)
    trials: int = 1  # number of shapes of which this one is the best

    @property
    def key(self) -> Key:
        """Effect and joints: candidates that differ in shape only share it."""
        return self.effect.name, self.effect.joints

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return int(self.columns.stop - self.columns.start)


@dataclass(frozen=True, eq=False)
class SetFit:
    """Fit of the active columns of a set of causes.

    Attributes:
        problem: For the residual of the given model.
        active: Active columns.
        root: L of L Lᵀ, their information.
        coordinates: Of all columns, zero where inactive, shape (p,).
        products: Of the active columns with all and the residual, weighted, (active, p + 1).
    """

    problem: Regression
    active: Indices
    root: Array
    coordinates: Array
    products: Array

    @cached_property
    def half(self) -> Array:
        """H = L⁻¹ of the products: beside the set, HᵀH is off the products of all columns."""
        return frozen(_halved(self.root, self.products))

    @cached_property
    def residual(self) -> Array:
        """Residual beside the set, shape (n, nv) [N·m]."""
        return frozen(self.problem.residual(self.coordinates))

    @property
    def covariance(self) -> Array:
        """Covariance of the active coordinates, shape (active, active)."""
        return self.solved(np.eye(len(self.active)))

    def solved(self, right: Array) -> Array:
        """Solution of the normal equations for a right-hand side, (active, ...)."""
        return _by_root(self.root, right)


@dataclass(frozen=True, eq=False)
class Evidence:
    """Weighted columns of all candidates, after those of the nuisance, which are always active."""

    problem: Regression  # for the residual of the given model; rows that do not count are zero
    counted: Array  # number of rows that count, shape (nv,)
    precision: Array  # prior precision of each coordinate, shape (p,)
    nuisance: int  # number of its columns
    candidates: tuple[Candidate, ...]
    blocks: Indices  # first row of each block of time
    tests: int  # among which the level is divided
    by_share: bool  # bound the false discovery rate (Benjamini and Gavrilov 2009), not any alarm
    sigma: Array  # noise of each joint [N·m], shape (nv,)
    inflation: (
        Array  # integrated autocorrelation time of the noise [rows], shape (nv,)
    )
    # columns of the nuisance: drive gains that are not known
    gains: range = range(0)
    # of given bodies and effects, relative to ±10 %
    tolerance: tuple[float, float] = (1.0, 1.0)
    # of the sets asked for last
    _fits: dict[tuple[Candidate, ...], SetFit] = field(
        default_factory=dict, init=False, repr=False
    )

    @property
    def weight(self) -> Array:
        """Λ of each joint's rows, shape (nv,)."""
        return 1 / (self.sigma**2 * self.inflation)

    @cached_property
    def products(self) -> Array:
        """[X r]ᵀ Λ [X r] of all columns and the residual, shape (p + 1, p + 1)."""
        return frozen(self.problem.gram(self.weight))

    @property
    def gram(self) -> Array:
        """Xᵀ Λ X, shape (p, p)."""
        return self.products[:-1, :-1]

    def information(self, columns: Indices) -> Array:
        """Xᵀ Λ X of some columns with the prior precision, shape (k, k)."""
        information = self.gram[np.ix_(columns, columns)]
        information.flat[:: len(columns) + 1] += self.precision[columns]
        return information

    @property
    def moment(self) -> Array:
        """Xᵀ Λ r, shape (p,)."""
        return self.products[:-1, -1]

    @cached_property
    def powers(self) -> Array:
        """rᵀ Λ r of each joint, shape (nv,)."""
        return self.weight * np.array([gram[-1, -1] for gram in self.problem.grams])

    def fit(self, chosen: Sequence[Candidate]) -> SetFit:
        """Fit of a set of causes, kept while few others are asked for."""
        key = tuple(chosen)
        fit = self._fits.pop(key, None) or self._fitted(key)
        self._fits[key] = fit
        # a set, it with one cause more and with one less, and none
        for oldest in list(self._fits)[:-4]:
            del self._fits[oldest]
        return fit

    def _fitted(self, chosen: Sequence[Candidate]) -> SetFit:
        active = self.active(chosen)
        root = _root(self.information(active))
        coordinates = np.zeros(len(self.moment))
        coordinates[active] = _by_root(root, self.moment[active])
        products = self.products[active]
        return SetFit(self.problem, active, root, frozen(coordinates), products)

    def cost(self, chosen: Sequence[Candidate]) -> float:
        """J of a set of candidates."""
        explained = self.moment @ self.fit(chosen).coordinates
        return float(self.products[-1, -1] - explained)

    def beside(
        self, chosen: Sequence[Candidate], candidate: Candidate
    ) -> tuple[Array, Array]:
        """Coordinates per unit of a candidate's own beside a set, (p, k), and information of these.

        The latter, (k, k), is the inverse of the covariance of the candidate's own coordinates.
        """
        fit = self.fit(chosen)
        active = fit.active
        at = np.r_[candidate.columns]
        per_unit = np.zeros((len(self.moment), len(at)))
        per_unit[at] = np.eye(len(at))
        cross = fit.products[:, at]
        per_unit[active] = -fit.solved(cross)
        own = self.information(at)
        own.flat[:: len(at) + 1] *= 1 + _ROUNDING
        own += cross.T @ per_unit[active]
        return per_unit, own

    def fall(
        self,
        chosen: Sequence[Candidate],
        candidate: Candidate,
        more: Sequence[Candidate] = (),
    ) -> float:
        """Fall of J by adding a candidate to a set, and to some more that are none of it."""
        columns = np.r_[tuple(c.columns for c in (*more, candidate))]
        whole = self.fit(chosen).half
        half = whole[:, columns]
        own = self.information(columns)
        own.flat[:: len(columns) + 1] *= 1 + _ROUNDING
        own -= half.T @ half
        score = self.moment[columns] - half.T @ whole[:, -1]
        # the last rows of the triangle are the candidate's, beside all else
        falls = _halved(_root(own), score)[-candidate.size :] ** 2
        return falls.sum()

    def additions(self, chosen: Sequence[Candidate]) -> Array:
        """Fall of J by adding each of the candidates to a set, shape (candidates,)."""
        half = self.fit(chosen).half
        half, projected = half[:, :-1], half[:, -1]
        rest = self.moment - half.T @ projected
        falls = np.empty(len(self.candidates))
        for of_size, at in self._by_size:
            part = half[:, at].transpose(1, 0, 2)
            G = (
                self.gram[at[:, :, None], at[:, None]]
                - part.transpose(0, 2, 1) @ part
            )
            G += self.precision[at][:, None] * np.eye(at.shape[1])
            inverse = np.linalg.pinv(G, rcond=1e-10, hermitian=True)
            falls[of_size] = np.einsum("ck,ckl,cl->c", rest[at], inverse, rest[at])
        return falls

    def removals(self, chosen: Sequence[Candidate]) -> Array:
        """Rise of J by taking each candidate out of a set, shape (chosen,).

        It is xᵀ C⁻¹ x of the candidate's coordinates x and their covariance C.
        """
        fit = self.fit(chosen)
        covariance = fit.covariance
        coordinates = fit.coordinates[fit.active]
        rises = []
        start = self.nuisance
        for candidate in chosen:
            at = slice(start, start + candidate.size)
            x = coordinates[at]
            rises.append(x @ np.linalg.solve(covariance[at, at], x))
            start = at.stop
        return np.array(rises)

    @cached_property
    def _by_size(self) -> list[tuple[Indices, Indices]]:
        """Candidates of the same number of coefficients k, and their columns, (c,) and (c, k)."""
        sizes = np.array([c.size for c in self.candidates], np.intp)
        starts = np.array([c.columns.start for c in self.candidates], np.intp)
        alike = (
            (np.flatnonzero(sizes == k), np.arange(k)) for k in np.unique(sizes)
        )
        return [
            (of_size, starts[of_size][:, None] + columns)
            for of_size, columns in alike
        ]

    def threshold(self, candidate: Candidate, beside: int = 0) -> float:
        """Fall of J over λ that a candidate must exceed beside others, the search accounted for."""
        # λ is estimated from the blocks and, to one half, known from theory
        alarms = EVIDENCE.false_alarm * (1 + beside if self.by_share else 1)
        tail = alarms / (self.tests * candidate.trials)
        size = candidate.size
        freedom = 2 * size * (len(self.blocks) - 1)
        return float(size / scipy.special.fdtri(freedom, size, tail))

    def dispersion(
        self, chosen: Sequence[Candidate], candidate: Candidate
    ) -> float:
        """λ of a candidate added to a set: variance of its score over that of white noise.

        Scores are scaled up by the block's share in the fit (Bell and McCaffrey 2002); few blocks
        estimate λ badly, so it is shrunk half-way to 1.
        """
        per_unit, own = self.beside(chosen, candidate)
        S = self.problem.torque(per_unit)
        size = _solved(own, self.moment @ per_unit)
        e = self.fit(chosen).residual - S @ size
        weighted = S * self.weight[:, None]
        scores = np.add.reduceat(np.einsum("njk,nj->nk", weighted, e), self.blocks)
        grams = np.add.reduceat(np.einsum("njk,njl->nkl", weighted, S), self.blocks)
        unit = _inverse_root(grams.sum(axis=0))
        if not len(unit):
            return EVIDENCE.least_dispersion
        share, modes = np.linalg.eigh(unit @ grams @ unit.T)
        scale = 1 / np.sqrt(np.maximum(1 - share, LEAST_LEVERAGE))
        adjusted = scale * np.einsum("bmi,bm->bi", modes, scores @ unit.T)
        measured = (adjusted**2).sum() / len(unit)
        return max(EVIDENCE.least_dispersion, (measured + 1) / 2)

    def cosine(self, one: Candidate, other: Candidate) -> float:
        """Largest |cos| between two candidates' columns, the nuisance projected out."""
        columns = np.r_[one.columns, other.columns]
        half = self.fit(()).half[:, columns]
        G = self.gram[np.ix_(columns, columns)] - half.T @ half
        k = one.size
        whiten = [_inverse_root(block) for block in (G[:k, :k], G[k:, k:])]
        cosines = np.linalg.svd(
            whiten[0] @ G[:k, k:] @ whiten[1].T, compute_uv=False
        )
        return float(min(1.0, cosines[0])) if len(cosines) else 0.0

    def block_errors(self, chosen: Sequence[Candidate]) -> Array:
        """Weighted squared error that a set leaves in each block of time, shape (blocks,)."""
        squares = (self.fit(chosen).residual ** 2 * self.weight).sum(axis=1)
        return np.add.reduceat(squares, self.blocks)

    def separate_joints(
        self, chosen: Sequence[Candidate], cause: Candidate
    ) -> tuple[float, int]:
        """Fall of J when each joint has its own coefficients of a cause, and their extra number."""
        fit = self.fit(chosen)
        active = fit.active
        grams = []
        crosses = []
        moments = []
        used = set[int]()
        for j, here in self.acting(cause):
            at = self.problem.index[j]
            weight = self.weight[j]
            G = weight * self.problem.grams[j]
            cross = np.zeros((len(self.moment), len(here)))
            cross[at] = G[:-1, here]
            grams.append(G[np.ix_(here, here)] + np.diag(self.precision[at[here]]))
            crosses.append(cross[active])
            moments.append(G[here, -1])
            used |= {*at[here].tolist()}
        if len(grams) < 2:
            return 0.0, 0
        cross = np.concatenate(crosses, axis=1)
        beside = cross.T @ fit.coordinates[active]
        remaining = np.concatenate(moments) - beside
        G = scipy.linalg.block_diag(*grams) - cross.T @ fit.solved(cross)
        fall = remaining @ np.linalg.lstsq(G, remaining, rcond=1e-9)[0]
        return fall, len(remaining) - len(used)

    def acting(self, cause: Candidate) -> Iterator[tuple[int, Indices]]:
        """Joints on which a cause acts, each with the indices of its columns among the joint's."""
        for j, at in enumerate(self.problem.index):
            here = np.flatnonzero(
                (at >= cause.columns.start) & (at < cause.columns.stop)
            )
            if len(here):
                yield j, here

    def active(self, chosen: Sequence[Candidate]) -> Indices:
        """Active columns of a set: those of the nuisance and of its candidates."""
        return np.r_[0 : self.nuisance, *(c.columns for c in chosen)]


def _root(A: Array) -> Array:
    """L of L Lᵀ = A, positive but for rounding, each column in its own unit."""
    unit = 1 / np.sqrt(np.diag(A))
    scaled = unit[:, None] * A * unit
    scaled.flat[:: len(A) + 1] += _ROUNDING
    return np.linalg.cholesky(scaled) / unit[:, None]


def _halved(root: Array, right: Array) -> Array:
    """L⁻¹ times a right-hand side, L the root."""
    return scipy.linalg.solve_triangular(
        root, right, lower=True, check_finite=False
    )


def _by_root(root: Array, right: Array) -> Array:
    """A⁻¹ times a right-hand side, root that of A."""
    return scipy.linalg.cho_solve((root, True), right, check_finite=False)


def _solved(A: Array, right: Array) -> Array:
    """A⁻¹ times a right-hand side, A as of `_root`."""
    return _by_root(_root(A), right)


def _inverse_root(G: Array) -> Array:
    """Inverse square root of a Gram matrix on the directions it has, shape (rank, k)."""
    values, vectors = np.linalg.eigh(G)
    keep = values > 1e-9 * max(values[-1], 0.0)
    return (vectors[:, keep] / np.sqrt(values[keep])).T


def cross_validation(
    evidence: Evidence, chosen: Sequence[Candidate]
) -> Callable[[Sequence[Candidate]], Array]:
    """Weighted squared error of each joint in each block of time, predicted from other parts.

    The function takes subsets of the causes chosen; shape (blocks, nv). Parts are the quarters of
    the rows, so that what is fitted to some of the motion must hold for the rest (Stone 1974).
    """
    active = evidence.active(chosen)
    problem = evidence.problem.select(active.tolist())
    place = np.full(evidence.problem.p, -1)
    place[active] = np.arange(len(active))
    bounds = itertools.pairwise([*evidence.blocks, None])
    blocks = [problem.at(slice(begin, end)) for begin, end in bounds]
    grams = [
        np.array(each)
        for each in zip(*(block.grams for block in blocks), strict=True)
    ]
    whole = np.array([block.gram(evidence.weight) for block in blocks])
    folds = np.array_split(np.arange(len(blocks)), SELECTION.parts)
    others = [np.delete(whole, fold, axis=0).sum(axis=0) for fold in folds]

    def errors(subset: Sequence[Candidate]) -> Array:
        used = place[evidence.active(subset)]
        squares = np.empty((len(blocks), problem.nv))
        for fold, total in zip(folds, others, strict=True):
            A = total[np.ix_(used, used)] + np.diag(
                evidence.precision[active[used]]
            )
            coefficients = np.zeros(problem.p + 1)
            coefficients[used] = -_solved(A, total[used, -1])
            coefficients[-1] = 1.0
            for j, weight in enumerate(evidence.weight):
                of_joint = coefficients[np.append(problem.index[j], problem.p)]
                squares[fold, j] = weight * (grams[j][fold] @ of_joint) @ of_joint
        return squares

    return errors


def weigh(
    problem: Regression,
    precision: Array,
    nuisance: int,
    candidates: Sequence[Candidate],
    period: float,
    *,
    by_share: bool = False,
    gains: range = range(0),
) -> Evidence:
    """Evidence from the rows that count, a period [s] apart; for the rest see `Evidence`."""
    n = len(problem)
    wanted = n * period / EVIDENCE.block_s
    count = int(np.clip(wanted, EVIDENCE.fewest_blocks, EVIDENCE.most_blocks))
    counted = np.maximum([len(rows) for rows in problem.counted(problem.tau)], 1)
    blocks = np.linspace(0, n, count, endpoint=False).astype(np.intp)
    sigma, inflation = _noise(problem.tau, counted)
    first = Evidence(
        problem,
        counted,
        precision,
        nuisance,
        tuple(candidates),
        blocks,
        len(candidates),
        by_share,
        sigma,
        inflation,
        gains,
    )
    return reweighed(first, [])


def reweighed(evidence: Evidence, chosen: Sequence[Candidate]) -> Evidence:
    """The same evidence with noise levels from the residual of a rough model.

    It has every usual cause at once and loose given values, so that no cause is taken for noise.
    """
    usual = [
        c for c in evidence.candidates if c.effect.search.usual and c not in chosen
    ]
    active = evidence.active([*chosen, *usual])
    problem = evidence.problem
    loose = _FREE * np.diag(evidence.precision[active])
    coordinates = np.zeros(problem.p)
    of_joints = problem.products_of(active)
    for _ in range(_NOISE_ITERATIONS):
        products = weighted(of_joints, evidence.weight)
        A = products[:-1, :-1] + loose
        coordinates[active] = _solved(A, products[:-1, -1])
        sigma, inflation = _noise(problem.residual(coordinates), evidence.counted)
        evidence = replace(evidence, sigma=sigma, inflation=inflation)
    return evidence


def _noise(e: Array, counted: Array) -> tuple[Array, Array]:
    sigma = believed(np.maximum(np.sqrt((e**2).sum(axis=0) / counted), 1e-9))
    return sigma, np.array([autocorrelation_time(column) for column in e.T])


def are_placeholders(robot: Robot) -> bool:
    """Whether the robot says nothing of any of its links' bodies."""
    return bool(placeholder_links(robot).all())


def widened(robot: Robot, tolerance: float = 1.0) -> Array:
    """Tolerance of each link relative to ±10 %, shape (nv,): wide where it holds only a place."""
    return np.where(placeholder_links(robot), EVIDENCE.placeholder, tolerance)


def calibrated(evidence: Evidence, robot: Robot) -> Evidence:
    """The same evidence with the tolerance of given values that the data support."""
    links = 10 * robot.nv
    parts = (
        np.arange(links),
        np.arange(links, evidence.nuisance - len(evidence.gains)),
    )
    bodies, effects = (_typical_deviation(evidence, part, robot) for part in parts)
    precision = np.array(evidence.precision)
    precision[parts[0]] /= np.repeat(widened(robot, bodies), 10) ** 2
    precision[parts[1]] /= effects**2
    given = EVIDENCE.placeholder if are_placeholders(robot) else bodies
    tolerance = given, effects
    return reweighed(
        replace(evidence, precision=precision, tolerance=tolerance), []
    )


def _typical_deviation(evidence: Evidence, part: Indices, robot: Robot) -> float:
    """Typical deviation of given values from what the data say, all else as free as the data are.

    The median of squares: a few values may be any. Few directions do not make it smaller than 1.
    """
    nominal = {
        (effect.name, joint) for effect in robot.effects for joint in effect.joints
    }
    usual = [  # what joints have is left free, but not as what is given twice
        c
        for c in evidence.candidates
        if c.effect.search.usual
        and not {(c.effect.name, joint) for joint in c.effect.joints} <= nominal
    ]
    others = np.setdiff1d(evidence.active(usual), part)
    H = evidence.gram[np.ix_(part, part)]
    m = evidence.moment[part]
    if len(others):
        beside = evidence.gram[np.ix_(others, part)]
        cross = _solved(evidence.information(others), beside)
        H = H - beside.T @ cross
        m = m - cross.T @ evidence.moment[others]
    unit = 1 / np.sqrt(evidence.precision[part])
    values, vectors = np.linalg.eigh(unit[:, None] * H * unit)
    determined = values > EVIDENCE.determined
    if determined.sum() < EVIDENCE.fewest_directions:
        return 1.0
    deviation = (vectors[:, determined].T @ (unit * m)) / values[determined]
    # noise alone adds the second term to the median of a squared deviation
    variance = (
        np.median(deviation**2 - CHI2_MEDIAN / values[determined]) / CHI2_MEDIAN
    )
    least = (
        EVIDENCE.least_off if determined.sum() >= EVIDENCE.many_directions else 1.0
    )
    return float(np.clip(np.sqrt(max(variance, 0.0)), least, EVIDENCE.most_off))
