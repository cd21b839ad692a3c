"""Laws of the seed paper's recursion (Khosla 1987), and its arm, the CMU DD Arm II."""

import numpy as np
import pinocchio as pin
from hypothesis import given
from hypothesis import strategies as st
from khosla import close, dh_from_robot, frames, torque_matrix
from seed import dd_arm, dd_arm_chain, dd_arm_parameters, dd_arm_tables, parameter_map

from excitant.robots import DHChain, Motion, load_robot, rigid_body_torque
from excitant.robots.dh import CONVENTIONS, robot_from_dh
from excitant.robots.parameters import STANDARD, violations
from excitant.robots.regressor import CIRCLE, circle_weights, regressor


def states(seed: int, n: int, nv: int) -> Motion:
    return Motion(np.arange(float(n)), *np.random.default_rng(seed).uniform(-2, 2, (3, n, nv)))


def matrix(chain: DHChain, motion: Motion) -> np.ndarray:
    return torque_matrix(chain, motion.q, motion.dq, motion.ddq)


def rank(W: np.ndarray) -> int:
    """Number of independent columns, whatever their units."""
    norms = np.linalg.norm(W, axis=0)
    W = W[:, norms > 1e-10 * norms.max()]
    return int(np.linalg.matrix_rank(W / np.linalg.norm(W, axis=0), tol=1e-8 * np.sqrt(W.shape[1])))


@given(seed=st.integers(0, 10**9), nv=st.integers(1, 9), convention=st.sampled_from(CONVENTIONS))
def test_a_chain_needs_the_torque_of_the_recursion_there(random_chain, seed, nv, convention):
    """And Property 4 holds: neither m_i, nor I_i, nor m_i s_i shows in τ_{i+1} .. τ_N."""
    chain, motion = random_chain(seed, nv, convention), states(seed, 5, nv)
    robot, M = robot_from_dh(chain), matrix(chain, motion)
    tau, data = rigid_body_torque(robot, motion), robot.model.createData()
    assert close(M @ chain.phi, tau)
    assert close(regressor(robot, motion) @ parameter_map(chain), M)
    for i in range(nv - 1):
        assert not M[:, i + 1 :, : 10 * i + 10].any()
    for joint in np.array(robot.joints)[robot.revolute]:  # polynomials of its sine and cosine
        five = [rigid_body_torque(robot.with_zero(joint, x), motion) for x in CIRCLE]
        moved = np.tensordot(circle_weights(np.array([0.7])), five, 1)
        assert close(moved, rigid_body_torque(robot.with_zero(joint, 0.7), motion))
    back = dh_from_robot(robot)
    assert close(matrix(back, motion) @ back.phi, tau)
    for one in (chain, back):
        for q, placed in zip(motion.q, frames(one, motion.q), strict=True):
            pin.framesForwardKinematics(robot.model, data, q)
            tip = data.oMf[robot.tip].homogeneous
            assert np.allclose(placed[-1] @ one.tool, tip, rtol=0, atol=1e-12)


# The CMU DD Arm II

SCANNED = """
I6xx 0.000426 0.002092, I6xy 0.0 0.000011, I6xz 0.0 0.000022,
I6yy 0.000421 0.001979, I6yz 0.0 0.000010, I6zz 0.000047 0.000310,
m6s6x 0.0 -0.000090, m6s6y 0.0 -0.000187, m6s6z 0.002199 0.008709, m6 0.269 0.90018,
I5xx 0.002018 0.002602, I5xy 0.0 0.000302, I5xz 0.0 -0.000108,
I5yy 0.001049 0.001349, I5yz -0.000092 -0.000070, I5zz 0.001396 0.001211,
m5s5x 0.0 0.000981, m5s5y 0.005130 0.006744, m5s5z -0.016784 -0.019689, m5+m4 2.817 3.0895,
I4xx 0.023775 0.030765, I4xy 0.0 -0.00100, I4xz 0.0 0.000302,
I4yy 0.004055 0.003655, I4yz 0.003083 0.004207, I4zz 0.021652 0.029002,
m4s4x 0.0 -0.002402, m4s4y 0.134764 0.160372, m4s4z 0.043011 0.081462,
I3xx 0.014622 0.015192, I3xy 0.0 0.000726, I3xz 0.0 0.000109,
I3yy 0.006615 0.006209, I3yz 0-001269 0.001872, I3zz 0.012432 0.014080,
m3s3x 0.0 0.015242, m3s3y -0.039703 -0432251, m3s3z -0.G124S7 -0.040521, m3 2.801 2.92106,
I2yy 0.264736 0.322156, m2s2x -1.039971 -1.156482, m2s2z 0.008722 0.008234, m2 7.894 8.2501,
I1zz 1.193645 1.270784, m1s1x -5.925900 -6.478305, m1 19.753000 20.152630
"""  # parameter, initial and estimated value, digits as the scan shows them
MENDED = {"0-001269": 0.001269, "-0432251": -0.0432251, "-0.G124S7": -0.012487}
DD = dd_arm_chain()


def test_dd_arm_tables_as_transcribed_a_second_time() -> None:
    """From the scan, by somebody else: what one misread, the other would have to misread too."""
    rows = [row.split() for row in SCANNED.split(",")]
    table = {entry.name: entry for entry in dd_arm_tables()}
    assert [name for name, *_ in rows] == list(table)
    for name, *texts in rows:
        entry = table[name]
        assert f"link{name[1]}" in entry.parameter
        for text, value in zip(texts, (entry.initial, entry.estimated), strict=True):
            assert value == (MENDED[text] if text in MENDED else float(text)), name
            assert text not in MENDED or text in entry.printed


def test_dd_arm_is_loaded_with_its_initial_values() -> None:
    """The arm's file states them twice: as tables, and as inertias about the same frames."""
    assert np.allclose(DD.phi, dd_arm_parameters("initial"), rtol=0, atol=1e-9)
    motion = states(0, 5, 6)
    M = matrix(DD, motion)
    assert close(rigid_body_torque(load_robot("cmu_dd_arm_ii"), motion), M @ DD.phi)
    for column in ("initial", "estimated"):
        expected = M @ dd_arm_parameters(column)
        assert close(rigid_body_torque(dd_arm(column), motion), expected, 1e-8)


def test_dd_arm_shows_exactly_what_the_tables_list() -> None:
    """47 non-zero columns, two of them the same (m4, m5): the 46 rows of the tables.

    Seven columns of links 1 and 2 hold four combinations.
    """
    W = matrix(DD, states(0, 200, 6)).reshape(-1, 60)
    norms = np.linalg.norm(W, axis=0)
    names = [f"{link}.{name}" for link in DD.links for name in STANDARD]
    shown = {name for name, norm in zip(names, norms, strict=True) if norm > 1e-12 * norms.max()}
    m4, m5 = names.index("link4.m"), names.index("link5.m")
    assert np.allclose(W[:, m4], W[:, m5], rtol=0, atol=1e-12 * norms.max())
    assert shown == {p for e in dd_arm_tables() for p in e.parameter.split(" + ")}
    assert len(shown) - 1 == len(dd_arm_tables()) == 46
    assert (len(shown & set(names[:20])), rank(W[:, :20])) == (7, 4)


def test_initial_values_are_possible_and_link_5_as_estimated_is_not() -> None:
    assert violations(dd_arm_parameters("initial"), DD.links) == []
    found = violations(dd_arm_parameters("estimated"), DD.links)
    assert [line.split(":")[0] for line in found] == ["link4", "link5"]
    assert "break the triangle inequality" in found[1]
    assert violations(dd_arm_parameters("estimated", likely=True), DD.links) == []
