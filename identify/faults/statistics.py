"""How large a statistic may get by chance in a recording of many samples."""

from __future__ import annotations

import numpy as np
import scipy.ndimage
import scipy.stats

from excitant.identify.faults.fault import ALARM
from excitant.robots.motion import Array

_QUANTILES = (0.5, 0.9)


def tail_bound(values: Array, alarm: float = ALARM) -> float:
    """Level that the largest of the values exceeds by chance with probability ``alarm``.

    Their distribution is taken to fall off beyond its 90 % quantile like exp(−√z), as fast as
    between the median and there: far heavier than Gaussian, as dry friction, impacts and
    jitter of stamps make it, and blind to up to a tenth of outliers.

    Args:
        values: Magnitudes, shape (n,).
        alarm: Probability.
    """
    if not len(values):
        return np.inf
    low, high = np.sqrt(np.quantile(values, _QUANTILES))
    decay = (high - low) / np.log((1 - _QUANTILES[0]) / (1 - _QUANTILES[1]))
    return float((high + decay * max(np.log((1 - _QUANTILES[1]) * len(values) / alarm), 0.0)) ** 2)


def normal_bound(tests: int, alarm: float = ALARM) -> float:
    """Level that the largest of many standard normal variables exceeds by chance."""
    return float(scipy.stats.norm.isf(alarm / (2 * max(tests, 1))))


def local_scale(values: Array, half: int = 50) -> Array:
    """Running median of magnitudes, no less than a fifth of the upper quartile of all."""
    size = np.abs(values)
    running = scipy.ndimage.median_filter(size, size=min(2 * half + 1, len(size)), mode="nearest")
    return np.asarray(np.maximum(running, 0.2 * np.quantile(size, 0.75)), float)


def run_lengths(same: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Starts and lengths of the runs of True in a boolean array."""
    edges = np.diff(np.concatenate([[0], same.astype(np.int8), [0]]))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return starts, ends - starts
