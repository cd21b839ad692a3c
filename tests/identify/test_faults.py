"""Faults of recordings: planted ones are found, named and repaired; faultless ones raise none."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
from planted_faults import PLANTS, Plant, edited, log_of_table, recorded, scaled, with_rows

from excitant.exceptions import BadRecording
from excitant.identify import ColumnMap, identify_robot, load_dataset, raw_recording
from excitant.identify.faults import (
    FAULTS,
    Checked,
    Fault,
    Log,
    find_copies,
    find_faults,
    read_checked,
    repair,
)
from excitant.identify.faults.modelled import in_joint_frames
from excitant.robots import Robot, load_robot

N = 1001  # samples of a recording
Read = Callable[..., Checked]


def shifted_rows(robot: Robot, log: Log, rng: np.random.Generator) -> Log:
    """Rows in which every value stands one column too far to the right."""
    whole = np.hstack([values for _, values in log.channels()])
    rows = [len(log) // 5, len(log) // 2, 4 * len(log) // 5]
    whole[rows] = np.roll(whole[rows], 1, axis=1)
    q, dq, tau = np.split(whole, 3, axis=1)
    return replace(log, q=q, dq=dq, tau=tau)


def decimated(log: Log, start: int = 0) -> Log:
    """From a row on every other sample is missing, the stamps run on."""
    return with_rows(log, np.r_[0:start, start : len(log) : 2])


def dead(name: str, joint: int) -> Plant:
    return lambda robot, log, rng: edited(log, name, (slice(None), joint), lambda x: 0.0)


MORE: dict[str, tuple[str, Plant]] = {
    "shifted rows": ("corrupt_rows", shifted_rows),
    "decimated": ("wrong_sample_rate", lambda _, x, rng: decimated(x)),
    "decimated, no speed": ("wrong_sample_rate", lambda _, x, rng: replace(decimated(x), dq=None)),
    "decimated on the way": ("wrong_sample_rate", lambda _, x, rng: decimated(x, len(x) // 2)),
    "dead torque": ("dead_channel", dead("tau", -1)),
    "dead speed": ("dead_channel", dead("dq", 1)),
    "dead position": ("dead_channel", dead("q", 1)),
}
ALL = PLANTS | MORE
NOT_IN_REAL = {"rows_lost_unseen", "noise_for_torque"}
CASES = [*(("planar", plant) for plant in PLANTS), *(("six joints", plant) for plant in MORE)]
SLOW = [
    pytest.param("real", plant, marks=pytest.mark.slow) for plant in ALL if plant not in NOT_IN_REAL
]


@pytest.fixture(scope="module")
def clean(planar: Robot) -> Log:
    return recorded(planar, 0)


@pytest.fixture(scope="module")
def second(planar: Robot) -> Log:
    return recorded(planar, 1)


@pytest.fixture(scope="module")
def faultless(
    planar: Robot, clean: Log, ur10: Robot, data_folder: Path
) -> dict[str, tuple[Robot, Log]]:
    real = load_dataset(data_folder / "ur10").robot
    table = pd.read_parquet(data_folder / "ur10" / "unisa_exciting.parquet")
    return {
        "planar": (planar, clean),
        "without speeds": (planar, replace(clean, dq=None)),
        "six joints": (ur10, recorded(ur10, 0)),
        "real": (real, log_of_table(real, table)),
    }


@pytest.fixture
def read(save: Callable[..., Path]) -> Read:
    """``read(log, ..., repaired=...)``: files run0, run1, ... with their faults."""

    def checked(*logs: Log, repaired: bool = False) -> Checked:
        files = [str(save(log, f"run{k}.parquet")) for k, log in enumerate(logs)]
        return read_checked(load_dataset("planar_2r"), files, repaired=repaired)

    return checked


def planted(plant: str, robot: Robot, log: Log, seed: int = 1) -> Log:
    return ALL[plant][1](robot, log, np.random.default_rng(seed))


def names(faults: tuple[Fault, ...]) -> set[str]:
    return {fault.fault for fault in faults}


@pytest.mark.parametrize(("arm", "plant"), [*CASES, *SLOW])
def test_a_planted_fault_is_named(
    faultless: dict[str, tuple[Robot, Log]], arm: str, plant: str
) -> None:
    robot, log = faultless[arm]
    faults = find_faults(robot, planted(plant, robot, log, seed=4 if arm == "real" else 1))
    assert ALL[plant][0] in names(faults)
    assert names(faults) <= set(FAULTS)
    for fault in faults:
        assert any(character.isdigit() for character in fault.detail), fault.detail
        assert set(fault.joints) <= set(robot.joints)
    if arm == "six joints" and plant in ("dead torque", "dead speed"):
        joint = robot.joints[-1 if plant == "dead torque" else 1]
        assert [fault.joints for fault in faults] == [(joint,)]
    if arm == "six joints" and plant == "decimated on the way":
        (fault,) = faults
        assert fault.evidence["at"] == pytest.approx(log.t[len(log) // 2], abs=0.3)
        assert fault.evidence["before"] == pytest.approx(1.0, abs=0.02)
        assert fault.evidence["after"] == pytest.approx(0.5, abs=0.02)


def test_faultless_recordings_raise_none(faultless: dict[str, tuple[Robot, Log]]) -> None:
    assert [fault.detail for pair in faultless.values() for fault in find_faults(*pair)] == []


@pytest.mark.parametrize(
    "name", [pytest.param("panda", marks=pytest.mark.slow), "planar_2r", "cmu_dd_arm_ii", "real"]
)
def test_inertias_are_told_by_their_frames(
    name: str, faultless: dict[str, tuple[Robot, Log]]
) -> None:
    robot = faultless[name][0] if name in faultless else load_robot(name)
    log = faultless[name][1] if name in faultless else recorded(robot, 1)
    places = [robot.model.jointPlacements[j + 1] for j in range(1, robot.nv)]
    places.append(robot.model.frames[robot.tip].placement)
    bodies = map(pin.Inertia.FromDynamicParameters, robot.phi.reshape(-1, 10))
    moved = [place.actInv(body) for place, body in zip(places, bodies, strict=True)]
    distal = robot.with_parameters(np.concatenate([body.toDynamicParameters() for body in moved]))
    np.testing.assert_allclose(in_joint_frames(distal), robot.phi, atol=1e-12)
    assert "wrong_frame" in names(find_faults(distal, log))
    assert find_faults(robot, log) == ()


@pytest.mark.parametrize(("column", "computed"), [("i", False), ("tau_target", True)])
def test_what_a_controller_computes_is_no_measurement(
    data_folder: Path, column: str, computed: bool
) -> None:
    robot = load_dataset(data_folder / "ur10e").robot
    path = data_folder / "ur10e" / "id_12harm_30s.parquet"
    log = raw_recording(path, robot, ColumnMap(torque=column))
    assert ("not_measured" in names(find_faults(robot, log))) == computed


REPAIRABLE = """velocity_negated torque_negated position_negated velocity_in_rpm all_in_degrees
    half_rate half_rate_without_velocity milliseconds counted_samples stamps_twice
    rows_logged_twice not_a_number torque_outliers position_outliers"""


@pytest.mark.parametrize("plant", REPAIRABLE.split())
def test_a_repaired_recording_is_faultless(planar: Robot, clean: Log, plant: str) -> None:
    log = planted(plant, planar, clean, seed=2)
    repaired, notes = repair(log, find_faults(planar, log))
    assert notes
    gaps = plant in ("rows_logged_twice", "not_a_number")
    assert names(find_faults(planar, repaired)) <= ({"dropped_samples"} if gaps else set())


def test_repair_restores_the_values_and_does_only_what_faults_say(
    planar: Robot, clean: Log
) -> None:
    log = planted("torque_negated", planar, planted("velocity_in_rpm", planar, clean), seed=0)
    assert repair(clean, ())[1] == ()
    for repaired, _ in (repair(log, find_faults(planar, log)), repair(clean, ())):
        np.testing.assert_allclose(repaired.dq, clean.dq, rtol=1e-12)
        np.testing.assert_array_equal(repaired.tau, clean.tau)
        np.testing.assert_array_equal(repaired.t, clean.t)


def test_rows_of_a_fault_are_rows_of_the_file(planar: Robot, clean: Log) -> None:
    """Also when rows before them were left out by an earlier test."""
    log = edited(clean, "tau", (600, 0), lambda x: 1e4).take(np.r_[0, 0, 0, 1:N])
    faults = {f.fault: f for f in find_faults(planar, log)}
    assert list(faults["duplicate_samples"].evidence["rows"]) == [1, 2]
    assert list(faults["corrupt_rows"].evidence["rows"]) == [602]


def test_nothing_at_all_is_no_traceback(planar: Robot, clean: Log) -> None:
    for rows in (0, 1, 2, 10, 60):
        find_faults(planar, clean.take(np.arange(rows)))
    find_faults(planar, scaled(clean, "q", 0.0))
    find_faults(planar, scaled(clean, "tau", np.nan))


def test_a_file_that_is_refused_can_be_read_with_repair(
    planar: Robot, clean: Log, read: Read
) -> None:
    wrong = planted("velocity_negated", planar, clean)
    assert names(read(wrong).faults["run0"]) == {"wrong_sign"}
    for plant, why in (
        ("zero_torque", "dead channel"),
        ("not_a_number", "not a finite number"),
        ("stamps_twice", "time repeats"),
    ):
        log = planted(plant, planar, wrong)
        with pytest.raises(BadRecording, match=why):
            read(log)
    checked = read(log, repaired=True)
    assert names(checked.faults["run0"]) == {"duplicate_samples", "wrong_sign"}
    assert {entry["recording"] for entry in checked.entries()} == {"run0"}
    assert len(checked.notes) == 2
    assert len(checked.recordings[0].t) == len(clean)


def test_the_same_recording_under_two_names_is_found(clean: Log, read: Read) -> None:
    later, other = replace(clean, t=clean.t + 5.0), scaled(clean, "tau", 1.001)
    found = find_copies({"first": clean, "second": later, "third": other})
    assert set(found) == {"second"}
    assert "first" in found["second"].detail
    checked = read(clean, clean)
    assert checked.faults["run0"] == ()
    assert names(checked.faults["run1"]) == {"duplicate_samples"}


BLOCKS = np.r_[0:200, 500:800, 200:500, 800:N]
LATE = np.r_[0:40, 41, 40, 42:300, 301:331, 300, 331:700, 701:781, 700, 781:N]
ORDERS: dict[str, tuple[np.ndarray, str]] = {
    "exchanged": (LATE, "sorts rows 41, 330, 780 by time"),
    "blocks": (BLOCKS, "sorts rows (200 to 499|500 to 799) by time"),
    "backwards": (np.arange(N)[::-1], "sorts rows 1 to 1000 by time"),
    "written again": (np.r_[0:500, 480:N], "leaves 20 rows out"),
}


@pytest.mark.parametrize("order", ORDERS)
def test_rows_out_of_order_are_put_right(clean: Log, read: Read, order: str) -> None:
    rows, said = ORDERS[order]
    with pytest.raises(BadRecording, match="time goes back"):
        read(clean.take(rows))
    checked = read(clean.take(rows), repaired=True)
    (note,), (found,) = checked.notes, checked.recordings
    assert re.search(said, note)
    np.testing.assert_allclose(found.t - found.t[0], clean.t, atol=1e-12)
    for name, values in clean.channels():
        np.testing.assert_array_equal(getattr(found, name), values)


def test_values_are_repaired_in_the_order_of_time(planar: Robot, clean: Log) -> None:
    """Outliers beside a border of blocks: their neighbours stand elsewhere in the file."""
    plain = edited(clean, "tau", ([199, 504, 797], 0), lambda x: 1e4)
    one, other = (repair(log, find_faults(planar, log))[0] for log in (plain, plain.take(BLOCKS)))
    np.testing.assert_array_equal(other.t, clean.t)
    np.testing.assert_allclose(other.tau, one.tau, rtol=1e-12)
    assert np.abs(one.tau - clean.tau).max() < 0.2 * np.ptp(clean.tau[:, 0])


@pytest.mark.parametrize("stamps", [{500: 0.1}, {500: 1e9}, {200: 1e9, 700: -3.0}])
def test_stamps_that_fit_nowhere_are_left_out(
    planar: Robot, clean: Log, stamps: dict[int, float]
) -> None:
    log = edited(clean, "t", list(stamps), lambda t: list(stamps.values()))
    repaired, _ = repair(log, find_faults(planar, log))
    np.testing.assert_array_equal(repaired.t, np.delete(clean.t, list(stamps)))
    np.testing.assert_array_equal(repaired.q, np.delete(clean.q, list(stamps), axis=0))


def one_after_the_other(one: Log, other: Log, later: float = 0.0) -> Log:
    parts = {n: np.concatenate([x, getattr(other, n)]) for n, x in one.channels()}
    return replace(one, t=np.concatenate([one.t, other.t + later]), **parts)


@pytest.mark.parametrize("later", [0.0, 0.003, -5.0, -20.0])
def test_a_clock_that_starts_anew_is_a_cut(
    planar: Robot, clean: Log, second: Log, read: Read, later: float
) -> None:
    """Two runs in one file are the two runs, and are identified as such."""
    both = one_after_the_other(clean, second, later)
    both = both.take(np.r_[0:40, 41, 40, 42 : N + 60, N + 61, N + 60, N + 62 : 2 * N])
    checked = read(both, repaired=True)
    overlap = later > -clean.t[-1]  # else sorting puts the second run before the first
    assert any(f"2 parts at row {N}" in note for note in checked.notes) == overlap
    assert ("dropped_samples" in names(checked.faults["run0"])) == (not overlap)
    (repaired,) = checked.recordings
    runs = (clean, second) if overlap else (second, clean)
    np.testing.assert_array_equal(repaired.q, np.concatenate([run.q for run in runs]))
    if later == 0.003:
        apart, found = (
            identify_robot(planar, recordings, validate=[recorded(planar, 2)])
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
    log = one_after_the_other(clean.take(np.delete(np.arange(N), rows)), other)
    repaired, (note, *_) = repair(log, find_faults(planar, log))
    assert "cuts the recording into 2 parts at row 701" in note
    np.testing.assert_array_equal(repaired.q, log.q)


def interleaved(log: Log) -> Log:
    both = one_after_the_other(log, replace(log, q=log.q[::-1], tau=log.tau[::-1]), -0.4 * log.step)
    return both.take(np.arange(2 * N).reshape(2, -1).T.ravel())


NOISE = np.random.default_rng(0).normal(size=N)
UNCLEAR: dict[str, Callable[[Log], Log]] = {
    "interleaved": interleaved,
    "wrapped clock": lambda log: replace(log, t=np.mod(log.t, 1.0)),
    "another rate": lambda log: one_after_the_other(log, replace(log, t=2 * log.t, q=-log.q)),
    "shaken": lambda log: replace(log, t=log.t + 0.5 * log.step * NOISE),
}


@pytest.mark.parametrize("damage", UNCLEAR)
def test_time_of_more_than_one_meaning_is_refused(clean: Log, read: Read, damage: str) -> None:
    with pytest.raises(BadRecording, match=r"time goes back in .* cut the file by hand") as refusal:
        read(UNCLEAR[damage](clean), repaired=True)
    assert "\n" not in str(refusal.value)
    assert (Path(refusal.value.file).name, refusal.value.column) == ("run0.parquet", "t")
