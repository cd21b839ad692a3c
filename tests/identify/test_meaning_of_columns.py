"""What a column means other than the model takes it for is named, on arms and logs of our own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from known_arms import Call

from excitant.identify import Recording
from excitant.identify.faults import Fault, find_faults, physics
from excitant.identify.faults.fault import Log
from excitant.robots import Motion, Robot, load_robot, rigid_body_torque
from excitant.robots.virtual_arm import industrial_sensors

ARMS = ("ur5e", "panda")  # gravity tells; a SCARA's does not
Change = Callable[[Robot, Recording], Recording]


@pytest.fixture(scope="module", params=ARMS)
def logged(request: pytest.FixtureRequest, runs: Call) -> tuple[Robot, Recording]:
    """An arm and a log of one whose bodies are off by up to 5 %."""
    robot = load_robot(request.param)
    sensors = industrial_sensors(robot)
    [recording, _] = runs(robot, 5, sensors=sensors, tolerance=0.05, duration=12.0)
    return robot, recording


def faults_after(logged: tuple[Robot, Recording], change: Change) -> dict[str, Fault]:
    robot, recording = logged
    return {fault.fault: fault for fault in find_faults(robot, change(robot, recording))}


def without_gravity(robot: Robot, recording: Recording) -> Recording:
    still = np.zeros_like(recording.q)
    held = rigid_body_torque(robot, Motion(recording.t, recording.q, still, still))
    return replace(recording, tau=recording.tau - held)


def motor_side(robot: Robot, recording: Recording) -> Recording:
    dq = None if recording.dq is None else 101 * recording.dq
    return replace(recording, q=101 * recording.q, dq=dq, tau=recording.tau / 101)


def frozen(robot: Robot, recording: Recording) -> Recording:
    stopped = np.minimum(np.arange(len(recording)), int(0.6 * len(recording)))
    held = {name: x[stopped] for name, x in recording.channels()}
    return replace(recording, **held)


@pytest.mark.parametrize("factor", [8.8507, 0.102, 1000.0])
def test_torque_in_another_unit_is_told_by_its_factor(
    logged: tuple[Robot, Recording], factor: float
) -> None:
    found = faults_after(logged, lambda _, run: replace(run, tau=factor * run.tau))
    fault = found["wrong_unit"]
    assert fault.channel == "tau"
    assert found.keys() <= {"wrong_unit", "saturation"}


def test_currents_called_torque_are_told(logged: tuple[Robot, Recording]) -> None:
    gains = np.linspace(18, 8, logged[0].nv)
    found = faults_after(logged, lambda _, run: replace(run, tau=run.tau / gains))
    assert found["wrong_unit"].channel == "tau"
    assert "currents" in found["wrong_unit"].detail


@pytest.mark.parametrize(
    ("change", "name", "said"),
    [
        (without_gravity, "wrong_mounting", "the torque has no gravity"),
        (motor_side, "wrong_unit", "leaves the joints' limits"),
        (frozen, "duplicate_samples", "frozen from t = "),
    ],
)
def test_what_the_log_means_is_named(
    logged: tuple[Robot, Recording], change: Change, name: str, said: str
) -> None:
    found = faults_after(logged, change)
    assert said in found[name].detail
    assert "wrong_sample_rate" not in found  # measured velocities confirm the clock


def test_a_log_as_it_should_be_is_not_accused(logged: tuple[Robot, Recording]) -> None:
    assert faults_after(logged, lambda _, run: run) == {}


def fit_of(robot: Robot, recording: Recording) -> physics.TorqueFit:
    log = Log.of(robot, recording)
    case = physics.torque_fit(robot, log, physics.smooth(log), set())
    assert case is not None
    return case


def test_a_clock_is_left_alone_where_velocities_confirm_it(
    logged: tuple[Robot, Recording],
) -> None:
    """At half the speed of the torque: the torque alone tells, until velocities speak."""
    robot, run = logged
    slow = replace(run, t=2 * run.t, dq=run.dq / 2)
    assert [fault.fault for fault in physics.rate(fit_of(robot, replace(slow, dq=None)))]
    assert not [*physics.rate(fit_of(robot, slow))]


def test_friction_of_a_joint_that_stands_tells_no_sign(
    logged: tuple[Robot, Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, run = logged
    q = np.array(run.q)
    q[:, 1] = 0.3
    driving = physics._Signs(gain=0.0, gain_z=0.0, friction_z=-40.0, explained=0.98)
    monkeypatch.setattr(physics, "_signs", lambda *_: driving)
    accused = physics.torque_signs(fit_of(robot, replace(run, q=q, dq=None)))
    assert [f.joints for f in accused] == [(j,) for j in np.delete(robot.joints, 1)]


def test_channels_of_a_joint_that_stands_are_not_dead(planar: Robot, exact: Call) -> None:
    """Noise-free, while the other joint moves."""
    run = exact(planar, np.arange(0, 8, 0.01))
    q = np.column_stack([np.full(len(run), 0.3), run.q[:, 1]])
    held = np.column_stack([np.full(len(run), -8.9), run.tau[:, 1]])
    found = find_faults(planar, replace(run, q=q, tau=held, dq=None))
    assert not {f.fault for f in found} & {"dead_channel", "saturation", "wrong_sign"}
