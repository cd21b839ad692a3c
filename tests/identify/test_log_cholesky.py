"""Free numbers for every body: the semidefinite minimiser, and effects of any shape."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from excitant.exceptions import BadInput
from excitant.identify.log_cholesky import (
    NonlinearEffects,
    TorqueModel,
    from_log_cholesky,
    refine_log_cholesky,
    to_log_cholesky,
)
from excitant.identify.physical import PhysicalFit, fit_physical
from excitant.identify.prior import EffectPrior, prior_parameters
from excitant.robots import Array, Motion, load_robot
from excitant.robots.parameters import isotropic, pseudo_inertia, violations
from excitant.robots.regressor import regressor

NONE = EffectPrior(*(np.zeros(0),) * 3)
NUMBERS = st.lists(st.floats(-2, 2), min_size=10, max_size=10).map(np.array)


@given(NUMBERS)
def test_any_numbers_make_a_body_and_come_back(numbers: Array) -> None:
    phi, J = from_log_cholesky(numbers)
    assert violations(phi, ("body",)) == []
    P = pseudo_inertia(phi)
    condition = np.linalg.cond(P)
    np.testing.assert_allclose(to_log_cholesky(phi), numbers, atol=1e-14 * condition + 1e-12)
    for k in range(10):
        step = 1e-6 * np.eye(10)[k]
        change = from_log_cholesky(numbers + step)[0] - from_log_cholesky(numbers - step)[0]
        np.testing.assert_allclose(J[:, k], change / 2e-6, atol=1e-8 * np.abs(P).max())


def test_the_numbers_are_those_of_the_paper() -> None:
    a, d1, d2, d3, s12, s23, s13, t1, t2, t3 = numbers = np.linspace(-0.4, 0.5, 10)
    U = np.exp(a) * np.array(
        [[np.exp(d1), s12, s13, t1], [0, np.exp(d2), s23, t2], [0, 0, np.exp(d3), t3], [0, 0, 0, 1]]
    )
    P = pseudo_inertia(from_log_cholesky(numbers)[0])
    np.testing.assert_allclose(P, U @ U.T, rtol=1e-12)


def test_a_body_that_cannot_be_has_no_numbers() -> None:
    with pytest.raises(BadInput, match="no body of positive density"):
        to_log_cholesky(np.array([1.0, 0, 0, 0, 1, 0, 1, 0, 0, 3]))


def nonlinear(
    torque: TorqueModel, known: EffectPrior, start: Array | None = None
) -> NonlinearEffects:
    return NonlinearEffects(
        torque, known, known.mean if start is None else start, lambda theta: torque(theta)[0]
    )


def fitted(
    R: Array, z: Array, prior: Array, effects: NonlinearEffects, sigma: float = 1.0
) -> PhysicalFit:
    """From the prior on, to the minimum."""
    return refine_log_cholesky(R, z, prior, effects, prior, sigma, tolerance=1e-15)[0]


def silent(rows: int) -> NonlinearEffects:
    return nonlinear(lambda theta: (np.zeros(rows), np.zeros((rows, 0))), NONE)


@pytest.mark.parametrize("name", ["planar_2r", "ur10"])
def test_the_minimiser_is_that_of_the_semidefinite_fit(name: str) -> None:
    robot, rng = load_robot(name), np.random.default_rng(0)
    motion = Motion(np.arange(200) / 100, *robot.random_motion(rng, 200))
    prior = np.array([isotropic(values) for values in prior_parameters(robot)])
    R = regressor(robot, motion).reshape(-1, prior.size) / 0.5
    truth = (prior * rng.uniform(0.9, 1.1, (robot.nv, 1))).ravel()
    z = R @ truth + rng.standard_normal(len(R))
    convex = fit_physical(R, z, prior, NONE, 0.5)
    Q = np.linalg.solve(pseudo_inertia(prior), pseudo_inertia(convex.x.reshape(-1, 10)))
    assert np.linalg.eigvals(Q).real.min() > 1e-2  # no constraint is near
    free = fitted(R, z, prior, silent(len(z)), 0.5)
    assert free.kkt.stationarity < 1e-7
    scale = np.sqrt(np.diag(convex.covariance))
    assert (np.abs(free.x - convex.x) <= 1e-5 * scale).all()
    np.testing.assert_allclose(
        free.covariance / np.outer(scale, scale),
        convex.covariance / np.outer(scale, scale),
        atol=1e-5,
    )
    np.testing.assert_allclose(free.prior_share, convex.prior_share, atol=1e-5)


class Stribeck:
    """Coulomb, viscous and Stribeck friction of two joints: θ = (Fc, Fv, Fs, v_s) of each."""

    def __init__(self, dq: Array, noise: float) -> None:
        self.dq, self.noise = dq, noise

    def __call__(self, theta: Array) -> tuple[Array, Array]:
        n = len(self.dq)
        tau, J = np.zeros((n, 2)), np.zeros((n, 2, 8))
        for j, (fc, fv, fs, vs) in enumerate(theta.reshape(2, 4)):
            v = self.dq[:, j]
            side, bell = np.tanh(v / 1e-3), np.exp(-((v / vs) ** 2))
            tau[:, j] = fc * side + fv * v + fs * bell * side
            J[:, j, 4 * j : 4 * j + 4] = np.column_stack(
                [side, v, bell * side, fs * side * bell * 2 * v**2 / vs**3]
            )
        return tau.ravel() / self.noise, J.reshape(2 * n, 8) / self.noise


def test_the_jacobian_of_the_whole_is_exact() -> None:
    from excitant.identify.log_cholesky import _Problem

    robot, rng = load_robot("planar_2r"), np.random.default_rng(2)
    prior = prior_parameters(robot)
    dq = rng.uniform(0.1, 1, (30, 2))
    known = EffectPrior(np.full(8, 0.5), np.ones(8), np.zeros(8))
    R, z = rng.standard_normal((60, 20)), rng.standard_normal(60)
    problem = _Problem(R, z, prior, nonlinear(Stribeck(dq, 1.0), known), 0.7)
    numbers = [to_log_cholesky(values) for values in prior]
    at = np.concatenate([*numbers, known.mean]) + 0.1 * rng.standard_normal(28)
    J = problem.jacobian(at)
    for k in range(28):
        step = 1e-6 * np.eye(28)[k]
        change = (problem.residual(at + step) - problem.residual(at - step)) / 2e-6
        np.testing.assert_allclose(J[:, k], change, atol=1e-7 * (1 + np.abs(J).max()))


def test_signs_of_effects_hold() -> None:
    robot, rng = load_robot("planar_2r"), np.random.default_rng(3)
    prior = prior_parameters(robot)
    motion = Motion(np.arange(100) / 100, *robot.random_motion(rng, 100))
    R = regressor(robot, motion).reshape(-1, 20)
    column = np.zeros((100, 2, 1))
    column[:, 0, 0] = motion.dq[:, 0]
    column = column.reshape(200, 1)
    known = EffectPrior(np.zeros(1), np.full(1, 10.0), np.zeros(1))
    effects = nonlinear(lambda theta: (column @ theta, column), known)
    fit = fitted(R, R @ prior.ravel() - 0.5 * column[:, 0], prior, effects)
    assert 0 <= fit.x[20] < 1e-4  # viscous friction that drives is refused


def test_what_does_not_fit_is_refused() -> None:
    prior = prior_parameters(load_robot("planar_2r"))
    with pytest.raises(BadInput, match=r"expected \(5, 20\)"):
        fitted(np.zeros((4, 20)), np.zeros(5), prior, silent(5))


def test_data_that_no_body_can_make_are_not_taken_for_solved() -> None:
    """The minimum lies on the edge of the cone, where no numbers are."""
    robot = load_robot("planar_2r")
    impossible = np.array(robot.phi)
    impossible[10 + 9] *= -1
    R = np.diag(1 / np.maximum(np.abs(robot.phi), 1e-3)) / 1e-2
    fit = fitted(R, R @ impossible, prior_parameters(robot), silent(20))
    assert violations(fit.x, robot.links) == []
    assert fit.kkt.stationarity > 1e-6
