"""Deviations are those of repeated experiments; what a motion leaves open is named, with a cure."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest

from excitant.analysis import uncertainty
from excitant.analysis.experiment import identify_shown, prior_influence, prior_of
from excitant.analysis.identifiability import Identifiability, analyze
from excitant.analysis.uncertainty import (
    APART,
    MotionInformation,
    base_wrench_columns,
    correlation,
    deviations,
    largest_correlations,
    scale_deviation,
    triangle,
    unseen_directions,
    weak_directions,
)
from excitant.design import random_trajectory
from excitant.identify import Recording, identify_robot, recording_from_table
from excitant.identify.physical import fit_physical
from excitant.identify.prior import EffectPrior, prior_parameters
from excitant.identify.rows import fit_rows
from excitant.robots import Motion, Robot, load_robot
from excitant.robots.base_parameters import BaseParameters, base_parameters
from excitant.robots.effects import standard_effects
from excitant.robots.parameters import from_pseudo_inertia, pseudo_inertia
from excitant.robots.regressor import regressor

Runs = Callable[..., list[Recording]]


def motion_of(robot: Robot, seed: int = 0) -> Motion:
    return random_trajectory(robot, np.random.default_rng(seed), 10.0, 5).motion(50.0)


def resting(motion: Motion, joint: int, at: float = 0.4) -> Motion:
    q, dq, ddq = (np.array(x) for x in (motion.q, motion.dq, motion.ddq))
    q[:, joint], dq[:, joint], ddq[:, joint] = at, 0.0, 0.0
    return Motion(motion.t, q, dq, ddq)


def stacked(*motions: Motion) -> Motion:
    parts = [np.concatenate([getattr(m, n) for m in motions]) for n in ("q", "dq", "ddq")]
    return Motion(np.arange(len(parts[0])) / 50.0, *parts)


def newton_euler(robot: Robot, motion: Motion) -> np.ndarray:
    states, data = zip(motion.q, motion.dq, motion.ddq, strict=True), robot.model.createData()
    return np.array([pin.rnea(robot.model, data, *state) for state in states])


def entry(found: Identifiability, name: str):
    return next(e for e in found.entries if e.name == name)


# deviations


def test_deviations_are_those_of_the_textbook() -> None:
    rng = np.random.default_rng(0)
    X, sigma = rng.normal(size=(200, 2, 5)), np.array([0.5, 2.0])
    rows = (X / sigma[:, None]).reshape(-1, 5)
    A = rng.normal(size=(3, 5))
    expected = np.sqrt(np.diag(A @ np.linalg.inv(rows.T @ rows) @ A.T))
    np.testing.assert_allclose(deviations(triangle(X, sigma), A), expected, rtol=1e-10)


@pytest.mark.parametrize("unit", [1.0, 1e-6, 1e6])
def test_what_is_not_seen_has_no_deviation(unit: float) -> None:
    rng = np.random.default_rng(1)
    X = rng.normal(size=(50, 1, 4))
    X[:, 0, 2], X[:, 0, 3] = 2 * X[:, 0, 1], 0.0
    X[:, 0, 0] *= unit
    A = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1], [0, 1, 2, 0.0], [1, 1, 2, 1]])
    std = deviations(triangle(X, np.ones(1)), A)
    assert np.isfinite(std).tolist() == [True, False, False, True, False]
    first, second = X[:, 0, 0] / np.linalg.norm(X[:, 0, 0]), X[:, 0, 1]
    alone = np.linalg.norm(second - first * (first @ second))  # what the first cannot imitate
    np.testing.assert_allclose(std[3], 1 / alone, rtol=1e-9)


def test_unseen_directions_are_sparse_and_silent() -> None:
    rng = np.random.default_rng(2)
    R = rng.normal(size=(6, 6))
    R[:, 3] = R[:, 0] - 0.5 * R[:, 2]
    R[:, 5] = 0.0
    found = unseen_directions(R)
    np.testing.assert_allclose(found @ R.T, 0, atol=1e-12)
    np.testing.assert_allclose(found, [[-1, 0, 0.5, 1, 0, 0], [0, 0, 0, 0, 0, 1]], atol=1e-12)


def test_deviations_are_met_by_repeated_experiments_on_recursive_newton_euler(ur10: Robot) -> None:
    motion, draws = motion_of(ur10), 400
    sigma = 0.02 * ur10.limits.torque
    found = analyze(ur10, motion=motion, noise=sigma.tolist())
    tau = newton_euler(ur10, motion)
    W = regressor(ur10, motion)[:, :, list(found.base.columns)] / sigma[:, None]
    solve = np.linalg.pinv(W.reshape(-1, len(found.base)))
    rng = np.random.default_rng(3)
    estimates = np.array(
        [solve @ (tau / sigma + rng.normal(size=tau.shape)).ravel() for _ in range(draws)]
    )
    predicted = np.array([p.std for p in found.practical])
    spread = 1 / np.sqrt(2 * draws)  # of a standard deviation from so many draws
    ratio = estimates.std(axis=0, ddof=1) / predicted
    assert abs(ratio - 1).max() < 5 * spread
    error = (estimates.mean(axis=0) - [p.value for p in found.practical]) / predicted
    assert abs(error).max() < 5 / np.sqrt(draws)
    for column, std in zip(found.base.columns, predicted, strict=True):
        if found.entries[column].category == "unique":
            assert found.entries[column].std_data == pytest.approx(std)


# directions and correlations


def informed(covariance: np.ndarray, unseen: np.ndarray | None = None) -> MotionInformation:
    r = len(covariance)
    unseen = np.zeros((0, r)) if unseen is None else unseen
    return MotionInformation(np.eye(r), covariance, unseen, np.ones(r))


def plain_base(names: tuple[str, ...]) -> BaseParameters:
    r = len(names)
    return BaseParameters(names, tuple(range(r)), np.eye(r), np.zeros((r, 0)), (1.0, 0.0))


def test_what_trades_against_each_other_is_named() -> None:
    C = np.diag([1e-6, 4.0, 4.0])
    C[1, 2] = C[2, 1] = -3.96
    base = plain_base(("a.m", "a.Ixx", "b.Izz"))
    worst = weak_directions(base, ("kg", "kg·m²", "kg·m²"), informed(C), np.ones(3))[0]
    assert worst.std == pytest.approx(np.sqrt(7.96))
    assert worst.expression.replace("b.Izz − a.Ixx", "a.Ixx − b.Izz") == "a.Ixx − b.Izz"
    assert "rise by 2 kg·m² while" in worst.meaning
    assert "falls by 2 kg·m²" in worst.meaning
    change = np.zeros(3)
    for name, value, _ in worst.members:
        change[base.names.index(name)] = value
    # one standard deviation: δᵀ C⁻¹ δ = 1
    assert change @ np.linalg.inv(C) @ change == pytest.approx(1.0)


def test_directions_that_are_not_seen_come_first() -> None:
    base = plain_base(("a.m", "a.Ixx", "b.Izz"))
    seen = informed(np.diag([1.0, 0.0, 0.0]), np.array([[0, 1.0, -0.25]]))
    first, *rest = weak_directions(base, ("kg",) * 3, seen, np.ones(3))
    assert first.std == np.inf
    assert first.expression == "a.Ixx − 0.25·b.Izz"
    assert "no torque of this motion" in first.meaning
    assert [d.members[0][0] for d in rest] == ["a.m"]


def test_correlations_are_sorted_by_size() -> None:
    C = np.diag([1.0, 4.0, 9.0, 0.0])
    C[0, 1] = C[1, 0] = 1.0
    C[1, 2] = C[2, 1] = -5.4
    matrix = correlation(C)
    assert largest_correlations(matrix) == [(1, 2, pytest.approx(-0.9)), (0, 1, pytest.approx(0.5))]
    assert np.diag(matrix).tolist() == [1, 1, 1, 0]


# what is needed


def test_gravity_in_the_plane_shows_first_moments_and_tilting_brings_it(planar: Robot) -> None:
    level = planar.with_gravity([0, -9.81, 0])  # along the axes of both joints
    assert (len(base_parameters(planar)), len(base_parameters(level))) == (6, 4)
    found = analyze(level)
    answer = entry(found, "link1.mcz").needed
    assert answer.startswith("the base tilted by 90°")
    assert entry(found, "link1.m").needed == APART
    assert entry(found, "link2.mcx").needed == ""
    upright = analyze(planar)
    assert entry(upright, "link1.mcz").category == "unique"
    assert entry(upright, "link1.mcz").needed == ""
    assert entry(upright, "link2.Iyz").needed.startswith("never by joint torques; by a force")


def test_in_free_fall_no_tilt_helps(planar: Robot) -> None:
    found = analyze(planar.with_gravity([0, 0, 0]))
    assert not any("tilted" in e.needed for e in found.entries)
    assert "sensor under the base" in entry(found, "link1.mcz").needed


def test_a_joint_that_rests_is_named_and_moving_it_helps(ur10: Robot) -> None:
    still = resting(motion_of(ur10), 2)
    effects = standard_effects(ur10.joints)
    found = analyze(ur10, effects=effects, motion=still)
    lost = {p.expression for p in found.practical if p.verdict == "not_shown"}
    assert {"elbow_joint.Fv", "elbow_joint.Fc", "elbow_joint.Ia"} <= lost
    assert found.motion is not None
    assert found.motion.resting == ("elbow_joint",)
    for p in found.practical:
        assert (p.needed == "moving elbow_joint, which rests") == (p.expression in lost)
    assert any("does not show" in note and "elbow_joint" in note for note in found.notes)
    cured = analyze(ur10, effects=effects, motion=stacked(still, motion_of(ur10, 1)))
    assert not any(p.verdict == "not_shown" for p in cured.practical)


def test_of_two_resting_joints_the_one_that_matters_is_named(ur10: Robot) -> None:
    still = resting(resting(motion_of(ur10), 1), 4)
    found = analyze(ur10, effects=standard_effects(ur10.joints), motion=still)
    for joint in (ur10.joints[1], ur10.joints[4]):
        assert entry(found, f"{joint}.Fv").needed == f"moving {joint}, which rests"


def test_joints_that_do_not_move_are_what_is_missing(planar: Robot) -> None:
    found = analyze(planar, moving=["joint1"], measured=["joint1"])
    assert entry(found, "link2.mcx").category != "unique"
    assert entry(found, "link2.mcx").needed == "moving joint2, which rests"
    both = analyze(planar, moving=["joint1", "joint2"], measured=["joint1"])
    assert entry(both, "link2.mcx").needed == ""


def test_more_of_the_same_is_proposed_where_it_is_enough(ur10: Robot) -> None:
    motion, effects = motion_of(ur10)[np.arange(0, 500, 20)], standard_effects(ur10.joints)
    found = analyze(ur10, effects=effects, motion=motion)
    asked = [e for e in found.entries if e.needed.startswith("about")]
    assert asked
    times = max(int(e.needed.split()[1]) for e in asked)
    longer = analyze(ur10, effects=effects, motion=stacked(*[motion] * times))
    for before in asked:
        assert entry(longer, before.name).needed == ""


def test_the_base_feels_what_newton_and_euler_say(ur10: Robot) -> None:
    motion = motion_of(ur10)[np.arange(0, 500, 50)]
    columns = base_wrench_columns(ur10, motion)
    model, data = ur10.model, ur10.model.createData()
    for k in range(len(motion)):
        pin.rnea(model, data, motion.q[k], motion.dq[k], motion.ddq[k])
        pin.forwardKinematics(model, data, motion.q[k])
        expected = data.oMi[1].act(data.f[1]).vector
        np.testing.assert_allclose(columns[k] @ ur10.phi, expected, atol=1e-9)


def test_a_known_payload_shows_the_scale_of_currents(
    ur10: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    sigma, std = 0.01 * ur10.limits.torque, {}
    for mass in (0.0, 0.05, 0.1):
        monkeypatch.setattr(uncertainty, "PAYLOAD_KG", mass)
        std[mass] = scale_deviation(ur10, standard_effects(ur10.joints), sigma)
    assert std[0.0] == np.inf
    assert std[0.05] / std[0.1] == pytest.approx(2.0, rel=0.02)


# the prior


@pytest.fixture(scope="module")
def judged(runs: Runs):
    robot = load_robot("planar_2r")
    recording, held = runs(robot, 0)
    estimate = identify_robot(robot, [recording], validate=[held])
    return robot, estimate, analyze(robot, estimate=estimate, rng=np.random.default_rng(0))


def test_the_prior_decides_what_is_null_and_not_what_is_seen(judged) -> None:
    _, _, found = judged
    influence = found.motion.influence
    assert influence.refits > 0
    for k, e in enumerate(found.entries):
        if e.category == "unidentifiable":
            assert influence.linear[0, k] == pytest.approx(1.0, abs=1e-6)
            assert e.influence > 0.9  # a body at its limit cannot follow everywhere
            assert e.prior_dominated
        if e.category == "combined":  # moved along the null space, it follows all the way
            assert influence.linear[0, k] == pytest.approx(1.0, abs=1e-6)
    for name in ("link2.mcx", "joint1.Fv", "joint2.Fc"):
        assert entry(found, name).influence < 0.05
        assert entry(found, name).decided_by == "data"


def test_base_parameters_stay_where_the_data_have_them(judged) -> None:
    _, _, found = judged
    assert found.motion.influence.base_move.max() < 0.3


def test_two_initial_values_that_agree_within_5_percent_show_nothing(judged) -> None:
    """Two priors, far apart where the data see, alike where they do not: the tables agree."""
    robot, estimate, found = judged
    rows = fit_rows(robot, estimate.model.effects, estimate.base, estimate.data)
    R, z = rows.regression.factor(estimate.least_squares.weight)
    phi = prior_parameters(robot)
    prior, links = prior_of(phi, rows.open_prior), phi.size
    B = estimate.base.regrouping
    covariance = prior.L @ prior.L.T
    rng = np.random.default_rng(4)
    # prior-orthogonal to the null space: all of it is in what torque shows
    visible = covariance[:links] @ B.T @ rng.normal(size=len(B))
    visible = np.concatenate([visible, np.zeros(len(prior.mean) - links)])
    visible *= 0.1 / prior.size(np.linalg.solve(prior.L, visible))
    other = phi + visible[:links].reshape(-1, 10)
    assert np.abs(visible[:links]).max() > 1e-3
    again = fit_physical(R, z, other, rows.open_prior, metric=phi)
    difference = np.abs(again.x - estimate.physical.x)[:links]
    assert (difference <= 0.05 * np.abs(estimate.physical.x[:links]) + 1e-5).all()
    combined = [e for e in found.entries[:links] if e.category == "combined"]
    assert any(e.decided_by == "prior" and e.influence > 0.9 for e in combined)


def test_linear_theory_is_what_refits_give_away_from_limits() -> None:
    """One link, one parameter seen with weight s: its prior counts 1 / (1 + s²)."""
    phi = np.array([[2.0, 0.1, 0.0, 0.0, 0.3, 0.0, 0.3, 0.0, 0.0, 0.3]])
    nothing = EffectPrior(np.zeros(0), np.zeros(0), np.zeros(0))
    prior = prior_of(phi, nothing)
    R, base = np.zeros((10, 10)), np.eye(10)
    R[0] = 0.7 * np.linalg.inv(prior.L)[3]
    z = R @ phi.ravel()
    reference = fit_physical(R, z, phi, nothing).x

    def response(delta):
        moved = phi + delta.reshape(1, 10)
        return fit_physical(R, z, moved, nothing, metric=phi).x - reference

    seen = MotionInformation(R, np.eye(10), np.zeros((0, 10)), np.ones(10))
    one, two = (
        prior_influence(seen, base, prior, phi.ravel(), np.random.default_rng(5), answer)
        for answer in (None, response)
    )
    np.testing.assert_allclose(one.ratio, two.ratio, atol=1e-4, equal_nan=True)
    assert np.nanmin(one.linear[1]) == pytest.approx(1 / (1 + 0.7**2), rel=1e-9)
    assert two.decided_by.count("physics") == 0


def test_the_prior_moves_alike_in_any_basis_of_the_null_space(planar: Robot) -> None:
    """The same information as R and as Q R, whose decompositions round differently."""
    phi = prior_parameters(planar)
    prior = prior_of(phi, EffectPrior(*(np.zeros(0),) * 3))
    rng = np.random.default_rng(7)
    R = rng.normal(size=(5, 20)) @ np.linalg.inv(prior.L)
    Q = np.linalg.qr(rng.normal(size=(20, 5)))[0]
    one, two = (
        prior_influence(
            MotionInformation(factor, np.eye(2), np.zeros((0, 2)), np.ones(20)),
            np.eye(2, 20),
            prior,
            phi.ravel(),
            np.random.default_rng(8),
        )
        for factor in (R, Q @ R)
    )
    np.testing.assert_allclose(one.ratio, two.ratio, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(one.base_move, two.base_move, rtol=1e-6)


# recordings that do not show everything


def test_a_recording_that_rests_a_joint_is_judged_as_far_as_it_goes(planar: Robot) -> None:
    motion = resting(motion_of(planar), 1)
    tau = newton_euler(planar, motion)
    tau += 0.02 * np.random.default_rng(6).normal(size=tau.shape)
    columns = {"t": motion.t}
    for name, values in (("q", motion.q), ("dq", motion.dq), ("tau", tau)):
        columns |= {f"{name}{j + 1}": values[:, j] for j in range(2)}
    recording = recording_from_table(pd.DataFrame(columns), 2, file="rest.csv", name="rest")
    estimate = identify_shown(planar, [recording])
    found = analyze(planar, estimate=estimate, rng=np.random.default_rng(0))
    assert len(estimate.base) < len(found.base)
    hidden = [p.expression for p in found.practical if p.verdict == "not_shown"]
    assert "joint2.Fv" in hidden
    assert entry(found, "joint2.Fv").needed == "moving joint2, which rests"
    assert entry(found, "joint2.Fv").influence > 0.5  # it cannot follow below zero
    assert entry(found, "joint1.Fv").verdict in ("negligible", "well")
    assert entry(found, "joint1.Fv").influence < 0.05
    assert found.result()["resting_joints"] == ("joint2",)


def test_bodies_at_their_limit_are_named(judged) -> None:
    robot, estimate, _ = judged
    rows = fit_rows(robot, estimate.model.effects, estimate.base, estimate.data)
    prior = prior_of(prior_parameters(robot), rows.open_prior)
    x = prior.mean.copy()
    assert prior.at_limit(x) == ()
    body = pseudo_inertia(x[10:20])
    root = np.linalg.cholesky(body)
    flat = root @ np.diag([1.0, 1e-4, 1.0, 1.0]) @ root.T  # thin beside the prior, in one direction
    x[10:20] = from_pseudo_inertia(flat)
    assert prior.at_limit(x) == (1,)
    x[10:20] = from_pseudo_inertia(root @ np.diag([1.0, 0.01, 1.0, 1.0]) @ root.T)
    assert prior.at_limit(x) == ()


def test_parameters_that_follow_from_one_another_are_grouped(planar: Robot) -> None:
    """Torque shows link1.mcx + l m2, and link1.Iyy + l² m2 with the rotor's inertia added."""
    assert analyze(planar).follow == (("link1.mcx", "link1.Iyy", "link2.m"),)
    effects = standard_effects(planar.joints)
    assert analyze(planar, effects=effects).follow == (("link1.mcx", "link2.m"),)
    assert analyze(planar, effects=effects, motion=motion_of(planar)).follow == (
        ("link1.mcx", "link2.m"),
    )
