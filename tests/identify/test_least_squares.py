"""Weighted least squares: truth from noiseless data, honest intervals, refusals by name."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st

from excitant.identify.least_squares import (
    autocorrelation_time,
    essential_parameters,
    weighted_least_squares,
)
from excitant.identify.regression import dense

N, NV, R = 800, 2, 5
NAMES = tuple(f"beta{k}" for k in range(R))
BETA = np.array([3.0, -0.5, 0.02, 10.0, 1.0])
SIGMA = np.array([0.3, 2.0])


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


ZERO = [1, 4, 5, 9]
P = 12


def draw(seed: int, kind: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns, torque and truth of an arm with four parameters that are zero."""
    rng = np.random.default_rng(seed)
    t = np.arange(800)[:, None, None] / 40
    W = sum(
        rng.normal(size=(2, P)) * np.sin(2 * np.pi * f * t + rng.uniform(0, 6, (2, P)))
        for f in rng.uniform(0.1, 2.0, 6)
    )
    beta = rng.choice([-1, 1], P) * rng.uniform(0.5, 3, P)
    beta[ZERO] = 0.0
    white = rng.standard_normal((1100, 2))
    if kind == "ar":
        white = scipy.signal.lfilter([np.sqrt(1 - 0.9**2)], [1.0, -0.9], white, axis=0)
    return W, W @ beta + 0.5 * white[300:], beta


@pytest.mark.parametrize("kind", ["white", "ar"])
def test_planted_zeros_are_dropped_and_nothing_else(kind: str) -> None:
    all_found = 0
    for seed in range(40):
        W, tau, beta = draw(seed, kind)
        fit = weighted_least_squares(dense(W, tau, tuple(map(str, range(P)))))
        found = essential_parameters(fit.beta, fit.covariance)
        assert set(found.dropped) <= set(ZERO), seed  # the others are 8 or more deviations away
        assert sorted((*found.kept, *found.dropped)) == list(range(P))
        assert (found.beta[list(found.dropped)] == 0).all()
        all_found += set(found.dropped) == set(ZERO)
        inside = np.abs(found.beta - beta)[list(found.kept)]
        assert (inside <= 5 * np.sqrt(np.diag(found.covariance)[list(found.kept)])).all()
    assert all_found >= 34  # of 40; 5 % are kept by chance


def test_dropping_is_least_squares_without_the_columns() -> None:
    """With the covariance of least squares, the rest follows as a fit of fewer columns."""
    W, tau, _ = draw(0, "white")
    A, b = W.reshape(-1, P), tau.ravel()
    inverse = np.linalg.inv(A.T @ A)
    found = essential_parameters(inverse @ A.T @ b, 0.25 * inverse)
    kept = list(found.kept)
    assert found.dropped
    alone = np.linalg.lstsq(A[:, kept], b, rcond=None)[0]
    np.testing.assert_allclose(found.beta[kept], alone, rtol=1e-8)
    covariance = 0.25 * np.linalg.inv(A[:, kept].T @ A[:, kept])
    np.testing.assert_allclose(found.covariance[np.ix_(kept, kept)], covariance, rtol=1e-6)


@given(st.integers(0, 10**6), st.floats(0.1, 30))
def test_the_p_value_is_walds(seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(6, 6)) + 3 * np.eye(6)
    S, b = root @ root.T, size * rng.normal(size=6)
    found = essential_parameters(b, S)
    d = list(found.dropped)
    statistic = b[d] @ np.linalg.solve(S[np.ix_(d, d)], b[d]) if d else 0.0
    expected = scipy.stats.chi2.sf(statistic, len(d)) if d else 1.0
    assert found.p_value == pytest.approx(expected, rel=1e-6)
    assert found.p_value >= 0.05
    assert (np.abs(found.beta[d]) == 0).all()


def test_units_do_not_matter() -> None:
    W, tau, _ = draw(1, "ar")
    fit = weighted_least_squares(dense(W, tau, tuple(map(str, range(P)))))
    unit = 10.0 ** np.arange(-6, 6)
    one = essential_parameters(fit.beta, fit.covariance)
    two = essential_parameters(fit.beta * unit, fit.covariance * np.outer(unit, unit))
    assert one.dropped == two.dropped
    np.testing.assert_allclose(two.beta, one.beta * unit, rtol=1e-6)


def test_noise_alone_needs_nothing_and_a_sure_thing_stays() -> None:
    nothing = essential_parameters(np.array([0.1, -0.2]), np.eye(2))
    assert nothing.kept == ()
    exact = essential_parameters(np.array([1.0, 0.1]), np.diag([0.0, 1.0]))
    assert exact.kept == (0,)
