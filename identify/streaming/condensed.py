"""Condensed rows: triangular factors that stand for all rows of a log, block by block.

‖W_j β − τ_j‖² = ‖R_j [β; −1]‖² for the triangle R_j of [W_j, τ_j], so that fits, noise levels and
accuracies need nothing else. Triangles of consecutive blocks of rows are kept apart, because the
spread of their scores Wᵀ ε tells how coloured the noise is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from excitant.identify.accuracy import Accuracy
from excitant.identify.streaming.columns import GIVEN, ONE, RAW, TAU, Layout
from excitant.robots.motion import Array, freeze, read_only

_SHORTEST = 50  # rows, 12 periods of the cut-off: longer than the memory of filtered noise
_MOST = 128  # blocks; then two become one


@dataclass(frozen=True, eq=False)
class Condensed:
    """As few rows as have the same sums of products as n rows of every joint.

    Attributes:
        n: Number of rows they stand for.
        W: Base columns, shape (m, nv, r).
        given: Torque of the given robot's own effects, shape (m, nv) [N·m].
        one: What has become of ones, shape (m, nv).
        tau: Filtered torque, shape (m, nv) [torque unit].
        raw: Unfiltered torque, shape (m, nv) [torque unit].
    """

    n: int
    W: Array
    given: Array
    one: Array
    tau: Array
    raw: Array

    def __post_init__(self) -> None:
        freeze(self, "W", "given", "one", "tau", "raw")

    @property
    def spread(self) -> Array:
        """Standard deviation of the filtered torque, shape (nv,) [torque unit]."""
        mean = (self.one * self.tau).sum(axis=0) / self.n
        return np.asarray(np.sqrt(((self.tau - mean * self.one) ** 2).sum(axis=0) / self.n), float)

    def accuracy(self, predicted: Array) -> Accuracy:
        """Accuracy of a prediction at these rows, shape (m, nv) [torque unit]."""
        rms, raw = (
            np.sqrt(((measured - predicted) ** 2).sum(axis=0) / self.n)
            for measured in (self.tau, self.raw)
        )
        spread = self.spread
        nrmse = np.divide(rms, spread, out=np.full_like(rms, np.nan), where=spread > 0)
        return Accuracy(*(read_only(v) for v in (rms, raw, nrmse, 1 - nrmse**2)))


def condensed(layout: Layout, triangles: Sequence[Array], n: int) -> Condensed:
    """Condensed rows from one triangle per joint, columns as in `window_rows`."""
    m, nv = max(len(R) for R in triangles), len(triangles)
    W, rest = np.zeros((m, nv, len(layout.base))), np.zeros((4, m, nv))
    for j, (R, used) in enumerate(zip(triangles, layout.used, strict=True)):
        W[: len(R), j, used] = R[:, : len(used)]
        rest[:, : len(R), j] = R[:, [GIVEN, ONE, TAU, RAW]].T
    return Condensed(n, W, *rest)


class Blocks:
    """Triangles of consecutive blocks of rows, at most so many whatever the number of rows.

    Attributes:
        n: Number of rows taken in.
    """

    def __init__(self, layout: Layout) -> None:
        self._layout, self.n = layout, 0
        self._size = _SHORTEST
        self._full: list[list[Array]] = []
        self._open = [np.empty((0, len(used) + 4)) for used in layout.used]
        self._waiting = 0

    def take(self, rows: Sequence[Array]) -> None:
        """Take in rows of every joint, columns as in `window_rows`."""
        start, count = 0, len(rows[0])
        while start < count:
            stop = min(count, start + self._size - self._waiting)
            self._open = [
                _triangle(R, new[start:stop]) for R, new in zip(self._open, rows, strict=True)
            ]
            self._waiting += stop - start
            start = stop
            if self._waiting == self._size:
                self._close()
        self.n += count

    def _close(self) -> None:
        self._full.append(self._open)
        self._open, self._waiting = [R[:0] for R in self._open], 0
        if len(self._full) == _MOST:
            pairs = zip(self._full[::2], self._full[1::2], strict=True)
            self._full = [[_triangle(A, B) for A, B in zip(*pair, strict=True)] for pair in pairs]
            self._size *= 2

    def whole(self) -> Condensed:
        """All rows."""
        parts = [*self._full, self._open]
        triangles = [_triangle(*(part[j] for part in parts)) for j in range(len(self._open))]
        return condensed(self._layout, triangles, self.n)

    def each(self) -> list[Condensed]:
        """Every block; rows that do not fill one belong to the last."""
        full = list(self._full)
        sizes = [self._size] * len(full)
        if self._waiting and not full:
            full, sizes = [self._open], [self._waiting]
        elif self._waiting:
            full[-1] = [_triangle(A, B) for A, B in zip(full[-1], self._open, strict=True)]
            sizes[-1] += self._waiting
        return [condensed(self._layout, R, n) for R, n in zip(full, sizes, strict=True)]


def _triangle(*parts: Array) -> Array:
    """Triangle of rows one below the other."""
    return np.asarray(np.linalg.qr(np.concatenate(parts), mode="r"), float)
