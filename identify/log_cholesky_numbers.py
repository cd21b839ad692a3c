"""Every consistent body as ten free numbers (Rucker and Wensing 2022), and back.

Its pseudo-inertia is P = U Uᵀ with

    U = e^α [[e^d₁, s₁₂, s₁₃, t₁], [0, e^d₂, s₂₃, t₂], [0, 0, e^d₃, t₃], [0, 0, 0, 1]].
"""

from __future__ import annotations

import numpy as np

from excitant.exceptions import BadInput
from excitant.robots.motion import Array
from excitant.robots.parameters import from_pseudo_inertia, pseudo_inertia

_OFF = ((0, 1), (1, 2), (0, 2))  # s₁₂, s₂₃, s₁₃, the order of Rucker and Wensing


def _root(numbers: Array) -> Array:
    """U of ten numbers (α, d₁, d₂, d₃, s₁₂, s₂₃, s₁₃, t₁, t₂, t₃) without its factor e^α."""
    U = np.diag(np.append(np.exp(numbers[1:4]), 1.0))
    for value, (i, j) in zip(numbers[4:7], _OFF, strict=True):
        U[i, j] = value
    U[:3, 3] = numbers[7:]
    return U


def from_log_cholesky(numbers: Array) -> tuple[Array, Array]:
    """Standard parameters of ten numbers, shape (10,), and their exact Jacobian, shape (10, 10)."""
    U, size = _root(numbers), np.exp(2 * numbers[0])
    P = size * U @ U.T
    slopes = [2 * P]
    changes = np.zeros((9, 4, 4))
    for k in range(3):
        changes[k, k, k] = U[k, k]
        changes[3 + k][_OFF[k]] = 1.0
        changes[6 + k, k, 3] = 1.0
    for dU in changes:
        half = size * dU @ U.T
        slopes.append(half + half.T)
    return from_pseudo_inertia(P), from_pseudo_inertia(np.array(slopes)).T


def to_log_cholesky(phi: Array) -> Array:
    """The ten numbers of a consistent body.

    Args:
        phi: Standard parameters of one link, shape (10,).

    Raises:
        BadInput: No body of positive density has them.
    """
    flip = pseudo_inertia(phi)[::-1, ::-1]
    try:
        U = np.linalg.cholesky(flip)[::-1, ::-1]  # upper triangular with U Uᵀ = P
    except np.linalg.LinAlgError:
        raise BadInput("log-Cholesky: parameters that no body of positive density has") from None
    unit = U / U[3, 3]
    return np.array(
        [np.log(U[3, 3]), *np.log(np.diag(unit)[:3]), *(unit[k] for k in _OFF), *unit[:3, 3]]
    )
