"""95 % intervals of predicted torque hold 95 % of unseen readings, and say when they do not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import scipy.signal

from excitant.identify import Recording, identify_robot
from excitant.identify.estimate import (
    PredictionInterval,
    coverage,
    independent_squares,
    prediction_interval,
    torque_std,
)
from excitant.identify.least_squares import LeastSquares, weighted_least_squares
from excitant.identify.regression import dense
from excitant.robots import Array, Robot
from excitant.robots.virtual_arm import industrial_sensors

LEVEL = 0.95


def columns(rng: np.random.Generator, n: int, nv: int = 2, r: int = 8) -> Array:
    """Slow sums of sines, as the regressor of a motion is."""
    t = np.arange(n)[:, None, None] / 40
    return sum(
        rng.normal(size=(nv, r)) * np.sin(2 * np.pi * f * t + rng.uniform(0, 6, (nv, r)))
        for f in rng.uniform(0.1, 2.0, 4)
    )


def noise(kind: str, rng: np.random.Generator, n: int) -> Array:
    """Stationary noise of two joints, standard deviations 0.5 and 2."""
    white = rng.standard_normal((n + 300, 2))
    if kind == "ar":
        rho = 0.8
        white = scipy.signal.lfilter([np.sqrt(1 - rho**2)], [1.0, -rho], white, axis=0)
    return np.asarray(white[300:] * [0.5, 2.0])


@pytest.mark.parametrize("kind", ["white", "ar"])
@pytest.mark.parametrize("n", [150, 600])
def test_intervals_hold_95_percent_of_unseen_readings(kind: str, n: int) -> None:
    hits, plain = [], []
    for draw in range(200):
        rng = np.random.default_rng([draw, n])
        W, new = columns(rng, n), columns(rng, 200)
        beta = rng.normal(size=8)
        tau = W @ beta + noise(kind, rng, n)
        fit = weighted_least_squares(dense(W, tau, tuple("abcdefgh")))
        found = prediction_interval(new, fit, tau - W @ fit.beta)
        unseen, predicted = new @ beta + noise(kind, rng, 200), new @ fit.beta
        hits.append(coverage(unseen, predicted, found.half_width).share)
        rms = np.sqrt(((tau - W @ fit.beta) ** 2).mean(axis=0))
        plain.append(coverage(unseen, predicted, 1.96 * np.broadcast_to(rms, unseen.shape)).share)
    share = np.mean(hits, axis=0)
    assert (share > 0.93).all(), share
    assert (share < 0.97).all(), share
    if n == 150 and kind == "ar":  # what residuals alone announce is too little
        assert np.mean(plain) < 0.93 < np.mean(hits)


def test_the_parameters_part_is_the_spread_of_predictions() -> None:
    rng = np.random.default_rng(0)
    W, new, beta = columns(rng, 300), columns(rng, 50), rng.normal(size=8)
    root = rng.normal(size=(8, 8))
    exact = [np.sqrt(np.diag(row @ root @ root.T @ row.T)) for row in new]
    np.testing.assert_allclose(torque_std(new, root @ root.T), exact)
    predictions, announced = [], []
    for _ in range(300):
        tau = W @ beta + noise("ar", rng, 300)
        fit = weighted_least_squares(dense(W, tau, tuple("abcdefgh")))
        predictions.append(new @ fit.beta)
        announced.append(torque_std(new, fit.covariance))
    ratio = np.mean(announced, axis=0) / np.std(predictions, axis=0)
    assert 0.85 < np.median(ratio) < 1.15


def test_readings_in_other_units() -> None:
    rng = np.random.default_rng(2)
    W = columns(rng, 200)
    fit = LeastSquares(np.ones(8), 1e-3 * np.eye(8), np.ones(2), np.ones(2))
    residual, gains = noise("white", rng, 200), np.array([10.0, 4.0])
    torque = prediction_interval(W, fit, residual)
    current = prediction_interval(W, fit, residual / gains, gains)
    np.testing.assert_allclose(current.half_width * gains, torque.half_width)


def test_correlated_residuals_know_their_variance_from_fewer_samples() -> None:
    rng = np.random.default_rng(3)
    rho, n = 0.9, 20000
    found = {kind: independent_squares(noise(kind, rng, n)[:, 0]) for kind in ("white", "ar")}
    assert found["white"] == pytest.approx(n, rel=0.1)
    rho = 0.8
    assert found["ar"] == pytest.approx(n * (1 - rho**2) / (1 + rho**2), rel=0.2)
    assert independent_squares(np.zeros(50)) == 50


def test_a_model_that_misses_something_covers_too_little() -> None:
    rng = np.random.default_rng(4)
    n = 600
    W, new, beta = columns(rng, n), columns(rng, n), rng.normal(size=8)
    tau = W @ beta + noise("white", rng, n)
    fit = weighted_least_squares(dense(W, tau, tuple("abcdefgh")))
    found = prediction_interval(new, fit, tau - W @ fit.beta)
    honest = new @ beta + noise("white", rng, n)
    missed = honest + np.outer(np.sin(np.arange(n) / 50), [1.5, 0.0])
    assert not coverage(honest, new @ fit.beta, found.half_width).too_few.any()
    seen = coverage(missed, new @ fit.beta, found.half_width)
    assert seen.too_few.tolist() == [True, False]
    assert seen.std[0] > coverage(honest, new @ fit.beta, found.half_width).std[0]


def test_half_width_is_students() -> None:
    few = PredictionInterval(np.zeros((1, 1)), np.ones(1), np.array([3.0]))
    many = PredictionInterval(np.zeros((1, 1)), np.ones(1), np.array([1e9]))
    assert few.half_width[0, 0] == pytest.approx(3.182, abs=1e-3)
    assert many.half_width[0, 0] == pytest.approx(1.960, abs=1e-3)


def test_identify_reports_intervals_coverage_and_essential_parameters(
    planar: Robot, runs: Callable[..., list[Recording]]
) -> None:
    excitation, holdout = runs(planar, 3, sensors=industrial_sensors(planar))
    found = identify_robot(planar, [excitation], validate=[holdout])
    result = found.result()
    for j, row in enumerate(result["joints"]):
        entry = row["validate"]["interval95"]
        assert entry["half_width"] == pytest.approx(found.interval.half_width[:, j].mean())
        assert 0 < entry["half_width_parameters"] < entry["half_width"]
        outside = np.abs(found.holdout.measured - found.predicted) > found.interval.half_width
        assert entry["coverage"] == pytest.approx(1 - outside[:, j].mean())
        assert entry["coverage"] > 0.85
    essential = result["essential"]
    assert sorted(essential["kept"] + essential["dropped"]) == sorted(found.base.expressions)
    assert essential["nrmse_essential"] < 1.2 * essential["nrmse_all"]
    assert essential["p_value"] >= 0.05
    band = found.series()["half_width"]
    assert band.shape == found.predicted.shape
    np.testing.assert_allclose(band, found.interval.half_width)


def test_a_hidden_effect_of_the_hold_out_is_said_to_be_missed(
    planar: Robot, exact: Callable[..., Recording]
) -> None:
    rng = np.random.default_rng(5)
    train, other = (exact(planar, np.arange(0, 20, 0.01), seed) for seed in (0, 1))
    tau = [r.tau + 0.05 * rng.standard_normal(r.tau.shape) for r in (train, other)]
    train = replace(train, tau=tau[0])
    pulled = tau[1] + np.outer(np.sin(other.t), [0.0, 0.5])  # somebody leans on the second joint
    honest = identify_robot(planar, [train], validate=[replace(other, tau=tau[1])])
    leaned = identify_robot(planar, [train], validate=[replace(other, tau=pulled)])
    assert not any("misses something" in note for note in honest.result()["notes"])
    [said] = [n for n in leaned.result()["notes"] if "misses something" in n]
    assert planar.joints[1] in said
    assert planar.joints[0] not in said
