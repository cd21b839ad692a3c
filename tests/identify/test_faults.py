"""Faults of recordings: planted ones are found, named and repaired; faultless ones raise none.

Recordings are those of a virtual arm that deviates from its model, seen by sensors with noise, and
of a real arm.
"""

from __future__ import annotations

import re
import runpy
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest

from excitant.exceptions import BadRecording
from excitant.identify import identify_robot, load_dataset
from excitant.identify.faults import (
    FAULTS,
    Fault,
    Log,
    find_copies,
    find_faults,
    read_checked,
    repair,
)
from excitant.identify.faults.modelled import in_joint_frames
from excitant.robots import Robot, load_robot

BENCHMARK = Path(__file__).resolve().parents[2] / "benchmarks" / "planted_faults.py"
plants = SimpleNamespace(**runpy.run_path(str(BENCHMARK)))
Plant = Callable[[Robot, Log, np.random.Generator], Log]


def shifted_rows(log: Log) -> Log:
    """Rows in which every value stands one column too far to the right."""
    whole = np.hstack([log.q, np.asarray(log.dq), log.tau])
    for row in (len(log) // 5, len(log) // 2, 4 * len(log) // 5):
        whole[row] = np.roll(whole[row], 1)
    q, dq, tau = np.split(whole, 3, axis=1)
    return replace(log, q=q, dq=dq, tau=tau)


def decimated(log: Log, start: int = 0) -> Log:
    """From a row on every other sample is missing, the stamps run on."""
    return plants.with_rows(log, np.r_[np.arange(start), np.arange(start, len(log), 2)])


def dead(log: Log, name: str, joint: int) -> Log:
    return plants.edited(log, name, (slice(None), joint), lambda x: 0.0)


Damage = Callable[[Log], Log]
MORE: dict[str, tuple[str, Damage]] = {
    "shifted rows": ("corrupt_rows", shifted_rows),
    "decimated": ("wrong_sample_rate", decimated),
    "decimated, no speed": ("wrong_sample_rate", lambda x: replace(decimated(x), dq=None)),
    "decimated on the way": ("wrong_sample_rate", lambda x: decimated(x, len(x) // 2)),
    "dead torque": ("dead_channel", lambda x: dead(x, "tau", -1)),
    "dead speed": ("dead_channel", lambda x: dead(x, "dq", 1)),
    "dead position": ("dead_channel", lambda x: dead(x, "q", 1)),
}
PLANTS: dict[str, tuple[str, Plant]] = plants.PLANTS
NOT_IN_REAL = {"rows_lost_unseen", "noise_for_torque"}


@pytest.fixture(scope="module")
def clean(planar: Robot) -> Log:
    return plants.recorded(planar, 0)


@pytest.fixture(scope="module")
def second(planar: Robot) -> Log:
    return plants.recorded(planar, 1)


@pytest.fixture(scope="module")
def six_joints(ur10: Robot) -> Log:
    return plants.recorded(ur10, 0)


@pytest.fixture(scope="module")
def real(data_folder: Path) -> tuple[Robot, Log]:
    dataset = load_dataset(data_folder / "ur10")
    table = pd.read_parquet(data_folder / "ur10" / "unisa_exciting.parquet")
    return dataset.robot, plants.log_of_table(dataset.robot, table)


def names(faults: tuple[Fault, ...]) -> set[str]:
    return {fault.fault for fault in faults}


@pytest.mark.parametrize("plant", PLANTS)
def test_a_planted_fault_is_named(planar: Robot, clean: Log, plant: str) -> None:
    name, damage = PLANTS[plant]
    faults = find_faults(planar, damage(planar, clean, np.random.default_rng(1)))
    assert name in names(faults)
    assert names(faults) <= set(FAULTS)
    for fault in faults:
        assert any(character.isdigit() for character in fault.detail), fault.detail
        assert set(fault.joints) <= set(planar.joints)


@pytest.mark.parametrize("plant", MORE)
def test_a_fault_planted_in_an_arm_of_six_joints_is_named(
    ur10: Robot, six_joints: Log, plant: str
) -> None:
    name, damage = MORE[plant]
    faults = find_faults(ur10, damage(six_joints))
    assert name in names(faults)
    if plant in ("dead torque", "dead speed"):
        joint = ur10.joints[-1 if plant == "dead torque" else 1]
        assert [fault.joints for fault in faults] == [(joint,)]
    if plant == "decimated on the way":
        (fault,) = faults
        middle = float(six_joints.t[len(six_joints) // 2])
        assert fault.evidence["at"] == pytest.approx(middle, abs=0.3)
        assert fault.evidence["before"] == pytest.approx(1.0, abs=0.02)
        assert fault.evidence["after"] == pytest.approx(0.5, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("plant", [*sorted(PLANTS.keys() - NOT_IN_REAL), *MORE])
def test_a_fault_planted_in_a_real_recording_is_named(real: tuple[Robot, Log], plant: str) -> None:
    robot, log = real
    if plant in MORE:
        name, damaged = MORE[plant][0], MORE[plant][1](log)
    else:
        name, damage = PLANTS[plant]
        damaged = damage(robot, log, np.random.default_rng(4))
    assert name in names(find_faults(robot, damaged))


def test_faultless_recordings_raise_none(
    planar: Robot, clean: Log, ur10: Robot, six_joints: Log, real: tuple[Robot, Log]
) -> None:
    logs = (planar, clean), (planar, replace(clean, dq=None)), (ur10, six_joints), real
    assert [fault.detail for pair in logs for fault in find_faults(*pair)] == []


@pytest.mark.parametrize(
    "name", [pytest.param("panda", marks=pytest.mark.slow), "planar_2r", "cmu_dd_arm_ii"]
)
def test_inertias_are_told_by_their_frames(name: str) -> None:
    robot = load_robot(name)
    log = plants.recorded(robot, 1)
    places = [robot.model.jointPlacements[j + 1] for j in range(1, robot.nv)]
    places.append(robot.model.frames[robot.tip].placement)
    bodies = map(pin.Inertia.FromDynamicParameters, robot.phi.reshape(-1, 10))
    moved = [place.actInv(body) for place, body in zip(places, bodies, strict=True)]
    distal = robot.with_parameters(np.concatenate([body.toDynamicParameters() for body in moved]))
    np.testing.assert_allclose(in_joint_frames(distal), robot.phi, atol=1e-12)
    assert "wrong_frame" in names(find_faults(distal, log))
    assert find_faults(robot, log) == ()


def test_what_a_controller_computes_is_no_measurement(data_folder: Path) -> None:
    """A log with the motor current and the torque that the controller's model asked for."""
    folder = data_folder / "ur10e"
    robot = load_dataset(folder).robot
    table = pd.read_parquet(folder / "id_12harm_30s.parquet")
    measured, computed = (plants.log_of_table(robot, table, name) for name in ("i", "tau_target"))
    assert "not_measured" not in names(find_faults(robot, measured))
    assert "not_measured" in names(find_faults(robot, computed))


REPAIRABLE = """velocity_negated torque_negated position_negated velocity_in_rpm all_in_degrees
    half_rate_without_velocity milliseconds counted_samples stamps_twice rows_logged_twice
    not_a_number torque_outliers position_outliers"""


@pytest.mark.parametrize("plant", REPAIRABLE.split())
def test_a_repaired_recording_is_faultless(planar: Robot, clean: Log, plant: str) -> None:
    log = PLANTS[plant][1](planar, clean, np.random.default_rng(2))
    repaired, notes = repair(log, find_faults(planar, log))
    assert notes
    gaps = plant in ("rows_logged_twice", "not_a_number")
    assert names(find_faults(planar, repaired)) <= ({"dropped_samples"} if gaps else set())


def test_repair_restores_the_values_and_does_only_what_faults_say(
    planar: Robot, clean: Log
) -> None:
    faster = PLANTS["velocity_in_rpm"][1](planar, clean, None)
    log = PLANTS["torque_negated"][1](planar, faster, np.random.default_rng(0))
    for repaired, _ in (repair(log, find_faults(planar, log)), repair(clean, ())):
        np.testing.assert_allclose(repaired.dq, clean.dq, rtol=1e-12)
        np.testing.assert_array_equal(repaired.tau, clean.tau)
        np.testing.assert_array_equal(repaired.t, clean.t)


def test_rows_of_a_fault_are_rows_of_the_file(planar: Robot, clean: Log) -> None:
    """Also when rows before them were left out by an earlier test."""
    log = plants.edited(clean, "tau", (600, 0), lambda x: 1e4)
    log = log.take(np.r_[0, 0, 0, np.arange(1, len(log))])
    faults = {f.fault: f for f in find_faults(planar, log)}
    assert list(faults["duplicate_samples"].evidence["rows"]) == [1, 2]
    assert list(faults["corrupt_rows"].evidence["rows"]) == [602]


def test_nothing_at_all_is_no_traceback(planar: Robot, clean: Log) -> None:
    for rows in (0, 1, 2, 10, 60):
        find_faults(planar, clean.take(np.arange(rows)))
    find_faults(planar, plants.scaled(clean, "q", 0.0))
    find_faults(planar, plants.scaled(clean, "tau", np.nan))


def written(folder: Path, log: Log, name: str = "run") -> str:
    columns = {"t": log.t}
    for channel, values in log.channels():
        columns |= {f"{channel}{j + 1}": values[:, j] for j in range(log.nv)}
    pd.DataFrame(columns).to_parquet(folder / f"{name}.parquet")
    return str(folder / f"{name}.parquet")


def test_a_file_that_is_refused_can_be_read_with_repair(
    planar: Robot, clean: Log, tmp_path: Path
) -> None:
    rng, dataset = np.random.default_rng(0), load_dataset("planar_2r")
    path = written(tmp_path, PLANTS["velocity_negated"][1](planar, clean, rng))
    assert names(read_checked(dataset, [path]).faults["run"]) == {"wrong_sign"}
    for plant, why in (
        (PLANTS["zero_torque"][1], "dead channel"),
        (PLANTS["not_a_number"][1], "not a finite number"),
        (plants.stamps_twice, "time repeats"),
    ):
        log = plant(planar, PLANTS["velocity_negated"][1](planar, clean, rng), rng)
        path = written(tmp_path, log)
        with pytest.raises(BadRecording, match=why):
            read_checked(dataset, [path])
    checked = read_checked(dataset, [path], repaired=True)
    assert names(checked.faults["run"]) == {"duplicate_samples", "wrong_sign"}
    assert {entry["recording"] for entry in checked.entries()} == {"run"}
    assert len(checked.notes) == 2
    assert len(checked.recordings[0].t) == len(clean)


def test_the_same_recording_under_two_names_is_found(clean: Log, tmp_path: Path) -> None:
    later, other = replace(clean, t=clean.t + 5.0), plants.scaled(clean, "tau", 1.001)
    found = find_copies({"first": clean, "second": later, "third": other})
    assert set(found) == {"second"}
    assert "first" in found["second"].detail
    files = [written(tmp_path, clean, name) for name in ("one", "two")]
    checked = read_checked(load_dataset("planar_2r"), files)
    assert checked.faults["one"] == ()
    assert names(checked.faults["two"]) == {"duplicate_samples"}


def exchanged(log: Log) -> Log:
    """Neighbours in reverse, and rows that came 30 and 80 rows late."""
    rows = list(range(len(log)))
    rows[40], rows[41] = 41, 40
    for late, place in ((300, 330), (700, 780)):
        rows.insert(place, rows.pop(late))
    return log.take(np.array(rows))


def blocks_exchanged(log: Log) -> Log:
    return log.take(np.r_[0:200, 500:800, 200:500, 800 : len(log)])


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (exchanged, "sorts rows 41, 330, 780 by time"),
        (blocks_exchanged, "sorts rows 200 to 499 by time|sorts rows 500 to 799 by time"),
        (lambda log: log.take(np.arange(len(log))[::-1]), "sorts rows 1 to 1000 by time"),
        (lambda log: log.take(np.r_[0:500, 480 : len(log)]), "leaves 20 rows out"),  # went back
    ],
    ids=["exchanged", "blocks", "backwards", "written again"],
)
def test_rows_out_of_order_are_put_right(
    clean: Log, tmp_path: Path, damage: Damage, said: str
) -> None:
    path, dataset = written(tmp_path, damage(clean)), load_dataset("planar_2r")
    with pytest.raises(BadRecording, match="time goes back"):
        read_checked(dataset, [path])
    checked = read_checked(dataset, [path], repaired=True)
    (note,), (found,) = checked.notes, checked.recordings
    assert re.search(said, note)
    np.testing.assert_allclose(found.t - found.t[0], clean.t, atol=1e-12)
    for name in ("q", "tau", "dq"):
        np.testing.assert_array_equal(getattr(found, name), getattr(clean, name))


def test_values_are_repaired_in_the_order_of_time(planar: Robot, clean: Log) -> None:
    """Outliers beside the seams of blocks, interpolated between neighbours in time."""
    plain = plants.edited(clean, "tau", ([199, 504, 797], 0), lambda x: 1e4)
    logs = (plain, blocks_exchanged(plain))
    one, other = (repair(log, find_faults(planar, log))[0] for log in logs)
    np.testing.assert_array_equal(other.t, clean.t)
    np.testing.assert_allclose(other.tau, one.tau, rtol=1e-12)
    assert np.abs(one.tau - clean.tau).max() < 0.2 * np.ptp(clean.tau[:, 0])


@pytest.mark.parametrize("stamps", [{500: 0.1}, {500: 1e9}, {200: 1e9, 700: -3.0}])
def test_stamps_that_fit_nowhere_are_left_out(
    planar: Robot, clean: Log, stamps: dict[int, float]
) -> None:
    log = replace(clean, t=np.array([stamps.get(k, t) for k, t in enumerate(clean.t)]))
    repaired, _ = repair(log, find_faults(planar, log))
    np.testing.assert_array_equal(repaired.t, np.delete(clean.t, list(stamps)))
    np.testing.assert_array_equal(repaired.q, np.delete(clean.q, list(stamps), axis=0))


def one_after_the_other(one: Log, other: Log, later: float = 0.0) -> Log:
    parts = {"t": np.concatenate([one.t, other.t + later])}
    parts |= {n: np.concatenate([x, getattr(other, n)]) for n, x in one.channels()}
    return replace(one, **parts)


@pytest.mark.parametrize("later", [0.0, 0.003, -5.0, -20.0])
def test_a_clock_that_starts_anew_is_a_cut(
    planar: Robot, clean: Log, second: Log, tmp_path: Path, later: float
) -> None:
    """Two runs in one file are the two runs, and are identified as such."""
    n = len(clean)
    both = one_after_the_other(clean, second, later)
    both = both.take(np.r_[0:40, 41, 40, 42 : n + 60, n + 61, n + 60, n + 62 : 2 * n])
    checked = read_checked(load_dataset("planar_2r"), [written(tmp_path, both)], repaired=True)
    overlap = later > -clean.t[-1]  # else sorting puts the second run before the first
    assert any(f"2 parts at row {n}" in note for note in checked.notes) == overlap
    assert ("dropped_samples" in names(checked.faults["run"])) == (not overlap)
    (repaired,) = checked.recordings
    runs = (clean, second) if overlap else (second, clean)
    np.testing.assert_array_equal(repaired.q, np.concatenate([run.q for run in runs]))
    if later != 0.003:
        return
    validate = [plants.recorded(planar, 2)]
    apart, found = (
        identify_robot(planar, recordings, validate=validate)
        for recordings in ([clean, second], [repaired])
    )
    assert len(found.data.train) == 2
    std = np.sqrt(np.diag(apart.least_squares.covariance))
    difference = np.abs(found.least_squares.beta - apart.least_squares.beta)
    assert (difference < 1e-6 * std).all()


def test_another_motion_is_not_sorted_into_a_gap(planar: Robot, clean: Log, second: Log) -> None:
    """Stamps alone would let it pass: they fill the gap, but positions would jump at its ends."""
    rows = np.arange(300, 600)
    other = replace(second.take(rows), t=clean.t[rows])
    log = one_after_the_other(clean.take(np.delete(np.arange(len(clean)), rows)), other)
    repaired, (note, *_) = repair(log, find_faults(planar, log))
    assert "cuts the recording into 2 parts at row 701" in note
    np.testing.assert_array_equal(repaired.q, log.q)


def interleaved(log: Log) -> Log:
    both = one_after_the_other(log, replace(log, q=log.q[::-1], tau=log.tau[::-1]), -0.4 * log.step)
    return both.take(np.arange(2 * len(log)).reshape(2, -1).T.ravel())


def shaken_stamps(log: Log) -> Log:
    noise = np.random.default_rng(0).normal(size=len(log))
    return replace(log, t=log.t + 0.5 * log.step * noise)


@pytest.mark.parametrize(
    "damage",
    [
        interleaved,
        lambda log: replace(log, t=np.mod(log.t, 1.0)),
        lambda log: one_after_the_other(log, replace(log, t=2 * log.t, q=-log.q)),
        shaken_stamps,
    ],
    ids=["interleaved", "wrapped clock", "another rate", "shaken"],
)
def test_time_of_more_than_one_meaning_is_refused(
    clean: Log, tmp_path: Path, damage: Damage
) -> None:
    path, dataset = written(tmp_path, damage(clean)), load_dataset("planar_2r")
    with pytest.raises(BadRecording, match=r"time goes back in .* cut the file by hand") as refusal:
        read_checked(dataset, [path], repaired=True)
    assert "\n" not in str(refusal.value)
    assert (refusal.value.file, refusal.value.column) == (path, "t")
