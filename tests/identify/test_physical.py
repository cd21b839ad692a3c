"""The semidefinite fit is optimal, physically consistent and fast, whatever the data and prior."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest
import scipy.linalg

from excitant.analysis import identifiability
from excitant.exceptions import BadRobot, Infeasible
from excitant.identify import Recording, identify_robot
from excitant.identify.knowledge import PRIORS, Knowledge, LinkKnowledge, Quantity
from excitant.identify.physical import PhysicalFit, fit_physical
from excitant.identify.prior import (
    EffectPrior,
    follows,
    linear_influence,
    link_coordinates,
    link_weights,
    prior_parameters,
)
from excitant.robots import Array, Motion, Robot, base_parameters, load_robot
from excitant.robots.base_parameters import categories
from excitant.robots.effects import standard_effects
from excitant.robots.parameters import pseudo_inertia, violations
from excitant.robots.torque import observation_columns
from excitant.robots.urdf import robot_from_urdf
from excitant.robots.virtual_arm import industrial_sensors

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


def distance(kind: str, prior: Array, x: Array) -> float:
    """Distance to the prior as in the docstring, from φ alone."""
    total = 0.0
    for known, values in zip(prior, x.reshape(prior.shape), strict=True):
        P0, P = pseudo_inertia(known), pseudo_inertia(values)
        if kind == "pullback":
            L = np.linalg.inv(np.linalg.cholesky(P0))
            total += float(((L @ P @ L.T - np.eye(4)) ** 2).sum())
        else:
            r = np.sqrt(np.trace(P0[:3, :3]) / known[0])
            units = known[0] * np.array([1, r, r, r, *(r**2,) * 6])
            total += float((((values - known) / units) ** 2).sum())
    return total


def assert_no_feasible_descent(
    fit: PhysicalFit, data: tuple[Array, Array, Array, EffectPrior], kind: str, sigma: float,
    share: float,
) -> None:  # fmt: skip
    """Convexity: no step from the solution towards a feasible point lowers the objective."""
    (R, z, prior, effects), rng = data, np.random.default_rng(0)

    def value(x: Array) -> float:
        """The docstring's objective, its bodies from φ alone."""
        known = (((x[prior.size :] - effects.mean) / effects.std) ** 2).sum()
        misfit = ((R @ x - z) ** 2).sum()
        return float(misfit + distance(kind, prior, x[: prior.size]) / sigma**2 + known)

    best, links, T = value(fit.x), len(prior), link_coordinates(prior)
    size = np.linalg.norm(np.linalg.solve(T, fit.x[: prior.size]))
    for _ in range(20):
        root = np.eye(4) + 0.5 * rng.standard_normal((links, 4, 4))
        Q = (root @ root.transpose(0, 2, 1))[:, *np.triu_indices(4)].ravel()
        body = T @ Q * max(1.0, size / np.linalg.norm(Q))
        other = np.concatenate([body, rng.uniform(0, 3, len(effects.mean))])
        for step in (1e-6, 1e-4, 1e-2, 0.5):
            assert value(fit.x + step * (other - fit.x)) >= best - share * abs(best)


@pytest.mark.parametrize("kind", PRIORS)
@pytest.mark.parametrize(("name", "noise"), [("ur10", 0.0), ("ur10", 200.0), ("planar_2r", 300.0)])
def test_no_body_near_the_solution_is_better(kind: str, name: str, noise: float) -> None:
    """Optimal by its own conditions, and by values of the objective at other bodies."""
    robot, rng = load_robot(name), np.random.default_rng(1)
    effects = standard_effects(robot.joints)
    R, known = rows(robot, effects) / 0.1, friction_prior(robot, effects)
    prior = prior_parameters(robot)
    truth = (prior * rng.uniform(0.6, 1.5, (robot.nv, 1))).ravel()
    z = R[:, : prior.size] @ truth + (1.0 + noise) * rng.standard_normal(len(R))
    fit = fit_physical(R, z, prior, known, 0.5, knowledge=Knowledge(kind))
    assert_optimal_and_consistent(fit, robot.nv)
    assert (fit.x[prior.size :] >= known.lower - KKT * np.abs(fit.x[prior.size :]).max()).all()
    assert_no_feasible_descent(fit, (R, z, prior, known), kind, 0.5, 1e-9)


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


@pytest.mark.parametrize("kind", PRIORS)
def test_without_data_every_prior_is_its_own_answer(kind: str) -> None:
    prior = prior_parameters(load_robot("ur10"))
    fit = fit_physical(np.zeros((1, 60)), np.zeros(1), prior, NONE, knowledge=Knowledge(kind))
    scale = np.abs(prior).max(axis=1, keepdims=True)
    np.testing.assert_allclose(fit.x.reshape(6, 10) / scale, prior / scale, atol=1e-6)
    np.testing.assert_allclose(fit.prior_share, 1.0, atol=1e-6)


def test_coordinates_matter_to_the_euclidean_prior_alone() -> None:
    """A body seen in another frame: the pull-back agrees with itself, the euclidean does not."""
    prior = prior_parameters(load_robot("ur10"))[1:2]
    turn = scipy.linalg.expm(np.cross(np.eye(3), [0.3, -0.5, 0.8]))
    G = np.eye(4)
    G[:3, :3], G[:3, 3] = turn, [0.1, -0.2, 0.3]
    B = np.array([pseudo_inertia(e) for e in np.eye(10)])
    moved = np.einsum("ab,kbc,dc->kad", G, B, G)
    basis = np.array([b.ravel() for b in B]).T
    M = np.linalg.lstsq(basis, moved.reshape(10, 16).T, rcond=None)[0]  # φ in the new frame
    rng = np.random.default_rng(3)
    R = rng.standard_normal((4, 10)) / np.abs(prior[0]).max()
    z = R @ (1.4 * prior[0]) + 0.1
    gaps = {}
    for kind in PRIORS:
        one = fit_physical(R, z, prior, NONE, knowledge=Knowledge(kind)).x
        R2 = R @ np.linalg.inv(M)
        two = fit_physical(R2, z, (M @ prior[0])[None], NONE, knowledge=Knowledge(kind)).x
        gaps[kind] = np.abs(two - M @ one).max() / np.abs(one).max()
    assert gaps["pullback"] < 1e-5
    assert gaps["euclidean"] > 1e-3


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
    data = exact_data(name, noise, spread)
    fit, prior = fit_physical(*data), data[2]
    assert fit.kkt.primal <= 1e-6
    assert violations(fit.x[: prior.size], tuple("abcdefg"[: len(prior)])) == []
    assert_no_feasible_descent(fit, data, "pullback", 1.0, 1e-6)


def test_what_no_scaling_solves_is_refused_in_one_line() -> None:
    with pytest.raises(Infeasible, match=r"wrong units or signs of torque$"):
        fit_physical(*exact_data("planar_2r", 1e-9, 3))


def test_data_that_show_everything_decide_everything_and_none_nothing() -> None:
    L = np.diag(np.arange(1.0, 11))
    assert (linear_influence(1e3 * np.eye(10), L, np.ones(10), 1) < 1e-3).all()
    np.testing.assert_allclose(linear_influence(np.zeros((1, 10)), L, np.ones(10), 1), 1.0)


def test_a_sum_that_is_seen_leaves_its_members_to_the_prior() -> None:
    """Their deviations shrink to 0.3 and 0.95 of the prior's; both still follow it."""
    R = np.zeros((9, 10))
    R[0, :2] = 1e4
    R[1:, 2:] = 1e4 * np.eye(8)
    L = np.diag([1.0, 0.33, *(1.0,) * 8])
    posterior = np.linalg.inv(R.T @ R + np.linalg.inv(L @ L.T))
    assert np.sqrt(posterior[0, 0]) < 0.5  # of the prior's: once taken for the data's
    influence = linear_influence(R, L, np.ones(10), 1)
    assert (influence[:2] > 0.99).all()
    assert (influence[2:] < 1e-3).all()
    # a sum of one large member is decided by the data
    influence = linear_influence(R, np.diag([1.0, 0.05, *(1.0,) * 8]), np.ones(10), 1)
    assert influence[0] < 0.5 < influence[1]


def test_kinds_that_hardly_reach_an_entry_do_not_count() -> None:
    ratio = np.array([[1.0, 1.0, np.nan], [0.2, 0.2, 0.2]])
    reach = np.array([[0.24, 0.26, np.nan], [1.0, 1.0, 1.0]])
    np.testing.assert_allclose(follows(ratio, reach), [0.2, 1.0, 0.2])


@pytest.mark.parametrize("kind", ["pullback", "euclidean"])
def test_the_root_is_that_of_the_prior_covariance(kind: str) -> None:
    robot, rng = load_robot("planar_2r"), np.random.default_rng(0)
    prior = prior_parameters(robot)
    R = rng.normal(size=(20, 20)) / np.abs(prior).max() * 30
    fit = fit_physical(R, R @ prior.ravel(), prior, NONE, knowledge=Knowledge(kind))
    expected = np.linalg.inv(R.T @ R + np.linalg.inv(fit.root @ fit.root.T))
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        fit.covariance / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-6
    )


def test_what_is_known_exactly_is_the_priors() -> None:
    robot = load_robot("planar_2r")
    prior = prior_parameters(robot)
    known = Knowledge(links={robot.links[0]: LinkKnowledge(mass=Quantity(2.0))})
    R = 1e7 * np.eye(20)
    body = prior * np.array([[2.0 / prior[0, 0]], [1.0]])
    fit = fit_physical(R, R @ body.ravel(), prior, NONE, knowledge=known, links=robot.links)
    assert fit.influence[0] == 1.0
    assert fit.root.shape == (20, 19)
    assert (fit.influence[1:] < 0.1).all()


def test_identify_and_analyze_say_the_same(
    planar: Robot, runs: Callable[..., list[Recording]]
) -> None:
    [recording, _] = runs(planar, 3, sensors=industrial_sensors(planar))
    found = identify_robot(planar, [recording])
    said = {p["name"]: p["prior_dominated"] for p in found.result()["parameters"]}
    analysis = identifiability.analyze(
        planar, effects=found.model.effects, estimate=found, rng=np.random.default_rng(0)
    )
    rows = [p for link in analysis.result()["links"] for p in link["parameters"]]
    clear = [r for r in rows if r["decided_by"] and abs(r["prior_influence"] - 0.5) > 0.25]
    assert len(clear) > 15
    for row in clear:
        if row["decided_by"] != "physics":  # which only repeated fits tell from the prior
            assert said[row["name"]] == row["prior_dominated"], row
    missed = [
        p["name"]
        for k, p in enumerate(found.result()["parameters"])
        if p["category"] == "combined" and said[p["name"]] and found.physical.prior_share[k] < 0.5
    ]
    assert all(p["prior_dominated"] for p in rows if p["name"] in missed)
