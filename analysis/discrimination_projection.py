"""What is left of causes once given values, and each other, have taken what they can."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.linalg

from excitant.robots.motion import Array

_LOOSE = 1e-9  # prior precision of what only the data decide, of its own information


def without_given(information: Array, precision: Array) -> tuple[Array, Array]:
    """Information on causes once the given values may take what they can, and its rounding."""
    p = len(precision)
    A = information[:p, :p] + np.diag(precision)
    half = scipy.linalg.solve_triangular(np.linalg.cholesky(A), information[:p, p:], lower=True)
    floor = 1e-10 * np.maximum(np.diag(information)[p:], 1e-12)
    return information[p:, p:] - half.T @ half, floor


def explaining(R: Array, floor: Array, columns: Sequence[int], b: Array) -> Array:
    """Coefficients of columns that explain most of a torque with inner products b."""
    at = list(columns)
    scale = np.sqrt(np.maximum(np.diag(R)[at], floor[at]))
    A = R[np.ix_(at, at)] / np.outer(scale, scale) + _LOOSE * np.eye(len(at))
    return np.asarray(np.linalg.lstsq(A, b[at] / scale, rcond=1e-11)[0] / scale, float)
