"""Evidence for candidate causes: how much better the data are explained with them than without.

The residual of the given model is r = N η + C θ + e. The nuisance N η is what the given model's
own values may be off within their tolerance, η ~ N(0, tolerance²); a candidate adds columns C
with coefficients θ that only the data decide; e is noise with one level per joint, its
autocorrelation counted by the number of independent samples. For a set S of candidates

    J(S) = min over η, θ_S of  ‖r − N η − C_S θ_S‖²_Λ + ‖η‖²_prior,

and J falls, when a k-column candidate is added that is not at work, by a χ² variable with k
degrees of freedom. Everything follows from one Gram matrix, whatever the recording's length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.linalg
import scipy.stats

from excitant.identify.least_squares import autocorrelation_time
from excitant.robots.effects import Effect
from excitant.robots.motion import Array, read_only

FALSE_ALARM = 0.01  # probability that any candidate at all is taken up when none is at work
_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class Candidate:
    """A cause that may be at work.

    Attributes:
        effect: The effect, on one joint, with its shape fixed.
        columns: Where its columns are among those of the evidence.
        scale: Coefficient in units of the effect per unit of the column's coordinate, (k, k).
    """

    effect: Effect
    columns: slice
    scale: Array

    @property
    def key(self) -> tuple[str, tuple[str, ...]]:
        """Effect and joint: candidates that differ in shape only share it."""
        return self.effect.name, self.effect.joints

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return int(self.columns.stop - self.columns.start)


@dataclass(frozen=True, eq=False)
class Evidence:
    """The Gram matrix of all columns, with the nuisance always at work.

    Attributes:
        gram: Xᵀ Λ X of all columns, shape (p, p).
        moment: Xᵀ Λ r, shape (p,).
        power: rᵀ Λ r.
        precision: Prior precision of each coordinate, shape (p,).
        nuisance: Number of leading columns that belong to the nuisance.
        candidates: What may be at work.
        sigma: Noise of each joint [N·m], shape (nv,).
        inflation: Integrated autocorrelation time of each joint's noise [rows], shape (nv,).
    """

    gram: Array
    moment: Array
    power: float
    precision: Array
    nuisance: int
    candidates: tuple[Candidate, ...]
    sigma: Array
    inflation: Array

    def solve(self, chosen: Sequence[Candidate]) -> tuple[float, Array, Array]:
        """J, the coordinates of all columns (zero where not at work), and their covariance."""
        active = self._active(chosen)
        A = self.gram[np.ix_(active, active)] + np.diag(self.precision[active])
        factor = scipy.linalg.cho_factor(A, lower=True)
        solution = scipy.linalg.cho_solve(factor, self.moment[active])
        coordinates, covariance = np.zeros(len(self.moment)), np.zeros_like(self.gram)
        coordinates[active] = solution
        covariance[np.ix_(active, active)] = scipy.linalg.cho_solve(factor, np.eye(len(active)))
        return self.power - float(self.moment[active] @ solution), coordinates, covariance

    def cost(self, chosen: Sequence[Candidate]) -> float:
        """J of a set of candidates."""
        active = self._active(chosen)
        A = self.gram[np.ix_(active, active)] + np.diag(self.precision[active])
        half = scipy.linalg.solve_triangular(
            np.linalg.cholesky(A), self.moment[active], lower=True, check_finite=False
        )
        return self.power - float(half @ half)

    def threshold(self, size: int) -> float:
        """Fall of J that a candidate of this size must exceed, the search accounted for."""
        return float(scipy.stats.chi2.isf(FALSE_ALARM / len(self.candidates), size))

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

    def _active(self, chosen: Sequence[Candidate]) -> npt.NDArray[np.intp]:
        parts = [np.arange(self.nuisance)]
        parts += [np.arange(c.columns.start, c.columns.stop) for c in chosen]
        return np.concatenate(parts)


def _inverse_root(G: Array) -> Array:
    """Inverse square root of a Gram matrix on the directions it has, shape (rank, k)."""
    values, vectors = np.linalg.eigh(G)
    keep = values > 1e-9 * max(values[-1], 0.0)
    return np.asarray((vectors[:, keep] / np.sqrt(values[keep])).T, float)


def weigh(
    X: Array,
    r: Array,
    precision: Array,
    nuisance: int,
    candidates: Sequence[Candidate],
) -> Evidence:
    """Evidence from rows, with the noise estimated from what *all* columns leave unexplained.

    Args:
        X: Columns, nuisance first, shape (n, nv, p).
        r: Residual of the given model, shape (n, nv) [N·m].
        precision: Prior precision of each column's coordinate, shape (p,).
        nuisance: Number of leading columns that are nuisance.
        candidates: What the other columns stand for.
    """
    grams = np.einsum("njp,njq->jpq", X, X, optimize=True)
    moments = np.einsum("njp,nj->jp", X, r, optimize=True)
    sigma, inflation = np.maximum(r.std(axis=0), 1e-9), np.ones(r.shape[1])
    loose = np.where(np.arange(len(precision)) < nuisance, 0.01 * precision, precision)
    for _ in range(_ROUNDS):
        weight = 1 / sigma**2
        A = np.tensordot(weight, grams, 1) + np.diag(loose)
        solution = scipy.linalg.solve(A, weight @ moments, assume_a="pos")
        noise = r - X @ solution
        sigma = np.maximum(noise.std(axis=0), 1e-9)
    inflation = np.array([autocorrelation_time(column) for column in noise.T])
    weight = 1 / (sigma**2 * inflation)
    return Evidence(
        gram=read_only(np.tensordot(weight, grams, 1)),
        moment=read_only(weight @ moments),
        power=float((weight * r**2).sum()),
        precision=read_only(precision),
        nuisance=nuisance,
        candidates=tuple(candidates),
        sigma=read_only(sigma),
        inflation=read_only(inflation),
    )
