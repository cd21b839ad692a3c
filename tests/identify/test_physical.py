"""The semidefinite fit is optimal, physically consistent and fast, whatever the data and prior."""

from __future__ import annotations

import time

import numpy as np
import pinocchio as pin
import pytest
from known_arms import KKT, NONE, Call, Whitened, assert_optimal

from excitant.analysis import identifiability
from excitant.exceptions import BadRobot, Infeasible
from excitant.identify import identify_robot
from excitant.identify.knowledge import PRIORS, Knowledge, LinkKnowledge, Quantity
from excitant.identify.physical import PhysicalFit, fit_physical
from excitant.identify.prior import (
    follows,
    linear_influence,
    link_coordinates,
    link_weights,
    prior_parameters,
)
from excitant.robots import Array, Robot, base_parameters, load_robot
from excitant.robots.base_parameters import categories
from excitant.robots.parameters import pseudo_inertia, violations
from excitant.robots.urdf import robot_from_urdf
from excitant.robots.virtual_arm import industrial_sensors

KINDS = pytest.mark.parametrize("kind", PRIORS)


def assert_optimal_and_consistent(fit: PhysicalFit, robot: Robot) -> None:
    assert_optimal(fit)
    assert violations(fit.x[: 10 * robot.nv], robot.links) == []


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
    fit: PhysicalFit, arm: Whitened, z: Array, share: float, kind: str, sigma: float
) -> None:
    """Convexity: no step from the solution towards a feasible point lowers the objective."""
    rng, known, links = np.random.default_rng(0), arm.effects, arm.robot.nv

    def value(x: Array) -> float:
        """The docstring's objective, its bodies from φ alone."""
        bodies, theta = np.split(x, [arm.links])
        misfit = ((arm.R @ x - z) ** 2).sum() + (((theta - known.mean) / known.std) ** 2).sum()
        return float(misfit + distance(kind, arm.prior, bodies) / sigma**2)

    best, T = value(fit.x), link_coordinates(arm.prior)
    size = np.linalg.norm(np.linalg.solve(T, fit.x[: arm.links]))
    for _ in range(20):
        root = np.eye(4) + 0.5 * rng.standard_normal((links, 4, 4))
        Q = (root @ root.transpose(0, 2, 1))[:, *np.triu_indices(4)].ravel()
        body = T @ Q * max(1.0, size / np.linalg.norm(Q))
        other = np.concatenate([body, rng.uniform(0, 3, len(known.mean))])
        for step in (1e-6, 1e-4, 1e-2, 0.5):
            assert value(fit.x + step * (other - fit.x)) >= best - share * abs(best)


@KINDS
@pytest.mark.parametrize(("name", "noise"), [("ur10", 0.0), ("ur10", 200.0), ("planar_2r", 300.0)])
def test_no_body_near_the_solution_is_better(kind: str, name: str, noise: float) -> None:
    """Optimal by its own conditions, and by values of the objective at other bodies."""
    arm, rng = Whitened(name, 0.1), np.random.default_rng(1)
    truth = (arm.prior * rng.uniform(0.6, 1.5, (arm.robot.nv, 1))).ravel()
    z = arm.R[:, : arm.links] @ truth + (1.0 + noise) * rng.standard_normal(len(arm.R))
    fit = arm.fit(z, Knowledge(kind), 0.5)
    assert_optimal_and_consistent(fit, arm.robot)
    theta = fit.x[arm.links :]
    assert (theta >= arm.effects.lower - KKT * np.abs(theta).max()).all()
    assert_no_feasible_descent(fit, arm, z, 1e-9, kind, 0.5)


@pytest.mark.parametrize("name", ["planar_2r", "ur10", "panda"])
def test_noiseless_data_give_the_base_parameters(name: str) -> None:
    arm, rng = Whitened(name, 1e-4, effects=False), np.random.default_rng(0)  # N·m
    truth = (arm.prior * rng.uniform(0.7, 1.4, (arm.robot.nv, 1))).ravel()
    fit, base = arm.fit(arm.R @ truth), base_parameters(arm.robot)
    # the prior (σ = 1) pulls by its share of the precision, (std / σ)², std from the data
    shown = arm.R[:, base.columns]
    std = np.sqrt(np.diag(np.linalg.inv(shown.T @ shown)))
    distance = np.abs(base.regrouping) @ np.abs(truth - arm.prior.ravel())
    found, true = base.regrouping @ fit.x, base.regrouping @ truth
    assert np.abs(found - true).max() <= 1e-6 * np.abs(true).max()
    assert (std < 0.01 * np.maximum(distance, 1e-2)).all()
    assert_optimal_and_consistent(fit, arm.robot)


def test_data_that_no_body_can_make_give_a_body() -> None:
    robot = load_robot("planar_2r")
    impossible = np.array(robot.phi)
    impossible[10 + 9] *= -1  # Izz of the second link below zero
    [violation] = violations(impossible, robot.links)
    assert violation.startswith(robot.links[1])
    R = np.diag(1 / np.maximum(np.abs(robot.phi), 1e-3)) / 1e-2  # every parameter is seen to 1 %
    fit = fit_physical(R, R @ impossible, prior_parameters(robot), NONE)
    assert_optimal_and_consistent(fit, robot)
    first = slice(0, 10)  # what was consistent stays, but for the pull of the prior: (1 % / 1)²
    np.testing.assert_allclose(fit.x[first], robot.phi[first], rtol=1e-3, atol=1e-4)


def test_what_no_torque_shows_is_known_by_the_prior_alone() -> None:
    """On the null space N of the data, (data + prior precision) N = prior precision · N."""
    arm = Whitened("panda", 0.1, effects=False)
    base, prior = base_parameters(arm.robot), arm.prior
    fit = arm.fit(arm.R @ (1.2 * prior.ravel()))
    T = np.linalg.inv(link_coordinates(prior)) * link_weights(arm.robot.nv, 1.0)[:, None]
    expected = T @ (base.null_space / np.linalg.norm(T @ base.null_space, axis=0))
    np.testing.assert_allclose(T @ fit.covariance @ T.T @ expected, expected, atol=1e-5)
    # and the data move nothing along it: the gradient of the prior vanishes there
    step = T @ (fit.x - prior.ravel())
    assert np.abs(expected.T @ step).max() <= 1e-5 * np.linalg.norm(step)
    # and no prior makes a parameter less certain than the data alone
    unique = [k for k, c in enumerate(categories(base)) if c == "unique"]
    assert set(unique) <= set(base.columns)
    shown = arm.R[:, base.columns]
    std = dict(zip(base.columns, np.sqrt(np.diag(np.linalg.inv(shown.T @ shown))), strict=True))
    assert unique
    assert all(fit.covariance[k, k] <= (1 + 1e-6) * std[k] ** 2 for k in unique)
    assert ((fit.prior_share >= 0) & (fit.prior_share <= 1)).all()


@KINDS
def test_without_data_every_prior_is_its_own_answer(kind: str) -> None:
    prior = prior_parameters(load_robot("ur10"))
    fit = fit_physical(np.zeros((1, 60)), np.zeros(1), prior, NONE, knowledge=Knowledge(kind))
    scale = np.abs(prior).max(axis=1, keepdims=True)
    np.testing.assert_allclose(fit.x.reshape(6, 10) / scale, prior / scale, atol=1e-6)
    np.testing.assert_allclose(fit.prior_share, 1.0, atol=1e-6)


@pytest.mark.parametrize(
    ("kind", "least", "most"), [("pullback", 0.0, 1e-5), ("euclidean", 1e-3, np.inf)]
)
def test_coordinates_matter_to_one_prior_alone(kind: str, least: float, most: float) -> None:
    """A body seen in another frame: the pull-back agrees with itself, the euclidean does not."""
    prior = prior_parameters(load_robot("ur10"))[1:2]
    place = pin.SE3(pin.exp3(np.array([0.3, -0.5, 0.8])), np.array([0.1, -0.2, 0.3]))

    def moved(phi: Array) -> Array:
        """The same body about the new frame."""
        return place.act(pin.Inertia.FromDynamicParameters(phi)).toDynamicParameters()

    rng = np.random.default_rng(3)
    R = rng.standard_normal((4, 10)) / np.abs(prior[0]).max()
    z = R @ (1.4 * prior[0]) + 0.1
    one = fit_physical(R, z, prior, NONE, knowledge=Knowledge(kind)).x
    M = np.array([moved(prior[0] + e) - moved(prior[0]) for e in np.eye(10)]).T
    R2, prior2 = R @ np.linalg.inv(M), moved(prior[0])[None]
    two = fit_physical(R2, z, prior2, NONE, knowledge=Knowledge(kind)).x
    assert least <= np.abs(two - moved(one)).max() / np.abs(one).max() < most


def test_a_link_without_mass_is_refused_by_name() -> None:
    urdf = load_robot("planar_2r").urdf
    start = urdf.index("<mass", urdf.index('<link name="link2"'))
    end = urdf.index("/>", start)
    robot = robot_from_urdf(urdf[:start] + '<mass value="0"' + urdf[end:], source="empty.urdf")
    with pytest.raises(BadRobot, match=r"link 'link2' has mass 0 kg.*give it a rough mass") as no:
        prior_parameters(robot)
    assert no.value.source == "empty.urdf"


def test_seven_joints_with_friction_are_solved_within_a_second() -> None:
    arm, spent = Whitened("panda", 0.1, n=1000), []
    arm.R = np.linalg.qr(arm.R, mode="r")
    truth = np.concatenate([1.3 * arm.robot.phi, np.full(28, 0.2)])
    z = arm.R @ truth + np.random.default_rng(0).standard_normal(len(arm.R))
    for _ in range(3):
        start = time.perf_counter()
        arm.fit(z)
        spent.append(time.perf_counter() - start)
    assert min(spent) < 1.0, spent


def exact_data(name: str, noise: float, spread: float) -> tuple[Whitened, Array]:
    """Whitened rows and torque whose noise is far below that of any sensor."""
    arm, rng = Whitened(name, noise), np.random.default_rng(1)
    truth = arm.robot.phi * rng.normal(1, spread, arm.links)
    z = arm.R[:, : arm.links] @ truth + rng.standard_normal(len(arm.R))
    factor = np.linalg.qr(np.column_stack([arm.R, z]), mode="r")
    arm.R = factor[:, :-1]
    return arm, factor[:, -1]


@pytest.mark.parametrize(("name", "noise", "spread"), [("ur10", 1e-9, 0), ("panda", 1e-6, 3)])
def test_a_solver_out_of_digits_ends_no_run(name: str, noise: float, spread: float) -> None:
    """The conic solver ends inaccurately at every tolerance; the optimum is found all the same."""
    arm, z = exact_data(name, noise, spread)
    fit = arm.fit(z)
    assert fit.kkt.primal <= 1e-6
    assert violations(fit.x[: arm.links], arm.robot.links) == []
    assert_no_feasible_descent(fit, arm, z, 1e-6, "pullback", 1.0)


def test_what_no_scaling_solves_is_refused_in_one_line() -> None:
    arm, z = exact_data("planar_2r", 1e-9, 3)
    with pytest.raises(Infeasible, match=r"wrong units or signs of torque$"):
        arm.fit(z)


SUM = np.vstack([np.eye(10)[0] + np.eye(10)[1], np.eye(10)[2:]])


@pytest.mark.parametrize(
    ("R", "second", "least", "most"),
    [
        (1e3 * np.eye(10), 2.0, np.zeros(10), np.full(10, 1e-3)),  # all is seen
        (np.zeros((1, 10)), 2.0, np.ones(10), np.ones(10)),  # nothing is
        # a sum is seen: deviations of its members shrink to 0.3 and 0.95; both follow the prior
        (1e4 * SUM, 0.33, [0.99, 0.99, *(0,) * 8], [1, 1, *(1e-3,) * 8]),
        (1e4 * SUM, 0.05, [0, 0.5, *(0,) * 8], [0.5, 1, *(1e-3,) * 8]),  # of one large member
    ],
)
def test_who_decides_an_entry(R: Array, second: float, least: Array, most: Array) -> None:
    influence = linear_influence(R, np.diag([1.0, second, *(1.0,) * 8]), np.ones(10), 1)
    assert (influence >= np.array(least) - 1e-7).all()
    assert (influence <= np.array(most) + 1e-7).all()


def test_kinds_that_hardly_reach_an_entry_do_not_count() -> None:
    ratio = np.array([[1.0, 1.0, np.nan], [0.2, 0.2, 0.2]])
    reach = np.array([[0.24, 0.26, np.nan], [1.0, 1.0, 1.0]])
    np.testing.assert_allclose(follows(ratio, reach), [0.2, 1.0, 0.2])


@KINDS
def test_the_root_is_that_of_the_prior_covariance(kind: str) -> None:
    rng, prior = np.random.default_rng(0), prior_parameters(load_robot("planar_2r"))
    R = rng.normal(size=(20, 20)) / np.abs(prior).max() * 30
    fit = fit_physical(R, R @ prior.ravel(), prior, NONE, knowledge=Knowledge(kind))
    expected = np.linalg.inv(R.T @ R + np.linalg.inv(fit.root @ fit.root.T))
    scale = np.sqrt(np.diag(expected))
    relative = (fit.covariance - expected) / np.outer(scale, scale)
    np.testing.assert_allclose(relative, 0, atol=1e-6)


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


def test_identify_and_analyze_say_the_same(planar: Robot, runs: Call) -> None:
    [recording, _] = runs(planar, 3, sensors=industrial_sensors(planar))
    found = identify_robot(planar, [recording])
    parameters = found.result()["parameters"]
    said = {p["name"]: p["prior_dominated"] for p in parameters}
    analysis = identifiability.analyze(
        planar, effects=found.model.effects, estimate=found, rng=np.random.default_rng(0)
    )
    rows = [p for link in analysis.result()["links"] for p in link["parameters"]]
    clear = [r for r in rows if r["decided_by"] and abs(r["prior_influence"] - 0.5) > 0.25]
    assert len(clear) > 15
    for row in clear:
        if row["decided_by"] != "physics":  # which only repeated fits tell from the prior
            assert said[row["name"]] == row["prior_dominated"], row
    missed = {
        p["name"]
        for p, share in zip(parameters, found.physical.prior_share, strict=True)
        if p["category"] == "combined" and p["prior_dominated"] and share < 0.5
    }
    assert all(p["prior_dominated"] for p in rows if p["name"] in missed)
