"""A motion of all joints is persistently exciting; a joint that rests is named."""

from __future__ import annotations

import json

import numpy as np
import pytest

from excitant.analysis.identifiability import analyze
from excitant.design import random_trajectory
from excitant.exceptions import BadInput
from excitant.identify.excitation import persistency
from excitant.reports.run import as_saved
from excitant.robots import Motion, Robot
from excitant.robots.effects import standard_effects


def wide(robot: Robot) -> Motion:
    return random_trajectory(robot, np.random.default_rng(0), 10.0, 5).motion(50.0)


def resting(motion: Motion, joint: int) -> Motion:
    """The motion with one joint at rest."""
    q, dq, ddq = (np.array(x) for x in (motion.q, motion.dq, motion.ddq))
    q[:, joint], dq[:, joint], ddq[:, joint] = q[0, joint], 0.0, 0.0
    return Motion(motion.t, q, dq, ddq)


def test_a_motion_without_motion_shows_nothing(ur10: Robot) -> None:
    motion = wide(ur10)
    still = Motion(motion.t, np.tile(motion.q[0], (len(motion), 1)), 0 * motion.q, 0 * motion.q)
    silent = persistency(ur10, still)
    assert (silent.enough, silent.shortest) == (False, None)
    assert silent.level == pytest.approx(0.0, abs=1e-6)
    assert set(silent.joints) >= set(ur10.joints[1:])  # gravity is along the first axis


def test_level_is_information_per_noise(planar: Robot) -> None:
    motion, sigma = wide(planar), np.array([0.2, 0.1])
    one, half = (persistency(planar, motion, sigma=s) for s in (sigma, sigma / 2))
    # halving the noise makes four times the information, in at least as many directions
    assert len(half.levels) >= len(one.levels)
    assert half.levels[-1] == pytest.approx(4 * one.levels[-1], rel=1e-6)


def test_windows_of_six_seconds_are_enough_for_two_joints(planar: Robot) -> None:
    found = persistency(planar, wide(planar))
    assert found.enough
    assert found.level > 1
    assert found.shortest is not None
    assert found.shortest <= 6.0


def test_a_motion_of_all_joints_is_exciting(ur10: Robot) -> None:
    effects = standard_effects(ur10.joints)
    motion = wide(ur10)
    found = persistency(ur10, motion, effects)
    assert found.enough
    assert found.level >= 1
    assert (found.missing, found.joints, found.weak) == (0, (), ())
    assert found.end - found.start == pytest.approx(10.0)
    assert 0 < found.shortest <= 10.0
    said = analyze(ur10, effects=effects, motion=motion).result()["persistency"]
    assert said["sentence"].startswith("persistently exciting over 10 s at level")


@pytest.mark.parametrize("joint", [2, 5])
def test_the_resting_joint_is_named(ur10: Robot, joint: int) -> None:
    effects = standard_effects(ur10.joints)
    motion = resting(wide(ur10), joint)
    found = persistency(ur10, motion, effects)
    assert not found.enough
    assert found.shortest is None
    assert found.level < 1
    assert found.joints[0] == ur10.joints[joint]
    assert found.weak[0].level == pytest.approx(found.level)
    assert all(ur10.joints[joint] in direction.joints for direction in found.weak)
    said = analyze(ur10, effects=effects, motion=motion).result()["persistency"]
    assert said["sentence"].endswith(f"move {', '.join(said['joints'])}")
    assert said["missing"] == found.missing
    saved = as_saved({"persistency": said}, {})[0]["persistency"]
    assert json.loads(json.dumps(saved, allow_nan=False)) == saved


def test_a_motion_without_duration_is_refused(ur10: Robot) -> None:
    with pytest.raises(BadInput, match="a motion of 0 s"):
        persistency(ur10, wide(ur10)[:1], ())
