"""A cause common to all joints is named when all of them agree on it, and only then."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from excitant.analysis.diagnosis import Diagnosis, diagnose
from excitant.identify import Recording
from excitant.robots import Robot
from excitant.robots.virtual_arm import HiddenEffect, industrial_sensors

Runs = Callable[..., list[Recording]]
LEVER = "joint1"


def tilted(robot: Robot, recording: Recording, shares: list[float]) -> Recording:
    """The recording with the torque as if gravity came from elsewhere, joints by their shares."""
    model = pin.buildModelFromXML(robot.urdf)
    data = model.createData()
    model.gravity.linear = np.array([1.7, -1.0, -9.61])
    turned = np.array([pin.computeGeneralizedGravity(model, data, q).copy() for q in recording.q])
    model.gravity.linear = robot.gravity
    upright = np.array([pin.computeGeneralizedGravity(model, data, q).copy() for q in recording.q])
    return replace(recording, tau=recording.tau + (turned - upright) * shares)


def gravity_findings(diagnosis: Diagnosis) -> list[Any]:
    return [f for f in diagnosis.findings if f.effect.name == "gravity_direction"]


@pytest.mark.parametrize("shares", [[1.0] * 6, [1.0, 1.0, 0.7, 0.3, 0.0, 0.0]])
def test_gravity_turns_for_all_joints_or_for_none(
    shares: list[float], ur10: Robot, runs: Runs
) -> None:
    recordings = [
        tilted(ur10, recording, shares)
        for recording in runs(ur10, 8, (), industrial_sensors(ur10), 0.03, duration=15.0)
    ]
    diagnosis = diagnose(ur10, recordings[:1], validate=recordings[1:])
    found = gravity_findings(diagnosis)
    if min(shares) == 1:
        [finding] = found
        assert finding.verdict == "named"
        change = np.array(finding.effect.values)
        np.testing.assert_allclose(change, [1.7, -1.0, 0.2], atol=0.15)
    else:
        assert not found


def test_play_that_is_never_crossed_is_not_called_play(planar: Robot, runs: Runs) -> None:
    """A lever that always hangs to one side leans on one flank: its encoder may be off instead."""
    off = HiddenEffect("encoder_offset", LEVER, (("offset", 0.08),))
    sensors = industrial_sensors(planar)
    recordings = runs(planar, 5, (off,), sensors, 0.0, duration=12.0)
    diagnosis = diagnose(planar, recordings[:1], validate=recordings[1:])
    assert diagnosis.findings
    lead = diagnosis.findings[0]
    names = {lead.effect.name, *(r.candidate.effect.name for r in lead.rivals)}
    assert "encoder_offset" in names
    assert lead.effect.name != "backlash"
