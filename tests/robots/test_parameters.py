"""Laws of the standard parameters, the pseudo-inertia and physical consistency."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from excitant.robots import load_robot
from excitant.robots.parameters import (
    from_pseudo_inertia,
    nearest_consistent,
    pseudo_inertia,
    violations,
)

Bodies = Callable[[int, int], np.ndarray]
Finite = st.floats(-10, 10, allow_subnormal=False)


def body(mass: float, moments: tuple[float, float, float], lever: tuple[float, ...]) -> np.ndarray:
    """Standard parameters from the principal moments about the centre of mass."""
    c = np.array(lever)
    inertia = np.diag(moments) + mass * (c @ c * np.eye(3) - np.outer(c, c))
    return np.array([mass, *(mass * c), *inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])


@given(phi=st.lists(Finite, min_size=10, max_size=10))
def test_pseudo_inertia_round_trip(phi: list[float]) -> None:
    P = pseudo_inertia(phi)
    assert np.array_equal(P, P.T)
    assert np.allclose(from_pseudo_inertia(P), phi, rtol=0, atol=1e-14 * max(1, *np.abs(phi)))


def test_pseudo_inertia_is_the_second_moment_of_the_mass() -> None:
    rng = np.random.default_rng(0)
    points, masses = rng.standard_normal((50, 3)), rng.uniform(0.1, 1, 50)
    inertia = sum(
        m * (x @ x * np.eye(3) - np.outer(x, x)) for m, x in zip(masses, points, strict=True)
    )
    first = masses @ points
    phi = [masses.sum(), *first, *inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]]
    homogeneous = np.column_stack([points, np.ones(50)])
    moments = (homogeneous * masses[:, None]).T @ homogeneous
    assert np.allclose(pseudo_inertia(phi), moments, rtol=1e-12)
    assert violations(phi, ("cloud",)) == []


@given(seed=st.integers(0, 2**32 - 1))
def test_consistent_exactly_when_the_pseudo_inertia_is_positive(seed: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((4, 4))
    P = root @ np.diag(rng.uniform(-0.2, 1, 4)) @ root.T
    positive = np.linalg.eigvalsh(P)[0] > 0
    assert (violations(from_pseudo_inertia(P), ("link",)) == []) == positive


@pytest.mark.parametrize(
    ("phi", "what"),
    [
        (body(-1.0, (1, 1, 1), (0.0, 0.0, 0.0)), "mass"),
        (body(0.0, (1, 1, 1), (0.0, 0.0, 0.0)), "mass"),
        (body(1.0, (1, 1, -0.1), (0.0, 0.0, 0.0)), "not positive"),
        (body(1.0, (1, 1, 2.1), (0.1, -0.2, 0.3)), "triangle"),
    ],
)
def test_violations_name_link_and_inequality(phi: np.ndarray, what: str) -> None:
    good = body(1.0, (1, 1, 1), (0.5, 0.0, 0.0))
    found = violations(np.concatenate([good, phi]), ("good", "bad"))
    assert len(found) == 1
    assert found[0].startswith("bad: ")
    assert what in found[0]


@given(seed=st.integers(0, 2**32 - 1))
def test_nearest_of_consistent_is_itself(random_bodies: Bodies, seed: int) -> None:
    phi = random_bodies(seed, 1)
    moments = np.linalg.eigvalsh(np.linalg.inv(np.linalg.inv(pseudo_inertia(phi))[:3, :3]))
    assume(moments[0] > 1e-4 * max(moments[-1], 1e-4 * phi[0]))
    assert np.array_equal(nearest_consistent(phi), phi)


@given(
    mass=st.floats(1e-3, 50),
    rest=st.lists(st.floats(-2, 2, allow_subnormal=False), min_size=9, max_size=9),
)
def test_nearest_is_consistent_and_keeps_mass_and_first_moment(
    mass: float, rest: list[float]
) -> None:
    phi = np.array([mass, *rest])
    lever = phi[1:4] / mass
    phi[4:] += mass * np.array([1.0, 0, 1, 0, 0, 1]) * (lever @ lever)
    nearest = nearest_consistent(phi)
    assert np.allclose(nearest[:4], phi[:4], rtol=1e-12)
    assert violations(nearest, ("link",)) == []
    assert np.allclose(nearest_consistent(nearest), nearest, rtol=1e-9, atol=1e-12)


def test_a_link_without_mass_keeps_its_parameters() -> None:
    """Robot with a last link without inertia: its own parameters give it back, without NaN."""
    robot = load_robot("planar_2r")
    phi = np.concatenate([robot.phi[:10], np.zeros(10)])
    assert np.array_equal(robot.with_parameters(phi).phi, phi)
