"""Regressions and their least squares: products, intervals, and the parameters that matter.

95 % intervals of predicted torque hold 95 % of unseen readings, and say when they do not.
"""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import scipy.signal
import scipy.stats
from arms import Truth, truth
from known_arms import Z95, Call, rows_of
from marks import refusal, refused, slow

from excitant.design import random_trajectory
from excitant.exceptions import BadInput, RankDeficient
from excitant.identify import Recording, identify_robot
from excitant.identify.accuracy import (
    PredictionInterval,
    coverage,
    independent_squares,
    prediction_interval,
    torque_std,
)
from excitant.identify.least_squares import (
    JointRows,
    LeastSquares,
    autocorrelation,
    autocovariance,
    score_covariances,
    weighted_least_squares,
)
from excitant.identify.preprocessing import prepare
from excitant.identify.regression import ActingColumns, dense, joined, weighted
from excitant.robots import Array, Robot
from excitant.robots.virtual_arm import industrial_sensors

N, NV, P = 60, 3, 5
NAMES = tuple("abcde")
RNG = np.random.default_rng(0)
TAU = RNG.standard_normal((N, NV))
W, OTHER, MORE = (  # columns, some of which act on some joints only
    RNG.standard_normal((N, NV, p)) * (RNG.random((NV, p)) < 0.7) for p in (P, P, 2)
)
MIXTURE = RNG.standard_normal((P, 2))
PROBLEM = dense(W, TAU, NAMES)


def test_products_and_triangles_are_those_of_the_rows() -> None:
    weight = np.array([1.0, 2.0, 0.5])
    A = np.concatenate([W, TAU[:, :, None]], axis=2) * weight[:, None]
    products = np.einsum("njp,njq->pq", A, A)
    np.testing.assert_allclose(PROBLEM.gram(weight**2), products, atol=1e-12)
    few = weighted(PROBLEM.products_of(np.array([3, 0])), weight**2)
    np.testing.assert_allclose(few, products[np.ix_([3, 0, P], [3, 0, P])], atol=1e-12)
    factor = np.column_stack(PROBLEM.factor(weight))
    np.testing.assert_allclose(factor.T @ factor, products, atol=1e-10)


def test_rows_come_back_and_other_problems_are_those_of_other_rows_and_columns() -> None:
    count = np.random.default_rng(3).random((N, NV)) < 0.5
    few, counted = PROBLEM.select([3, 0]), PROBLEM.counting(count)
    for problem, rows in (
        (PROBLEM, W),
        (few, W[:, :, [3, 0]]),
        (PROBLEM.with_columns(MORE, ["f", "g"]), np.concatenate([W, MORE], axis=2)),
        (counted, W * count[:, :, None]),
        (PROBLEM.at(slice(None, None, 4)), W[::4]),
        (joined([PROBLEM, dense(OTHER, TAU, NAMES)]), np.concatenate([W, OTHER])),
        (dense(W, TAU, NAMES, count), W * count[:, :, None]),
    ):
        np.testing.assert_array_equal(problem.W, rows)
    x = np.arange(P, dtype=float)
    np.testing.assert_allclose(PROBLEM.residual(x), TAU - W @ x)
    assert all((W[:, j, own] != 0).any() for j, own in enumerate(PROBLEM.index))
    assert few.names == ("d", "a")
    np.testing.assert_array_equal(counted.tau, TAU * count)
    np.testing.assert_array_equal(PROBLEM.select([]).residual(np.zeros(0)), TAU)


def test_parts_without_the_joints_where_they_do_not_act_are_the_same_columns() -> None:
    zeros = np.zeros((N, NV, 1))
    last, first = (zeros + np.eye(NV)[j][:, None] for j in (NV - 1, 0))
    all_of = [W, first, zeros, last]
    parts = [ActingColumns.of(part) for part in all_of[:3]]
    parts.append(ActingColumns.of(last[:, 1:], range(1, NV)))
    assert [part.joints.tolist() for part in parts[1:]] == [[0], [], [NV - 1]]
    for part, whole in zip(parts, all_of, strict=True):
        np.testing.assert_array_equal(part.on(NV), whole)
    np.testing.assert_array_equal(ActingColumns.of(W[:, ::-1], range(NV)[::-1]).on(NV), W)
    np.testing.assert_allclose((parts[0] @ MIXTURE).on(NV), W @ MIXTURE, atol=1e-14)
    wide = np.concatenate(all_of, axis=2)
    names = [str(k) for k in range(wide.shape[2])]
    found, expected = dense(parts, TAU, names), dense(wide, TAU, names)
    np.testing.assert_array_equal(found.W, wide)
    assert [own.tolist() for own in found.index] == [own.tolist() for own in expected.index]


def test_what_does_not_fit_is_refused() -> None:
    for tau, names, why in (
        (TAU[:-1], NAMES, "shape"),
        (TAU, NAMES[1:], "4 names"),
        (np.full_like(TAU, np.nan), NAMES, "finite"),
    ):
        refused(why, dense, W, tau, names, error=BadInput)
    refused("shape", dense, [ActingColumns(np.arange(2), W)], TAU, NAMES, error=BadInput)


@pytest.mark.parametrize("size", [1e-3, 1e-6, 1e-9, 0.0])
def test_a_joint_without_torque_hides_no_parameter_of_the_others(size: float) -> None:
    """A last link without mass, or a dead channel: rows of its joint are fine beyond all others."""
    rng, n = np.random.default_rng(1), 400
    W = rng.standard_normal((n, 2, 3)) * np.array([[1, 1, 1], [0, 0, 1]])
    tau = np.column_stack([W[:, 0] @ [2.0, -1.0, 0.0], np.zeros(n)])
    tau += rng.standard_normal(tau.shape) * np.array([0.1, size])
    fit = weighted_least_squares(dense(W, tau, ("a", "b", "c")))
    alone = weighted_least_squares(dense(W[:, :1, :2], tau[:, :1], ("a", "b")))
    np.testing.assert_allclose(fit.beta[:2], alone.beta, rtol=1e-3)
    np.testing.assert_allclose(fit.std[:2], alone.std, rtol=0.05)
    assert abs(fit.beta[2]) <= 5 * max(size, 1e-6 * 0.1) / np.sqrt(n)


def test_what_a_motion_does_not_show_is_named_whatever_the_noise() -> None:
    """As without noise of several sizes: `test_silent_and_dependent_columns_are_named`."""
    twin = dense(W[:, :, [0, 1, 2, 3, 3]], TAU * np.array([1.0, 1e-9, 1e3]), NAMES)
    assert refusal(".", weighted_least_squares, twin, error=RankDeficient).names == ("d", "e")


def test_the_covariance_of_columns_that_nearly_depend_is_that_of_independent_ones() -> None:
    """β_a and β_b of a and a + 1e-8 v: β_b is 1e8 times as unsure as the coefficient of v."""
    apart = np.random.default_rng(4).standard_normal((N, NV, 2))
    nearly = np.stack([apart[..., 0], apart[..., 0] + 1e-8 * apart[..., 1]], axis=2)
    fit, expected = (weighted_least_squares(dense(x, TAU, ("a", "b"))) for x in (nearly, apart))
    np.testing.assert_allclose(fit.std, 1e8 * expected.std[1], rtol=1e-6)


def test_uncorrected_residuals_would_be_too_sure() -> None:
    """Over many draws the corrected scores are right on average; those of residuals are not."""
    rng, draws, n = np.random.default_rng(0), 60, 400
    t = np.linspace(0, 1, n)[:, None, None]
    W = np.sin(2 * np.pi * rng.uniform(0, 6, (2, 5)) * t + rng.uniform(0, 6.28, (2, 5)))
    flat = np.linalg.qr(W.reshape(-1, 5))[0]
    joints = [JointRows(Q, np.eye(5)) for Q in flat.reshape(n, 2, 5).swapaxes(0, 1)]
    gamma = scipy.linalg.toeplitz(0.9 ** np.arange(n))
    root = np.linalg.cholesky(gamma)
    true = np.array([np.trace(joint.X.T @ gamma @ joint.X) for joint in joints])
    found, plain = np.zeros(2), np.zeros(2)
    for _ in range(draws):
        noise = (root @ rng.standard_normal((400, 2))).ravel()
        residual = (noise - flat @ (flat.T @ noise)).reshape(400, 2)
        found += np.trace(score_covariances(joints, list(residual.T))[0], axis1=1, axis2=2) / draws
        gammas = autocovariance(residual, 26).T
        plain += [np.trace(x.score(g)) / draws for x, g in zip(joints, gammas, strict=True)]
    assert (found > 1.05 * plain).all()
    assert found / true == pytest.approx(1.0, abs=0.2)  # √(4 (1 + ρ) / ((1 − ρ) N draws)) = 6 %


RATE_HZ, ENCODER, NOISE_SHARE = 125.0, 2e-5, 0.02  # rad; of each joint's rms torque
NOISES = {
    "white": ([1.0], [1.0]),
    "ar 0.05 s": ([1.0], [1.0, -np.exp(-1 / (RATE_HZ * 0.05))]),
    "ar 0.2 s": ([1.0], [1.0, -np.exp(-1 / (RATE_HZ * 0.2))]),
    "low-pass 3 Hz": scipy.signal.butter(2, 3.0, fs=RATE_HZ),
}


def coloured(kind: str, rng: np.random.Generator, n: int, nv: int) -> np.ndarray:
    """Stationary noise of unit variance, shape (n, nv)."""
    settle, (b, a) = round(3 * RATE_HZ), NOISES[kind]
    impulse = scipy.signal.lfilter(b, a, np.eye(1, settle)[0])
    white = rng.standard_normal((n + settle, nv))
    made = scipy.signal.lfilter(b, a, white, axis=0) / np.linalg.norm(impulse)
    return np.asarray(made[settle:])


def scaled_errors(known: Truth, rng: np.random.Generator, seconds: float) -> np.ndarray:
    """Error over standard deviation of every base parameter on one motion, shape (noises, r)."""
    t = np.arange(0, seconds, 1 / RATE_HZ)
    motion = random_trajectory(known.robot, rng, 10.0, 5).at(t)
    tau = known.arm.torque(motion)
    size = NOISE_SHARE * np.sqrt((tau**2).mean(axis=0))
    measured = motion.q + ENCODER * rng.standard_normal(tau.shape)
    torques = (tau + size * coloured(kind, rng, *tau.shape) for kind in NOISES)
    runs = [Recording("run", "run.csv", t, measured, noisy) for noisy in torques]
    rows, found = rows_of(known.robot, runs[0]).reduced, []
    for run in runs:  # the same positions make the same columns
        kept = np.concatenate([segment.tau[segment.keep] for segment in prepare(run, 10.0)])
        fit = weighted_least_squares(rows.with_torque(kept))
        found.append((fit.beta - known.beta) / fit.std)
    return np.array(found)


@pytest.mark.parametrize(
    ("robot", "recordings", "seconds", "seed", "deviations", "slack"),
    [
        slow("planar_2r", 40, 10.0, 0, 3, 0.01),
        slow("planar_2r", 150, 30.0, 1, 2, 0.02),
        slow("ur10", 30, 30.0, 1, 2, 0.02),
    ],
)
def test_intervals_cover_the_truth(robot, recordings, seconds, seed, deviations, slack):
    """Intervals of one recording depend on each other, recordings do not."""
    known, draws = truth(robot), (np.random.default_rng([seed, k]) for k in range(recordings))
    errors = np.array([scaled_errors(known, rng, seconds) for rng in draws])
    each = (np.abs(errors) <= Z95).mean(axis=2)
    share, spread = each.mean(axis=0), each.std(axis=0, ddof=1) / np.sqrt(recordings)
    assert (np.abs(share - 0.95) <= deviations * spread + slack).all(), share


@pytest.mark.parametrize("n", [541, 600, 1012])  # transforms of odd and even length
def test_autocorrelation_is_that_of_sums_over_lags(n: int) -> None:
    x = np.random.default_rng(n).standard_normal(n).cumsum()
    sums = np.correlate(x - x.mean(), x - x.mean(), "full")[n - 1 :][: n // 3]
    np.testing.assert_allclose(autocorrelation(x), sums / sums[0], rtol=0, atol=1e-12)


def columns(rng: np.random.Generator, n: int, r: int = 8, sines: int = 4) -> Array:
    """Slow sums of sines at two joints, as the regressor of a motion is."""
    t = np.arange(n)[:, None, None] / 40
    return sum(
        rng.normal(size=(2, r)) * np.sin(2 * np.pi * f * t + rng.uniform(0, 6, (2, r)))
        for f in rng.uniform(0.1, 2.0, sines)
    )


def noise(rho: float, rng: np.random.Generator, n: int) -> Array:
    """First-order autoregressive noise of unit variance at two joints."""
    white = rng.standard_normal((n + 300, 2)) * np.sqrt(1 - rho**2)
    made: Array = scipy.signal.lfilter([1.0], [1.0, -rho], white, axis=0)
    return made[300:]


SIZES = np.array([0.5, 2.0])


@pytest.mark.parametrize(
    ("rho", "n"), [slow(rho, n) for rho, n in ((0.8, 150), (0.0, 150), (0.0, 600), (0.8, 600))]
)
def test_intervals_hold_95_percent_of_unseen_readings(rho: float, n: int) -> None:
    hits, plain = [], []
    for draw in range(200):
        rng = np.random.default_rng([draw, n])
        W, new, beta = columns(rng, n), columns(rng, 200), rng.normal(size=8)
        tau = W @ beta + noise(rho, rng, n) * SIZES
        fit = weighted_least_squares(dense(W, tau, tuple("abcdefgh")))
        residual = tau - W @ fit.beta
        found = prediction_interval(new, fit, list(residual.T))
        error = np.abs(new @ beta + noise(rho, rng, 200) * SIZES - new @ fit.beta)
        hits.append(coverage(list((error <= found.half_width).T)).share)
        rms = np.sqrt((residual**2).mean(axis=0))
        plain.append(coverage(list((error <= 1.96 * rms).T)).share)
    share = np.mean(hits, axis=0)
    assert (np.abs(share - 0.95) < 0.02).all(), share
    if n == 150 and rho:  # what residuals alone announce is too little
        assert np.mean(plain) < 0.93 < np.mean(hits)


def test_intervals_are_those_of_the_linear_map_in_any_unit() -> None:
    rng = np.random.default_rng(0)
    W, root = columns(rng, 50), rng.normal(size=(8, 8))
    expected = [np.sqrt(np.diag(row @ root @ root.T @ row.T)) for row in W]
    np.testing.assert_allclose(torque_std(W, root @ root.T), expected)
    rng = np.random.default_rng(2)
    W = columns(rng, 200)
    fit = LeastSquares(np.ones(8), 1e-3 * np.eye(8), np.ones(2), np.ones(2))
    residual, gains = noise(0.0, rng, 200) * SIZES, np.array([10.0, 4.0])
    torque = prediction_interval(W, fit, list(residual.T))
    current = prediction_interval(W, fit, list((residual / gains).T), gains)
    np.testing.assert_allclose(current.half_width * gains, torque.half_width)


@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_correlated_residuals_know_their_variance_from_fewer_samples(rho: float) -> None:
    found = independent_squares(noise(rho, np.random.default_rng(3), 20_000)[:, 0])
    assert found == pytest.approx(20_000 * (1 - rho**2) / (1 + rho**2), rel=0.2 if rho else 0.1)
    assert independent_squares(np.zeros(50)) == 50


@pytest.mark.parametrize(("freedom", "width"), [(3.0, 3.182), (1e9, 1.960)])
def test_half_width_is_students(freedom: float, width: float) -> None:
    found = PredictionInterval(np.zeros((1, 1)), np.ones(1), np.array([freedom]))
    assert found.half_width[0, 0] == pytest.approx(width, abs=1e-3)


def test_identify_reports_intervals_and_coverage(planar: Robot, runs: Call) -> None:
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
    np.testing.assert_array_equal(found.series()["half_width"], found.interval.half_width)


def test_a_hidden_effect_of_the_hold_out_is_said_to_be_missed(planar: Robot, exact: Call) -> None:
    t = np.arange(0, 20, 0.01)
    train, other = (exact(planar, t, seed, noise=0.05) for seed in (0, 1))
    # somebody leans on the second joint
    pulled = replace(other, tau=other.tau + np.outer(np.sin(other.t), [0.0, 0.5]))
    found = (identify_robot(planar, [train], validate=[run]) for run in (other, pulled))
    honest, leaned = (each.result()["notes"] for each in found)
    assert not any("misses something" in note for note in honest)
    [said] = [note for note in leaned if "misses something" in note]
    assert [joint in said for joint in planar.joints] == [False, True]
