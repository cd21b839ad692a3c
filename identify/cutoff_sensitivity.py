"""How the result depends on the cut-off: the fit repeated at others, judged at the common one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from excitant.identify.accuracy import Series
from excitant.identify.cutoff_rows import Bank, weighted_fit
from excitant.identify.cutoff_study import FACTORS, Study
from excitant.robots.motion import Array, freeze


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Weighted least squares at other cut-offs, by k factors of the chosen ones.

    Attributes:
        factors: Factors, shape (k,).
        rms: Errors on the hold-out, at the common cut-off, shape (k, nv) [torque unit].
        nrmse: The same over the standard deviation of the measured torque, shape (k, nv).
        moved: Largest change of a base parameter in its standard deviations, shape (k,).
        parameters: The parameter that changed so, k expressions; empty for the factor of one.
    """

    factors: tuple[float, ...]
    rms: Array
    nrmse: Array
    moved: Array
    parameters: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze(self, "rms", "nrmse", "moved")


def sensitivity(study: Study, W: Array, unseen: Series, std: Array) -> Sensitivity:
    """The fit at other cut-offs; those that no rows are there for are left out.

    Args:
        study: Rows at any cut-off, and the cut-offs chosen.
        W: Columns of the base parameters on the hold-out, shape (n, nv, r).
        unseen: The hold-out.
        std: Standard deviations of the base parameters, shape (r,).
    """
    rows, choice = study.rows, study.choice
    cutoffs_hz, moving = choice.cutoffs_hz, choice.dead_zone
    factors, betas = [], []
    for factor in FACTORS:
        able = [
            bank
            for bank in study.banks
            if factor * cutoffs_hz.max() <= bank.highest_hz * (1 + 1e-9)
        ]
        if able:
            factors.append(factor)
            betas.append(_fitted(able[0], factor * cutoffs_hz, moving))
    accuracies = [unseen.accuracy(W @ beta / rows.gains) for beta in betas]
    moves = np.abs(np.array(betas) - betas[factors.index(1.0)]) / std
    return Sensitivity(
        tuple(factors),
        np.array([a.rms for a in accuracies]),
        np.array([a.nrmse for a in accuracies]),
        moves.max(axis=1),
        tuple(rows.base.expressions[int(m.argmax())] if m.any() else "" for m in moves),
    )


def _fitted(rows: Bank, hz: Array, moving: bool) -> Array:
    grams = [rows.grams(j, float(f), moving).sum(axis=0) for j, f in enumerate(hz)]
    return weighted_fit(np.array(grams), float(rows.counts.sum()))
