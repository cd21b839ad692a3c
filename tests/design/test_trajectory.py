"""Laws of Fourier series and interpolated samples as functions of time."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from excitant.design import HermiteTrajectory, Trajectory
from excitant.design.trajectory import FourierSeries

SEEDS, ORDERS, PERIODS = st.integers(0, 10**6), st.integers(0, 3), st.floats(0.5, 60.0)


def some(fewest: int, most: int) -> st.SearchStrategy[FourierSeries]:
    return st.builds(FourierSeries, PERIODS, st.integers(fewest, most))


def drawn(series: FourierSeries, seed: int, rest: bool = True) -> Trajectory:
    X = np.random.default_rng(seed).normal(size=(series.size, 2))
    return series.trajectory(series.rest @ (series.rest.T @ X) if rest else X)


@settings(max_examples=40, deadline=None)
@given(some(1, 12), SEEDS, ORDERS)
def test_derivatives_agree_with_finite_differences_and_the_motion_closes(series, seed, order):
    trajectory, period = drawn(series, seed, rest=False), series.period
    t, w = np.linspace(0.01, 0.99, 23) * period, 2 * np.pi * series.harmonics / period
    h = 1e-5 / w
    difference = (trajectory(t + h, order) - trajectory(t - h, order)) / (2 * h)
    size = w ** (order + 1) * np.abs(trajectory.coefficients).sum()
    assert np.allclose(difference, trajectory(t, order + 1), rtol=0, atol=1e-9 * size)
    start, end = trajectory([0.0, period], order)
    np.testing.assert_allclose(start, end, rtol=0, atol=1e-9 * size)


@settings(max_examples=40, deadline=None)
@given(some(2, 24), SEEDS)
def test_at_rest_at_both_ends(series: FourierSeries, seed: int) -> None:
    trajectory, period = drawn(series, seed), series.period
    assert trajectory.at_rest
    for order in (1, 2):
        size = np.abs(trajectory(np.linspace(0, period, 200), order)).max()
        assert np.abs(trajectory([0.0, period], order)).max() < 1e-10 * size
    assert not drawn(series, seed, rest=False).at_rest
    standstill = series.trajectory(series.constant(np.array([0.3, -1.0])))
    assert standstill.at_rest
    np.testing.assert_allclose(standstill(0.3 * period), [[0.3, -1.0]])


@settings(max_examples=40, deadline=None)
@given(some(1, 20), SEEDS, ORDERS, st.booleans())
def test_extrema_bound_dense_samples_tightly(
    series: FourierSeries, seed: int, order: int, rest: bool
):
    trajectory = drawn(series, seed, rest and series.size > 3)
    low, high = trajectory.extrema(order)
    n = 2000 * series.harmonics
    values = trajectory(np.linspace(0, series.period, n + 1), order)
    span = np.abs(values).max(axis=0)
    # by Bernstein's inequality a peak lies at most (pi H / n)^2 / 2 of the span above a sample
    gap = 2 * (np.pi * series.harmonics / n) ** 2 * span
    for beyond in (high - values.max(axis=0), values.min(axis=0) - low):
        assert np.all(beyond >= -1e-12 * span)
        assert np.all(beyond <= gap)


def test_extrema_of_a_standstill_and_of_missing_harmonics() -> None:
    X = np.zeros((7, 2))
    X[0], X[4, 1] = [0.3, -1.0], 0.7
    low, high = Trajectory(X, 4.0).extrema()
    np.testing.assert_allclose(low, [0.3, -1.7], atol=1e-12)
    np.testing.assert_allclose(high, [0.3, -0.3], atol=1e-12)


def test_more_harmonics_hold_the_motion_exactly() -> None:
    trajectory, t = drawn(FourierSeries(4.0, 3), 0), np.linspace(0, 4, 101)
    more = FourierSeries(4.0, 5)
    np.testing.assert_allclose(more.trajectory(more.nearest(trajectory))(t), trajectory(t))


def test_fewer_and_longer_periods_hold_the_same_motion() -> None:
    few, many = FourierSeries(2.0, 3, periods=6), FourierSeries(6.0, 9, periods=2)
    trajectory = drawn(few, 0)
    near = many.trajectory(many.nearest(trajectory))
    assert trajectory.duration == near.duration == 12.0
    one, other = trajectory.motion(100.0), near.motion(100.0)
    np.testing.assert_allclose(one.t, other.t, rtol=1e-12)
    np.testing.assert_allclose(one.q, other.q, atol=1e-12 * np.abs(one.q).max())
    slow = trajectory.slowed(0.5)
    assert (slow.duration, slow.period) == (24.0, 4.0)
    np.testing.assert_allclose(slow(2 * one.t, 1), one.dq / 2, atol=1e-9)


def test_motion_includes_both_ends_and_repeated_periods_join_smoothly() -> None:
    trajectory = drawn(FourierSeries(7.0, 4), 1)
    once, twice = trajectory.motion(100.0), trajectory.motion(100.0, 2)
    assert (len(once), once.t[0], once.t[-1]) == (701, 0.0, 7.0)
    np.testing.assert_array_equal(once.ddq, trajectory(once.t, 2))
    assert len(twice) == 2 * len(once) - 1
    np.testing.assert_allclose(np.diff(twice.t), 0.01)
    np.testing.assert_allclose(twice.q, trajectory(twice.t), atol=1e-12)
    thirds = drawn(FourierSeries(10.0 / 3, 4, periods=3), 1).motion(100.0)
    np.testing.assert_allclose(thirds.t, 0.01 * np.arange(1001))


def test_refuses_what_is_no_period() -> None:
    for period, periods, why in ((0.0, 1, "period"), (1.0, 0, "0 periods")):
        with pytest.raises(ValueError, match=why):
            FourierSeries(period, 3, periods=periods)


def test_hermite_interpolant_reproduces_samples_and_converges() -> None:
    trajectory, t = drawn(FourierSeries(10.0, 4), 3), np.linspace(0, 10, 777)
    errors = []
    for rate in (20.0, 40.0):
        spline = HermiteTrajectory(trajectory.motion(rate))
        samples = spline.samples
        np.testing.assert_allclose(spline(samples.t, 2), samples.ddq, rtol=0, atol=1e-9)
        errors.append(np.abs(spline(t) - trajectory(t)).max())
    assert errors[1] < errors[0] / 40  # sixth order: 64
