from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from excitant.design import (
    FourierTrajectory,
    SplineTrajectory,
    check,
    design,
    load_trajectory,
    trajectory_json,
)
from excitant.design.trajectory import FourierSeries, Series, SplineSeries
from excitant.exceptions import BadInput
from excitant.robots import Robot

Limited = Callable[..., Robot]


def drawn(series: Series, nv: int = 2, seed: int = 0) -> SplineTrajectory | FourierTrajectory:
    rng = np.random.default_rng(seed)
    X = series.rest @ rng.normal(size=(series.size - 2, nv))
    trajectory = series.trajectory(X)
    assert isinstance(trajectory, SplineTrajectory | FourierTrajectory)
    return trajectory


@pytest.mark.parametrize("pieces", [6, 13, 40])
def test_derivatives_are_those_of_the_motion_and_it_closes(pieces: int) -> None:
    trajectory = drawn(SplineSeries(3.0, pieces))
    assert trajectory.at_rest
    t, h = np.linspace(0.01, 2.99, 57), 1e-5
    for order in range(3):
        slope = (trajectory(t + h, order) - trajectory(t - h, order)) / (2 * h)
        scale = np.abs(trajectory(t, order + 1)).max()
        np.testing.assert_allclose(trajectory(t, order + 1), slope, atol=1e-5 * scale)
    for order in range(4):
        np.testing.assert_allclose(trajectory(0.0, order), trajectory(3.0, order), atol=1e-9)


@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_extrema_are_those_of_dense_samples(order: int) -> None:
    trajectory = drawn(SplineSeries(2.0, 17), seed=order)
    low, high = trajectory.extrema(order)
    values = trajectory(np.linspace(0, 2, 200_001), order)
    span = np.ptp(values, axis=0)
    np.testing.assert_allclose(low, values.min(axis=0), atol=1e-6 * span.max())
    np.testing.assert_allclose(high, values.max(axis=0), atol=1e-6 * span.max())
    assert np.all(low <= values.min(axis=0) + 1e-12)
    assert np.all(high >= values.max(axis=0) - 1e-12)


def test_more_harmonics_hold_the_motion_exactly_and_more_pieces_nearly() -> None:
    trajectory = drawn(FourierSeries(4.0, 3))
    t = np.linspace(0, 4, 101)
    more = FourierSeries(4.0, 5)
    np.testing.assert_allclose(more.trajectory(more.nearest(trajectory))(t), trajectory(t))
    errors = []
    for pieces in (12, 24):
        spline = SplineSeries(4.0, pieces)
        near = spline.trajectory(spline.nearest(trajectory))
        assert near.at_rest
        errors.append(np.abs(near(t) - trajectory(t)).max())
    assert errors[1] < errors[0] / 16
    assert errors[1] < 0.01


def test_json_is_read_back_exactly(planar: Robot, tmp_path: Path) -> None:
    trajectory = drawn(SplineSeries(3.0, 9))
    path = tmp_path / "trajectory.json"
    path.write_text(trajectory_json(trajectory, planar))
    loaded = load_trajectory(path, planar)
    assert isinstance(loaded, SplineTrajectory)
    np.testing.assert_array_equal(loaded.control_points, trajectory.coefficients)
    path.write_text('{"period": 2.0, "control_points": [[0, 0], [1, 1]]}')
    with pytest.raises(BadInput, match=r"trajectory\.json: .*at least 6 pieces"):
        load_trajectory(path, planar)


def test_a_spline_design_keeps_all_limits(planar: Robot, limited: Limited) -> None:
    robot = limited(planar, acceleration=8.0, jerk=15.0)
    found = design(robot, duration=6.0, harmonics=6, series="spline", starts=4, jobs=1)
    assert isinstance(found.trajectory, SplineTrajectory)
    assert found.trajectory.at_rest
    assert found.limits.hold
    assert found.condition_final < 0.5 * found.condition_initial
    fine = np.linspace(0, 6, 20_001)
    for order, limit in ((1, robot.limits.velocity), (2, 8.0), (3, 15.0)):
        assert np.all(np.abs(found.trajectory(fine, order)) <= np.asarray(limit) * (1 + 1e-9))
    assert found.limits.jerk is not None
    assert found.limits.jerk.ratio > 0.9


def test_repeated_periods_join_smoothly() -> None:
    trajectory = drawn(FourierSeries(2.0, 3))
    once, twice = trajectory.motion(100.0), trajectory.motion(100.0, 2)
    assert len(twice) == 2 * len(once) - 1
    np.testing.assert_allclose(np.diff(twice.t), 0.01)
    np.testing.assert_allclose(twice.q, trajectory(twice.t), atol=1e-12)


def test_check_accepts_a_spline(planar: Robot) -> None:
    trajectory = drawn(SplineSeries(20.0, 9))
    assert check(planar, trajectory).velocity.ratio == pytest.approx(
        (np.abs(trajectory(np.linspace(0, 20, 50_001), 1)) / planar.limits.velocity).max(), rel=1e-6
    )
