"""Rows at which a joint rests say nothing of dry friction; a reversal does."""

from __future__ import annotations

import numpy as np
import pytest

from excitant.analysis.residuals import moving
from excitant.identify.preprocessing import Segment
from excitant.robots import Motion

RATE, CUTOFF = 200.0, 10.0
REACH_S = 0.5 / CUTOFF  # how far the torque filter carries a rest


def segment(dq: np.ndarray, keep: slice = slice(None), rate: float = RATE) -> Segment:
    t = np.arange(len(dq)) / rate
    q = np.cumsum(dq, axis=0) / rate
    motion = Motion(t, q, dq, np.gradient(dq, t, axis=0))
    return Segment("run", motion, 0 * q, 0 * q, CUTOFF, keep)


def sine(seconds: float, amplitude: float = 1.0, rate: float = RATE) -> np.ndarray:
    """Reverses at every half second, as quickly as a sine does."""
    t = np.arange(0, seconds, 1 / rate)
    return np.asarray(amplitude * np.cos(2 * np.pi * t + 0.3))[:, None]


@pytest.mark.parametrize("rate", [100.0, 200.0, 1000.0])
def test_a_quick_reversal_counts(rate: float) -> None:
    dq = sine(4.0, rate=rate)
    assert (np.diff(np.sign(dq[:, 0])) != 0).sum() == 8
    assert moving([segment(dq, rate=rate)]).all()


@pytest.mark.parametrize("creep", [0.0, 0.005])
def test_a_rest_does_not_count_as_far_as_the_filter_carries_it(creep: float) -> None:
    dq, n = sine(4.0), round(REACH_S * RATE)
    rest = slice(300, 360)  # 0.3 s
    dq[rest] = creep
    counts = moving([segment(dq)])[:, 0]
    assert not counts[300 - n : 360 + n].any()
    far = np.r_[0 : 300 - n - 3, 360 + n + 3 : len(dq)]  # the sine itself is slow for a moment
    assert counts[far].all()


def test_a_short_stop_counts_and_a_longer_one_does_not() -> None:
    for samples, counted in ((5, True), (12, False)):  # 25 ms, 60 ms
        dq = np.ones((400, 1))
        dq[200 : 200 + samples] = 0.0
        assert moving([segment(dq)]).all() == counted


def test_each_joint_rests_by_itself_and_by_its_own_speed() -> None:
    dq = np.hstack([sine(4.0), sine(4.0, 1e-3), sine(4.0)])
    dq[400:500, 2] = 0.0
    counts = moving([segment(dq)])
    assert counts[:, :2].all()  # a slow joint is not one at rest
    assert not counts[400:500, 2].any()


def test_the_fastest_motion_is_that_of_all_segments() -> None:
    fast, slow = sine(2.0), sine(2.0, 0.01)
    assert moving([segment(slow)]).all()
    counts = moving([segment(fast), segment(slow)])[:, 0]
    assert counts[: len(fast)].all()
    assert not counts[len(fast) :].any()


def test_rows_are_those_that_are_kept() -> None:
    dq = sine(4.0)
    dq[300:400] = 0.0
    whole = moving([segment(dq)])
    keep = slice(20, -20, 5)
    assert np.array_equal(moving([segment(dq, keep)]), whole[keep])
    both = moving([segment(dq, keep), segment(dq)])
    assert np.array_equal(both, np.vstack([whole[keep], whole]))
