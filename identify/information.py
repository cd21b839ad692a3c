"""Information in square-root form: everything linear data say about parameters x, as a triangle.

Rows A x ≈ b of unit noise become, by a QR factorisation, R x ≈ z with R upper triangular and
‖A x − b‖² = ‖R x − z‖² + ρ² for every x (Bierman 1977).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from scipy.linalg import lapack

from excitant.robots.motion import Array, Indices, Noun

TOGETHER = 8  # rows that are taken at once
_PANEL = 8  # columns that LAPACK takes at a time


@dataclass(frozen=True, eq=False)
class Information(Noun):
    """R x ≈ z of unit noise, beside a part ρ that no x explains."""

    R: Array  # upper triangular, possibly singular, shape (p, p)
    z: Array  # shape (p,)
    rest: float = 0.0  # ρ²

    def squares(self, x: Array) -> float:
        """‖A x − b‖² of all rows behind it."""
        return float(np.sum((self.R @ x - self.z) ** 2)) + self.rest

    def scaled(self, weight: float) -> Information:
        """The same rows weighted, each row times a number."""
        return Information(weight * self.R, weight * self.z, weight**2 * self.rest)

    def of(self, columns: Sequence[int]) -> Information:
        """The same rows about some of the parameters, the others zero."""
        part = information_of(self.R[:, list(columns)], self.z)
        return Information(part.R, part.z, part.rest + self.rest)

    def solve(self) -> Array:
        """The x of least squares, shape (p,); of smallest norm where R is singular."""
        d = np.abs(np.diag(self.R))
        if len(d) and d.min() > 1e-12 * d.max():
            return scipy.linalg.solve_triangular(self.R, self.z)
        return np.asarray(np.linalg.lstsq(self.R, self.z, rcond=1e-12)[0], float)

    def covariance(self) -> Array:
        """(RᵀR)⁻¹ of a regular R, shape (p, p)."""
        inverse = scipy.linalg.solve_triangular(self.R, np.eye(len(self.z)))
        return inverse @ inverse.T


def information_of(A: Array, b: Array) -> Information:
    """Information of rows A x ≈ b, shapes (m, p) and (m,); m may be smaller than p."""
    p = A.shape[1]
    factor = np.zeros((p + 1, p + 1))
    R = np.linalg.qr(np.column_stack([A, b]), mode="r")
    factor[: len(R)] = R
    return Information(factor[:p, :p], factor[:p, p], float(factor[p, p] ** 2))


def combined(parts: Sequence[Information]) -> Information:
    """Information of independent parts about the same parameters."""
    total = information_of(
        np.vstack([part.R for part in parts]),
        np.concatenate([part.z for part in parts]),
    )
    return Information(
        total.R, total.z, total.rest + sum(part.rest for part in parts)
    )


def square_root(covariance: Array) -> Array:
    """L of covariance = L Lᵀ, lower triangular, whatever the units of its rows."""
    scale = np.sqrt(np.diag(covariance))
    L = np.linalg.cholesky(covariance / np.outer(scale, scale))
    return scale[:, None] * L


def gaussian(mean: Array, covariance: Array) -> Information:
    """Information form of a normal distribution with regular covariance."""
    A = scipy.linalg.solve_triangular(
        square_root(covariance), np.eye(len(mean)), lower=True
    )
    return information_of(A, A @ mean)


class InformationFilter:
    """Information about some of p parameters that grows row by row and may be forgotten.

    Rows wait until several can be taken at once, which costs hardly more than one.
    """

    def __init__(self, columns: Indices, p: int) -> None:
        self.columns = columns
        self.p = p
        self._picked = np.append(columns, -1)
        self._size = len(columns) + 1
        self._factor = np.zeros((self._size, self._size), order="F")
        self._rows = np.zeros((2 * TOGETHER, self._size))
        self.waiting = 0

    def add(self, row: Array) -> None:
        """Let a row [a, b] of all parameters wait, shape (p + 1,)."""
        if self.waiting == len(self._rows):
            self.take()
        self._rows[self.waiting] = row[self._picked]
        self.waiting += 1

    def take(self) -> None:
        """Take the rows that wait."""
        if self.waiting:
            stacked = np.asfortranarray(self._rows[: self.waiting])
            panel = min(_PANEL, self._size)
            self._factor = lapack.dtpqrt(0, panel, self._factor, stacked, 1, 1)[0]
            self.waiting = 0

    def forget(self, factor: float) -> None:
        """Weigh everything so far by a factor on the information, 0 < factor ≤ 1."""
        self._factor *= np.sqrt(factor)
        self._rows[: self.waiting] *= np.sqrt(factor)

    def information(self) -> Information:
        """Information of the rows so far on all p parameters."""
        self.take()
        n = self._size - 1
        R = np.zeros((n, self.p))
        R[:, self.columns] = self._factor[:n, :n]
        full = information_of(R, self._factor[:n, n])
        rest = full.rest + float(self._factor[n, n] ** 2)
        return Information(full.R, full.z, rest)
