"""Filters shift nothing, derivatives are those of the motion, columns and torque pass alike."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.optimize
import scipy.signal
from known_arms import smooth_motion
from numpy.polynomial import Polynomial

from excitant.exceptions import BadInput, BadRecording
from excitant.identify import LocalPolynomial, Recording
from excitant.identify.differentiators import (
    causal_polynomial,
    causal_polynomials,
    position_spectrum,
)
from excitant.identify.preprocessing import SAMPLING, Segment, prepare
from excitant.identify.rows import split
from excitant.robots import Robot, load_robot, rigid_body_torque
from excitant.robots.regressor import regressor

RATE, CUTOFF = 256.0, 10.0  # a rate whose steps are exact in binary
T = np.arange(0, 20, 1 / RATE)
SLOW = np.arange(0, 20, 0.1)
MIDDLE = slice(len(T) // 3, 2 * len(T) // 3)  # where filters have forgotten their edges
NAMES = ("q", "dq", "ddq")
PLANAR = load_robot("planar_2r")


def prepared(t: np.ndarray, q: np.ndarray, cutoff: float | None = CUTOFF) -> list[Segment]:
    """Segments of a recording whose torque is its position."""
    return prepare(Recording("n", "f.csv", t, q, q), cutoff)


@pytest.mark.parametrize("f", [0.5, 3.0, 8.0, 15.0])
def test_a_sinusoid_comes_out_in_phase(f: float) -> None:
    wave = np.column_stack([np.sin(2 * np.pi * f * T), np.cos(2 * np.pi * f * T)])
    [segment] = prepared(T, wave)
    # gain of a bilinear Butterworth filter of fourth order, forward and backward; its poles decay
    # by exp(−2π · 10 Hz · 0.38 · 6.7 s) over a third: nothing is left
    gain = 1 / (1 + (f / CUTOFF) ** 8)
    np.testing.assert_allclose(segment.tau[MIDDLE], gain * wave[MIDDLE], atol=1e-9)
    np.testing.assert_array_equal(segment.tau_raw, wave)


def test_derivatives_are_those_of_the_motion() -> None:
    motion = smooth_motion(PLANAR, T)
    [segment] = prepared(T, motion.q)
    # quintic spline through samples of at most 1.3 Hz at 256 Hz: relative error (ω h)⁴ / 30 in
    # the second derivative; the position filter at 20 Hz takes (1.3 / 20)⁸
    allowed = 4 * max((2 * np.pi * 1.3 / RATE) ** 4 / 30, (1.3 / 20) ** 8)
    for name in NAMES:
        true, found = getattr(motion, name)[MIDDLE], getattr(segment.motion, name)[MIDDLE]
        assert np.abs(found - true).max() <= allowed * np.abs(true).max(), name


def test_irregular_time_gives_what_regular_time_gives() -> None:
    t = T + np.random.default_rng(0).uniform(-0.4, 0.4, len(T)) / RATE
    [segment] = prepared(t, smooth_motion(PLANAR, t).q)
    expected = smooth_motion(PLANAR, segment.motion.t)
    largest = np.diff(t).max()
    linear = largest**2 / 8 * np.abs(expected.ddq).max()  # of piecewise linear interpolation
    assert np.abs(segment.tau_raw - expected.q).max() <= linear
    cubic = 5 / 384 * largest**4 * np.abs(expected.q).max() * (2 * np.pi * 1.3) ** 4
    # the position filter lets pass 20 Hz: an error of q grows at most by 2π · 20 Hz each time
    for order, name in enumerate(NAMES):
        error = np.abs(getattr(segment.motion, name) - getattr(expected, name))[MIDDLE]
        assert error.max() <= 4 * cubic * (2 * np.pi * 20) ** order, name


def test_gaps_split_and_nothing_is_invented_across_them() -> None:
    t = T[(T < 6.0) | (T >= 9.0)]
    q = smooth_motion(PLANAR, t).q
    segments = prepared(t, q)
    assert len(segments) == 2
    for found, rows in zip(segments, (t < 6.0, t >= 9.0), strict=True):
        [alone] = prepared(t[rows], q[rows])
        np.testing.assert_allclose(found.t, alone.t, atol=1e-12)
        np.testing.assert_allclose(found.tau, alone.tau, atol=1e-9)
        assert not ((found.t >= 6.0) & (found.t < 9.0)).any()


def test_parts_too_short_between_gaps_are_left_out_or_refused() -> None:
    t = T + 1.0 * np.floor(T)  # one second on, one second off
    wave, why = np.sin(t)[:, None], r"time jumps 19 times, first after 0\.9961 s"
    with pytest.raises(BadRecording, match=why) as refusal:
        prepared(t, wave)
    assert (refusal.value.file, refusal.value.column) == ("f.csv", "t")
    assert len(prepared(np.where(T < 10, T, t), wave)) == 1


def test_a_cutoff_that_does_not_fit_is_refused() -> None:
    unfit = [(T, f, "102") for f in (102.5, 128.0, 1e4, 0.0, -3.0, np.nan)]
    for t, cutoff, highest in (*unfit, (SLOW, 4.1, "4")):
        with pytest.raises(BadRecording, match=f"choose one up to {highest} Hz"):
            prepared(t, np.sin(t)[:, None], cutoff)
    for given, expected in ((None, 2.0), (4.0, 4.0)):  # positions: 4 of 5 Hz
        [segment] = prepared(SLOW, np.sin(SLOW)[:, None], given)
        assert segment.cutoff_hz == pytest.approx(expected)


def test_columns_and_torque_pass_the_same_filter_also_in_parts(
    ur10: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    t = T[:2000]
    [segment] = prepared(t, smooth_motion(ur10, t).q)
    columns, torque = (
        segment.rows(lambda motion, of=of: of(ur10, motion))
        for of in (regressor, rigid_body_torque)
    )
    np.testing.assert_allclose(columns @ ur10.phi, torque, atol=1e-9 * np.abs(torque).max())
    assert len(torque) == len(segment.t) == len(segment.tau[segment.keep])
    small = replace(SAMPLING, chunk=500)
    monkeypatch.setattr("excitant.identify.preprocessing.SAMPLING", small)
    parts = segment.rows(lambda motion: regressor(ur10, motion))
    np.testing.assert_allclose(parts, columns, atol=1e-6 * np.abs(columns).max())
    # edges are left out, and rows are twice as dense as the filter lets pass
    assert min(segment.t[0] - t[0], t[-1] - segment.t[-1]) >= 1 / CUTOFF - 1 / RATE
    assert np.diff(segment.t).max() <= 1 / (4 * CUTOFF) + 1e-12


def test_one_cut_off_and_one_sentence_why(exact: Callable[..., Recording]) -> None:
    fast, slow = (exact(PLANAR, np.arange(0, 10, 1 / rate)) for rate in (200.0, 30.0))
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


def test_five_points_are_the_least_squares_parabola_with_the_published_figures() -> None:
    five, rate = LocalPolynomial(2, 2), 500.0
    np.testing.assert_allclose(10 * five.kernel(1), [-2, -1, 0, 1, 2], atol=1e-14)
    np.testing.assert_allclose(7 * five.kernel(2), [2, -1, -2, -1, 2], atol=1e-13)
    assert five.noise_gain(rate) / rate == pytest.approx(1 / np.sqrt(10), rel=1e-12)  # 0.316
    gains = five.gain(np.array([2.0, 10.0, 20.0]), rate)
    np.testing.assert_allclose(gains, [0.9996, 0.991, 0.965], atol=5e-4)
    half_power = scipy.optimize.brentq(lambda f: five.gain(f, rate) - np.sqrt(0.5), 30, 100)
    assert half_power == pytest.approx(60.5, abs=0.05)


def derivative(polynomial: LocalPolynomial, x: np.ndarray, order: int, rate: float = RATE) -> Any:
    """A derivative of channels, shape (n, k), at the middle of every whole window."""
    windows = np.lib.stride_tricks.sliding_window_view(x, 2 * polynomial.half_width + 1, axis=0)
    return windows @ polynomial.kernel(order) * rate**order


@pytest.mark.parametrize(
    "polynomial", [LocalPolynomial(2, 2), LocalPolynomial(8, 4)], ids=lambda x: x.name
)
def test_gain_and_noise_gain_are_those_announced(polynomial: LocalPolynomial) -> None:
    """Of a sinusoid, and the norm of the impulse response."""
    t = T[polynomial.half_width : -polynomial.half_width]
    impulse = np.eye(len(T))[:, [2000]]
    for order in range(3):
        for f in (1.0, 7.0, 25.0):
            w = 2 * np.pi * f
            found = derivative(polynomial, np.sin(w * T)[:, None], order)[:, 0]
            gain = float(polynomial.gain(np.array([f]), RATE, order)[0])
            true = w**order * np.sin(w * t + order * np.pi / 2)
            assert np.abs(found - gain * true).max() <= 1e-8 * w**order
        response = np.linalg.norm(derivative(polynomial, impulse, order))
        assert polynomial.noise_gain(RATE, order) == pytest.approx(response, rel=1e-6)
    assert polynomial.delay(RATE) == polynomial.half_width / RATE
    with pytest.raises(BadInput, match="degree 5 through 5 samples"):
        LocalPolynomial(2, 5)


def test_polynomials_are_exact_up_to_their_degree() -> None:
    t = np.arange(200) / RATE
    q = Polynomial(np.random.default_rng(0).standard_normal(5), domain=[0, t[-1]], window=[0, 1])
    for order in range(3):
        found = derivative(LocalPolynomial(6, 4), q(t)[:, None], order)[:, 0]
        true = q.deriv(order)(t[6:-6])
        np.testing.assert_allclose(found, true, atol=1e-8 * np.abs(true).max())


def recorded(noise: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ten seconds of two joints with position noise, and their true acceleration."""
    t, w = np.arange(0, 10, 1e-3), 2 * np.pi * np.array([[[0.7]], [[3.1]]])
    waves = np.array([[[1.0]], [[0.2]]]) * np.sin(w * t[:, None] + np.array([0.0, 1.0]))
    q = waves.sum(axis=0) + noise * np.random.default_rng(seed).standard_normal((len(t), 2))
    return t, q, -(w**2 * waves).sum(axis=0)


def error_of(polynomial: LocalPolynomial, q: np.ndarray, ddq: np.ndarray) -> Any:
    """Root mean square error of acceleration per joint, away from the ends."""
    edge = polynomial.half_width
    error = derivative(polynomial, q, 2, 1e3) - ddq[edge:-edge]
    return np.sqrt((error[500:-500] ** 2).mean(axis=0))


@pytest.mark.parametrize("noise", [1e-6, 1e-4, 1e-3])
def test_the_predicted_error_is_the_error_and_no_candidate_much_better(noise: float) -> None:
    t, q, true = recorded(noise, seed=3)
    spectrum = position_spectrum(t, q)
    np.testing.assert_allclose(spectrum.noise, noise, rtol=0.1)
    choice = causal_polynomial(spectrum)
    # a recording of some hundred independent errors gives their rms to about ten per cent
    error = error_of(choice.differentiator, q, true)
    np.testing.assert_allclose(error, choice.error, rtol=0.35)
    others = [error_of(each, q, true) for each in causal_polynomials(spectrum)]
    assert np.linalg.norm(error) <= 1.3 * np.linalg.norm(others, axis=1).min()
    assert choice.differentiator.delay(1e3) > 0
    assert "predicted acceleration error" in choice.why
    assert "\n" not in choice.why


def test_positions_pass_another_filter_where_one_is_named() -> None:
    t, q, true = recorded(0.0)
    [segment] = prepare(Recording("n", "f", t, q, q), 10.0, 40.0)
    np.testing.assert_allclose(segment.motion.ddq[200:-200], true[200:-200], atol=1e-3)


@pytest.mark.parametrize("rate", [100.0, 125.0, 250.0, 1000.0])
def test_a_thin_segment_has_the_same_rows_and_nearly_the_same_columns(rate: float) -> None:
    t = np.arange(0, 20, 1 / rate)
    motion = smooth_motion(PLANAR, t)
    [segment] = prepared(t, motion.q)
    thin = segment.thin
    assert thin.rate_hz >= min(rate, 8 * CUTOFF) * (1 - 1e-9)
    np.testing.assert_allclose(thin.t, segment.t, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(thin.tau[thin.keep], segment.tau[segment.keep])
    full, few = (s.rows(lambda m: regressor(PLANAR, m)) for s in (segment, thin))
    # positions keep 20 Hz, so that products of three of them end at the Nyquist frequency
    within = slice(10, -10)  # edges of the filter apart
    assert np.abs(few - full)[within].max() < 2e-3 * np.abs(full).max()
