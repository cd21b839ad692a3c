"""Columns that are worked out once are those of the robot, whichever model asks for them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from excitant.analysis.candidates import Observed, observed
from excitant.identify import Recording
from excitant.identify.regression import regression_of
from excitant.identify.rows import predicted_torque, split
from excitant.robots import Robot
from excitant.robots.effects import (
    CoulombFriction,
    Effect,
    FrictionCoupling,
    KinematicError,
    LoadDependentFriction,
    Payload,
    TimeDelay,
    ViscousFriction,
)
from excitant.robots.virtual_arm import industrial_sensors

Runs = Callable[..., list[Recording]]
MOTION, ROBOT = ViscousFriction(("joint1", "joint2")), LoadDependentFriction(("joint1", "joint2"))


def effects(robot: Robot) -> list[Effect]:
    """One of each way in which an effect gets its columns."""
    joints = robot.joints
    return [
        Payload(joints[-1:], (0.5, *[0.01] * 9)),
        MOTION.with_values((0.3, 0.2)),
        ROBOT.with_values((0.05, 0.04)),
        FrictionCoupling(joints[:2], values=(0.1, 0.2)),
        KinematicError(joints[1:], (0.01, 0.0, -0.01)),
        TimeDelay(joints, (0.002,)),
    ]


@pytest.fixture(scope="module")
def rows(planar: Robot, runs: Runs) -> Observed:
    recordings = runs(planar, 3, (), industrial_sensors(planar), 0.03)
    return observed(planar, split(recordings[:1], recordings[1:], None).train)


def test_they_are_those_of_the_robot(rows: Observed, planar: Robot) -> None:
    model = planar.with_effects(effects(planar))
    found = rows.by(model)
    expected = regression_of(model, model.effects, rows.segments).W
    np.testing.assert_allclose(found.matrix(model.effects), expected, atol=1e-12)
    expected = predicted_torque(model, rows.segments)
    np.testing.assert_allclose(found.torque(), expected, atol=1e-9)


def test_another_model_of_the_arm_has_its_own(rows: Observed, planar: Robot) -> None:
    heavier = planar.with_parameters(2 * planar.phi)
    rows.matrix([MOTION, ROBOT])
    np.testing.assert_allclose(
        rows.by(heavier).columns(ROBOT), regression_of(heavier, [ROBOT], rows.segments).W[:, :, 20:]
    )
    assert np.abs(rows.by(heavier).columns(ROBOT) - rows.columns(ROBOT)).max() > 0.1


def test_each_is_worked_out_once(
    rows: Observed, planar: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the motion alone, for all models of the arm."""
    asked = []
    whole = CoulombFriction.columns
    monkeypatch.setattr(
        CoulombFriction, "columns", lambda *args: (asked.append(args[0].joints), whole(*args))[1]
    )
    heavier = rows.by(planar.with_parameters(2 * planar.phi))
    for joints in (planar.joints, planar.joints[:1], planar.joints[::-1]):
        for each in (rows, heavier):
            each.columns(CoulombFriction(joints, tuple(range(len(joints)))))
    assert sorted(asked) == [("joint1",), ("joint2",)]
