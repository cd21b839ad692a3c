"""Regularised least squares from products of columns, and what added columns change in them."""

from __future__ import annotations

import numpy as np
import scipy

from excitant.analysis.evidence import Index
from excitant.robots.motion import Array

_RIDGE = 1e-10  # relative, so that columns that repeat each other do no harm


class NormalEquations:
    """Regularised normal equations of a set of columns, ready for additions.

    Args:
        G: Products of all columns and, last, the torque, shape (p + 1, p + 1).
        precision: Prior precision, shape (p,).
        active: The set.
    """

    def __init__(self, G: Array, precision: Array, active: Index) -> None:
        self._G, self._precision, self._active = G, precision, active
        A = G[np.ix_(active, active)] + np.diag(precision[active])
        A[np.diag_indices_from(A)] *= 1 + _RIDGE
        self._factor = scipy.linalg.cho_factor(A, lower=True)
        self._explained = scipy.linalg.cho_solve(self._factor, G[active])  # (a, p + 1)
        self.solution = np.zeros(len(precision))
        self.solution[active] = self._explained[:, -1]

    def addition(self, columns: slice) -> tuple[Array, float]:
        """Coefficients of columns that are added, and the fall of the cost."""
        at = np.arange(columns.start, columns.stop)
        cross = self._G[np.ix_(self._active, at)]
        schur = self._G[np.ix_(at, at)] - cross.T @ self._explained[:, at]
        rest = self._G[at, -1] - cross.T @ self._explained[:, -1]
        schur = schur + np.diag(self._precision[at])
        value = np.linalg.lstsq(schur, rest, rcond=1e-9)[0]
        return value, float(rest @ value)

    def change(self, columns: slice) -> Array:
        """Change of the solution when columns are added, shape (p,)."""
        value, _ = self.addition(columns)
        change = np.zeros(len(self._precision))
        change[columns] = value
        change[self._active] = -self._explained[:, columns] @ value
        return change


def gram_factor(G: Array) -> Array:
    """F with Fᵀ F = G, of as many rows as G has."""
    unit = np.sqrt(np.maximum(np.diag(G), 1e-300))
    values, vectors = np.linalg.eigh(G / np.outer(unit, unit))
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))).T * unit, float)
