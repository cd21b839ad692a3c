"""Laws of the base parameters."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from excitant.robots import Motion, Robot, base_parameters, load_robot, regressor
from excitant.robots.effects import standard_effects
from excitant.robots.torque import column_names, observation_columns

States = Callable[[Robot, int, int], Motion]


@pytest.mark.parametrize(
    ("name", "gravity", "count"),
    [
        ("planar_2r", (0, 0, -9.81), 6),
        ("planar_2r", (0, -9.81, 0), 4),
        ("planar_2r", (0, 0, 0), 4),
        ("ur10", (0, 0, -9.81), 36),
        ("panda", (0, 0, -9.81), 43),
    ],
)
def test_known_counts(name: str, gravity: tuple[float, ...], count: int) -> None:
    assert len(base_parameters(load_robot(name).with_gravity(gravity))) == count


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


def test_expressions_are_the_same_every_time(arm: Robot) -> None:
    first, second = base_parameters(arm), base_parameters(arm)
    assert first.expressions == second.expressions
    assert len(set(first.expressions)) == len(first)


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
