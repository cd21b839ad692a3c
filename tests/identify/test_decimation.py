"""Logs too long to hold: what they are read as says the same as the whole."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from excitant.exceptions import BadRecording
from excitant.identify import Recording, dataset, identify_robot, read_recordings
from excitant.identify.dataset import decimated
from excitant.robots import Motion, Robot, load_robot, torque
from excitant.robots.effects import standard_effects

RATE = 1000.0


def logged(motion: Motion, robot: Robot, noise: float = 0.05) -> Recording:
    effects = standard_effects(robot.joints)
    valued = [e.with_values(0.2 + 0.1 * np.arange(len(e.parameters(robot)))) for e in effects]
    tau = torque(robot.with_effects(valued), motion)
    tau = tau + noise * np.random.default_rng(0).normal(size=tau.shape)
    return Recording("log", "log.csv", motion.t, motion.q, tau)


def pieces(whole: Recording, rows: int) -> Iterator[Recording]:
    return (whole.take(slice(k, k + rows)) for k in range(0, len(whole), rows))


@pytest.mark.parametrize("rows", [700, 9999])
@pytest.mark.parametrize(("jitter", "gap"), [(0.0, False), (0.3, False), (0.0, True)])
def test_the_estimate_is_that_of_all_samples(
    motion_of: Callable[..., Motion], rows: int, jitter: float, gap: bool
) -> None:
    robot = load_robot("planar_2r")
    t = np.arange(40_000) / RATE
    t = t + jitter / RATE * np.random.default_rng(1).uniform(-0.5, 0.5, len(t))
    t = t[(t < 13.3) | (t > 14.5)] if gap else t
    whole = logged(motion_of(robot, t), robot)
    thin = decimated(pieces(whole, rows))
    assert 160 <= 1 / np.median(np.diff(thin.t)) < 200
    assert (np.diff(thin.t) > 0).all()
    assert int((np.diff(thin.t) > 1).sum()) == gap
    expected, found = (identify_robot(robot, [each]) for each in (whole, thin))
    std = np.sqrt(np.diag(expected.least_squares.covariance))
    moved = np.abs(found.least_squares.beta - expected.least_squares.beta) / std
    # rows at other instants, and ends of parts lost
    assert moved.max() < 1
    np.testing.assert_allclose(
        found.validate.rms, expected.validate.rms, rtol=0.1 if jitter == 0 else 0.3
    )


def test_what_decimation_would_fold_onto_the_motion_is_taken_away() -> None:
    t = np.arange(20_000) / RATE
    slow = np.sin(2 * np.pi * np.array([1.0, 20.0]) * t[:, None])
    fast = np.sin(2 * np.pi * (RATE / int(RATE / 160) - np.array([1.0, 20.0])) * t[:, None])
    thin = decimated(pieces(Recording("log", "", t, slow + fast, slow + fast), 3000))
    expected = np.sin(2 * np.pi * np.array([1.0, 20.0]) * thin.t[:, None])
    assert np.abs(thin.q - expected).max() < 1e-3  # 80 dB, and the same for what is passed


def test_slow_logs_keep_their_samples() -> None:
    t = np.arange(500) / 100.0
    whole = Recording("log", "", t, np.sin(t)[:, None], np.cos(t)[:, None])
    thin = decimated(pieces(whole, 120))
    np.testing.assert_allclose(thin.t, t, atol=1e-9)
    np.testing.assert_allclose(thin.q, whole.q, atol=1e-9)


def test_long_files_are_read_in_pieces_and_short_parts_are_refused(
    motion_of: Callable[..., Motion], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, path = load_robot("planar_2r"), tmp_path / "log.csv"
    whole = logged(motion_of(robot, np.arange(8000) / RATE), robot)
    columns = {f"{n}{j + 1}": x[:, j] for n, x in whole.channels() for j in (0, 1)}
    pd.DataFrame({"t": whole.t} | columns).to_csv(path, index=False)
    assert len(read_recordings([path], robot)[0]) == 8000
    monkeypatch.setattr(dataset, "LONG", 5000)
    [thin] = read_recordings([path], robot)
    assert len(thin) < 1400
    assert any("decimated" in note for note in thin.notes)
    with pytest.raises(BadRecording, match="no uninterrupted part"):
        decimated(pieces(replace(whole, t=whole.t + np.arange(8000) // 30), 100))
