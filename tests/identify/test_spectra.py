"""The filter and the power density against those of SciPy's signal package."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal

from excitant.identify.signals import detrended, live, low_pass, power_density

RATE = 250.0
SIZES = [64, 65, 1000, 5003]


def noise(n: int) -> np.ndarray:
    return np.cumsum(np.random.default_rng(n).normal(size=(n, 3)), axis=0)


@pytest.mark.parametrize(("n", "cutoff"), [(5003, 2.0), (20_000, 0.5)])
def test_the_filter_is_that_of_sections_forward_and_backward(n: int, cutoff: float) -> None:
    """Far below the sampling rate, where sections are those of the analogue filter."""
    x, sections = noise(n), scipy.signal.butter(4, cutoff, fs=RATE, output="sos")
    expected = scipy.signal.sosfiltfilt(sections, x, axis=0, padlen=int(6 * RATE / cutoff))
    warped = (np.pi * cutoff / RATE) ** 2  # relative error of tan x / x, some times over
    np.testing.assert_allclose(low_pass(x, cutoff, RATE), expected, atol=warped * np.ptp(x))


@pytest.mark.parametrize("rate", [50.0, 125.0, 1000.0])
@pytest.mark.parametrize("f", [1.0, 7.0, 10.0, 16.0])
def test_the_gain_is_that_of_the_analogue_filter_at_every_rate(rate: float, f: float) -> None:
    wave = np.sin(2 * np.pi * f * np.arange(int(20 * rate)) / rate)
    poles = scipy.signal.butter(4, 2 * np.pi * 10.0, analog=True)
    [gain] = np.abs(scipy.signal.freqs(*poles, [2 * np.pi * f])[1]) ** 2
    middle = slice(len(wave) // 3, -(len(wave) // 3))
    np.testing.assert_allclose(low_pass(wave, 10.0, rate)[middle], gain * wave[middle], atol=1e-7)


def test_the_filter_is_linear_passes_lines_and_keeps_shapes() -> None:
    x, y = noise(501), noise(501)[::-1]
    assert low_pass(np.zeros((0, 3, 2)), 10.0, RATE).shape == (0, 3, 2)
    both = low_pass(2 * x - 3 * y, 10.0, RATE)
    np.testing.assert_allclose(both, 2 * low_pass(x, 10.0, RATE) - 3 * low_pass(y, 10.0, RATE))
    line = np.linspace(-3.0, 9.0, 400)
    np.testing.assert_allclose(low_pass(line, 10.0, RATE), line, atol=1e-12)
    for shape in [(1, 2), (2,), (7,), (30, 2, 3)]:
        np.testing.assert_allclose(low_pass(np.ones(shape), 10.0, RATE), np.ones(shape))


def test_a_constant_stays_exactly_constant_for_a_dead_channel_is_known_by_that() -> None:
    passed = low_pass(np.full((999, 2), 3.7), 10.0, RATE, slice(30, 960, 7))
    np.testing.assert_array_equal(passed, np.full((133, 2), 3.7))


def test_columns_are_live_by_their_only_row_that_is_not_zero() -> None:
    values = np.zeros((500, 3, 400))
    for column in range(1, 400):
        values[column, column % 3, column] = [1e-300, np.nan, -np.inf][column % 3]
    np.testing.assert_array_equal(live(values), values.any(axis=0))
    assert live(np.zeros((0, 2))).tolist() == [False, False]


def test_half_of_a_sine_at_the_cut_off_passes() -> None:
    t = np.arange(2000) / RATE
    passed = low_pass(np.sin(2 * np.pi * 10.0 * t), 10.0, RATE)[500:-500]
    assert np.abs(passed).max() == pytest.approx(0.5, rel=3e-3)


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("longest", [64, 255, 10_000])
def test_the_density_is_welchs(n: int, longest: int) -> None:
    x = noise(n)
    f, expected = scipy.signal.welch(x, RATE, nperseg=min(longest, n), axis=0)
    found = power_density(x, RATE, longest)
    np.testing.assert_allclose(found[0], f)
    np.testing.assert_allclose(found[1], expected, rtol=1e-9, atol=1e-14 * expected.max())


def test_a_line_is_taken_out() -> None:
    x = noise(77)
    np.testing.assert_allclose(detrended(x), scipy.signal.detrend(x, axis=0), atol=1e-12)
