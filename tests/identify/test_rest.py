"""Joints at rest spoil no fit, whatever dry friction holds and whatever encoders toggle."""

from dataclasses import replace

import numpy as np
import pytest
from arms import TrueArm
from marks import refused, slow

from excitant.analysis.diagnosis import diagnose
from excitant.design import random_trajectory
from excitant.exceptions import BadRecording
from excitant.identify import Estimate, Recording, identify_link_by_link, identify_robot
from excitant.identify.export import publication
from excitant.identify.faults import find_faults
from excitant.identify.preprocessing import prepare
from excitant.robots import Array, Motion, load_robot
from excitant.robots.effects import standard_effects, turning_speed

ARM = load_robot("planar_2r")
DRIVES = {"Fv": [0.5, 0.3], "Fc": [1.0, 0.6], "offset": [0.2, -0.1], "Ia": [0.05, 0.02]}
TRUTH = TrueArm(ARM.model, **{name: np.array(values) for name, values in DRIVES.items()})
NOISE, STEP = 0.05, 2 * np.pi / 2**16  # N·m, rad
SHARP, FC = standard_effects(ARM.joints), [f"{joint}.Fc" for joint in ARM.joints]


def run(seed: int, moving=(0, 1), toggling=False, duration=10.0, turning=1e-9, arm=TRUTH):
    """Friction holds joints at rest with little change; toggling readings are random neighbours."""
    rng, t = np.random.default_rng(seed), np.arange(0, duration, 1 / 200)
    path = random_trajectory(ARM, rng, duration, 5)
    q, dq, ddq = (np.array(path(t, order)) for order in range(3))
    still = [j for j in range(2) if j not in moving]
    q[:, still], dq[:, still], ddq[:, still] = 0.7, 0.0, 0.0
    tau, read = arm.torque(Motion(t, q, dq, ddq)), STEP * np.round(q / STEP)
    tau += TRUTH.Fc * (np.tanh(dq / turning) - np.sign(dq))
    for j in still:
        held = tau[0, j] + TRUTH.Fc[j]
        for row in tau:
            row[j] = held = np.clip(held, row[j] - TRUTH.Fc[j], row[j] + TRUTH.Fc[j])
        read[:, j] += STEP * rng.integers(0, 2, len(t)) * toggling
    tau += NOISE * rng.standard_normal(tau.shape)
    return Recording(f"run {seed}", f"run{seed}.csv", t, read, tau)


HOLDOUT = [run(100)]


def poses(seed: int, count: int = 40) -> Recording:
    """A row each, 3 s apart, at which friction holds any torque."""
    rng, t = np.random.default_rng(seed), 3.0 * np.arange(count)
    q, still = rng.uniform(-2, 2, (count, 2)), np.zeros((count, 2))
    held = rng.uniform(-1, 1, (count, 2)) * TRUTH.Fc
    tau = TRUTH.torque(Motion(t, q, still, still)) + held
    return Recording(f"poses {seed}", f"poses{seed}.csv", t, q, tau)


@pytest.mark.parametrize(("factor", "fault"), [(-1.0, "wrong_sign"), (1e3, "wrong_unit")])
def test_a_wrong_sign_or_unit_shows_at_rest(factor: float, fault: str) -> None:
    assert not find_faults(ARM, poses(3))
    [found] = find_faults(ARM, replace(poses(3), tau=poses(3).tau * [1.0, factor]))
    assert (found.fault, found.joints) == (fault, ("joint2",))


def test_poses_show_gravity_and_offsets_alone() -> None:
    truth, off = np.append(ARM.phi, DRIVES["offset"]), list[float]()
    given = ARM.with_parameters(1.3 * ARM.phi)
    for seed in range(10):
        found = identify_robot(given, [poses(seed)], validate=[poses(seed + 50)])
        error = found.least_squares.beta - found.base.regrouping @ truth
        off += (error / found.base_std).tolist()
        assert publication(found).published
        shown = {row["name"].split(".")[1][0] for row in found.result()["parameters"]}
        assert shown == {"m", "o"}  # masses, first moments, offsets
    assert np.mean(np.abs(off) < 1.96) > 0.85  # of 60, 57 ± 1.7
    log = poses(0)
    assert not publication(identify_robot(ARM, [replace(log, tau=log.tau * [1, -1])])).published
    moving = replace(log, dq=np.full_like(log.q, 0.5))
    wrong = (
        (log, replace(log, t=log.t + 1), "unseen"),
        (poses(1, 5), log, "more"),
        (moving, log, "joint1 at 0.5 rad/s here.*rows .* s apart do not show accelerations"),
    )
    for fit, held, why in wrong:
        refused(why, identify_robot, ARM, [fit], validate=[held], error=BadRecording)


def friction(estimate: Estimate) -> Array:
    return estimate.to_frame()["value"][FC].to_numpy()


@pytest.fixture(scope="module")
def good() -> Estimate:
    return identify_robot(ARM, [run(1)], validate=HOLDOUT)


@pytest.mark.parametrize("toggling", [False, True])
@pytest.mark.parametrize("count", [slow(1), 3, slow(10)])
def test_recordings_in_which_a_joint_rests_spoil_nothing(good, count, toggling):
    resting = [run(10 + k, (0,), toggling, 4.0) for k in range(count)]
    found = identify_robot(ARM, [run(1), *resting], validate=HOLDOUT)
    # their own noise moves the hold-out error by some per cent; what friction holds, by a factor
    assert (found.validate.rms < 1.1 * good.validate.rms).all()
    assert (np.abs(friction(found) - TRUTH.Fc) < 0.02).all()
    assert any("joint2" in note and "left out of the fit" in note for note in found.notes)


def test_what_a_hold_out_at_rest_does_not_show_is_undecided() -> None:
    found = diagnose(ARM.with_effects(()), [run(1)], validate=[run(100, (0,))]).findings
    verdicts = {f.effect.joints: f.verdict for f in found if f.effect.name == "coulomb_friction"}
    assert verdicts == {("joint1",): "named", ("joint2",): "undecided"}


def test_friction_turns_over_the_speeds_over_which_that_of_the_arm_turns() -> None:
    logs, held = [run(k, turning=0.2) for k in (1, 2)], [run(100, turning=0.2)]
    found, jump = (identify_robot(ARM, logs, validate=held, effects=x) for x in (None, SHARP))
    effects = [e.without_values() for e in found.model.effects]
    known = identify_robot(ARM, logs, validate=held, effects=effects)
    reversals, at = found.result()["reversals"], [found.base.names.index(n) for n in FC]
    assert [abs(r["speed"] - 0.2) < 4 * r["std"] < 0.05 for r in reversals] == [True, True]
    assert (found.validate.rms_all < 0.8 * jump.validate.rms_all).all()
    std, far = found.std[at], np.abs(friction(found) - TRUTH.Fc)
    assert ((std > 1.05 * known.std[at]) & (far < 4 * std)).all()
    # what diagnose names, beside friction that the model has, is the law of identify
    given = ARM.with_effects([e.with_values(DRIVES[e.terms[0].name]) for e in SHARP])
    diagnosis, sharp = diagnose(given, logs, validate=held), diagnose(given, [run(1)])
    verdicts = {(f.effect.name, f.verdict) for f in diagnosis.findings}
    assert ("gradual_reversal", "named") in verdicts
    assert ({name for name, _ in verdicts}, sharp.findings) == ({"gradual_reversal"}, ())
    laws = {e.without_values() for e in diagnosis.extension.model.effects if turning_speed(e)}
    assert laws == {e for e in effects if turning_speed(e)}
    assert (diagnosis.extended.rms < 1.05 * found.validate.rms).all()


@pytest.mark.parametrize("apparent", [0.02, -0.03])  # kg·m²; friction that lags takes some off
def test_a_rotor_that_none_can_be_is_told_as_what_the_model_lacks(apparent: float) -> None:
    arm = replace(TRUTH, Ia=np.array([0.05, apparent]))
    found = identify_robot(ARM, [run(1, arm=arm)], validate=[run(100, arm=arm)])
    told = any("joint2.Ia = -0.0" in note for note in found.result()["notes"])
    assert told == np.isnan(found.std[found.base.names.index("joint2.Ia")]) == (apparent < 0)


@pytest.mark.parametrize("toggling", [slow(False), True])
def test_one_joint_at_a_time_as_in_the_papers_offline_procedure(toggling: bool) -> None:
    single = [run(20 + k, (k % 2,), toggling, 4.0) for k in range(4)]
    runs = [*single, run(1)]
    found = identify_link_by_link(ARM, runs, validate=HOLDOUT)
    effects = standard_effects(ARM.joints)
    both = found.estimate, identify_robot(ARM, runs, validate=HOLDOUT, effects=effects)
    assert (np.abs([*map(friction, both)] - TRUTH.Fc) < 0.02).all()
    assert (np.abs(both[0].validate.rms / both[1].validate.rms - 1) < 0.03).all()


def test_a_reading_that_toggles_has_no_direction() -> None:
    rng, step, t = np.random.default_rng(0), 2 * np.pi / 2**12, np.arange(0, 20, 1 / 500)
    readings = 1 + step * (np.cumsum(rng.random((len(t), 4)) < [0.5, 0.02, 0.002, 0], axis=0) % 2)
    [segment] = prepare(Recording("n", "f.csv", t, readings, np.zeros_like(readings)))
    assert not segment.motion.dq.any()  # held exactly
    creeping = 1.0 + step * np.round(0.3 * t[:, None] / step)
    [segment] = prepare(Recording("n", "f.csv", t, creeping, np.zeros_like(creeping)))
    assert (segment.motion.dq[segment.keep] > segment.least_speed).all()


@pytest.mark.parametrize("jump", [slow(1e-12), 1e-9, slow(1e-8)])
def test_a_joint_that_rests_is_not_accused_of_what_nobody_sees(jump: float) -> None:
    log, rng = run(3, moving=(0,)), np.random.default_rng(0)
    q, now = np.array(log.q), rng.random(len(log)) < [[0.3], [0.002]]  # off now and then
    q[:, 0] += 2e-5 * rng.standard_normal(len(q))
    for dither in (jump / 50 * rng.random(len(q)) * now[0], jump * now[1]):
        q[:, 1] = 0.97973 + dither
        q[700, 1] += 5 * jump
        faults = find_faults(ARM, Recording("n", "f.csv", log.t, q, log.tau))
        assert "corrupt_rows" not in [fault.fault for fault in faults]
