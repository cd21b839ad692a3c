"""95 % intervals hold the truth 95 times in a hundred, whatever the colour of the noise."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
import scipy.signal
from estimators import HARMONICS, Truth, truth
from known_arms import Z95

from excitant.design import random_trajectory
from excitant.identify import Data, Recording
from excitant.identify.least_squares import (
    JointRows,
    autocorrelation,
    autocovariance,
    autoregression,
    score_covariances,
    weighted_least_squares,
)
from excitant.identify.preprocessing import prepare
from excitant.identify.rows import fit_rows
from excitant.robots.effects import standard_effects

N, NV, R = 400, 2, 5
RATE_HZ, ENCODER, NOISE_SHARE = 125.0, 2e-5, 0.02  # rad; of each joint's rms torque
NOISES = {
    "white": ([1.0], [1.0]),
    "ar 0.05 s": ([1.0], [1.0, -np.exp(-1 / (RATE_HZ * 0.05))]),
    "ar 0.2 s": ([1.0], [1.0, -np.exp(-1 / (RATE_HZ * 0.2))]),
    "low-pass 3 Hz": scipy.signal.butter(2, 3.0, fs=RATE_HZ),
}


def test_an_autoregression_is_found_from_its_own_autocovariance() -> None:
    a, b = 1.5, -0.7  # x_i = a x_{i−1} + b x_{i−2} + ε_i
    gamma = [1.0, a / (1 - b)]
    for _ in range(20):
        gamma.append(a * gamma[-1] + b * gamma[-2])
    found, variance = autoregression(3.0 * np.array(gamma), 10_000)
    assert found == pytest.approx([1, -a, -b], abs=1e-9)
    assert variance == pytest.approx(3.0 * (1 - a * gamma[1] - b * gamma[2]))


def test_uncorrected_residuals_would_be_too_sure() -> None:
    """Over many draws the corrected scores are right on average; those of residuals are not."""
    rng, draws = np.random.default_rng(0), 60
    t = np.linspace(0, 1, N)[:, None, None]
    W = np.sin(2 * np.pi * rng.uniform(0, 6, (NV, R)) * t + rng.uniform(0, 6.28, (NV, R)))
    W[:, 1, 0] = 0.0  # a column silent at a joint
    used = [np.flatnonzero(W[:, j].any(axis=0)) for j in range(NV)]
    joints = [JointRows(own, W[:, j, own]) for j, own in enumerate(used)]
    gamma, flat = scipy.linalg.toeplitz(0.9 ** np.arange(N)), W.reshape(-1, R)
    root, inverse = np.linalg.cholesky(gamma), np.linalg.inv(flat.T @ flat)
    true = np.array([np.trace(inverse @ (W[:, j].T @ gamma @ W[:, j])) for j in range(NV)])
    found, plain = np.zeros(NV), np.zeros(NV)
    for _ in range(draws):
        noise = (root @ rng.standard_normal((N, NV))).ravel()
        residual = (noise - flat @ (inverse @ (flat.T @ noise))).reshape(N, NV)
        scores, _ = score_covariances(joints, residual, inverse)
        found += np.einsum("rs,jsr->j", inverse, scores) / draws
        for j, gamma_j in enumerate(autocovariance(residual, 26).T):
            part = inverse[np.ix_(used[j], used[j])]
            plain[j] += np.trace(part @ joints[j].coloured(gamma_j) @ joints[j].W) / draws
    assert (found > 1.05 * plain).all()
    assert found / true == pytest.approx(1.0, abs=0.2)  # √(4 (1 + ρ) / ((1 − ρ) N draws)) = 6 %


def coloured(kind: str, rng: np.random.Generator, n: int, nv: int) -> np.ndarray:
    """Stationary noise of unit variance, shape (n, nv)."""
    settle, (b, a) = round(3 * RATE_HZ), NOISES[kind]
    impulse = scipy.signal.lfilter(b, a, np.eye(1, settle)[0])
    white = rng.standard_normal((n + settle, nv))
    made = scipy.signal.lfilter(b, a, white, axis=0) / np.linalg.norm(impulse)
    return np.asarray(made[settle:])


def scaled_errors(known: Truth, rng: np.random.Generator, seconds: float) -> np.ndarray:
    """Error over standard deviation of every base parameter on one motion, shape (noises, r)."""
    trajectory = random_trajectory(known.robot, rng, 10.0, HARMONICS)
    t = np.arange(0, seconds, 1 / RATE_HZ)
    q, dq, ddq = (trajectory(t, order) for order in range(3))
    tau = known.torque(q, dq, ddq)
    size = NOISE_SHARE * np.sqrt((tau**2).mean(axis=0))
    measured = q + ENCODER * rng.standard_normal(q.shape)
    rows, found = None, []
    for kind in NOISES:
        noisy = tau + size * coloured(kind, rng, *tau.shape)
        train = tuple(prepare(Recording(kind, kind, t, measured, noisy)))
        if rows is None:  # the same positions make the same columns
            data = Data(train, (), "N·m", train[0].cutoff_hz, "")
            effects = standard_effects(known.robot.joints)
            rows = fit_rows(known.robot, effects, known.base, data).reduced
        kept = np.concatenate([segment.tau[segment.keep] for segment in train])
        fit = weighted_least_squares(rows.with_torque(kept))
        found.append((fit.beta - known.beta) / fit.std)
    return np.array(found)


def coverage(
    robot: str, recordings: int, seconds: float, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Coverage over all parameters of each noise, and its standard deviation.

    Intervals of one recording depend on each other, recordings do not.
    """
    known, draws = truth(robot), (np.random.default_rng([seed, k]) for k in range(recordings))
    errors = np.array([scaled_errors(known, rng, seconds) for rng in draws])
    each = (np.abs(errors) <= Z95).mean(axis=2)
    return each.mean(axis=0), each.std(axis=0, ddof=1) / np.sqrt(len(each))


def test_intervals_cover_the_truth() -> None:
    for kind, value, spread in zip(NOISES, *coverage("planar_2r", 40, 20.0), strict=True):
        assert abs(value - 0.95) <= 3 * spread + 0.01, (kind, value)


@pytest.mark.slow
@pytest.mark.parametrize(("robot", "recordings"), [("planar_2r", 150), ("ur10", 30)])
def test_intervals_cover_the_truth_on_many_recordings(robot: str, recordings: int) -> None:
    for kind, value, spread in zip(NOISES, *coverage(robot, recordings, 30.0, 1), strict=True):
        assert 0.93 - 2 * spread <= value <= 0.97 + 2 * spread, (kind, value)


@pytest.mark.parametrize("n", [541, 600, 1012])  # transforms of odd and even length
def test_autocorrelation_is_that_of_sums_over_lags(n: int) -> None:
    x = np.random.default_rng(n).standard_normal(n).cumsum()
    sums = np.correlate(x - x.mean(), x - x.mean(), "full")[n - 1 :][: n // 3]
    np.testing.assert_allclose(autocorrelation(x), sums / sums[0], rtol=0, atol=1e-12)
