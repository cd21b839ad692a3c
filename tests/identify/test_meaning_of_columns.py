"""What a column means other than the model takes it for is named, on arms and logs of our own."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from known_arms import Call
from marks import refused, slow
from mistakes import MADE, READ, coupled, geared, loaded, run_of, scaled, shifted, with_rows

from excitant.analysis.set_up import set_up
from excitant.exceptions import BadRobot
from excitant.identify import Recording, faults, load_dataset
from excitant.identify.faults import Fault, channels, find_faults, installation, proven, repair
from excitant.identify.faults.fault import OF_THE_ARM, Log, is_modelled
from excitant.identify.faults.torque_fit import TorqueFit, smooth, torque_fit
from excitant.identify.reading.names import meaning
from excitant.options import Data
from excitant.robots import Robot, load_robot
from excitant.robots.virtual_arm import industrial_sensors

ENTRY = {"recording": "log", "repaired": False}
Change = Callable[[Robot, Recording], Recording]


@pytest.fixture(scope="module", params=("ur5e", slow("panda")))  # gravity tells; a SCARA's does not
def logged(request: pytest.FixtureRequest, runs: Call) -> tuple[Robot, Recording]:
    """An arm and a log of one whose bodies are off by up to 5 %."""
    robot = load_robot(request.param)
    sensors = industrial_sensors(robot)
    [recording, _] = runs(robot, 5, sensors=sensors, tolerance=0.05, duration=12.0)
    return robot, recording


def faults_after(logged: tuple[Robot, Recording], change: Change) -> dict[str, Fault]:
    robot, recording = logged
    return {fault.fault: fault for fault in find_faults(robot, change(robot, recording))}


def late(_: Robot, recording: Recording, seconds: float = 0.3) -> Recording:
    """Torque that was read before it begins is that of the first row."""
    before = np.arange(len(recording)) - round(seconds / np.diff(recording.t).mean())
    return replace(recording, tau=recording.tau[np.maximum(before, 0)])


@pytest.mark.parametrize("turn", [360.0, slow(300.0)])
def test_servos_that_count_from_zero_are_told_as_one(runs: Call, turn: float) -> None:
    robot = load_robot("so100")
    [run, _] = runs(robot, 5, sensors=industrial_sensors(robot), tolerance=0.05, duration=12.0)
    log = replace(run, q=run.q + np.radians(turn / 2))
    [fault] = [fault for fault in find_faults(robot, log) if fault.fault == "wrong_zero"]
    assert fault.joints == robot.joints
    np.testing.assert_allclose(repair(log, [fault])[0].q, run.q, atol=1e-9 + np.radians(2))


def test_only_torque_that_bodies_confirm_has_a_unit_by_its_limit(logged) -> None:
    robot, run = logged
    counts = replace(run, q=run.q * 4096 / 6.283, dq=None)
    for log, size, told in ((run, 100, "N·cm"), (run, 3000, "another unit"), (counts, 100, "")):
        *positions, torque = find_faults(robot, replace(log, tau=size * log.tau))
        assert told in torque.detail
        assert bool(torque.remedies) == (size == 100 and log is run)
        assert bool(positions) == (log is counts)


def stops(n: int) -> np.ndarray:
    return np.minimum(np.arange(n), int(0.6 * n))


@pytest.mark.parametrize(
    ("code", "size"),
    [(lambda n: np.where(n < 0, 1024 - n, n), 1024), (lambda n: np.mod(n, 4096), 4096)],
)
def test_torque_logged_unsigned_is_decoded_and_no_friction_that_jumps(logged, code, size):
    robot, run = logged
    step = np.ptp(run.tau, axis=0) / 400
    count = np.round(run.tau / step)
    log = replace(Log.of(robot, run), tau=step * code(count))
    faults = [*channels.wrapped_counters(log)]
    negative = [j for j in range(robot.nv) if count[:, j].min() < 0]
    assert [f.joints[0] for f in faults] == [robot.joints[j] for j in negative]
    np.testing.assert_allclose([f.evidence["range"] for f in faults], size * step[negative])
    jumping = 14 + np.add.outer(10 * np.sign(np.sin(run.t)), np.zeros(robot.nv)) + 0.01 * run.tau
    assert not [*channels.wrapped_counters(replace(log, tau=jumping))]
    # but where only so read the drive can give it
    dry = np.round(60 * np.sign(np.sin(run.t))[:, None] + 0.01 * count)
    for most, found in ((np.inf, 0), (100 * step, robot.nv)):
        register = replace(log, tau=step * code(dry), most=most)
        assert len([*channels.wrapped_counters(register)]) == found
    for repaired in (True, False):
        entries = [f.entry() | {"recording": "log", "repaired": repaired} for f in faults]
        assert len(proven(entries)) == (0 if repaired else len(faults))
    decoded, _ = repair(log, faults)
    np.testing.assert_allclose(decoded.tau, step * count, atol=1e-9)
    turned = replace(log, tau=-log.tau)  # by the sign of a map
    again, _ = repair(turned, [*channels.wrapped_counters(turned)])
    np.testing.assert_allclose(again.tau, -step * count, atol=1e-9)


def test_positions_that_wrap_are_continued(logged: tuple[Robot, Recording]) -> None:
    robot, run = logged
    middle = run.q.mean(axis=0)
    log = replace(Log.of(robot, run), q=middle + np.mod(run.q - middle, 2 * np.pi))
    faults = [*channels.wrapped_counters(log)]
    assert [f.joints for f in faults] == [(name,) for name in robot.joints]
    repaired, _ = repair(log, faults)
    np.testing.assert_allclose(np.ptp(repaired.q - run.q, axis=0), 0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [8.8507, 0.102, 1000.0])
def test_torque_in_another_unit_is_told_by_its_factor(logged, factor):
    found = faults_after(logged, lambda _, run: replace(run, tau=factor * run.tau))
    assert found["wrong_unit"].channel == "tau"
    assert found.keys() == {"wrong_unit"}  # whatever it is, it reaches no limit


@pytest.mark.parametrize(
    ("change", "name", "said"),
    [
        (lambda *log: READ["no_gravity"][1](*log, None), "wrong_mounting", "has no gravity"),
        (lambda _, run: scaled(run, "tau", 1 / np.arange(8, 8 + run.nv)), "wrong_unit", "currents"),
        (lambda arm, run: scaled(run, "tau", 1e3 / arm.limits.torque), "wrong_unit", "per mille"),
        slow(lambda _, run: geared(run, 101.0), "wrong_unit", "leaves the joints' limits"),
        slow(lambda _, run: shifted(run, 1, 2), "wrong_zero", "so read"),
        slow(lambda _, run: coupled(run), "coupled_axes", " added, and torque is that of"),
        (lambda _, run: with_rows(run, stops(len(run))), "duplicate_samples", "frozen from t = "),
        (late, "time_delay", "the torque lags the motion by "),
    ],
)
def test_what_the_log_means_is_named(logged, change, name, said):
    found = faults_after(logged, change)
    entry = found[name].entry()
    assert said in entry["detail"]
    # a diagnosis amends its model, but by no torque of which nobody knows what was taken off
    assert is_modelled(entry) == (name == "wrong_zero")
    assert "wrong_sample_rate" not in found  # measured velocities confirm the clock


def test_neither_a_log_as_it_should_be_nor_a_clock_that_velocities_confirm_is_accused(logged):
    """At half the speed of the torque: the torque alone tells, until velocities speak."""
    assert faults_after(logged, lambda _, run: run) == {}
    robot, run = logged
    slow = replace(run, t=2 * run.t, dq=run.dq / 2)
    for log, told in ((replace(slow, dq=None), True), (slow, False)):
        assert any(installation._clock(fit_of(robot, log))) == told


def fit_of(robot: Robot, recording: Recording) -> TorqueFit:
    log = Log.of(robot, recording)
    case = torque_fit(robot, log, smooth(log), set())
    assert case is not None
    return case


@pytest.mark.parametrize(("arm", "seed", "run"), [("ur5e", 3, 0), ("ur5e", 1, 0), ("gen3", 2, 1)])
def test_a_load_is_no_other_unit_nor_a_peak_saturation(arm, seed, run):
    robot = load_robot(arm)
    assert not find_faults(robot, loaded(run_of(robot, (3, seed, run))))


def test_friction_of_motors_on_coupled_axes_is_no_coupling_of_the_columns():
    """Bodies beyond the wrist are light: they tell no coupling."""
    robot = load_robot("ur5e")
    light = robot.phi.reshape(-1, 10) * np.array([1, 1, 1, 1, 0.1, 0.1])[:, None]
    run = run_of(robot.with_parameters(light), (3, 0, 0))
    axes = np.array([[0, 0, 0, 0, 1, 0], [0, 0, 0, 0, 1, 1]])
    motors = tuple((lambda s, k=k: np.tanh(s.dq @ axes[k] / 1e-3), 3.0 * axes[k]) for k in (0, 1))
    arm = 1 - axes[1]
    dry, viscous = arm * run.plant.coulomb, arm * run.plant.viscous
    laws = (*run.plant.laws, *motors)
    plant = replace(run.plant, coulomb=dry, viscous=viscous, laws=laws)
    assert not find_faults(run.robot, replace(run, plant=plant).log)


@pytest.mark.parametrize(
    ("kind", "arm", "seed", "run", "told"),
    [
        ("kilogram_metres", "scara", 43, 0, {"wrong_unit"}),  # no gravity tells
        ("coarse_torque", "ur5e", 48, 0, set()),
        slow("pushed_by_hand", "scara", 0, 0, set()),  # most of the log speaks against a mounting
        slow("pushed_by_hand", "so100", 0, 1, set()),
    ],
)
def test_what_is_small_coarse_or_pushed_is_told_for_nothing_else(kind, arm, seed, run, told):
    robot = load_robot(arm)
    log = READ[kind][1](robot, run_of(robot, (3, seed, run)).log, None)
    found = {fault.fault for fault in find_faults(robot, log)}
    assert found & {*OF_THE_ARM, "wrong_unit", "saturation"} == told


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (MADE["brakes_close"][1], ("corrupt_rows", "tau")),
        (lambda run: replace(run.log, dq=101 * run.log.dq), ("wrong_unit", "dq")),
    ],
)
def test_brakes_and_speeds_of_motors_are_told_as_such(change, told):
    run = run_of(load_robot("so100"), (3, 41, 0))
    assert {(f.fault, f.channel) for f in find_faults(run.robot, change(run))} == {told}


def test_channels_of_a_joint_that_stands_are_not_dead(planar: Robot, exact: Call) -> None:
    """Noise-free, while the other joint moves."""
    run = exact(planar, np.arange(0, 8, 0.01))
    q = np.column_stack([np.full(len(run), 0.3), run.q[:, 1]])
    held = np.column_stack([np.full(len(run), -8.9), run.tau[:, 1]])
    found = find_faults(planar, replace(run, q=q, tau=held, dq=None))
    assert not {f.fault for f in found} & {"dead_channel", "saturation", "wrong_sign"}


def test_a_sign_that_two_columns_may_have_is_told_of_both(runs: Call) -> None:
    """Torque of a pendulum against its position, and position against its torque, are the same."""
    robot = load_robot("planar_2r", lock={"joint2": 0.0})
    [run, _] = runs(robot, 3, sensors=industrial_sensors(robot))
    [fault] = find_faults(robot, replace(run, tau=-run.tau))
    assert all(f"{channel} of joint1 counts" in fault.detail for channel in ("q", "tau"))
    assert (fault.repair, repair(run, [fault])[1]) == (None, ())
    assert set_up(robot, [replace(run, tau=-run.tau)])[0].standing == [fault.detail]


@pytest.mark.parametrize("unit", [1, 30, 3417, 1e4, 1e6, 1e9])  # up to lb·in², kg·cm², .. g·mm²
def test_inertias_in_another_unit_are_told(logged: tuple[Robot, Recording], unit: float) -> None:
    robot, run = logged
    phi = robot.phi.reshape(-1, 10).copy()
    phi[:, 4:] *= unit
    given = robot.with_parameters(phi.ravel())
    found = [fault for fault in find_faults(given, run) if fault.channel == "inertia"]
    assert bool(found) == (unit > 30)
    for fault in found:
        assert proven([fault.entry() | ENTRY])
        refused(": another unit;", set_up, given, [run], error=BadRobot)


@pytest.mark.slow
def test_sums_of_torques_are_not_likelier_for_being_larger(ur10: Robot) -> None:
    """A small torque and a large one, of an arm that hardly moves."""
    log = MADE["hardly_moving"][1](run_of(ur10, (3, 1, 0), off=0.03))
    assert "coupled_axes" not in {fault.fault for fault in find_faults(ur10, log)}


def test_a_joint_that_stands_tells_no_sign(logged: tuple[Robot, Recording]) -> None:
    """Whether its friction brakes or drives it does not matter."""
    robot, run = logged
    q, last = run.q.copy(), robot.nv - 1
    # steps of an encoder, back and forth
    q[:, last] = 0.3 + 1e-4 * np.round(np.sin(2 * np.pi * run.t))
    dry = np.zeros_like(q)
    dry[:, last] = 3 * np.sign(np.cos(2 * np.pi * run.t))
    fits = [fit_of(robot, replace(run, q=q, tau=run.tau + x, dq=None)) for x in (dry, -dry)]
    left = [fit.surprise(0 * fit.power, fits[0].rows, last)[0] for fit in fits]
    assert left[0] == pytest.approx(left[1], rel=0.2)
    signs = [fault for move in installation._signs(fits[0]) for fault in move.faults]
    assert {*robot.joints[:-1]} == {f.joints[0] for f in signs if "q" in str(f.channel)}


@pytest.mark.slow
def test_torque_that_is_late_is_read_later(logged: tuple[Robot, Recording]) -> None:
    robot, recording = logged
    run = late(robot, recording, 0.08)
    [fault] = find_faults(robot, run)
    assert fault.evidence["delay"] == pytest.approx(0.08, abs=2 * fault.evidence["std"])
    assert fault.evidence["std"] < 0.01
    repaired, _ = repair(run, [fault])
    assert repaired.t[-1] == pytest.approx(run.t[-1] - 0.08, abs=0.01)
    at = np.array([np.interp(repaired.t + 0.08, run.t, tau) for tau in run.tau.T]).T
    assert ((repaired.tau - at).std(axis=0) < 0.1 * run.tau.std(axis=0)).all()
    # drives and their filters take as long
    assert not find_faults(robot, late(robot, recording, 0.02))


@pytest.mark.slow
def test_zero_positions_of_two_joints_are_told_together(logged: tuple[Robot, Recording]) -> None:
    robot, recording = logged
    log = shifted(recording, 1, 2)
    found = find_faults(robot, log)
    offsets = {f.joints[0]: f.evidence["offset"] for f in found if f.fault == "wrong_zero"}
    assert offsets == pytest.approx({robot.joints[1]: -np.pi / 2, robot.joints[2]: np.pi / 2})
    np.testing.assert_allclose(repair(log, found)[0].q, recording.q, atol=1e-9)
    brief = log.take(slice(300))  # alone it tells nothing
    assert faults.shared_installation(robot, [brief], [()], found) == [found]
    assert faults.shared_installation(robot, [recording], [()], found) == [()]


def test_a_coupled_wrist_is_uncoupled(logged: tuple[Robot, Recording]) -> None:
    robot, recording = logged
    log = coupled(recording)
    repaired, _ = repair(log, find_faults(robot, log))
    np.testing.assert_allclose(repaired.q, recording.q, atol=1e-12)
    np.testing.assert_allclose(repaired.tau, recording.tau, atol=1e-12)


def test_the_hold_out_is_repaired_like_the_fit(runs: Call, save: Call) -> None:
    planar = load_robot("planar_2r")
    run, held = runs(planar, 3, sensors=industrial_sensors(planar))
    turned = (replace(each, tau=each.tau * [1, -1]) for each in (run, held))
    files = [str(save(each, f"{each.name}.parquet")) for each in turned]
    read = Data(validate=[files[1]], repair=True).read(load_dataset("planar_2r"), [files[0]])
    for repaired, recording in ((read.fit[0], run), (read.holdout[0], held)):
        np.testing.assert_array_equal(repaired.tau, recording.tau)
    assert [entry["repaired"] for entry in read.entries["faults"]] == [True, True]


def test_force_is_the_torque_of_a_joint_that_is_named_and_no_tool_sensor() -> None:
    slide = meaning("lift_force_N", ("lift", "elbow"))
    assert (slide.role, slide.joint, slide.unit) == ("tau", "lift", "N")
    assert meaning("actual_TCP_force_0", ("lift", "elbow")).role is None
