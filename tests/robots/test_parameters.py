"""Laws of the regressor, of standard and base parameters, and of physical consistency."""

import re
from dataclasses import replace
from unittest import mock

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from khosla import close
from known_arms import Call

from excitant.robots import Motion, Robot, base_parameters, rigid_body_torque
from excitant.robots.base_parameters import BaseParameters, categories, coefficient_text
from excitant.robots.effects import StribeckFriction, standard_effects
from excitant.robots.parameters import (
    from_pseudo_inertia,
    moved_parameters,
    nearest_consistent,
    pseudo_inertia,
    violations,
)
from excitant.robots.regressor import regressor, regressor_derivatives
from excitant.robots.torque import column_names, observation_columns

SEEDS = st.integers(0, 2**32 - 1)


def body(mass: float, moments: tuple[float, float, float], lever: tuple[float, ...]) -> np.ndarray:
    """Standard parameters from the principal moments about the centre of mass."""
    c = np.array(lever)
    inertia = np.diag(moments) + mass * (c @ c * np.eye(3) - np.outer(c, c))
    return np.array([mass, *(mass * c), *inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])


@given(phi=st.lists(st.floats(-10, 10, allow_subnormal=False), min_size=10, max_size=10))
def test_pseudo_inertia_round_trip(phi: list[float]) -> None:
    P = pseudo_inertia(phi)
    assert np.array_equal(P, P.T)
    assert np.allclose(from_pseudo_inertia(P), phi, rtol=0, atol=1e-14 * max(1, *np.abs(phi)))


def test_pseudo_inertia_is_the_second_moment_of_the_mass() -> None:
    """And parameters move as the points of the body do."""
    rng = np.random.default_rng(0)
    points, masses = rng.standard_normal((50, 3)), rng.uniform(0.1, 1, 50)

    def of_points(points: np.ndarray) -> np.ndarray:
        return sum(body(m, (0, 0, 0), x) for m, x in zip(masses, points, strict=True))

    phi, homogeneous = of_points(points), np.column_stack([points, np.ones(50)])
    moments = (homogeneous * masses[:, None]).T @ homogeneous
    assert np.allclose(pseudo_inertia(phi), moments, rtol=1e-12)
    assert violations(phi, ("cloud",)) == []
    T = pin.exp6(rng.uniform(-2, 2, 6)).homogeneous
    moved = of_points((homogeneous @ T.T)[:, :3])
    assert np.allclose(moved_parameters(phi, T), moved, rtol=1e-12, atol=1e-12)


@given(seed=SEEDS)
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
    (found,) = violations(np.concatenate([good, phi]), ("good", "bad"))
    assert re.match(f"bad: .*{what}", found)


@given(seed=SEEDS)
def test_nearest_of_consistent_is_itself(random_bodies: Call, seed: int) -> None:
    phi = random_bodies(seed, 1)
    moments = np.linalg.eigvalsh(np.linalg.inv(np.linalg.inv(pseudo_inertia(phi))[:3, :3]))
    assume(moments[0] > 1e-4 * max(moments[-1], 1e-4 * phi[0]))
    assert np.array_equal(nearest_consistent(phi), phi)


@given(
    mass=st.floats(1e-3, 50),
    rest=st.lists(st.floats(-2, 2, allow_subnormal=False), min_size=9, max_size=9),
)
def test_nearest_is_consistent_and_keeps_mass_and_first_moment(mass: float, rest: list) -> None:
    phi = np.array([mass, *rest])
    lever = phi[1:4] / mass
    phi[4:] += mass * np.array([1.0, 0, 1, 0, 0, 1]) * (lever @ lever)
    nearest = nearest_consistent(phi)
    assert np.allclose(nearest[:4], phi[:4], rtol=1e-12)
    assert violations(nearest, ("link",)) == []
    assert np.allclose(nearest_consistent(nearest), nearest, rtol=1e-9, atol=1e-12)


def test_a_link_without_mass_keeps_its_parameters(planar: Robot) -> None:
    phi = np.concatenate([planar.phi[:10], np.zeros(10)])
    assert np.array_equal(planar.with_parameters(phi).phi, phi)


RELATIVE = 1e-8
STENCIL = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}
"""Weights of the central difference of eighth order: error h⁸ f⁽⁹⁾ / 630 ≈ 1e-12 at h = 0.05."""


def finite_difference(robot: Robot, motion: Motion, by: str, joint: int) -> np.ndarray:
    step = 0.05 * np.eye(robot.nv)[joint]

    def moved(steps: int) -> np.ndarray:
        return regressor(robot, replace(motion, **{by: getattr(motion, by) + steps * step}))

    return sum(weight / 0.05 * (moved(k) - moved(-k)) for k, weight in STENCIL.items())


@given(seed=SEEDS)
def test_regressor_times_parameters_is_newton_euler(arm, random_states, random_bodies, seed):
    motion = random_states(arm, seed, 5)
    for robot in (arm, arm.with_parameters(random_bodies(seed, arm.nv))):
        tau = rigid_body_torque(robot, motion)
        assert close(regressor(robot, motion) @ robot.phi, tau, RELATIVE)


@pytest.mark.parametrize("by", ["q", "dq", "ddq"])
def test_derivatives_are_those_of_finite_differences(arm, random_states, by):
    motion = random_states(arm, 3, 4)
    found = regressor_derivatives(arm, motion)
    assert np.array_equal(found.Y, regressor(arm, motion))
    expected = [finite_difference(arm, motion, by, joint) for joint in range(arm.nv)]
    assert close(np.array(expected), getattr(found, f"by_{by}"), RELATIVE)


def assert_same_torque(base: BaseParameters, W: np.ndarray, seed: int) -> None:
    """W φ = W_base B φ for any φ, and no torque along the null space."""
    phi = np.random.default_rng(seed).standard_normal(W.shape[2])
    assert close(W[:, :, base.columns] @ (base.regrouping @ phi), W @ phi, 1e-9)
    assert base.null_space.shape == (len(phi), len(phi) - len(base))
    assert np.abs(W @ base.null_space).max() <= 1e-9 * np.abs(W).max()


@given(seed=SEEDS)
def test_regrouping_keeps_the_torque(arm: Robot, random_states: Call, seed: int) -> None:
    assert_same_torque(base_parameters(arm), regressor(arm, random_states(arm, seed, 10)), seed)


@settings(max_examples=5)
@given(seed=SEEDS)
def test_text_does_not_depend_on_the_draw_of_states(arm: Robot, seed: int) -> None:
    usual = base_parameters(arm, effects := standard_effects(arm.joints))
    with mock.patch("numpy.random.default_rng", return_value=np.random.default_rng(seed)):
        other = base_parameters(arm, effects)
    assert other.expressions == usual.expressions
    assert len(set(usual.expressions)) == len(usual)
    assert categories(other) == categories(usual)
    np.testing.assert_allclose(other.regrouping, usual.regrouping, rtol=1e-10, atol=0)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        *((1.0, "1"), (1 / 3, "1/3"), (2 / 7, "2/7"), (1.75, "1.75"), (0.0825**2, "0.0068062")),
        *((0.1234, "0.1234"), (np.sqrt(2), "1.4142"), (123.456, "123.46"), (2.5e-7, "2.5e-07")),
    ],
)
def test_coefficients_read_the_same_however_they_are_rounded(value: float, text: str) -> None:
    for factor in (1 - 4e-15, 1 - 1e-15, 1.0, 1 + 1e-15, 1 + 4e-15):
        assert coefficient_text(value * factor) == text


def test_slow_friction_is_seen_at_any_speed_limit(ur10: Robot) -> None:
    fast = ur10.with_limits(replace(ur10.limits, velocity=np.full(6, 900.0)))
    effects = (StribeckFriction(ur10.joints),)
    assert len(base_parameters(fast, effects)) == len(base_parameters(ur10, effects)) == 36 + 6


def test_effects_extend_the_base(builtin: Robot, random_states: Call) -> None:
    effects = standard_effects(builtin.joints)
    base = base_parameters(builtin, effects)
    assert base.names == column_names(builtin, effects)
    assert {f"{j}.Fv" for j in builtin.joints} <= {base.names[k] for k in base.columns}
    W = observation_columns(builtin, effects, random_states(builtin, 7, 20))
    assert_same_torque(base, W, 0)
