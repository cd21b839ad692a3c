"""Laws of the base parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from excitant.robots import Motion, Robot, base_parameters, regressor
from excitant.robots.base_parameters import categories, coefficient_text
from excitant.robots.effects import StribeckFriction, standard_effects
from excitant.robots.torque import column_names, observation_columns

States = Callable[[Robot, int, int], Motion]


def test_a_tilted_base_shows_more(builtin: Robot) -> None:
    tilted = builtin.with_gravity([1.0, 2.0, -9.5])
    assert len(base_parameters(tilted)) >= len(base_parameters(builtin))


@given(seed=st.integers(0, 2**32 - 1))
def test_regrouping_keeps_the_torque(arm: Robot, random_states: States, seed: int) -> None:
    base, W = base_parameters(arm), regressor(arm, random_states(arm, seed, 10))
    phi = np.random.default_rng(seed).standard_normal(len(arm.phi))
    beta = base.regrouping @ phi
    difference = W @ phi - W[:, :, base.columns] @ beta
    assert np.abs(difference).max() <= 1e-9 * np.abs(W @ phi).max()


@given(seed=st.integers(0, 2**32 - 1))
def test_no_torque_along_the_null_space(arm: Robot, random_states: States, seed: int) -> None:
    base, W = base_parameters(arm), regressor(arm, random_states(arm, seed, 10))
    assert base.null_space.shape == (len(arm.phi), len(arm.phi) - len(base))
    assert np.abs(W @ base.null_space).max() <= 1e-9 * np.abs(W).max()


def test_base_columns_are_independent(arm: Robot, random_states: States) -> None:
    base = base_parameters(arm)
    W = regressor(arm, random_states(arm, 1, 300))[:, :, base.columns].reshape(-1, len(base))
    assert np.linalg.matrix_rank(W / np.linalg.norm(W, axis=0)) == len(base)


@settings(max_examples=5)
@given(seed=st.integers(0, 2**32 - 1))
def test_text_does_not_depend_on_the_draw_of_states(arm: Robot, seed: int) -> None:
    effects = standard_effects(arm.joints)
    usual = base_parameters(arm, effects)
    other = base_parameters(arm, effects, rng=np.random.default_rng(seed))
    assert other.expressions == usual.expressions
    assert categories(other) == categories(usual)
    np.testing.assert_allclose(other.regrouping, usual.regrouping, rtol=1e-10, atol=0)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1.0, "1"),
        (1 / 3, "1/3"),
        (1.75, "1.75"),
        (0.0825**2, "0.0068062"),
        (0.1234, "0.1234"),
        (np.sqrt(2), "1.4142"),
        (2.5e-7, "2.5e-07"),
    ],
)
def test_coefficients_read_the_same_however_they_are_rounded(value: float, text: str) -> None:
    for factor in (1 - 4e-15, 1 - 1e-15, 1.0, 1 + 1e-15, 1 + 4e-15):
        assert coefficient_text(value * factor) == text


def test_categories_follow_the_null_space(arm: Robot) -> None:
    base = base_parameters(arm, standard_effects(arm.joints))
    category = np.array(categories(base))
    moved = np.abs(base.null_space).max(axis=1) > 1e-12
    assert (moved == (category != "unique")).all()
    alone = np.abs(base.regrouping).max(axis=0) == 0
    assert (alone == (category == "unidentifiable")).all()


def test_the_gap_is_wide_on_arms_of_exact_geometry(arm: Robot) -> None:
    accepted, rejected = base_parameters(arm, standard_effects(arm.joints)).gap
    assert accepted > 1e-3
    assert rejected < 1e-12


def test_slow_friction_is_seen_at_any_speed_limit(ur10: Robot) -> None:
    fast = ur10.with_limits(replace(ur10.limits, velocity=np.full(6, 900.0)))
    effects = (StribeckFriction(ur10.joints),)
    assert len(base_parameters(fast, effects)) == len(base_parameters(ur10, effects)) == 36 + 6


def test_effects_extend_the_base(builtin: Robot, random_states: States) -> None:
    effects = standard_effects(builtin.joints)
    base = base_parameters(builtin, effects)
    names = column_names(builtin, effects)
    assert base.names == names
    kept = {names[k] for k in base.columns}
    assert {f"{joint}.Fv" for joint in builtin.joints} <= kept
    W = observation_columns(builtin, effects, random_states(builtin, 7, 20))
    phi = np.random.default_rng(0).standard_normal(len(names))
    difference = W @ phi - W[:, :, base.columns] @ (base.regrouping @ phi)
    assert np.abs(difference).max() <= 1e-9 * np.abs(W @ phi).max()
