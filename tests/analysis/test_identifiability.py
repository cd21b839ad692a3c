"""What cannot be known changes no torque; what can, does; more data say it better."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from excitant.analysis.identifiability import analyze, analyze_result
from excitant.design import random_trajectory
from excitant.exceptions import BadInput, RankDeficient
from excitant.identify import Recording, identify
from excitant.robots import Limits, Motion, Robot, load_robot
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
    category = np.array(found.category)
    silent = np.abs(W).max(axis=0) <= 1e-9 * np.abs(W).max()
    moved = np.abs(null).max(axis=1) > 1e-8
    assert (silent == (category == "unidentifiable")).all()
    assert (~moved == (category == "unique")).all()
    assert set(category) <= {"unique", "combined", "unidentifiable"}


def test_what_is_known_of_the_planar_arm(planar: Robot) -> None:
    found = analyze(planar)
    assert len(found.base) == 6  # of each link: two first moments, and inertia about the axis
    assert found.category.count("unidentifiable") > 0
    assert found.practical == ()
    assert found.condition_number is None


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
    assert once.condition_number is not None
    tolerance = 1e-15 * once.condition_number**2 + 1e-9
    np.testing.assert_allclose(ratio, 3.0, rtol=tolerance)
    assert nine.condition_number == pytest.approx(once.condition_number, rel=1e-9)


def test_a_recording_gives_its_own_uncertainty(
    ur10: Robot, runs: Callable[..., list[Recording]]
) -> None:
    recording, held = runs(ur10, 0)
    estimate = identify(ur10, [recording], validate=[held])
    found = analyze(ur10, estimate=estimate)
    std = np.sqrt(np.diag(estimate.least_squares.covariance))
    np.testing.assert_array_equal([p.std for p in found.practical], std)
    assert "residual" in found.basis


def test_verdicts_follow_the_uncertainty(ur10: Robot) -> None:
    found = analyze(ur10, effects=standard_effects(ur10.joints), motion=repeated(ur10, 1))
    for p in found.practical:
        if p.rel_std is not None and p.rel_std <= 0.3:
            assert p.verdict == ("well" if p.rel_std <= 0.1 else "roughly")
        else:
            assert p.verdict == ("negligible" if p.negligible else "hardly")


def test_a_motion_at_rest_is_refused(ur10: Robot) -> None:
    still = np.zeros((100, 6))
    with pytest.raises(RankDeficient, match="does not determine"):
        analyze(ur10, motion=Motion(np.arange(100) / 100, still, still, still))


def test_without_torque_limits_there_is_no_noise_to_assume(ur10: Robot) -> None:
    limits = ur10.limits
    torque = np.array(limits.torque)
    torque[3] = np.inf
    unlimited = ur10.with_limits(
        Limits(limits.position, limits.velocity, limits.acceleration, torque)
    )
    with pytest.raises(BadInput, match=f"joint {ur10.joints[3]} has no torque limit"):
        analyze(unlimited, motion=repeated(ur10, 1))


def test_the_result_has_the_agreed_keys(ur10: Robot) -> None:
    result = analyze_result(analyze(ur10, motion=repeated(ur10, 1)))
    agreed = {"standard_parameters", "base_parameters", "links", "condition_number", "practical"}
    assert agreed <= set(result)
    assert (result["standard_parameters"], result["base_parameters"]) == (60, 36)
    assert [entry["link"] for entry in result["links"]] == list(ur10.links)
    for entry in result["links"]:
        assert {"link", "unique", "combined", "unidentifiable"} <= set(entry)
        assert all({"expression", "members"} <= set(c) for c in entry["combined"])
    assert all(
        {"name", "std", "rel_std", "verdict"} == set(p) - {"value"} for p in result["practical"]
    )


def test_every_parameter_appears_in_the_result(ur10: Robot) -> None:
    result = analyze_result(analyze(ur10, effects=standard_effects(ur10.joints)))
    seen: set[str] = set()
    for entry in result["links"]:
        seen |= {*entry["unique"], *entry["unidentifiable"]}
        seen |= {name for c in entry["combined"] for name in c["members"]}
    assert len(seen) == result["standard_parameters"]
