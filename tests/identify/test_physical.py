"""The semidefinite fit is optimal, consistent and fast, whatever the data, prior and knowledge."""

import time
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml
from known_arms import NONE, Call, Whitened, write_csv
from marks import refused, slow
from scipy.optimize import nnls

from excitant.analysis import identifiability
from excitant.exceptions import BadInput
from excitant.identify import identify_robot, load_knowledge
from excitant.identify.knowledge import Box, Knowledge, LinkKnowledge, Quantity
from excitant.identify.physical import PhysicalFit, agreement, fit_physical, fit_program
from excitant.identify.prior import (
    BodyPrior,
    EffectPrior,
    follows,
    linear_influence,
    link_coordinates,
    link_weights,
    prior_parameters,
)
from excitant.identify.semidefinite import together
from excitant.robots import Array, Robot, base_parameters, load_robot
from excitant.robots.base_parameters import categories
from excitant.robots.parameters import from_pseudo_inertia, pseudo_inertia, violations
from excitant.robots.virtual_arm import industrial_sensors

KKT, NOTHING = 1e-8, Knowledge()


def assert_optimal_and_consistent(
    fit: PhysicalFit, arm: Whitened, z: Array, known: Knowledge = NOTHING
) -> None:
    """Multipliers, none of an inequality negative, balance the gradient, and vanish where slack."""
    links = arm.robot.links
    program, scale, _ = fit_program(arm.R, z, fit.prior, arm.effects, known, links)
    y = np.linalg.solve(scale, fit.x)
    J, residual = program.prior(y)
    gradient = program.A.T @ (program.A @ y - z) + J.T @ residual
    size = np.linalg.norm(program.A.T @ z) + 1
    exact, bounds = (together(program.restrictions, k, len(y)) for k in ("zero", "nonnegative"))
    G = np.vstack([np.zeros(len(y)), exact.G, -exact.G, bounds.G])
    slack = G @ y - np.concatenate([[0.0], exact.h, -exact.h, bounds.h])
    assert slack.min() >= -KKT
    balance = np.hstack([G, np.diag(slack)]).T
    assert nnls(balance, np.pad(gradient, (0, len(slack))))[1] <= KKT * size
    assert violations(fit.x[: arm.links], links) == []


def surprise(prior: Array, x: Array, sigma: float) -> float:
    """−2 log p of bodies as in the docstring of the prior, from φ alone."""
    total = 0.0
    for given, found in zip(prior, x.reshape(prior.shape), strict=True):
        P, Q = pseudo_inertia(given), pseudo_inertia(found)
        mass, centre = P[3, 3], P[:3, 3] / P[3, 3]
        r2 = (np.trace(P[:3, :3]) / mass - centre @ centre) / 3  # radius of gyration² an axis
        frame = np.eye(4)
        frame[:3, 3] = -centre
        change = frame @ (Q - P) @ frame.T / mass
        metric = np.diag([1 / r2] * 3 + [1.0])
        total += np.trace(change @ metric @ change @ metric) / sigma**2
        relative = np.linalg.solve(P, Q)
        roots = np.linalg.cholesky(Q), np.linalg.cholesky(P)  # det Q itself may be lost in rounding
        size, given = (2 * np.log(np.diag(root)).sum() for root in roots)
        entropy = np.trace(relative) - size + given - 4
        total += min(1, 1 / sigma**2) * entropy
    return float(total)


def assert_no_feasible_descent(
    fit: PhysicalFit, arm: Whitened, z: Array, share: float, sigma: float
) -> None:
    """Convexity: no step from the solution towards a feasible point lowers the objective."""
    rng, known, links = np.random.default_rng(0), arm.effects, arm.robot.nv

    def value(x: Array) -> float:
        """The docstring's objective, its bodies from φ alone."""
        bodies, theta = np.split(x, [arm.links])
        misfit = ((arm.R @ x - z) ** 2).sum() + (((theta - known.mean) / known.std) ** 2).sum()
        return float(misfit + surprise(arm.prior, bodies, sigma))

    best, T = value(fit.x), link_coordinates(arm.prior)
    size = np.linalg.norm(np.linalg.solve(T, fit.x[: arm.links]))
    for _ in range(20):
        root = np.eye(4) + 0.5 * rng.standard_normal((links, 4, 4))
        Q = (root @ root.transpose(0, 2, 1))[:, *np.triu_indices(4)].ravel()
        body = T @ Q * max(1.0, size / np.linalg.norm(Q))
        other = np.concatenate([body, rng.uniform(0, 3, len(known.mean))])
        for step in (1e-6, 1e-4, 1e-2, 0.5):
            assert value(fit.x + step * (other - fit.x)) >= best - share * abs(best)


@pytest.mark.parametrize(("name", "noise"), [("ur10", 0.0), ("ur10", 200.0), ("planar_2r", 300.0)])
def test_no_body_near_the_solution_is_better(name: str, noise: float) -> None:
    arm, rng = Whitened(name, 0.1), np.random.default_rng(1)
    truth = (arm.prior * rng.uniform(0.6, 1.5, (arm.robot.nv, 1))).ravel()
    z = arm.R[:, : arm.links] @ truth + (1.0 + noise) * rng.standard_normal(len(arm.R))
    fit = arm.fit(z, Knowledge(), 0.5)
    assert_optimal_and_consistent(fit, arm, z)
    theta = fit.x[arm.links :]
    assert (theta >= arm.effects.lower - KKT * np.abs(theta).max()).all()
    assert_no_feasible_descent(fit, arm, z, 1e-9, 0.5)


@pytest.mark.parametrize("name", ["planar_2r", "ur10", "panda"])
def test_noiseless_data_give_the_base_parameters(name: str) -> None:
    arm, rng = Whitened(name, 1e-4, effects=False), np.random.default_rng(0)  # N·m
    truth = (arm.prior * rng.uniform(0.7, 1.4, (arm.robot.nv, 1))).ravel()
    z = arm.R @ truth
    fit, base = arm.fit(z), base_parameters(arm.robot)
    # the prior (σ = 1) pulls by its share of the precision, (std / σ)², std from the data
    shown = arm.R[:, base.columns]
    std = np.sqrt(np.diag(np.linalg.inv(shown.T @ shown)))
    distance = np.abs(base.regrouping) @ np.abs(truth - arm.prior.ravel())
    found, true = base.regrouping @ fit.x, base.regrouping @ truth
    assert np.abs(found - true).max() <= 1e-6 * np.abs(true).max()
    assert (std < 0.01 * np.maximum(distance, 1e-2)).all()
    assert_optimal_and_consistent(fit, arm, z)


def test_what_no_torque_shows_is_known_by_the_prior_alone() -> None:
    """On the null space N of the data, (data + prior precision) N = prior precision · N."""
    arm = Whitened("panda", 0.1, effects=False)
    base, prior = base_parameters(arm.robot), arm.prior
    fit = arm.fit(arm.R @ (1.2 * prior.ravel()))
    slope, J = fit.prior.quadratic(fit.x)
    expected = J @ (base.null_space / np.linalg.norm(J @ base.null_space, axis=0))
    np.testing.assert_allclose(J @ fit.covariance @ J.T @ expected, expected, atol=1e-5)
    # and the data move nothing along it: the gradient of the prior vanishes there
    assert np.abs(expected.T @ slope).max() <= 1e-5 * np.linalg.norm(slope)
    # and no prior makes a parameter less certain than the data alone
    unique = [k for k, c in enumerate(categories(base)) if c == "unique"]
    assert set(unique) <= set(base.columns)
    shown = arm.R[:, base.columns]
    std = dict(zip(base.columns, np.sqrt(np.diag(np.linalg.inv(shown.T @ shown))), strict=True))
    assert unique
    assert all(fit.covariance[k, k] <= (1 + 1e-6) * std[k] ** 2 for k in unique)
    assert ((fit.prior_share >= 0) & (fit.prior_share <= 1)).all()


@pytest.mark.parametrize("sigma", [0.1, 1.0, 3.0])
def test_the_prior_and_its_expansion_are_its_density(sigma: float) -> None:
    arm, rng = Whitened("panda", 1.0), np.random.default_rng(0)
    density = BodyPrior(arm.prior, sigma)
    root = np.linalg.cholesky(pseudo_inertia(arm.prior))
    spread = root @ (np.eye(4) + 0.3 * rng.standard_normal((7, 4, 4)))
    phi = from_pseudo_inertia(spread @ spread.swapaxes(1, 2)).ravel()
    value = density.surprise(phi)
    assert value == pytest.approx(surprise(arm.prior, phi, sigma), rel=1e-9)
    slope, H = density.quadratic(phi)
    draws = rng.standard_normal((7, 4, 4))
    change = spread @ (draws + draws.swapaxes(1, 2)) @ spread.swapaxes(1, 2)
    step = from_pseudo_inertia(1e-4 * change).ravel()
    ahead, behind = (surprise(arm.prior, phi + sign * step, sigma) for sign in (1, -1))
    assert ahead - behind == pytest.approx(4 * slope @ H @ step, rel=1e-4)
    assert ahead + behind - 2 * value == pytest.approx(2 * step @ H.T @ H @ step, rel=1e-2)


@pytest.mark.parametrize("off", [slow(0.1), slow(0.3), slow(1.0)])
def test_how_far_off_the_given_bodies_are_is_found(off: float) -> None:
    """Bodies drawn from the prior itself: σ within what six links show of it."""
    rng, found = np.random.default_rng(0), []
    arm = Whitened("ur10", 0.1)
    L = link_coordinates(arm.prior) * off / link_weights(6, 1.0)
    for _ in range(30):
        theta = rng.uniform(0, 3, len(arm.effects.mean))
        x = np.concatenate([arm.prior.ravel() + L @ rng.standard_normal(60), theta])
        sigma = agreement(arm.R, arm.R @ x + rng.standard_normal(len(arm.R)), arm.prior)
        found.append(sigma[0])
    assert np.exp(np.log(found).mean()) == pytest.approx(off, rel=0.15)


def test_a_description_is_right_to_five_per_cent_and_a_tool_leaves_links_sure() -> None:
    arm = Whitened("ur10", 0.1)
    x = np.concatenate([arm.prior.ravel(), arm.effects.mean])
    np.testing.assert_allclose(agreement(arm.R, arm.R @ x, arm.prior), 0.05, rtol=0.01)
    body = arm.prior.copy()
    body[-1] = pin.Inertia.FromSphere(3.0, 0.1).toDynamicParameters()
    x = np.concatenate([body.ravel(), arm.effects.mean])
    noise = np.random.default_rng(0).standard_normal(len(arm.R))
    sigma = agreement(arm.R, arm.R @ x + noise, arm.prior)
    assert sigma[-1] > 5
    assert (sigma[:-1] < 0.1).all()


def test_without_data_the_prior_is_the_answer() -> None:
    prior = prior_parameters(load_robot("ur10"))
    fit = fit_physical(np.zeros((1, 60)), np.zeros(1), prior, NONE)
    scale = np.abs(prior).max(axis=1, keepdims=True)
    np.testing.assert_allclose(fit.x.reshape(6, 10) / scale, prior / scale, atol=1e-6)
    np.testing.assert_allclose(fit.prior_share, 1.0, atol=1e-6)


def test_the_fit_is_the_same_in_any_frame() -> None:
    """The distance to the prior is a pull-back metric."""
    prior = prior_parameters(load_robot("ur10"))[1]
    place = pin.SE3(pin.exp3(np.array([0.3, -0.5, 0.8])), np.array([0.1, -0.2, 0.3]))
    bodies = (pin.Inertia.FromDynamicParameters(prior + e) for e in (*np.eye(10), np.zeros(10)))
    *others, moved = (place.act(body).toDynamicParameters() for body in bodies)
    M = np.array(others).T - moved[:, None]  # φ in the new frame
    R = np.random.default_rng(3).standard_normal((4, 10)) / np.abs(prior).max()
    z = R @ (1.4 * prior) + 0.1
    one = fit_physical(R, z, prior[None], NONE).x
    two = fit_physical(R @ np.linalg.inv(M), z, moved[None], NONE).x
    assert np.abs(two - M @ one).max() / np.abs(one).max() < 1e-5


def test_a_link_without_mass_is_a_placeholder_of_one() -> None:
    robot = load_robot("planar_2r")
    first, last = prior_parameters(robot.with_parameters(robot.phi * (np.arange(20) != 10)))
    np.testing.assert_array_equal(first, robot.phi[:10])
    assert 0 < last[0] < 1e-3 * first[0]
    assert violations(last, ["link2"]) == []
    assert (prior_parameters(robot.with_parameters(0 * robot.phi))[:, 0] == 1.0).all()


@pytest.mark.parametrize("seed", [0, slow(1), slow(2)])
def test_no_scale_or_collinearity_of_data_ends_without_a_result(seed: int) -> None:
    """Noise of 1e-6 of the torque, collinear effects of any unit, torque of the wrong sign."""
    arm, rng = Whitened("panda", 0.1, n=300), np.random.default_rng(seed)
    effects = len(arm.effects.mean)
    truth = np.concatenate([1.3 * arm.robot.phi, np.full(effects, 0.2)])
    z = arm.R @ truth + rng.standard_normal(len(arm.R))
    noise = np.tile(10 ** rng.uniform(-5, 1, 7), len(z) // 7)
    twin = arm.R[:, -2:] @ [[1.0], [1e-3]] + 1e-9 * rng.standard_normal((len(z), 1))
    R = np.column_stack([arm.R, twin])
    units = 10 ** rng.uniform(-6, 6, effects + 1)
    R[:, -effects - 1 :] *= units
    prior = EffectPrior(np.zeros(effects + 1), np.full(effects + 1, 1e3) / units, -np.inf * units)
    for sign in (1.0, -1.0):
        fit = fit_physical(R / noise[:, None], sign * z / noise, arm.prior, prior)
        left, given = z - sign * R @ fit.x, z - sign * R[:, :70] @ arm.robot.phi
        assert np.linalg.norm(left / noise) < np.linalg.norm(given / noise)
        if sign > 0:  # torque of the wrong sign leaves bodies of no size
            assert violations(fit.x[:70], arm.robot.links) == []


def test_seven_joints_with_friction_are_solved_within_a_second() -> None:
    arm, spent = Whitened("panda", 0.1, n=1000), []
    arm.R = np.linalg.qr(arm.R, mode="r")
    truth = np.concatenate([1.3 * arm.robot.phi, np.full(28, 0.2)])
    z = arm.R @ truth + np.random.default_rng(0).standard_normal(len(arm.R))
    for _ in range(3):
        start = time.process_time()
        arm.fit(z)
        spent.append(time.process_time() - start)
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
    assert violations(fit.x[: arm.links], arm.robot.links) == []
    assert_no_feasible_descent(fit, arm, z, 1e-6, 1.0)


def test_bodies_that_no_digits_hold_are_given_as_far_as_digits_go() -> None:
    """Noise of 1e-9 N·m, and bodies that cannot exist: the best ones vanish in directions."""
    arm, z = exact_data("planar_2r", 1e-9, 3)
    fit, given = arm.fit(z), np.concatenate([arm.robot.phi, arm.effects.mean])
    assert violations(fit.x[: arm.links], arm.robot.links) == []
    assert np.isfinite(fit.covariance).all()
    assert np.linalg.norm(z - arm.R @ fit.x) < np.linalg.norm(z - arm.R @ given)
    for share in (1e-6, 1e-3, 0.5):  # the objective is convex, and all but data of no account
        other = fit.x + share * (given - fit.x)
        assert np.linalg.norm(z - arm.R @ fit.x) < (1 + 1e-6) * np.linalg.norm(z - arm.R @ other)


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


def test_the_root_is_that_of_the_prior_covariance() -> None:
    rng, prior = np.random.default_rng(0), prior_parameters(load_robot("planar_2r"))
    R = rng.normal(size=(20, 20)) / np.abs(prior).max() * 30
    fit = fit_physical(R, R @ prior.ravel(), prior, NONE)
    expected = np.linalg.inv(R.T @ R + np.linalg.inv(fit.root @ fit.root.T))
    scale = np.sqrt(np.diag(expected))
    assert (np.abs(fit.covariance - expected) <= 1e-6 * np.outer(scale, scale)).all()


def test_what_is_known_exactly_is_the_priors() -> None:
    robot = load_robot("planar_2r")
    prior = prior_parameters(robot)
    known = Knowledge(links={robot.links[0]: LinkKnowledge(mass=2.0)})
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
    analysis = identifiability.analyze(planar, effects=found.model.effects, estimate=found)
    rows = [p for link in analysis.result()["links"] for p in link["parameters"]]
    clear = [r for r in rows if r["decided_by"] and abs(r["prior_influence"] - 0.5) > 0.25]
    assert len(clear) > 15
    assert [row for row in clear if said[row["name"]] != row["prior_dominated"]] == []
    shares = zip(parameters, found.physical.prior_share, strict=True)
    combined = [p for p, share in shares if p["category"] == "combined" and share < 0.5]
    missed = {p["name"] for p in combined if p["prior_dominated"]}
    assert all(p["prior_dominated"] for p in rows if p["name"] in missed)


class Seen(Whitened):
    """An arm that differs from its model, and its friction."""

    def __init__(self) -> None:
        super().__init__("ur10", 0.1, n=300)
        rng = np.random.default_rng(0)
        self.truth = self.prior * rng.uniform(0.6, 1.5, (6, 1))
        x = np.concatenate([self.truth.ravel(), rng.uniform(0, 1, len(self.effects.mean))])
        self.z = self.R @ x + rng.standard_normal(len(self.R))

    def bodies(self, knowledge: Knowledge) -> Array:
        fit = self.fit(self.z, knowledge)
        assert_optimal_and_consistent(fit, self, self.z, knowledge)
        return fit.x[: self.links].reshape(6, 10)


SEEN = Seen()


def test_known_masses_hold_exactly_or_as_far_as_they_are_sure() -> None:
    free = SEEN.bodies(Knowledge())[:, 0]
    total = 1.1 * float(free.sum())
    masses = (7.0, Quantity(12.0, 1e-4), Quantity(4.0, 1e6))
    about = {n: LinkKnowledge(mass=m) for n, m in zip(SEEN.robot.links, masses, strict=False)}
    fit = SEEN.fit(SEEN.z, Knowledge(total, about))
    assert_optimal_and_consistent(fit, SEEN, SEEN.z, Knowledge(total, about))
    m = fit.x[: SEEN.links : 10]
    assert m.sum() == pytest.approx(total, abs=1e-7)
    assert m[0] == pytest.approx(7.0, abs=1e-8)
    assert m[1] == pytest.approx(12.0, abs=1e-3)
    C = fit.covariance[: SEEN.links : 10, : SEEN.links : 10]
    assert C[0, 0] <= 1e-12
    assert np.sqrt(C[1, 1]) <= 1e-4 * (1 + 1e-6)
    assert C.sum() <= 1e-10 * total**2
    np.testing.assert_allclose(SEEN.bodies(Knowledge(Quantity(total, 1e6)))[:, 0], free, rtol=1e-4)


def test_centres_and_masses_stay_where_they_are_known_to_be() -> None:
    free = SEEN.bodies(Knowledge())
    centre = free[:, 1:4] / free[:, :1]
    box = Box(tuple(centre[1] + 0.02), tuple(centre[1] + [0.05, 0.06, 0.02]))  # flat along z
    phi = SEEN.bodies(Knowledge(links={SEEN.robot.links[1]: LinkKnowledge(com_box=box)}))
    found = phi[:, 1:4] / phi[:, :1]
    tight = 1e-6
    assert (found[1] >= np.array(box.low) - tight).all()
    assert (found[1] <= np.array(box.high) + tight).all()
    true = SEEN.truth[:, 0].tolist()
    about = {n: LinkKnowledge(mass=m) for n, m in zip(SEEN.robot.links, true, strict=True)}
    found = SEEN.bodies(Knowledge(total_mass=sum(true), links=about))
    np.testing.assert_allclose(found[:, 0], true, atol=1e-7)
    gap, before = (np.linalg.norm((phi - SEEN.truth)[:, :4]) for phi in (found, free))
    assert gap < 0.5 * before


def test_constraints_that_do_not_bind_change_nothing() -> None:
    wide = LinkKnowledge(com_box=Box((-9, -9, -9), (9, 9, 9)))
    known = Knowledge(links=dict.fromkeys(SEEN.robot.links, wide))
    free, fit = (SEEN.fit(SEEN.z, each).x for each in (Knowledge(), known))
    np.testing.assert_allclose(fit, free, rtol=1e-5, atol=1e-6)


CORNER = [[0, 0, 0], [0.1, 0.1, 0.1]]


def test_contradictions_are_named_in_one_line(tmp_path: Path) -> None:
    links, file = SEEN.robot.links, tmp_path / "known.yaml"
    masses = {links[1]: {"mass": 3.0}, links[2]: {"mass": 4.0}}
    file.write_text(yaml.safe_dump({"links": masses, "total_mass": 5.0}))
    known = load_knowledge(file, links)
    said = refused("contradict each other", SEEN.fit, SEEN.z, known, error=BadInput)
    assert said.startswith(str(file))
    assert all(word in said for word in ("total_mass", *links[1:3], "correct one of them"))
    assert f"of {links[0]} " not in said


def test_what_is_written_is_what_is_read(tmp_path: Path) -> None:
    file = tmp_path / "known.yaml"
    content = {
        "total_mass": {"value": 33.5, "std": 0.5},
        "links": {"forearm": {"mass": 2.3, "com_box": CORNER}},
    }
    file.write_text(yaml.safe_dump(content))
    known = load_knowledge(file, ["base", "forearm"])
    assert known.total_mass == Quantity(33.5, 0.5)
    assert known.masses["mass of forearm"] == Quantity(2.3)
    assert known.entry() == content
    assert Knowledge().entry() == {}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a: [", "not valid YAML .line 1: "),
        ("- 1", "expected entries 'name: value'"),
        ("totalmass: 3", "did you mean 'total_mass'"),
        ("total_mass: -3", "total_mass: expected a number above 0"),
        ("total_mass: {value: 3, std: -1}", "total_mass.std: expected a number >= 0"),
        ("total_mass: {value: heavy}", "total_mass.value: expected a number, got text"),
        ("total_mass: .inf", "total_mass: expected a finite number"),
        ("links: {fore: {mass: 1}}", "did you mean 'forearm'"),
        ("links: {forearm: {weight: 1}}", "links.forearm: unknown entry 'weight'"),
        ("links: {forearm: {com_box: [[0, 0, 1], [1, 1, 0]]}}", "along z .* exchange them"),
        ("links: {forearm: {com_box: [0, 1]}}", "links.forearm.com_box.* expected a list"),
        ("links: {forearm: {com_box: 3}}", "com_box: expected a list"),
    ],
)
def test_errors_name_file_key_and_remedy(tmp_path: Path, text: str, said: str) -> None:
    file = tmp_path / "known.yaml"
    file.write_text(text)
    found = refused(said, load_knowledge, file, ["base", "forearm"], error=BadInput)
    assert found.startswith(str(file))


def test_missing_file_and_unknown_link() -> None:
    missing, other = "no such file; give a YAML file of what is known", LinkKnowledge(mass=1.0)
    refused(missing, load_knowledge, "nowhere.yaml", [], error=BadInput)
    refused("no link 'tail'", SEEN.fit, SEEN.z, Knowledge(links={"tail": other}), error=BadInput)


def test_command(tmp_path: Path, planar: Robot, exact: Call, excitant: Call) -> None:
    log, file = tmp_path / "log.csv", tmp_path / "known.yaml"
    write_csv(log, exact(planar, np.arange(0, 12, 0.01)))
    content = {"total_mass": 7.5, "links": {"link2": {"mass": 2.5}}}
    file.write_text(yaml.safe_dump(content))
    call = ("identify planar_2r --json", log, "--knowledge", file)
    result = excitant(*call).result
    assert result["knowledge"] == content
    by_name = {p["name"]: p for p in result["parameters"]}
    masses = [by_name[f"link{k}.m"]["value"] for k in (1, 2)]
    np.testing.assert_allclose(masses, [5.0, 2.5], rtol=0, atol=1e-6)
    assert by_name["link2.m"]["prior_dominated"]
    assert any("total_mass 7.5 kg; mass of link2 2.5 kg" in note for note in result["notes"])
    online = excitant(*call, "--online")
    file.write_text("total_mass: 1\nlinks: {link1: {mass: 2}}")
    said = ("--knowledge is for all rows at once", "contradict each other")
    for ran, why in zip((online, excitant(*call)), said, strict=True):
        assert (ran.status, ran.err.count("\n"), why in ran.err) == (1, 1, True)
