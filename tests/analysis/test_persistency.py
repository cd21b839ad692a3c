"""A lively motion is persistently exciting; a joint that rests is named."""

from __future__ import annotations

import json

import numpy as np
import pytest

from excitant.analysis.persistency import persistency_result
from excitant.design import random_trajectory
from excitant.exceptions import BadInput
from excitant.identify.excitation import persistency
from excitant.robots import Motion, Robot
from excitant.robots.effects import standard_effects


def lively(robot: Robot) -> Motion:
    return random_trajectory(robot, np.random.default_rng(0), 10.0, 5).motion(50.0)


def resting(motion: Motion, joint: int, since: float) -> Motion:
    """The motion with one joint at rest from a time on."""
    q, dq, ddq = (np.array(x) for x in (motion.q, motion.dq, motion.ddq))
    late = motion.t >= since
    q[late, joint] = q[np.argmax(late), joint]
    dq[late, joint] = ddq[late, joint] = 0.0
    return Motion(motion.t, q, dq, ddq)


def test_a_lively_motion_is_exciting(ur10: Robot) -> None:
    effects = standard_effects(ur10.joints)
    found = persistency_result(ur10, effects, lively(ur10))
    assert found["persistent"]
    assert found["level"] >= 1
    assert found["missing"] == 0
    assert found["joints"] == found["weak"] == []
    assert found["window_s"] == pytest.approx(10.0)
    assert found["shortest_window_s"] <= found["window_s"]
    assert found["sentence"].startswith("persistently exciting over 10 s at level")


@pytest.mark.parametrize("joint", [2, 5])
def test_the_resting_joint_is_named(ur10: Robot, joint: int) -> None:
    effects = standard_effects(ur10.joints)
    found = persistency_result(ur10, effects, resting(lively(ur10), joint, 0.0))
    assert not found["persistent"]
    assert found["level"] < 1
    assert found["joints"][0] == ur10.joints[joint]
    assert found["sentence"].endswith(f"move {', '.join(found['joints'])}")
    assert found["weak"][0]["level"] == pytest.approx(found["level"])
    assert all(ur10.joints[joint] in direction["joints"] for direction in found["weak"])


def test_the_window_in_which_it_rests_is_found(ur10: Robot) -> None:
    effects = standard_effects(ur10.joints)
    motion = resting(lively(ur10), 5, 5.0)
    whole = persistency_result(ur10, effects, motion)
    halves = persistency_result(ur10, effects, motion, window=5.0)
    assert whole["level"] > halves["level"]
    last = halves["windows"][-1]
    assert last["end_s"] == pytest.approx(10.0)
    assert last["missing"] > 0
    assert last["joints"][0] == ur10.joints[5]
    assert not halves["persistent"]


def test_the_values_are_plain_and_those_of_the_measure(ur10: Robot) -> None:
    effects, motion = standard_effects(ur10.joints), resting(lively(ur10), 1, 3.0)
    found = persistency_result(ur10, effects, motion, window=4.0)
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    measure = persistency(ur10, motion, effects, window=4.0)
    assert found["level"] == measure.level
    assert len(found["windows"]) == len(measure.windows)
    assert found["persistent"] == all(w["missing"] == 0 for w in found["windows"])


def test_a_window_beyond_the_motion_is_refused(ur10: Robot) -> None:
    with pytest.raises(BadInput, match="window of 20 s"):
        persistency_result(ur10, (), lively(ur10), window=20.0)
