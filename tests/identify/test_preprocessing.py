"""The filter shifts nothing, derivatives are those of the motion, columns and torque pass alike."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from excitant.exceptions import BadRecording
from excitant.identify import Recording
from excitant.identify.preprocessing import Segment, prepare
from excitant.identify.rows import split
from excitant.robots import Motion, Robot, rigid_body_torque
from excitant.robots.regressor import regressor

RATE, CUTOFF = 256.0, 10.0  # a rate whose steps are exact in binary
T = np.arange(0, 20, 1 / RATE)
WAVE = np.sin(T)[:, None]
MIDDLE = slice(len(T) // 3, 2 * len(T) // 3)  # where the filter has forgotten its edges
MotionOf = Callable[..., Motion]


def prepared(t: np.ndarray, q: np.ndarray, cutoff: float | None = CUTOFF) -> list[Segment]:
    """Segments of a recording whose torque is its position."""
    return prepare(Recording("n", "f.csv", t, q, q), cutoff)


def butterworth_twice(f: float) -> float:
    """Gain of a bilinear Butterworth filter of fourth order run forward and backward."""
    ratio = np.tan(np.pi * f / RATE) / np.tan(np.pi * CUTOFF / RATE)
    return float(1 / (1 + ratio**8))


@pytest.mark.parametrize("f", [0.5, 3.0, 8.0, 15.0])
def test_a_sinusoid_comes_out_in_phase(f: float) -> None:
    wave = np.column_stack([np.sin(2 * np.pi * f * T), np.cos(2 * np.pi * f * T)])
    [segment] = prepared(T, wave)
    # poles at the cut-off decay by exp(−2π · 10 Hz · 0.38 · 6.7 s) over a third: nothing is left
    expected = butterworth_twice(f) * wave[MIDDLE]
    np.testing.assert_allclose(segment.tau[MIDDLE], expected, atol=1e-9)
    np.testing.assert_array_equal(segment.tau_raw, wave)


def test_derivatives_are_those_of_the_motion(planar: Robot, motion_of: MotionOf) -> None:
    motion = motion_of(planar, T)
    [segment] = prepared(T, motion.q)
    # quintic spline through samples of at most 1.3 Hz at 256 Hz: relative error (ω h)⁴ / 30 in
    # the second derivative; the position filter at 20 Hz takes (1.3 / 20)⁸
    h = 2 * np.pi * 1.3 / RATE
    allowed = 4 * max(h**4 / 30, (1.3 / 20) ** 8)
    for name in ("q", "dq", "ddq"):
        true, found = getattr(motion, name)[MIDDLE], getattr(segment.motion, name)[MIDDLE]
        assert np.abs(found - true).max() <= allowed * np.abs(true).max(), name


def test_irregular_time_gives_what_regular_time_gives(planar: Robot, motion_of: MotionOf) -> None:
    t = T + np.random.default_rng(0).uniform(-0.4, 0.4, len(T)) / RATE
    [segment] = prepared(t, motion_of(planar, t).q)
    expected = motion_of(planar, segment.motion.t)
    largest = np.diff(t).max()
    linear = largest**2 / 8 * np.abs(expected.ddq).max()  # of piecewise linear interpolation
    assert np.abs(segment.tau_raw - expected.q).max() <= linear
    cubic = 5 / 384 * largest**4 * np.abs(expected.q).max() * (2 * np.pi * 1.3) ** 4
    # the position filter lets pass 20 Hz: an error of q grows at most by 2π · 20 Hz each time
    for order, name in enumerate(("q", "dq", "ddq")):
        allowed = 4 * cubic * (2 * np.pi * 20) ** order
        difference = (getattr(segment.motion, name) - getattr(expected, name))[MIDDLE]
        assert np.abs(difference).max() <= allowed, name


def test_gaps_split_and_nothing_is_invented_across_them(planar: Robot, motion_of: MotionOf) -> None:
    t = T[(T < 6.0) | (T >= 9.0)]
    q = motion_of(planar, t).q
    segments = prepared(t, q)
    assert len(segments) == 2
    for found, rows in zip(segments, (t < 6.0, t >= 9.0), strict=True):
        [alone] = prepared(t[rows], q[rows])
        np.testing.assert_allclose(found.t, alone.t, atol=1e-12)
        np.testing.assert_allclose(found.tau, alone.tau, atol=1e-9)
        assert not ((found.t >= 6.0) & (found.t < 9.0)).any()


def test_parts_too_short_between_gaps_are_left_out_or_refused() -> None:
    t = T + 1.0 * np.floor(T)  # one second on, one second off
    why = r"time jumps 19 times, first after 0\.9961 s"
    with pytest.raises(BadRecording, match=why) as refusal:
        prepared(t, WAVE)
    assert (refusal.value.file, refusal.value.column) == ("f.csv", "t")
    assert len(prepared(np.where(T < 10, T, t), WAVE)) == 1


SLOW = np.arange(0, 20, 0.1)


@pytest.mark.parametrize(
    ("t", "cutoff", "highest"),
    [*((T, f, "102") for f in (102.5, 128.0, 1e4, 0.0, -3.0, np.nan)), (SLOW, 4.1, "4")],
)
def test_a_cutoff_that_does_not_fit_is_refused(t: np.ndarray, cutoff: float, highest: str) -> None:
    with pytest.raises(BadRecording, match=f"choose one up to {highest} Hz"):
        prepared(t, np.sin(t)[:, None], cutoff)


def test_a_slow_recording_gets_a_cutoff_that_fits() -> None:
    for given, expected in ((None, 2.0), (4.0, 4.0)):  # positions: 4 of 5 Hz
        [segment] = prepared(SLOW, np.sin(SLOW)[:, None], given)
        assert segment.cutoff_hz == pytest.approx(expected)


def test_columns_and_torque_pass_the_same_filter(ur10: Robot, motion_of: MotionOf) -> None:
    t = T[:1000]
    [segment] = prepared(t, motion_of(ur10, t).q)
    columns = segment.rows(lambda m: regressor(ur10, m)) @ ur10.phi
    torque = segment.rows(lambda m: rigid_body_torque(ur10, m))
    np.testing.assert_allclose(columns, torque, atol=1e-9 * np.abs(torque).max())
    assert len(torque) == len(segment.t) == len(segment.tau[segment.keep])


def test_rows_leave_out_the_edges_and_stay_dense_enough() -> None:
    [segment] = prepared(T, WAVE)
    assert segment.t[0] - T[0] >= 1 / CUTOFF - 1 / RATE
    assert T[-1] - segment.t[-1] >= 1 / CUTOFF - 1 / RATE
    assert np.diff(segment.t).max() <= 1 / (4 * CUTOFF) + 1e-12  # twice the Nyquist rate


def test_one_cut_off_and_one_sentence_why(planar: Robot, exact: Callable[..., Recording]) -> None:
    fast, slow = (exact(planar, np.arange(0, 10, 1 / rate)) for rate in (200.0, 30.0))
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
    planar: Robot, motion_of: MotionOf, monkeypatch: pytest.MonkeyPatch
) -> None:
    t = np.arange(0, 40, 0.01)
    [segment] = prepared(t, motion_of(planar, t).q, 5.0)
    whole = segment.rows(lambda motion: regressor(planar, motion))
    monkeypatch.setattr("excitant.identify.preprocessing._AT_ONCE", 700)
    parts = segment.rows(lambda motion: regressor(planar, motion))
    np.testing.assert_allclose(parts, whole, atol=1e-6 * np.abs(whole).max())
