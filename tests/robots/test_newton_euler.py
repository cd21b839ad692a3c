"""Laws of the seed paper's recursion (Khosla 1987), and its arm, the CMU DD Arm II."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from khosla import LinkMotion, cross_matrix, dh_from_robot, torque_matrix, with_convention
from second_opinion import grouping
from seed import dd_arm, dd_arm_chain, dd_arm_parameters, dd_arm_tables, parameter_map

from excitant.robots import (
    DHChain,
    Motion,
    base_parameters,
    load_robot,
    regressor,
    rigid_body_torque,
    robot_from_dh,
)
from excitant.robots.parameters import STANDARD, violations

Chains = Callable[..., DHChain]
SEEDS = st.integers(0, 2**32 - 1)
CONVENTIONS = st.sampled_from(["standard", "modified"])
EXACT = 1e-10
"""Relative; rounding leaves about 1e-14."""


def close(left: np.ndarray, right: np.ndarray, relative: float = EXACT) -> bool:
    return bool(np.abs(left - right).max() <= relative * np.abs(right).max())


def states(seed: int, n: int, nv: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-2, 2, (3, n, nv))


def rank(W: np.ndarray) -> int:
    """Number of independent columns, whatever their units."""
    norms = np.linalg.norm(W, axis=0)
    W = W[:, norms > 1e-10 * norms.max()]
    return int(np.linalg.matrix_rank(W / np.linalg.norm(W, axis=0), tol=1e-8 * np.sqrt(W.shape[1])))


@given(seed=SEEDS, nv=st.integers(1, 9), convention=CONVENTIONS)
def test_the_recursion_is_what_pinocchio_says(
    random_chain: Chains, seed: int, nv: int, convention: str
) -> None:
    """And Property 4 holds: neither m_i, nor I_i, nor m_i s_i shows in τ_{i+1} .. τ_N."""
    chain, x = random_chain(seed, nv, convention), states(seed, 5, nv)
    robot, motion = robot_from_dh(chain), Motion(np.arange(5.0), *x)
    M = torque_matrix(chain, *x)
    assert close(M @ chain.phi, rigid_body_torque(robot, motion))
    assert close(regressor(robot, motion) @ parameter_map(chain), M)
    for i in range(nv - 1):
        assert not M[:, i + 1 :, : 10 * i + 10].any()


# What the paper gets wrong, and what it takes for wrong


def arm_of(random_chain: Chains, convention: str, seed: int = 1) -> DHChain:
    """A random arm of six revolute joints."""
    chain = random_chain(seed, 6, convention)
    return replace(chain, revolute=np.ones(6, dtype=bool), a=np.full(6, 0.3), d=np.full(6, 0.2))


def without_lever_times_acceleration(K: np.ndarray, motion: LinkMotion) -> None:
    K[..., 3:, 0] = 0.0


def as_printed(K: np.ndarray, motion: LinkMotion) -> None:
    arm, spin = cross_matrix(motion.p), cross_matrix(motion.omega)
    K[..., 3:, 1:4] = arm @ spin - cross_matrix(motion.dv)


def pinocchio(chain: DHChain, x: np.ndarray) -> np.ndarray:
    return rigid_body_torque(robot_from_dh(chain), Motion(np.arange(float(x.shape[1])), *x))


@pytest.mark.parametrize("seed", range(5))
def test_lever_times_acceleration_belongs_to_distal_frames_only(
    random_chain: Chains, seed: int
) -> None:
    """[p×]v̇: needed in the paper's frames, zero in those of An, Atkeson and Hollerbach."""
    distal, x = arm_of(random_chain, "standard", seed), states(seed, 50, 6)
    expected = pinocchio(distal, x)
    dropped = torque_matrix(distal, *x, without_lever_times_acceleration) @ distal.phi - expected
    assert np.sqrt(np.mean(dropped**2)) > 0.05 * np.sqrt(np.mean(expected**2))
    proximal = with_convention(distal, "modified")
    without = torque_matrix(proximal, *x, without_lever_times_acceleration)
    assert close(without @ proximal.phi, expected)
    motion = Motion(np.arange(50.0), *x)
    assert close(without, regressor(robot_from_dh(proximal), motion))


def test_the_printed_kinematic_matrix_is_wrong(random_chain: Chains) -> None:
    """[p×][ω×] for [p×]([ω̇×] + [ω×][ω×]): other units, so it breaks the scaling of time."""
    chain = replace(arm_of(random_chain, "standard"), gravity=np.zeros(3))
    x = states(2, 40, 6)
    faster = x * np.array([1, 2, 4])[:, None, None]
    printed = torque_matrix(chain, *x, as_printed) @ chain.phi
    assert np.abs(printed - pinocchio(chain, x)).max() > 0.1
    for change, scales in ((None, True), (as_printed, False)):
        once, twice = (torque_matrix(chain, *s, change) @ chain.phi for s in (x, faster))
        assert close(twice, 4 * once, 1e-9) == scales


# The CMU DD Arm II


@pytest.fixture(scope="module")
def dd() -> DHChain:
    return dd_arm_chain()


def test_dd_arm_is_loaded_with_its_initial_values(dd: DHChain) -> None:
    """The arm's file states them twice: as tables, and as inertias about the same frames."""
    assert np.allclose(dd.phi, dd_arm_parameters("initial"), rtol=0, atol=1e-9)
    x = states(0, 5, 6)
    motion, M = Motion(np.arange(5.0), *x), torque_matrix(dd, *x)
    assert close(rigid_body_torque(load_robot("cmu_dd_arm_ii"), motion), M @ dd.phi)
    for column in ("initial", "estimated"):
        expected = M @ dd_arm_parameters(column)
        assert close(rigid_body_torque(dd_arm(column), motion), expected, 1e-8)


def test_dd_arm_shows_exactly_what_the_tables_list(dd: DHChain) -> None:
    """47 non-zero columns, two of them the same (m4, m5): the 46 rows of the tables.

    Seven columns of links 1 and 2 hold four combinations.
    """
    W = torque_matrix(dd, *states(0, 200, 6)).reshape(-1, 60)
    norms = np.linalg.norm(W, axis=0)
    names = [f"{link}.{name}" for link in dd.links for name in STANDARD]
    shown = {name for name, norm in zip(names, norms, strict=True) if norm > 1e-12 * norms.max()}
    m4, m5 = names.index("link4.m"), names.index("link5.m")
    assert np.allclose(W[:, m4], W[:, m5], rtol=0, atol=1e-12 * norms.max())
    assert shown == {p for e in dd_arm_tables() for p in e.parameter.split(" + ")}
    assert len(shown) - 1 == len(dd_arm_tables()) == 46
    assert len(shown & set(names[:20])) == 7
    assert rank(W[:, :20]) == 4


def test_initial_values_are_possible_and_link_5_as_estimated_is_not(dd: DHChain) -> None:
    assert violations(dd_arm_parameters("initial"), dd.links) == []
    found = violations(dd_arm_parameters("estimated"), dd.links)
    assert [line.split(":")[0] for line in found] == ["link4", "link5"]
    assert "break the triangle inequality" in found[1]
    assert violations(dd_arm_parameters("estimated", likely=True), dd.links) == []


def test_link_1_is_about_its_centre_of_mass(dd: DHChain) -> None:
    """About the frame the printed I1zz would violate I ≥ (m s)² / m."""
    row = {entry.name: entry.initial for entry in dd_arm_tables()}
    assert row["I1zz"] < row["m1s1x"] ** 2 / row["m1"]
    assert dd.phi[9] == pytest.approx(row["I1zz"] + row["m1s1x"] ** 2 / row["m1"])
    assert row["I2yy"] > row["m2s2x"] ** 2 / row["m2"]
    assert dd.phi[16] == row["I2yy"]


# How many base parameters, by rule


@pytest.mark.parametrize(
    ("name", "gravity", "count"),
    [
        ("puma560", (0, 0, -9.81), 36),
        ("puma560", (3, 0, -9.3), 38),
        ("cmu_dd_arm_ii", (0, 0, -9.81), 32),
        ("ur10", (0, 0, -9.81), 36),
        ("panda", (0, 0, -9.81), 43),
        ("planar_2r", (0, 0, -9.81), 6),
        ("planar_2r", (0, 0, 0), 4),
        ("planar_2r", (0, -9.81, 0), 4),
        ("cylindrical", (0, 0, -9.81), 5),
    ],
)
def test_base_parameters_counted_in_three_ways(
    name: str, gravity: tuple[float, ...], count: int
) -> None:
    """Ranks of two regressors that share no code, and a rule that needs none."""
    robot = load_robot(name).with_gravity(gravity)
    chain = dh_from_robot(robot, "modified")
    x = np.array(robot.random_motion(np.random.default_rng(5), 200))
    assert len(base_parameters(robot)) == count
    assert rank(torque_matrix(chain, *x).reshape(-1, 10 * robot.nv)) == count
    assert len(grouping(robot)) == count


@given(seed=SEEDS, nv=st.integers(1, 6))
def test_the_rule_holds_for_arms_of_right_angles(random_chain: Chains, seed: int, nv: int) -> None:
    """Random arms with parallel and orthogonal axes, mounted upright or at a slant."""
    rng = np.random.default_rng(seed)
    chain = replace(
        random_chain(seed, nv, "modified"),
        revolute=np.ones(nv, dtype=bool),
        alpha=rng.choice([0.0, np.pi / 2, -np.pi / 2], nv) * (np.arange(nv) > 0),
        a=rng.choice([0.0, 0.4], nv) * (np.arange(nv) > 0),
        d=rng.choice([0.0, 0.3], nv),
        base=np.eye(4),
        gravity=np.array([[0, 0, -9.81], [2, 3, -9]][rng.integers(2)], float),
    )
    W = torque_matrix(chain, *states(seed, 100, nv)).reshape(-1, 10 * nv)
    assert rank(W) == len(grouping(robot_from_dh(chain)))
