"""Figures as data: thinned curves show the same, pages hold what the figure does."""

import json
from base64 import b64decode

import numpy as np
import pytest

from excitant.reports.charts import packed
from excitant.reports.figure import Axes, Axis, Band, Figure, Line, Panel, Points, Timeline, thinned
from excitant.reports.values import condition, number, percent, sentence, shorten, value_and_std


@pytest.mark.parametrize("n", [1, 50, 401, 5000, 12345])
def test_thinned_curve_keeps_ends_and_extremes(n):
    rng = np.random.default_rng(n)
    x, y = np.arange(n, dtype=float), rng.normal(size=n)
    short = thinned(Line(x, y, "fitted"), 200)
    short_x, short_y = short.x, short.y
    assert len(short_y) <= min(n, 402)
    assert (np.diff(short_x) > 0).all()
    found = (short_x[0], short_x[-1], short_y.min(), short_y.max())
    assert found == (0, n - 1, y.min(), y.max())
    np.testing.assert_array_equal(y[short_x.astype(int)], short_y)


def test_gap_stays_a_gap():
    y = np.sin(np.arange(9000.0))
    y[3000:6000] = np.nan
    curve = thinned(Line(np.arange(9000.0), y, "fitted"), 200)
    assert np.isnan(curve.y[(curve.x > 3100) & (curve.x < 5900)]).all()
    assert np.isfinite(curve.y[(curve.x < 3000) | (curve.x >= 6000)]).all()


def test_time_of_joined_recordings_grows_and_since_the_epoch_starts_at_zero():
    t = np.concatenate([14 + np.arange(5) * 0.1, 3 + np.arange(4) * 0.1])
    joined = Timeline.of(t)
    assert joined.joins == (5,)
    np.testing.assert_allclose(np.delete(joined.t, 5), 14 + np.arange(9) * 0.1)
    broken = joined.broken(np.arange(9.0))
    assert np.flatnonzero(np.isnan(broken)).tolist() == [5]
    np.testing.assert_array_equal(np.delete(broken, 5), np.arange(9))
    np.testing.assert_allclose(Timeline.of(1.7e9 + np.arange(3.0)).t, [0, 1, 2])


def unpacked(array):
    """Numbers as the page's script reads them."""
    k = np.frombuffer(b64decode(array["k"]), "<i2").astype(float)
    return np.where(k == -32768, np.nan, array["low"] + array["step"] * (k + 32767))


def figure_of(*marks):
    return Figure((Panel((Axes(marks, Axis(), Axis()),), "label"),), "caption")


def test_curves_in_a_page_are_those_of_the_figure_and_shared_arrays_are_in_it_once():
    t = np.linspace(0, 10, 5000)
    y = np.sin(t)
    y[1000:1100] = np.nan
    content = json.loads(packed(figure_of(Line(t, y, "fitted", "<b>"), Line(t, -y, "given"))))
    first, second = content["panels"][0]["axes"][0]["marks"]
    assert (first["x"], first["name"], len(content["arrays"])) == (second["x"], "<b>", 3)
    np.testing.assert_allclose(unpacked(content["arrays"][first["y"]]), y, atol=2 / 65534)
    np.testing.assert_allclose(unpacked(content["arrays"][first["x"]]), t, atol=10 / 65534)


def test_long_curves_and_bands_lose_points_but_no_edge():
    rng = np.random.default_rng(0)
    t = np.arange(300_000.0)
    y = rng.normal(size=len(t))
    text = packed(figure_of(Line(t, y, "fitted"), Band(t, y - 1, y + 1)))
    assert len(text) < 2_000_000
    content = json.loads(text)
    line, band = content["panels"][0]["axes"][0]["marks"]
    arrays = [unpacked(array) for array in content["arrays"]]
    low, high = arrays[band["low"]].min() + 1, arrays[band["high"]].max() - 1
    drawn = [arrays[line["y"]].min(), arrays[line["y"]].max(), low, high]
    assert drawn == pytest.approx([y.min(), y.max()] * 2)


def test_axes_end_beyond_their_marks_and_logarithmic_ones_stay_positive():
    points = Points(np.arange(4.0), np.array([0.0, np.nan, 1e-3, 10.0]), "fitted")
    linear, empty = Axes((points,), Axis("", 0.0), Axis()), Axes((), Axis(), Axis())
    assert linear.ends("x")[0] == 0
    low, high = linear.ends("y")
    assert low < 0 < 10 < high < 11
    low, high = Axes((points,), Axis(), Axis(log=True)).ends("y")
    assert 0 < low < 1e-3 < 10 < high
    assert np.diff(empty.ends("x")) > 0


@pytest.mark.parametrize(
    ("found", "written"),
    [
        (number(None), "–"),
        (number(float("nan")), "–"),
        (number(True), "–"),
        (condition(12.76), "12.8"),
        (condition(3e14), "above 1.00×10⁸, so that not all parameters are shown"),
        (number(0), "0"),
        (number(1234.5), "1234"),
        (number(-0.012345), "−0.0123"),
        (number(9.996), "10.0"),
        (number(1.5e-7), "1.50×10⁻⁷"),
        (number(-2e12), "−2.00×10¹²"),
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
def test_numbers_of_three_digits_shares_names_and_sentences_are_set_in_type(found, written):
    assert found == written
