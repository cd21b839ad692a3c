"""How many runs tell two causes apart, given how far one run drives them apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.stats

POWER, LEVEL = 0.9, 0.05
MOST_RUNS = 10
_ALIKE, _ALIKE_LEVEL = 0.9, 0.001  # |cos| of signatures that `diagnose` takes more for, and what


@dataclass(frozen=True)
class Separation:
    """How far a motion drives two causes apart.

    Attributes:
        delta: Δ in squared standard deviations of the noise.
        cosine: Between the one cause's torque and the best that the other makes of it.
        repetitions: Runs after which `diagnose` decides, with probability `POWER`; None where
            `MOST_RUNS` are not enough.
    """

    delta: float
    cosine: float
    repetitions: int | None

    @property
    def deviations(self) -> float:
        """√Δ: by how many standard deviations the two differ."""
        return float(np.sqrt(max(self.delta, 0.0)))

    @property
    def enough(self) -> bool:
        """Whether `diagnose` decides, at a stricter level where both still look alike."""
        return self.delta >= needed(level=_ALIKE_LEVEL if self.cosine > _ALIKE else LEVEL)


def repetitions(delta: float, power: float = POWER, level: float = LEVEL) -> int:
    """Runs that tell two causes apart with this probability at this level.

    Both are compared by the squared error that each leaves (Vuong 1989). The difference has mean
    N Δ and standard deviation 2 √(N Δ), so N = 4 (z_{level/2} + z_{1−power})² / Δ.
    """
    return max(1, int(np.ceil(needed(power, level) / max(delta, 1e-9) - 1e-9)))


def needed(power: float = POWER, level: float = LEVEL) -> float:
    """Δ at which one run is enough."""
    z = scipy.stats.norm.isf(level / 2) + scipy.stats.norm.isf(1 - power)
    return float(4 * z**2)
