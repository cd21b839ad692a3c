"""Filters shift nothing, derivatives are those of the motion, columns and torque pass alike.

Filter and spectra against SciPy's; positions and speeds weighed by their noise.
"""

import re
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
import scipy
from known_arms import Call, smooth_motion
from marks import refusal, refused
from numpy.polynomial import Polynomial

from excitant.exceptions import BadInput, BadRecording
from excitant.identify import LocalPolynomial, Recording
from excitant.identify.differentiators import (
    causal_polynomial,
    causal_polynomials,
    position_spectrum,
)
from excitant.identify.preprocessing import SAMPLING, Segment, prepare
from excitant.identify.regression import effect_columns
from excitant.identify.rows import split
from excitant.identify.signals import differentiated, live, low_pass, resolution, smoothed
from excitant.robots import load_robot, rigid_body_torque
from excitant.robots.effects import Backlash
from excitant.robots.motion import power_density
from excitant.robots.regressor import regressor, torque_derivatives

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
    for found, rows in zip(prepared(t, q), (t < 6.0, t >= 9.0), strict=True):
        [alone] = prepared(t[rows], q[rows])
        np.testing.assert_allclose(found.t, alone.t, atol=1e-12)
        np.testing.assert_allclose(found.tau, alone.tau, atol=1e-9)
        assert not ((found.t >= 6.0) & (found.t < 9.0)).any()


def test_parts_too_short_between_gaps_are_left_out_or_refused() -> None:
    t = T + 1.0 * np.floor(T)  # one second on, one second off
    wave, why = np.sin(t)[:, None], r"time jumps 19 times, first after 0\.9961 s"
    error = refusal(why, prepared, t, wave, error=BadRecording)
    assert (error.file, error.column) == ("f.csv", "t")
    assert len(prepared(np.where(T < 10, T, t), wave)) == 1
    assert len(prepared(t, np.sin(t / 8)[:, None])) == 1  # neighbours determine so slow a motion


def test_a_cutoff_that_does_not_fit_is_refused() -> None:
    unfit = [(T, f, "102") for f in (102.5, 128.0, 1e4, 0.0, -3.0, np.nan)]
    for t, cutoff, highest in (*unfit, (SLOW, 4.1, "4")):
        wave, why = np.sin(t)[:, None], f"choose one up to {highest} Hz"
        refused(why, prepared, t, wave, cutoff, error=BadRecording)
    for given, expected in ((None, 2.0), (4.0, 4.0)):  # positions: 4 of 5 Hz
        [segment] = prepared(SLOW, np.sin(SLOW)[:, None], given)
        assert segment.cutoff_hz == pytest.approx(expected)


def test_columns_and_torque_pass_the_same_filter_also_in_parts(ur10, monkeypatch):
    t = T[:2000]
    [segment] = prepared(t, smooth_motion(ur10, t).q)
    kinds = [partial(of, ur10) for of in (regressor, rigid_body_torque)]
    columns, torque = segment.rows_of(kinds)
    np.testing.assert_allclose(columns @ ur10.phi, torque, atol=1e-9 * np.abs(torque).max())
    assert len(torque) == len(segment.t) == len(segment.tau[segment.keep])
    monkeypatch.setattr("excitant.identify.preprocessing.SAMPLING", replace(SAMPLING, chunk=500))
    np.testing.assert_allclose(segment.rows(kinds[0]), columns, atol=1e-6 * np.abs(columns).max())
    # what effects share of a part is computed once
    torque_derivatives.cache_clear()
    effect_columns(ur10, [Backlash((joint,)) for joint in ur10.joints], [segment])
    assert 1 < torque_derivatives.cache_info().misses < len(ur10.joints)
    # edges are left out, and rows are twice as dense as the filter lets pass
    assert min(segment.t[0] - t[0], t[-1] - segment.t[-1]) >= 1 / CUTOFF - 1 / RATE
    assert np.diff(segment.t).max() <= 1 / (4 * CUTOFF) + 1e-12


def test_one_cut_off_and_one_sentence_why(exact: Call) -> None:
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


@pytest.mark.parametrize("shape", [(2, 2), (8, 4)])
def test_gain_and_noise_gain_are_those_announced(shape: tuple[int, int]) -> None:
    """Of a sinusoid, and the norm of the impulse response."""
    polynomial = LocalPolynomial(*shape)
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
    refused("degree 5 through 5 samples", LocalPolynomial, 2, 5, error=BadInput)


def test_polynomials_are_exact_up_to_their_degree() -> None:
    t = np.arange(200) / RATE
    q = Polynomial(np.random.default_rng(0).standard_normal(5), domain=[0, t[-1]], window=[0, 1])
    for order in range(3):
        found = derivative(LocalPolynomial(6, 4), q(t)[:, None], order)[:, 0]
        true = q.deriv(order)(t[6:-6])
        np.testing.assert_allclose(found, true, atol=1e-8 * np.abs(true).max())


def recorded(noise: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ten seconds of two joints with position noise, and their true acceleration."""
    motion = smooth_motion(PLANAR, np.arange(0, 10, 1e-3), hz=np.array([0.7, 0.9, 1.3, 3.1]))
    q = motion.q + noise * np.random.default_rng(seed).standard_normal(motion.q.shape)
    return motion.t, q, motion.ddq


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
    [segment] = prepared(t, smooth_motion(PLANAR, t).q)
    thin = segment.thin
    assert thin.rate_hz >= min(rate, 8 * CUTOFF) * (1 - 1e-9)
    np.testing.assert_allclose(thin.t, segment.t, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(thin.tau[thin.keep], segment.tau[segment.keep])
    full, few = (s.rows(lambda m: regressor(PLANAR, m)) for s in (segment, thin))
    # positions keep 20 Hz, so that products of three of them end at the Nyquist frequency
    within = slice(10, -10)  # edges of the filter apart
    assert np.abs(few - full)[within].max() < 2e-3 * np.abs(full).max()


LOW_RATE = 250.0


def walk(n: int) -> np.ndarray:
    return np.cumsum(np.random.default_rng(n).normal(size=(n, 3)), axis=0)


@pytest.mark.parametrize(("n", "cutoff"), [(5003, 2.0), (20_000, 0.5)])
def test_the_filter_is_that_of_sections_forward_and_backward(n: int, cutoff: float) -> None:
    """Far below the sampling rate, where sections are those of the analogue filter."""
    x, sections = walk(n), scipy.signal.butter(4, cutoff, fs=LOW_RATE, output="sos")
    expected = scipy.signal.sosfiltfilt(sections, x, axis=0, padlen=int(6 * LOW_RATE / cutoff))
    warped = (np.pi * cutoff / LOW_RATE) ** 2  # relative error of tan x / x, some times over
    np.testing.assert_allclose(low_pass(x, cutoff, LOW_RATE), expected, atol=warped * np.ptp(x))


@pytest.mark.parametrize("rate", [50.0, 125.0, 1000.0])
@pytest.mark.parametrize("f", [1.0, 7.0, 10.0, 16.0])
def test_the_gain_is_that_of_the_analogue_filter_at_every_rate(rate: float, f: float) -> None:
    wave = np.sin(2 * np.pi * f * np.arange(int(20 * rate)) / rate)
    poles = scipy.signal.butter(4, 2 * np.pi * 10.0, analog=True)
    [gain] = np.abs(scipy.signal.freqs(*poles, [2 * np.pi * f])[1]) ** 2
    middle = slice(len(wave) // 3, -(len(wave) // 3))
    np.testing.assert_allclose(low_pass(wave, 10.0, rate)[middle], gain * wave[middle], atol=1e-7)


def test_the_filter_is_linear_passes_lines_keeps_shapes_and_constants_exactly() -> None:
    x, y = walk(501), walk(501)[::-1]
    assert low_pass(np.zeros((0, 3, 2)), 10.0, LOW_RATE).shape == (0, 3, 2)
    both, one, other = (low_pass(each, 10.0, LOW_RATE) for each in (2 * x - 3 * y, x, y))
    np.testing.assert_allclose(both, 2 * one - 3 * other)
    line = np.linspace(-3.0, 9.0, 400)
    np.testing.assert_allclose(low_pass(line, 10.0, LOW_RATE), line, atol=1e-12)
    for shape in [(1, 2), (2,), (7,), (30, 2, 3)]:
        np.testing.assert_allclose(low_pass(np.ones(shape), 10.0, LOW_RATE), np.ones(shape))
    passed = low_pass(np.full((999, 2), 3.7), 10.0, LOW_RATE, slice(30, 960, 7))
    np.testing.assert_array_equal(passed, np.full((133, 2), 3.7))


def test_columns_are_live_by_their_only_row_that_is_not_zero() -> None:
    values = np.zeros((500, 3, 400))
    for column in range(1, 400):
        values[column, column % 3, column] = [1e-300, np.nan, -np.inf][column % 3]
    np.testing.assert_array_equal(live(values), values.any(axis=0))
    assert live(np.zeros((0, 2))).tolist() == [False, False]


@pytest.mark.parametrize("n", [64, 65, 1000, 5003])
@pytest.mark.parametrize("longest", [64, 255, 10_000])
def test_the_density_is_welchs(n: int, longest: int) -> None:
    x = walk(n)
    f, expected = scipy.signal.welch(x, LOW_RATE, nperseg=min(longest, n), axis=0)
    found = power_density(x, LOW_RATE, longest)
    np.testing.assert_allclose(found[0], f)
    np.testing.assert_allclose(found[1], expected, rtol=1e-9, atol=1e-14 * expected.max())


FAST, BAND = 500.0, 20.0
TIME = np.arange(0, 20, 1 / FAST)
MOVED = smooth_motion(PLANAR, TIME)
Q, DQ = MOVED.q, MOVED.dq


def error(q: np.ndarray) -> np.ndarray:
    """Rms error of acceleration, shape (nv,)."""
    return np.sqrt(((differentiated(TIME, q, BAND).ddq - MOVED.ddq)[200:-200] ** 2).mean(axis=0))


@pytest.mark.parametrize(("bits", "speed"), [(10, 0.02), (12, 0.01), (14, 0.01), (16, 0.001)])
def test_noise_is_found_and_what_is_fused_beats_either(bits: int, speed: float) -> None:
    step, rng = 2 * np.pi / 2**bits, np.random.default_rng(bits)
    q, dq = step * np.round(Q / step), DQ + speed * rng.standard_normal(DQ.shape)
    found, sensors = smoothed(TIME, q, dq, BAND)
    # 400 bins of the band, and the white floor of a third of all
    np.testing.assert_allclose(sensors.step, step, rtol=1e-6)
    np.testing.assert_allclose(sensors.position, step / np.sqrt(12), rtol=0.35)
    np.testing.assert_allclose(sensors.speed, speed, rtol=0.35)
    said = sensors.sentence(["a", "b"])
    assert re.search(r"speeds count more above \[Hz\] a [\d.]+, b [\d.]+$", said)
    crossover = speed / (2 * np.pi * step / np.sqrt(12))
    np.testing.assert_allclose(sensors.crossover_hz, crossover, rtol=0.4)
    assert (error(found) < 1.1 * np.minimum(error(q), error(np.cumsum(dq, axis=0) / FAST))).all()


def test_speeds_that_are_perfect_change_nothing_but_noise() -> None:
    found, _ = smoothed(TIME, Q, DQ, BAND)
    np.testing.assert_allclose(found, Q, atol=1e-7)
    noisy = smoothed(TIME, Q, DQ + np.random.default_rng(0).standard_normal(Q.shape), BAND)[1]
    assert noisy.sentence(["a", "b"]).endswith(": positions count more at every frequency at a, b")
    assert smoothed(TIME, Q, None, BAND)[0] is Q


@pytest.mark.parametrize("kind", ["scaled", "late", "filtered", "wrong", "still"])
def test_speeds_that_are_not_those_of_the_motion_do_no_harm(kind: str) -> None:
    """Gain, offset and delay are calibrated; what is left of the motion counts as noise."""
    rng = np.random.default_rng(0)
    q = Q + 1e-5 * rng.standard_normal(Q.shape)
    fine = 1e-3 * rng.standard_normal(Q.shape)
    last = np.exp(-2 * np.pi * 5.0 / FAST)  # a controller's filter of 5 Hz
    filtered, _ = scipy.signal.lfilter([1 - last], [1, -last], DQ, axis=0, zi=last * DQ[:1])
    speeds = {
        "scaled": 57.3 * DQ + 0.2 + fine,
        "late": np.roll(DQ, 3, axis=0) + fine,
        "filtered": filtered + fine,
        "wrong": DQ[:, ::-1] + fine,
        "still": fine,
    }
    found, _ = smoothed(TIME, q, speeds[kind], BAND)
    assert (error(found) < 1.05 * error(q) + 1e-3).all()


@pytest.mark.parametrize(("kind", "calibrated"), [("scaled", 1.01), ("late", 2.0)])
def test_gain_offset_and_delay_of_speeds_cost_little(kind: str, calibrated: float) -> None:
    """Coarse positions gain as much from speeds in other units, or late, as from true ones.

    A delay is calibrated to first order.
    """
    rng, step = np.random.default_rng(0), 2 * np.pi / 2**12
    q, fine = step * np.round(Q / step), 1e-3 * rng.standard_normal(Q.shape)
    late = scipy.interpolate.make_interp_spline(TIME, DQ)(TIME - 0.004)
    speeds = {"scaled": 57.3 * (DQ + fine) + 0.2, "late": late + fine}
    found, true = (smoothed(TIME, q, dq, BAND)[0] for dq in (speeds[kind], DQ + fine))
    assert (error(true) < 0.1 * error(q)).all()
    assert (error(found) < calibrated * error(true)).all()


def test_steps_are_those_of_a_lattice_only() -> None:
    x = np.sin(TIME)
    assert resolution(np.round(x, 3)) == pytest.approx(1e-3)
    assert resolution(x) == 0 == resolution(np.ones(100))
