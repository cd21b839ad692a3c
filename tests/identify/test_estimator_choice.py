"""The estimator is chosen on what it has not seen: robust with outliers, the default without."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from excitant.cli import main
from excitant.identify import Recording, identify, identify_result
from excitant.identify.estimator_choice import (
    AUTO,
    DEFAULT,
    RIVALS,
    EstimatorChoice,
    choose_estimator,
    estimator_for,
)
from excitant.identify.estimator_entrants import field_of
from excitant.identify.estimators import ESTIMATORS, Regression
from excitant.identify.estimators.of_rows import estimated, regression_of
from excitant.identify.rows import FitRows, fit_rows, split
from excitant.robots import Motion, Robot, load_robot, torque
from excitant.robots.base_parameters import base_parameters
from excitant.robots.effects import standard_effects

N, NV = 600, 2
NAMES = tuple(f"beta{k}" for k in range(4))
BETA = np.array([3.0, -0.5, 2.0, 1.0])
RATE = 128.0
T = np.arange(0, 30, 1 / RATE)
MotionOf = Callable[..., Motion]


def problem(rng: np.random.Generator, wrong: float, size: float = 20.0) -> Regression:
    """Slow columns with white noise; a share of the torques is wrong, always upwards."""
    t = np.linspace(0, 1, N)[:, None, None]
    frequency, phase = rng.uniform(3, 20, (NV, 4)), rng.uniform(0, 6.28, (NV, 4))
    W = np.sin(2 * np.pi * frequency * t + phase)
    tau = W @ BETA + 0.1 * rng.standard_normal((N, NV))
    hit = rng.random((N, NV)) < wrong
    return Regression(W, tau + size * 0.1 * hit * rng.exponential(1.0, (N, NV)), NAMES)


def test_clean_torque_keeps_the_default() -> None:
    for seed in range(20):
        found = choose_estimator(problem(np.random.default_rng(seed), 0.0))
        assert found.name == DEFAULT
        assert {c.name for c in found.contestants} == {DEFAULT, *RIVALS}
        assert "none is better beyond chance" in found.sentence
        [robust] = found.contestants[1:]
        assert abs(robust.fall) <= 5 * robust.error + 1e-3


def test_wrong_torques_call_for_the_robust_one() -> None:
    chosen = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        dirty = problem(rng, 0.1, 60.0)
        clean = dirty.W @ BETA
        found = choose_estimator(dirty, (dirty.W, clean))
        chosen += found.name == "irls"
        if found.name == "irls":
            default, robust = found.contestants
            assert robust.nrmse < default.nrmse
            assert robust.fall > 2 * robust.error > 0
            text = f"nrmse {robust.nrmse:.3g} against {default.nrmse:.3g} of wls"
            assert text in found.sentence
    assert chosen >= 18


def test_errors_are_those_of_rows_never_fitted() -> None:
    rng = np.random.default_rng(0)
    rows = problem(rng, 0.0)
    seen: list[np.ndarray] = []
    inner = ESTIMATORS[DEFAULT]

    def spy(given: Regression) -> object:
        seen.append(given.tau[:, 0])
        return inner(given)

    changed = dict(ESTIMATORS) | {DEFAULT: spy}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("excitant.identify.estimator_entrants.ESTIMATORS", changed)
        found = choose_estimator(rows)
    assert len(seen) == 5
    position = {value: k for k, value in enumerate(rows.tau[:, 0])}
    counts = np.zeros(N)
    for part in seen:
        at = np.array([position[value] for value in part])
        counts[at] += 1
        left = np.setdiff1d(np.arange(N), at)
        assert 0.2 * N <= len(left) <= 0.3 * N  # a fifth, and a few rows beside it
    assert counts.max() <= 4  # every row is left out once
    residual = 0.1 / rows.tau.std(axis=0)
    assert found.contestants[0].nrmse == pytest.approx(np.exp(np.log(residual).mean()), rel=0.1)


def test_segments_stay_apart() -> None:
    rows = problem(np.random.default_rng(1), 0.0)
    parted = replace(rows, starts=(0, 250, 400))
    starts: list[tuple[int, ...]] = []
    inner = ESTIMATORS[DEFAULT]

    def spy(given: Regression) -> object:
        starts.append(given.starts)
        return inner(given)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "excitant.identify.estimator_entrants.ESTIMATORS", dict(ESTIMATORS) | {DEFAULT: spy}
        )
        choose_estimator(parted)
    assert all(len(each) >= 3 for each in starts)


def test_a_default_that_cannot_be_compared_stays() -> None:
    rows = problem(np.random.default_rng(2), 0.0)
    W = np.array(rows.W)
    W[: N // 10 * 9, :, 3] = 0.0  # only the last tenth shows the last parameter
    found = choose_estimator(replace(rows, W=W))
    assert found.name == DEFAULT
    assert "do not show all parameters" in found.sentence


@pytest.fixture(scope="module")
def arm() -> Robot:
    robot = load_robot("planar_2r")
    values = ([3.0, 2.0], [2.0, 1.0], [0.2, -0.1], [0.3, 0.2])
    effects = standard_effects(robot.joints)
    return robot.with_effects([e.with_values(v) for e, v in zip(effects, values, strict=True)])


def recorded(arm: Robot, motion: Motion, spikes: int, seed: int = 0) -> Recording:
    """Torque with 2 % noise, and a bump of half a second now and then (somebody leans on it)."""
    rng = np.random.default_rng(seed)
    tau = torque(arm, motion)
    spread = tau.std(axis=0)
    tau = tau + 0.02 * spread * rng.standard_normal(tau.shape)
    for _ in range(spikes):
        at, joint = rng.integers(len(tau) - 70), rng.integers(arm.nv)
        tau[at : at + 64, joint] += spread[joint] * rng.uniform(0.5, 1.5)
    return Recording("run", "run.csv", motion.t, motion.q, tau)


def test_the_holdout_takes_no_part(arm: Robot, motion_of: MotionOf) -> None:
    run = recorded(arm, motion_of(arm, T), 12)
    quiet = recorded(arm, motion_of(arm, T, 1), 0)
    loud = replace(quiet, tau=3 * quiet.tau)
    found = [identify(arm, [run], validate=[v], estimator=AUTO) for v in (quiet, loud)]
    assert found[0].contest == found[1].contest
    assert found[0].contest is not None
    assert found[0].contest.sentence in found[0].notes


def test_the_chosen_estimator_is_the_one_that_is_used(arm: Robot, motion_of: MotionOf) -> None:
    run, other = recorded(arm, motion_of(arm, T), 12), recorded(arm, motion_of(arm, T, 1), 0)
    found = identify(arm, [run], validate=[other], estimator=AUTO)
    assert found.contest is not None
    same = identify(arm, [run], validate=[other], estimator=found.contest.name)
    np.testing.assert_array_equal(found.least_squares.beta, same.least_squares.beta)
    assert found.estimator == same.estimator
    names = [row["name"] for row in identify_result(found)["estimators"] if row["chosen"]]
    assert names == [found.contest.name]
    assert "estimators" not in identify_result(same)


def test_noise_of_the_motion_brings_instruments_in(arm: Robot, motion_of: MotionOf) -> None:
    motion = motion_of(arm, T)
    clean = recorded(arm, motion, 0)
    rng = np.random.default_rng(5)
    effects = standard_effects(arm.joints)
    base = base_parameters(arm, effects)
    tried = []
    for noise in (0.0, 3e-3):
        run = replace(clean, q=clean.q + noise * rng.standard_normal(clean.q.shape))
        rows = fit_rows(arm, effects, base, split([run], [run], 10.0))
        assert len(regression_of(rows).starts) == 1
        choice = estimator_for(arm, rows, [run])
        tried.append({c.name for c in choice.contestants})
    assert "iv" not in tried[0]
    assert "iv" in tried[1]


def repeating(arm: Robot, seconds: float, encoder: float, seed: int = 0) -> Recording:
    """Four harmonics of five seconds."""
    t, rng = np.arange(0, seconds, 1 / RATE), np.random.default_rng(7)
    k = np.arange(1, 5)[:, None, None]
    w, phase = 2 * np.pi * k / 5.0, rng.uniform(0, 2 * np.pi, (4, 1, 2))
    parts = (
        (0.6 / k * w**order * np.sin(w * t[:, None] + phase + order * np.pi / 2)).sum(axis=0)
        for order in range(3)
    )
    clean = recorded(arm, Motion(t, *parts), 0, seed)
    noise = np.random.default_rng([seed, 1]).standard_normal(clean.q.shape)
    return replace(clean, q=clean.q + encoder * noise)


def rows_at(arm: Robot, run: Recording, cutoff_hz: float) -> FitRows:
    effects = standard_effects(arm.joints)
    return fit_rows(arm, effects, base_parameters(arm, effects), split([run], [run], cutoff_hz))


def test_periods_are_averaged_where_that_predicts_better(arm: Robot) -> None:
    """Encoders of 1 mrad, filtered too little: least squares is biased, averaged periods are not.

    The choice is also right about what it cannot see: torque on the motion without noise.
    """
    clean = rows_at(arm, replace(repeating(arm, 20, 0.0), name="clean"), 25.0)
    W = clean.W[:, :, list(clean.base.columns)]
    for seed in range(2):
        run = repeating(arm, 20, 1e-3, seed)
        rows = rows_at(arm, run, 25.0)
        choice = estimator_for(arm, rows, [run])
        assert choice.name in ("ml", "oe")
        assert {c.name for c in choice.contestants} == {"wls", "irls", "iv", "oe", "ml"}
        assert "(the same part of all periods)" in choice.sentence
        assert "errors of the motion taken out" in choice.sentence
        assert choice.absent == ()
        wrong = {
            name: np.sqrt(
                ((W @ estimated(arm, rows, [run], [run], name)[0].beta - clean.tau) ** 2).mean()
            )
            for name in ("wls", choice.name)
        }
        assert wrong[choice.name] < 0.3 * wrong["wls"]
        assert min(choice.contestants, key=lambda c: c.nrmse).name in ("ml", "oe")


def test_clean_positions_that_repeat_keep_the_default_but_compare(arm: Robot) -> None:
    run = repeating(arm, 20, 0.0)
    choice = estimator_for(arm, rows_at(arm, run, 10.0), [run])
    assert choice.name == DEFAULT
    assert [c.name for c in choice.contestants] == ["wls", "irls", "ml"]
    assert "not compared: iv and oe (" in choice.sentence


def test_output_error_takes_part_where_nothing_repeats(arm: Robot, motion_of: MotionOf) -> None:
    clean = recorded(arm, motion_of(arm, np.arange(0, 15, 1 / RATE)), 0)
    rng = np.random.default_rng(1)
    run = replace(clean, q=clean.q + 1e-3 * rng.standard_normal(clean.q.shape))
    choice = estimator_for(arm, rows_at(arm, run, 25.0), [run])
    assert choice.name in ("iv", "oe")
    by_name = {c.name: c for c in choice.contestants}
    assert by_name["oe"].nrmse < 0.5 * by_name["wls"].nrmse
    assert dict(choice.absent) == {"ml": "the motion does not repeat"}
    assert "not compared: ml (the motion does not repeat)" in choice.sentence


def test_what_would_take_long_is_left_out_and_said(
    arm: Robot, motion_of: MotionOf, monkeypatch: pytest.MonkeyPatch
) -> None:
    clean = recorded(arm, motion_of(arm, np.arange(0, 15, 1 / RATE)), 0)
    rng = np.random.default_rng(1)
    run = replace(clean, q=clean.q + 1e-3 * rng.standard_normal(clean.q.shape))
    rows = rows_at(arm, run, 25.0)
    monkeypatch.setattr("excitant.identify.estimator_entrants._STEPS", 1000)
    monkeypatch.setattr("excitant.identify.estimator_entrants.closed_loop", None)
    choice = estimator_for(arm, rows, [run])
    assert dict(choice.absent)["oe"] == "its simulation of 15360 steps would take long"
    assert "iv" in {c.name for c in choice.contestants}
    monkeypatch.setattr("excitant.identify.estimator_entrants._SAMPLES", 1000)
    monkeypatch.setattr("excitant.identify.estimator_entrants.half_columns", None)
    choice = estimator_for(arm, rows, [run])
    assert [c.name for c in choice.contestants] == ["wls", "irls"]
    assert "iv and oe and ml (of more than 1000 samples)" in choice.sentence


def test_what_is_left_out_of_one_period_is_left_out_of_all(arm: Robot) -> None:
    run = repeating(arm, 20, 1e-4)
    rows = rows_at(arm, run, 10.0)
    found = field_of(arm, rows, rows, [run])
    [segment] = rows.data.train
    at = np.mod(segment.t - run.t[0], 5.0) / 5.0
    for b, block in enumerate(found.holdout.blocks):
        assert ((at[block] > b / 10 - 1e-3) & (at[block] < (b + 1) / 10 + 1e-3)).all()
    averaged = found.entrants["ml"]
    own = np.arange(len(averaged.at)) / len(averaged.at)
    apart = np.abs(at[averaged.at] - own)
    assert np.minimum(apart, 1 - apart).max() < 0.11 / 5.0  # an edge of the filter at the end
    left = found.holdout.near([3])
    seen = own[~left[averaged.at]]
    assert not ((seen > 0.3) & (seen < 0.4)).any()


def test_an_estimator_that_looks_at_recordings_gets_their_rows(
    arm: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where rows are tuned for others, it is the one that its name alone would give."""
    run, held = repeating(arm, 20, 0.0), repeating(arm, 10, 0.0, 1)
    shake = np.sin(2 * np.pi * 5.0 * run.t)[:, None] * run.tau.std(axis=0)
    noise = np.random.default_rng(0).standard_normal(run.tau.shape)
    run = replace(run, tau=run.tau + 0.5 * shake * (1 + noise))
    given = EstimatorChoice("ml", (), "estimator: this one")
    monkeypatch.setattr("excitant.identify.fit_choices.estimator_for", lambda *_: given)
    found, same, other = (
        identify(arm, [run], validate=[held], estimator=name, tune=True)
        for name in (AUTO, "ml", "wls")
    )
    assert other.data.tuned
    assert not found.data.tuned
    np.testing.assert_array_equal(found.least_squares.beta, same.least_squares.beta)
    np.testing.assert_array_equal(found.phi, same.phi)
    assert "estimator: this one" in found.notes
    assert identify_result(found)["estimators_not_compared"] == []


def test_the_command_chooses_unless_told(
    arm: Robot, motion_of: MotionOf, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = recorded(arm, motion_of(arm, T), 0)
    table = np.column_stack([run.t, run.q, run.tau])
    np.savetxt(tmp_path / "run.csv", table, delimiter=",", header="t,q1,q2,tau1,tau2", comments="")
    words = ["identify", "planar_2r", str(tmp_path / "run.csv"), "-o", str(tmp_path / "o")]
    for more, has in (([], True), (["--estimator", "auto"], True), (["--estimator", "wls"], False)):
        assert main([*words, *more]) == 0
        result = json.loads((tmp_path / "o" / "result.json").read_text())
        assert ("estimators" in result) is has
        assert any(note.startswith("estimator: ") for note in result["notes"]) is has
    capsys.readouterr()
    assert main([*words, "--estimator", "auto", "--online"]) == 1
    assert "leave the other way out" in capsys.readouterr().err
