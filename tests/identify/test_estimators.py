"""Estimators on columns that are known and on arms: closed forms, and what each is for."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
import scipy.signal
from arms import truth
from known_arms import HARMONICS, Z95, Call, recorded, rows_of, smooth_motion, write_csv

from excitant.exceptions import BadInput, RankDeficient
from excitant.identify import Recording, Regression, identify_robot
from excitant.identify.attenuation import every_second, without_noise
from excitant.identify.drive_gains import BODY_STD
from excitant.identify.estimators import ESTIMATORS, Smoothing, irls, iv, smoothed_regression
from excitant.identify.knowledge import Knowledge
from excitant.identify.least_squares import (
    LeastSquares,
    autocorrelation_time,
    weighted_least_squares,
)
from excitant.identify.physical import fit_physical
from excitant.identify.preprocessing import prepare, stilled
from excitant.identify.prior import prior_parameters
from excitant.identify.regression import dense
from excitant.identify.rows import fit_rows, split
from excitant.robots import Robot
from excitant.robots.effects import standard_effects
from excitant.robots.parameters import violations

N, NV, R = 400, 2, 4
NAMES = tuple(f"beta{k}" for k in range(R))
BETA = np.array([3.0, -0.5, 0.02, 1.0])
SIZE = np.array([1.0, 20.0, 300.0, 1.0])
SIGMA = np.array([0.3, 2.0])
Problem = tuple[Regression, Regression]
BY_NAME: dict[str, Callable[[Problem], LeastSquares]] = {
    "wls": lambda both: weighted_least_squares(both[0]),
    "irls": lambda both: irls(both[0]),
    "iv": lambda both: iv(*both),
    "halves": lambda both: by_halves(*both),
}
every = pytest.mark.parametrize("name", [name for name in ESTIMATORS if name in BY_NAME])


def columns(n: int = N) -> np.ndarray:
    """Slow columns of different sizes; the last one is a constant, as an offset's."""
    rng = np.random.default_rng(0)
    t = np.linspace(0, 1, n)[:, None, None]
    frequency, phase = rng.uniform(0.5, 6, (NV, R)), rng.uniform(0, 6.28, (NV, R))
    W: np.ndarray = SIZE * np.sin(2 * np.pi * frequency * t + phase)
    W[:, :, -1] = [1.0, 0.5]
    return W


def measured(rng: np.random.Generator | int, rho: float, n: int = N) -> np.ndarray:
    """Torque of the columns with autoregressive noise."""
    white = np.random.default_rng(rng).standard_normal((n + 200, NV)) * np.sqrt(1 - rho**2)
    noise = scipy.signal.lfilter([1.0], [1.0, -rho], white, axis=0)[200:]
    return columns(n) @ BETA + SIGMA * noise


def problem(W: np.ndarray, tau: np.ndarray, Z: np.ndarray | None = None) -> Problem:
    """The regression, and the one of its instruments."""
    return dense(W, tau, NAMES), dense(W if Z is None else Z, tau, NAMES)


def by_halves(one: Regression, other: Regression) -> LeastSquares:
    """Mean columns without the bias by the square of half their difference."""
    mean, half = (dense((one.W + k * other.W) / 2, one.tau, NAMES) for k in (1, -1))
    R, z = mean.factor(1 / SIGMA)
    R = without_noise(R, half.gram(SIGMA**-2.0)[:-1, :-1])
    return LeastSquares(np.linalg.lstsq(R, z)[0], np.linalg.inv(R.T @ R), SIGMA, np.ones(NV))


def draws(
    names: Sequence[str], make: Callable[[np.random.Generator], Problem], count: int
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Errors and standard deviations that each estimator gives, of shape (count, R)."""
    rng = np.random.default_rng(1)
    problems = [make(rng) for _ in range(count)]
    fits = ([BY_NAME[name](rows) for rows in problems] for name in names)
    return [(np.array([f.beta - BETA for f in x]), np.array([f.std for f in x])) for x in fits]


def biased(errors: np.ndarray) -> np.ndarray:
    """Mean error over its standard deviation, shape (R,)."""
    return np.abs(errors.mean(axis=0)) / (errors.std(axis=0) / np.sqrt(len(errors)))


def covered(errors: np.ndarray, stds: np.ndarray) -> float:
    return float((np.abs(errors) <= Z95 * stds).mean())


@every
def test_noiseless_data_give_the_truth(name: str) -> None:
    W = columns()
    fit = BY_NAME[name](problem(W, W @ BETA))
    np.testing.assert_allclose(fit.beta, BETA, rtol=1e-6)
    assert (fit.std * SIZE <= 1e-6).all()
    arrays = [x for x in vars(fit).values() if isinstance(x, np.ndarray)]
    assert not any(values.flags.writeable for values in arrays)


@every
def test_the_unit_of_a_joint_and_of_a_column_does_not_matter(name: str) -> None:
    W, tau = columns(), measured(3, 0.5)
    joint, unit = np.array([1e3, 2.0]), np.array([1.0, 1e3, 1e-2, 1.0])
    fit = BY_NAME[name](problem(W, tau))
    scaled = BY_NAME[name](problem(joint[:, None] * W / unit, joint * tau))
    close, covariance = np.testing.assert_allclose, scaled.covariance / np.outer(unit, unit)
    settled = 1e-8 if name == "wls" else 1e-4  # the others iterate
    close(scaled.beta / unit, fit.beta, atol=settled * fit.std.min(), rtol=min(settled, 1e-6))
    close(covariance, fit.covariance, rtol=10 * settled)
    close(scaled.sigma, joint * fit.sigma, rtol=settled)
    close(scaled.inflation, fit.inflation, rtol=10 * settled)


@every
@pytest.mark.parametrize(("change", "named"), [(1, {"beta1"}), (2, {"beta0", "beta2"})])
def test_silent_and_dependent_columns_are_named(name: str, change: int, named: set[str]) -> None:
    W = columns()
    W[:, :, change] = (change - 1) * W[:, :, 0]
    with pytest.raises(RankDeficient, match="does not determine") as refusal:
        BY_NAME[name](problem(W, measured(4, 0.0)))
    assert set(refusal.value.names) == named


def test_noise_and_its_correlation_are_found_and_the_noisier_joint_counts_less() -> None:
    n, rho = 800, 0.8
    fit = weighted_least_squares(dense(columns(n), measured(2, rho, n), NAMES))
    tau = (1 + rho) / (1 - rho)  # integrated autocorrelation time of AR(1)
    np.testing.assert_allclose(fit.sigma, SIGMA, rtol=4 * np.sqrt(tau / (2 * n)))
    np.testing.assert_allclose(fit.inflation, tau, rtol=0.5)
    assert autocorrelation_time(np.random.default_rng(0).standard_normal(4000)) < 1.2
    assert autocorrelation_time(np.zeros(100)) == 1.0
    W, tau = columns(), measured(4, 0.0)
    fit = weighted_least_squares(dense(W, tau, NAMES))
    A = (W / SIGMA[:, None]).reshape(-1, R)
    best = np.linalg.lstsq(A, (tau / SIGMA).ravel(), rcond=None)[0]
    std = np.sqrt(np.diag(np.linalg.inv(A.T @ A)))
    # weights are known to √(1/2N); the estimate moves by that share of its deviation
    assert (np.abs(fit.beta - best) <= 4 / np.sqrt(2 * N) * std).all()


def test_robust_regression_withstands_wrong_torques() -> None:
    """5 % of the torques are off by 20 standard deviations, all to one side."""

    def make(rng: np.random.Generator, share: float) -> Problem:
        return problem(columns(), measured(rng, 0.0) + 20 * SIGMA * (rng.random((N, NV)) < share))

    (error, std), (plain, _) = draws(("irls", "wls"), lambda rng: make(rng, 0.05), 30)
    (clean, _), (best, _) = draws(("irls", "wls"), lambda rng: make(rng, 0.0), 30)
    spread = best.std(axis=0)
    deviation = 1 / np.sqrt(2 * 30)  # relative, of a standard deviation from 30 draws
    assert biased(plain)[-1] > 10  # the offset takes the mean of the errors
    rms = np.sqrt((error**2).mean(axis=0))
    assert (rms / spread)[:-1].max() < 1.2 * (1 + 3 * deviation)
    assert (clean.std(axis=0) / spread).max() < 1.06 * (1 + 3 * deviation)
    assert abs(covered(error[:, :-1], std[:, :-1]) - 0.95) <= 3 * np.sqrt(0.95 * 0.05 / 30)
    assert np.abs(error.mean(axis=0) / spread)[-1] < 1.0
    assert rms[-1] < 0.3 * np.sqrt((plain[:, -1] ** 2).mean())


def wrong_columns(rng: np.random.Generator) -> Problem:
    """Columns twice, with independent errors, nearly half of what they are."""
    size = np.array([0.3, 0.3, 0.3, 0.0]) * SIZE
    seen, again = (columns() + size * rng.standard_normal((N, NV, R)) for _ in range(2))
    return problem(seen, measured(rng, 0.5), again)


@pytest.mark.slow
def test_instruments_take_away_the_bias_that_wrong_columns_make() -> None:
    found, plain, halved = draws(("iv", "wls", "halves"), wrong_columns, 60)
    assert (biased(plain[0])[1:3] > 10).all()
    assert (np.maximum(biased(found[0]), biased(halved[0])) < 4).all()
    assert abs(covered(*found) - 0.95) <= 3 * np.sqrt(0.95 * 0.05 / 60)


def test_even_and_odd_samples_see_one_motion_with_independent_noise() -> None:
    t = np.arange(3000) / 200.0

    def seen(values: np.ndarray, speeds: np.ndarray | None = None) -> list[np.ndarray]:
        """Accelerations by even, by odd, and by all samples."""
        log = Recording("log", "log.csv", t, values, 0 * values, dq=speeds)
        logs = every_second(log, 0), every_second(log, 1), log
        return [prepare(each, 7.0, 15.0)[0].motion.ddq[200:-200, 0] for each in logs]

    q = np.sin(2 * np.pi * 0.7 * t)[:, None]
    even, odd, true = seen(q)
    np.testing.assert_allclose(even, odd, atol=1e-3)
    noise, drift = 1e-3 * np.random.default_rng(12).standard_normal((2, len(t), 1))
    independent = len(even) * 2 * 15 / 200  # samples that a band of 15 Hz leaves
    for speeds in (np.gradient(q, t, axis=0) + drift, None):
        even, odd, both = (each - true for each in seen(q + noise, speeds))
        assert abs(np.corrcoef(even, odd)[0, 1]) < 4 / np.sqrt(independent)
    # half the samples: twice the density of noise
    assert even.std() / both.std() == pytest.approx(np.sqrt(2), rel=0.1)


KNOWN = truth("planar_2r")
MOTION = smooth_motion(KNOWN.robot, np.arange(0, 10, 1 / 125), hz=0.64 * HARMONICS)
NOISY = recorded(KNOWN, smooth_motion(KNOWN.robot, np.arange(0, 7, 1 / 125)), 13, encoder=1e-4)


@pytest.mark.parametrize("name", list(ESTIMATORS))
def test_every_estimator_identifies_a_robot(name: str, planar: Robot) -> None:
    found = identify_robot(planar, [NOISY], estimator=name)
    assert found.validate.nrmse.max() < 0.02  # of noise that the filter left
    assert violations(found.phi, planar.links) == []
    assert np.linalg.eigvalsh(found.least_squares.covariance).min() > 0
    assert found.estimator == ESTIMATORS[name]
    said = " ".join(found.notes)
    assert (f"base parameters by {ESTIMATORS[name]}" in said) == (name != "wls")
    assert ("positions count up to" in said) == (name == "smooth")


def test_bursts_of_torque_make_the_default_robust(planar: Robot) -> None:
    """Of torque, independent of the motion; errors that depend on it are the model's."""
    rng = np.random.default_rng(1)
    struck = np.repeat(rng.choice([-1, 0, 1], (50, 2), p=[0.03, 0.94, 0.03]), 20, axis=0)
    bursts = 3 * NOISY.tau.std(axis=0) * struck[: len(NOISY)]
    clean = identify_robot(planar, [NOISY])
    found = identify_robot(planar, [replace(NOISY, tau=NOISY.tau + bursts)])
    assert found.estimator == ESTIMATORS["irls"]
    assert "in bursts or contact" in " ".join(found.notes)
    assert "friction turns" not in " ".join(found.notes)
    error = np.abs(found.least_squares.beta - clean.least_squares.beta)
    assert (error < 4 * found.least_squares.std).all()
    # only where a joint goes fast: as likely to be physics as bursts
    speed = np.gradient(NOISY.q, NOISY.t, axis=0)
    fast = np.abs(speed) > np.quantile(np.abs(speed), 0.95, axis=0)
    lacking = 3 * NOISY.tau.std(axis=0) * fast * np.sign(speed)
    found = identify_robot(planar, [replace(NOISY, tau=NOISY.tau + lacking)])
    assert found.estimator == ESTIMATORS["wls"]


def test_coarse_encoders_make_the_default_smooth_positions(planar: Robot, monkeypatch) -> None:
    coarse = replace(NOISY, q=8e-3 * np.round(NOISY.q / 8e-3))
    fits = [identify_robot(planar, [coarse], estimator=name) for name in (None, "wls")]
    assert fits[0].estimator == ESTIMATORS["smooth"]
    assert "positions are coarse beside the motion" in " ".join(fits[0].notes)
    found, plain = (each.least_squares.beta - KNOWN.beta for each in fits)
    assert (np.abs(found) < 4 * fits[0].least_squares.std).all()
    W = fits[0].holdout_columns
    assert np.linalg.norm(W @ found) < np.linalg.norm(W @ plain) / 1.5
    # smoothed so far that motion is lost: that leaves more of the torque
    monkeypatch.setattr("excitant.identify.estimators.SMOOTHING", Smoothing(wider=0.2))
    assert identify_robot(planar, [coarse]).estimator == ESTIMATORS["wls"]


def test_the_default_identifies_as_by_hand(planar: Robot) -> None:
    """To rounding, which depends on where arrays lie in memory."""
    effects = standard_effects(planar.joints)
    found = identify_robot(planar, [NOISY], effects=effects)
    rows = fit_rows(planar, effects, found.base, split([NOISY]))
    fit = weighted_least_squares(rows.reduced)
    R, z = rows.regression.factor(fit.weight)
    near = Knowledge().near({planar.links[0]: planar.phi[0]}, BODY_STD)
    bodies = prior_parameters(planar)
    physical = fit_physical(R, z, bodies, rows.open_prior, near, planar.links)
    np.testing.assert_allclose(found.physical.x, physical.x, rtol=0, atol=1e-10)
    # and the bias that noise of these positions makes
    np.testing.assert_allclose(found.least_squares.std, fit.std, rtol=0.01)
    assert (found.least_squares.std >= fit.std * (1 - 1e-12)).all()


def test_positions_without_noise_lose_no_motion_that_torque_shows(planar, exact: Call) -> None:
    recording = exact(planar, np.arange(0, 10, 1 / 512))
    fit = identify_robot(planar, [recording], estimator="smooth").least_squares
    known = identify_robot(planar, [recording], estimator="wls").least_squares
    assert (np.abs(fit.beta - known.beta) <= 1.5 * known.std).all()
    assert (fit.sigma <= 1.01 * known.sigma).all()


def test_instruments_need_no_noise_but_a_rate_for_every_second_sample(
    planar: Robot, exact: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At a rate at which interpolation between every second sample leaves no error."""
    recording = exact(planar, np.arange(0, 10, 1 / 512))
    fit = identify_robot(planar, [recording], estimator="iv").least_squares
    known = identify_robot(planar, [recording], estimator="wls").least_squares
    assert (np.abs(fit.beta - known.beta) <= 1e-2 * known.std).all()
    np.testing.assert_allclose(fit.covariance, known.covariance, rtol=1e-2)
    with pytest.raises(BadInput, match=r"choose one up to 25 Hz"):
        identify_robot(planar, [NOISY], cutoff_hz=40.0, estimator="iv")
    singular = Mock(side_effect=np.linalg.LinAlgError("singular"))
    monkeypatch.setattr("excitant.identify.estimators.iv", singular)
    with pytest.raises(BadInput, match="every second sample shows too little"):
        identify_robot(planar, [NOISY], estimator="iv")


def test_the_command_says_which_estimator(tmp_path: Path, excitant: Call) -> None:
    write_csv(tmp_path / "run.csv", NOISY)
    ran = excitant("identify planar_2r --json --estimator irls", tmp_path / "run.csv")
    assert ran.result["estimator"].startswith(ESTIMATORS["irls"])


@pytest.mark.slow
def test_noisy_encoders_bias_least_squares_not_smoothed_positions(planar: Robot) -> None:
    """One motion, draws of noise only: mean error over its standard deviation."""
    count, errors, plain, held = 5, [], [], []
    for seed in range(count):
        rows = rows_of(planar, recorded(KNOWN, MOTION, seed, encoder=5e-4), cutoff_hz=25.0)
        fit = weighted_least_squares(smoothed_regression(rows)[0])
        errors.append(fit.beta - KNOWN.beta)
        held.append(np.abs(errors[-1]) < Z95 * fit.std)
        plain.append(weighted_least_squares(rows.reduced).beta - KNOWN.beta)
    assert biased(np.array(errors)).max() < 4 < 15 < biased(np.array(plain)).max()
    assert np.mean(held) > 0.95 - 3 * np.sqrt(0.05 * 0.95 / count)


def test_smoothed_positions_are_better_than_a_bad_filter(planar: Robot) -> None:
    rows = rows_of(planar, recorded(KNOWN, MOTION[:625], 0, encoder=1e-3), cutoff_hz=25.0)
    smoothed, bandwidth_hz = smoothed_regression(rows)
    size = np.sqrt((rows.reduced.W**2).mean(axis=(0, 1)))
    fits = (weighted_least_squares(problem) for problem in (smoothed, rows.reduced))
    error, plain = (np.linalg.norm((fit.beta - KNOWN.beta) * size) for fit in fits)
    assert error < 0.2 * plain
    # the motion ends at 0.83 Hz; positions pass 2.5 times as far, or a little more
    assert 2.5 * 0.83 <= bandwidth_hz.min() <= bandwidth_hz.max() < 6
    [train] = rows.data.train
    still = replace(rows, data=replace(rows.data, train=(stilled(train, np.array([True, False])),)))
    assert len(smoothed_regression(still)[0]) >= len(smoothed)
