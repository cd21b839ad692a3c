"""What a regression says from products and triangles is what its rows say."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from excitant.exceptions import BadInput
from excitant.identify import Recording
from excitant.identify.preprocessing import prepare
from excitant.identify.regression import dense, joined, regression_of
from excitant.robots import Robot
from excitant.robots.effects import standard_effects
from excitant.robots.torque import observation_columns

N, NV, P = 60, 3, 5
NAMES = tuple("abcde")


def arrays(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Columns, some of which act on some joints only, and torque."""
    rng = np.random.default_rng(seed)
    W = rng.standard_normal((N, NV, P)) * (rng.random((NV, P)) < 0.7)
    return W, rng.standard_normal((N, NV))


W, TAU = arrays()
PROBLEM = dense(W, TAU, NAMES)


def test_rows_come_back() -> None:
    np.testing.assert_array_equal(PROBLEM.W, W)
    x = np.arange(P, dtype=float)
    np.testing.assert_allclose(PROBLEM.residual(x), TAU - W @ x)
    assert all((W[:, j, own] != 0).any() for j, own in enumerate(PROBLEM.index))


def test_products_and_triangles_are_those_of_the_rows() -> None:
    weight = np.array([1.0, 2.0, 0.5])
    A = np.concatenate([W, TAU[:, :, None]], axis=2) * weight[:, None]
    products = np.einsum("njp,njq->pq", A, A)
    np.testing.assert_allclose(PROBLEM.gram(weight**2), products, atol=1e-12)
    factor = np.column_stack(PROBLEM.factor(weight))
    np.testing.assert_allclose(factor.T @ factor, products, atol=1e-10)


def test_other_problems_are_those_of_other_rows_and_columns() -> None:
    more, other = arrays(2)[0][:, :, :2], arrays(4)[0]
    count = np.random.default_rng(3).random((N, NV)) < 0.5
    few, counted = PROBLEM.select([3, 0]), PROBLEM.counting(count)
    for problem, rows in (
        (few, W[:, :, [3, 0]]),
        (PROBLEM.with_columns(more, ["f", "g"]), np.concatenate([W, more], axis=2)),
        (counted, W * count[:, :, None]),
        (PROBLEM.at(slice(None, None, 4)), W[::4]),
        (joined([PROBLEM, dense(other, TAU, NAMES)]), np.concatenate([W, other])),
    ):
        np.testing.assert_array_equal(problem.W, rows)
    assert few.names == ("d", "a")
    np.testing.assert_array_equal(counted.tau, TAU * count)


def test_an_arm_has_the_filtered_columns_of_its_segments(
    planar: Robot, exact: Callable[..., Recording]
) -> None:
    effects, segments = (
        standard_effects(planar.joints),
        prepare(exact(planar, np.arange(600) / 100)),
    )
    found = regression_of(planar, effects, segments * 2)
    columns = segments[0].rows(lambda motion: observation_columns(planar, effects, motion))
    np.testing.assert_array_equal(found.W, np.concatenate([columns, columns]))
    assert found.names[:2] == ("link1.m", "link1.mcx")


@pytest.mark.parametrize(
    ("tau", "names", "why"),
    [
        (TAU[:-1], NAMES, "shape"),
        (TAU, NAMES[1:], "4 names"),
        (np.where(TAU > TAU.max() - 1e-9, np.nan, TAU), NAMES, "finite"),
    ],
)
def test_what_does_not_fit_is_refused(tau: np.ndarray, names: tuple[str, ...], why: str) -> None:
    with pytest.raises(BadInput, match=why):
        dense(W, tau, names)
