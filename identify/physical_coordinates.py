"""Coordinates of the physically consistent fit: pseudo-inertias relative to reference bodies.

With the pseudo-inertia of link k written P_k = L_k Q_k L_kᵀ, where L_k L_kᵀ is that of a reference
body (the prior's), the coordinates y are the upper triangles of all Q_k. They have no units, and
‖Q − 1‖_F is the coordinate-invariant distance to the reference (the constant pull-back of the
affine-invariant metric: Lee, Wensing, Park 2020).
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from excitant.robots.motion import Array
from excitant.robots.parameters import from_pseudo_inertia, pseudo_inertia

UPPER = np.triu_indices(4)
_KINDS = (0, 1, 1, 1, *(2,) * 6)  # powers of length in m, m c, I


def svec_weights() -> Array:
    """Weights w with Σ (w · upper(Q))² = ‖Q‖_F², shape (10,)."""
    return np.where(UPPER[0] == UPPER[1], 1.0, np.sqrt(2.0))


def link_weights(links: int, sigma: float | Array) -> Array:
    """Square roots of the prior precision of the coordinates y, shape (10 links,)."""
    each = np.broadcast_to(np.asarray(sigma, float), (links,))
    return np.concatenate([svec_weights() / s for s in each])


def link_coordinates(prior: Array) -> Array:
    """Map T from coordinates to standard parameters, φ = T y, shape (10 links, 10 links).

    The coordinates y are the upper triangles of all Q_k; the prior lies at Q = 1.

    Args:
        prior: Consistent standard parameters, shape (links, 10).
    """
    return np.asarray(scipy.linalg.block_diag(*(_block(values) for values in prior)), float)


def _block(values: Array) -> Array:
    L = np.linalg.cholesky(pseudo_inertia(values))
    columns = [from_pseudo_inertia(L @ unit @ L.T) for unit in _units()]
    return np.column_stack(columns)


def _units() -> Array:
    units = np.zeros((10, 4, 4))
    for k, (i, j) in enumerate(zip(*UPPER, strict=True)):
        units[k, i, j] = units[k, j, i] = 1.0
    return units


def plain_units(prior: Array) -> Array:
    """Units of standard parameters by each link's mass and size alone, shape (links, 10).

    m, m r and m r² with r the radius of gyration about the joint's frame, alike in all directions.

    Args:
        prior: Consistent standard parameters, shape (links, 10).
    """
    mass = prior[:, 0]
    radius = np.sqrt(np.trace(pseudo_inertia(prior)[:, :3, :3], axis1=1, axis2=2) / mass)
    return np.asarray(mass[:, None] * radius[:, None] ** np.array(_KINDS), float)


def matrices(y: Array, links: int) -> Array:
    """The matrices Q_k of the coordinates, shape (links, 4, 4)."""
    Q = np.zeros((links, 4, 4))
    Q[:, *UPPER] = y[: 10 * links].reshape(links, 10)
    return Q + np.triu(Q, 1).transpose(0, 2, 1)


def symmetric(start: int, size: int) -> Array:
    """Map from all coordinates to the 16 entries of one Q, shape (16, size)."""
    selection = np.zeros((4, 4, size))
    for k, (i, j) in enumerate(zip(*UPPER, strict=True)):
        selection[i, j, start + k] = selection[j, i, start + k] = 1.0
    return selection.reshape(16, size)


def slopes(G: Array) -> Array:
    """Gradient of Σ ⟨G_k, Q_k⟩ by the coordinates, G_k symmetric: (links, 4, 4) → (10 links,)."""
    return np.asarray((svec_weights() ** 2 * G[:, *UPPER]).ravel(), float)


def congruence(inverse: Array) -> Array:
    """Map from upper(Q) to what has the squares ‖K Q Kᵀ‖_F², K = inverse, shape (10, 10)."""
    columns = [(inverse @ unit @ inverse.T)[UPPER] for unit in _units()]
    return np.asarray(svec_weights()[:, None] * np.column_stack(columns), float)
