"""The filter shifts nothing, derivatives are those of the motion, columns and torque pass alike."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from excitant.exceptions import BadRecording
from excitant.identify import Recording
from excitant.identify.preprocessing import prepare
from excitant.identify.rows import split
from excitant.robots import Motion, Robot, load_robot, rigid_body_torque
from excitant.robots.regressor import regressor

RATE, CUTOFF = 256.0, 10.0  # a rate whose steps are exact in binary
T = np.arange(0, 20, 1 / RATE)


def inner(n: int) -> slice:
    """The middle third, where the filter has forgotten its edges."""
    return slice(n // 3, 2 * n // 3)


def butterworth_twice(f: float) -> float:
    """Gain of a bilinear Butterworth filter of fourth order run forward and backward."""
    ratio = np.tan(np.pi * f / RATE) / np.tan(np.pi * CUTOFF / RATE)
    return float(1 / (1 + ratio**8))


@pytest.mark.parametrize("f", [0.5, 3.0, 8.0, 15.0])
def test_a_sinusoid_comes_out_in_phase(f: float) -> None:
    wave = np.column_stack([np.sin(2 * np.pi * f * T), np.cos(2 * np.pi * f * T)])
    [segment] = prepare(Recording("n", "f", T, wave, wave), CUTOFF)
    mid = inner(len(T))
    # poles at the cut-off decay by exp(−2π · 10 Hz · 0.38 · 6.7 s) over a third: nothing is left
    np.testing.assert_allclose(segment.tau[mid], butterworth_twice(f) * wave[mid], atol=1e-9)
    np.testing.assert_array_equal(segment.tau_raw, wave)


def test_derivatives_are_those_of_the_motion(
    planar: Robot, motion_of: Callable[..., Motion]
) -> None:
    motion = motion_of(planar, T)
    [segment] = prepare(Recording("n", "f", T, motion.q, motion.q), CUTOFF)
    mid = inner(len(T))
    # quintic spline through samples of at most 1.3 Hz at 256 Hz: relative error (ω h)⁴ / 30 in
    # the second derivative; the position filter at 20 Hz takes (1.3 / 20)⁸
    h = 2 * np.pi * 1.3 / RATE
    allowed = 4 * max(h**4 / 30, (1.3 / 20) ** 8)
    for name in ("q", "dq", "ddq"):
        true, found = getattr(motion, name)[mid], getattr(segment.motion, name)[mid]
        assert np.abs(found - true).max() <= allowed * np.abs(true).max(), name


def test_irregular_time_gives_what_regular_time_gives(
    planar: Robot, motion_of: Callable[..., Motion]
) -> None:
    rng = np.random.default_rng(0)
    t = T + rng.uniform(-0.4, 0.4, len(T)) / RATE
    true = motion_of(planar, t)
    [segment] = prepare(Recording("n", "f", t, true.q, true.q), CUTOFF)
    expected = motion_of(planar, segment.motion.t)
    largest = np.diff(t).max()
    linear = largest**2 / 8 * np.abs(expected.ddq).max()  # of piecewise linear interpolation
    assert np.abs(segment.tau_raw - expected.q).max() <= linear
    mid = inner(len(segment.motion.t))
    cubic = 5 / 384 * largest**4 * np.abs(expected.q).max() * (2 * np.pi * 1.3) ** 4
    # the position filter lets pass 20 Hz: an error of q grows at most by 2π · 20 Hz each time
    for order, name in enumerate(("q", "dq", "ddq")):
        allowed = 4 * cubic * (2 * np.pi * 20) ** order
        difference = getattr(segment.motion, name)[mid] - getattr(expected, name)[mid]
        assert np.abs(difference).max() <= allowed, name


def test_gaps_split_and_nothing_is_invented_across_them(
    planar: Robot, motion_of: Callable[..., Motion]
) -> None:
    keep = (T < 6.0) | (T >= 9.0)
    motion = motion_of(planar, T[keep])
    segments = prepare(Recording("n", "f", motion.t, motion.q, motion.q), CUTOFF)
    alone = [
        prepare(Recording("n", "f", motion.t[rows], motion.q[rows], motion.q[rows]), CUTOFF)[0]
        for rows in (motion.t < 6.0, motion.t >= 9.0)
    ]
    assert len(segments) == 2
    for found, expected in zip(segments, alone, strict=True):
        np.testing.assert_allclose(found.t, expected.t, atol=1e-12)
        np.testing.assert_allclose(found.tau, expected.tau, atol=1e-9)
        assert not ((found.t >= 6.0) & (found.t < 9.0)).any()


def test_parts_too_short_between_gaps_are_left_out_or_refused() -> None:
    t = T + 1.0 * np.floor(T)  # one second on, one second off
    wave, why = np.sin(t)[:, None], r"time jumps 19 times, first after 0\.9961 s"
    with pytest.raises(BadRecording, match=why) as refusal:
        prepare(Recording("n", "f.csv", t, wave, wave))
    assert (refusal.value.file, refusal.value.column) == ("f.csv", "t")
    t = np.where(T < 10, T, t)
    assert len(prepare(Recording("n", "f.csv", t, wave, wave))) == 1


@pytest.mark.parametrize("cutoff", [102.5, 128.0, 1e4, 0.0, -3.0, np.nan])
def test_a_cutoff_that_does_not_fit_is_refused(cutoff: float) -> None:
    wave = np.sin(T)[:, None]
    with pytest.raises(BadRecording, match="choose one up to 102 Hz"):
        prepare(Recording("n", "f", T, wave, wave), cutoff)


def test_a_slow_recording_gets_a_cutoff_that_fits() -> None:
    t = np.arange(0, 20, 0.1)
    wave = np.sin(t)[:, None]
    recording = Recording("n", "f", t, wave, wave)
    assert prepare(recording)[0].cutoff_hz == pytest.approx(2.0)  # positions: 4 of 5 Hz
    assert prepare(recording, 4.0)[0].cutoff_hz == pytest.approx(4.0)
    with pytest.raises(BadRecording, match="choose one up to 4 Hz"):
        prepare(recording, 4.1)


def test_columns_and_torque_pass_the_same_filter(
    ur10: Robot, motion_of: Callable[..., Motion]
) -> None:
    t = T[:1000]
    motion = motion_of(ur10, t)
    [segment] = prepare(Recording("n", "f", t, motion.q, motion.q), CUTOFF)
    columns = segment.rows(lambda m: regressor(ur10, m)) @ ur10.phi
    torque = segment.rows(lambda m: rigid_body_torque(ur10, m))
    np.testing.assert_allclose(columns, torque, atol=1e-9 * np.abs(torque).max())
    assert len(torque) == len(segment.t) == len(segment.tau[segment.keep])


def test_rows_leave_out_the_edges_and_stay_dense_enough() -> None:
    wave = np.sin(T)[:, None]
    [segment] = prepare(Recording("n", "f", T, wave, wave), CUTOFF)
    assert segment.t[0] - T[0] >= 1 / CUTOFF - 1 / RATE
    assert T[-1] - segment.t[-1] >= 1 / CUTOFF - 1 / RATE
    assert np.diff(segment.t).max() <= 1 / (4 * CUTOFF) + 1e-12  # twice the Nyquist rate


def test_one_cut_off_and_one_sentence_why(exact: Callable[..., Recording]) -> None:
    robot = load_robot("planar_2r")
    fast, slow = (exact(robot, np.arange(0, 10, 1 / rate)) for rate in (200.0, 30.0))
    for recordings, given, harmonics, expected, why in (
        ([fast], None, None, 10.0, "above the motion of arms"),
        ([fast], None, 3.0, 10.0, "above the motion of arms"),
        ([fast], None, 8.0, 16.0, "twice the highest harmonic"),
        ([fast, slow], None, None, 6.0, "a fifth of the lowest sampling rate"),
        ([fast], 4.0, 8.0, 4.0, "as given"),
    ):
        data = split(recordings, cutoff_hz=given, harmonics_hz=harmonics)
        assert data.cutoff_hz == pytest.approx(expected)
        assert why in data.cutoff_why


def test_columns_of_long_segments_are_those_of_the_whole(
    exact: Callable[..., Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = load_robot("planar_2r")
    [segment] = prepare(exact(robot, np.arange(0, 40, 0.01)), 5.0)
    whole = segment.rows(lambda motion: regressor(robot, motion))
    monkeypatch.setattr("excitant.identify.preprocessing._AT_ONCE", 700)
    parts = segment.rows(lambda motion: regressor(robot, motion))
    np.testing.assert_allclose(parts, whole, atol=1e-6 * np.abs(whole).max())
