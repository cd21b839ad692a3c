from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from excitant.design import FourierTrajectory, HermiteTrajectory
from excitant.design.trajectory import FourierSeries, from_coefficients


def random_series(
    seed: int, harmonics: int, nv: int, period: float, rest: bool
) -> FourierTrajectory:
    X = np.random.default_rng(seed).normal(size=(1 + 2 * harmonics, nv))
    if rest:
        Z = FourierSeries(period, harmonics).rest
        X = Z @ (Z.T @ X)
    return from_coefficients(X, period)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 12), st.floats(0.5, 60.0), st.integers(0, 3))
def test_derivatives_agree_with_finite_differences(
    seed: int, harmonics: int, period: float, order: int
) -> None:
    trajectory = random_series(seed, harmonics, 3, period, rest=False)
    t = np.linspace(0, period, 23)
    w = 2 * np.pi * harmonics / period
    h = 1e-5 / w
    difference = (trajectory(t + h, order) - trajectory(t - h, order)) / (2 * h)
    size = w ** (order + 1) * np.abs(trajectory.coefficients).sum()
    assert np.allclose(difference, trajectory(t, order + 1), rtol=0, atol=1e-9 * size)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 24), st.floats(0.5, 60.0))
def test_at_rest_at_both_ends(seed: int, harmonics: int, period: float) -> None:
    trajectory = random_series(seed, harmonics, 2, period, rest=True)
    assert trajectory.at_rest
    ends = np.array([0.0, period])
    for order in (1, 2):
        size = np.abs(trajectory(np.linspace(0, period, 200), order)).max()
        assert np.abs(trajectory(ends, order)).max() < 1e-10 * size
    assert not random_series(seed, harmonics, 2, period, rest=False).at_rest


@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 10**6),
    st.integers(1, 20),
    st.floats(0.5, 60.0),
    st.integers(0, 2),
    st.booleans(),
)
def test_extrema_bound_dense_samples_tightly(
    seed: int, harmonics: int, period: float, order: int, rest: bool
) -> None:
    trajectory = random_series(seed, harmonics, 2, period, rest and harmonics > 1)
    low, high = trajectory.extrema(order)
    n = 2000 * harmonics
    values = trajectory(np.linspace(0, period, n + 1), order)
    span = np.abs(values).max(axis=0)
    assert np.all(high >= values.max(axis=0) - 1e-12 * span)
    assert np.all(low <= values.min(axis=0) + 1e-12 * span)
    # by Bernstein's inequality a peak lies at most (pi H / n)^2 / 2 of the span above a sample
    gap = 2 * (np.pi * harmonics / n) ** 2 * span
    assert np.all(high <= values.max(axis=0) + gap)
    assert np.all(low >= values.min(axis=0) - gap)


def test_extrema_of_a_standstill_and_of_missing_harmonics() -> None:
    cosine, sine = np.zeros((3, 2)), np.zeros((3, 2))
    sine[0, 1] = 0.7
    trajectory = FourierTrajectory([0.3, -1.0], cosine, sine, 4.0)
    low, high = trajectory.extrema()
    np.testing.assert_allclose(low, [0.3, -1.7], atol=1e-12)
    np.testing.assert_allclose(high, [0.3, -0.3], atol=1e-12)


def test_motion_includes_both_ends_and_agrees_with_the_series() -> None:
    trajectory = random_series(1, 4, 3, 7.0, rest=True)
    motion = trajectory.motion(100.0)
    assert len(motion) == 701
    assert motion.t[0] == 0.0
    assert motion.t[-1] == 7.0
    np.testing.assert_array_equal(motion.ddq, trajectory(motion.t, 2))


def test_refuses_coefficients_of_different_shape() -> None:
    with pytest.raises(ValueError, match="shapes differ"):
        FourierTrajectory(np.zeros(2), np.zeros((3, 2)), np.zeros((4, 2)), 1.0)
    with pytest.raises(ValueError, match="period"):
        FourierTrajectory(np.zeros(2), np.zeros((3, 2)), np.zeros((3, 2)), 0.0)


def test_hermite_interpolant_reproduces_samples_and_converges() -> None:
    trajectory = random_series(3, 4, 2, 10.0, rest=True)
    t = np.linspace(0, 10, 777)
    errors = []
    for rate in (20.0, 40.0):
        spline = HermiteTrajectory(trajectory.motion(rate))
        np.testing.assert_allclose(
            spline(spline.samples.t, 2), spline.samples.ddq, rtol=0, atol=1e-9
        )
        errors.append(np.abs(spline(t) - trajectory(t)).max())
    assert errors[1] < errors[0] / 40  # sixth order: 64
