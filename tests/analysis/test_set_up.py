"""Set-up errors of arms whose torque MuJoCo computes, and what a diagnosis makes of them."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis import moving_arm, record
from marks import slow
from worlds_plant import Drawing, Plant, perturbed

from excitant.analysis.diagnosis import Diagnosis, _judged_set_up, diagnose
from excitant.analysis.set_up import SetUp, set_up
from excitant.design import random_trajectory
from excitant.identify import Recording
from excitant.identify.faults import find_faults, installation, shared_installation
from excitant.identify.faults.fault import Fault, Log
from excitant.identify.faults.installation import Installation
from excitant.identify.faults.torque_fit import smooth, torque_fit
from excitant.robots import Robot, load_robot
from excitant.robots.effects import CoulombFriction, ViscousFriction
from excitant.robots.motion import Motion
from excitant.robots.regressor import rigid_body_torque
from excitant.robots.torque import effect_values
from excitant.robots.urdf import robot_from_urdf

DURATION = 12.0  # s
SIDEWAYS, TURNED = (9.81, 0.0, 0.0), (3.2, -7.1, 5.96)
OF_SET_UPS = {"wrong_mounting", "wrong_zero", "wrong_sign", "wrong_order"}
pytestmark = pytest.mark.filterwarnings("ignore::excitant.exceptions.FaultWarning")


def recorded(
    robot: Robot, seed: int, gravity: tuple[float, ...] | None = None, off: float = 0.1
) -> list[Recording]:
    """Two motions with the torque of bodies off from the given ones, friction and white noise."""
    rng = np.random.default_rng(seed)
    true = perturbed(robot, rng, off)
    true = true if gravity is None else true.with_gravity(gravity)
    plant = Plant(true, *rng.uniform(0.01, 0.03, (2, robot.nv)) * robot.limits.torque)
    paths = ((random_trajectory(robot, rng, DURATION, 4), name) for name in ("fitted", "held"))
    return [record(plant, path, "white", 1.0, rng, name, DURATION) for path, name in paths]


def lead(diagnosis: Diagnosis) -> str:
    entry = diagnosis.result()["findings"][0]
    return f"{entry['effect']} {' '.join(entry['joints'][: 1 if len(entry['joints']) > 2 else 2])}"


def bare(robot: Robot) -> Robot:
    """The arm without friction, so that what the plant has is not given."""
    return robot.with_effects([])


def test_torques_exchanged_between_two_recordings_are_put_back(planar: Robot) -> None:
    fitted, held = recorded(bare(planar), 5)
    mixed = replace(fitted, tau=held.tau), replace(held, tau=fitted.tau)
    found, as_recorded = (
        diagnose(bare(planar), [one], validate=[other]) for one, other in (mixed, (fitted, held))
    )
    assert found.ordered[0].findings[0].effect.name == "swapped_recordings"
    np.testing.assert_allclose(found.extended.rms, as_recorded.extended.rms, rtol=1e-9)


def test_no_cause_is_named_while_a_joint_is_missed(planar: Robot) -> None:
    """Torque of the last joint is that of something else, in the hold-out of something faster."""
    both = recorded(bare(planar), 5)
    verdicts = []
    for size in (0.0, 3.0):
        disturbed = []
        for run, hz in zip(both, (1.7, 2.3), strict=True):
            other = size * run.tau[:, 1].std() * np.sin(2 * np.pi * hz * run.t)
            disturbed.append(replace(run, tau=run.tau + np.outer(other, [0, 1])))
        diagnosis = diagnose(bare(planar), disturbed[:1], validate=disturbed[1:])
        verdicts.append({f.verdict for f in diagnosis.findings})
    assert "named" in verdicts[0]
    assert verdicts[1] == {"undecided"}
    assert any("impossible stands beside it: it " in f.downgrade for f in diagnosis.findings)


@pytest.mark.slow
@pytest.mark.parametrize("world", [1, 3, 4])
def test_saturation_and_eccentricity_are_named_with_their_size(world: int) -> None:
    kind = "motor_saturation" if world < 4 else "encoder_eccentricity"
    rng = np.random.default_rng([977, world])
    robot, given, plant, paths = moving_arm(rng, 0.0)
    plant, hidden = Drawing(plant, given, paths, rng).hide(plant, kind, set())
    fitted, held = (record(plant, path, "white", 1.0, rng, "run") for path in paths)
    found = diagnose(robot, [fitted], validate=[held]).findings[0]
    assert (found.effect.name, found.effect.joints, found.verdict) == (kind, hidden.joints, "named")
    true = hidden.parameters.get("wave", [-1.0])
    np.testing.assert_allclose(found.effect.values, true, atol=4 * max(found.std))


@pytest.mark.slow
def test_an_arm_bolted_otherwise_is_named_first_and_its_gravity_measured(ur10: Robot) -> None:
    fitted, held = recorded(bare(ur10), 1, TURNED)
    diagnosis = diagnose(bare(ur10), [fitted], validate=[held])
    first = diagnosis.ordered[0].findings[0]
    assert first.effect.name == "gravity_direction"
    error = diagnosis.set_up.robot.gravity - TURNED
    assert np.linalg.norm(error) < 4 * np.linalg.norm(first.std) + 0.02 * 9.81
    assert np.linalg.norm(diagnosis.set_up.robot.gravity) == pytest.approx(9.81)
    assert np.median(diagnosis.extended.nrmse) < 0.05 < 0.5 < np.median(diagnosis.simulation.nrmse)
    assert not {f.effect.name for f in diagnosis.findings} & {"encoder_offset", "torque_gain"}
    idle = _judged_set_up(diagnosis.set_up, replace(first, rms_after=first.rms_before))
    why = "it does not predict the hold-out better"
    assert (idle.verdict, idle.downgrade) == ("undecided", why)


def with_zero_off(robot: Robot, joint: int, angle: float) -> list[Recording]:
    return [replace(r, q=r.q - angle * np.eye(robot.nv)[joint]) for r in recorded(robot, 2)]


def assert_zero_found(found: SetUp, joint: str, angle: float) -> None:
    turn = dict(found.robot.zeros)[joint] - angle
    assert abs((turn + np.pi) % (2 * np.pi) - np.pi) < 0.03


@pytest.mark.slow
def test_a_zero_position_that_is_off_is_named_first(ur10: Robot) -> None:
    robot, joint = bare(ur10), ur10.joints[1]
    fitted, held = with_zero_off(robot, 1, np.pi / 2)
    diagnosis = diagnose(robot, [fitted], validate=[held])
    assert lead(diagnosis) == f"encoder_offset {joint}"
    assert_zero_found(diagnosis.set_up, joint, np.pi / 2)


@pytest.mark.slow
def test_an_angle_known_no_better_than_by_half_of_its_size_is_not_named(ur10, monkeypatch):
    monkeypatch.setattr(SetUp, "std_of", lambda *_: (0.9,))
    fitted, held = with_zero_off(bare(ur10), 1, np.pi / 2)
    first = diagnose(bare(ur10), [fitted], validate=[held]).findings[0]
    assert (first.effect.name, first.verdict) == ("encoder_offset", "undecided")
    assert "not known to better than half" in first.downgrade
    assert not replace(first, covariance=np.array([[0.49]])).is_nominal


@pytest.mark.slow
@pytest.mark.parametrize(("joint", "angle"), [(2, -2.0), (3, np.pi)])
def test_a_zero_position_of_any_angle_is_found(ur10: Robot, joint: int, angle: float) -> None:
    robot = bare(ur10)
    fitted, held = with_zero_off(robot, joint, angle)
    found, _ = set_up(robot, [fitted, held])
    told = [(e.name, e.joints) for e in found.effects]
    assert told == [("encoder_offset", (robot.joints[joint],))]
    assert_zero_found(found, robot.joints[joint], angle)


def test_a_zero_position_is_refined_where_the_torque_has_no_gravity(ur10: Robot) -> None:
    robot = bare(ur10)
    log = Log.of(robot, with_zero_off(robot.with_gravity(np.zeros(3)), 2, 0.3)[0])
    case = torque_fit(robot, log, smooth(log), set())
    none = Fault("wrong_mounting", log.joints, "", {"gravity": np.zeros(3)})
    near = Installation((none, installation._zero(case, [2], np.array([0.25]))))
    unmoved, zero = installation._polished(case, near).faults
    assert unmoved is none
    assert abs(zero.evidence["offset"] - 0.3) < min(4 * zero.evidence["std"], 0.01)


@pytest.mark.slow
@pytest.mark.parametrize("channels", ["tau", "q tau"])
def test_a_joint_of_the_other_sign_is_repaired_and_named_first(ur10: Robot, channels: str) -> None:
    robot, sign = bare(ur10), 1 - 2 * np.eye(6)[2]
    recordings = [
        replace(r, **{name: getattr(r, name) * sign for name in channels.split()})
        for r in recorded(robot, 3)
    ]
    diagnosis = diagnose(robot, recordings[:1], validate=recordings[1:])
    assert lead(diagnosis) == f"wrong_sign {robot.joints[2]}"
    assert {fault.fault for fault in diagnosis.set_up.faults} == {"wrong_sign"}
    assert diagnosis.findings[0].rms_after < 0.2 * diagnosis.findings[0].rms_before
    assert np.median(diagnosis.extended.nrmse) < 0.05
    assert not {f.effect.name for f in diagnosis.findings} & {"spring", "torque_gain"}


def as_currents(recordings: list[Recording], seed: int) -> list[Recording]:
    """The torque of each joint read as a current of a gain that is not told."""
    nv = recordings[0].tau.shape[1]
    gains = np.exp(np.random.default_rng(seed).uniform(*np.log([2.0, 30.0]), nv))
    return [replace(r, tau=r.tau / gains, unit="A") for r in recordings]


@pytest.mark.slow
@pytest.mark.parametrize("gravity", [SIDEWAYS, TURNED])
def test_currents_tell_how_an_arm_is_mounted(ur10: Robot, gravity: tuple[float, ...]) -> None:
    for recording in as_currents(recorded(bare(ur10), 1, gravity, off=0.0), 1):
        (fault,) = [f for f in find_faults(bare(ur10), recording) if f.of_the_arm]
        assert fault.fault == "wrong_mounting"
        assert np.linalg.norm(fault.evidence["gravity"] - gravity) < 0.02 * 9.81


@pytest.mark.slow
def test_all_recordings_of_an_arm_share_its_set_up() -> None:
    """A joint between two that turn about one axis: its sign is a half turn of the next."""
    robot, sign = bare(load_robot("panda")), 1 - 2 * np.eye(7)[1]
    recordings = [replace(r, q=r.q * sign, tau=r.tau * sign) for r in recorded(robot, 2, off=0.0)]
    alone = {tuple((f.fault, f.joints) for f in find_faults(robot, r)) for r in recordings}
    found, amended = set_up(robot, recordings)
    told = {(each.name, each.joints) for each in (*found.faults, *found.effects)}
    alike = {(rival.candidate.effect.name, rival.candidate.effect.joints) for rival in found.rivals}
    same = {("wrong_sign", (robot.joints[1],)), ("encoder_offset", (robot.joints[2],))}
    assert len(alone) == 1
    assert told <= same == told | alike
    for recording in amended:
        tau = rigid_body_torque(found.robot, motion_of(recording))
        slope = [np.polyfit(*pair, 1)[0] for pair in zip(tau.T, recording.tau.T, strict=True)]
        assert np.abs(np.array(slope)[[1, 3]] - 1).max() < 0.1


@pytest.mark.slow
def test_a_mounting_counts_where_all_recordings_support_it_and_none_refutes_it(ur10: Robot) -> None:
    robot = bare(ur10)
    pushed, *_ = recorded(robot, 2, gravity=TURNED)
    first, second = recorded(robot, 3)
    for recordings in ([pushed], [pushed, first, second]):
        own = [find_faults(robot, each) for each in recordings]
        assert "wrong_mounting" in {fault.fault for fault in own[0]}
        refuted = {"wrong_mounting"} if len(recordings) > 1 else set()
        told = [tuple(fault for fault in mine if fault.fault not in refuted) for mine in own]
        assert shared_installation(robot, recordings, own) == told
    recordings = recorded(robot, 2, gravity=TURNED)
    mounting, other = (find_faults(robot, each) for each in recordings)
    assert [f.fault for f in mounting] == [f.fault for f in other] == ["wrong_mounting"]
    [one, same] = shared_installation(robot, recordings, [mounting, ()])
    assert one == same == mounting


def motion_of(recording: Recording) -> Motion:
    speed = np.gradient(recording.q, recording.t, axis=0)
    return Motion(recording.t, recording.q, speed, np.gradient(speed, recording.t, axis=0))


def test_degrees_beyond_all_limits_are_degrees_also_of_currents(ur10: Robot) -> None:
    for recording in as_currents(recorded(bare(ur10), 3), 3):
        faults = find_faults(bare(ur10), replace(recording, q=np.degrees(recording.q)))
        assert [f.fault for f in faults if f.fault.startswith("wrong")] == ["wrong_unit"]


@pytest.mark.parametrize("off", [slow(0.0), slow(0.1), 0.3])
def test_bodies_off_by_as_much_as_published_ones_are_no_other_set_up(ur10: Robot, off: float):
    for seed in (10, 11):
        both = recorded(bare(ur10), seed, off=off)
        for recording in (*both, *as_currents(both, seed)):
            assert not [f for f in find_faults(bare(ur10), recording) if f.of_the_arm]


@pytest.mark.slow
def test_a_heavy_load_is_no_other_set_up(ur10: Robot) -> None:
    body = ur10.phi.copy()
    body[50:60] += [12.0, 0.6, 0.3, 1.5, 0.6, 0.0, 0.6, 0.0, 0.0, 0.5]
    loaded = bare(ur10).with_parameters(body)
    for recording in recorded(loaded, 4):
        assert not {fault.fault for fault in find_faults(bare(ur10), recording)} & OF_SET_UPS


def test_the_description_of_an_arm_has_its_zero_positions(ur10: Robot) -> None:
    motion = Motion(np.arange(4.0), *np.random.default_rng(0).normal(size=(3, 4, 6)))
    joint, angle = ur10.joints[2], 0.7
    moved = ur10.with_zero(joint, angle)
    shifted = replace(motion, q=motion.q + angle * np.eye(6)[2])
    expected = rigid_body_torque(ur10, shifted)
    assert rigid_body_torque(moved, motion) == pytest.approx(expected)
    again = robot_from_urdf(moved.urdf, source="moved.urdf")
    assert rigid_body_torque(again, motion) == pytest.approx(expected)


@pytest.fixture(scope="module")
def frictionless(ur10: Robot) -> Diagnosis:
    """An arm whose model has no friction, diagnosed from motions with friction at every joint."""
    fitted, held = recorded(bare(ur10), 5, off=0.0)
    return diagnose(bare(ur10), [fitted], validate=[held])


def test_friction_that_the_model_lacks_is_one_significant_finding(frictionless: Diagnosis) -> None:
    (entry,) = frictionless.result()["findings"]
    assert (entry["effect"], entry["verdict"]) == ("friction", "named")
    assert set(entry["joints"]) == set(frictionless.robot.joints)
    kinds = {part["effect"] for part in entry["parts"]}
    assert kinds == {f.effect.name for f in frictionless.findings} >= {"viscous_friction"}
    assert entry["explained"] == pytest.approx(sum(f.explained for f in frictionless.findings))
    values = [p["value"] for p in entry["parameters"] if p["name"].endswith(".Fv")]
    assert f"viscous friction {min(values):.2g} to {max(values):.2g} N·m·s/rad" in entry["sentence"]
    before, after = frictionless.before_and_after(frictionless.findings)
    given = frictionless.simulation.rms
    assert before == pytest.approx(np.sqrt((given**2).mean()), rel=0.05)
    assert after < 0.1 * before
    for f in (f for f in frictionless.findings if f.verdict == "named"):
        assert (np.abs(np.array(f.effect.values) - f.nominal) > 2 * np.array(f.std)).any()


@pytest.mark.parametrize("seed", [6, slow(7)])
def test_drive_gains_that_nobody_told_are_no_cause(ur10: Robot, seed: int) -> None:
    """Bodies and friction as given, each joint's torque read as a current of its own gain."""
    plain = recorded(bare(ur10), seed, off=0.0)
    recordings = as_currents(plain, seed)
    gains = plain[0].tau[0] / recordings[0].tau[0]
    given = with_friction_off(ur10, seed, 0.0)
    diagnosis = diagnose(given, recordings[:1], validate=recordings[1:])
    assert diagnosis.findings == ()
    assert diagnosis.drive is not None
    assert diagnosis.drive.gains == pytest.approx(gains, rel=0.03)


def with_friction_off(robot: Robot, seed: int, off: float) -> Robot:
    """The arm with the friction that `recorded` draws, each coefficient off by a share."""
    rng = np.random.default_rng(seed)
    perturbed(robot, rng, 0.0)
    viscous, coulomb = rng.uniform(0.01, 0.03, (2, robot.nv)) * robot.limits.torque
    ways = 1 + off * rng.choice([-1, 1], (2, robot.nv))
    values = zip((ViscousFriction, CoulombFriction), ways * (viscous, coulomb), strict=True)
    return robot.with_effects([kind(robot.joints, tuple(each)) for kind, each in values])


@pytest.mark.slow
@pytest.mark.parametrize("off", [0.1, 0.3])
def test_given_friction_that_is_off_is_told_and_is_no_finer_friction(ur10: Robot, off: float):
    given = with_friction_off(bare(ur10), 9, off)
    fitted, held = recorded(bare(ur10), 9, off=0.0)
    diagnosis = diagnose(given, [fitted], validate=[held])
    friction = [f.effect for f in diagnosis.findings if f.effect.family == "friction"]
    assert {effect.name for effect in friction} <= {"viscous_friction", "coulomb_friction"}
    assert {f.effect.family for f in diagnosis.findings} == {"friction"}
    cancel = {f"it and {kind} friction mostly cancel" for kind in ("viscous", "Coulomb")}
    assert {f.downgrade for f in diagnosis.findings if f.verdict != "named"} <= cancel
    # what is off by less than given values may be is corrected, with a ± that holds
    true = effect_values(with_friction_off(bare(ur10), 9, 0.0))
    corrected = diagnosis.result()["corrected"]
    assert all(abs(p["value"] - true[p["name"]]) < 4 * p["std"] for p in corrected)
    assert len(corrected) > 2 or off > 0.1


def test_a_clock_is_not_blamed_for_what_two_joints_do(ur10: Robot) -> None:
    """A base that sways: torque of 4 Hz at the first two joints, after the motion's own."""
    fitted, _ = recorded(bare(ur10), 8, off=0.3)
    sway = np.sin(2 * np.pi * 4 * fitted.t)[:, None] * [1.0, 1.0, 0, 0, 0, 0]
    shaken = replace(fitted, tau=fitted.tau * (1 + 0.5 * sway))
    assert not {f.fault for f in find_faults(bare(ur10), shaken)} & {"wrong_sample_rate"}
