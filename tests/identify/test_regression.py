"""What a regression says from products and triangles is what its rows say."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from excitant.exceptions import BadInput
from excitant.identify import Recording
from excitant.identify.preprocessing import prepare
from excitant.identify.regression import Regression, dense, joined, regression_of
from excitant.robots import load_robot
from excitant.robots.effects import standard_effects
from excitant.robots.torque import observation_columns

N, NV, P = 60, 3, 5
NAMES = tuple("abcde")


def arrays(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Columns, some of which act on some joints only, and torque."""
    rng = np.random.default_rng(seed)
    W = rng.standard_normal((N, NV, P)) * (rng.random((NV, P)) < 0.7)
    return W, rng.standard_normal((N, NV))


@pytest.fixture
def problem() -> Regression:
    return dense(*arrays(), NAMES)


def test_rows_come_back(problem: Regression) -> None:
    W, tau = arrays()
    np.testing.assert_array_equal(problem.W, W)
    x = np.arange(P, dtype=float)
    np.testing.assert_allclose(problem.residual(x), tau - W @ x)
    assert all((W[:, j, own] != 0).any() for j, own in enumerate(problem.index))


def test_products_are_those_of_the_rows(problem: Regression) -> None:
    (W, tau), weight = arrays(), np.array([1.0, 2.0, 0.5])
    A = np.concatenate([W, tau[:, :, None]], axis=2) * np.sqrt(weight)[:, None]
    flat = A.reshape(-1, P + 1)
    np.testing.assert_allclose(problem.gram(weight), flat.T @ flat, atol=1e-12)


def test_the_factor_gives_the_misfit(problem: Regression) -> None:
    W, tau = arrays()
    weight, rng = np.array([1.0, 2.0, 0.5]), np.random.default_rng(1)
    R, z = problem.factor(weight)
    differences = [
        (((tau - W @ x) * weight) ** 2).sum() - ((R @ x - z) ** 2).sum()
        for x in rng.standard_normal((3, P))
    ]
    np.testing.assert_allclose(differences, 0, atol=1e-10)


def test_other_problems_are_those_of_other_rows_and_columns(problem: Regression) -> None:
    W, tau = arrays()
    np.testing.assert_array_equal(problem.select([3, 0]).W, W[:, :, [3, 0]])
    assert problem.select([3, 0]).names == ("d", "a")
    more = arrays(2)[0][:, :, :2]
    wider = problem.with_columns(more, ["f", "g"])
    np.testing.assert_array_equal(wider.W, np.concatenate([W, more], axis=2))
    rows = np.random.default_rng(3).random((N, NV)) < 0.5
    counted = problem.counting(rows)
    np.testing.assert_array_equal(counted.W, W * rows[:, :, None])
    np.testing.assert_array_equal(counted.tau, tau * rows)
    thin = problem.at(slice(None, None, 4))
    np.testing.assert_array_equal(thin.W, W[::4])
    both = joined([problem, dense(*arrays(4), NAMES)])
    np.testing.assert_array_equal(both.W, np.concatenate([W, arrays(4)[0]]))


def test_an_arm_has_the_filtered_columns_of_its_segments(exact: Callable[..., Recording]) -> None:
    robot = load_robot("planar_2r")
    effects, segments = standard_effects(robot.joints), prepare(exact(robot, np.arange(0, 6, 0.01)))
    found = regression_of(robot, effects, segments * 2)
    W = segments[0].rows(lambda motion: observation_columns(robot, effects, motion))
    np.testing.assert_array_equal(found.W, np.concatenate([W, W]))
    assert found.names[:2] == ("link1.m", "link1.mcx")


def test_what_does_not_fit_is_refused() -> None:
    W, tau = arrays()
    for given, why in (
        ((W, tau[:-1], NAMES), "shape"),
        ((W, tau, NAMES[1:]), "4 names"),
        ((W, np.where(tau == tau.max(), np.nan, tau), NAMES), "finite"),
    ):
        with pytest.raises(BadInput, match=why):
            dense(*given)
