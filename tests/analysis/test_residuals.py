"""What a model leaves: how much of it is noise, and with what the rest varies."""

import re
from dataclasses import replace

import numpy as np
import pytest

from excitant.analysis import residuals
from excitant.identify.preprocessing import Segment, away_from_rest
from excitant.identify.signals import low_pass
from excitant.robots import Motion

RATE, CUTOFF = 200.0, 10.0
HARMONICS_HZ = (0.2, 0.6)
PASSED = np.pi / 8 / np.sin(np.pi / 8) * 7 / 8  # ∫ dx / (1 + x⁸)²: power that the filter passes


def motion(seed: int = 0, seconds: float = 60.0) -> Motion:
    """One joint in two harmonics."""
    t, w = np.arange(0, seconds, 1 / RATE), 2 * np.pi * np.array(HARMONICS_HZ)
    phase = np.random.default_rng(seed).uniform(0, 6.28, 2)
    waves = np.array([0.8, 0.3]) * np.exp(1j * (np.outer(t, w) + phase))
    return Motion(t, *(((1j * w) ** k * waves).imag.sum(axis=1)[:, None] for k in range(3)))


def segment(seed: int, sigma: float, signal: float = 0.0) -> Segment:
    """That motion, its torque noisy."""
    m = motion(seed)
    tau = signal * m.q + sigma * np.random.default_rng([seed, 1]).standard_normal(m.q.shape)
    return Segment("run", m, low_pass(tau, CUTOFF, RATE), tau, CUTOFF, slice(20, -20, 5))


def at_speed(dq: np.ndarray, keep: slice = slice(None), rate: float = RATE) -> Segment:
    t = np.arange(len(dq)) / rate
    m = Motion(t, np.cumsum(dq, axis=0) / rate, dq, np.gradient(dq, t, axis=0))
    return Segment("run", m, 0 * dq, 0 * dq, CUTOFF, keep)


def sine(seconds: float, amplitude: float = 1.0, rate: float = RATE) -> np.ndarray:
    """Reverses at every half second, as quickly as a sine does."""
    t = np.arange(0, seconds, 1 / rate)
    return np.asarray(amplitude * np.cos(2 * np.pi * t + 0.3))[:, None]


@pytest.mark.parametrize("rate", [100.0, 200.0, 1000.0])
def test_a_quick_reversal_counts(rate: float) -> None:
    assert away_from_rest([at_speed(sine(4.0, rate=rate), rate=rate)]).all()


@pytest.mark.parametrize("creep", [0.0, 0.005])
def test_a_rest_does_not_count_as_far_as_the_filter_carries_it(creep: float) -> None:
    dq, n = sine(4.0), round(0.5 / CUTOFF * RATE)
    dq[300:360] = creep  # 0.3 s
    counts = away_from_rest([at_speed(dq)])[:, 0]
    assert not counts[300 - n : 360 + n].any()
    far = np.r_[0 : 300 - n - 3, 360 + n + 3 : len(dq)]  # the sine itself is slow for a moment
    assert counts[far].all()


@pytest.mark.parametrize(("samples", "counted"), [(5, True), (12, False)])  # 25 ms, 60 ms
def test_a_short_stop_counts_and_a_longer_one_does_not(samples: int, counted: bool) -> None:
    dq = np.ones((400, 1))
    dq[200 : 200 + samples] = 0.0
    assert away_from_rest([at_speed(dq)]).all() == counted


def test_each_joint_rests_by_its_own_fastest_motion_at_the_rows_that_are_kept() -> None:
    dq = np.hstack([sine(4.0), sine(4.0, 1e-3), sine(4.0)])
    dq[400:500, 2] = 0.0
    counts = away_from_rest([at_speed(dq)])
    assert counts[:, :2].all()  # a slow joint is not one at rest
    assert not counts[400:500, 2].any()
    fast, slow = at_speed(sine(2.0)), at_speed(sine(2.0, 0.01))
    assert away_from_rest([slow]).all()
    both = away_from_rest([fast, slow])
    np.testing.assert_array_equal(both[:, 0], np.arange(len(both)) < len(fast.t))
    dq, keep = sine(4.0), slice(20, -20, 5)
    dq[300:400] = 0.0
    whole = away_from_rest([at_speed(dq)])
    both = away_from_rest([at_speed(dq, keep), at_speed(dq)])
    np.testing.assert_array_equal(both, np.vstack([whole[keep], whole]))


@pytest.mark.parametrize("signal", [0.0, 50.0])
def test_noise_floor_is_what_white_noise_leaves_behind_the_filter(signal: float) -> None:
    sigma = 0.4
    segments = [segment(seed, sigma, signal) for seed in range(2)]
    # white noise in the band below the cut-off, of which the filter passes a little less
    expected = sigma * np.sqrt(PASSED * 2 * CUTOFF / RATE)
    assert residuals.noise_floor(segments, 0) == pytest.approx(expected, rel=0.03)
    noise = np.concatenate([segment(seed, sigma).tau for seed in range(2)])
    assert residuals.noise_floor(segments, 0) == pytest.approx(noise.std(), rel=0.05)


def test_noise_floor_is_unknown_where_the_rate_leaves_no_band() -> None:
    s = segment(0, 0.4)
    slow = Segment("run", s.motion[::10], s.tau[::10], s.tau_raw[::10], 8.0, slice(None))
    assert residuals.noise_floor([slow], 0) == 0.0


SEGMENTS = [segment(seed, 0.2) for seed in range(2)]
NOISE = np.concatenate([s.tau[s.keep] for s in SEGMENTS])
STEPS = np.random.default_rng(1).uniform(2, 40, 40)
BY = residuals.explanatory(SEGMENTS, STEPS[np.arange(len(NOISE)) // 60 % 40][:, None])
STRUCTURE = {
    "constant": np.ones_like(NOISE),
    "direction": np.sign(BY.velocity),
    "velocity": BY.velocity * np.abs(BY.velocity),
    "position": np.cos(4 * BY.position),
    "load": BY.load * np.sign(BY.velocity) / 20,
    "reversal": np.sign(BY.velocity) * np.exp(-np.abs(BY.reversal) / 0.02),
    "time": np.linspace(-1, 1, len(NOISE))[:, None] ** 3,
}


def left(structure: np.ndarray) -> residuals.Residual:
    """Of noise and a structure."""
    error = NOISE + structure
    [found] = residuals.residuals(("elbow",), SEGMENTS, error, error, BY.load)
    assert found.rms == pytest.approx(np.sqrt((error**2).mean()), rel=0.05)
    return found


@pytest.mark.parametrize("kind", residuals.QUANTITIES)
def test_structure_is_told_by_the_quantity_in_which_it_is(kind: str) -> None:
    structure = STRUCTURE[kind]
    found = left(structure)
    assert found.visible or kind == "reversal"  # whose power is small beside the noise
    assert (found.dominant, found.shares[kind] > 0.7) == (kind, True)
    assert re.match(f"structured.*{re.escape(residuals.QUANTITIES[kind])}$", found.structure)
    assert found.structured == pytest.approx(np.sqrt((structure**2).mean()), rel=0.1)
    error, rows = 1e3 * (NOISE + structure)[:, 0], away_from_rest(SEGMENTS)[:, 0]
    assert residuals.shares(error, BY, 0, rows) == pytest.approx(found.shares)


def test_noise_alone_and_structure_below_it_are_not_visible() -> None:
    assert not left(0.03 * STRUCTURE["velocity"]).visible
    noise = left(0 * NOISE)
    assert (noise.visible, noise.structure, noise.dominant) == (False, "noise-like", "")
    assert max(noise.shares.values()) < 0.05
    assert noise.structured < noise.floor


def test_what_a_rest_leaves_does_not_count() -> None:
    turns = np.abs(np.arange(len(SEGMENTS[0].motion))[:, None] - 4999.5) > 1000
    moved = [replace(s.motion, dq=s.motion.dq * turns) for s in SEGMENTS]
    still = [replace(s, motion=m) for s, m in zip(SEGMENTS, moved, strict=True)]
    stuck = np.concatenate([s.motion.dq[s.keep] == 0 for s in still])
    assert stuck.sum() > 700
    [found] = residuals.residuals(("elbow",), still, NOISE + 9.0 * stuck, NOISE, BY.load)
    assert (found.visible, found.rms) == (False, pytest.approx(NOISE[~stuck].std(), rel=0.05))


def test_an_error_against_noise_in_words() -> None:
    found = left(STRUCTURE["direction"])
    times = float(found.against_noise.removesuffix(" times the noise"))
    assert times == pytest.approx(found.rms / found.floor, rel=0.1)
    assert replace(found, floor=found.rms / 250).against_noise == "over 100 times the noise"
    for floor in (0.0, found.rms / 28957.9):
        assert "smoothed or computed" in replace(found, floor=floor).against_noise


def test_a_trend_is_not_judged_on_a_motion_that_hardly_repeats() -> None:
    m = motion(seconds=1 / HARMONICS_HZ[0])
    s = Segment("run", m, 0 * m.q, 0 * m.q, CUTOFF, slice(None))
    by = residuals.explanatory([s], 0 * m.q)
    assert "time" not in residuals.shares(np.linspace(-1, 1, len(m)), by, 0, np.ones(len(m), bool))
    assert BY.lowest_hz[0] == pytest.approx(HARMONICS_HZ[0], abs=0.05)


def test_distance_since_a_reversal() -> None:
    q = np.array([0.0, 1, 2, 3, 2, 1, 0, 1])[:, None]
    dq = np.array([1.0, 1, 1, 0, -1, -1, 0, 1])[:, None]
    found = residuals.since_reversal(q, dq, np.array([0.1]))[:, 0]
    np.testing.assert_allclose(found, [0, 1, 2, 3, 0, -1, -2, 0])
    both = [replace(SEGMENTS[0], name=name) for name in ("one", "two")]
    one, two = np.split(residuals.explanatory(both, np.vstack([SEGMENTS[0].tau] * 2)).reversal, 2)
    np.testing.assert_allclose(one, two)
