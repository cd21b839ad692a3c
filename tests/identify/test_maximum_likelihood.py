"""Maximum likelihood of averaged periods: against theory, and on torque made without excitant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from excitant.exceptions import BadRecording
from excitant.identify import Recording, identify
from excitant.identify.estimators import Regression, ml, wls
from excitant.identify.estimators.of_rows import regression_of
from excitant.identify.estimators.periodic import MaximumLikelihood, maximum_likelihood
from excitant.identify.rows import FitRows, fit_rows, split
from excitant.robots import Robot, base_parameters
from excitant.robots.effects import standard_effects

PERIOD, RATE = 5.0, 125.0
FRICTION = np.array([[0.8, 0.4], [1.0, 0.5], [0.1, -0.2]])  # viscous, Coulomb, offset
N, R = 300, 3
NAMES = ("a", "b", "c")
BETA = np.array([2.0, -1.0, 0.5])


def columns(seed: int = 0) -> np.ndarray:
    rng, t = np.random.default_rng(seed), np.linspace(0, 1, N)[:, None, None]
    W: np.ndarray = np.sin(2 * np.pi * rng.uniform(0.5, 6, (2, R)) * t + rng.uniform(0, 6, (2, R)))
    return W


def test_joints_with_common_noise_are_weighted_as_gauss_and_markov_would() -> None:
    """Noise of correlation 0.95: the variance is that of generalised least squares, known Σ."""
    rng, W, count = np.random.default_rng(1), columns(), 40
    C = np.array([[1.0, 0.95 * 3], [0.95 * 3, 9.0]])
    root, inverse = np.linalg.cholesky(C), np.linalg.inv(C)
    best = np.linalg.inv(np.einsum("tir,ij,tjs->rs", W, inverse, W))
    found: dict[str, list[np.ndarray]] = {"known": [], "unknown": [], "wls": []}
    held = []
    for _ in range(count):
        rows = Regression(W, W @ BETA + rng.standard_normal((N, 2)) @ root.T, NAMES)
        fits = {"known": ml(replace(rows, noise=C[None])), "unknown": ml(rows), "wls": wls(rows)}
        for name, fit in fits.items():
            found[name].append(fit.beta - BETA)
        std = np.sqrt(np.diag(fits["known"].covariance))
        held.append(np.abs(found["known"][-1]) < 1.959963984540054 * std)
    deviation = 1 / np.sqrt(2 * count)
    for name in ("known", "unknown"):
        ratio = np.std(found[name], axis=0) / np.sqrt(np.diag(best))
        assert (np.abs(ratio - 1) < 4 * deviation).all()
    assert (np.std(found["wls"], axis=0) > 1.5 * np.sqrt(np.diag(best))).all()
    assert abs(np.mean(held) - 0.95) <= 3 * np.sqrt(0.95 * 0.05 / count)


def test_with_a_diagonal_covariance_it_is_weighted_least_squares() -> None:
    rng, W = np.random.default_rng(2), columns()
    rows = Regression(W, W @ BETA + rng.standard_normal((N, 2)) * [0.2, 3.0], NAMES)
    fit = wls(rows)
    known = ml(replace(rows, noise=np.diag(fit.sigma**2)[None]))
    np.testing.assert_allclose(known.beta, fit.beta, rtol=1e-6)
    np.testing.assert_allclose(known.covariance, fit.covariance, rtol=1e-4)


def test_segments_of_much_noise_count_for_little() -> None:
    rng, W = np.random.default_rng(3), columns()
    tau = W @ BETA + rng.standard_normal((N, 2)) * np.where(np.arange(N) < 200, 0.1, 10)[:, None]
    noise = np.array([0.01 * np.eye(2), 100 * np.eye(2)])
    both = ml(Regression(W, tau, NAMES, (0, 200), noise=noise))
    alone = ml(Regression(W[:200], tau[:200], NAMES, noise=noise[:1]))
    std = np.sqrt(np.diag(alone.covariance))
    assert (np.abs(both.beta - alone.beta) < 0.1 * std).all()


def series(t: np.ndarray, order: int) -> np.ndarray:
    k = np.arange(1, 5)[:, None, None]
    phase = np.random.default_rng(7).uniform(0, 2 * np.pi, (4, 1, 2))
    w = 2 * np.pi * k / PERIOD
    motion: np.ndarray = (
        np.array([0.7, 0.5, 0.3, 0.2])[:, None, None]
        * w**order
        * np.sin(w * t[:, None] + phase + order * np.pi / 2)
    ).sum(axis=0)
    return motion


def recorded(
    robot: Robot,
    seed: int,
    *,
    periods: float = 4,
    encoder: float = 1e-4,
    noise: float = 0.02,
    missing: Sequence[float] = (0.0, 0.0),
    drift: float = 0.0,
) -> Recording:
    """Recursive Newton-Euler and friction written here; ``missing`` is a ripple nobody models."""
    rng, t = np.random.default_rng(seed), np.arange(0, periods * PERIOD, 1 / RATE)
    q, dq, ddq = (series(t, order) for order in range(3))
    q = q * (1 + drift * t[:, None])
    data = robot.model.createData()
    tau = np.array([pin.rnea(robot.model, data, *x) for x in zip(q, dq, ddq, strict=True)])
    viscous, coulomb, offset = FRICTION
    tau += viscous * dq + coulomb * np.sign(dq) + offset + np.asarray(missing) * np.sin(9 * q)
    size = noise * np.sqrt((tau**2).mean(axis=0))
    common = rng.standard_normal((len(t), 1))
    tau += size * (0.6 * common + 0.8 * rng.standard_normal(tau.shape))
    return Recording("run", "run.csv", t, q + encoder * rng.standard_normal(q.shape), tau)


def rows_of(robot: Robot, recording: Recording, cutoff_hz: float = 10.0) -> FitRows:
    effects = standard_effects(robot.joints)
    data = split([recording], [recording], cutoff_hz)
    return fit_rows(robot, effects, base_parameters(robot, effects), data)


def fitted(robot: Robot, recording: Recording, cutoff_hz: float = 10.0) -> MaximumLikelihood:
    return maximum_likelihood(robot, rows_of(robot, recording, cutoff_hz), [recording])


def truth(robot: Robot) -> np.ndarray:
    effects = standard_effects(robot.joints)
    values = np.concatenate([robot.phi, *FRICTION, np.zeros(2)])
    beta: np.ndarray = base_parameters(robot, effects).regrouping @ values
    return beta


def test_without_noise_it_is_the_truth(planar: Robot) -> None:
    found = fitted(planar, recorded(planar, 0, encoder=0.0, noise=0.0))
    np.testing.assert_allclose(found.fit.beta, truth(planar), atol=1e-3)


@pytest.mark.parametrize("cutoff_hz", [10.0, 25.0])
def test_intervals_hold_the_truth_though_encoders_are_noisy(
    planar: Robot, cutoff_hz: float
) -> None:
    beta, scores, least = truth(planar), [], []
    for seed in range(16):
        recording = recorded(planar, seed, encoder=1e-3)
        rows = rows_of(planar, recording, cutoff_hz)
        fit = maximum_likelihood(planar, rows, [recording]).fit
        scores.append((fit.beta - beta) / np.sqrt(np.diag(fit.covariance)))
        plain = wls(regression_of(rows))
        least.append((plain.beta - beta) / np.sqrt(np.diag(plain.covariance)))
    mean = np.abs(np.mean(scores, axis=0)) * np.sqrt(16)
    assert (mean < 4).all()
    assert np.mean(np.abs(scores) < 1.959963984540054) > 0.95 - 3 * np.sqrt(0.05 * 0.95 / 16)
    if cutoff_hz == 25.0:
        assert (np.abs(np.mean(least, axis=0)) * np.sqrt(16)).max() > 10


def test_what_the_model_lacks_is_seen_at_its_joint(planar: Robot) -> None:
    found = fitted(planar, recorded(planar, 0, missing=(0.0, 0.2))).lack_of_fit
    assert found.p[1] < 1e-6
    assert found.ratio[1] > 3
    assert found.ratio[0] < 0.5 * found.ratio[1]
    assert found.residual[1] > 1.5 * found.noise[1]


@pytest.mark.parametrize("periods", [2, 4])
def test_where_nothing_is_missing_the_test_is_silent(planar: Robot, periods: int) -> None:
    found = [
        fitted(planar, recorded(planar, seed, periods=periods)).lack_of_fit for seed in range(16)
    ]
    chances = np.array([lack.p for lack in found])
    assert np.mean(chances < 0.05) <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / 32)
    ratio = np.mean([lack.ratio for lack in found], axis=0)
    np.testing.assert_allclose(ratio, 1.0, atol=0.15)


def test_motion_that_does_not_quite_repeat_is_no_noise_of_torque(planar: Robot) -> None:
    """Positions grow by 0.02 % a second; what that asks of the motors is not noise."""
    recording = recorded(planar, 0, drift=2e-4, noise=1e-3, encoder=1e-6)
    rows = rows_of(planar, recording)
    seen, blind = (
        maximum_likelihood(planar, rows, [recording], position_noise=given).lack_of_fit.noise
        for given in (True, False)
    )
    assert (seen < 0.8 * blind).any()


def test_periods_of_two_recordings_are_weighted_each_with_its_noise(planar: Robot) -> None:
    first, second = recorded(planar, 0), recorded(planar, 1, noise=0.5)
    effects = standard_effects(planar.joints)
    both = [first, replace(second, name="noisy")]
    data = split(both, [first], 10.0)
    rows = fit_rows(planar, effects, base_parameters(planar, effects), data)
    found = maximum_likelihood(planar, rows, both)
    assert [p.name for p in found.rows.periods] == ["run", "noisy"]
    alone = fitted(planar, first).fit
    std = np.sqrt(np.diag(alone.covariance))
    assert (np.abs(found.fit.beta - alone.beta) < std).all()


def test_identify_says_what_was_averaged_and_what_is_missing(planar: Robot) -> None:
    recording = recorded(planar, 0, missing=(0.0, 0.2))
    found = identify(planar, [recording], validate=[recording], estimator="ml")
    said = " ".join(found.notes)
    assert "4 of 5 s in 'run'" in said
    assert "some effect is missing" in said
    assert planar.joints[1] in said
    assert found.validate.nrmse.max() < 0.1
    std = np.sqrt(np.diag(found.least_squares.covariance))
    assert np.isfinite(std).all()


def test_a_motion_that_does_not_repeat_is_refused_by_name(planar: Robot) -> None:
    recording = recorded(planar, 0, periods=1.8)
    with pytest.raises(BadRecording, match=r"run.csv: 'run' does not repeat") as refusal:
        identify(planar, [recording], validate=[recording], estimator="ml")
    assert "\n" not in str(refusal.value)
