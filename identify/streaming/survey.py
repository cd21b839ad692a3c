"""Survey: what must be known of a log before its first sample can be prepared."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from excitant.robots.motion import Array, freeze

_REMEMBERED = 200_000  # steps; of longer logs every second, fourth, ... is remembered
_ALIKE = 1e-3  # of a step: steps that count for the mean
_SAME = 1e-7  # of a step: mean and median of a regular clock


@dataclass(frozen=True, eq=False)
class Survey:
    """Time of a log.

    Attributes:
        rows: Number of samples.
        start: Time of the first sample [s].
        end: Time of the last sample [s].
        t: Times at which remembered steps end, shape (m,) [s].
        steps: Those steps, shape (m,) [s].
        mean: Mean of all steps that are about as long as most; 0 without steps [s].
    """

    rows: int
    start: float
    end: float
    t: Array
    steps: Array
    mean: float

    def __post_init__(self) -> None:
        freeze(self, "t", "steps")

    def step(self, low: float, high: float) -> float:
        """Sampling period between two times, or of all where no step lies there [s].

        The median; where the clock is regular the mean, which does not drift over a long log.
        """
        inside = self.steps[(self.t - self.steps >= low) & (self.t < high)]
        median = float(np.median(inside if len(inside) else self.steps))
        return self.mean if abs(self.mean - median) <= _SAME * median else median

    def scaled(self, pace: float) -> Survey:
        """The same with all times multiplied."""
        return Survey(
            self.rows, pace * self.start, pace * self.end, pace * self.t, pace * self.steps,
            pace * self.mean,
        )  # fmt: skip


def survey(times: Iterable[Array]) -> Survey:
    """Survey of consecutive pieces of time, each of shape (n,) [s].

    Steps that no recording may have, backward or not finite, are left out: they are refused,
    with their row, where the samples are read.
    """
    rows, every, low, high = 0, 1, np.inf, -np.inf
    usual, total, count = 0.0, 0.0, 0
    t, steps, last = np.zeros(0), np.zeros(0), np.zeros(0)
    for piece in times:
        joined = np.concatenate([last, piece[np.isfinite(piece)]])
        rows, last = rows + len(piece), joined[-1:]
        found = np.diff(joined)
        kept = np.flatnonzero(found > 0)
        if not len(kept):
            continue
        low, high = min(low, float(joined.min())), max(high, float(joined.max()))
        usual = usual or float(np.median(found[kept]))
        alike = found[np.abs(found - usual) <= _ALIKE * usual]
        total, count = total + float(alike.sum()), count + len(alike)
        t, steps = np.append(t, joined[1:][kept[::every]]), np.append(steps, found[kept[::every]])
        while len(steps) > _REMEMBERED:
            every, t, steps = 2 * every, t[::2], steps[::2]
    return Survey(rows, low, high, t, steps, total / max(count, 1))
