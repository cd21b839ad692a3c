"""95 % intervals of predicted torque hold 95 % of unseen readings, and say when they do not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import scipy.signal

from excitant.identify import Recording, identify_robot
from excitant.identify.accuracy import (
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


def columns(rng: np.random.Generator, n: int, nv: int = 2, r: int = 8) -> Array:
    """Slow sums of sines, as the regressor of a motion is."""
    t = np.arange(n)[:, None, None] / 40
    return sum(
        rng.normal(size=(nv, r)) * np.sin(2 * np.pi * f * t + rng.uniform(0, 6, (nv, r)))
        for f in rng.uniform(0.1, 2.0, 4)
    )


def noise(rho: float, rng: np.random.Generator, n: int) -> Array:
    """First-order autoregressive noise of two joints, standard deviations 0.5 and 2."""
    white = rng.standard_normal((n + 300, 2))
    made = scipy.signal.lfilter([np.sqrt(1 - rho**2)], [1.0, -rho], white, axis=0)
    return np.asarray(made[300:] * [0.5, 2.0])


@pytest.mark.parametrize("rho", [0.0, 0.8])
@pytest.mark.parametrize("n", [150, pytest.param(600, marks=pytest.mark.slow)])
def test_intervals_hold_95_percent_of_unseen_readings(rho: float, n: int) -> None:
    hits, plain = [], []
    for draw in range(200):
        rng = np.random.default_rng([draw, n])
        W, new, beta = columns(rng, n), columns(rng, 200), rng.normal(size=8)
        tau = W @ beta + noise(rho, rng, n)
        fit = weighted_least_squares(dense(W, tau, tuple("abcdefgh")))
        residual = tau - W @ fit.beta
        found = prediction_interval(new, fit, list(residual.T))
        unseen, predicted = new @ beta + noise(rho, rng, 200), new @ fit.beta
        error = np.abs(unseen - predicted)
        hits.append(coverage(list((error <= found.half_width).T)).share)
        rms = np.sqrt((residual**2).mean(axis=0))
        plain.append(coverage(list((error <= 1.96 * rms).T)).share)
    share = np.mean(hits, axis=0)
    assert (share > 0.93).all(), share
    assert (share < 0.97).all(), share
    if n == 150 and rho:  # what residuals alone announce is too little
        assert np.mean(plain) < 0.93 < np.mean(hits)


def test_the_parameters_part_is_that_of_the_linear_map() -> None:
    rng = np.random.default_rng(0)
    W, root = columns(rng, 50), rng.normal(size=(8, 8))
    expected = [np.sqrt(np.diag(row @ root @ root.T @ row.T)) for row in W]
    np.testing.assert_allclose(torque_std(W, root @ root.T), expected)


def test_readings_in_other_units() -> None:
    rng = np.random.default_rng(2)
    W = columns(rng, 200)
    fit = LeastSquares(np.ones(8), 1e-3 * np.eye(8), np.ones(2), np.ones(2))
    residual, gains = noise(0.0, rng, 200), np.array([10.0, 4.0])
    torque = prediction_interval(W, fit, list(residual.T))
    current = prediction_interval(W, fit, list((residual / gains).T), gains)
    np.testing.assert_allclose(current.half_width * gains, torque.half_width)


@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_correlated_residuals_know_their_variance_from_fewer_samples(rho: float) -> None:
    n = 20000
    found = independent_squares(noise(rho, np.random.default_rng(3), n)[:, 0])
    assert found == pytest.approx(n * (1 - rho**2) / (1 + rho**2), rel=0.2 if rho else 0.1)
    assert independent_squares(np.zeros(50)) == 50


@pytest.mark.parametrize(("freedom", "width"), [(3.0, 3.182), (1e9, 1.960)])
def test_half_width_is_students(freedom: float, width: float) -> None:
    found = PredictionInterval(np.zeros((1, 1)), np.ones(1), np.array([freedom]))
    assert found.half_width[0, 0] == pytest.approx(width, abs=1e-3)


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
        assert entry["coverage"] == pytest.approx(1 - found.holdout.counted(outside)[j].mean())
        assert entry["coverage"] > 0.85
    essential = result["essential"]
    assert sorted(essential["kept"] + essential["dropped"]) == sorted(found.base.expressions)
    assert essential["nrmse_essential"] < 1.2 * essential["nrmse_all"]
    assert essential["p_value"] >= 0.05
    np.testing.assert_array_equal(found.series()["half_width"], found.interval.half_width)


def test_a_hidden_effect_of_the_hold_out_is_said_to_be_missed(
    planar: Robot, exact: Callable[..., Recording]
) -> None:
    rng = np.random.default_rng(5)
    train, other = (
        replace(run, tau=run.tau + 0.05 * rng.standard_normal(run.tau.shape))
        for run in (exact(planar, np.arange(0, 20, 0.01), seed) for seed in (0, 1))
    )
    # somebody leans on the second joint
    pulled = replace(other, tau=other.tau + np.outer(np.sin(other.t), [0.0, 0.5]))
    honest, leaned = (
        [n for n in found.result()["notes"] if "misses something" in n]
        for found in (identify_robot(planar, [train], validate=[run]) for run in (other, pulled))
    )
    assert not honest
    [said] = leaned
    assert planar.joints[1] in said
    assert planar.joints[0] not in said
