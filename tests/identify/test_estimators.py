"""Estimators under one interface: closed forms, and what each is for, by Monte Carlo."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.signal

from excitant.cli import main
from excitant.exceptions import BadInput, RankDeficient, UnknownName
from excitant.identify import Recording, identify
from excitant.identify.differentiators import ZeroPhaseButterworth
from excitant.identify.estimate import whitened
from excitant.identify.estimators import (
    DESCRIPTIONS,
    ESTIMATORS,
    HUBER,
    Estimator,
    EverySecond,
    Regression,
    errors_in_variables,
    estimator_named,
    gls,
    irls,
    iv,
    oe,
    ols,
    tls,
    wls,
)
from excitant.identify.least_squares import weighted_least_squares
from excitant.identify.physical import fit_physical, prior_parameters
from excitant.identify.rows import fit_rows, split
from excitant.robots import load_robot
from excitant.robots.effects import standard_effects
from excitant.robots.parameters import violations

N, NV, R = 400, 2, 4
NAMES = tuple(f"beta{k}" for k in range(R))
BETA = np.array([3.0, -0.5, 0.02, 1.0])
SIZE = np.array([1.0, 20.0, 300.0, 1.0])
SIGMA = np.array([0.3, 2.0])
every = pytest.mark.parametrize("name", list(ESTIMATORS))


def columns(seed: int = 0, n: int = N) -> np.ndarray:
    """Slow columns of different sizes; the last one is a constant, as an offset's."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 1, n)[:, None, None]
    frequency, phase = rng.uniform(0.5, 6, (NV, R)), rng.uniform(0, 6.28, (NV, R))
    W: np.ndarray = SIZE * np.sin(2 * np.pi * frequency * t + phase)
    W[:, :, -1] = [1.0, 0.5]
    return W


def coloured(rng: np.random.Generator, rho: float, n: int = N) -> np.ndarray:
    """Autoregressive noise of unit variance."""
    white = rng.standard_normal((n + 200, NV)) * np.sqrt(1 - rho**2)
    return scipy.signal.lfilter([1.0], [1.0, -rho], white, axis=0)[200:]


def problem(W: np.ndarray, tau: np.ndarray, Z: np.ndarray | None = None) -> Regression:
    return Regression(W, tau, NAMES, instruments=W if Z is None else Z, simulated=lambda _: W)


def draws(
    estimators: dict[str, Estimator], make: Callable[[np.random.Generator], Regression], count: int
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Errors and standard deviations that estimators give, each of shape (count, R)."""
    rng = np.random.default_rng(1)
    found: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {name: [] for name in estimators}
    for _ in range(count):
        rows = make(rng)
        for name, estimator in estimators.items():
            fit = estimator(rows)
            found[name].append((fit.beta - BETA, np.sqrt(np.diag(fit.covariance))))
    return {
        name: (np.array([e for e, _ in each]), np.array([s for _, s in each]))
        for name, each in found.items()
    }


def biased(errors: np.ndarray) -> np.ndarray:
    """Mean error over its standard deviation, shape (R,)."""
    return np.abs(errors.mean(axis=0)) / (errors.std(axis=0) / np.sqrt(len(errors)))


def covered(errors: np.ndarray, stds: np.ndarray) -> float:
    return float((np.abs(errors) <= 1.959963984540054 * stds).mean())


@every
def test_noiseless_data_give_the_truth(name: str) -> None:
    W = columns()
    fit = estimator_named(name)(problem(W, W @ BETA))
    np.testing.assert_allclose(fit.beta, BETA, rtol=1e-6)
    assert (np.sqrt(np.diag(fit.covariance)) * SIZE <= 1e-6).all()
    for values in (fit.beta, fit.covariance, fit.sigma, fit.inflation):
        assert not values.flags.writeable


@every
def test_the_unit_of_torque_and_of_a_column_does_not_matter(name: str) -> None:
    W = columns()
    tau = W @ BETA + SIGMA * coloured(np.random.default_rng(3), 0.5)
    unit = np.array([1.0, 1e3, 1e-2, 1.0])
    fit = ESTIMATORS[name](problem(W, tau))
    scaled = ESTIMATORS[name](problem(1e3 * W / unit, 1e3 * tau))
    std = np.sqrt(np.diag(fit.covariance))
    np.testing.assert_allclose(scaled.beta / unit, fit.beta, atol=1e-4 * std.min(), rtol=1e-6)
    np.testing.assert_allclose(scaled.covariance / np.outer(unit, unit), fit.covariance, rtol=1e-3)
    np.testing.assert_allclose(scaled.sigma, 1e3 * fit.sigma, rtol=1e-4)
    np.testing.assert_allclose(scaled.inflation, fit.inflation, rtol=1e-3)


@every
def test_silent_and_dependent_columns_are_named(name: str) -> None:
    W = columns()
    tau = W @ BETA + SIGMA * coloured(np.random.default_rng(4), 0.0)
    silent, twins = W.copy(), W.copy()
    silent[:, :, 1] = 0.0
    twins[:, :, 2] = 3 * twins[:, :, 0]
    with pytest.raises(RankDeficient, match="does not determine") as refusal:
        ESTIMATORS[name](problem(silent, tau))
    assert refusal.value.names == ("beta1",)
    with pytest.raises(RankDeficient) as refusal:
        ESTIMATORS[name](problem(twins, tau))
    assert set(refusal.value.names) == {"beta0", "beta2"}


def test_shapes_and_names_that_do_not_fit_are_refused() -> None:
    W = columns()
    tau = W @ BETA
    with pytest.raises(BadInput, match="shape"):
        Regression(W, tau[:-1], NAMES)
    with pytest.raises(BadInput, match="instruments of shape"):
        Regression(W, tau, NAMES, instruments=W[1:])
    with pytest.raises(BadInput, match="segments start"):
        Regression(W, tau, NAMES, starts=(0, N))
    with pytest.raises(BadInput, match="finite"):
        Regression(W, np.where(tau == tau.max(), np.nan, tau), NAMES)
    with pytest.raises(BadInput, match="need instruments"):
        iv(Regression(W, tau, NAMES))
    with pytest.raises(BadInput, match="needs a simulation"):
        oe(Regression(W, tau, NAMES))
    with pytest.raises(BadInput, match="one covariance matrix for each segment"):
        Regression(W, tau, NAMES, (0, 100), noise=np.ones((1, NV, NV)))
    with pytest.raises(BadInput, match="errors of 4 columns"):
        tls(problem(W, tau), errors=np.ones(R - 1))
    with pytest.raises(UnknownName, match="did you mean 'wls'"):
        estimator_named("wlss")


def test_ordinary_least_squares_is_that_of_numpy() -> None:
    W = columns()
    tau = W @ BETA + SIGMA * coloured(np.random.default_rng(5), 0.0)
    fit = ols(problem(W, tau))
    best = np.linalg.lstsq(W.reshape(-1, R), tau.ravel(), rcond=None)[0]
    np.testing.assert_allclose(fit.beta, best, rtol=1e-9)


def test_the_default_is_weighted_least_squares_bit_for_bit() -> None:
    W = columns()
    tau = W @ BETA + SIGMA * coloured(np.random.default_rng(6), 0.5)
    fit, known = wls(problem(W, tau)), weighted_least_squares(W, tau, NAMES)
    for name in ("beta", "covariance", "sigma", "inflation"):
        assert (getattr(fit, name) == getattr(known, name)).all()


def test_without_column_errors_instruments_that_are_the_columns_change_nothing() -> None:
    W = columns()
    tau = W @ BETA + SIGMA * coloured(np.random.default_rng(7), 0.5)
    fit, known = iv(problem(W, tau)), wls(problem(W, tau))
    std = np.sqrt(np.diag(known.covariance))
    assert (np.abs(fit.beta - known.beta) <= 1e-3 * std).all()
    np.testing.assert_allclose(fit.covariance, known.covariance, rtol=1e-2)


def test_ordinary_intervals_hold_the_truth_though_joints_differ() -> None:
    W, rho = columns(), 0.6
    found = draws(
        {"ols": ols, "wls": wls},
        lambda rng: problem(W, W @ BETA + SIGMA * coloured(rng, rho)),
        60,
    )
    deviation = np.sqrt(0.95 * 0.05 / 60)  # as if all intervals of one draw were one
    assert abs(covered(*found["ols"]) - 0.95) <= 3 * deviation
    ratio = found["wls"][0].std(axis=0) / found["ols"][0].std(axis=0)
    assert (ratio < 1.0).all()


@pytest.mark.parametrize("influence", ["student", "huber"])
def test_robust_regression_withstands_wrong_torques(influence: str) -> None:
    """5 % of the torques are off by 20 standard deviations, all to one side."""
    W = columns()

    def make(rng: np.random.Generator, share: float) -> Regression:
        wrong = 20 * SIGMA * (rng.random((N, NV)) < share)
        return problem(W, W @ BETA + SIGMA * rng.standard_normal((N, NV)) + wrong)

    robust: Estimator = irls if influence == "student" else lambda rows: irls(rows, HUBER)
    found = draws({"irls": robust, "wls": wls}, lambda rng: make(rng, 0.05), 30)
    clean = draws({"irls": robust, "wls": wls}, lambda rng: make(rng, 0.0), 30)
    error, std = found["irls"]
    spread = clean["wls"][0].std(axis=0)
    deviation = 1 / np.sqrt(2 * 30)  # relative, of a standard deviation from 30 draws
    assert biased(found["wls"][0])[-1] > 10  # the offset takes the mean of the errors
    assert (np.sqrt((error**2).mean(axis=0)) / spread)[:-1].max() < 1.2 * (1 + 3 * deviation)
    assert (clean["irls"][0].std(axis=0) / spread).max() < 1.06 * (1 + 3 * deviation)
    assert abs(covered(error[:, :-1], std[:, :-1]) - 0.95) <= 3 * np.sqrt(0.95 * 0.05 / 30)
    if influence == "student":
        assert np.abs(error.mean(axis=0) / spread)[-1] < 1.0
        assert (
            np.sqrt((error**2).mean(axis=0)) < 0.3 * np.sqrt((found["wls"][0] ** 2).mean(axis=0))
        )[-1]


def test_prewhitening_is_efficient_and_its_intervals_hold_the_truth() -> None:
    """Columns that are slow and fast at once; noise is strong where they are slow only."""
    rho, count = 0.9, 40
    W = columns() + columns(seed=1)[::-1] * np.cos(np.pi * np.arange(N) / 4)[:, None, None]
    found = draws(
        {"gls": gls, "wls": wls},
        lambda rng: problem(W, W @ BETA + SIGMA * coloured(rng, rho)),
        count,
    )
    # Gauss and Markov: with the covariance Γ of the noise known
    gamma = rho ** np.abs(np.subtract.outer(np.arange(N), np.arange(N)))
    weighted = (W / SIGMA[:, None]).transpose(1, 0, 2)
    best = np.linalg.inv(sum(X.T @ np.linalg.solve(gamma, X) for X in weighted))
    inverse = np.linalg.inv(sum(X.T @ X for X in weighted))
    plain = inverse @ sum(X.T @ gamma @ X for X in weighted) @ inverse
    gain = np.sqrt(np.diag(plain) / np.diag(best))
    assert gain.max() > 1.5
    deviation = 1 / np.sqrt(2 * count)
    error = np.sqrt((found["gls"][0] ** 2).mean(axis=0) / np.diag(best))
    assert (error <= 1 + 4 * deviation).all()
    better = found["wls"][0].std(axis=0) / found["gls"][0].std(axis=0)
    assert (better[gain > 1.5] > 1.2).all()
    assert abs(covered(*found["gls"]) - 0.95) <= 3 * np.sqrt(0.95 * 0.05 / count)


def test_whitening_does_not_reach_over_the_borders_of_segments() -> None:
    """Segments in another order, each as it was, give the same estimate."""
    W = columns()
    tau = W @ BETA + SIGMA * coloured(np.random.default_rng(8), 0.8)
    parts = [slice(0, 120), slice(120, 280), slice(280, N)]
    swapped = [parts[k] for k in (2, 0, 1)]
    sizes = np.cumsum([0, *(p.stop - p.start for p in swapped)])
    first = gls(Regression(W, tau, NAMES, (0, 120, 280)))
    second = gls(
        Regression(
            np.concatenate([W[p] for p in swapped]),
            np.concatenate([tau[p] for p in swapped]),
            NAMES,
            tuple(int(k) for k in sizes[:-1]),
        )
    )
    joined = gls(Regression(W, tau, NAMES))
    np.testing.assert_allclose(second.beta, first.beta, rtol=1e-9)
    assert np.abs(joined.beta / first.beta - 1).max() > 1e-6


COLUMN_ERROR = np.array([0.3, 0.3, 0.3, 0.0]) * SIZE


def wrong_columns(rng: np.random.Generator) -> Regression:
    """Columns and instruments with independent errors, nearly half of what they are."""
    W = columns()
    seen, again = (W + COLUMN_ERROR * rng.standard_normal(W.shape) for _ in range(2))
    return problem(seen, W @ BETA + SIGMA * coloured(rng, 0.5), again)


def test_instruments_take_away_the_bias_that_wrong_columns_make() -> None:
    found = draws({"iv": iv, "wls": wls}, wrong_columns, 60)
    assert (biased(found["wls"][0])[1:3] > 10).all()
    assert (biased(found["iv"][0]) < 4).all()
    assert abs(covered(*found["iv"]) - 0.95) <= 3 * np.sqrt(0.95 * 0.05 / 60)


def test_total_least_squares_with_the_errors_known_is_not_biased() -> None:
    """Of torque and columns, the latter with errors of 30 % but for the constant one."""
    W, errors = columns(), SIZE * np.array([1.0, 1.0, 1.0, 0.0])

    def make(rng: np.random.Generator) -> Regression:
        seen = W + 0.3 * errors * rng.standard_normal(W.shape)
        return problem(seen, W @ BETA + 0.3 * rng.standard_normal((N, NV)))

    found = draws({"tls": lambda rows: tls(rows, errors), "wls": wls}, make, 40)
    assert (biased(found["wls"][0])[1:3] > 10).all()
    assert (biased(found["tls"][0]) < 4).all()
    assert abs(covered(*found["tls"]) - 0.95) <= 3 * np.sqrt(0.95 * 0.05 / 40)


def test_the_smallest_correction_is_that_of_the_singular_vector() -> None:
    rng = np.random.default_rng(9)
    W = columns()[:, :1] + 0.1 * rng.standard_normal((N, 1, R)) * SIZE
    tau = W @ BETA + rng.standard_normal((N, 1))
    v = np.linalg.svd(np.column_stack([W[:, 0] / SIZE, tau]))[2][-1]
    fit = tls(Regression(W, tau, NAMES), errors=SIZE)
    np.testing.assert_allclose(fit.beta, -v[:-1] / v[-1] / SIZE, rtol=1e-8)


def test_wrong_columns_are_told_from_right_ones() -> None:
    rng, W = np.random.default_rng(10), columns()
    chances = []
    for _ in range(60):
        again = W + 0.1 * SIZE * rng.standard_normal(W.shape)
        tau = W @ BETA + SIGMA * coloured(rng, 0.5)
        chances.append(errors_in_variables(W, tau, again)[1])
    alarms = np.mean(np.array(chances) < 0.05)
    assert alarms <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / 60)
    assert np.mean(np.array(chances) < 0.5) >= 0.5 - 3 * np.sqrt(0.25 / 60)
    for _ in range(5):
        rows = wrong_columns(rng)
        statistic, p = errors_in_variables(rows.W, rows.tau, rows.Z)
        assert p < 1e-6
        assert statistic > 30
    with pytest.raises(BadInput, match="nothing is left to test"):
        errors_in_variables(W, W @ BETA + SIGMA * coloured(rng, 0.0), W)


def test_missing_physics_is_no_error_of_columns() -> None:
    rng, W = np.random.default_rng(11), columns()
    again, seen = (W + 0.01 * SIZE * rng.standard_normal(W.shape) for _ in range(2))
    missing = np.sin(np.linspace(0, 40, N))[:, None] * np.array([3.0, 10.0])
    tau = W @ BETA + missing + SIGMA * coloured(rng, 0.0)
    assert errors_in_variables(seen, tau, again)[1] > 0.001


def test_even_and_odd_samples_see_one_motion_with_independent_noise() -> None:
    t = np.arange(3000) / 200.0
    q = np.sin(2 * np.pi * 0.7 * t)[:, None]
    inner = ZeroPhaseButterworth(15.0)
    even, odd = (EverySecond(first, inner)(t, q) for first in (0, 1))
    np.testing.assert_allclose(even.ddq[200:-200], odd.ddq[200:-200], atol=1e-3)
    noise = 1e-3 * np.random.default_rng(12).standard_normal((len(t), 1))
    a, b, both = (
        each(t, noise).ddq[200:-200, 0]
        for each in (EverySecond(0, inner), EverySecond(1, inner), inner)
    )
    independent = len(a) * 2 * 15 / 200  # samples that a band of 15 Hz leaves
    assert abs(np.corrcoef(a, b)[0, 1]) < 4 / np.sqrt(independent)
    ratio = EverySecond(0, inner).noise_gain(200.0, 2) / inner.noise_gain(200.0, 2)
    assert a.std() / both.std() == pytest.approx(ratio, rel=0.1)


@pytest.fixture(scope="module")
def noisy(exact: Callable[..., Recording]) -> Recording:
    """Two links for 20 s, seen by sensors with noise."""
    rng, t = np.random.default_rng(13), np.arange(0, 20, 1 / 128)
    recording = exact(load_robot("planar_2r"), t)
    return replace(
        recording,
        q=recording.q + 1e-4 * rng.standard_normal(recording.q.shape),
        tau=recording.tau + 0.02 * recording.tau.std(axis=0) * rng.standard_normal((len(t), 2)),
    )


@every
def test_a_robot_is_identified_by_every_estimator(name: str, noisy: Recording) -> None:
    robot = load_robot("planar_2r")
    periods = [noisy] if name == "ml" else []  # 70 % of two are not two
    found = identify(robot, [noisy], validate=periods, estimator=name)
    assert found.validate.nrmse.max() < 0.02  # of noise that the filter left
    assert violations(found.phi, robot.links) == []
    assert np.linalg.eigvalsh(found.least_squares.covariance).min() > 0
    said = " ".join(found.notes)
    assert (name == "wls") != (f"base parameters by {DESCRIPTIONS[name]}" in said)
    assert (name == "iv") == ("Durbin-Wu-Hausman" in said)


def test_the_default_identifies_bit_for_bit_as_by_hand(noisy: Recording) -> None:
    robot = load_robot("planar_2r")
    found = identify(robot, [noisy])
    rows = fit_rows(robot, standard_effects(robot.joints), found.base, split([noisy]))
    columns, names = list(found.base.columns), found.base.expressions
    fit = weighted_least_squares(rows.W[:, :, columns], rows.tau, names)
    R, z = whitened(rows.W, rows.tau, fit)
    physical = fit_physical(R, z, prior_parameters(robot), rows.open_prior)
    assert (found.physical.x == physical.x).all()
    assert (found.least_squares.covariance == fit.covariance).all()


def test_segments_too_short_to_whiten_are_weighted() -> None:
    W = columns()
    tau = W @ BETA + SIGMA * coloured(np.random.default_rng(14), 0.8)
    alone = Regression(W, tau, NAMES, tuple(range(0, N, 4)))
    assert (gls(alone).beta == wls(alone).beta).all()


def test_a_motion_known_exactly_needs_no_instruments(exact: Callable[..., Recording]) -> None:
    """At a rate at which interpolation between every second sample leaves no error."""
    robot = load_robot("planar_2r")
    recording = exact(robot, np.arange(0, 10, 1 / 512))
    found = identify(robot, [recording], estimator="iv")
    assert "no errors of it to be tested" in found.notes[-1]
    known = identify(robot, [recording]).least_squares
    std = np.sqrt(np.diag(known.covariance))
    assert (np.abs(found.least_squares.beta - known.beta) <= 1e-2 * std).all()


def test_a_rate_too_low_for_every_second_sample_is_refused(noisy: Recording) -> None:
    with pytest.raises(BadInput, match=r"choose one up to 25.6 Hz"):
        identify(load_robot("planar_2r"), [noisy], cutoff_hz=40.0, estimator="iv")


def test_the_estimator_is_refused_by_name(noisy: Recording) -> None:
    with pytest.raises(UnknownName, match="unknown estimator 'huber'"):
        identify(load_robot("planar_2r"), [noisy], estimator="huber")


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--estimator", "huber"], "unknown estimator 'huber'"),
        (["--estimator", "gls", "--online"], "--estimator is for all rows at once"),
        (["--estimator", "gls", "--link-by-link"], "--estimator is for all rows at once"),
    ],
)
def test_the_command_refuses_in_one_line(
    words: list[str], why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["identify", "planar_2r", "nowhere.csv", *words]) == 1
    said = capsys.readouterr().err
    assert why in said
    assert said.count("\n") == 1


def test_the_command_says_which_estimator(noisy: Recording, tmp_path: Path) -> None:
    table = np.column_stack([noisy.t, noisy.q, noisy.tau])
    file = tmp_path / "run.csv"
    np.savetxt(file, table, delimiter=",", header="t,q1,q2,tau1,tau2", comments="")
    words = ["identify", "planar_2r", str(file), "--estimator", "irls", "-o", str(tmp_path / "o")]
    assert main(words) == 0
    result = json.loads((tmp_path / "o" / "result.json").read_text(encoding="utf-8"))
    assert result["estimator"].startswith(DESCRIPTIONS["irls"])
