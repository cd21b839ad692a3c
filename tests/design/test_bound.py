from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path

import clarabel
import numpy as np
import pytest
import scipy.sparse

from excitant.design import condition_number, design_trajectory, random_trajectory
from excitant.design.bound import Bound, best_mixture, lower_bound
from excitant.design.relaxation import Relaxation, numbered
from excitant.exceptions import BadInput
from excitant.robots import Robot, load_robot

Limited = Callable[..., Robot]

PENDULUM = """<robot name="pendulum"><link name="base"/>
<link name="bob"><inertial><origin xyz="0.3 0.1 0"/><mass value="2"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial></link>
<joint name="hinge" type="revolute"><parent link="base"/><child link="bob"/><axis xyz="0 1 0"/>
<limit lower="-3.2" upper="3.2" velocity="2" effort="1000"/></joint></robot>"""


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    path: Path = tmp_path_factory.mktemp("pendulum") / "pendulum.urdf"
    path.write_text(PENDULUM)
    return load_robot(path)


def svec(M: np.ndarray) -> np.ndarray:
    """Upper triangle column by column, off-diagonal entries times √2."""
    j, i = np.tril_indices(M.shape[-1])
    return M[..., i, j] * np.where(i == j, 1.0, np.sqrt(2.0))


def reference_mixture(M: np.ndarray, rows: np.ndarray) -> float:
    """The same programme, one block and hard equality rows, by a general conic solver."""
    n, p, m = len(M), M.shape[1], rows.shape[1]
    columns, one = svec(M).T, svec(np.eye(p))
    zero = np.zeros(len(one))
    equalities = np.column_stack([np.zeros(m), rows.T])
    above, below = np.column_stack([zero, -columns]), np.column_stack([-one, columns])
    A = np.vstack([equalities, above, below, np.column_stack([np.zeros(n), -np.eye(n)])])
    b = np.concatenate([np.zeros(m), -one, zero, np.zeros(n)])
    cones = [clarabel.ZeroConeT(m), *[clarabel.PSDTriangleConeT(p)] * 2]
    cones.append(clarabel.NonnegativeConeT(n))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    none, cost = scipy.sparse.csc_matrix((n + 1, n + 1)), np.eye(n + 1)[0]
    A = scipy.sparse.csc_matrix(A)
    solution = clarabel.DefaultSolver(none, cost, A, b, cones, settings).solve()
    assert str(solution.status) == "Solved"
    return float(solution.obj_val)


def grid_value(problem: Relaxation, counts: tuple[int, int, int]) -> float:
    """The relaxation of a one-joint arm on a dense grid of states; q̇ ≥ 0 says all of it."""
    axes = [np.linspace(low, 1, n) for low, n in zip((-1, 0, -1), counts, strict=True)]
    u = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=1)
    motion = problem.space.slowed(problem.space.motion(u))
    M, rows = problem.matrices(motion), problem.tests.rates(motion)
    size = np.trace(M, axis1=1, axis2=2)[:, None]
    return float(np.sqrt(reference_mixture(M / size[:, :, None], rows * problem.unit / size)))


def assert_certificate_holds(bound: Bound, n: int = 10_000) -> None:
    problem = bound.relaxation
    for matrix in (bound.multipliers.P, bound.multipliers.Q):
        assert np.linalg.eigvalsh(matrix)[0] >= -1e-12 * np.trace(matrix)
    assert np.trace(bound.multipliers.Q) == pytest.approx(1.0, abs=1e-9)
    assert bound.value == pytest.approx(max(1.0, np.sqrt(bound.multipliers.value)), rel=1e-9)
    assert bound.weights.min() >= 0.0
    assert bound.value <= bound.without_repair * (1 + 1e-9)
    rng = np.random.default_rng(12345)
    u = rng.uniform(-1, 1, (n, 3 * problem.space.robot.nv))
    u[::2] = np.sign(u[::2]) * np.abs(u[::2]) ** 0.2
    motion = problem.space.slowed(problem.space.motion(u))
    assert len(motion) > n / 2
    assert bound.slack(motion).min() >= -1e-9


@pytest.mark.parametrize("seed", range(3))
def test_mixture_agrees_with_a_general_solver(seed: int) -> None:
    rng = np.random.default_rng(seed)
    Y = rng.normal(size=(80, 2, 6)) * rng.uniform(0.3, 3.0, 6)
    M = np.swapaxes(Y, 1, 2) @ Y
    rows = rng.normal(size=(80, 4))
    weights, found = best_mixture(M, rows, bound=10.0, tolerance=1e-8)
    W = np.tensordot(weights, M, axes=1)
    eigenvalues = np.linalg.eigvalsh(W)
    assert found.value == pytest.approx(reference_mixture(M, rows), rel=1e-5)
    assert eigenvalues[-1] / eigenvalues[0] == pytest.approx(found.value, rel=1e-5)
    np.testing.assert_allclose(weights @ rows, 0.0, atol=1e-5 * weights.sum())
    assert (np.tensordot(M, found.P - found.Q, axes=2) + rows @ found.y).max() < 1e-5


def test_pendulum_has_the_bound_known_in_closed_form(pendulum: Robot, limited: Limited) -> None:
    """Y = (g sin q, g cos q, q̈): tr of the first two is g², the third at most a²."""
    g, a = 9.81, 2.0
    robot = limited(pendulum, acceleration=a)
    bound = lower_bound(robot, harmonics=None, time_limit=20.0)
    assert bound.value == pytest.approx(g / np.sqrt(2) / a, rel=5e-3)
    assert bound.value <= g / np.sqrt(2) / a * (1 + 1e-9)
    assert_certificate_holds(bound)


@pytest.mark.parametrize("half", [0.4, 0.7])
def test_pendulum_agrees_with_a_dense_grid(pendulum: Robot, limited: Limited, half: float) -> None:
    robot = limited(pendulum, position=[[0.3 - half, 0.3 + half]], acceleration=8.0)
    bound = lower_bound(robot, duration=5.0, harmonics=4, time_limit=20.0)
    exhaustive = grid_value(bound.relaxation, (41, 7, 9))
    assert bound.value <= exhaustive * (1 + 1e-4)
    assert bound.value == pytest.approx(exhaustive, rel=5e-3)
    assert_certificate_holds(bound)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(8))
def test_never_above_a_trajectory(planar: Robot, limited: Limited, seed: int) -> None:
    rng = np.random.default_rng(seed)
    middle, half = rng.uniform(-2, 2, 2), rng.uniform(0.4, 2.0, 2)
    robot = limited(
        planar,
        position=np.column_stack([middle - half, middle + half]),
        velocity=rng.uniform(1, 4, 2),
        acceleration=rng.uniform(3, 20, 2),
        torque=planar.limits.torque * rng.uniform(0.7, 1.0, 2),
    )
    columns = ("inertial", "friction")[seed % 2]
    duration, harmonics = float(rng.uniform(3, 10)), int(rng.integers(2, 6))
    bound = lower_bound(
        robot, duration=duration, harmonics=harmonics, columns=columns, time_limit=4.0
    )
    information = bound.relaxation.information
    found = design_trajectory(
        robot, duration=duration, harmonics=harmonics, columns=columns, starts=3, jobs=1
    )
    trajectories = [found.trajectory]
    trajectories += [random_trajectory(robot, rng, duration, harmonics) for _ in range(50)]
    conditions = [condition_number(information.matrix(x.sample(401))) for x in trajectories]
    assert bound.value <= min(conditions)
    assert bound.value > 1.0
    assert_certificate_holds(bound, 2000)


@pytest.mark.slow
def test_tighter_limits_never_lower_the_bound(planar: Robot, limited: Limited) -> None:
    bounds = [
        lower_bound(
            limited(
                planar,
                position=[[-share * 2, share * 2]] * 2,
                velocity=planar.limits.velocity * share,
                acceleration=planar.limits.acceleration * share,
            ),
            harmonics=harmonics,
            time_limit=4.0,
        )
        for harmonics, share in ((None, 1.0), (5, 1.0), (5, 0.7), (5, 0.4))
    ]
    for looser, tighter in itertools.pairwise(bounds):
        assert tighter.without_repair >= looser.value * (1 - 1e-9)
        assert tighter.value >= looser.value * (1 - 0.02)
    assert bounds[-1].value > 1.2 * bounds[0].value


@pytest.mark.slow
def test_bound_of_a_six_joint_arm_is_far_above_one(ur10: Robot, limited: Limited) -> None:
    robot = limited(ur10, position=[-np.pi, np.pi], acceleration=10.0)
    pool = [random_trajectory(robot, np.random.default_rng(1), 10.0, 5).sample(200)]
    told: list[tuple[float, float, float]] = []
    bound = lower_bound(robot, time_limit=60.0, pool=pool, progress=lambda *x: told.append(x))
    assert bound.value > 7.6 / 4
    assert_certificate_holds(bound)
    assert len(told) == len(bound.history)
    assert np.all(np.diff(bound.history[:, 1]) >= 0)
    assert "not a proof" in bound.assumptions


@pytest.mark.slow
def test_test_functions_vanish_on_trajectories(ur10: Robot, limited: Limited) -> None:
    robot = limited(ur10, position=[-np.pi, np.pi], acceleration=10.0)
    bound = lower_bound(robot, time_limit=0.1)
    trajectory = random_trajectory(robot, np.random.default_rng(0), 10.0, 5)
    motion = trajectory.at(np.arange(400) / 400 * 10.0)
    rates = bound.relaxation.tests.rates(motion)
    assert rates.shape[1] == 66
    np.testing.assert_allclose(rates.mean(axis=0), 0.0, atol=1e-9 * np.abs(rates).max())
    space = bound.relaxation.space
    back = space.motion(space.cube(motion))
    for name in ("q", "dq", "ddq"):
        np.testing.assert_allclose(getattr(back, name), getattr(motion, name), atol=1e-9)


def test_refuses_what_it_cannot_bound(planar: Robot, limited: Limited) -> None:
    with pytest.raises(BadInput, match="at least 2"):
        lower_bound(planar, harmonics=1)
    with pytest.raises(BadInput, match="velocity"):
        lower_bound(limited(planar, velocity=np.inf), harmonics=None)
    with pytest.raises(BadInput, match="joints"):
        lower_bound(planar, pool=[numbered(*np.zeros((3, 4, 3)))])
