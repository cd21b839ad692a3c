"""What a virtual arm hides is named where it is; what it does not hide is not.

The virtual arm shares no code with the effects that are fitted.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from excitant.analysis.diagnosis import Diagnosis, diagnose
from excitant.identify import Recording, model_files
from excitant.identify.preprocessing import prepare
from excitant.robots import Robot, load_robot, torque
from excitant.robots.virtual_arm import HiddenEffect, draw_hidden_effect, industrial_sensors

Runs = Callable[..., list[Recording]]
Example = tuple[Robot, Recording, Diagnosis]
PAN, LIFT, ELBOW = "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"
WRISTS = ("wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
DRAWN = (
    "viscous_friction",
    "coulomb_friction",
    "stribeck_friction",
    "rotor_inertia",
    "payload",
    "torque_offset",
)
SCALAR = {"viscous_friction", "coulomb_friction", "rotor_inertia", "torque_offset"}
SEEDS, CLEAN = 6, 10  # of each arm


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


def drawn(robot: Robot, kind: str, seed: int) -> HiddenEffect:
    """An effect of this kind, on a joint and of a size that the virtual arm draws."""
    rng = np.random.default_rng([seed, DRAWN.index(kind)])
    while (effect := draw_hidden_effect(robot, rng)).effect != kind:
        pass
    return effect


def diagnosed(
    robot: Robot, runs: Runs, seed: int, *effects: HiddenEffect, duration: float = 10.0
) -> Diagnosis:
    sensors = industrial_sensors(robot)
    excitation, holdout = runs(robot, seed, effects, sensors, 0.03, duration=duration)
    return diagnose(robot, [excitation], validate=[holdout])


def right(diagnosis: Diagnosis, effect: HiddenEffect) -> bool:
    if not diagnosis.findings:
        return False
    lead = diagnosis.findings[0].effect
    return (lead.name, lead.joints) == (effect.effect, (effect.joint,))


@pytest.mark.parametrize("kind", DRAWN)
def test_what_is_hidden_is_found(kind: str, ur10: Robot, planar: Robot, runs: Runs) -> None:
    robot = ur10 if kind == "payload" else planar  # where a payload is a change of the last link
    effect = drawn(robot, kind, 0)
    diagnosis = diagnosed(robot, runs, 1, effect)
    assert right(diagnosis, effect), diagnosis.headline
    lead = diagnosis.findings[0]
    assert lead.rms_after < lead.rms_before
    assert lead.explained > 0
    value, true = (lead.effect.values or ())[0], effect.parameters[0][1]
    if kind in SCALAR:
        # the truth's own friction is off its nominal value by up to 5 %
        given = lead.given[0]
        assert abs(value - given - true) <= 4 * lead.std[0] + 0.05 * given + 0.1 * abs(true)
    if kind == "payload":
        assert value == pytest.approx(dict(effect.parameters)["m"], rel=0.3)


def marked(effect: HiddenEffect) -> Any:
    name = f"{effect.effect}-{'-'.join(effect.acts_on) or 'all'}"
    fast = effect.effect == "presliding_hysteresis"
    return pytest.param(effect, marks=() if fast else pytest.mark.slow, id=name)


@pytest.mark.parametrize("effect", [marked(effect) for effect in PLANTED])
def test_it_alone_is_named(effect: HiddenEffect, ur10: Robot, runs: Runs) -> None:
    diagnosis = diagnosed(ur10, runs, 100 + PLANTED.index(effect), effect, duration=15.0)
    result = diagnosis.result()
    lead = result["findings"][0]
    assert lead["effect"] == effect.effect, result["headline"]
    assert lead["verdict"] == "named", result["headline"]
    assert set(lead["joints"]) == set(effect.acts_on or ur10.joints)
    assert lead["holdout"]["rms_after"] < lead["holdout"]["rms_before"]
    assert not [f for f in result["findings"][1:] if f["verdict"] == "named"]


def test_what_no_candidate_describes_is_unknown(ur10: Robot, runs: Runs) -> None:
    """A torque that switches at random, as a sticking brake might."""
    values = (("amplitude", 10.0), ("rate", 1.0))
    switching = HiddenEffect("unknown", LIFT, values, structure="telegraph_torque")
    result = diagnosed(ur10, runs, 4, switching, duration=15.0).result()
    assert [f["effect"] for f in result["findings"]] == ["unknown"], result["headline"]
    assert result["findings"][0]["joints"] == [LIFT]
    assert "stay unexplained" in result["headline"]


@pytest.mark.parametrize(("name", "seed"), [("planar_2r", 0), ("ur10", 2)])
def test_nothing_hidden_nothing_named(name: str, seed: int, runs: Runs) -> None:
    diagnosis = diagnosed(load_robot(name), runs, seed)
    assert diagnosis.findings == ()
    assert diagnosis.headline.startswith("No cause stands out")


@pytest.mark.slow
def test_hidden_effects_are_found_in_nine_of_ten(ur10: Robot, runs: Runs) -> None:
    wrong, failures = 0, []
    for robot, seed in itertools.product((ur10, load_robot("panda")), range(SEEDS)):
        effect = draw_hidden_effect(robot, np.random.default_rng([7, seed]))
        diagnosis = diagnosed(robot, runs, 100 + seed, effect)
        if not right(diagnosis, effect):
            wrong += bool(diagnosis.findings) and diagnosis.findings[0].verdict == "named"
            failures.append((robot.name, seed, effect.effect, effect.joint, diagnosis.headline))
    assert len(failures) <= 0.1 * 2 * SEEDS, failures
    assert wrong <= 0.05 * 2 * SEEDS, failures


@pytest.mark.slow
def test_clean_arms_have_nothing_named(ur10: Robot, runs: Runs) -> None:
    alarms = []
    for robot, seed in itertools.product((ur10, load_robot("panda")), range(CLEAN)):
        diagnosis = diagnosed(robot, runs, 200 + seed)
        if any(finding.verdict == "named" for finding in diagnosis.findings):
            alarms.append((robot.name, seed, diagnosis.headline))
    assert len(alarms) <= 0.05 * 2 * CLEAN, alarms


@pytest.mark.parametrize(
    "shares", [[1.0] * 6, pytest.param([1.0, 1.0, 0.7, 0.3, 0.0, 0.0], marks=pytest.mark.slow)]
)
def test_gravity_turns_for_all_joints_or_for_none(
    shares: list[float], ur10: Robot, runs: Runs
) -> None:
    """Torque as if gravity came from elsewhere, joints by their shares."""
    model, data = ur10.model.copy(), ur10.model.createData()
    recordings = []
    for recording in runs(ur10, 8, (), industrial_sensors(ur10), 0.03):
        torques = []
        for gravity in (np.array([1.7, -1.0, -9.61]), ur10.gravity):
            model.gravity.linear = gravity
            each = [pin.computeGeneralizedGravity(model, data, q).copy() for q in recording.q]
            torques.append(np.array(each))
        recordings.append(
            replace(recording, tau=recording.tau + (torques[0] - torques[1]) * shares)
        )
    diagnosis = diagnose(ur10, recordings[:1], validate=recordings[1:])
    found = [f for f in diagnosis.findings if f.effect.name == "gravity_direction"]
    if min(shares) < 1:
        assert not found
        return
    [finding] = found
    assert finding.verdict == "named"
    np.testing.assert_allclose(np.array(finding.effect.values), [1.7, -1.0, 0.2], atol=0.15)


def test_play_that_is_never_crossed_is_not_called_play(planar: Robot, runs: Runs) -> None:
    """A lever that always hangs to one side leans on one flank: its encoder may be off instead."""
    off = hidden("encoder_offset", "joint1", offset=0.08)
    recordings = runs(planar, 5, (off,), industrial_sensors(planar), 0.0, duration=12.0)
    lead = diagnose(planar, recordings[:1], validate=recordings[1:]).findings[0]
    names = {lead.effect.name, *(r.candidate.effect.name for r in lead.rivals)}
    assert "encoder_offset" in names
    assert lead.effect.name != "backlash"


@pytest.fixture(scope="module")
def example(planar: Robot, runs: Runs) -> Example:
    effect = drawn(planar, "coulomb_friction", 3)
    recordings = runs(planar, 3, (effect,), industrial_sensors(planar), 0.03)
    return planar, recordings[1], diagnose(planar, recordings[:1], validate=recordings[1:])


def test_gains_are_those_of_the_written_model(example: Example, tmp_path: Path) -> None:
    robot, holdout, diagnosis = example
    for name, text in model_files(diagnosis.extension.model, "extended", "extended.yaml").items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    written = load_robot(tmp_path / "extended.yaml")
    [segment] = prepare(holdout, diagnosis.data.cutoff_hz)
    measured = segment.tau[segment.keep]
    for model, reported in ((robot, diagnosis.simulation), (written, diagnosis.extended)):
        error = measured - segment.filtered(torque(model, segment.motion))[segment.keep]
        rms = np.sqrt((error**2).mean(axis=0))
        np.testing.assert_allclose(reported.rms, rms, rtol=1e-6)
        np.testing.assert_allclose(reported.nrmse, rms / measured.std(axis=0), rtol=1e-6)
    lead = diagnosis.findings[0]
    j = robot.joint_index(lead.effect.joints[0])
    assert lead.rms_after == pytest.approx(diagnosis.extended.rms[j], rel=1e-9)


def test_a_finding_is_the_extended_model_without_it(
    example: Example,
) -> None:
    robot, holdout, diagnosis = example
    lead, without = diagnosis.findings[0], []
    for effect in diagnosis.extension.model.effects:
        values = list(effect.values or ())
        if effect.name == lead.effect.name:
            values[effect.joints.index(lead.effect.joints[0])] = lead.given[0]
        without.append(effect.with_values(values))
    j = robot.joint_index(lead.effect.joints[0])
    [segment] = prepare(holdout, diagnosis.data.cutoff_hz)
    tau = segment.filtered(torque(diagnosis.extension.model.with_effects(without), segment.motion))
    error = segment.tau[segment.keep] - tau[segment.keep]
    assert lead.rms_before == pytest.approx(np.sqrt((error[:, j] ** 2).mean()), rel=1e-6)


def test_the_result_has_the_agreed_keys(example: Example) -> None:
    robot, _, diagnosis = example
    result, arrays = diagnosis.result(), diagnosis.series()
    assert {"simulation", "faults", "findings", "unexplained", "extended"} <= set(result)
    for part in ("simulation", "extended"):
        assert [j["name"] for j in result[part]["joints"]] == list(robot.joints)
        assert all({"name", "rms", "nrmse", "r2"} <= set(j) for j in result[part]["joints"])
    keys = {"effect", "joints", "parameters", "explained", "holdout", "verdict", "rivals"}
    for finding in result["findings"]:
        assert keys <= set(finding)
        assert {"rms_before", "rms_after"} == set(finding["holdout"])
        assert all({"name", "value", "std", "unit"} <= set(p) for p in finding["parameters"])
        assert finding["verdict"] in ("named", "undecided")
    explained = [f["explained"] for f in result["findings"]]
    assert explained == sorted(explained, reverse=True)
    for entry in result["unexplained"]:
        assert {"joint", "share", "structure"} <= set(entry)
        assert 0 <= entry["share"] <= 1
    assert {len(values) for values in arrays.values()} == {len(diagnosis.held.series.t)}
