import numpy as np
import pytest
from limit_use import limited
from marks import slow

from excitant.design import build_design, check, condition_number, random_trajectory
from excitant.design.criterion import objective, smooth_model
from excitant.design.peaks import torque_peaks, torque_rows
from excitant.design.result import lone_torque, scaled_condition_number
from excitant.design.step import local_model
from excitant.robots import load_robot
from excitant.robots.effects import CoulombFriction, RotorInertia, ViscousFriction
from excitant.robots.torque import largest_torque


@pytest.mark.parametrize("name", ["planar_2r", slow("ur10")])
@pytest.mark.parametrize("columns", ["inertial", "friction"])
@pytest.mark.parametrize("criterion", ["d", "a", "condition", "e"])
def test_gradient_of_every_criterion(criterion: str, columns: str, name: str) -> None:
    robot, rng = load_robot(name), np.random.default_rng(5)
    problem = build_design(robot, harmonics=3, columns=columns, criterion=criterion)
    z = problem.unknowns(random_trajectory(robot, rng, 10.0, 3))
    model = local_model(problem, z)
    blocks = zip(model.blocks, (0, -1), strict=False)
    gradient = model.gradient + sum(block.sign * block.derivative[:, i, i] for block, i in blocks)
    direction = np.random.default_rng(0).normal(size=z.shape)
    smooth = criterion in ("d", "a")
    h, rel = (1e-5, 1e-5) if smooth else (1e-6, 1e-4)
    matrices = (problem.information_matrix(z + s * h * direction) for s in (1, -1))
    ahead, behind = (objective(M, criterion) for M in matrices)
    expected = (ahead - behind) / (2 * h)
    assert gradient @ direction.ravel() == pytest.approx(expected, rel=rel, abs=1e-7 * smooth)


@pytest.mark.parametrize("criterion", ["d", "a"])
def test_hessian_along_linear_information(criterion: str) -> None:
    rng = np.random.default_rng(2)
    W = rng.normal(size=(30, 6))
    M, dM = W.T @ W, rng.normal(size=(4, 6, 6))
    dM = dM + np.swapaxes(dM, 1, 2)
    gradient, hessian = smooth_model(M, dM, criterion)
    assert np.linalg.eigvalsh(hessian).min() > -1e-12
    x = rng.normal(size=4)
    value = {"d": lambda A: objective(A, "d"), "a": lambda A: np.trace(np.linalg.inv(A))}[criterion]
    scale = 1.0 if criterion == "d" else value(M)
    h = 1e-3
    ahead, here, behind = (value(M + s * h * np.tensordot(x, dM, 1)) for s in (1, 0, -1))
    assert (ahead - behind) / (2 * h) == pytest.approx(scale * gradient @ x, rel=1e-3)
    assert (ahead - 2 * here + behind) / h**2 == pytest.approx(scale * x @ hessian @ x, rel=1e-3)


@pytest.mark.parametrize(
    ("friction", "uncertainty"), [((), 0.0), ((30.0,), 0.0), ((9.0, 3.0, 0.4), 0.3)]
)
@pytest.mark.parametrize("seed", [0, slow(1), slow(2), slow(3)])
def test_torque_peaks_are_those_of_continuous_time_and_rows_too(ur10, friction, uncertainty, seed):
    kinds = zip((CoulombFriction, ViscousFriction, RotorInertia), friction, strict=False)
    robot = ur10.with_effects([kind(ur10.joints, (value,) * 6) for kind, value in kinds])
    robot = limited(robot, mass_uncertainty=uncertainty)
    problem = build_design(robot, harmonics=3, columns="inertial")
    rng = np.random.default_rng(seed)
    z = problem.unknowns(random_trajectory(robot, rng, 10.0, 3))
    room = robot.limits.torque[0] / problem.torque_bound[0]
    peaks = torque_peaks(problem, z)
    exact = room * check(robot, problem.trajectory(z)).torque.ratio
    assert peaks.use.max() == pytest.approx(exact, rel=1e-3)
    rows, use = torque_rows(problem, z, -1.0)
    np.testing.assert_allclose(use, peaks.use, rtol=1e-9)
    direction, h = rng.normal(size=z.shape), 1e-6
    found = rows @ direction.ravel()
    size = 1e-6 + np.linalg.norm(rows, axis=1) * np.linalg.norm(direction)

    def sized(step: float) -> np.ndarray:
        """Use at the same instants, of the motion changed by a step."""
        motion = peaks.motion(problem, z + step * direction)
        tau = largest_torque(robot, motion)[np.arange(len(use)), peaks.joint]
        return np.abs(tau) / problem.torque_bound[peaks.joint]

    smooth = (peaks.side == 0) & (peaks.use > 0.1)
    still = (sized(h) - sized(-h)) / (2 * h)
    assert smooth.sum() >= 3
    assert np.all(np.abs(found - still)[smooth] < 1e-4 * size[smooth])
    ahead, behind = (torque_peaks(problem, z + s * h * direction) for s in (1, -1))
    turning = (peaks.side != 0) & (peaks.weight == 1) & (peaks.t > 0.3) & (peaks.t < 9.7)
    for k in np.flatnonzero(turning & (peaks.use > 0.1)):
        same = [
            p.use[(p.joint == peaks.joint[k]) & (p.side == peaks.side[k]) & near]
            for p, near in ((p, np.abs(p.t - peaks.t[k]) < 1e-3) for p in (ahead, behind))
        ]
        moved = float((same[0] - same[1])[0]) / (2 * h)
        assert abs(found[k] - moved) < 1e-3 * size[k]
    assert turning.any() == bool(friction)


def test_columns_that_say_nothing_of_their_own() -> None:
    W = np.random.default_rng(1).normal(size=(30, 3))
    W[:, 2] = W[:, 0] - W[:, 1]
    assert lone_torque(W.T @ W / 30).max() < 1e-6
    W[:, 2] = 0.0
    assert scaled_condition_number(W.T @ W) is None


@pytest.mark.filterwarnings("error")
def test_condition_number_of_a_singular_matrix_is_huge() -> None:
    assert 1e150 < condition_number(np.diag([1e76, 0.0])) < np.inf
