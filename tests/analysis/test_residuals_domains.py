"""Where an error shows: what is planted in one quantity is told by that quantity."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from excitant.analysis.residuals import (
    BANDS,
    QUANTITIES,
    Explanatory,
    band_shares,
    dominant,
    explanatory,
    shares,
    since_reversal,
)
from excitant.identify.preprocessing import Segment
from excitant.robots import Motion

RATE, SECONDS = 200.0, 60.0
SLOW, FAST = 0.2, 0.6  # Hz: harmonics of the motion


def motion(phase: float = 0.0) -> Motion:
    t = np.arange(0, SECONDS, 1 / RATE)
    w, size = 2 * np.pi * np.array([SLOW, FAST]), np.array([0.8, 0.3])
    angle = np.outer(t, w) + np.array([phase, 1.0])
    q, dq, ddq = (
        (size * f).sum(axis=1)[:, None]
        for f in (np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle))
    )
    return Motion(t, q, dq, ddq)


def where(load: Callable[[Motion], np.ndarray] = lambda m: m.q) -> Explanatory:
    m = motion()
    tau = np.zeros_like(m.q)
    segment = Segment("run", m, tau, tau, 10.0, slice(20, -20, 5))
    return explanatory([segment], load(m)[segment.keep])


def shared(error: np.ndarray, at: Explanatory) -> dict[str, float]:
    return shares(error, at, 0, np.ones(len(error), bool))


PLANTED = {
    "constant": lambda at: np.ones(len(at.position)),
    "direction": lambda at: np.sign(at.velocity[:, 0]),
    "velocity": lambda at: at.velocity[:, 0] * np.abs(at.velocity[:, 0]),
    "position": lambda at: np.sin(2 * at.position[:, 0]),
    "load": lambda at: np.abs(at.load[:, 0]) * np.sign(at.velocity[:, 0]),
    "reversal": lambda at: np.sign(at.velocity[:, 0]) * np.exp(-np.abs(at.reversal[:, 0]) / 0.02),
    "time": lambda at: np.linspace(-1, 1, len(at.position)),
}


@pytest.mark.parametrize("name", QUANTITIES)
def test_what_is_planted_is_told(name: str) -> None:
    rng = np.random.default_rng(0)
    at = where(lambda m: np.repeat(rng.uniform(1, 20, 60), RATE)[: len(m.q), None])
    error = PLANTED[name](at)
    noise = 0.3 * error.std() if error.std() > 0 else 0.3
    found = shared(error + noise * rng.standard_normal(len(error)), at)
    assert dominant(found) == name
    assert found[name] > 0.7


def test_noise_goes_with_nothing() -> None:
    at = where()
    found = shared(np.random.default_rng(1).standard_normal(len(at.position)), at)
    assert max(found.values()) < 0.05
    assert dominant(found) == ""


def test_shares_do_not_depend_on_the_unit() -> None:
    at = where()
    error = PLANTED["velocity"](at) + np.random.default_rng(2).standard_normal(len(at.position))
    one, other = shared(error, at), shared(1e3 * error, at)
    assert one == pytest.approx(other)


def test_a_trend_is_not_judged_on_a_motion_that_hardly_repeats() -> None:
    m = motion()[: int(RATE / SLOW)]
    tau = np.zeros_like(m.q)
    segment = Segment("run", m, tau, tau, 10.0, slice(None))
    at = explanatory([segment], tau)
    assert "time" not in shared(np.linspace(-1, 1, len(m)), at)


def test_the_motion_lies_in_its_band() -> None:
    low, high = where().bands[0]
    assert low == pytest.approx(SLOW, abs=0.05)
    assert high == pytest.approx(FAST, abs=0.05)


@pytest.mark.parametrize(("hz", "band"), [(0.05, "slower"), (0.4, "motion"), (3.0, "faster")])
def test_an_error_lies_in_the_band_of_its_frequency(hz: float, band: str) -> None:
    at = where()
    t = at.steps[0] * np.arange(at.lengths[0])
    found = band_shares(np.sin(2 * np.pi * hz * t) + 7.0, at, 0)
    assert set(found) == set(BANDS)
    assert found[band] > 0.95
    assert sum(found.values()) == pytest.approx(1.0)


def test_distance_since_a_reversal() -> None:
    q = np.array([0.0, 1, 2, 3, 2, 1, 0, 1])[:, None]
    dq = np.array([1.0, 1, 1, 0, -1, -1, 0, 1])[:, None]
    found = since_reversal(q, dq, np.array([0.1]))[:, 0]
    np.testing.assert_allclose(found, [0, 1, 2, 3, 0, -1, -2, 0])


def test_parts_do_not_reach_into_each_other() -> None:
    """Two recordings: a reversal of the first is none of the second."""
    m = motion()
    tau = np.zeros_like(m.q)
    both = [Segment(str(k), m, tau, tau, 10.0, slice(None)) for k in range(2)]
    at = explanatory(both, np.vstack([tau, tau]))
    np.testing.assert_allclose(at.reversal[: len(m)], at.reversal[len(m) :])
