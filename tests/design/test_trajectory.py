"""Laws of Fourier series, B-splines and interpolated samples as functions of time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from excitant.design import FourierTrajectory, HermiteTrajectory, Trajectory
from excitant.design.trajectory import FourierSeries, Series, SplineSeries

KINDS = st.sampled_from(["fourier", "spline"])


def series_of(kind: str, terms: int, period: float) -> Series:
    return FourierSeries(period, terms) if kind == "fourier" else SplineSeries(period, 2 * terms)


def drawn(series: Series, seed: int, rest: bool = True, nv: int = 2) -> Trajectory:
    X = np.random.default_rng(seed).normal(size=(series.size, nv))
    return series.trajectory(series.rest @ (series.rest.T @ X) if rest else X)


@settings(max_examples=40, deadline=None)
@given(KINDS, st.integers(0, 10**6), st.integers(3, 12), st.floats(0.5, 60.0), st.integers(0, 3))
def test_derivatives_agree_with_finite_differences_and_the_motion_closes(
    kind: str, seed: int, terms: int, period: float, order: int
) -> None:
    trajectory = drawn(series_of(kind, terms, period), seed, rest=False)
    t, w = np.linspace(0.01, 0.99, 23) * period, 2 * np.pi * terms / period
    h = 1e-5 / w
    difference = (trajectory(t + h, order) - trajectory(t - h, order)) / (2 * h)
    size = w ** (order + 1) * np.abs(trajectory.coefficients).sum()
    # the fourth derivative of a quintic spline bends at its knots
    atol = 1e-9 if kind == "fourier" else 1e-5
    assert np.allclose(difference, trajectory(t, order + 1), rtol=0, atol=atol * size)
    np.testing.assert_allclose(
        trajectory(0.0, order), trajectory(period, order), rtol=0, atol=1e-9 * size
    )


@settings(max_examples=40, deadline=None)
@given(KINDS, st.integers(0, 10**6), st.integers(3, 24), st.floats(0.5, 60.0))
def test_at_rest_at_both_ends(kind: str, seed: int, terms: int, period: float) -> None:
    series = series_of(kind, terms, period)
    trajectory = drawn(series, seed)
    assert trajectory.at_rest
    for order in (1, 2):
        size = np.abs(trajectory(np.linspace(0, period, 200), order)).max()
        assert np.abs(trajectory(np.array([0.0, period]), order)).max() < 1e-10 * size
    assert not drawn(series, seed, rest=False).at_rest
    standstill = series.trajectory(series.constant(np.array([0.3, -1.0])))
    assert standstill.at_rest
    np.testing.assert_allclose(standstill(0.3 * period), [[0.3, -1.0]])


@settings(max_examples=40, deadline=None)
@given(
    KINDS,
    st.integers(0, 10**6),
    st.integers(3, 20),
    st.floats(0.5, 60.0),
    st.integers(0, 3),
    st.booleans(),
)
def test_extrema_bound_dense_samples_tightly(
    kind: str, seed: int, terms: int, period: float, order: int, rest: bool
) -> None:
    trajectory = drawn(series_of(kind, terms, period), seed, rest)
    low, high = trajectory.extrema(order)
    n = 2000 * terms
    values = trajectory(np.linspace(0, period, n + 1), order)
    span = np.abs(values).max(axis=0)
    assert np.all(high >= values.max(axis=0) - 1e-12 * span)
    assert np.all(low <= values.min(axis=0) + 1e-12 * span)
    # by Bernstein's inequality a peak lies at most (pi H / n)^2 / 2 of the span above a sample
    gap = 2 * (np.pi * terms / n) ** 2 * span * (1 if kind == "fourier" else 20)
    assert np.all(high <= values.max(axis=0) + gap)
    assert np.all(low >= values.min(axis=0) - gap)


def test_extrema_of_a_standstill_and_of_missing_harmonics() -> None:
    cosine, sine = np.zeros((3, 2)), np.zeros((3, 2))
    sine[0, 1] = 0.7
    trajectory = FourierTrajectory([0.3, -1.0], cosine, sine, 4.0)
    low, high = trajectory.extrema()
    np.testing.assert_allclose(low, [0.3, -1.7], atol=1e-12)
    np.testing.assert_allclose(high, [0.3, -0.3], atol=1e-12)


def test_more_harmonics_hold_the_motion_exactly_and_more_pieces_nearly() -> None:
    trajectory, t = drawn(FourierSeries(4.0, 3), 0), np.linspace(0, 4, 101)
    more = FourierSeries(4.0, 5)
    np.testing.assert_allclose(more.trajectory(more.nearest(trajectory))(t), trajectory(t))
    errors = []
    for pieces in (12, 24):
        spline = SplineSeries(4.0, pieces)
        near = spline.trajectory(spline.nearest(trajectory))
        assert near.at_rest
        errors.append(np.abs(near(t) - trajectory(t)).max())
    assert errors[1] < min(errors[0] / 16, 0.01)


def test_motion_includes_both_ends_and_repeated_periods_join_smoothly() -> None:
    trajectory = drawn(FourierSeries(7.0, 4), 1)
    once, twice = trajectory.motion(100.0), trajectory.motion(100.0, 2)
    assert (len(once), once.t[0], once.t[-1]) == (701, 0.0, 7.0)
    np.testing.assert_array_equal(once.ddq, trajectory(once.t, 2))
    assert len(twice) == 2 * len(once) - 1
    np.testing.assert_allclose(np.diff(twice.t), 0.01)
    np.testing.assert_allclose(twice.q, trajectory(twice.t), atol=1e-12)


def test_refuses_coefficients_of_different_shape() -> None:
    with pytest.raises(ValueError, match="shapes differ"):
        FourierTrajectory(np.zeros(2), np.zeros((3, 2)), np.zeros((4, 2)), 1.0)
    with pytest.raises(ValueError, match="period"):
        FourierTrajectory(np.zeros(2), np.zeros((3, 2)), np.zeros((3, 2)), 0.0)
    with pytest.raises(ValueError, match="at least 6 are needed"):
        SplineSeries(1.0, 5)


def test_hermite_interpolant_reproduces_samples_and_converges() -> None:
    trajectory, t = drawn(FourierSeries(10.0, 4), 3), np.linspace(0, 10, 777)
    errors = []
    for rate in (20.0, 40.0):
        spline = HermiteTrajectory(trajectory.motion(rate))
        samples = spline.samples
        np.testing.assert_allclose(spline(samples.t, 2), samples.ddq, rtol=0, atol=1e-9)
        errors.append(np.abs(spline(t) - trajectory(t)).max())
    assert errors[1] < errors[0] / 40  # sixth order: 64
