"""Traps that recordings came from: planted in faultless ones, each is found and named.

A virtual arm that deviates from its model, seen by sensors with noise, and a real arm's recording.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from excitant.exceptions import BadRecording
from excitant.identify.dataset import load_dataset
from excitant.identify.faults import FAULTS, Log, find_copies, find_faults, read_checked
from excitant.identify.faults.modelled import in_distal_frames, in_joint_frames
from excitant.robots import Robot, load_robot

Loader = Callable[[str], Any]
Corrupted = tuple[Robot, Log]


@dataclass(frozen=True)
class Trap:
    """One way in which a recording is not what it seems.

    Attributes:
        name: In words.
        faults: Names that fit it; one of them must be said.
        plant: Puts it into a recording.
    """

    name: str
    faults: frozenset[str]
    plant: Callable[[Any, Robot, Log], Corrupted]


def shifted_rows(plants: Any, robot: Robot, log: Log) -> Corrupted:
    """Rows in which every value stands one column too far to the right."""
    whole = np.hstack([log.q, np.asarray(log.dq), log.tau])
    for row in (len(log) // 5, len(log) // 2, 4 * len(log) // 5):
        whole[row] = np.roll(whole[row], 1)
    q, dq, tau = np.split(whole, 3, axis=1)
    return robot, replace(log, q=q, dq=dq, tau=tau)


def corrupt_rows(plants: Any, robot: Robot, log: Log) -> Corrupted:
    """A torque that is no number, and one that cannot be."""
    damaged = plants.not_a_number(robot, log, np.random.default_rng(0))
    return robot, plants.torque_outliers(robot, damaged, np.random.default_rng(1))


def speed_in_rpm(plants: Any, robot: Robot, log: Log) -> Corrupted:
    return robot, plants.velocity_in_rpm(robot, log, np.random.default_rng(0))


def repeated_samples(plants: Any, robot: Robot, log: Log) -> Corrupted:
    """Six per cent of rows hold the values of the row before."""
    return robot, plants.rows_logged_twice(robot, log, np.random.default_rng(0))


def repeated_stamps(plants: Any, robot: Robot, log: Log) -> Corrupted:
    """Six per cent of rows are there twice, stamp and all."""
    rng = np.random.default_rng(0)
    again = rng.choice(len(log), round(0.06 * len(log)), replace=False)
    return robot, log.take(np.sort(np.r_[np.arange(len(log)), again]))


def halved_rate(plants: Any, robot: Robot, log: Log) -> Corrupted:
    """Every other sample is missing, the stamps run on."""
    return robot, plants.with_rows(log, np.arange(0, len(log), 2))


def halved_rate_without_speed(plants: Any, robot: Robot, log: Log) -> Corrupted:
    """The same where only the torque can tell."""
    return robot, replace(halved_rate(plants, robot, log)[1], dq=None)


def rate_halved_on_the_way(plants: Any, robot: Robot, log: Log) -> Corrupted:
    """From the middle on, every other sample is missing, the stamps run on."""
    half = len(log) // 2
    return robot, plants.with_rows(log, np.r_[np.arange(half), np.arange(half, len(log), 2)])


def unsigned_negatives(plants: Any, robot: Robot, log: Log) -> Corrupted:
    return robot, plants.unsigned_torque(robot, log, np.random.default_rng(0))


def dead_torque(plants: Any, robot: Robot, log: Log) -> Corrupted:
    return robot, plants.edited(log, "tau", lambda x: x[:, -1].fill(0.0))


def dead_speed(plants: Any, robot: Robot, log: Log) -> Corrupted:
    return robot, plants.edited(log, "dq", lambda x: x[:, 1].fill(0.0))


def dead_position(plants: Any, robot: Robot, log: Log) -> Corrupted:
    return robot, plants.edited(log, "q", lambda x: x[:, 1].fill(0.0))


def distal_inertias(plants: Any, robot: Robot, log: Log) -> Corrupted:
    """The model's inertias stand for the frames at the next joints."""
    return robot.with_parameters(in_distal_frames(robot)), log


def counted_time(plants: Any, robot: Robot, log: Log) -> Corrupted:
    return robot, plants.counted_samples(robot, log, np.random.default_rng(0))


def computed_torque(plants: Any, robot: Robot, log: Log) -> Corrupted:
    return robot, plants.model_for_torque(robot, log, np.random.default_rng(0))


TRAPS = (
    Trap("shifted rows", frozenset(["corrupt_rows"]), shifted_rows),
    Trap("corrupt rows", frozenset(["corrupt_rows"]), corrupt_rows),
    Trap("speed in rpm", frozenset(["wrong_unit"]), speed_in_rpm),
    Trap("duplicated samples", frozenset(["duplicate_samples"]), repeated_samples),
    Trap("duplicated stamps", frozenset(["duplicate_samples"]), repeated_stamps),
    Trap("halved rate", frozenset(["wrong_sample_rate"]), halved_rate),
    Trap("halved rate, no speed", frozenset(["wrong_sample_rate"]), halved_rate_without_speed),
    Trap("rate halved on the way", frozenset(["wrong_sample_rate"]), rate_halved_on_the_way),
    Trap("unsigned negatives", frozenset(["corrupt_rows"]), unsigned_negatives),
    Trap("dead torque", frozenset(["dead_channel"]), dead_torque),
    Trap("dead speed", frozenset(["dead_channel"]), dead_speed),
    Trap("dead position", frozenset(["dead_channel"]), dead_position),
    Trap("inertias in the distal frame", frozenset(["wrong_frame"]), distal_inertias),
    Trap("time in samples", frozenset(["wrong_sample_rate"]), counted_time),
    Trap("model output for torque", frozenset(["not_measured"]), computed_torque),
)
each_trap = pytest.mark.parametrize("trap", TRAPS, ids=lambda trap: trap.name)


@pytest.fixture(scope="module")
def plants(benchmark_module: Loader) -> Any:
    return benchmark_module("planted_faults")


@pytest.fixture(scope="module")
def virtual(plants: Any, ur10: Robot) -> Log:
    log: Log = plants.recorded(ur10, 0)
    return log


@pytest.fixture(scope="module")
def real(plants: Any, data_folder: Path) -> Corrupted:
    dataset = load_dataset(data_folder / "ur10")
    table = pd.read_parquet(data_folder / "ur10" / "unisa_exciting.parquet")
    return dataset.robot, plants.log_of_table(dataset.robot, table, "tau")


def names(robot: Robot, log: Log) -> set[str]:
    return {fault.fault for fault in find_faults(robot, log)}


@each_trap
def test_a_trap_is_named(trap: Trap, plants: Any, ur10: Robot, virtual: Log) -> None:
    found = names(*trap.plant(plants, ur10, virtual))
    assert trap.faults & found
    assert found <= set(FAULTS)


@each_trap
def test_a_trap_in_a_real_recording_is_named(trap: Trap, plants: Any, real: Corrupted) -> None:
    assert trap.faults & names(*trap.plant(plants, *real))


def test_recordings_without_a_trap_raise_none(ur10: Robot, virtual: Log, real: Corrupted) -> None:
    assert names(ur10, virtual) == set()
    assert names(*real) == set()


def test_what_is_dead_is_named_where_it_is(plants: Any, ur10: Robot, virtual: Log) -> None:
    for plant, joint in ((dead_torque, ur10.joints[-1]), (dead_speed, ur10.joints[1])):
        (fault,) = find_faults(*plant(plants, ur10, virtual))
        assert fault.joints == (joint,)


def test_the_moment_at_which_the_rate_changes_is_told(
    plants: Any, ur10: Robot, virtual: Log
) -> None:
    (fault,) = find_faults(*rate_halved_on_the_way(plants, ur10, virtual))
    middle = float(virtual.t[len(virtual) // 2])
    assert fault.evidence["at"] == pytest.approx(middle, abs=0.3)
    assert fault.evidence["before"] == pytest.approx(1.0, abs=0.02)
    assert fault.evidence["after"] == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("name", ["planar_2r", "panda", "cmu_dd_arm_ii"])
def test_inertias_are_told_by_their_frames(name: str, plants: Any) -> None:
    robot = load_robot(name)
    log = plants.recorded(robot, 1)
    distal = robot.with_parameters(in_distal_frames(robot))
    np.testing.assert_allclose(in_joint_frames(distal), robot.phi, atol=1e-12)
    assert "wrong_frame" in names(distal, log)
    assert names(robot, log) == set()


def written(folder: Path, name: str, log: Log) -> str:
    columns = {"t": log.t}
    for channel, values in log.channels():
        columns |= {f"{channel}{j + 1}": values[:, j] for j in range(log.nv)}
    pd.DataFrame(columns).to_parquet(folder / f"{name}.parquet")
    return str(folder / f"{name}.parquet")


def test_one_recording_under_two_names(ur10: Robot, virtual: Log, tmp_path: Path) -> None:
    files = [written(tmp_path, name, virtual) for name in ("one", "two")]
    checked = read_checked(load_dataset("ur10"), files)
    assert checked.faults["one"] == ()
    (fault,) = checked.faults["two"]
    assert fault.fault == "duplicate_samples"
    assert "one" in fault.detail
    assert set(find_copies({"a": virtual, "b": replace(virtual, t=virtual.t + 3)})) == {"b"}


REFUSED = "dead channel|not a finite number|time repeats"


@pytest.mark.parametrize(
    "trap", [t for t in TRAPS if t.plant is not distal_inertias], ids=lambda trap: trap.name
)
def test_a_trap_in_a_file_is_named_or_refused(
    trap: Trap, plants: Any, ur10: Robot, virtual: Log, tmp_path: Path
) -> None:
    """What the command reads: named among the faults, or refused in a line that says why."""
    path = written(tmp_path, "run", trap.plant(plants, ur10, virtual)[1])
    dataset = load_dataset("ur10")
    if trap.plant in (corrupt_rows, repeated_stamps, dead_torque):
        with pytest.raises(BadRecording, match=REFUSED):
            read_checked(dataset, [path])
    if trap.plant is not dead_torque:
        repaired = trap.plant in (corrupt_rows, repeated_stamps)
        checked = read_checked(dataset, [path], repaired=repaired)
        assert trap.faults & {fault.fault for fault in checked.faults["run"]}
