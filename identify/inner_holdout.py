"""Training data left out in turn, and what estimators predict there.

Instants are left out in blocks: stretches of time, or, where the motion repeats, stretches of the
period in all periods at once, so that what is predicted has not been seen in another period.

A residual on noisy columns W + V rewards the wrong estimate: E ‖τ − (W + V) β‖² is smallest for
the β of least squares, whose bias makes good for the very noise of V. With two looks at one motion
whose errors V₁ and V₂ are independent,

    E (τ − (W + V₁) β)ᵀ (τ − (W + V₂) β) = ‖W (β₀ − β)‖² + E ‖ε‖²,

the squared error of the torque on the true motion and a noise that is the same for all β: the
errors of the motion have no part in it. They widen its spread, so that positions of looks pass a
filter that ends where the motion does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import scipy.ndimage

from excitant.identify.estimators.regression import Estimator, Regression
from excitant.identify.periods import Periods
from excitant.robots.motion import Array

BLOCKS = 10
FOLDS = 5  # blocks are left out two at a time, far from each other
_GAP = 4  # rows beside what is left out: a period of the cut-off
_SMALLEST = 1e-6  # of the variance of torque: errors are not told apart below a thousandth

Indices = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class InnerHoldout:
    """Blocks of instants and what is to be predicted there.

    Attributes:
        tau: Torque, shape (n, nv) [torque unit].
        looks: Columns on the motion, each of shape (n, nv, r): one, or two with errors of their
            own.
        blocks: Instants of each block.
        used: Whether an instant counts, evenly thinned, shape (n,).
    """

    tau: Array
    looks: tuple[Array, ...]
    blocks: tuple[Indices, ...]
    used: Mask

    @property
    def folds(self) -> list[list[int]]:
        """Blocks that are left out together."""
        count = min(FOLDS, len(self.blocks))
        return [list(range(k, len(self.blocks), count)) for k in range(count)]

    def near(self, out: Sequence[int]) -> Mask:
        """Instants in or beside blocks, shape (n,)."""
        gone = np.zeros(len(self.tau), bool)
        gone[np.concatenate([self.blocks[b] for b in out])] = True
        return np.asarray(scipy.ndimage.maximum_filter1d(gone, 2 * _GAP + 1), dtype=np.bool_)

    def errors(self, block: int, beta: Array) -> Array:
        """Mean square errors of joints in one block, shape (nv,)."""
        at = self.blocks[block][self.used[self.blocks[block]]]
        first = self.tau[at] - self.looks[0][at] @ beta
        second = first if len(self.looks) == 1 else self.tau[at] - self.looks[1][at] @ beta
        return np.asarray((first * second).mean(axis=0), float)

    def unit(self, errors: Array) -> Array:
        """What falls of errors are relative to, positive though products may be below, (nv,).

        Args:
            errors: Those of the default in all blocks, shape (blocks, nv).
        """
        tiny = np.finfo(float).tiny
        return np.asarray(np.maximum(errors.mean(axis=0), _SMALLEST * self.tau.var(axis=0) + tiny))


@dataclass(frozen=True, eq=False)
class Entrant:
    """An estimator with rows of its own.

    Attributes:
        rows: What it is fitted to.
        at: The instant of the hold-out that each row stands for, shape (m,).
        estimator: How.
    """

    rows: Regression
    at: Indices
    estimator: Estimator

    def without(self, gone: Mask) -> Regression:
        """The rows at instants that are not gone; what is side by side is one segment."""
        return some_rows(self.rows, ~gone[self.at])

    def thinned(self, used: Mask) -> Entrant:
        """Only the rows at instants that count, those of a segment still side by side."""
        kept = np.flatnonzero(used[self.at])
        starts = np.unique(np.searchsorted(kept, self.rows.starts))
        return replace(
            self,
            rows=of_instants(self.rows, kept, tuple(int(k) for k in starts if k < len(kept))),
            at=self.at[kept],
        )


def some_rows(rows: Regression, keep: Mask) -> Regression:
    """Some instants of a regression; a new segment begins after each that is missing."""
    at = np.flatnonzero(keep)
    segment = np.searchsorted(rows.starts, at, side="right") - 1
    first = (np.diff(at, prepend=-2) > 1) | (np.diff(segment, prepend=-1) > 0)
    return of_instants(rows, at, tuple(int(k) for k in np.flatnonzero(first)))


def of_instants(rows: Regression, at: Indices, starts: tuple[int, ...]) -> Regression:
    """A regression at some of its instants, with segments that start there."""
    segment = np.searchsorted(rows.starts, at[list(starts)], side="right") - 1
    return replace(
        rows,
        W=rows.W[at],
        tau=rows.tau[at],
        instruments=None if rows.instruments is None else rows.instruments[at],
        noise=None if rows.noise is None else rows.noise[segment],
        starts=starts,
    )


def unseen_errors(entrant: Entrant, holdout: InnerHoldout) -> Array:
    """Errors in blocks, each predicted by a fit to others, shape (blocks, nv)."""
    errors = np.empty((len(holdout.blocks), holdout.tau.shape[1]))
    for out in holdout.folds:
        beta = entrant.estimator(entrant.without(holdout.near(out))).beta
        for b in out:
            errors[b] = holdout.errors(b, beta)
    return errors


def stretches(segments: Sequence[slice]) -> tuple[Indices, ...]:
    """Blocks of consecutive instants, none over the border of a segment."""
    found: list[Indices] = []
    for part in segments:
        rows = np.arange(part.start, part.stop)
        found += np.array_split(rows, _count(part, segments[-1].stop))
    return tuple(found)


def phases(
    segments: Sequence[slice], times: Sequence[Array], periods: Sequence[Periods]
) -> tuple[Indices, ...]:
    """Blocks of instants at like phases of a motion that repeats.

    Args:
        segments: Instants of each segment.
        times: Time of these, one array for each segment [s].
        periods: What repeats in each.
    """
    found: list[Indices] = []
    for part, t, own in zip(segments, times, periods, strict=True):
        count = _count(part, segments[-1].stop)
        block = (phase(t, own) * count).astype(int)
        parts = (part.start + np.flatnonzero(block == b) for b in range(count))
        found += [rows for rows in parts if len(rows)]
    return tuple(found)


def phase(t: Array, periods: Periods) -> Array:
    """Where in its period a motion is at a time, from 0 to below 1, shape (n,)."""
    return np.asarray(np.mod((t - periods.start) / periods.period, 1.0) % 1.0, float)


def every(segments: Sequence[slice], most: int) -> Mask:
    """So many instants of each segment, evenly taken, that they are not too many, shape (n,)."""
    n = segments[-1].stop
    used, stride = np.zeros(n, bool), -(-n // most)
    for part in segments:
        used[part.start : part.stop : stride] = True
    return used


def _count(part: slice, n: int) -> int:
    """Blocks of a segment of n instants in all."""
    share = float(part.stop - part.start) / n
    return max(1, round(BLOCKS * share))
