"""Evidence for candidate causes: how much better the data are explained with them than without.

The residual of the given model is r = N η + C θ + e. The nuisance N η is what the given model's
own values may be off within their tolerance, η ~ N(0, tolerance²); a candidate adds columns C
with coefficients θ that only the data decide; e is noise with one level per joint. For a set S of
candidates

    J(S) = min over η, θ_S of  ‖r − N η − C_S θ_S‖²_Λ + ‖η‖²_prior.

J falls when a k-column candidate is added that is not at work by λ times a χ² variable with k
degrees of freedom. λ is 1 where Λ has the noise right; residuals are far from white, so λ is
measured for every candidate from sums of its score over blocks of time (a robust covariance,
used by the mean of its eigenvalues: Rao and Scott 1984).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import scipy.linalg
import scipy.stats

from excitant.analysis.signatures import Index, Signatures
from excitant.identify.least_squares import autocorrelation_time
from excitant.robots.effects import Effect
from excitant.robots.motion import Array, read_only

FALSE_ALARM = 0.05  # that any candidate enters when none is at work; the hold-out confirms it
_ROUNDS = 3  # of estimating the noise
_RIDGE = 1e-3  # of a candidate's information that other blocks hold, at least
_ROUNDING = 1e-12  # of a column, below which it cannot be told from those before
_LEAST = 0.5  # λ: noise whose correlation helps a candidate is not relied on further
_LOOSE = 0.01  # of the prior precision, where only the noise is asked for
_COMMON = frozenset(
    ("viscous_friction", "coulomb_friction", "torque_offset", "rotor_inertia", "spring")
)
_BLOCK_S = 0.5  # s at least: longer than noise that passed the torque filter stays correlated
_BLOCKS = (16, 40)  # at least, at most


@dataclass(frozen=True, eq=False)
class Candidate:
    """A cause that may be at work.

    Attributes:
        effect: The effect, its shape fixed.
        columns: Where its columns are among those of the evidence.
        scale: Coefficient in units of the effect per unit of the column's coordinate, (k, k).
        trials: Number of shapes that this one is the best of.
    """

    effect: Effect
    columns: slice
    scale: Array
    trials: int = 1

    @property
    def key(self) -> tuple[str, tuple[str, ...]]:
        """Effect and joints: candidates that differ in shape only share it."""
        return self.effect.name, self.effect.joints

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return int(self.columns.stop - self.columns.start)


@dataclass(frozen=True, eq=False)
class Evidence:
    """Weighted columns of all candidates, the nuisance always at work.

    Attributes:
        signatures: All columns, nuisance first.
        residual: Residual of the given model, zero where rows do not count, shape (n, nv) [N·m].
        counted: Number of rows that count, shape (nv,).
        moments: Inner products of all columns with it, joint by joint, shape (nv, p).
        precision: Prior precision of each coordinate, shape (p,).
        nuisance: Number of leading columns that belong to the nuisance.
        candidates: What may be at work.
        blocks: First row of each block of time.
        sigma: Noise of each joint [N·m], shape (nv,).
        inflation: Integrated autocorrelation time of each joint's noise [rows], shape (nv,).
        tolerance: Deviation of given bodies and effects over what is taken as usual.
        gram: Xᵀ Λ X of all columns, shape (p, p).
        moment: Xᵀ Λ r, shape (p,).
        power: rᵀ Λ r.
    """

    signatures: Signatures
    residual: Array
    counted: Array
    moments: Array
    precision: Array
    nuisance: int
    candidates: tuple[Candidate, ...]
    blocks: Index
    sigma: Array
    inflation: Array
    gram: Array
    moment: Array
    power: float
    tolerance: tuple[float, float] = (1.0, 1.0)

    @property
    def weight(self) -> Array:
        """Λ of each joint's rows, shape (nv,)."""
        return np.asarray(1 / (self.sigma**2 * self.inflation), float)

    def solve(self, chosen: Sequence[Candidate]) -> tuple[float, Array, Array]:
        """J, the coordinates of all columns (zero where not at work), and their covariance."""
        active = self.active(chosen)
        factor = scipy.linalg.cho_factor(self._precision(active), lower=True)
        solution = scipy.linalg.cho_solve(factor, self.moment[active])
        coordinates, covariance = np.zeros(len(self.moment)), np.zeros_like(self.gram)
        coordinates[active] = solution
        covariance[np.ix_(active, active)] = scipy.linalg.cho_solve(factor, np.eye(len(active)))
        return self.power - float(self.moment[active] @ solution), coordinates, covariance

    def cost(self, chosen: Sequence[Candidate]) -> float:
        """J of a set of candidates."""
        active = self.active(chosen)
        half = scipy.linalg.solve_triangular(
            np.linalg.cholesky(self._precision(active)),
            self.moment[active],
            lower=True,
            check_finite=False,
        )
        return self.power - float(half @ half)

    def left(self, chosen: Sequence[Candidate], prior: float = 1.0) -> Array:
        """What a set of candidates leaves of the residual, shape (n, nv) [N·m].

        Args:
            chosen: The set.
            prior: Factor on the prior precision.
        """
        active = self.active(chosen)
        A = self.gram[np.ix_(active, active)] + prior * np.diag(self.precision[active])
        coordinates = np.zeros(len(self.moment))
        unit = 1 / np.sqrt(np.diag(A))
        scaled = scipy.linalg.solve(
            unit[:, None] * A * unit + _ROUNDING * np.eye(len(A)),
            unit * self.moment[active],
            assume_a="pos",
        )
        coordinates[active] = unit * scaled
        return self.residual - self.signatures.torque(coordinates)

    def additions(self, chosen: Sequence[Candidate]) -> Array:
        """Fall of J by adding each of the candidates to a set, shape (candidates,)."""
        active = self.active(chosen)
        root = np.linalg.cholesky(self._precision(active))
        half = scipy.linalg.solve_triangular(root, self.gram[active], lower=True)
        rest = self.moment - half.T @ scipy.linalg.solve_triangular(
            root, self.moment[active], lower=True
        )
        falls = np.empty(len(self.candidates))
        for k, c in enumerate(self.candidates):
            part, at = half[:, c.columns], c.columns
            G = self.gram[at, at] + np.diag(self.precision[at]) - part.T @ part
            falls[k] = rest[at] @ np.linalg.lstsq(G, rest[at], rcond=1e-10)[0]
        return falls

    def threshold(self, candidate: Candidate) -> float:
        """Fall of J over λ that a candidate must exceed, the search accounted for.

        The noise behind λ is known from as many blocks as there are, and half from theory.
        """
        tail = FALSE_ALARM / (len(self.candidates) * candidate.trials)
        size, blocks = candidate.size, len(self.blocks)
        return size * _beyond(tail, size, 2 * size * (blocks - 1))

    def dispersion(self, chosen: Sequence[Candidate], candidate: Candidate) -> float:
        """λ of a candidate added to a set: variance of its score over that of white noise.

        A fit leaves every block's score smaller by the block's share in it; the scores are scaled
        up so that white noise gives 1 (Bell and McCaffrey 2002). Few blocks know λ badly, so it is
        shrunk half-way to 1.
        """
        active = self.active(chosen)
        at = np.arange(candidate.columns.start, candidate.columns.stop)
        B = scipy.linalg.solve(
            self._precision(active), self.gram[np.ix_(active, at)], assume_a="pos"
        )
        coordinates = np.zeros((len(self.moment), len(at)))
        coordinates[at], coordinates[active] = np.eye(len(at)), -B
        S, e = self.signatures.torque(coordinates), self.left([*chosen, candidate])
        weighted = S * self.weight[:, None]
        scores = np.add.reduceat(np.einsum("njk,nj->nk", weighted, e), self.blocks)
        grams = np.add.reduceat(np.einsum("njk,njl->nkl", weighted, S), self.blocks)
        unit = _inverse_root(grams.sum(axis=0))
        if not len(unit):
            return _LEAST
        share, modes = np.linalg.eigh(unit @ grams @ unit.T)
        left = 1 / np.sqrt(np.maximum(1 - share, _RIDGE))
        adjusted = left * np.einsum("bmi,bm->bi", modes, scores @ unit.T)
        measured = float((adjusted**2).sum()) / len(unit)
        return max(_LEAST, (measured + 1) / 2)

    def cosine(self, one: Candidate, other: Candidate) -> float:
        """Largest |cos| between two candidates' columns, the nuisance projected out."""
        rest = slice(0, self.nuisance)
        A = self.gram[rest, rest] + np.diag(self.precision[rest])
        columns = np.r_[one.columns, other.columns]
        cross = self.gram[rest, columns]
        G = self.gram[np.ix_(columns, columns)] - cross.T @ np.linalg.solve(A, cross)
        k = one.size
        whiten = [_inverse_root(block) for block in (G[:k, :k], G[k:, k:])]
        cosines = np.linalg.svd(whiten[0] @ G[:k, k:] @ whiten[1].T, compute_uv=False)
        return float(min(1.0, cosines[0])) if len(cosines) else 0.0

    def active(self, chosen: Sequence[Candidate]) -> Index:
        """Columns that are at work with a set."""
        parts = [np.arange(self.nuisance)]
        parts += [np.arange(c.columns.start, c.columns.stop) for c in chosen]
        return np.concatenate(parts)

    def _precision(self, active: Index) -> Array:
        return self.gram[np.ix_(active, active)] + np.diag(self.precision[active])


@lru_cache(maxsize=4096)
def _beyond(tail: float, size: int, freedom: int) -> float:
    """Quantile of Fisher's F."""
    return float(scipy.stats.f.isf(tail, size, freedom))


def _inverse_root(G: Array) -> Array:
    """Inverse square root of a Gram matrix on the directions it has, shape (rank, k)."""
    values, vectors = np.linalg.eigh(G)
    keep = values > 1e-9 * max(values[-1], 0.0)
    return np.asarray((vectors[:, keep] / np.sqrt(values[keep])).T, float)


def weigh(
    columns: Signatures,
    r: Array,
    counts: npt.NDArray[np.bool_],
    precision: Array,
    nuisance: int,
    candidates: Sequence[Candidate],
    period: float,
) -> Evidence:
    """Evidence from rows.

    Args:
        columns: Columns, nuisance first.
        r: Residual of the given model, shape (n, nv) [N·m].
        counts: Rows that count, shape (n, nv).
        precision: Prior precision of each column's coordinate, shape (p,).
        nuisance: Number of leading columns that are nuisance.
        candidates: What the other columns stand for.
        period: Time between rows [s].
    """
    n, residual = len(r), read_only(r * counts)
    count = int(np.clip(n * period / _BLOCK_S, *_BLOCKS))
    blank = Evidence(
        signatures=columns,
        residual=residual,
        counted=read_only(np.maximum(counts.sum(axis=0), 1)),
        moments=read_only(columns.moments(residual)),
        precision=read_only(precision),
        nuisance=nuisance,
        candidates=tuple(candidates),
        blocks=np.linspace(0, n, count, endpoint=False).astype(np.intp),
        sigma=np.ones(r.shape[1]),
        inflation=np.ones(r.shape[1]),
        gram=np.zeros(0),
        moment=np.zeros(0),
        power=0.0,
    )
    return reweighed(_with_noise(blank, residual), [])


def reweighed(evidence: Evidence, chosen: Sequence[Candidate]) -> Evidence:
    """The same evidence with the noise that a rough model leaves.

    The rough model has the set of candidates and every common cause at once, and given values
    that may be off by far more than their tolerance: what it leaves is near the noise whatever
    is wrong, so that one cause does not pass for the noise that hides another, or itself.
    """
    taken = {c.columns.start for c in chosen}
    common = [c for c in evidence.candidates if c.effect.name in _COMMON]
    rough = [*chosen, *(c for c in common if c.columns.start not in taken)]
    for _ in range(_ROUNDS):
        evidence = _with_noise(evidence, evidence.left(rough, _LOOSE))
    return evidence


def _with_noise(evidence: Evidence, e: Array) -> Evidence:
    """The same evidence with noise of the size and correlation of e, shape (n, nv)."""
    sigma = np.maximum(np.sqrt((e**2).sum(axis=0) / evidence.counted), 1e-9)
    inflation = np.array([autocorrelation_time(column) for column in e.T])
    weight, r = 1 / (sigma**2 * inflation), evidence.residual
    return replace(
        evidence,
        sigma=read_only(sigma),
        inflation=read_only(inflation),
        gram=read_only(evidence.signatures.gram(weight)),
        moment=read_only(weight @ evidence.moments),
        power=float((weight * r**2).sum()),
    )
