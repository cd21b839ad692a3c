"""Weighted least squares: truth from noiseless data, honest intervals, refusals by name."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal

from excitant.exceptions import RankDeficient
from excitant.identify.least_squares import autocorrelation_time, weighted_least_squares
from excitant.identify.regression import dense

N, NV, R = 800, 2, 5
NAMES = tuple(f"beta{k}" for k in range(R))
BETA = np.array([3.0, -0.5, 0.02, 10.0, 1.0])
SIGMA = np.array([0.3, 2.0])
INSIDE = 1.959963984540054


def columns(seed: int = 0) -> np.ndarray:
    """Slow columns of different sizes, as a motion makes them."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 1, N)[:, None, None]
    frequency, phase = rng.uniform(0.5, 6, (NV, R)), rng.uniform(0, 6.28, (NV, R))
    size = np.array([1.0, 20.0, 500.0, 0.1, 1.0])
    W: np.ndarray = size * np.sin(2 * np.pi * frequency * t + phase)
    return W


def noise(rng: np.random.Generator, rho: float) -> np.ndarray:
    """Autoregressive noise of unit variance."""
    white = rng.standard_normal((N + 500, NV)) * np.sqrt(1 - rho**2)
    return scipy.signal.lfilter([1.0], [1.0, -rho], white, axis=0)[500:]


def covered(rho: float, draws: int) -> float:
    """Share of 95 % intervals that hold the truth."""
    W, rng, hits = columns(), np.random.default_rng(1), 0
    for _ in range(draws):
        fit = weighted_least_squares(dense(W, W @ BETA + SIGMA * noise(rng, rho), NAMES))
        error = np.abs(fit.beta - BETA) / np.sqrt(np.diag(fit.covariance))
        hits += int((error <= INSIDE).sum())
    return hits / (draws * R)


def test_noiseless_data_give_the_truth() -> None:
    W = columns()
    fit = weighted_least_squares(dense(W, W @ BETA, NAMES))
    np.testing.assert_allclose(fit.beta, BETA, rtol=1e-8)
    for values in (fit.beta, fit.covariance, fit.sigma, fit.inflation):
        assert not values.flags.writeable


@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_intervals_cover_the_truth(rho: float) -> None:
    draws = 100
    deviation = np.sqrt(0.95 * 0.05 / draws)  # as if all intervals of one draw were one
    assert abs(covered(rho, draws) - 0.95) <= 3 * deviation


@pytest.mark.slow
@pytest.mark.parametrize("rho", [0.0, 0.5, 0.8])
def test_intervals_cover_the_truth_over_many_draws(rho: float) -> None:
    draws = 1000
    deviation = np.sqrt(0.95 * 0.05 / draws)
    # the correlation time of N rows is itself known to about √(2 τ / N): 15 % of a width at
    # ρ = 0.8, which costs up to 2 % of coverage
    short = 0.02 if rho else 0.0
    assert -3 * deviation - short <= covered(rho, draws) - 0.95 <= 3 * deviation


def test_noise_levels_and_correlation_are_found() -> None:
    W, rho = columns(), 0.8
    fit = weighted_least_squares(
        dense(W, W @ BETA + SIGMA * noise(np.random.default_rng(2), rho), NAMES)
    )
    tau = (1 + rho) / (1 - rho)  # integrated autocorrelation time of AR(1)
    np.testing.assert_allclose(fit.sigma, SIGMA, rtol=4 * np.sqrt(tau / (2 * N)))
    np.testing.assert_allclose(fit.inflation, tau, rtol=0.5)
    assert autocorrelation_time(np.random.default_rng(0).standard_normal(4000)) < 1.2
    assert autocorrelation_time(np.zeros(100)) == 1.0


def test_the_unit_of_one_joint_does_not_matter() -> None:
    W = columns()
    tau = W @ BETA + SIGMA * noise(np.random.default_rng(3), 0.0)
    scale = np.array([1.0, 1000.0])
    fit = weighted_least_squares(dense(W, tau, NAMES))
    scaled = weighted_least_squares(dense(W * scale[:, None], tau * scale, NAMES))
    np.testing.assert_allclose(scaled.beta, fit.beta, rtol=1e-8)
    np.testing.assert_allclose(scaled.covariance, fit.covariance, rtol=1e-6)
    np.testing.assert_allclose(scaled.sigma, fit.sigma * scale, rtol=1e-8)


def test_the_noisier_joint_counts_less() -> None:
    W = columns()
    tau = W @ BETA + SIGMA * noise(np.random.default_rng(4), 0.0)
    fit = weighted_least_squares(dense(W, tau, NAMES))
    A = (W / SIGMA[:, None]).reshape(-1, R)
    best = np.linalg.lstsq(A, (tau / SIGMA).ravel(), rcond=None)[0]
    std = np.sqrt(np.diag(np.linalg.inv(A.T @ A)))
    # weights are known to √(1/2N) = 2.5 %; the estimate moves by that share of its deviation
    assert (np.abs(fit.beta - best) <= 4 / np.sqrt(2 * N) * std).all()


def test_a_column_that_the_motion_does_not_show_is_named() -> None:
    W = columns()
    W[:, :, 3] = 0.0
    with pytest.raises(RankDeficient, match="does not determine") as refusal:
        weighted_least_squares(dense(W, W @ BETA, NAMES))
    assert refusal.value.names == ("beta3",)


def test_columns_that_the_motion_cannot_tell_apart_are_named() -> None:
    W = columns()
    W[:, :, 4] = 7 * W[:, :, 1]
    with pytest.raises(RankDeficient) as refusal:
        weighted_least_squares(dense(W, W @ BETA, NAMES))
    assert set(refusal.value.names) == {"beta1", "beta4"}
