from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from excitant.design import build_design, check, condition_number, information, random_trajectory
from excitant.design.criterion import information_derivative, objective, smooth_model
from excitant.design.peaks import torque_derivatives, torque_peaks, torque_rows
from excitant.design.problem import DesignProblem
from excitant.design.step import local_model
from excitant.robots import Motion, Robot, load_robot, torque
from excitant.robots.base_parameters import base_parameters
from excitant.robots.effects import CoulombFriction, RotorInertia, ViscousFriction, standard_effects
from excitant.robots.torque import largest_torque


def problem_and_point(
    robot: Robot, columns: str, criterion: str
) -> tuple[DesignProblem, np.ndarray]:
    problem = build_design(robot, harmonics=3, columns=columns, criterion=criterion)
    rng = np.random.default_rng(5)
    return problem, problem.unknowns(random_trajectory(robot, rng, 10.0, 3))


def value(problem: DesignProblem, z: np.ndarray) -> float:
    return objective(problem.information_matrix(z), problem.criterion)


def test_what_rounded_angles_show_is_not_counted() -> None:
    """A right angle written as 1.5708 would raise the condition number a thousandfold."""
    arm = load_robot("panda")
    model = arm.model.copy()
    for placement in model.jointPlacements:
        roll, pitch, yaw = pin.rpy.matrixToRpy(placement.rotation)
        placement.rotation = pin.rpy.rpyToMatrix(*np.round([roll, pitch, yaw], 4))
    rounded = replace(arm, model=model)
    effects = standard_effects(arm.joints)
    assert len(base_parameters(rounded, effects)) > len(base_parameters(arm, effects))
    exact, seen = (information(robot, "friction") for robot in (arm, rounded))
    assert seen.base.columns == exact.base.columns
    motion = random_trajectory(arm, np.random.default_rng(0), 10.0, 5).sample(200)
    found, expected = (condition_number(each.matrix(motion)) for each in (seen, exact))
    assert found == pytest.approx(expected, rel=1e-2)


@pytest.mark.parametrize("columns", ["inertial", "friction"])
@pytest.mark.parametrize("name", ["planar_2r", "ur10"])
def test_derivative_of_information(columns: str, name: str, request: pytest.FixtureRequest) -> None:
    robot = request.getfixturevalue({"planar_2r": "planar", "ur10": "ur10"}[name])
    problem, z = problem_and_point(robot, columns, "condition")
    linear = problem.information.linearise(problem.sampled(z))
    r = len(problem.information.base)
    dM = information_derivative(linear, problem.sample_bases, np.eye(r))
    direction = np.random.default_rng(0).normal(size=z.shape)
    h = 1e-6
    ahead, behind = (problem.information_matrix(z + s * h * direction) for s in (1, -1))
    expected = (ahead - behind) / (2 * h)
    found = np.tensordot(direction.ravel(), dM, 1)
    assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()
    U = np.linalg.qr(np.random.default_rng(1).normal(size=(r, min(3, r))))[0]
    early = information_derivative(linear, problem.sample_bases, U)
    assert np.allclose(early, U.T @ dM @ U, rtol=0, atol=1e-12 * np.abs(dM).max() * r)


@pytest.mark.parametrize("criterion", ["d", "a", "condition", "e"])
def test_gradient_of_every_criterion(ur10: Robot, criterion: str) -> None:
    problem, z = problem_and_point(ur10, "inertial", criterion)
    model = local_model(problem, z)
    gradient = model.gradient + sum(
        block.sign * block.derivative[:, i, i]
        for block, i in zip(model.blocks, (0, -1), strict=False)
    )
    direction = np.random.default_rng(0).normal(size=z.shape)
    smooth = criterion in ("d", "a")
    h = 1e-5 if smooth else 1e-6
    ahead, behind = (value(problem, z + s * h * direction) for s in (1, -1))
    expected = (ahead - behind) / (2 * h)
    rel = 1e-5 if smooth else 1e-4
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


@pytest.mark.parametrize("uncertainty", [0.0, 0.3])
def test_torque_derivatives_with_effects(ur10: Robot, uncertainty: float) -> None:
    kinds = ((ViscousFriction, 3.0), (CoulombFriction, 2.0), (RotorInertia, 0.4))
    robot = ur10.with_effects([kind(ur10.joints, (value,) * 6) for kind, value in kinds])
    robot = robot.with_limits(replace(ur10.limits, mass_uncertainty=uncertainty))
    rng, h = np.random.default_rng(0), 1e-6
    motion = Motion(np.arange(6.0), *rng.normal(size=(3, 6, 6)))
    k = joint = np.arange(6)
    _, *parts = torque_derivatives(robot, motion, joint)
    for name, D in zip(("q", "dq", "ddq"), parts, strict=True):
        way = rng.normal(size=6)
        ahead, behind = (
            largest_torque(robot, replace(motion, **{name: getattr(motion, name) + s * h * way}))
            for s in (1, -1)
        )
        slope = (ahead - behind)[k, joint] / (2 * h)
        np.testing.assert_allclose(D[k, joint] @ way, slope, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("friction", [0.0, 30.0])
@pytest.mark.parametrize("seed", range(4))
def test_torque_peaks_are_those_of_continuous_time_and_rows_follow_them(
    ur10: Robot, friction: float, seed: int
) -> None:
    robot = ur10.with_effects([CoulombFriction(ur10.joints, (friction,) * 6)] if friction else ())
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
        tau = torque(robot, motion)[np.arange(len(use)), peaks.joint]
        return np.abs(tau) / problem.torque_bound[peaks.joint]

    smooth = (peaks.side == 0) & (peaks.use > 0.1)
    still = (sized(h) - sized(-h)) / (2 * h)
    assert smooth.sum() >= 3
    assert np.all(np.abs(found - still)[smooth] < 1e-4 * size[smooth])
    ahead, behind = (torque_peaks(problem, z + s * h * direction) for s in (1, -1))
    turning = (peaks.side != 0) & (peaks.weight == 1) & (peaks.t > 0.3) & (peaks.t < 9.7)
    for k in np.flatnonzero(turning & (peaks.use > 0.1)):
        there, back = (
            p.use[
                (p.joint == peaks.joint[k])
                & (p.side == peaks.side[k])
                & (np.abs(p.t - peaks.t[k]) < 1e-3)
            ]
            for p in (ahead, behind)
        )
        moved = float((there - back)[0]) / (2 * h)
        assert abs(found[k] - moved) < 1e-3 * size[k]
    assert turning.any() == (friction > 0)
