"""Laws of the seed paper's recursion (Khosla 1987), and its arm, the CMU DD Arm II."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from khosla import close, dh_from_robot, frames, torque_matrix
from second_opinion import grouping
from seed import dd_arm, dd_arm_chain, dd_arm_parameters, dd_arm_tables, parameter_map

from excitant.robots import DHChain, Motion, base_parameters, load_robot, rigid_body_torque
from excitant.robots.dh import CONVENTIONS, Convention, robot_from_dh
from excitant.robots.parameters import STANDARD, violations
from excitant.robots.regressor import regressor

Chains = Callable[..., DHChain]


def states(seed: int, n: int, nv: int) -> Motion:
    return Motion(np.arange(float(n)), *np.random.default_rng(seed).uniform(-2, 2, (3, n, nv)))


def matrix(chain: DHChain, motion: Motion, **form: bool) -> np.ndarray:
    return torque_matrix(chain, motion.q, motion.dq, motion.ddq, **form)


def rank(W: np.ndarray) -> int:
    """Number of independent columns, whatever their units."""
    norms = np.linalg.norm(W, axis=0)
    W = W[:, norms > 1e-10 * norms.max()]
    return int(np.linalg.matrix_rank(W / np.linalg.norm(W, axis=0), tol=1e-8 * np.sqrt(W.shape[1])))


@given(
    seed=st.integers(0, 2**32 - 1), nv=st.integers(1, 9), convention=st.sampled_from(CONVENTIONS)
)
def test_a_chain_needs_the_torque_of_the_recursion_where_its_frames_are(
    random_chain: Chains, seed: int, nv: int, convention: Convention
) -> None:
    """And Property 4 holds: neither m_i, nor I_i, nor m_i s_i shows in τ_{i+1} .. τ_N."""
    chain, motion = random_chain(seed, nv, convention), states(seed, 5, nv)
    robot, M = robot_from_dh(chain), matrix(chain, motion)
    tau, data = rigid_body_torque(robot, motion), robot.model.createData()
    assert close(M @ chain.phi, tau)
    assert close(regressor(robot, motion) @ parameter_map(chain), M)
    for i in range(nv - 1):
        assert not M[:, i + 1 :, : 10 * i + 10].any()
    back = dh_from_robot(robot)
    assert close(matrix(back, motion) @ back.phi, tau)
    for one in (chain, back):
        for q, placed in zip(motion.q, frames(one, motion.q), strict=True):
            pin.framesForwardKinematics(robot.model, data, q)
            tip = data.oMf[robot.tip].homogeneous
            assert np.allclose(placed[-1] @ one.tool, tip, rtol=0, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_lever_times_acceleration_belongs_to_distal_frames_only(
    random_chain: Chains, seed: int
) -> None:
    """[p×]v̇: needed in the paper's frames, zero in those of An, Atkeson and Hollerbach."""
    distal, motion = random_chain(seed, 6), states(seed, 50, 6)
    distal = replace(distal, revolute=np.full(6, True), a=np.full(6, 0.3), d=np.full(6, 0.2))
    proximal, expected = dh_from_robot(robot_from_dh(distal)), matrix(distal, motion) @ distal.phi
    dropped = matrix(distal, motion, lever=False) @ distal.phi - expected
    assert np.linalg.norm(dropped) > 0.05 * np.linalg.norm(expected)
    assert close(matrix(proximal, motion, lever=False) @ proximal.phi, expected)


@pytest.mark.parametrize("printed", [False, True])
def test_the_printed_kinematic_matrix_is_wrong(random_chain: Chains, printed: bool) -> None:
    """[p×][ω×] for [p×]([ω̇×] + [ω×][ω×]): other units, so it breaks the scaling of time."""
    chain, motion = replace(random_chain(1, 6), gravity=np.zeros(3)), states(2, 40, 6)
    faster = replace(motion, dq=2 * motion.dq, ddq=4 * motion.ddq)
    once, twice = (matrix(chain, x, printed=printed) @ chain.phi for x in (motion, faster))
    assert close(twice, 4 * once, 1e-9) != printed
    error = np.abs(once - rigid_body_torque(robot_from_dh(chain), motion)).max()
    assert (error > 0.1) == printed


# The CMU DD Arm II


@pytest.fixture(scope="module")
def dd() -> DHChain:
    return dd_arm_chain()


def test_dd_arm_tables_mark_what_is_doubtful_in_print() -> None:
    table = {entry.name: entry for entry in dd_arm_tables()}
    assert table["m5+m4"].initial == pytest.approx(1.880 + 0.937)
    assert table["m4s4z"].value("estimated") == 0.081462
    assert table["m4s4z"].value("estimated", likely=True) == 0.051462
    assert table["m4s4z"].value("initial", likely=True) == 0.043011
    doubtful = {name for name, entry in table.items() if entry.doubtful}
    inertias = {"I3xz", "I3yy", "I3yz", "I3zz", "I5xx"}
    assert doubtful == {"m3s3y", "m3s3z", "m4s4z", "m5s5z"} | inertias
    assert all(table[name].why and table[name].printed for name in doubtful)


def test_dd_arm_is_loaded_with_its_initial_values(dd: DHChain) -> None:
    """The arm's file states them twice: as tables, and as inertias about the same frames."""
    assert np.allclose(dd.phi, dd_arm_parameters("initial"), rtol=0, atol=1e-9)
    motion = states(0, 5, 6)
    M = matrix(dd, motion)
    assert close(rigid_body_torque(load_robot("cmu_dd_arm_ii"), motion), M @ dd.phi)
    for column in ("initial", "estimated"):
        expected = M @ dd_arm_parameters(column)
        assert close(rigid_body_torque(dd_arm(column), motion), expected, 1e-8)


def test_dd_arm_shows_exactly_what_the_tables_list(dd: DHChain) -> None:
    """47 non-zero columns, two of them the same (m4, m5): the 46 rows of the tables.

    Seven columns of links 1 and 2 hold four combinations.
    """
    W = matrix(dd, states(0, 200, 6)).reshape(-1, 60)
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
    chain = dh_from_robot(robot)
    motion = Motion(np.arange(200.0), *robot.random_motion(np.random.default_rng(5), 200))
    M = matrix(chain, motion)
    assert close(M @ chain.phi, rigid_body_torque(robot, motion))
    assert len(base_parameters(robot)) == count
    assert rank(M.reshape(-1, 10 * robot.nv)) == count
    assert len(grouping(robot)) == count
