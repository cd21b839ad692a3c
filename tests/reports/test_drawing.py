"""Curves with fewer points show the same, and times of joined recordings do not run back."""

import numpy as np
import pytest

from excitant.reports.drawing import thin, timeline
from excitant.reports.values import number, percent, sentence, shorten, value_and_std


@pytest.mark.parametrize("n", [1, 50, 401, 5000, 12345])
def test_thinned_curve_keeps_ends_and_extremes(n):
    rng = np.random.default_rng(n)
    x, y = np.arange(n, dtype=float), rng.normal(size=n)
    short_x, short_y = thin(x, y, 200)
    assert len(short_y) <= min(n, 402)
    assert (np.diff(short_x) > 0).all()
    assert (short_x[0], short_x[-1]) == (0, n - 1)
    assert (short_y.min(), short_y.max()) == (y.min(), y.max())
    np.testing.assert_array_equal(y[short_x.astype(int)], short_y)


def test_gap_stays_a_gap():
    y = np.sin(np.arange(9000.0))
    y[3000:6000] = np.nan
    x, short = thin(np.arange(9000.0), y)
    assert np.isnan(short[(x > 3100) & (x < 5900)]).all()
    assert np.isfinite(short[(x < 3000) | (x >= 6000)]).all()


def test_time_of_joined_recordings_grows_and_since_the_epoch_starts_at_zero():
    t = np.concatenate([14 + np.arange(5) * 0.1, 3 + np.arange(4) * 0.1])
    for given, shown, joins in (
        (t, 14 + np.arange(9) * 0.1, [5]),
        (1.7e9 + np.arange(3.0), [0, 1, 2], []),
    ):
        time, found = timeline(given)
        np.testing.assert_allclose(time, shown)
        assert found == joins


@pytest.mark.parametrize(
    ("value", "written"),
    [
        (None, "–"),
        (float("nan"), "–"),
        (True, "–"),
        (0, "0"),
        (1234.5, "1234"),
        (-0.012345, "−0.0123"),
        (9.996, "10.0"),
        (1.5e-7, "1.50×10⁻⁷"),
        (-2e12, "−2.00×10¹²"),
    ],
)
def test_numbers_have_three_digits(value, written):
    assert number(value) == written


@pytest.mark.parametrize(
    ("found", "written"),
    [
        (value_and_std(12.34567, 0.0123), ("12.346", "0.012")),  # the decimals of the std
        (value_and_std(-1234.5, 56), ("−1234", "56")),
        (value_and_std(1.5, None), ("1.500", "–")),
        (percent(0.0731), "7.3\u00a0%"),
        (percent(2.341), "234\u00a0%"),
        (percent(50), ">\u00a0999\u00a0%"),
        (shorten("a_long_name", 11), "a_long_name"),
        (shorten("a_very_long_name", 9), "a_ve…name"),
        (sentence("mean square error -0.4 ± 6.8 %"), "Mean square error −0.4 ± 6.8 %."),
        (sentence("known to ±2.8e+02 mm only"), "Known to ±2.8×10² mm only."),
        (sentence("noise of 1.4e-05!"), "Noise of 1.4×10⁻⁵!"),
        (sentence("run separate-1.csv"), "Run separate-1.csv."),
        (sentence("wrist_1_joint rests"), "wrist_1_joint rests."),
        (sentence(""), ""),
    ],
)
def test_values_shares_names_and_sentences_are_set_in_type(found, written):
    assert found == written
