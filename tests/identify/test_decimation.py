"""Logs too long to hold: what they are read as says the same as the whole."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import streaming

from excitant.exceptions import BadRecording
from excitant.identify import Recording, dataset, identify_robot, read_recordings
from excitant.identify.dataset import decimated
from excitant.identify.faults import find_faults
from excitant.robots import Motion, Robot, torque
from excitant.robots.effects import standard_effects

RATE = 1000.0


@pytest.fixture(scope="module")
def logged(planar: Robot, motion_of: Callable[..., Motion]) -> Callable[..., Recording]:
    effects = standard_effects(planar.joints)
    valued = [e.with_values(0.2 + 0.1 * np.arange(len(e.parameters(planar)))) for e in effects]
    arm = planar.with_effects(valued)

    def recorded(t: np.ndarray) -> Recording:
        motion, rng = motion_of(planar, t), np.random.default_rng(0)
        tau = torque(arm, motion) + 0.05 * rng.normal(size=motion.q.shape)
        return Recording("log", "log.csv", t, motion.q, tau)

    return recorded


def pieces(whole: Recording, rows: int) -> Iterator[Recording]:
    return (whole.take(slice(k, k + rows)) for k in range(0, len(whole), rows))


@pytest.mark.parametrize("rows", [700, 9999])
@pytest.mark.parametrize(("jitter", "gap"), [(0.0, False), (0.3, False), (0.0, True)])
def test_the_estimate_is_that_of_all_samples(
    planar: Robot, logged: Callable[..., Recording], rows: int, jitter: float, gap: bool
) -> None:
    t = np.arange(40_000) / RATE
    t = t + jitter / RATE * np.random.default_rng(1).uniform(-0.5, 0.5, len(t))
    whole = logged(t[(t < 13.3) | (t > 14.5)] if gap else t)
    thin = decimated(pieces(whole, rows))
    assert 160 <= 1 / np.median(np.diff(thin.t)) < 200
    assert (np.diff(thin.t) > 0).all()
    assert int((np.diff(thin.t) > 1).sum()) == gap
    assert [fault.fault for fault in find_faults(planar, thin)] == ["dropped_samples"] * gap
    expected, found = (identify_robot(planar, [each]) for each in (whole, thin))
    std, also = (np.sqrt(np.diag(e.least_squares.covariance)) for e in (expected, found))
    moved = np.abs(found.least_squares.beta - expected.least_squares.beta) / std
    # rows at other instants, and ends of parts lost
    assert moved.max() < 1
    assert np.abs(np.log(also / std)).max() < 0.36
    rtol = 0.1 if jitter == 0 else 0.3
    np.testing.assert_allclose(found.validate.rms, expected.validate.rms, rtol=rtol)


def test_what_decimation_would_fold_onto_the_motion_is_taken_away() -> None:
    t = np.arange(20_000) / RATE
    slow = np.sin(2 * np.pi * np.array([1.0, 20.0]) * t[:, None])
    fast = np.sin(2 * np.pi * (RATE / int(RATE / 160) - np.array([1.0, 20.0])) * t[:, None])
    thin = decimated(pieces(Recording("log", "", t, slow + fast, slow + fast), 3000))
    expected = np.sin(2 * np.pi * np.array([1.0, 20.0]) * thin.t[:, None])
    assert np.abs(thin.q - expected).max() < 1e-3  # 80 dB, and the same for what is passed


def test_slow_logs_keep_their_samples() -> None:
    t = np.arange(500) / 100.0
    whole = Recording("log", "", t, np.sin(t)[:, None], np.cos(t)[:, None], "A")
    thin = decimated(pieces(whole, 120))
    np.testing.assert_allclose(thin.t, t, atol=1e-9)
    np.testing.assert_allclose(thin.q, whole.q, atol=1e-9)
    assert thin.unit == "A"


def test_long_files_are_read_in_pieces_and_short_parts_are_refused(
    planar: Robot,
    logged: Callable[..., Recording],
    save: Callable[..., Path],
    excitant: Callable[..., Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    whole = logged(np.arange(8000) / RATE)
    path = save(whole, tmp_path / "log.csv")
    assert len(read_recordings([path], planar)[0]) == 8000
    monkeypatch.setattr(dataset, "LONG", 5000)
    [thin] = read_recordings([path], planar)
    assert len(thin) < 1400
    assert any("decimated" in note for note in thin.notes)
    ran = excitant("identify planar_2r --json", path, "-o", tmp_path / "run")
    assert any("decimated" in note for note in ran.result["notes"])
    with pytest.raises(BadRecording, match="no uninterrupted part"):
        decimated(pieces(replace(whole, t=whole.t + np.arange(8000) // 30), 100))
    bad = save(replace(whole, t=np.where(whole.t == 6.789, 1.0, whole.t)), path)
    with pytest.raises(BadRecording, match="goes back") as refusal:
        read_recordings([bad], planar)
    assert (refusal.value.row, refusal.value.column) == (6789, "t")


@pytest.mark.slow
def test_memory_is_bounded(capsys: pytest.CaptureFixture[str]) -> None:
    """Of a million rows of seven joints, whose columns alone would take 5500 MB."""
    streaming.main(["--samples", "1100000"])
    said = capsys.readouterr().out
    assert int(re.search(r"peak memory +(\d+) MB", said)[1]) < 1200
    assert float(re.search(r"nrmse (\S+)", said)[1]) < 0.3
