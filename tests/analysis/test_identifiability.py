"""What cannot be known changes no torque; what can, does; more data say it better."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from excitant.analysis.identifiability import analyze
from excitant.design import random_trajectory
from excitant.exceptions import BadInput, UnknownName
from excitant.identify import Recording, identify_robot
from excitant.reports.run import as_saved
from excitant.robots import Motion, Robot, load_robot
from excitant.robots.effects import standard_effects
from excitant.robots.torque import observation_columns


@pytest.mark.parametrize("name", ["planar_2r", "ur10", "panda"])
@pytest.mark.parametrize("friction", [False, True])
def test_categories_are_what_torque_can_show(name: str, friction: bool) -> None:
    robot = load_robot(name)
    effects = standard_effects(robot.joints) if friction else ()
    found = analyze(robot, effects=effects)
    motion = Motion(np.arange(50) / 10, *robot.random_motion(np.random.default_rng(9), 50))
    W = observation_columns(robot, effects, motion).reshape(-1, len(found.base.names))
    null = found.base.null_space
    assert np.abs(W @ null).max() <= 1e-9 * np.abs(W).max()
    assert np.linalg.matrix_rank(W, tol=1e-9 * np.linalg.norm(W)) == len(found.base)
    category = np.array(found.structure.category)
    silent = np.abs(W).max(axis=0) <= 1e-9 * np.abs(W).max()
    moved = np.abs(null).max(axis=1) > 1e-8
    assert (silent == (category == "unidentifiable")).all()
    assert (~moved == (category == "unique")).all()
    assert set(category) <= {"unique", "combined", "unidentifiable"}


def test_what_is_known_of_the_planar_arm(planar: Robot) -> None:
    found = analyze(planar)
    assert len(found.base) == 6  # of each link: two first moments, and inertia about the axis
    assert found.structure.category.count("unidentifiable") > 0
    assert found.practical == ()
    assert found.motion is None


def repeated(robot: Robot, times: int) -> Motion:
    motion = random_trajectory(robot, np.random.default_rng(0), 10.0, 5).motion(50.0)
    return Motion(
        np.arange(times * len(motion)) / 50.0,
        *(np.tile(x, (times, 1)) for x in (motion.q, motion.dq, motion.ddq)),
    )


def test_uncertainty_shrinks_with_the_root_of_the_samples(ur10: Robot) -> None:
    once, nine = (analyze(ur10, motion=repeated(ur10, k)) for k in (1, 9))
    ratio = [a.std / b.std for a, b in zip(once.practical, nine.practical, strict=True)]
    # the inverse of WᵀW loses at most cond(W)² of the sixteen digits
    tolerance = 1e-15 * once.motion.condition_number**2 + 1e-9
    np.testing.assert_allclose(ratio, 3.0, rtol=tolerance)
    assert nine.motion.condition_number == pytest.approx(once.motion.condition_number, rel=1e-9)


def test_a_recording_gives_its_own_uncertainty(
    planar: Robot, runs: Callable[..., list[Recording]]
) -> None:
    recording, held = runs(planar, 0)
    estimate = identify_robot(planar, [recording], validate=[held])
    found = analyze(planar, estimate=estimate)
    std = np.sqrt(np.diag(estimate.least_squares.covariance))
    np.testing.assert_array_equal([p.std for p in found.practical], std)
    assert found.motion is not None
    assert "residual" in found.motion.basis


def test_verdicts_follow_the_uncertainty(ur10: Robot) -> None:
    found = analyze(ur10, effects=standard_effects(ur10.joints), motion=repeated(ur10, 1))
    for p in found.practical:
        if p.rel_std is not None and p.rel_std <= 0.3:
            assert p.verdict == ("well" if p.rel_std <= 0.1 else "roughly")
        else:
            assert p.verdict == ("negligible" if p.negligible else "hardly")


def test_a_motion_at_rest_shows_what_gravity_does_and_no_more(ur10: Robot) -> None:
    still = np.zeros((100, 6))
    found = analyze(ur10, motion=Motion(np.arange(100) / 100, still, still, still))
    hidden = [p for p in found.practical if p.verdict == "not_shown"]
    assert len(found.base) - 6 <= len(hidden) < len(found.base)  # one equation for each joint
    assert found.motion is not None
    assert found.motion.resting == ur10.joints
    assert found.motion.condition_number == np.inf
    result = found.result()
    assert len(result["not_shown"]) == len(hidden)
    assert any("does not show" in note for note in result["notes"])
    saved, _ = as_saved(found.result(), {})
    assert saved["condition_number"] is None


def test_circumstances_that_contradict_each_other_are_refused(ur10: Robot) -> None:
    motion = repeated(ur10, 1)
    with pytest.raises(BadInput, match="moving"):
        analyze(ur10, motion=motion, moving=ur10.joints[:2])
    with pytest.raises(BadInput, match="noise"):
        analyze(ur10, noise=[1.0] * 6)
    with pytest.raises(BadInput, match="at least one joint"):
        analyze(ur10, measured=[])
    with pytest.raises(UnknownName, match="elbow"):
        analyze(ur10, moving=["elbow"])
    for noise in ([1.0] * 5, [1.0] * 5 + [0.0], [1.0] * 5 + [np.nan]):
        with pytest.raises(BadInput, match="one positive number"):
            analyze(ur10, motion=motion, noise=noise)


def test_torque_that_is_not_measured_shows_nothing(planar: Robot) -> None:
    motion = repeated(planar, 1)
    first = analyze(planar, motion=motion, measured=["joint1"])
    both = analyze(planar, motion=motion)
    assert set(first.base.names) == set(both.base.names)
    by_name = {e.name: e for e in both.entries}
    assert all(
        by_name[e.name].std_data <= e.std_data * (1 + 1e-9)
        for e in first.entries
        if e.category == "unique"
    )


def test_without_torque_limits_there_is_no_noise_to_assume(ur10: Robot) -> None:
    torque = np.where(np.arange(6) == 3, np.inf, ur10.limits.torque)
    unlimited = ur10.with_limits(replace(ur10.limits, torque=torque))
    with pytest.raises(BadInput, match=f"joint {ur10.joints[3]} has no torque limit"):
        analyze(unlimited, motion=repeated(ur10, 1))


def test_the_result_has_the_agreed_keys(ur10: Robot) -> None:
    result = analyze(ur10, motion=repeated(ur10, 1)).result()
    agreed = {"standard_parameters", "base_parameters", "links", "condition_number", "practical"}
    assert agreed <= set(result)
    assert (result["standard_parameters"], result["base_parameters"]) == (60, 36)
    assert [entry["link"] for entry in result["links"]] == list(ur10.links)
    for entry in result["links"]:
        assert {"link", "unique", "combined", "unidentifiable"} <= set(entry)
        assert all({"expression", "members"} <= set(c) for c in entry["combined"])
    assert all({"name", "std", "rel_std", "verdict"} <= set(p) for p in result["practical"])
    keys = {"name", "category", "value", "std", "prior", "prior_influence", "expression", "needed"}
    seen = {name for x in result["links"] for name in (*x["unique"], *x["unidentifiable"])}
    seen |= {n for x in result["links"] for c in x["combined"] for n in c["members"]}
    assert len(seen) == 60
    for entry in result["links"]:
        assert len(entry["parameters"]) == 10
        assert all(keys <= set(p) for p in entry["parameters"])
    assert {"persistency", "directions", "correlations", "not_shown"} <= set(result)
