"""Free numbers for every body: the semidefinite minimiser, and effects of any shape."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from excitant.exceptions import BadInput
from excitant.identify.physical import fit_physical
from excitant.identify.prior import EffectPrior, prior_parameters
from excitant.identify.shapes import Descent, from_log_cholesky, to_log_cholesky
from excitant.robots import Array, Motion, load_robot
from excitant.robots.parameters import isotropic, pseudo_inertia, violations
from excitant.robots.regressor import regressor

NONE = EffectPrior(*(np.zeros(0),) * 3)
Torque = Callable[[Array], tuple[Array, Array]]
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


def descent(
    R: Array, z: Array, prior: Array, torque: Torque | None = None, known: EffectPrior = NONE
) -> Descent:
    torque = torque or (lambda _: (np.zeros(len(z)), np.zeros((len(z), 0))))
    return Descent(R, z, prior, known, lambda x: torque(x)[0], lambda x: torque(x)[1])


def fitted(problem: Descent) -> tuple[Array, Array]:
    """From the prior on, to the minimum."""
    return problem.fit(problem.prior, problem.known.mean, tolerance=1e-15)


@pytest.mark.parametrize("name", ["planar_2r", "ur10"])
def test_the_minimiser_is_that_of_the_semidefinite_fit(name: str) -> None:
    robot, rng = load_robot(name), np.random.default_rng(0)
    motion = Motion(np.arange(200) / 100, *robot.random_motion(rng, 200))
    prior = np.array([isotropic(values) for values in prior_parameters(robot)])
    R = regressor(robot, motion).reshape(-1, prior.size) / 0.5
    truth = (prior * rng.uniform(0.9, 1.1, (robot.nv, 1))).ravel()
    z = R @ truth + rng.standard_normal(len(R))
    convex = fit_physical(R, z, prior, NONE)
    Q = np.linalg.solve(pseudo_inertia(prior), pseudo_inertia(convex.x.reshape(-1, 10)))
    assert np.linalg.eigvals(Q).real.min() > 1e-2  # no constraint is near
    x, covariance = fitted(descent(R, z, prior))
    scale = np.sqrt(np.diag(convex.covariance))
    assert (np.abs(x - convex.x) <= 1e-5 * scale).all()
    np.testing.assert_allclose(
        covariance / np.outer(scale, scale),
        convex.covariance / np.outer(scale, scale),
        atol=1e-5,
    )


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
    robot, rng = load_robot("planar_2r"), np.random.default_rng(2)
    prior = prior_parameters(robot)
    dq = rng.uniform(0.1, 1, (30, 2))
    known = EffectPrior(np.full(8, 0.5), np.ones(8), np.zeros(8))
    R, z = rng.standard_normal((60, 20)), rng.standard_normal(60)
    problem = descent(R, z, prior, Stribeck(dq, 1.0), known)
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
    z = R @ prior.ravel() - 0.5 * column[:, 0]
    x, _ = fitted(descent(R, z, prior, lambda theta: (column @ theta, column), known))
    assert 0 <= x[20] < 1e-4  # viscous friction that drives is refused


def test_data_that_no_body_can_make_still_give_bodies() -> None:
    """The minimum lies on the edge of the cone, where no numbers are."""
    robot = load_robot("planar_2r")
    impossible = np.array(robot.phi)
    impossible[10 + 9] *= -1
    R = np.diag(1 / np.maximum(np.abs(robot.phi), 1e-3)) / 1e-2
    x, _ = fitted(descent(R, R @ impossible, prior_parameters(robot)))
    assert violations(x, robot.links) == []
