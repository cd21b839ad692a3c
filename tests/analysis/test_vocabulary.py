"""Each effect of the vocabulary, planted on a virtual arm, is named at its joint.

The plant shares no code with the effects that are fitted.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from excitant.analysis.diagnosis import diagnose
from excitant.analysis.diagnosis_result import diagnose_result
from excitant.identify import Recording
from excitant.robots import Robot
from excitant.robots.virtual_arm import HiddenEffect, industrial_sensors

Runs = Callable[..., list[Recording]]
PAN, LIFT, ELBOW = "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"
WRISTS = ("wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
FAST = {"gravity_direction", "presliding_hysteresis", "torque_ripple", "time_delay", "spring"}


def hidden(effect: str, *joints: str, **parameters: float) -> HiddenEffect:
    several = joints if len(joints) > 1 else ()
    return HiddenEffect(effect, joints[0] if joints else "", tuple(parameters.items()), several)


PLANTED = (
    hidden("gravity_direction", roll=0.1, pitch=-0.05),
    hidden("asymmetric_friction", ELBOW, Fc_plus=10.0, Fc_minus=2.0, Fv_plus=5.0, Fv_minus=0.0),
    hidden("stribeck_friction", PAN, Fs=15.0, velocity=0.1),
    hidden("nonlinear_viscous_friction", LIFT, Fn=8.0, exponent=2.0),
    hidden("load_dependent_friction", LIFT, Fl=0.1),
    hidden("presliding_hysteresis", PAN, Fh=10.0, distance=0.03),
    hidden("friction_coupling", *WRISTS[1:], Fv=1.0, Fc=2.0, ratio=1.0),
    hidden("thermal_friction_drift", LIFT, Fv=10.0, Fc=10.0, time=5.0),
    hidden("torque_gain", ELBOW, gain=1.1),
    hidden("torque_ripple", WRISTS[0], amplitude=3.0, order=20.0, phase=0.3),
    hidden("spring", LIFT, stiffness=20.0, rest=0.5),
    hidden("time_delay", ELBOW, delay=0.01),
    hidden("time_delay", delay=0.025),
    hidden("encoder_offset", ELBOW, offset=0.05),
    hidden("encoder_scale", ELBOW, scale=1.03),
    hidden("kinematic_error", ELBOW, dx=0.02, dy=0.02, dz=-0.01),
)


def marked(effect: HiddenEffect) -> Any:
    fast = effect.effect in FAST and effect.acts_on
    return pytest.param(
        effect,
        marks=() if fast else pytest.mark.slow,
        id=f"{effect.effect}-{'-'.join(effect.acts_on) or 'all'}",
    )


@pytest.mark.parametrize("effect", [marked(effect) for effect in PLANTED])
def test_it_is_named(effect: HiddenEffect, ur10: Robot, runs: Runs) -> None:
    seed = 100 + PLANTED.index(effect)
    recordings = runs(ur10, seed, (effect,), industrial_sensors(ur10), 0.03, duration=15.0)
    result = diagnose_result(diagnose(ur10, recordings[:1], validate=recordings[1:]))
    lead = result["findings"][0]
    assert lead["effect"] == effect.effect, result["headline"]
    assert lead["verdict"] == "named", result["headline"]
    assert set(lead["joints"]) == set(effect.acts_on or ur10.joints)
    assert lead["holdout"]["rms_after"] < lead["holdout"]["rms_before"]
    others = [f for f in result["findings"][1:] if f["verdict"] == "named"]
    assert not others, others


def test_what_no_candidate_describes_is_unknown(ur10: Robot, runs: Runs) -> None:
    """A torque that switches at random, as a sticking brake might."""
    switching = HiddenEffect(
        "unknown", LIFT, (("amplitude", 10.0), ("rate", 1.0)), structure="telegraph_torque"
    )
    recordings = runs(ur10, 4, (switching,), industrial_sensors(ur10), 0.03, duration=15.0)
    result = diagnose_result(diagnose(ur10, recordings[:1], validate=recordings[1:]))
    assert [f["effect"] for f in result["findings"]] == ["unknown"], result["headline"]
    assert result["findings"][0]["joints"] == [LIFT]
    assert "stay unexplained" in result["headline"]
