import itertools
from types import SimpleNamespace

import clarabel
import numpy as np
import pytest
import scipy.sparse
from limit_use import limited
from marks import refused, slow

from excitant.design import condition_number, design_trajectory, random_trajectory
from excitant.design.bound import Bound, best_mixture, lower_bound
from excitant.design.relaxation import Relaxation, numbered
from excitant.exceptions import BadInput
from excitant.robots import Robot, load_robot


@pytest.fixture(scope="module")
def pendulum() -> Robot:
    """One joint whose base columns are (g sin q, g cos q, q̈)."""
    robot = load_robot("planar_2r", lock={"joint2": 0.0}).with_effects(())
    return limited(robot, velocity=2.0, torque=np.inf)


def svec(M: np.ndarray) -> np.ndarray:
    """Upper triangle column by column, off-diagonal entries times √2."""
    j, i = np.tril_indices(M.shape[-1])
    return M[..., i, j] * np.where(i == j, 1.0, np.sqrt(2.0))


def reference_mixture(M: np.ndarray, rows: np.ndarray) -> float:
    """The same programme, one block and hard equality rows, by a general conic solver."""
    n, p, m = len(M), M.shape[1], rows.shape[1]
    columns, one = svec(M).T, svec(np.eye(p))
    zero = np.zeros(len(one))
    blocks = ((np.zeros(m), rows.T), (zero, -columns), (-one, columns), (np.zeros(n), -np.eye(n)))
    A = scipy.sparse.csc_matrix(np.vstack([np.column_stack(block) for block in blocks]))
    b = np.concatenate([np.zeros(m), -one, zero, np.zeros(n)])
    definite = clarabel.PSDTriangleConeT(p)
    cones = [clarabel.ZeroConeT(m), definite, definite, clarabel.NonnegativeConeT(n)]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    none, cost = scipy.sparse.csc_matrix((n + 1, n + 1)), np.eye(n + 1)[0]
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
    assert bound.value <= bound.without_repair * (1 + 1e-9)
    u = np.random.default_rng(12345).uniform(-1, 1, (n, 3 * problem.space.robot.nv))
    u[::2] = np.sign(u[::2]) * np.abs(u[::2]) ** 0.2
    motion = problem.space.slowed(problem.space.motion(u))
    assert len(motion) > n / 2
    assert problem.price(bound.multipliers, motion).max() <= 1e-9


@pytest.mark.parametrize("seed", range(3))
def test_mixture_agrees_with_a_general_solver(seed: int) -> None:
    rng = np.random.default_rng(seed)
    Y = rng.normal(size=(80, 2, 6)) * rng.uniform(0.3, 3.0, 6)
    M = np.swapaxes(Y, 1, 2) @ Y
    rows = rng.normal(size=(80, 4))
    weights, found = best_mixture(M, rows, softness=1e-9, tolerance=1e-8)
    W = np.tensordot(weights, M, axes=1)
    eigenvalues = np.linalg.eigvalsh(W)
    assert found.value == pytest.approx(reference_mixture(M, rows), rel=1e-5)
    assert eigenvalues[-1] / eigenvalues[0] == pytest.approx(found.value, rel=1e-5)
    np.testing.assert_allclose(weights @ rows, 0.0, atol=1e-5 * weights.sum())
    assert (np.tensordot(M, found.P - found.Q, axes=2) + rows @ found.y).max() < 1e-5


@pytest.mark.usefixtures("own_time")
def test_pendulum_has_the_bound_known_in_closed_form(pendulum: Robot) -> None:
    """Y = (g sin q, g cos q, q̈): tr of the first two is g², the third at most a²."""
    g, a = 9.81, 2.0
    bound = lower_bound(limited(pendulum, acceleration=a), harmonics=50, time_limit=20.0)
    assert bound.value == pytest.approx(g / np.sqrt(2) / a, rel=5e-3)
    assert bound.value <= g / np.sqrt(2) / a * (1 + 1e-9)
    assert_certificate_holds(bound)


@pytest.mark.usefixtures("own_time")
@pytest.mark.parametrize("half", [slow(0.4), slow(0.7)])
def test_pendulum_agrees_with_a_dense_grid(pendulum: Robot, half: float) -> None:
    robot = limited(pendulum, position=[[0.3 - half, 0.3 + half]], acceleration=8.0)
    bound = lower_bound(robot, period=5.0, harmonics=4, time_limit=20.0)
    exhaustive = grid_value(bound.relaxation, (41, 7, 9))
    assert bound.value <= exhaustive * (1 + 1e-4)
    assert bound.value == pytest.approx(exhaustive, rel=5e-3)
    assert_certificate_holds(bound)


@pytest.mark.usefixtures("own_time")
@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_never_above_a_trajectory(planar: Robot, seed: int) -> None:
    rng = np.random.default_rng(seed)
    middle, half = rng.uniform(-2, 2, 2), rng.uniform(0.4, 2.0, 2)
    limits = {"position": np.column_stack([middle - half, middle + half])}
    limits |= {"velocity": rng.uniform(1, 4, 2), "acceleration": rng.uniform(3, 20, 2)}
    robot = limited(planar, **limits, torque=planar.limits.torque * rng.uniform(0.7, 1.0, 2))
    period, harmonics = float(rng.uniform(3, 10)), int(rng.integers(2, 6))
    options = {"harmonics": harmonics, "columns": ("inertial", "friction")[seed % 2]}
    bound = lower_bound(robot, period=period, time_limit=10.0, **options)
    found = design_trajectory(robot, duration=period, periods=1, starts=3, jobs=1, **options)
    drawn = [random_trajectory(robot, rng, period, harmonics) for _ in range(50)]
    matrix = bound.relaxation.information.matrix
    conditions = [condition_number(matrix(x.sample(401))) for x in (found.trajectory, *drawn)]
    assert 1.0 < bound.value <= min(conditions)
    assert_certificate_holds(bound, 2000)


@pytest.mark.usefixtures("own_time")
@pytest.mark.slow
def test_tighter_limits_never_lower_the_bound(planar: Robot) -> None:
    bounds = []
    names = ("velocity", "acceleration")
    for harmonics, share in ((50, 1.0), (5, 1.0), (5, 0.4)):
        rates = {name: share * getattr(planar.limits, name) for name in names}
        robot = limited(planar, position=[-2 * share, 2 * share], **rates)
        bounds.append(lower_bound(robot, harmonics=harmonics, time_limit=5.0))
    for looser, tighter in itertools.pairwise(bounds):
        assert tighter.without_repair >= looser.value * (1 - 1e-9)
        assert tighter.value >= looser.value * (1 - 0.02)
    assert bounds[-1].value > 1.2 * bounds[0].value


@pytest.mark.slow
def test_bound_of_a_six_joint_arm_is_far_above_one(ur10: Robot, monkeypatch: pytest.MonkeyPatch):
    ticks = itertools.count()  # two in a round: as many rounds on any machine
    monkeypatch.setattr("excitant.design.bound.time", SimpleNamespace(time=lambda: next(ticks)))
    robot = limited(ur10, position=[-np.pi, np.pi], acceleration=10.0)
    pool = [random_trajectory(robot, np.random.default_rng(1), 10.0, 5).sample(200)]
    told: list[tuple[float, float, float]] = []
    bound = lower_bound(robot, time_limit=22.0, pool=pool, progress=lambda *x: told.append(x))
    assert bound.value > 7.6 / 4
    assert_certificate_holds(bound)
    assert len(told) > 2
    assert np.all(np.diff(told, axis=0)[:, 1] >= 0)
    assert "not a proof" in bound.assumptions
    # its test functions vanish on trajectories
    trajectory = random_trajectory(robot, np.random.default_rng(0), 10.0, 5)
    motion = trajectory.at(np.arange(400) / 400 * 10.0)
    rates = bound.relaxation.tests.rates(motion)
    assert rates.shape[1] == 66
    np.testing.assert_allclose(rates.mean(axis=0), 0.0, atol=1e-9 * np.abs(rates).max())
    space = bound.relaxation.space
    back = space.motion(space.cube(motion))
    for name in ("q", "dq", "ddq"):
        np.testing.assert_allclose(getattr(back, name), getattr(motion, name), atol=1e-9)


def test_refuses_what_it_cannot_bound(planar: Robot) -> None:
    for robot, options, why in (
        (planar, {"harmonics": 1}, "at least 2"),
        (limited(planar, position=[-np.inf, np.inf], velocity=np.inf), {}, "velocity"),
        (planar, {"pool": [numbered(*np.zeros((3, 4, 3)))]}, "joints"),
    ):
        refused(why, lower_bound, robot, **options, error=BadInput)
