"""Covariance of streamed least squares: the spread of the scores of long blocks.

The scores s_b = W_bᵀ ε_b of consecutive blocks, much longer than the memory of the noise, are
nearly independent, so that Ω = Σ_b s_b s_bᵀ whatever the colour (batch means; block by block the
covariance of Liang and Zeger 1986). Residuals lack what the fit took: block b a share
H_b = A⁻ᵀᐟ² A_b A⁻¹ᐟ² of the noise, which (1 − H_b)⁻¹ᐟ² gives back (Bell and McCaffrey 2002).
In memory, `excitant.identify.coloured_noise` fits an autoregression instead; that needs all rows
at once. What is the same in every block, a model error that repeats with the motion, is bias and
not noise to this one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from excitant.identify.least_squares import Factor
from excitant.identify.streaming.condensed import Condensed
from excitant.robots.motion import Array

_LARGEST_SHARE = 0.99  # that the fit may take of a block's noise, as far as it is given back
_FEWEST = 3.0  # degrees of freedom, below which no noise is known


def block_scores(
    blocks: Sequence[Condensed], gains: Array, factor: Factor, inverse: Array, beta: Array
) -> tuple[Array, Array]:
    """Covariance Ω_j of the scores of each joint, shape (nv, r, r), and degrees of freedom, (nv,).

    Args:
        blocks: Blocks of the rows that were fitted.
        gains: Torque per reading, shape (nv,).
        factor: Factorisation of all of them; scores are those of its columns.
        inverse: R⁻¹ of the factorisation, A⁻¹ = R⁻¹ R⁻ᵀ.
        beta: The estimate, shape (r,).
    """
    nv, r = len(factor.weight), len(beta)
    found = np.zeros((nv, r, r))
    for block in blocks:
        X = block.W / factor.weight[:, None] / factor.norms
        error = (block.tau * gains - block.W @ beta) / factor.weight
        scores = np.einsum("mjr,mj->jr", X, error)
        share, V = np.linalg.eigh(np.einsum("mjr,mjs->rs", X @ inverse, X @ inverse, optimize=True))
        root = V / np.sqrt(1 - np.clip(share, 0, _LARGEST_SHARE))
        whitened = scores @ inverse @ root @ V.T
        given_back = np.linalg.solve(inverse.T, whitened.T).T
        found += given_back[:, :, None] * given_back[:, None, :]
    return found, np.full(nv, max(len(blocks) - 1.0, _FEWEST))
