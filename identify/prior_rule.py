"""When an identified entry counts as the prior's: one rule for all that say so.

The prior x = x̄ + L w, w of unit variance, is moved where the data are silent (the null space of
R L), along what they show worst, and at random. An entry is the prior's when it follows by more
than half in any of these ways that is material to it: that reaches at least a quarter of its
uncertainty. A small standard deviation is no proof that data decide: entries that torque shows in
combination only lose most of theirs and still follow the prior along the rest.

In linear theory, without the constraints of physics, the estimate moves by L V (1 + s²)⁻¹ Vᵀ w,
where R L = U diag(s) Vᵀ; `excitant.analysis.prior_influence` repeats the fit instead.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from excitant.robots.motion import Array

KINDS = ("null space", "weakly seen", "random")
DOMINATED = 0.5  # influence from which an entry counts as the prior's
WEAKEST = 4  # directions seen worst, of all seen
UNSEEN = 1e-9  # singular value relative to the largest, up to which a direction is not seen
_MATERIAL = 0.25  # of an entry's uncertainty: less means a move of less than 5 % of the entry
_SILENT = 1e-11  # norm of a column relative to the largest; below it is rounding


def follows(ratio: Array, reach: Array) -> Array:
    """Largest ratio of the kinds that reach a material part of an entry, at most 1, shape (p,).

    Args:
        ratio: Move of each entry relative to that of its prior, shape (kinds, p); NaN where a kind
            leaves the entry's prior as it is.
        reach: Share of each entry's uncertainty that a kind reaches, shape (kinds, p).
    """
    counted = np.where((reach >= _MATERIAL) & np.isfinite(ratio), ratio, 0.0)
    return np.asarray(np.clip(counted.max(axis=0), 0.0, 1.0), float)


def reached(L: Array, directions: Array, x: Array, links: int) -> Array:
    """Share of each entry's uncertainty in some directions of w, at most 1, shape (p,).

    An effect has no prior value; its estimate is what a share of it is compared with.

    Args:
        L: Root of the prior covariance, shape (p, k).
        directions: Orthonormal rows, shape (d, k).
        x: Estimate, shape (p,).
        links: Number of links, whose ten parameters come first.
    """
    spread, size = np.linalg.norm(L @ directions.T, axis=1), np.linalg.norm(L, axis=1)
    effects = slice(10 * links, None)
    size[effects] = np.minimum(size[effects], np.abs(x[effects]) + 1e-6 * size[effects])
    known = np.divide(spread, size, out=np.zeros_like(size), where=size > 0)
    return np.asarray(np.minimum(known, 1.0), float)


def silent_columns(R: Array) -> npt.NDArray[np.bool_]:
    """Columns that make no torque, shape (p,)."""
    norms = np.linalg.norm(R, axis=0)
    return np.asarray(norms <= _SILENT * norms.max(initial=0.0))


def linear_influence(R: Array, L: Array, x: Array, links: int) -> Array:
    """How far each entry follows the prior in linear theory, 0 to 1, shape (p,).

    An entry that is known exactly beforehand follows by 1.

    Args:
        R: Factor of the whitened columns, shape (rows, p).
        L: Root of the prior covariance, shape (p, k).
        x: Estimate, shape (p,).
        links: Number of links, whose ten parameters come first.
    """
    _, s, Vt = np.linalg.svd(R @ L)
    s = np.pad(s, (0, len(Vt) - len(s)))
    seen = s > UNSEEN * s.max(initial=0.0)
    moves, sizes = L @ Vt.T / (1 + s**2), np.linalg.norm(L, axis=1)
    weak = np.flatnonzero(seen)[-WEAKEST:]
    reach = np.array(
        [reached(L, Vt[~seen], x, links), reached(L, Vt[weak], x, links), np.zeros(len(x))]
    )
    reach[0, silent_columns(R)] = 1.0
    reach[2, : 10 * links] = 1.0
    along = np.linalg.norm((L @ Vt.T)[:, weak], axis=1)
    ratio = np.ones((3, len(x)))
    ratio[1] = _share(np.linalg.norm(moves[:, weak], axis=1), along)
    ratio[2] = _share(np.linalg.norm(moves, axis=1), sizes)
    return np.asarray(np.where(sizes > 0, follows(ratio, reach), 1.0), float)


def _share(part: Array, whole: Array) -> Array:
    return np.asarray(np.divide(part, whole, out=np.zeros_like(part), where=whole > 0), float)
