"""Filter and spectra against SciPy's; positions and speeds weighed by their noise."""

from __future__ import annotations

import re

import numpy as np
import pytest
import scipy

from excitant.identify.signals import (
    detrended,
    differentiated,
    live,
    low_pass,
    power_density,
    resolution,
    smoothed,
)

LOW_RATE = 250.0
SIZES = [64, 65, 1000, 5003]


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


def test_the_filter_is_linear_passes_lines_and_keeps_shapes() -> None:
    x, y = walk(501), walk(501)[::-1]
    assert low_pass(np.zeros((0, 3, 2)), 10.0, LOW_RATE).shape == (0, 3, 2)
    both = low_pass(2 * x - 3 * y, 10.0, LOW_RATE)
    np.testing.assert_allclose(
        both, 2 * low_pass(x, 10.0, LOW_RATE) - 3 * low_pass(y, 10.0, LOW_RATE)
    )
    line = np.linspace(-3.0, 9.0, 400)
    np.testing.assert_allclose(low_pass(line, 10.0, LOW_RATE), line, atol=1e-12)
    for shape in [(1, 2), (2,), (7,), (30, 2, 3)]:
        np.testing.assert_allclose(low_pass(np.ones(shape), 10.0, LOW_RATE), np.ones(shape))


def test_a_constant_stays_exactly_constant_for_a_dead_channel_is_known_by_that() -> None:
    passed = low_pass(np.full((999, 2), 3.7), 10.0, LOW_RATE, slice(30, 960, 7))
    np.testing.assert_array_equal(passed, np.full((133, 2), 3.7))


def test_columns_are_live_by_their_only_row_that_is_not_zero() -> None:
    values = np.zeros((500, 3, 400))
    for column in range(1, 400):
        values[column, column % 3, column] = [1e-300, np.nan, -np.inf][column % 3]
    np.testing.assert_array_equal(live(values), values.any(axis=0))
    assert live(np.zeros((0, 2))).tolist() == [False, False]


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("longest", [64, 255, 10_000])
def test_the_density_is_welchs(n: int, longest: int) -> None:
    x = walk(n)
    f, expected = scipy.signal.welch(x, LOW_RATE, nperseg=min(longest, n), axis=0)
    found = power_density(x, LOW_RATE, longest)
    np.testing.assert_allclose(found[0], f)
    np.testing.assert_allclose(found[1], expected, rtol=1e-9, atol=1e-14 * expected.max())


def test_a_line_is_taken_out() -> None:
    x = walk(77)
    np.testing.assert_allclose(detrended(x), scipy.signal.detrend(x, axis=0), atol=1e-12)


RATE, BAND = 500.0, 20.0
T = np.arange(0, 20, 1 / RATE)
INNER = slice(200, -200)


def motion() -> tuple[np.ndarray, ...]:
    w = 2 * np.pi * np.array([0.3, 1.1])
    amplitude, phase = np.array([[1.0, 0.4], [0.6, 0.7]]), np.array([0.3, 1.0])
    waves = [
        amplitude @ (w**k * np.sin(np.outer(T, w) + phase + k * np.pi / 2)).T for k in range(3)
    ]
    return tuple(each.T for each in waves)


Q, DQ, DDQ = motion()


def error(q: np.ndarray) -> np.ndarray:
    """Rms error of acceleration, shape (nv,)."""
    return np.sqrt(((differentiated(T, q, BAND).ddq - DDQ)[INNER] ** 2).mean(axis=0))


@pytest.mark.parametrize(("bits", "speed"), [(10, 0.02), (12, 0.01), (14, 0.01), (16, 0.001)])
def test_noise_is_found_and_what_is_fused_beats_either(bits: int, speed: float) -> None:
    step, rng = 2 * np.pi / 2**bits, np.random.default_rng(bits)
    q, dq = step * np.round(Q / step), DQ + speed * rng.standard_normal(DQ.shape)
    found, sensors = smoothed(T, q, dq, BAND)
    # 400 bins of the band, and the white floor of a third of all
    np.testing.assert_allclose(sensors.step, step, rtol=1e-6)
    np.testing.assert_allclose(sensors.position, step / np.sqrt(12), rtol=0.35)
    np.testing.assert_allclose(sensors.speed, speed, rtol=0.35)
    said = sensors.sentence(["a", "b"])
    assert re.search(r"speeds count more above \[Hz\] a [\d.]+, b [\d.]+$", said)
    crossover = speed / (2 * np.pi * step / np.sqrt(12))
    np.testing.assert_allclose(sensors.crossover_hz, crossover, rtol=0.4)
    way = np.cumsum(dq, axis=0) / RATE
    assert (error(found) < 1.1 * np.minimum(error(q), error(way))).all()


def test_speeds_that_are_perfect_change_nothing_but_noise() -> None:
    found, _ = smoothed(T, Q, DQ, BAND)
    np.testing.assert_allclose(found, Q, atol=1e-7)
    noisy = smoothed(T, Q, DQ + np.random.default_rng(0).standard_normal(Q.shape), BAND)[1]
    assert noisy.sentence(["a", "b"]).endswith(": positions count more at every frequency at a, b")
    assert smoothed(T, Q, None, BAND)[0] is Q


@pytest.mark.parametrize("kind", ["scaled", "late", "filtered", "wrong", "still"])
def test_speeds_that_are_not_those_of_the_motion_do_no_harm(kind: str) -> None:
    """Gain, offset and delay are calibrated; what is left of the motion counts as noise."""
    rng = np.random.default_rng(0)
    q = Q + 1e-5 * rng.standard_normal(Q.shape)
    fine = 1e-3 * rng.standard_normal(Q.shape)
    first = 1 - np.exp(-2 * np.pi * 5.0 / RATE)  # a controller's filter of 5 Hz
    filtered = np.array(DQ)
    for k in range(1, len(T)):
        filtered[k] = filtered[k - 1] + first * (DQ[k] - filtered[k - 1])
    speeds = {
        "scaled": 57.3 * DQ + 0.2 + fine,
        "late": np.roll(DQ, 3, axis=0) + fine,
        "filtered": filtered + fine,
        "wrong": DQ[:, ::-1] + fine,
        "still": fine,
    }
    found, _ = smoothed(T, q, speeds[kind], BAND)
    assert (error(found) < 1.05 * error(q) + 1e-3).all()


@pytest.mark.parametrize(("kind", "calibrated"), [("scaled", 1.01), ("late", 2.0)])
def test_gain_offset_and_delay_of_speeds_cost_little(kind: str, calibrated: float) -> None:
    """Coarse positions gain as much from speeds in other units, or late, as from true ones.

    A delay is calibrated to first order.
    """
    rng, step = np.random.default_rng(0), 2 * np.pi / 2**12
    q, fine = step * np.round(Q / step), 1e-3 * rng.standard_normal(Q.shape)
    late = scipy.interpolate.make_interp_spline(T, DQ)(T - 0.004)
    speeds = {"scaled": 57.3 * (DQ + fine) + 0.2, "late": late + fine}
    found, true = (smoothed(T, q, dq, BAND)[0] for dq in (speeds[kind], DQ + fine))
    assert (error(true) < 0.1 * error(q)).all()
    assert (error(found) < calibrated * error(true)).all()


def test_steps_are_those_of_a_lattice_only() -> None:
    x = np.sin(T)
    assert resolution(np.round(x, 3)) == pytest.approx(1e-3)
    assert resolution(x) == 0 == resolution(np.ones(100))
