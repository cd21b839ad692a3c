"""What cannot be known changes no torque; what can, does; how well, and what would show more."""

import json
from dataclasses import replace
from functools import cache
from types import SimpleNamespace as Judged

import numpy as np
import pinocchio as pin
import pytest
from arms import TrueArm
from planted import Runs, motion_of, stacked

from excitant.analysis import identify_shown, uncertainty
from excitant.analysis.identifiability import Identifiability, analyze
from excitant.analysis.uncertainty import flat_links
from excitant.exceptions import BadInput, UnknownName
from excitant.identify import Recording, identify_robot
from excitant.identify.excitation import ROWS_PER_SECOND, persistency
from excitant.identify.prior import base_prior, prior_parameters, reference_motion
from excitant.reports.run import as_saved
from excitant.results import ParameterIdentifiability, record_of
from excitant.robots import Motion, Robot, load_robot
from excitant.robots.base_parameters import base_parameters
from excitant.robots.effects import standard_effects
from excitant.robots.parameters import from_pseudo_inertia, pseudo_inertia
from excitant.robots.regressor import regressor
from excitant.robots.torque import observation_columns


@cache
def under(*resting: int) -> Identifiability:
    """The UR10 with friction under a motion, some of its joints at rest."""
    robot = load_robot("ur10")
    motion = motion_of(robot, resting=resting)
    return analyze(robot, effects=standard_effects(robot.joints), motion=motion)


def entry(found: Identifiability, name: str) -> ParameterIdentifiability:
    return next(e for e in found.entries if e.name == name)


@pytest.mark.parametrize("name", ["planar_2r", "ur10", "panda"])
@pytest.mark.parametrize("friction", [False, True])
def test_categories_are_what_torque_can_show(name: str, friction: bool) -> None:
    robot = load_robot(name)
    effects = standard_effects(robot.joints) if friction else ()
    found = analyze(robot, effects=effects)
    motion = Motion(np.arange(50) / 10, *robot.random_motion(np.random.default_rng(9), 50))
    W = observation_columns(robot, effects, motion).reshape(-1, len(found.base.names))
    null, category = found.base.null_space, np.array(found.structure.category)
    assert np.abs(W @ null).max() <= 1e-9 * np.abs(W).max()
    assert np.linalg.matrix_rank(W, tol=1e-9 * np.linalg.norm(W)) == len(found.base)
    silent = np.abs(W).max(axis=0) <= 1e-9 * np.abs(W).max()
    moved = np.abs(null).max(axis=1) > 1e-8
    assert (silent == (category == "unidentifiable")).all()
    assert (~moved == (category == "unique")).all()
    assert set(category) <= {"unique", "combined", "unidentifiable"}


def test_uncertainty_shrinks_with_the_root_of_the_samples(ur10: Robot) -> None:
    motion = motion_of(ur10)
    once, nine = (analyze(ur10, motion=stacked(*[motion] * k)) for k in (1, 9))
    ratio = [a.std / b.std for a, b in zip(once.practical, nine.practical, strict=True)]
    # the inverse of WᵀW loses at most cond(W)² of the sixteen digits
    tolerance = 1e-15 * once.motion.condition_number**2 + 1e-9
    np.testing.assert_allclose(ratio, 3.0, rtol=tolerance)
    assert nine.motion.condition_number == pytest.approx(once.motion.condition_number, rel=1e-9)


def test_a_motion_of_all_joints_is_exciting_and_verdicts_follow_the_uncertainty() -> None:
    for p in under().practical:
        unsure = p.rel_std is None or p.rel_std > 0.3
        good = "roughly" if unsure or p.rel_std > 0.1 else "well"
        assert p.verdict in (("negligible", "hardly") if unsure else (good,))
    found = under().motion.persistency
    assert found.level >= 1
    assert (found.enough, found.missing, found.joints) == (True, 0, ())
    sentence = under().result()["persistency"]["sentence"]
    assert sentence.startswith("persistently exciting over 10 s at level")


def test_a_motion_at_rest_shows_what_gravity_does_and_no_more(ur10: Robot) -> None:
    found = analyze(ur10, motion=Motion(np.arange(500) / 50, *np.zeros((3, 500, 6))))
    hidden = [p for p in found.practical if p.verdict == "not_shown"]
    assert len(found.base) - 6 <= len(hidden) < len(found.base)  # one equation for each joint
    assert (found.motion.resting, found.motion.condition_number) == (ur10.joints, np.inf)
    result = found.result()
    assert len(result["not_shown"]) == len(hidden)
    assert any("does not show" in note for note in result["notes"])
    assert as_saved(result, {})[0]["condition_number"] is None


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"motion": True, "moving": ["elbow_joint"]}, "moving"),
        ({"moving": []}, "at least one joint"),
        ({"measured": []}, "at least one joint"),
        ({"noise": [1.0] * 6}, "noise"),
        ({"motion": True, "noise": [1.0] * 5}, "one positive number"),
        ({"motion": True, "noise": [1.0] * 5 + [0.0]}, "one positive number"),
        ({"motion": True, "noise": [1.0] * 5 + [np.nan]}, "one positive number"),
        ({"moving": ["elbow"]}, "elbow"),
        ({"measured": ["elbow"]}, "elbow"),
    ],
)
def test_circumstances_that_contradict_each_other_are_refused(ur10, given, said):
    motion = motion_of(ur10) if "motion" in given else None
    with pytest.raises(UnknownName if said == "elbow" else BadInput, match=said):
        analyze(ur10, **(given | {"motion": motion}))


def test_torque_that_is_not_measured_shows_nothing(planar: Robot) -> None:
    motion = motion_of(planar)
    first = analyze(planar, motion=motion, measured=["joint1"])
    both = analyze(planar, motion=motion)
    assert set(first.base.names) == set(both.base.names)
    for e in first.entries:
        if e.category == "unique":
            assert entry(both, e.name).std_data <= e.std_data * (1 + 1e-9)


def test_without_torque_limits_there_is_no_noise_to_assume(ur10: Robot) -> None:
    torque = np.where(np.arange(6) == 3, np.inf, ur10.limits.torque)
    unlimited = ur10.with_limits(replace(ur10.limits, torque=torque))
    with pytest.raises(BadInput, match=f"joint {ur10.joints[3]} has no torque limit"):
        analyze(unlimited, motion=motion_of(ur10))


def test_the_result_is_its_record_link_by_link(ur10: Robot) -> None:
    result = analyze(ur10, motion=motion_of(ur10)).result()
    record_of(as_saved(result, {})[0])
    assert (result["standard_parameters"], result["base_parameters"]) == (60, 36)
    assert [link["link"] for link in result["links"]] == list(ur10.links)
    seen: set[str] = set()
    for link in result["links"]:
        seen |= {*link["unique"], *link["unidentifiable"]}
        seen |= {name for c in link["combined"] for name in c["members"]}
        keys = {"value", "std", "prior", "prior_influence", "expression", "needed"}
        assert [keys <= set(p) for p in link["parameters"]] == [True] * 10
    assert len(seen) == 60


def test_level_is_information_per_noise(planar: Robot) -> None:
    motion, sigma = motion_of(planar), np.array([0.2, 0.1])
    one, half = (persistency(planar, motion, sigma=s) for s in (sigma, sigma / 2))
    # halving the noise makes four times the information, in at least as many directions
    assert len(half.levels) >= len(one.levels)
    assert half.levels[-1] == pytest.approx(4 * one.levels[-1], rel=1e-6)


def test_what_is_shown_is_counted_of_all_combinations(planar: Robot) -> None:
    """Against the information itself."""
    sigma, effects = np.array([20.0, 10.0]), standard_effects(planar.joints)
    base, counts = base_parameters(planar, effects), list[int]()
    prior = base_prior(planar, effects, base).covariance
    for motion in (motion_of(planar), motion_of(planar, resting=[1])):
        W = observation_columns(planar, effects, motion)[:, :, base.columns] / sigma[:, None]
        step = (motion.t[-1] - motion.t[0]) / (len(motion) - 1)
        J = min(1.0, ROWS_PER_SECOND * step) * np.einsum("njr,njs->rs", W, W)
        expected = int((np.linalg.eigvals(prior @ J).real >= 1).sum())
        whole = persistency(planar, motion, sigma=sigma)
        lively = reference_motion(planar, 10.0, ROWS_PER_SECOND)
        W = observation_columns(planar, effects, lively)[:, :, base.columns] / sigma[:, None]
        levels = np.linalg.eigvals(prior @ np.einsum("njr,njs->rs", W, W)).real
        assert len(whole.levels) == (levels >= 10).sum()  # what a motion can show well
        assert (whole.shown, whole.combinations) == (expected, len(base))
        assert f"{expected} of {len(base)} combinations" in whole.summary
        counts.append(expected)
    assert len(base) > counts[0] > counts[1] > 0


def test_a_motion_at_rest_shows_nothing_and_one_without_duration_is_refused(ur10: Robot) -> None:
    silent = persistency(ur10, motion_of(ur10, resting=range(6)))
    assert (silent.enough, silent.level) == (False, pytest.approx(0.0, abs=1e-6))
    assert set(silent.joints) >= set(ur10.joints[1:])  # gravity is along the first axis
    with pytest.raises(BadInput, match="a motion of 0 s"):
        persistency(ur10, motion_of(ur10)[:1], ())


@pytest.mark.parametrize("joint", [2, 5])
def test_the_resting_joint_is_named(ur10: Robot, joint: int) -> None:
    name, found = ur10.joints[joint], under(joint).motion.persistency
    assert (found.enough, found.joints[0]) == (False, name)
    assert found.level < 1
    assert {*found.weakest} <= {*under(joint).base.names}
    said = as_saved(under(joint).result(), {})[0]["persistency"]
    assert said["sentence"].endswith(f"move {', '.join(said['joints'])}")
    assert said["missing"] == found.missing
    assert json.loads(json.dumps(said, allow_nan=False)) == said


def test_gravity_in_the_plane_shows_first_moments_and_tilting_brings_it(planar: Robot) -> None:
    upright, level = analyze(planar), analyze(planar.with_gravity([0, -9.81, 0]))
    assert (len(upright.base), len(level.base)) == (6, 4)  # level: along the axes of both joints
    assert entry(level, "link1.mcz").needed.startswith("the base tilted by 90°")
    needed = [entry(level, name).needed for name in ("link1.m", "link2.mcx")]
    assert needed == [uncertainty.APART, None]
    shown = entry(upright, "link1.mcz")
    assert (shown.category, shown.needed) == ("unique", None)
    assert entry(upright, "link2.Iyz").needed.startswith("never by joint torques; by a force")
    falling = analyze(planar.with_gravity([0, 0, 0]))
    assert not any("tilted" in (e.needed or "") for e in falling.entries)
    assert "sensor under the base" in entry(falling, "link1.mcz").needed


def test_a_joint_that_rests_is_named_and_moving_it_helps(ur10: Robot) -> None:
    found, moves = under(2), "moving elbow_joint, which rests"
    lost = {p.name for p in found.practical if p.verdict == "not_shown"}
    assert {"elbow_joint.Fv", "elbow_joint.Fc", "elbow_joint.Ia"} <= lost
    assert found.motion.resting == ("elbow_joint",)
    assert {p.name for p in found.practical if p.needed == moves} == lost
    assert any("does not show" in note and "elbow_joint" in note for note in found.notes)
    motion = stacked(motion_of(ur10, resting=[2]), motion_of(ur10, 1))
    cured = analyze(ur10, effects=found.effects, motion=motion)
    assert not any(p.verdict == "not_shown" for p in cured.practical)
    for joint in (ur10.joints[1], ur10.joints[4]):  # of two, the one that matters
        assert entry(under(1, 4), f"{joint}.Fv").needed == f"moving {joint}, which rests"


def test_joints_that_do_not_move_are_what_is_missing(planar: Robot) -> None:
    alone = entry(analyze(planar, moving=["joint1"], measured=["joint1"]), "link2.mcx")
    assert alone.category != "unique"
    assert alone.needed == "moving joint2, which rests"
    both = analyze(planar, moving=["joint1", "joint2"], measured=["joint1"])
    assert entry(both, "link2.mcx").needed is None


def test_more_of_the_same_is_proposed_where_it_is_enough(ur10: Robot) -> None:
    motion, effects = motion_of(ur10)[np.arange(0, 500, 20)], standard_effects(ur10.joints)
    found = analyze(ur10, effects=effects, motion=motion)
    asked = [e for e in found.entries if (e.needed or "").startswith("about")]
    assert asked
    times = max(int(e.needed.split()[1]) for e in asked)
    longer = analyze(ur10, effects=effects, motion=stacked(*[motion] * times))
    assert [entry(longer, before.name).needed for before in asked] == [None] * len(asked)


def test_the_base_feels_what_newton_and_euler_say(ur10: Robot) -> None:
    motion = motion_of(ur10)[np.arange(0, 500, 50)]
    model, data = ur10.model, ur10.model.createData()
    for k, columns in enumerate(uncertainty.base_wrench_columns(ur10, motion)):
        pin.rnea(model, data, motion.q[k], motion.dq[k], motion.ddq[k])
        pin.forwardKinematics(model, data, motion.q[k])
        expected = data.oMi[1].act(data.f[1]).vector
        np.testing.assert_allclose(columns @ ur10.phi, expected, atol=1e-9)


@pytest.mark.parametrize("unit", [1.0, 1e-6, 1e6])
def test_what_is_not_seen_has_no_deviation(unit: float) -> None:
    X = np.random.default_rng(1).normal(size=(50, 1, 4))
    X[:, 0, 2], X[:, 0, 3] = 2 * X[:, 0, 1], 0.0
    X[:, 0, 0] *= unit
    A = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1], [0, 1, 2, 0.0], [1, 1, 2, 1]])
    std = uncertainty.deviations(uncertainty.triangle(X, np.ones(1)), A)
    assert np.isfinite(std).tolist() == [True, False, False, True, False]
    first, second = X[:, 0, 0] / np.linalg.norm(X[:, 0, 0]), X[:, 0, 1]
    alone = np.linalg.norm(second - first * (first @ second))  # what the first cannot imitate
    np.testing.assert_allclose(std[3], 1 / alone, rtol=1e-9)


def test_deviations_are_met_by_repeated_experiments_on_recursive_newton_euler(ur10: Robot) -> None:
    motion, draws = motion_of(ur10), 400
    sigma = 0.02 * ur10.limits.torque
    found = analyze(ur10, motion=motion, noise=sigma.tolist())
    tau = TrueArm(ur10.model).torque(motion)
    W = regressor(ur10, motion)[:, :, list(found.base.columns)] / sigma[:, None]
    solve = np.linalg.pinv(W.reshape(-1, len(found.base)))
    noisy = tau / sigma + np.random.default_rng(3).normal(size=(draws, *tau.shape))
    estimates = noisy.reshape(draws, -1) @ solve.T
    predicted = np.array([p.std for p in found.practical])
    np.testing.assert_allclose(predicted, np.linalg.norm(solve, axis=1), rtol=1e-9)
    spread = 1 / np.sqrt(2 * draws)  # of a standard deviation from so many draws
    ratio = estimates.std(axis=0, ddof=1) / predicted
    assert abs(ratio - 1).max() < 5 * spread
    error = (estimates.mean(axis=0) - [p.value for p in found.practical]) / predicted
    assert abs(error).max() < 5 / np.sqrt(draws)
    for column, std in zip(found.base.columns, predicted, strict=True):
        if found.entries[column].category == "unique":
            assert found.entries[column].std_data == pytest.approx(std)


@pytest.fixture(scope="module")
def judged(planar: Robot, runs: Runs) -> Judged:
    """A recording of the planar arm: what was identified, and what it shows."""
    recording, held = runs(planar, 0)
    estimate = identify_robot(planar, [recording], validate=[held])
    return Judged(estimate=estimate, found=analyze(planar, estimate=estimate))


def test_a_recording_gives_its_uncertainty_and_the_prior_decides_what_is_null(judged: Judged):
    std = np.sqrt(np.diag(judged.estimate.least_squares.covariance))
    np.testing.assert_array_equal([p.std for p in judged.found.practical], std)
    assert "residual" in judged.found.motion.basis
    for e in judged.found.entries:
        if e.category == "unidentifiable":
            assert (e.prior_influence, e.prior_dominated) == (pytest.approx(1.0, abs=1e-6), True)
    for name in ("link2.mcx", "joint1.Fv", "joint2.Fc"):
        assert entry(judged.found, name).prior_influence < 0.05
        assert entry(judged.found, name).decided_by == "data"


def test_bodies_at_their_limit_are_named(planar: Robot) -> None:
    given = prior_parameters(planar)
    root = np.linalg.cholesky(pseudo_inertia(given[1]))
    assert flat_links(given, given) == ()
    for thickness, named in ((1e-4, (1,)), (0.01, ())):  # beside the prior, in one direction
        phi = given.copy()
        phi[1] = from_pseudo_inertia(root @ np.diag([1.0, thickness, 1.0, 1.0]) @ root.T)
        assert flat_links(phi, given) == named


def test_a_recording_that_rests_a_joint_is_judged_as_far_as_it_goes(planar: Robot) -> None:
    motion = motion_of(planar, resting=[1])
    tau = TrueArm(planar.model).torque(motion)
    tau += 0.02 * np.random.default_rng(6).normal(size=tau.shape)
    recording = Recording("rest", "rest.csv", motion.t, motion.q, tau, dq=motion.dq)
    estimate = identify_shown(planar, [recording])
    found = analyze(planar, estimate=estimate)
    assert len(estimate.base) < len(found.base)
    hidden = [p.name for p in found.practical if p.verdict == "not_shown"]
    rests, moves = entry(found, "joint2.Fv"), entry(found, "joint1.Fv")
    assert rests.name in hidden
    assert rests.needed == "moving joint2, which rests"
    assert moves.prior_influence < 0.05 < 0.5 < rests.prior_influence  # it cannot follow below zero
    assert moves.verdict in ("negligible", "well")
    assert found.result()["resting_joints"] == ("joint2",)
