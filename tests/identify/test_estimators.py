"""Estimators under one interface: closed forms, and what each is for, by Monte Carlo."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import scipy.signal

from excitant.cli import main
from excitant.exceptions import BadInput, Infeasible, RankDeficient, UnknownName
from excitant.identify import Recording, Regression, identify_robot
from excitant.identify.differentiators import ZeroPhaseButterworth
from excitant.identify.estimators import (
    ESTIMATORS,
    closed_loop,
    errors_in_variables,
    every_second,
    irls,
    iv,
    output_error,
)
from excitant.identify.least_squares import LeastSquares, weighted_least_squares
from excitant.identify.physical import fit_physical
from excitant.identify.prior import prior_parameters
from excitant.identify.regression import dense
from excitant.identify.rows import FitRows, fit_rows, split
from excitant.robots import Motion, Robot, base_parameters, load_robot
from excitant.robots.effects import standard_effects
from excitant.robots.parameters import violations

N, NV, R = 400, 2, 4
NAMES = tuple(f"beta{k}" for k in range(R))
BETA = np.array([3.0, -0.5, 0.02, 1.0])
SIZE = np.array([1.0, 20.0, 300.0, 1.0])
SIGMA = np.array([0.3, 2.0])
Problem = tuple[Regression, Regression]
Estimator = Callable[[Problem], LeastSquares]
BY_NAME: dict[str, Estimator] = {
    "wls": lambda both: weighted_least_squares(both[0]),
    "irls": lambda both: irls(both[0]),
    "iv": lambda both: iv(*both),
    "oe": lambda both: output_error(both[0], lambda _: both[0]).fit,
}
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


def problem(W: np.ndarray, tau: np.ndarray, Z: np.ndarray | None = None) -> Problem:
    """The regression, and the one of its instruments."""
    return dense(W, tau, NAMES), dense(W if Z is None else Z, tau, NAMES)


def draws(
    estimators: dict[str, Estimator], make: Callable[[np.random.Generator], Problem], count: int
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
    fit = BY_NAME[name](problem(W, W @ BETA))
    np.testing.assert_allclose(fit.beta, BETA, rtol=1e-6)
    assert (np.sqrt(np.diag(fit.covariance)) * SIZE <= 1e-6).all()
    for values in (fit.beta, fit.covariance, fit.sigma, fit.inflation):
        assert not values.flags.writeable


@every
def test_the_unit_of_torque_and_of_a_column_does_not_matter(name: str) -> None:
    W = columns()
    tau = W @ BETA + SIGMA * coloured(np.random.default_rng(3), 0.5)
    unit = np.array([1.0, 1e3, 1e-2, 1.0])
    fit = BY_NAME[name](problem(W, tau))
    scaled = BY_NAME[name](problem(1e3 * W / unit, 1e3 * tau))
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
        BY_NAME[name](problem(silent, tau))
    assert refusal.value.names == ("beta1",)
    with pytest.raises(RankDeficient) as refusal:
        BY_NAME[name](problem(twins, tau))
    assert set(refusal.value.names) == {"beta0", "beta2"}


def test_without_column_errors_instruments_that_are_the_columns_change_nothing() -> None:
    W = columns()
    tau = W @ BETA + SIGMA * coloured(np.random.default_rng(7), 0.5)
    fit, known = (BY_NAME[name](problem(W, tau)) for name in ("iv", "wls"))
    std = np.sqrt(np.diag(known.covariance))
    assert (np.abs(fit.beta - known.beta) <= 1e-3 * std).all()
    np.testing.assert_allclose(fit.covariance, known.covariance, rtol=1e-2)


def test_robust_regression_withstands_wrong_torques() -> None:
    """5 % of the torques are off by 20 standard deviations, all to one side."""
    W = columns()

    def make(rng: np.random.Generator, share: float) -> Problem:
        wrong = 20 * SIGMA * (rng.random((N, NV)) < share)
        return problem(W, W @ BETA + SIGMA * rng.standard_normal((N, NV)) + wrong)

    both = {name: BY_NAME[name] for name in ("irls", "wls")}
    found, clean = (draws(both, lambda rng, s=s: make(rng, s), 30) for s in (0.05, 0.0))
    error, std = found["irls"]
    spread = clean["wls"][0].std(axis=0)
    deviation = 1 / np.sqrt(2 * 30)  # relative, of a standard deviation from 30 draws
    assert biased(found["wls"][0])[-1] > 10  # the offset takes the mean of the errors
    assert (np.sqrt((error**2).mean(axis=0)) / spread)[:-1].max() < 1.2 * (1 + 3 * deviation)
    assert (clean["irls"][0].std(axis=0) / spread).max() < 1.06 * (1 + 3 * deviation)
    assert abs(covered(error[:, :-1], std[:, :-1]) - 0.95) <= 3 * np.sqrt(0.95 * 0.05 / 30)
    assert np.abs(error.mean(axis=0) / spread)[-1] < 1.0
    rms, plain = (np.sqrt((e[:, -1] ** 2).mean()) for e in (error, found["wls"][0]))
    assert rms < 0.3 * plain


COLUMN_ERROR = np.array([0.3, 0.3, 0.3, 0.0]) * SIZE


def wrong_columns(rng: np.random.Generator) -> Problem:
    """Columns and instruments with independent errors, nearly half of what they are."""
    W = columns()
    seen, again = (W + COLUMN_ERROR * rng.standard_normal(W.shape) for _ in range(2))
    return problem(seen, W @ BETA + SIGMA * coloured(rng, 0.5), again)


def test_instruments_take_away_the_bias_that_wrong_columns_make() -> None:
    found = draws({"iv": BY_NAME["iv"], "wls": BY_NAME["wls"]}, wrong_columns, 60)
    assert (biased(found["wls"][0])[1:3] > 10).all()
    assert (biased(found["iv"][0]) < 4).all()
    assert abs(covered(*found["iv"]) - 0.95) <= 3 * np.sqrt(0.95 * 0.05 / 60)


def test_wrong_columns_are_told_from_right_ones() -> None:
    rng, W = np.random.default_rng(10), columns()
    chances = []
    for _ in range(60):
        again = W + 0.1 * SIZE * rng.standard_normal(W.shape)
        tau = W @ BETA + SIGMA * coloured(rng, 0.5)
        chances.append(errors_in_variables(*problem(W, tau, again))[1])
    alarms = np.mean(np.array(chances) < 0.05)
    assert alarms <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / 60)
    assert np.mean(np.array(chances) < 0.5) >= 0.5 - 3 * np.sqrt(0.25 / 60)
    for _ in range(5):
        statistic, p = errors_in_variables(*wrong_columns(rng))
        assert p < 1e-6
        assert statistic > 30
    with pytest.raises(BadInput, match="nothing is left to test"):
        errors_in_variables(*problem(W, W @ BETA + SIGMA * coloured(rng, 0.0)))


def test_missing_physics_is_no_error_of_columns() -> None:
    rng, W = np.random.default_rng(11), columns()
    again, seen = (W + 0.01 * SIZE * rng.standard_normal(W.shape) for _ in range(2))
    missing = np.sin(np.linspace(0, 40, N))[:, None] * np.array([3.0, 10.0])
    tau = W @ BETA + missing + SIGMA * coloured(rng, 0.0)
    assert errors_in_variables(*problem(seen, tau, again))[1] > 0.001


def test_even_and_odd_samples_see_one_motion_with_independent_noise() -> None:
    t = np.arange(3000) / 200.0
    q = np.sin(2 * np.pi * 0.7 * t)[:, None]
    inner = ZeroPhaseButterworth(15.0)
    even, odd = (every_second(first, inner)(t, q) for first in (0, 1))
    np.testing.assert_allclose(even.ddq[200:-200], odd.ddq[200:-200], atol=1e-3)
    noise = 1e-3 * np.random.default_rng(12).standard_normal((len(t), 1))
    a, b, both = (
        each(t, noise).ddq[200:-200, 0]
        for each in (every_second(0, inner), every_second(1, inner), inner)
    )
    independent = len(a) * 2 * 15 / 200  # samples that a band of 15 Hz leaves
    assert abs(np.corrcoef(a, b)[0, 1]) < 4 / np.sqrt(independent)
    # half the samples: twice the density of noise
    assert a.std() / both.std() == pytest.approx(np.sqrt(2), rel=0.1)


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
    found = identify_robot(robot, [noisy], estimator=name)
    assert found.validate.nrmse.max() < 0.02  # of noise that the filter left
    assert violations(found.phi, robot.links) == []
    assert np.linalg.eigvalsh(found.least_squares.covariance).min() > 0
    said = " ".join(found.notes)
    assert (name == "wls") != (f"base parameters by {ESTIMATORS[name]}" in said)
    assert (name == "iv") == ("Durbin-Wu-Hausman" in said)
    for words in ("simulated on the measured motion up to", "converged after"):
        assert (name == "oe") == (words in said)
    assert found.estimator == ESTIMATORS[name]


def test_the_default_identifies_bit_for_bit_as_by_hand(noisy: Recording) -> None:
    robot = load_robot("planar_2r")
    found = identify_robot(robot, [noisy])
    rows = fit_rows(robot, standard_effects(robot.joints), found.base, split([noisy]))
    fit = weighted_least_squares(rows.reduced)
    R, z = rows.regression.factor(fit.weight)
    physical = fit_physical(R, z, prior_parameters(robot), rows.open_prior)
    assert (found.physical.x == physical.x).all()
    assert (found.least_squares.covariance == fit.covariance).all()


def test_a_motion_known_exactly_needs_no_instruments(exact: Callable[..., Recording]) -> None:
    """At a rate at which interpolation between every second sample leaves no error."""
    robot = load_robot("planar_2r")
    recording = exact(robot, np.arange(0, 10, 1 / 512))
    found = identify_robot(robot, [recording], estimator="iv")
    assert "no errors of it to be tested" in found.notes[-1]
    known = identify_robot(robot, [recording]).least_squares
    std = np.sqrt(np.diag(known.covariance))
    assert (np.abs(found.least_squares.beta - known.beta) <= 1e-2 * std).all()


def test_a_rate_too_low_for_every_second_sample_is_refused(noisy: Recording) -> None:
    with pytest.raises(BadInput, match=r"choose one up to 25.6 Hz"):
        identify_robot(load_robot("planar_2r"), [noisy], cutoff_hz=40.0, estimator="iv")


def test_the_estimator_is_refused_by_name(noisy: Recording) -> None:
    with pytest.raises(UnknownName, match="unknown estimator 'huber'"):
        identify_robot(load_robot("planar_2r"), [noisy], estimator="huber")


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--estimator", "huber"], "unknown estimator 'huber'"),
        (["--estimator", "irls", "--online"], "--estimator is for all rows at once"),
        (["--estimator", "irls", "--link-by-link"], "--estimator is for all rows at once"),
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
    assert result["estimator"].startswith(ESTIMATORS["irls"])


RATE = 125.0
FRICTION = np.array([[0.8, 0.4], [1.0, 0.5], [0.1, -0.2]])  # viscous, Coulomb, offset
DRAWS = 12
Z95 = 1.959963984540054


def motion_at(t: np.ndarray) -> Motion:
    """Sines of incommensurate frequencies, so that nothing repeats, differentiated on paper."""
    f = np.array([[0.21, 0.34], [0.47, 0.58], [0.83, 0.71]])[:, None, :]
    phase = np.random.default_rng(7).uniform(0, 2 * np.pi, (3, 1, 2))
    w, size = 2 * np.pi * f, np.array([0.7, 0.5, 0.3])[:, None, None]
    parts = (
        (size * w**order * np.sin(w * t[:, None] + phase + order * np.pi / 2)).sum(axis=0)
        for order in range(3)
    )
    return Motion(t, *parts)


def recorded(robot: Robot, seed: int, encoder: float, noise: float = 0.02) -> Recording:
    """Recursive Newton-Euler and friction written here."""
    rng, t = np.random.default_rng(seed), np.arange(0, 16, 1 / RATE)
    motion, data = motion_at(t), robot.model.createData()
    states = zip(motion.q, motion.dq, motion.ddq, strict=True)
    tau = np.array([pin.rnea(robot.model, data, *state) for state in states])
    viscous, coulomb, offset = FRICTION
    tau += viscous * motion.dq + coulomb * np.sign(motion.dq) + offset
    tau += noise * np.sqrt((tau**2).mean(axis=0)) * rng.standard_normal(tau.shape)
    q = motion.q + encoder * rng.standard_normal(tau.shape)
    return Recording("run", "run.csv", t, q, tau)


def rows_of(robot: Robot, recording: Recording, cutoff_hz: float = 10.0) -> FitRows:
    effects = standard_effects(robot.joints)
    data = split([recording], [recording], cutoff_hz)
    return fit_rows(robot, effects, base_parameters(robot, effects), data)


def truth(robot: Robot) -> np.ndarray:
    effects = standard_effects(robot.joints)
    values = np.concatenate([robot.phi, *FRICTION, np.zeros(2)])
    beta: np.ndarray = base_parameters(robot, effects).regrouping @ values
    return beta


@pytest.mark.slow
@pytest.mark.parametrize("cutoff_hz", [10.0, 25.0])
def test_noisy_encoders_do_not_bias_it_though_least_squares(
    planar: Robot, cutoff_hz: float
) -> None:
    """One motion, draws of noise only: mean error over its standard deviation."""
    beta, errors, plain, held = truth(planar), [], [], []
    for seed in range(DRAWS):
        recording = recorded(planar, seed, encoder=5e-4)
        rows = rows_of(planar, recording, cutoff_hz)
        loop = closed_loop(rows, [recording])
        fit = output_error(loop.problem, loop.simulated).fit
        errors.append(fit.beta - beta)
        held.append(np.abs(errors[-1]) < Z95 * np.sqrt(np.diag(fit.covariance)))
        plain.append(weighted_least_squares(rows.reduced).beta - beta)
    assert biased(np.array(errors)).max() < 4
    assert np.mean(held) > 0.95 - 3 * np.sqrt(0.05 * 0.95 / DRAWS)
    if cutoff_hz == 25.0:
        assert biased(np.array(plain)).max() > 15


def test_one_draw_is_better_than_least_squares_of_a_bad_filter(planar: Robot) -> None:
    recording = recorded(planar, 0, encoder=1e-3)
    rows = rows_of(planar, recording, 25.0)
    loop = closed_loop(rows, [recording])
    found = output_error(loop.problem, loop.simulated)
    size = np.sqrt((rows.W[:, :, list(rows.base.columns)] ** 2).mean(axis=(0, 1)))
    error, plain = (
        np.linalg.norm((fit.beta - truth(planar)) * size)
        for fit in (found.fit, weighted_least_squares(rows.reduced))
    )
    assert error < 0.2 * plain
    assert 1 <= found.iterations <= 4
    # the motion ends at 0.83 and 0.71 Hz; the reference goes 2.5 times as far, or a little more
    assert (loop.bandwidth_hz >= 2.5 * np.array([0.83, 0.71])).all()
    assert (loop.bandwidth_hz < 6).all()


def test_parameters_of_no_arm_still_give_a_motion(planar: Robot) -> None:
    """Inertia below zero: what is simulated lies between the given arm and these parameters."""
    recording = recorded(planar, 0, encoder=1e-4)
    loop = closed_loop(rows_of(planar, recording), [recording])
    W = loop.simulated(-3 * truth(planar)).W
    assert np.isfinite(W).all()
    np.testing.assert_allclose(
        np.sqrt((W**2).mean(axis=(0, 1))),
        np.sqrt((loop.problem.W**2).mean(axis=(0, 1))),
        rtol=0.05,
    )


def test_what_does_not_converge_is_refused_in_one_line() -> None:
    rng = np.random.default_rng(0)
    W = rng.standard_normal((200, 1, 2))

    def simulated(beta: np.ndarray) -> Regression:
        """A motion so different for every estimate that none fits its own."""
        return dense(W * (2.0 if abs(beta[0]) > 1.5 else 0.5), tau, ("a", "b"))

    tau = W @ [1.6, 1.0]
    with pytest.raises(Infeasible, match=r"output error: parameters still move") as refusal:
        output_error(dense(W, tau, ("a", "b")), simulated)
    assert "\n" not in str(refusal.value)
