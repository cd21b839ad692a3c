"""What is identified piece by piece is what is identified from the whole, in little memory."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.signal

from excitant.cli import main
from excitant.exceptions import BadInput, BadRecording
from excitant.identify import (
    Estimate,
    Recording,
    identify,
    identify_result,
    identify_series,
    identify_streamed,
    load_dataset,
    read_chunks,
    read_recording,
)
from excitant.identify.accuracy import predicted_torque, series
from excitant.identify.differentiators import ZeroPhaseButterworth
from excitant.identify.faults import Fault, find_faults, read_checked
from excitant.identify.least_squares import factorised, sandwiched
from excitant.identify.preprocessing import Tuning, prepare, tuned
from excitant.identify.rows import observation
from excitant.identify.streaming import budget, logs, mending
from excitant.identify.streaming.checks import Checks
from excitant.identify.streaming.columns import GIVEN, ONE, RAW, TAU, layout, window_rows
from excitant.identify.streaming.condensed import Blocks, Condensed
from excitant.identify.streaming.derivative import InnerButterworth
from excitant.identify.streaming.filtering import responses
from excitant.identify.streaming.noise import block_scores
from excitant.identify.streaming.survey import survey
from excitant.identify.streaming.windows import Span, windows
from excitant.robots import Motion, Robot, base_parameters, load_robot, torque
from excitant.robots.effects import (
    Effect,
    FrictionCoupling,
    Payload,
    StribeckFriction,
    standard_effects,
)

CUTOFF = 4.3  # Hz; at 100 Hz every fifth instant becomes a row, without a tie in rounding
RATE = 100.0
WRITTEN = 1e-8  # of the largest entry: what rows of windows may differ by from those of the whole

MotionOf = Callable[..., Motion]


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("planar_2r")


def true_torque(robot: Robot, motion: Motion) -> np.ndarray:
    effects = standard_effects(robot.joints)
    valued = [e.with_values(0.2 + 0.1 * np.arange(len(e.parameters(robot)))) for e in effects]
    return torque(robot.with_effects(valued), motion)


def logged(robot: Robot, motion: Motion, seed: int = 0, noise: float = 0.05) -> pd.DataFrame:
    """A log of a motion, its torque noise coloured."""
    rng = np.random.default_rng(seed)
    white = rng.normal(size=motion.q.shape)
    tau = true_torque(robot, motion) + noise * scipy.signal.lfilter([1.0], [1, -0.9], white, axis=0)
    columns = {"t": motion.t}
    columns |= {f"q{j + 1}": motion.q[:, j] for j in range(robot.nv)}
    columns |= {f"tau{j + 1}": tau[:, j] for j in range(robot.nv)}
    return pd.DataFrame(columns)


def written(table: pd.DataFrame, path: Path) -> Path:
    if path.suffix == ".csv":
        table.to_csv(path, index=False)
    else:
        table.to_parquet(path, index=False, row_group_size=3000)
    return path


def times(
    duration: float, jitter: float = 0.0, gaps: Sequence[float] = (), lost: float = 0.0
) -> np.ndarray:
    """Time at 100 Hz: steps uneven by a share, a second missing at gaps, a share of rows lost."""
    t = np.arange(round(duration * RATE)) / RATE
    t = t + jitter / RATE * np.random.default_rng(3).uniform(-0.5, 0.5, len(t))
    t = t[np.random.default_rng(4).uniform(size=len(t)) >= lost]
    for gap in gaps:
        t = t[(t < gap) | (t > gap + 1)]
    return t


@pytest.mark.parametrize(
    ("jitter", "gaps", "lost"),
    [(0, (), 0), (0.3, (), 0), (0, (1.0, 31.7, 34.0), 0), (0.3, (50.0,), 0), (0, (), 0.02)],
)
@pytest.mark.parametrize("rows", [333, 1500])
def test_rows_of_windows_are_those_of_the_whole(
    robot: Robot, motion_of: MotionOf, tmp_path: Path, jitter: float, gaps: Sequence[float],
    lost: float, rows: int,
) -> None:  # fmt: skip
    motion = motion_of(robot, times(90, jitter, gaps, lost))
    effects: tuple[Effect, ...] = (
        *standard_effects(robot.joints),
        StribeckFriction(robot.joints),
        FrictionCoupling(robot.joints),
        Payload(robot.joints[-1:]),
    )
    path = written(logged(robot, motion), tmp_path / "log.parquet")
    whole = read_recording(path, robot)
    base = base_parameters(robot, effects)
    form, segments = layout(robot, effects, base), prepare(whole, CUTOFF)
    h = responses(segments[0])
    step = float(np.median(np.diff(whole.t)))
    reach = 2 * h[0].half * step
    span = Span(-np.inf, np.inf, step, False)
    pieces = read_chunks(path, robot, rows)
    found = [window_rows(form, w, h) for w in windows(pieces, [span], CUTOFF, reach, 700)]
    assert len(found) > len(segments) + 5
    W = observation(robot, effects, segments)[:, :, list(base.columns)]
    tau = series(segments)
    for j, used in enumerate(form.used):
        X = np.concatenate([part[j] for part in found])
        assert len(X) == len(W)
        size = np.abs(W).max(axis=(0, 1))
        error = np.abs(X[:, : len(used)] - W[:, j, used]).max(axis=0)
        assert (error <= WRITTEN * size[used]).all()
        assert (np.delete(W[:, j], used, axis=1) == 0).all()
        np.testing.assert_allclose(X[:, TAU], tau.measured[:, j], atol=WRITTEN)
        np.testing.assert_allclose(X[:, RAW], tau.raw[:, j], atol=WRITTEN)
        assert (X[:, ONE] == 1).all()
        assert (X[:, GIVEN] == 0).all() == (not robot.effects)


def test_rows_of_windows_are_tuned_as_those_of_the_whole(
    robot: Robot, motion_of: MotionOf, tmp_path: Path
) -> None:
    """Joints with cut-offs of their own, and rows left out where one hardly moves."""
    path = written(logged(robot, motion_of(robot, times(90, gaps=(40.0,)))), tmp_path / "log.csv")
    effects = standard_effects(robot.joints)
    base = base_parameters(robot, effects)
    form, tuning = (
        layout(robot, effects, base),
        Tuning(np.array([2.1, CUTOFF]), np.array([0.2, -1])),
    )
    whole = read_recording(path, robot)
    segments = prepare(whole, CUTOFF, tuning=tuning)
    filters = responses(segments[0])
    reach = 2 * filters[0].half / RATE
    span = Span(-np.inf, np.inf, float(np.median(np.diff(whole.t))), False)
    seen = windows(read_chunks(path, robot, 1500), [span], CUTOFF, reach, 700)
    found = [window_rows(form, replace(w, segment=tuned(w.segment, tuning)), filters) for w in seen]
    W = observation(robot, effects, segments)[:, :, list(base.columns)]
    tau = series(segments)
    for j, used in enumerate(form.used):
        X = np.concatenate([part[j] for part in found])
        silent = (W[:, j] == 0).all(axis=1)
        assert silent.any() == (j == 0)
        np.testing.assert_allclose(X[:, : len(used)], W[:, j, used], atol=WRITTEN * np.abs(W).max())
        np.testing.assert_allclose(X[:, TAU], tau.measured[:, j], atol=WRITTEN)


def test_noise_of_positions_counts_alike(robot: Robot, motion_of: MotionOf, tmp_path: Path) -> None:
    # what smooth columns hold above half the rate of their evaluation, ten per period of the
    # cut-off, comes down: noise that the 20 Hz filter of positions leaves from 80 to 100 Hz
    t = np.arange(20_000) / 1000
    motion, rng = motion_of(robot, t), np.random.default_rng(0)
    base = base_parameters(robot, ())
    form, parts = layout(robot, (), base), {}
    for noise in (0.0, 1e-4):
        q = motion.q + noise * rng.normal(size=motion.q.shape)
        path = written(logged(robot, replace(motion, q=q)), tmp_path / "log.parquet")
        segments = prepare(read_recording(path, robot), 10.0)
        parts[noise] = observation(robot, (), segments)[:, :, list(base.columns)]
    h = responses(segments[0])
    assert h[0].every > 1
    span = Span(-np.inf, np.inf, 1e-3, False)
    seen = windows(read_chunks(path, robot, 4000), [span], 10.0, 2e-3 * h[0].half, 5000)
    found = [window_rows(form, window, h) for window in seen]
    for j, used in enumerate(form.used):
        X = np.concatenate([part[j] for part in found])[:, : len(used)]
        added = (parts[1e-4] - parts[0.0])[:, j, used].std(axis=0)
        assert ((X - parts[1e-4][:, j, used]).std(axis=0) <= 2e-3 * added).all()


def test_the_inside_of_a_spline_does_not_know_its_ends(motion_of: MotionOf, robot: Robot) -> None:
    motion = motion_of(robot, times(30))
    whole, inner = (
        kind(8.0)(motion.t, motion.q) for kind in (ZeroPhaseButterworth, InnerButterworth)
    )
    inside = slice(40, -40)  # 0.43⁴⁰ is rounding
    for name in ("q", "dq", "ddq"):
        expected = getattr(whole, name)[inside]
        error = np.abs(getattr(inner, name)[inside] - expected).max()
        assert error <= 1e-10 * np.abs(expected).max() * RATE**2


def judged_in_memory(estimate: Estimate, recordings: Sequence[Recording]) -> list[np.ndarray]:
    """Accuracies of the models on segments of recordings."""
    segments = [s for r in recordings for s in prepare(r, CUTOFF)]
    unseen = series(segments)
    accuracies = (
        unseen.accuracy(predicted_torque(robot, segments) / estimate.gains)
        for robot in (estimate.model, estimate.given)
    )
    return [np.array(list(vars(accuracy).values())) for accuracy in accuracies]


def figures(accuracy: object) -> np.ndarray:
    return np.array(list(vars(accuracy).values()))


def same_fit(found: Estimate, whole: Estimate, rtol: float = 1e-6) -> None:
    """Base parameters to a thousandth of their standard deviation, noise to rounding of rows."""
    std = np.sqrt(np.diag(whole.least_squares.covariance))
    moved = np.abs(found.least_squares.beta - whole.least_squares.beta) / std
    assert moved.max() < 1e-3
    np.testing.assert_allclose(found.least_squares.sigma, whole.least_squares.sigma, rtol=rtol)
    assert found.data.holdout == whole.data.holdout
    assert found.data.cutoff_hz == whole.data.cutoff_hz
    assert set(whole.notes) < set(found.notes)


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
@pytest.mark.parametrize(("jitter", "gaps"), [(0.0, ()), (0.2, (20.0, 70.0))])
def test_streamed_is_in_memory(
    robot: Robot, motion_of: MotionOf, tmp_path: Path, suffix: str, jitter: float,
    gaps: Sequence[float],
) -> None:  # fmt: skip
    table = logged(robot, motion_of(robot, times(120, jitter, gaps)))
    path = written(table, tmp_path / f"log{suffix}")
    recording = read_recording(path, robot)
    whole = identify(robot, [recording], cutoff_hz=CUTOFF)
    found = identify_streamed(robot, [path], cutoff_hz=CUTOFF, rows=1000)
    same_fit(found, whole)
    parts = [recording.between(0, 0.7, ""), recording.between(0.7, 1, "")]
    train, _ = judged_in_memory(found, parts[:1])
    validate, baseline = judged_in_memory(found, parts[1:])
    for accuracy, expected in zip(
        (found.train, found.validate, found.baseline), (train, validate, baseline), strict=True
    ):
        np.testing.assert_allclose(figures(accuracy), expected, rtol=1e-6)
    difference = np.abs(found.physical.x - whole.physical.x)
    assert (difference <= 0.5 * np.sqrt(np.diag(whole.physical.covariance))).all()


def test_the_result_is_of_the_same_kind(robot: Robot, motion_of: MotionOf, tmp_path: Path) -> None:
    path = written(logged(robot, motion_of(robot, times(60))), tmp_path / "log.parquet")
    found = identify_streamed(robot, [path], cutoff_hz=CUTOFF, rows=1000)
    whole = identify(robot, [read_recording(path, robot)], cutoff_hz=CUTOFF)
    assert identify_result(found).keys() == identify_result(whole).keys()
    json.dumps(identify_result(found))
    shown, expected = identify_series(found), identify_series(whole)
    for name in ("measured", "given"):
        part = expected[name][: len(shown[name])]
        np.testing.assert_allclose(shown[name], part, atol=1e-6 * np.abs(part).max())
    np.testing.assert_allclose(shown["t"], expected["t"][: len(shown["t"])], atol=1e-9)
    predicted = predicted_torque(found.model, found.data.validate)
    np.testing.assert_allclose(found.predicted, predicted, atol=1e-6 * np.abs(predicted).max())
    assert any("piece by piece" in note for note in found.notes)


def test_hold_outs_are_files_and_logs_may_be_split(
    robot: Robot, motion_of: MotionOf, tmp_path: Path
) -> None:
    table = logged(robot, motion_of(robot, times(80)))
    held = logged(robot, motion_of(robot, times(40), seed=5), seed=1)
    path, other = written(table, tmp_path / "a.parquet"), written(held, tmp_path / "b.csv")
    parts = [
        written(table[rows], tmp_path / f"part_{k}.csv")
        for k, rows in enumerate((slice(0, 3210), slice(3210, None)))
    ]
    recordings = [read_recording(file, robot) for file in (path, other)]
    whole = identify(robot, recordings[:1], validate=recordings[1:], cutoff_hz=CUTOFF)
    found = identify_streamed(robot, [path], validate=[other], cutoff_hz=CUTOFF, rows=1000)
    same_fit(found, whole)
    expected, baseline = judged_in_memory(found, recordings[1:])
    np.testing.assert_allclose(figures(found.validate), expected, rtol=1e-6)
    np.testing.assert_allclose(figures(found.baseline), baseline, rtol=1e-6)
    split = identify_streamed(robot, [parts], validate=[other], cutoff_hz=CUTOFF, rows=1000)
    np.testing.assert_allclose(split.phi, found.phi, rtol=1e-6, atol=1e-9)


def test_currents_find_their_gains(robot: Robot, motion_of: MotionOf, tmp_path: Path) -> None:
    table = logged(robot, motion_of(robot, times(100)), noise=0.01)
    gains = np.array([4.0, 2.5])
    for j, gain in enumerate(gains):
        table[f"i{j + 1}"] = table.pop(f"tau{j + 1}") / gain
    path = written(table, tmp_path / "log.parquet")
    found = identify_streamed(robot, [path], cutoff_hz=CUTOFF, rows=1000)
    assert found.data.unit == "A"
    ratio = found.gains / gains
    assert abs(ratio[0] / ratio[1] - 1) < 0.02
    assert (found.validate.r2 > 0.99).all()


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_a_bad_row_far_into_the_log_is_named(
    robot: Robot, motion_of: MotionOf, tmp_path: Path, suffix: str
) -> None:
    table = logged(robot, motion_of(robot, times(80)))
    for column, value, why in (("q2", np.nan, "finite"), ("t", 1.0, "goes back")):
        bad = table.copy()
        bad.loc[6789, column] = value
        path = written(bad, tmp_path / f"bad{suffix}")
        with pytest.raises(BadRecording, match=why) as refusal:
            identify_streamed(robot, [path], cutoff_hz=CUTOFF, rows=1000)
        error = refusal.value
        assert (error.file, error.row, error.column) == (str(path), 6789, column)


def test_what_cannot_be_fitted_is_refused(
    robot: Robot, motion_of: MotionOf, tmp_path: Path
) -> None:
    table = logged(robot, motion_of(robot, times(60)))
    current = table.rename(columns={"tau1": "i1", "tau2": "i2"})
    paths = [written(table, tmp_path / "a.csv"), written(current, tmp_path / "b.csv")]
    with pytest.raises(BadRecording, match="use recordings of one unit"):
        identify_streamed(robot, paths)
    short = written(table[:500], tmp_path / "short.csv")  # 30 % of 5 s is less than 2 s
    with pytest.raises(BadRecording, match="nothing of 'short' can be held out"):
        identify_streamed(robot, [short], cutoff_hz=CUTOFF)
    with pytest.raises(BadRecording, match="does not fit its rate"):
        identify_streamed(robot, paths[:1], cutoff_hz=60.0)
    with pytest.raises(BadInput, match="no recording given"):
        identify_streamed(robot, [])


def test_a_survey_remembers_few_steps() -> None:
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.5e-3, 1.5e-3, 2_500_000))
    seen = survey(np.array_split(t, 23))
    assert 100_000 < len(seen.steps) <= 200_000
    assert (seen.rows, seen.start, seen.end) == (len(t), t[0], t[-1])
    exact = np.median(np.diff(t))
    spread = 0.5 * 1e-3 / np.sqrt(len(seen.steps))  # standard deviation of a median, uniform steps
    assert abs(seen.step(-np.inf, np.inf) - exact) < 5 * spread
    few = survey([np.array([0.0, 1.0]), np.array([np.nan, 2.5, 1.0])])
    assert sorted(few.steps) == [1.0, 1.5]


def test_blocks_stand_for_all_their_rows(robot: Robot) -> None:
    effects = standard_effects(robot.joints)
    form = layout(robot, effects, base_parameters(robot, effects))
    rng = np.random.default_rng(0)
    sizes = (17, 30_000, 1, 4_321)
    rows = [[rng.normal(size=(n, len(u) + 4)) for u in form.used] for n in sizes]
    blocks = Blocks(form)
    for part in rows:
        blocks.take(part)
    whole, each = blocks.whole(), blocks.each()
    assert whole.n == sum(sizes) == sum(block.n for block in each)
    assert 64 <= len(each) <= 128
    for j, used in enumerate(form.used):
        X = np.concatenate([part[j] for part in rows])
        for condensed in (whole, replace(whole, **_stacked(each))):
            W, tau = condensed.W[:, j, used], condensed.tau[:, j]
            np.testing.assert_allclose(W.T @ W, X[:, : len(used)].T @ X[:, : len(used)], rtol=1e-9,
                                       atol=1e-9 * len(X))  # fmt: skip
            np.testing.assert_allclose(W.T @ tau, X[:, : len(used)].T @ X[:, TAU],
                                       atol=1e-9 * len(X))  # fmt: skip


def _stacked(blocks: Sequence[Condensed]) -> dict[str, np.ndarray]:
    names = ("W", "given", "one", "tau", "raw")
    return {name: np.concatenate([getattr(block, name) for block in blocks]) for name in names}


def test_intervals_of_blocks_cover_the_truth() -> None:
    # autoregressive noise, columns slow and fast, motion in the first third only for one of them
    rng = np.random.default_rng(0)
    n, size, truth = 6400, 100, np.array([1.0, -2.0, 0.5])
    t = np.arange(n)
    W = np.stack([np.cos(t / 50), np.ones(n), np.sin(t / 7) * (t < n / 3)], axis=1)
    W = np.stack([W, W[:, ::-1]], axis=1)
    hits, draws = np.zeros(3), 300
    for _ in range(draws):
        noise = scipy.signal.lfilter([1], [1, -0.8], rng.normal(size=(n, 2)), axis=0)
        tau = W @ truth + noise * np.array([1.0, 3.0])
        factor = factorised(W, np.array([1.0, 3.0]), ("a", "b", "c"))
        beta, zero = factor.solve(tau), np.zeros((size, 2))
        blocks = [
            Condensed(size, W[k : k + size], zero, zero, tau[k : k + size], zero)
            for k in range(0, n, size)
        ]
        inverse = np.linalg.inv(factor.R)
        scores, freedom = block_scores(blocks, np.ones(2), factor, inverse, beta)
        fit = sandwiched(factor, beta, scores, freedom, factor.weight)
        hits += np.abs(beta - truth) <= 1.96 * np.sqrt(np.diag(fit.covariance))
    # binomial, three standard deviations below 95 % less what blocks of 100 lose at their ends
    assert (hits / draws >= 0.95 - 3 * np.sqrt(0.95 * 0.05 / draws) - 0.01).all()
    assert (hits / draws <= 0.99).all()


def test_standard_deviations_are_those_of_coloured_noise(
    robot: Robot, motion_of: MotionOf, tmp_path: Path
) -> None:
    path = written(logged(robot, motion_of(robot, times(1500))), tmp_path / "log.parquet")
    found = identify_streamed(robot, [path], cutoff_hz=CUTOFF)
    whole = identify(robot, [read_recording(path, robot)], cutoff_hz=CUTOFF)
    std = [np.sqrt(np.diag(e.least_squares.covariance)) for e in (found, whole)]
    # 64 blocks or more know a standard deviation to 1 / √126 = 9 %
    ratio = std[0] / std[1]
    assert abs(np.median(ratio) - 1) < 0.12
    assert (np.abs(np.log(ratio)) < 4 * 0.09).all()


def test_the_command_streams_what_is_larger_than_memory(
    robot: Robot, motion_of: MotionOf, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    path = written(logged(robot, motion_of(robot, times(60))), tmp_path / "log.csv")
    assert budget.samples_of(path) == pytest.approx(6000, rel=0.02)
    assert not budget.larger_than_memory([path], 2, 28)
    monkeypatch.setattr(budget, "BUDGET", 6000 * 2 * 28 * 8)
    assert budget.larger_than_memory([path], 2, 28)
    words = ["identify", "planar_2r", str(path), "--cutoff", "4", "-o", str(tmp_path / "run")]
    assert main(words) == 0
    result = json.loads((tmp_path / "run" / "result.json").read_text(encoding="utf-8"))
    assert any("larger than the memory" in note for note in result["notes"])
    assert (tmp_path / "run" / "report.html").is_file()
    assert (tmp_path / "run" / "identified.urdf").is_file()
    capsys.readouterr()
    for option in (["--online"], ["--link-by-link"], ["--estimator", "gls"]):
        assert main([*words, *option]) == 1
        said = capsys.readouterr().err
        assert " ".join(option) in said
        assert "larger than memory" in said


def pieces_of(log: Any, *sizes: int) -> Iterator[tuple[Any, None]]:
    start = 0
    for size in sizes:
        yield log.take(np.arange(start, min(start + size, len(log)))), None
        start += size


def checked(robot: Robot, log: Any, *sizes: int) -> dict[str, Fault]:
    checks = Checks(robot)
    for piece, _ in pieces_of(log, *sizes):
        checks.take(piece)
    return {f"{f.fault} {f.evidence.get('channel', '')}": f for f in checks.faults()}


COUNTED = ("rows_lost", "rows_logged_twice", "clipped_torque", "zero_torque", "rows_lost_unseen")
OF_EXCERPT = ("velocity_negated", "torque_negated", "velocity_in_rpm", "position_in_degrees",
              "half_rate", "held_torque", "unsigned_torque", "model_for_torque")  # fmt: skip


@pytest.fixture(scope="module")
def plants(benchmark_module: Callable[[str], Any]) -> Any:
    return benchmark_module("planted_faults")


@pytest.fixture(scope="module")
def fast(plants: Any, robot: Robot) -> Any:
    """Eight seconds at 1 kHz."""
    return plants.recorded(robot, 0, 1000.0)


def test_pieces_of_a_faultless_log_have_no_fault(robot: Robot, fast: Any) -> None:
    assert checked(robot, fast, 5000, 3001) == {}
    assert checked(robot, fast, *([400] * 21)) == {}


@pytest.mark.parametrize("name", [*COUNTED, *OF_EXCERPT])
def test_faults_of_pieces_are_those_of_the_whole(
    robot: Robot, plants: Any, fast: Any, name: str
) -> None:
    log = getattr(plants, name)(robot, fast, np.random.default_rng(1))
    whole = {
        f"{f.fault} {f.evidence.get('channel', '')}": f
        for f in find_faults(robot, log)
        if f.fault not in ("poor_excitation",)
    }
    found = checked(robot, log, 6000, len(log) - 6000)
    assert found.keys() == whole.keys()
    for key, fault in found.items():
        assert fault.joints == whole[key].joints
        assert fault.entry().keys() == whole[key].entry().keys()
        assert fault.evidence.keys() == whole[key].evidence.keys()
        assert bool(fault.repair) == bool(whole[key].repair)
        if name in COUNTED and "band" not in key:
            for number in ("count", "gaps", "missing", "rows", "value"):
                found_number, number_of_whole = (
                    f.evidence.get(number, 0) for f in (fault, whole[key])
                )
                if name == "rows_logged_twice":  # what moves is judged by the noise of a piece
                    assert np.size(found_number) == pytest.approx(
                        np.size(number_of_whole), rel=0.01
                    )
                else:
                    np.testing.assert_array_equal(found_number, number_of_whole)


def test_faults_far_into_a_log_are_counted_with_their_rows(robot: Robot, fast: Any) -> None:
    tau = np.array(fast.tau)
    for row in (1500, 6500, 7300):
        tau[row, 0] += 50.0
    tau[3000:4500, 1] = tau[3000, 1]  # a second and a half, part of it a whole piece
    t = np.where(np.arange(len(fast)) >= 5000, fast.t + 0.25, fast.t)
    found = checked(robot, replace(fast, tau=tau, t=t), *([1000] * 9))
    assert found["corrupt_rows tau"].evidence["rows"].tolist() == [1500, 6500, 7300]
    gap = found["dropped_samples "].evidence
    assert (gap["gaps"], gap["missing"], gap["rows"].tolist()) == (1, 250, [4999])
    dead = found["dead_channel tau"].evidence
    assert dead["start"] == pytest.approx(3.0)
    assert 0.999 <= dead["seconds"] <= 1.5


def test_the_excerpt_is_where_joints_move(robot: Robot, plants: Any, fast: Any) -> None:
    wrong, rest = plants.velocity_negated(robot, fast, np.random.default_rng(0)), len(fast)
    noise = np.random.default_rng(0).normal(size=(2, rest, 2))
    parts = {
        "q": fast.q[0] + 1e-5 * noise[0],
        "dq": 1e-3 * noise[1],
        "tau": wrong.tau[0] + 0.1 * noise[0],
    }
    both = {c: np.concatenate([x, getattr(wrong, c)]) for c, x in parts.items()}
    log = replace(fast, t=np.concatenate([fast.t, fast.t + fast.t[-1] + fast.step]), **both)
    assert "wrong_sign dq" in checked(robot, log, rest, rest)


def test_what_the_excerpt_lacks_the_log_may_have(robot: Robot, plants: Any, fast: Any) -> None:
    still = plants.hardly_moving(robot, fast, np.random.default_rng(0))
    assert "poor_excitation " in checked(robot, still, 4000, 4001)
    both = {c: np.concatenate([getattr(still, c), getattr(fast, c)]) for c in ("q", "tau", "dq")}
    log = replace(fast, t=np.concatenate([fast.t, fast.t + fast.t[-1] + fast.step]), **both)
    assert "poor_excitation " not in checked(robot, log, *([4000] * 5))


def test_two_names_of_one_log_are_said(robot: Robot, motion_of: MotionOf, tmp_path: Path) -> None:
    table = logged(robot, motion_of(robot, times(40)))
    paths = [written(table, tmp_path / f"{name}.csv") for name in ("one", "two")]
    found = identify_streamed(robot, paths, cutoff_hz=CUTOFF)
    assert found.faults["one"] == ()
    (entry,) = found.fault_entries()
    assert (entry["recording"], entry["fault"]) == ("two", "duplicate_samples")
    assert entry["evidence"]["same_as"] == "one"


def swapped(table: pd.DataFrame) -> pd.DataFrame:
    order = np.arange(len(table))
    for k in (40, 2999, 6999):  # across the borders of pieces too
        order[[k, k + 1]] = order[[k + 1, k]]
    return table.iloc[order]


def blocks_swapped(table: pd.DataFrame) -> pd.DataFrame:
    return table.iloc[np.r_[0:1000, 4500:6500, 1000:4500, 6500 : len(table)]]


def rewritten(table: pd.DataFrame) -> pd.DataFrame:
    return table.iloc[np.r_[0:5000, 4900 : len(table)]]


def twice(table: pd.DataFrame) -> pd.DataFrame:
    return table.iloc[np.sort(np.r_[0 : len(table), 100, 3000, 5000, 5001])]


@pytest.mark.parametrize("damage", [swapped, blocks_swapped, rewritten, twice])
def test_a_log_repaired_on_the_way_is_the_clean_one(
    robot: Robot, motion_of: MotionOf, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    damage: Callable[[pd.DataFrame], pd.DataFrame],
) -> None:  # fmt: skip
    monkeypatch.setattr(logs, "_AT_ONCE", 3000)
    table = logged(robot, motion_of(robot, times(80)))
    clean = written(table, tmp_path / "clean.parquet")
    path = written(damage(table), tmp_path / "log.parquet")
    with pytest.raises(BadRecording, match=r"time goes back|time repeats"):
        identify_streamed(robot, [path], cutoff_hz=CUTOFF)
    expected = identify_streamed(robot, [clean], cutoff_hz=CUTOFF, rows=1000)
    found = identify_streamed(robot, [path], cutoff_hz=CUTOFF, rows=1000, repaired=True)
    np.testing.assert_allclose(found.least_squares.beta, expected.least_squares.beta, rtol=1e-9)
    np.testing.assert_allclose(figures(found.validate), figures(expected.validate), rtol=1e-9)
    in_memory = read_checked(load_dataset("planar_2r"), [str(path)], repaired=True)
    told = [fault.entry() for fault in in_memory.faults["log"]]
    assert [fault.entry() for fault in found.faults["log"]] == told
    assert set(in_memory.notes) <= set(found.notes)


def test_other_faults_are_repaired_on_the_way(
    robot: Robot, plants: Any, fast: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(logs, "_AT_ONCE", 6000)
    log = plants.torque_negated(robot, fast, np.random.default_rng(0))
    tau = np.array(log.tau)
    tau[[700, 6800], 1] = 1e4
    tau[7100, 0] = np.nan
    path = tmp_path / "log.parquet"
    pd.DataFrame(
        {"t": log.t} | {f"{c}{j + 1}": x[:, j] for c, x in
                        (("q", log.q), ("dq", log.dq), ("tau", tau)) for j in range(2)}
    ).to_parquet(path)  # fmt: skip
    with pytest.raises(BadRecording, match="not a finite number") as refusal:
        identify_streamed(robot, [path], cutoff_hz=CUTOFF)
    assert refusal.value.row == 7100
    found = identify_streamed(robot, [path], cutoff_hz=CUTOFF, rows=1000, repaired=True)
    assert [f.fault for f in found.faults["log"]] == [
        "dropped_samples", "corrupt_rows", "corrupt_rows", "wrong_sign"]  # fmt: skip
    clean = Recording("log", str(path), fast.t, fast.q, fast.tau)
    expected = identify(robot, [clean], cutoff_hz=CUTOFF)
    std = np.sqrt(np.diag(expected.least_squares.covariance))
    moved = np.abs(found.least_squares.beta - expected.least_squares.beta)
    assert (moved < 0.2 * std).all()


def test_time_that_runs_too_slow_is_repaired_on_the_way(
    robot: Robot, plants: Any, fast: Any, tmp_path: Path
) -> None:
    """Twice the time between samples, which velocities contradict."""
    log, path = plants.half_rate(robot, fast, np.random.default_rng(0)), tmp_path / "log.parquet"
    channels = (("q", log.q), ("dq", log.dq), ("tau", log.tau))
    columns = {f"{c}{j + 1}": x[:, j] for c, x in channels for j in range(2)}
    pd.DataFrame({"t": log.t} | columns).to_parquet(path)
    found = identify_streamed(robot, [path], cutoff_hz=CUTOFF, rows=1000, repaired=True)
    assert [f.fault for f in found.faults["log"]] == ["wrong_sample_rate"]
    clean = Recording("log", str(path), fast.t, fast.q, fast.tau)
    same_fit(found, replace(identify(robot, [clean], cutoff_hz=CUTOFF), notes=()))


def test_a_clock_that_starts_anew_cuts_a_streamed_log(
    robot: Robot, motion_of: MotionOf, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(logs, "_AT_ONCE", 3000)
    tables = [logged(robot, motion_of(robot, times(40), seed=k), seed=k) for k in range(3)]
    a, b, held = (written(x, tmp_path / f"{n}.csv") for x, n in zip(tables, "abh", strict=True))
    both = written(pd.concat(tables[:2], ignore_index=True), tmp_path / "both.csv")
    expected = identify_streamed(robot, [a, b], validate=[held], cutoff_hz=CUTOFF)
    found = identify_streamed(robot, [both], validate=[held], cutoff_hz=CUTOFF, repaired=True)
    np.testing.assert_allclose(found.least_squares.beta, expected.least_squares.beta, rtol=1e-6)
    assert any("cuts the recording into 2 parts at row 4000" in note for note in found.notes)


def test_rows_too_far_out_of_order_are_refused(
    robot: Robot, motion_of: MotionOf, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mending, "_MOST_HELD", 1000)
    table = logged(robot, motion_of(robot, times(80)))
    path = written(blocks_swapped(table), tmp_path / "log.parquet")
    with pytest.raises(BadRecording, match="sort the file by time first"):
        identify_streamed(robot, [path], cutoff_hz=CUTOFF, repaired=True)
    path = written(table.assign(t=np.mod(table.t, 1.0)), tmp_path / "log.parquet")
    with pytest.raises(BadRecording, match="cut the file by hand"):
        identify_streamed(robot, [path], cutoff_hz=CUTOFF, repaired=True)
    path = written(table.assign(tau2=1.0), tmp_path / "log.parquet")
    with pytest.raises(BadRecording, match="dead channel: 1 in every row"):
        identify_streamed(robot, [path], cutoff_hz=CUTOFF, repaired=True)


@pytest.mark.parametrize("cutoff_hz", [None, 8.0])
def test_cut_offs_are_chosen_as_in_memory(
    robot: Robot, motion_of: MotionOf, tmp_path: Path, cutoff_hz: float | None
) -> None:
    """A joint that rings at 6 Hz is filtered below that, unless the user names a cut-off."""
    motion = motion_of(robot, times(120))
    table, pole = logged(robot, motion, noise=0.01), np.exp((2j - 0.04) * np.pi * 6.0 / RATE)
    white = np.random.default_rng(1).normal(size=len(motion))
    ringing = scipy.signal.lfilter([1.0], [1, -2 * pole.real, abs(pole) ** 2], white)
    table["tau1"] += 0.3 * table["tau1"].std() / ringing.std() * ringing
    path = written(table, tmp_path / "log.parquet")
    whole = identify(robot, [read_recording(path, robot)], cutoff_hz=cutoff_hz, tune=True)
    found = identify_streamed(robot, [path], cutoff_hz=cutoff_hz, rows=1000, tune=True)
    assert whole.study is not None
    assert found.study is not None
    ours, theirs = found.study.choice, whole.study.choice
    assert (theirs.tuning(whole.data.cutoff_hz) is None) == (cutoff_hz is not None)
    np.testing.assert_array_equal(ours.cutoffs_hz, theirs.cutoffs_hz)
    assert ours.dead_zone == theirs.dead_zone
    same_fit(found, whole, rtol=1e-5)
    np.testing.assert_allclose(figures(found.train), figures(whole.train), rtol=1e-4)
    assert any("were chosen on" in note for note in found.notes)
    assert identify_result(found).keys() == identify_result(whole).keys()
    first, second = (identify_result(e)["sensitivity"] for e in (found, whole))
    assert [row["factor"] for row in first] == [row["factor"] for row in second]


PEAK = """
import pathlib, resource, sys
from excitant.identify import identify_streamed
from excitant.robots import load_robot
estimate = identify_streamed(load_robot("panda"), [sys.argv[1]])
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # on Linux at least its parent's
status = pathlib.Path("/proc/self/status")
if status.is_file():
    peak = next(x.split()[1] for x in status.read_text().splitlines() if "VmHWM" in x)
print(int(peak) / 1024, float(estimate.validate.r2.min()))
"""


@pytest.mark.slow
def test_a_million_rows_take_less_than_1200_megabytes(motion_of: MotionOf, tmp_path: Path) -> None:
    # of which 350 are the program itself; in memory the columns alone would take 5500
    arm, path = load_robot("panda"), tmp_path / "log.parquet"
    parts = []
    for k, t in enumerate(np.array_split(np.arange(1_000_000) / 1000, 20)):
        parts.append(logged(arm, motion_of(arm, t), seed=k))
    written(pd.concat(parts, ignore_index=True), path)
    done = subprocess.run(
        [sys.executable, "-c", PEAK, str(path)], capture_output=True, text=True, check=True
    )
    peak, r2 = map(float, done.stdout.split())
    assert peak < 1200
    assert r2 > 0.9
