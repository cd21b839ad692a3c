"""Links that all weigh the same say nothing: their inertias are left to the data."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from excitant.analysis.diagnosis import diagnose
from excitant.analysis.diagnosis_result import diagnose_result
from excitant.analysis.tolerance import are_placeholders
from excitant.identify import Recording
from excitant.robots import Robot
from excitant.robots.virtual_arm import HiddenEffect, industrial_sensors

Runs = Callable[..., list[Recording]]
BODY = (1.0, 0.0, 0.0, 0.0, 0.01, 0.0, 0.01, 0.0, 0.0, 0.01)
LIFT = "shoulder_lift_joint"
OFFSET = HiddenEffect("torque_offset", LIFT, (("offset", 8.0),))


def test_what_is_hidden_is_found_without_inertias(ur10: Robot, runs: Runs) -> None:
    """No axis is moved, no spring hung up to make up for masses."""
    recordings = runs(ur10, 2, (OFFSET,), industrial_sensors(ur10), 0.03, duration=15.0)
    given = ur10.with_parameters(np.tile(BODY, ur10.nv))
    assert are_placeholders(given)
    assert not are_placeholders(ur10)
    diagnosis = diagnose(given, recordings[:1], validate=recordings[1:])
    [finding] = diagnosis.findings
    effects = [finding.effect, *(r.candidate.effect for r in finding.rivals)]
    assert "torque_offset" in {e.name for e in effects if e.joints == (LIFT,)}
    assert (diagnosis.extended.nrmse < 0.05).all()
    result = diagnose_result(diagnosis)
    assert result["headline"].startswith("All links of the given model weigh 1 kg")
    assert "Beside inertias: " in result["headline"]
    assert any("fitted together with the causes" in note for note in result["notes"])
