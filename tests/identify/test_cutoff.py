"""Cut-offs from the data: a resonance is filtered out where it is, clean data stay as they are."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.signal

from excitant.cli import main
from excitant.identify import Recording, identify, identify_result
from excitant.identify.cutoff import CutoffChoice, block_errors, choose_cutoffs, paired
from excitant.identify.cutoff_rows import Bank, bank, squared_errors, weighted_fit
from excitant.identify.cutoff_spectra import column_spectra
from excitant.identify.cutoff_study import FACTORS, study
from excitant.identify.differentiators import ZeroPhaseButterworth, low_pass
from excitant.identify.least_squares import weighted_least_squares
from excitant.identify.preprocessing import Tuning, prepare, slowest_known, tuned
from excitant.identify.rows import FitRows, fit_rows, observation, split
from excitant.robots import Motion, Robot, load_robot, torque
from excitant.robots.base_parameters import base_parameters
from excitant.robots.effects import standard_effects
from excitant.robots.regressor import regressor

RATE, JUDGE = 128.0, 10.0
T = np.arange(0, 30, 1 / RATE)
FRICTION = ([3.0, 2.0], [2.0, 1.0], [0.2, -0.1], [0.3, 0.2])  # viscous, dry, offset, rotor
MotionOf = Callable[..., Motion]


@pytest.fixture(scope="module")
def arm() -> Robot:
    """A planar arm with the effects that are identified by default."""
    robot = load_robot("planar_2r")
    effects = standard_effects(robot.joints)
    return robot.with_effects([e.with_values(v) for e, v in zip(effects, FRICTION, strict=True)])


def resonance(rng: np.random.Generator, hz: float, n: int = len(T)) -> np.ndarray:
    """White noise through a resonance of 2 % damping, of unit variance."""
    pole = np.exp((2j - 0.04) * np.pi * hz / RATE)
    ringing = scipy.signal.lfilter(
        [1.0], [1, -2 * pole.real, abs(pole) ** 2], rng.standard_normal(n + 2000)
    )[2000:]
    return np.asarray(ringing / ringing.std(), float)


def recorded(
    arm: Robot, motion: Motion, rng: np.random.Generator, joint: int, hz: float, size: float
) -> Recording:
    """Torque with 1 % white noise, and a resonance at one joint."""
    tau = torque(arm, motion)
    spread = tau.std(axis=0)
    tau = tau + 0.01 * spread * rng.standard_normal(tau.shape)
    tau[:, joint] += size * spread[joint] * resonance(rng, hz, len(tau))
    return Recording("run", "run.csv", motion.t, motion.q, tau)


def rows_of(arm: Robot, recording: Recording, cutoff_hz: float | None = JUDGE) -> FitRows:
    effects = standard_effects(arm.joints)
    data = split([recording], [recording], cutoff_hz)
    return fit_rows(arm, effects, base_parameters(arm, effects), data)


def bank_of(arm: Robot, rows: FitRows, slowest: float = -1.0) -> Bank:
    judge = rows.data.cutoff_hz
    return bank(
        arm, rows.effects, rows.base, rows.data.train, rows.gains, judge_hz=judge,
        lowest_hz=judge / 4, highest_hz=judge, slowest=np.full(arm.nv, slowest),
    )  # fmt: skip


def chosen(arm: Robot, recording: Recording, cutoff_hz: float = JUDGE) -> CutoffChoice:
    rows = bank_of(arm, rows_of(arm, recording, cutoff_hz))
    return choose_cutoffs(rows, arm.joints, np.full(arm.nv, -1.0))


def test_joints_pass_their_own_filter_and_silent_rows_are_zero(
    arm: Robot, motion_of: MotionOf
) -> None:
    motion = motion_of(arm, T)
    [plain] = prepare(Recording("r", "r.csv", T, motion.q, motion.q), JUDGE)
    slow = np.array([0.1, -1.0])
    segment = tuned(plain, Tuning(np.array([2.5, 7.0]), slow))
    rng = np.random.default_rng(0)
    values = rng.standard_normal((len(segment.motion), 2, 3))
    passed = segment.filtered(values)
    assert segment.silent is not None
    np.testing.assert_array_equal(passed[segment.silent], 0.0)
    for j, hz in enumerate((2.5, 7.0)):
        counts = ~segment.silent[:, j]
        np.testing.assert_allclose(
            passed[counts, j], low_pass(values[:, j], hz, RATE)[counts], atol=1e-12
        )
        np.testing.assert_allclose(
            segment.tau[counts, j], low_pass(segment.tau_raw[:, j], hz, RATE)[counts], atol=1e-12
        )
    assert not segment.silent[:, 1].any()
    assert (np.abs(segment.motion.dq[segment.silent[:, 0], 0]) < 0.5).all()
    rows = segment.rows(lambda m: values)
    np.testing.assert_array_equal(rows, passed[segment.keep])


def test_one_filter_on_both_sides_keeps_the_equation_whatever_the_cutoffs(
    ur10: Robot, motion_of: MotionOf
) -> None:
    bare = ur10.with_effects(())
    motion = motion_of(bare, T[:1500])
    [plain] = prepare(Recording("r", "r.csv", motion.t, motion.q, motion.q), JUDGE)
    tau = torque(bare, plain.motion)
    cutoffs = np.array([1.5, 2.0, 3.0, 5.0, 8.0, 10.0])
    segment = tuned(replace(plain, tau_raw=tau), Tuning(cutoffs, np.full(6, -1.0)))
    W = segment.rows(lambda m: regressor(bare, m))
    measured = segment.tau[segment.keep]
    np.testing.assert_allclose(W @ bare.phi, measured, atol=1e-9 * np.abs(tau).max())


def test_gram_matrices_give_the_least_squares_of_their_rows(
    arm: Robot, motion_of: MotionOf
) -> None:
    recording = recorded(arm, motion_of(arm, T), np.random.default_rng(0), 0, 6.0, 0.1)
    rows, hz = rows_of(arm, recording), np.array([4.0, 9.0])
    found = bank_of(arm, rows)
    [part] = found.parts
    at = np.concatenate(part.blocks)
    W, tau = np.zeros((len(at), 2, found.size)), np.zeros((len(at), 2))
    for j, f in enumerate(hz):
        passed = low_pass(part.columns[j], f, part.rate_hz)[at]
        W[:, j, part.used[j]], tau[:, j] = passed[:, :-1], passed[:, -1]
    grams = np.array([found.grams(j, f).sum(axis=0) for j, f in enumerate(hz)])
    beta = weighted_fit(grams, float(found.counts.sum()))
    expected = weighted_least_squares(W, tau, rows.base.expressions)
    # a ridge of 1e-10 on columns of unit length, against a condition number of some hundreds
    np.testing.assert_allclose(beta, expected.beta, rtol=1e-5)
    np.testing.assert_allclose(
        squared_errors(grams, beta), ((W @ beta - tau) ** 2).sum(axis=0), rtol=1e-6
    )


def test_blocks_are_predicted_from_the_others(arm: Robot, motion_of: MotionOf) -> None:
    recording = recorded(arm, motion_of(arm, T), np.random.default_rng(0), 0, 6.0, 0.1)
    found = bank_of(arm, rows_of(arm, recording))
    hz = np.array([5.0, JUDGE])
    errors = block_errors(found, hz)
    assert errors.shape == (10, 2)
    [part] = found.parts
    grams = np.array(
        [np.delete(found.grams(j, f), 3, axis=0).sum(axis=0) for j, f in enumerate(hz)]
    )
    beta = weighted_fit(grams, found.counts.sum() - found.counts[3])
    for j in range(2):
        X = low_pass(part.columns[j], JUDGE, part.rate_hz)[part.blocks[3]]
        residual = X[:, :-1] @ beta[part.used[j]] - X[:, -1]
        assert errors[3, j] == pytest.approx((residual**2).mean(), rel=1e-8)
    # the memory of the slowest filter lies between what is left out and what is fitted
    ends = [
        block[0] - before[-1] for before, block in zip(part.blocks, part.blocks[1:], strict=False)
    ]
    assert min(ends) / part.rate_hz >= 0.4 / 2.5


def test_the_predicted_gain_is_that_of_many_draws(arm: Robot, motion_of: MotionOf) -> None:
    motion = motion_of(arm, T)
    true = torque(arm, motion)
    judged = bank_of(arm, rows_of(arm, Recording("r", "r.csv", T, motion.q, true))).judged()
    default, lower = np.full(2, JUDGE), np.full(2, 5.0)
    errors, foretold = np.zeros((40, 2)), []
    for k in range(len(errors)):
        rng = np.random.default_rng(k)
        ringing = np.column_stack([resonance(rng, 8.0), resonance(rng, 8.0)])
        noisy = true + 0.3 * true.std(axis=0) * ringing
        found = bank_of(arm, rows_of(arm, Recording("r", "r.csv", T, motion.q, noisy)))
        for i, hz in enumerate((default, lower)):
            grams = [found.grams(j, float(f)).sum(axis=0) for j, f in enumerate(hz)]
            beta = weighted_fit(np.array(grams), float(found.counts.sum()))
            error = squared_errors(judged.sum(axis=1), beta)
            errors[k, i] = (error / true.var(axis=0)).sum()
        spectra = column_spectra(found)
        foretold.append(1 - spectra.gained(spectra.error(default), spectra.error(lower))[0])
    ratio = errors[:, 1] / errors[:, 0].mean()
    spread = (ratio - ratio.mean() * errors[:, 0] / errors[:, 0].mean()).std() / np.sqrt(len(ratio))
    assert ratio.mean() < 0.8
    # besides the spread of the draws, a tenth for what the taper makes of slow columns
    assert np.mean(foretold) == pytest.approx(ratio.mean(), abs=3 * spread + 0.1)


@pytest.mark.parametrize(("judge", "hz"), [(10.0, 8.0), (20.0, 15.0)])
def test_a_resonance_lowers_the_cutoff_where_it_is(
    arm: Robot, motion_of: MotionOf, judge: float, hz: float
) -> None:
    lowered, errors = 0, []
    for seed in range(8):
        motion = motion_of(arm, T, seed)
        recording = recorded(arm, motion, np.random.default_rng(seed), 1, hz, 0.5)
        choice = chosen(arm, recording, judge)
        assert choice.cutoffs_hz[0] >= choice.cutoffs_hz[1]
        if choice.cutoffs_hz[1] == judge:
            continue
        lowered += 1
        assert choice.cutoffs_hz[1] < hz
        assert f"residual densest at {hz:.2g}" in choice.reasons[1]
        assert choice.noise_hz[1] == pytest.approx(hz, rel=0.1)
        errors.append([_true_error(arm, recording, f, judge) for f in (choice.cutoffs_hz, None)])
    assert lowered >= 6
    after, before = np.mean(errors, axis=0)
    assert after < 0.8 * before


def _true_error(
    arm: Robot, recording: Recording, cutoffs_hz: np.ndarray | None, judge: float
) -> float:
    """Mean square error of the torque predicted for the motion, against the arm's own."""
    rows = rows_of(arm, recording, judge)
    if cutoffs_hz is not None:
        tuning = Tuning(cutoffs_hz, np.full(arm.nv, -1.0))
        segments = tuple(tuned(s, tuning) for s in rows.data.train)
        rows = fit_rows(arm, rows.effects, rows.base, replace(rows.data, tuned=segments))
    columns = list(rows.base.columns)
    fit = weighted_least_squares(rows.W[:, :, columns], rows.tau, rows.base.expressions)
    W = observation(arm, rows.effects, rows.data.validate)[:, :, columns]
    [segment] = rows.data.validate
    true = segment.rows(lambda m: torque(arm, m))
    return float((((W @ fit.beta - true) / true.std(axis=0)) ** 2).mean())


def test_clean_data_keep_the_default(arm: Robot, motion_of: MotionOf) -> None:
    for seed in range(12):
        recording = recorded(arm, motion_of(arm, T, seed), np.random.default_rng(seed), 0, 8.0, 0)
        choice = chosen(arm, recording)
        np.testing.assert_array_equal(choice.cutoffs_hz, JUDGE)
        assert choice.tuning(JUDGE) is None
        assert "10 Hz for all joints; no lower one" in choice.notes[0]


def test_a_paired_difference_knows_its_error() -> None:
    rng = np.random.default_rng(0)
    before = 2 + rng.uniform(0, 1, (10, 3))
    fall, error = paired(before, 0.9 * before)
    assert fall == pytest.approx(0.1)
    each = 0.1 * (before / before.mean(axis=0)).mean(axis=1)
    assert error == pytest.approx(each.std(ddof=1) / np.sqrt(10))
    assert paired(before[:3], 0.9 * before[:3])[1] == np.inf  # too few to know


def test_the_slowest_known_speed_is_that_of_the_noise() -> None:
    rng, size = np.random.default_rng(0), 1e-4
    q = np.column_stack([np.sin(T), 0.5 * np.sin(2 * T)]) + size * rng.standard_normal((len(T), 2))
    recording = Recording("r", "r.csv", T, q, q)
    found = slowest_known(recording, 20.0)
    noise = ZeroPhaseButterworth(20.0)(T, size * rng.standard_normal((len(T), 2)))
    np.testing.assert_allclose(found, 2 * noise.dq[200:-200].std(axis=0), rtol=0.15)
    coarse = replace(recording, q=np.round(q / 0.01) * 0.01)
    assert (slowest_known(coarse, 20.0) > 10 * found).all()
    assert (slowest_known(replace(recording, t=T[:50], q=q[:50], tau=q[:50]), 20.0) == 0).all()


def resting(arm: Robot, motion_of: MotionOf, held: float) -> Recording:
    """The first joint stands still two seconds of every five, where dry friction holds a load."""
    rng = np.random.default_rng(3)
    motion = motion_of(arm, T)
    rate = np.interp(np.mod(T, 5.0), [0, 0.5, 2.5, 3.0, 5.0], [0, 1, 1, 0, 0])
    rate = rate**2 * (3 - 2 * rate)
    at_rest, curl = rate == 0, np.gradient(rate, T)
    clock = np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) / 2 / RATE)])
    moved = motion_of(arm, clock)
    q = np.column_stack([moved.q[:, 0], motion.q[:, 1]])
    dq = np.column_stack([moved.dq[:, 0] * rate, motion.dq[:, 1]])
    ddq = np.column_stack([moved.ddq[:, 0] * rate**2 + moved.dq[:, 0] * curl, motion.ddq[:, 1]])
    tau = torque(arm, Motion(T, q, dq, ddq))
    tau[at_rest, 0] += held * np.sign(moved.dq[at_rest, 0])
    q = q + 2e-5 * rng.standard_normal(q.shape)
    return Recording("rest", "rest.csv", T, q, tau + 0.01 * rng.standard_normal(tau.shape))


@pytest.mark.parametrize("held", [-6.0, 0.0])
def test_rows_at_rest_are_left_out_where_that_predicts_motion_better(
    arm: Robot, motion_of: MotionOf, held: float
) -> None:
    recording = resting(arm, motion_of, held)
    plain, found = (identify(arm, [recording], tune=tune) for tune in (False, True))
    assert found.study is not None
    choice = found.study.choice
    assert choice.dead_zone
    # at rest 40 % of the time; noise of the velocity decides signs but for one sample in twenty
    assert choice.left_out[0] == pytest.approx(0.4, abs=0.05)
    assert choice.left_out[1] < 0.01
    k = found.base.expressions.index("joint1.Fc")
    wrong = [abs(e.least_squares.beta[k] - FRICTION[1][0]) for e in (plain, found)]
    assert wrong[1] < 0.4 * wrong[0]
    assert wrong[1] < 4 * np.sqrt(found.least_squares.covariance[k, k])


def test_nothing_is_left_out_of_a_motion_without_rest(arm: Robot, motion_of: MotionOf) -> None:
    recording = recorded(arm, motion_of(arm, T), np.random.default_rng(0), 0, 8.0, 0.0)
    found = identify(arm, [recording], tune=True)
    assert found.study is not None
    assert not found.study.choice.dead_zone
    assert found.study.choice.left_out.max() < 0.01


def test_a_cutoff_given_is_kept_and_the_result_says_what_depends_on_it(
    arm: Robot, motion_of: MotionOf
) -> None:
    recording = recorded(arm, motion_of(arm, T), np.random.default_rng(0), 1, 8.0, 0.5)
    found = identify(arm, [recording], cutoff_hz=JUDGE, tune=True)
    assert found.study is not None
    np.testing.assert_array_equal(found.study.choice.cutoffs_hz, JUDGE)
    result = identify_result(found)
    assert [row["factor"] for row in result["sensitivity"]] == pytest.approx(FACTORS)
    at_one = result["sensitivity"][2]
    assert at_one["largest_change"] == {"standard_deviations": 0.0, "expression": None}
    for row, joint in zip(at_one["joints"], result["joints"], strict=True):
        assert row["cutoff_hz"] == JUDGE
        assert row["rms"] == pytest.approx(joint["validate"]["rms"], rel=0.1)
    assert {row["reason"] for row in result["cutoff_hz_per_joint"]} == {"given"}


def test_a_tuned_fit_is_judged_at_the_common_cutoff(arm: Robot, motion_of: MotionOf) -> None:
    recording = recorded(arm, motion_of(arm, T), np.random.default_rng(1), 1, 8.0, 1.0)
    plain, found = (identify(arm, [recording], tune=tune) for tune in (False, True))
    assert found.study is not None
    assert found.study.choice.cutoffs_hz[1] < JUDGE
    np.testing.assert_array_equal(found.series.measured, plain.series.measured)
    assert found.data.cutoff_hz == plain.data.cutoff_hz == JUDGE
    # the resonance is in what is judged, before and after: no lower cut-off hides it
    np.testing.assert_allclose(found.train.rms, plain.train.rms, rtol=0.05)
    assert not np.array_equal(found.least_squares.beta, plain.least_squares.beta)


def test_slow_recordings_are_fitted_at_lower_factors_only(arm: Robot, motion_of: MotionOf) -> None:
    t = np.arange(0, 30, 0.05)
    motion = motion_of(arm, t)
    recording = Recording("s", "s.csv", t, motion.q, torque(arm, motion))
    found = identify(arm, [recording], cutoff_hz=8.0, tune=True)  # of 10 Hz at most
    assert found.sensitivity is not None
    assert found.sensitivity.factors == pytest.approx(FACTORS[:3])


def test_an_estimator_that_looks_at_recordings_gets_plain_rows(
    arm: Robot, motion_of: MotionOf
) -> None:
    recording = recorded(arm, motion_of(arm, T), np.random.default_rng(1), 1, 8.0, 1.0)
    rows = rows_of(arm, recording)
    found = study(arm, rows, [recording], untouched=True)
    assert found.rows is rows
    assert found.choice.tuning(JUDGE) is None


def test_the_command_shows_the_choice_and_its_sensitivity(
    arm: Robot, motion_of: MotionOf, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = recorded(arm, motion_of(arm, T), np.random.default_rng(1), 1, 8.0, 1.0)
    header = "t,q1,q2,tau1,tau2"
    table = np.column_stack([recording.t, recording.q, recording.tau])
    np.savetxt(tmp_path / "run.csv", table, delimiter=",", header=header, comments="")
    words = ["identify", "planar_2r", str(tmp_path / "run.csv"), "-o", str(tmp_path / "o")]
    assert main(words) == 0
    result = json.loads((tmp_path / "o" / "result.json").read_text())
    assert result["cutoff_hz"] == JUDGE
    assert result["cutoff_hz_per_joint"][1]["cutoff_hz"] < JUDGE
    assert len(result["sensitivity"]) == len(FACTORS)
    assert result["estimators"][0]["name"] == "wls"
    page = (tmp_path / "o" / "report.html").read_text()
    assert "Filter of the fit" in page
    assert "Choice of the estimator" in page
