"""Essential parameters: the fewest base parameters that explain the data as well as all.

Backward elimination (Pham and Gautier 1991; Gautier and Venture 2013): the parameter of largest
relative standard deviation is set to zero and the others follow as the data want them to,

    β ← β − Σ e_k β_k / Σ_kk,   Σ ← Σ − Σ e_k e_kᵀ Σ / Σ_kk,

until that costs more than noise does. The squares β_k² / Σ_kk of the steps add up to Wald's
statistic of all that is dropped, β_Sᵀ Σ_SS⁻¹ β_S, which is χ² of as many degrees of freedom where
the dropped ones are zero indeed. Σ counts coloured noise, so slow structure in the residual does
not keep parameters alive.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from excitant.robots.motion import Array, freeze

_TOGETHER = 0.05  # probability by chance, of all dropped ones, below which elimination stops
_ALONE = 0.01  # of one of them


@dataclass(frozen=True, eq=False)
class Essential:
    """Which base parameters the data need.

    Attributes:
        kept: Indices of those that stay, in order.
        dropped: Indices of those set to zero, in the order of dropping.
        beta: Base parameters, zero where dropped, shape (r,).
        covariance: Of β, zero where dropped, shape (r, r).
        p_value: Probability of data that deny the dropped ones as much, where they are zero.
    """

    kept: tuple[int, ...]
    dropped: tuple[int, ...]
    beta: Array
    covariance: Array
    p_value: float

    def __post_init__(self) -> None:
        freeze(self, "beta", "covariance")


def essential_parameters(beta: Array, covariance: Array) -> Essential:
    """Drop parameters one by one as long as noise may have made them.

    Args:
        beta: Base parameters, shape (r,).
        covariance: Their covariance, shape (r, r).
    """
    unit = np.sqrt(np.diag(covariance))
    unit = np.where(unit > 0, unit, 1.0)
    b, S = beta / unit, covariance / np.outer(unit, unit)
    kept, dropped, statistic, p_value = list(range(len(beta))), list[int](), 0.0, 1.0
    while kept:
        variance = np.maximum(np.diag(S)[kept], 0.0)
        squares = np.divide(b[kept] ** 2, variance, out=np.full(len(kept), np.inf),
                            where=variance > 1e-12)  # fmt: skip
        k = kept[int(squares.argmin())]
        square = float(squares.min())
        together = float(scipy.stats.chi2.sf(statistic + square, len(dropped) + 1))
        if together < _TOGETHER or scipy.stats.chi2.sf(square, 1) < _ALONE:
            break
        b = b - S[:, k] * b[k] / S[k, k]
        S = S - np.outer(S[:, k], S[k]) / S[k, k]
        statistic, p_value = statistic + square, together
        kept.remove(k)
        dropped.append(k)
    b[dropped] = 0.0
    S[dropped] = 0.0
    S[:, dropped] = 0.0
    return Essential(tuple(kept), tuple(dropped), b * unit, S * np.outer(unit, unit), p_value)
