"""The semidefinite fit is optimal, physically consistent and fast, whatever the data say."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from excitant.exceptions import BadRobot, Infeasible
from excitant.identify.physical import (
    EffectPrior,
    PhysicalFit,
    fit_physical,
    link_coordinates,
    link_weights,
    prior_parameters,
)
from excitant.robots import Motion, Robot, base_parameters, load_robot
from excitant.robots.base_parameters import categories
from excitant.robots.effects import standard_effects
from excitant.robots.parameters import pseudo_inertia, violations
from excitant.robots.torque import observation_columns
from excitant.robots.urdf import robot_from_urdf

NONE = EffectPrior(*(np.zeros(0),) * 3)
KKT = 1e-8
NOISE = 1e-4  # N·m: so small that the prior hardly matters


def rows(robot: Robot, effects: tuple, n: int = 200, seed: int = 1) -> np.ndarray:
    motion = Motion(np.arange(n) / 100, *robot.random_motion(np.random.default_rng(seed), n))
    W = observation_columns(robot, effects, motion)
    return W.reshape(-1, W.shape[2])


def friction_prior(robot: Robot, effects: tuple) -> EffectPrior:
    parameters = [p for e in effects for p in e.parameters(robot)]
    zeros = np.zeros(len(parameters))
    return EffectPrior(zeros, zeros + 1e3, np.array([p.lower for p in parameters]))


def assert_optimal_and_consistent(fit: PhysicalFit, links: int) -> None:
    assert fit.kkt.stationarity <= KKT
    assert fit.kkt.complementarity <= KKT
    assert fit.kkt.primal <= KKT
    P = pseudo_inertia(fit.x[: 10 * links].reshape(links, 10))
    assert (np.linalg.eigvalsh(P)[:, 0] > 0).all()


@given(seed=st.integers(0, 10**6), noise=st.sampled_from([0.0, 0.1, 3.0]))
@settings(max_examples=8)
def test_optimal_and_consistent_whatever_the_data(seed: int, noise: float) -> None:
    robot, rng = load_robot("planar_2r"), np.random.default_rng(seed)
    effects = standard_effects(robot.joints)
    R = rows(robot, effects, seed=seed) / 0.5
    z = R[:, :20] @ robot.phi + noise * rng.standard_normal(len(R)) * np.abs(R).max()
    prior = prior_parameters(robot)
    effect_prior = friction_prior(robot, effects)
    fit = fit_physical(R, z, prior, effect_prior)
    assert_optimal_and_consistent(fit, robot.nv)
    assert (fit.x[20:] >= effect_prior.lower - KKT * np.abs(fit.x[20:]).max()).all()
    assert_no_feasible_descent(R, z, prior, effect_prior, fit, rng)


def objective(R: np.ndarray, z: np.ndarray, prior: np.ndarray, e: EffectPrior, x: np.ndarray):
    """Value of the docstring's problem, with Q from congruence rather than coordinates."""
    links = len(prior)
    total = float(((R @ x - z) ** 2).sum())
    for known, values in zip(prior, x[: 10 * links].reshape(links, 10), strict=True):
        L = np.linalg.inv(np.linalg.cholesky(pseudo_inertia(known)))
        total += float(((L @ pseudo_inertia(values) @ L.T - np.eye(4)) ** 2).sum())
    return total + float((((x[10 * links :] - e.mean) / e.std) ** 2).sum())


def assert_no_feasible_descent(R, z, prior, e, fit, rng) -> None:
    """Convexity: no step from the solution towards a feasible point lowers the objective."""
    links = len(prior)
    best = objective(R, z, prior, e, fit.x)
    scale = float(z @ z) + 1.0
    for _ in range(10):
        root = np.eye(4) + 0.5 * rng.standard_normal((links, 4, 4))
        Q = (root @ root.transpose(0, 2, 1))[:, *np.triu_indices(4)]
        other = np.concatenate(
            [link_coordinates(prior) @ Q.ravel(), rng.uniform(0, 3, len(e.mean))]
        )
        for step in (1e-3, 1e-1, 1.0):
            there = objective(R, z, prior, e, fit.x + step * (other - fit.x))
            assert there >= best - 1e-8 * scale


@pytest.mark.parametrize("name", ["planar_2r", "ur10", "panda"])
def test_noiseless_data_give_the_base_parameters(name: str) -> None:
    robot = load_robot(name)
    rng = np.random.default_rng(0)
    prior = prior_parameters(robot)
    factors = rng.uniform(0.7, 1.4, robot.nv)
    truth = (prior * factors[:, None]).ravel()
    base = base_parameters(robot)
    R = rows(robot, ()) / NOISE
    fit = fit_physical(R, R @ truth, prior, NONE)
    # the prior (σ = 1) pulls by its share of the precision, (std / σ)², std from the data
    std = np.sqrt(np.diag(np.linalg.inv(R[:, base.columns].T @ R[:, base.columns])))
    distance = np.abs(base.regrouping) @ np.abs(truth - prior.ravel())
    found, true = base.regrouping @ fit.x, base.regrouping @ truth
    assert np.abs(found - true).max() <= 1e-6 * np.abs(true).max()
    assert (std < 0.01 * np.maximum(distance, 1e-2)).all()
    assert_optimal_and_consistent(fit, robot.nv)


def test_data_that_no_body_can_make_give_a_body() -> None:
    robot = load_robot("planar_2r")
    impossible = np.array(robot.phi)
    impossible[10 + 9] -= 2 * impossible[10 + 9]  # Izz of the second link below zero
    R = np.diag(1 / np.maximum(np.abs(robot.phi), 1e-3)) / 1e-2  # every parameter is seen to 1 %
    z = R @ impossible
    unconstrained = np.linalg.lstsq(R, z, rcond=None)[0]
    [violation] = violations(unconstrained, robot.links)
    assert violation.startswith(robot.links[1])
    fit = fit_physical(R, z, prior_parameters(robot), NONE)
    assert violations(fit.x, robot.links) == []
    assert_optimal_and_consistent(fit, robot.nv)
    first = slice(0, 10)  # what was consistent stays, but for the pull of the prior: (1 % / 1)²
    np.testing.assert_allclose(fit.x[first], robot.phi[first], rtol=1e-3, atol=1e-4)


def test_what_no_torque_shows_is_known_by_the_prior_alone() -> None:
    """On the null space N of the data, (data + prior precision) N = prior precision · N."""
    robot = load_robot("panda")
    prior = prior_parameters(robot)
    base = base_parameters(robot)
    R = rows(robot, ()) / 0.1
    fit = fit_physical(R, R @ (1.2 * prior.ravel()), prior, NONE)
    T = np.linalg.inv(link_coordinates(prior)) * link_weights(robot.nv, 1.0)[:, None]
    null = base.null_space / np.linalg.norm(T @ base.null_space, axis=0)
    expected = T @ null
    np.testing.assert_allclose(T @ fit.covariance @ T.T @ expected, expected, atol=1e-5)
    # and the data move nothing along it: the gradient of the prior vanishes there
    step = T @ (fit.x - prior.ravel())
    assert np.abs(expected.T @ step).max() <= 1e-5 * np.linalg.norm(step)
    # and no prior makes a parameter less certain than the data alone
    unique = [k for k, c in enumerate(categories(base)) if c == "unique"]
    assert set(unique) <= set(base.columns)
    alone = np.linalg.inv(R[:, base.columns].T @ R[:, base.columns])
    std = dict(zip(base.columns, np.sqrt(np.diag(alone)), strict=True))
    assert unique
    assert all(fit.covariance[k, k] <= (1 + 1e-6) * std[k] ** 2 for k in unique)
    assert ((fit.prior_share >= 0) & (fit.prior_share <= 1)).all()


def test_without_data_the_prior_is_the_answer() -> None:
    prior = prior_parameters(load_robot("ur10"))
    fit = fit_physical(np.zeros((1, 60)), np.zeros(1), prior, NONE)
    np.testing.assert_allclose(fit.prior_share, 1.0, atol=1e-9)
    scale = np.abs(prior).max(axis=1, keepdims=True)
    np.testing.assert_allclose(fit.x.reshape(6, 10) / scale, prior / scale, atol=1e-6)


def test_a_link_without_mass_is_refused_by_name() -> None:
    urdf = load_robot("planar_2r").urdf
    start = urdf.index("<mass", urdf.index('<link name="link2"'))
    end = urdf.index("/>", start)
    robot = robot_from_urdf(urdf[:start] + '<mass value="0"' + urdf[end:], source="empty.urdf")
    with pytest.raises(BadRobot, match=r"link 'link2' has mass 0 kg.*give it a rough mass") as no:
        prior_parameters(robot)
    assert no.value.source == "empty.urdf"


def test_seven_joints_with_friction_are_solved_within_a_second() -> None:
    robot = load_robot("panda")
    effects = standard_effects(robot.joints)
    R = np.linalg.qr(rows(robot, effects, 1000), mode="r") / 0.1
    truth = np.concatenate([1.3 * robot.phi, np.full(28, 0.2)])
    z = R @ truth + np.random.default_rng(0).standard_normal(len(R))
    spent = []
    for _ in range(3):
        start = time.perf_counter()
        fit_physical(R, z, prior_parameters(robot), friction_prior(robot, effects))
        spent.append(time.perf_counter() - start)
    assert min(spent) < 1.0, spent


def exact_data(name: str, noise: float, spread: float) -> tuple:
    """A factor of whitened rows whose noise is far below that of any sensor, and a prior."""
    robot, rng = load_robot(name), np.random.default_rng(1)
    effects, links = standard_effects(robot.joints), 10 * robot.nv
    W = rows(robot, effects)
    tau = W[:, :links] @ (robot.phi * rng.normal(1, spread, links))
    z = tau / noise + rng.standard_normal(len(W))
    factor = np.linalg.qr(np.column_stack([W / noise, z]), mode="r")
    return factor[:, :-1], factor[:, -1], prior_parameters(robot), friction_prior(robot, effects)


@pytest.mark.parametrize(("name", "noise", "spread"), [("ur10", 1e-9, 0), ("panda", 1e-6, 3)])
def test_a_solver_at_the_end_of_its_digits_does_not_end_the_run(
    name: str, noise: float, spread: float
) -> None:
    """The conic solver ends inaccurately at every tolerance; the optimum is found all the same."""
    R, z, prior, effects = exact_data(name, noise, spread)
    fit = fit_physical(R, z, prior, effects)
    assert fit.kkt.primal <= 1e-6
    assert violations(fit.x[: prior.size], tuple("abcdefg"[: len(prior)])) == []
    best = objective(R, z, prior, effects, fit.x)
    target = np.linalg.norm(np.linalg.solve(link_coordinates(prior), fit.x[: prior.size]))
    rng = np.random.default_rng(0)
    for _ in range(20):  # convexity: no step towards another body lowers the objective
        root = np.eye(4) + 0.5 * rng.standard_normal((len(prior), 4, 4))
        Q = (root @ root.transpose(0, 2, 1))[:, *np.triu_indices(4)].ravel()
        other = np.concatenate(
            [link_coordinates(prior) @ Q * target / np.linalg.norm(Q), effects.mean]
        )
        for step in (1e-6, 1e-3, 1e-1):
            there = objective(R, z, prior, effects, fit.x + step * (other - fit.x))
            assert there >= best * (1 - 1e-6)


def test_what_no_scaling_solves_is_refused_in_one_line() -> None:
    R, z, prior, effects = exact_data("planar_2r", 1e-9, 3)
    with pytest.raises(Infeasible, match=r"wrong units or signs of torque$"):
        fit_physical(R, z, prior, effects)
