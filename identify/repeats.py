"""Agreement of several recordings of one arm on its base parameters.

With the information Λ_r = W_rᵀ W_r of each recording (rows weighted as in the fit of all, so that
their noise has unit variance) and Λ = Σ Λ_r, the score s_r = W_rᵀ (τ_r − W_r β̂) of recording r has
the covariance Λ_r − Λ_r Λ⁻¹ Λ_r where all recordings are of one model and one noise. So
s_rᵀ (Λ_r − Λ_r Λ⁻¹ Λ_r)⁺ s_r is χ²: its root over the degrees of freedom is by how many of their
standard errors the estimates of r are off, rms. What recordings say apart, whether or not each
shows all parameters, is their spread: Λ⁻¹ (Σ s_r s_rᵀ) Λ⁻¹ m / (m − 1), m recordings, is the
covariance of β̂ whatever differs between them (Liang and Zeger 1986).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
import scipy

from excitant.exceptions import RankDeficient
from excitant.identify.least_squares import LeastSquares, weighted_least_squares
from excitant.identify.preprocessing import Segment
from excitant.identify.regression import Regression
from excitant.robots.motion import Array, freeze

FALSE_ALARM = 0.01  # of recordings of one arm, called different
RANK = 1e-9  # eigenvalue over the largest, up to which a recording shows nothing


@dataclass(frozen=True, eq=False)
class Repeats:
    """Whether recordings agree.

    Attributes:
        recordings: Their names, m of them.
        deviation: By how many of their standard errors the estimates of each are off, rms over
            what it shows, shape (m,); about 1 where noise is all that differs, NaN where it shows
            nothing.
        chance: Of deviations so large where noise is all that differs.
        spread: Standard deviation of each base parameter by what recordings say apart, (r,).
    """

    recordings: tuple[str, ...]
    deviation: Array
    chance: float
    spread: Array

    def __post_init__(self) -> None:
        freeze(self, "deviation", "spread")

    @property
    def differ(self) -> bool:
        """Whether the recordings differ by more than their noise."""
        return self.chance < FALSE_ALARM

    def sentence(self, std: Array) -> str:
        """Whether they agree, in words; std is that of the base parameters, shape (r,)."""
        if not self.differ:
            return f"the {len(self.recordings)} recordings agree within their noise"
        worst = int(np.nanargmax(self.deviation))
        ratio = self.spread / np.maximum(std, np.finfo(float).tiny)
        return (
            f"the recordings differ by more than their noise, most {self.recordings[worst]} (its "
            f"estimates by {self.deviation[worst]:.2g} of their standard errors, rms): base "
            f"parameters spread by {np.nanmedian(ratio):.2g} times their ± (median; worst "
            f"{np.nanmax(ratio):.2g}), which counts noise alone"
        )

    def entry(self) -> list[dict[str, Any]]:
        """Its entry in ``result.json``."""
        pairs = zip(self.recordings, self.deviation.tolist(), strict=True)
        return [{"recording": name, "deviation": size} for name, size in pairs]


def repeats_of(
    problem: Regression, fit: LeastSquares, segments: Sequence[Segment]
) -> Repeats | None:
    """Whether the recordings behind the rows of a fit agree; None of a single one."""
    parts = {name: problem.at(rows) for name, rows in recordings_in(segments)}
    names = tuple(parts)
    if len(names) < 2:
        return None
    weight = noise_within(parts.values(), fit)
    information = {}
    scores = {}
    for name, part in parts.items():
        R, z = part.factor(weight)
        information[name] = R.T @ R
        scores[name] = R.T @ (z - R @ fit.beta)
    total = np.sum(list(information.values()), axis=0)
    unit = 1 / np.sqrt(np.diag(total))
    inverse = np.linalg.inv(total * np.outer(unit, unit))
    off = np.zeros(len(names))
    freedom = np.zeros(len(names))
    for k, name in enumerate(names):
        own = information[name] * np.outer(unit, unit)
        values, vectors = scipy.linalg.eigh(own - own @ inverse @ own)
        shown = values > RANK * max(values[-1], RANK)
        seen = (vectors.T @ (unit * scores[name]))[shown]
        off[k] = (seen**2 / values[shown]).sum()
        freedom[k] = shown.sum()
    steps = np.array([unit * (inverse @ (unit * s)) for s in scores.values()])
    m = len(names)
    # of m scores that sum to zero, m − 1 are independent
    independent = (m - 1) / m
    chance = scipy.special.chdtrc(
        independent * freedom.sum(), independent * off.sum()
    )
    nothing = np.full(m, np.nan)
    return Repeats(
        names,
        np.sqrt(np.divide(off, freedom, out=nothing, where=freedom > 0)),
        float(chance),
        np.sqrt((steps**2).sum(axis=0) * m / (m - 1)),
    )


def recordings_in(segments: Sequence[Segment]) -> Iterator[tuple[str, slice]]:
    """The rows of each recording, whose segments follow each other, by its name."""
    end = 0
    for name, own in groupby(segments, lambda s: s.name):
        begin = end
        end += sum(len(s.t) for s in own)
        yield name, slice(begin, end)


def noise_within(parts: Iterable[Regression], fit: LeastSquares) -> Array:
    """Weights of joints' rows by the noise of recordings that show all parameters alone, (nv,).

    That around the estimate of all holds what recordings differ by, too; it counts where there is
    no such recording.
    """
    noise = []
    rows = []
    for part in parts:
        with suppress(RankDeficient):
            noise.append(weighted_least_squares(part).weight ** -2.0)
            rows.append(len(part))
    if not rows:
        return fit.weight
    return np.asarray(np.average(noise, axis=0, weights=rows) ** -0.5, float)
