"""Periods: found where there are some, refused where there are none, and what noise they show."""

from __future__ import annotations

import numpy as np
import pytest

from excitant.exceptions import BadRecording
from excitant.identify.bandwidth import motion_bandwidth
from excitant.identify.periods import Periods, periods_of

NOISE = 2e-4  # rad


def series(t: np.ndarray, period: float, seed: int, harmonics: int = 5) -> np.ndarray:
    """Two joints, a Fourier series of some period."""
    rng = np.random.default_rng(seed)
    k = np.arange(1, harmonics + 1)[:, None, None]
    size = rng.uniform(0.1, 0.5, (harmonics, 1, 2))
    phase = rng.uniform(0, 2 * np.pi, (harmonics, 1, 2))
    motion: np.ndarray = (size * np.sin(2 * np.pi * k * t[:, None] / period + phase)).sum(axis=0)
    return motion


def found(
    t: np.ndarray, q: np.ndarray, noise: float = NOISE, tau: np.ndarray | None = None
) -> Periods:
    rng = np.random.default_rng(1)
    seen = q + noise * rng.standard_normal(q.shape)
    return periods_of(t, seen, q if tau is None else tau, "run", "run.csv")


@pytest.mark.parametrize("noise", [0.0, 2e-5, 2e-4, 5e-3])
@pytest.mark.parametrize(
    ("period", "rate", "duration"),
    [(5.0, 250, 20), (5.0, 250, 10), (5.0, 251.37, 16), (np.pi, 100, 13), (7.3, 94, 60)],
)
def test_the_period_is_found_between_samples(
    period: float, rate: float, duration: float, noise: float
) -> None:
    for seed in range(3):
        t = np.arange(0, duration - 1e-9, 1 / rate)
        q = series(t, period, seed)
        periods = found(t, q, noise)
        assert periods.count == int(duration / period + 1e-9)
        # what a wrong period moves is less than the noise, or a thousandth of a step
        speed = np.gradient(q, t, axis=0).std()
        assert abs(periods.period - period) * speed < 0.2 * noise + 1e-3 * speed / rate
        assert periods.q.shape == (periods.count, round(period * rate), 2)
        again = series(periods.t, period, seed)
        error = np.abs(periods.mean_q - again).max()
        assert error < 5 * noise / np.sqrt(periods.count) + 1e-6


def test_it_is_the_shortest_period_and_not_that_of_the_largest_joint() -> None:
    rng, t = np.random.default_rng(0), np.arange(0, 24, 1 / 128)
    fast, slow = np.sin(np.pi * t), np.sin(np.pi * t / 2)
    both = np.column_stack([fast, 1e-2 * slow])
    assert found(t, both).period == pytest.approx(4, abs=1e-3)
    alone = np.column_stack([fast, 0.01 * np.ones_like(t)])
    assert found(t, alone).period == pytest.approx(2, abs=1e-3)
    thirds = np.column_stack([np.sin(np.pi * t), np.sin(2 * np.pi * t / 3)])
    assert found(t, thirds + 1e-4 * rng.standard_normal(both.shape)).period == pytest.approx(6)


T = np.arange(0, 20, 1 / 128)
RNG = np.random.default_rng(2)
NEVER = {
    "two periods but one sample": (series(T, 10.03, 0), "no lag up to 10 s"),
    "incommensurate": (np.column_stack([np.sin(np.sqrt(2) * T), np.sin(np.pi * T)]), "not repeat"),
    "random walk": (0.01 * np.cumsum(RNG.standard_normal((len(T), 2)), axis=0), "not repeat"),
    "a line": (np.column_stack([T, T]), "no lag"),
    "decay": (np.column_stack([np.exp(-T), np.exp(-T / 2)]), "no lag"),
    "growth": ((1 + 0.05 * T)[:, None] * series(T, 5.0, 0), "differences of"),
    "rest": (np.zeros((len(T), 2)), "no lag"),
    "noise": (RNG.standard_normal((len(T), 2)), "no lag"),
}


@pytest.mark.parametrize("name", list(NEVER))
def test_what_does_not_repeat_is_refused_by_name(name: str) -> None:
    q, why = NEVER[name]
    with pytest.raises(BadRecording, match=why) as refusal:
        found(T, q)
    assert "'run'" in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_random_motions_do_not_pass_for_periods() -> None:
    rng, passed = np.random.default_rng(3), 0
    for _ in range(40):
        w, a = rng.uniform(0.1, 1, (5, 1, 2)), rng.uniform(0.2, 1, (5, 1, 2))
        q = (a * np.sin(2 * np.pi * w * T[:, None] + rng.uniform(0, 6, (5, 1, 2)))).sum(axis=0)
        try:
            found(T, q)
        except BadRecording:
            continue
        passed += 1
    assert passed == 0


def test_noise_between_periods_is_the_noise_there_is() -> None:
    """Covariance between joints of white noise, and the spectrum of coloured noise."""
    rng, t = np.random.default_rng(4), np.arange(0, 60, 1 / 125)
    C = np.array([[4.0, 1.5], [1.5, 1.0]])
    e = rng.standard_normal((len(t), 2)) @ np.linalg.cholesky(C).T
    e[1:] += 0.8 * e[:-1]  # a moving average: power |1 + 0.8 e^{-jω}|²
    periods = found(t, series(t, 5.0, 0), tau=series(t, 5.0, 1) + e)
    deviation = np.sqrt(2 / (len(t) * 11 / 12)) * 2
    np.testing.assert_allclose(periods.tau_noise, (1 + 0.8**2) * C, rtol=4 * deviation)
    np.testing.assert_allclose(
        np.sqrt(np.diag(periods.q_noise)), NOISE, rtol=4 / np.sqrt(2 * len(t) * 11 / 12)
    )
    f, S = periods.spectrum()
    power = np.abs(1 + 0.8 * np.exp(-2j * np.pi * f / 125)) ** 2
    for low, high in ((1, 10), (25, 35), (50, 60)):
        band = (f >= low) & (f <= high)
        expected = C * power[band].mean()
        np.testing.assert_allclose(
            S[band].mean(axis=0).real,
            expected,
            atol=5 * C.max() * power[band].mean() / np.sqrt(band.sum() * 11),
        )
    total = (S[1:-1].sum(axis=0) * 2 + S[0] + S[-1]).real / len(periods.t)
    np.testing.assert_allclose(total, periods.tau_noise, rtol=1e-2)


def test_derivatives_are_those_of_the_series() -> None:
    t, period = np.arange(0, 20, 1 / 250), 5.0
    for noise in (0.0, NOISE):
        periods = found(t, series(t, period, 0), noise)
        assert (periods.bandwidth_hz == pytest.approx([1.0, 1.0])) or noise
        motion = periods.motion()
        fine = series(np.arange(-5e-4, 5, 1e-4)[:50020], period, 0)
        first = np.gradient(fine, 1e-4, axis=0)[5:][::40]
        second = np.gradient(np.gradient(fine, 1e-4, axis=0), 1e-4, axis=0)[5:][::40]
        n = min(len(first), len(motion))
        # white noise of 4 · 1250 samples that five (or a few more) harmonics pass
        passed = noise * np.sqrt(2 * 7 / (4 * 1250)) * 2 * np.pi
        assert np.abs(motion.dq[:n] - first[:n]).max() < 1e-5 + 5 * passed
        assert np.abs(motion.ddq[2 : n - 2] - second[2 : n - 2]).max() < 1e-3 + 60 * passed


def test_the_noise_of_velocity_is_foreseen() -> None:
    t = np.arange(0, 10, 1 / 125)
    exact = found(t, series(t, 5.0, 0), 0.0).motion().dq
    spread, foreseen = [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        q = series(t, 5.0, 0) + 1e-3 * rng.standard_normal((len(t), 2))
        periods = periods_of(t, q, q, "run")
        right = periods.bandwidth_hz < 1.01  # no harmonic that only noise made
        spread.append(np.where(right, (periods.motion().dq - exact).std(axis=0), np.nan))
        foreseen.append(np.where(right, periods.dq_noise, np.nan))
    assert np.isfinite(spread).mean() > 0.8
    ratio = np.nanmean(np.square(spread), axis=0) / np.nanmean(np.square(foreseen), axis=0)
    np.testing.assert_allclose(ratio, 1.0, atol=4 * np.sqrt(2 / (16 * 10)))


def test_bandwidth_of_a_motion_that_does_not_repeat() -> None:
    rng, t = np.random.default_rng(5), np.arange(0, 20, 1 / 250)
    slow = np.sin(2 * np.pi * 0.37 * t) + 0.05 * t
    fast = np.sin(2 * np.pi * 0.37 * t) + 1e-2 * np.sin(2 * np.pi * 6.1 * t)
    q = np.column_stack([slow, fast]) + 1e-4 * rng.standard_normal((len(t), 2))
    found = motion_bandwidth(q, 250.0)
    assert 0.37 <= found[0] < 1.5
    assert 6.1 <= found[1] < 7.0
