"""Faults of recordings: planted ones are found and named, faultless recordings raise none."""

from __future__ import annotations

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

from excitant.identify.dataset import load_dataset
from excitant.identify.faults import (
    FAULTS,
    Fault,
    Log,
    find_copies,
    find_faults,
    read_checked,
    repair,
)
from excitant.robots import Robot, load_robot


def _planted() -> ModuleType:
    """The faults that the benchmark plants."""
    path = Path(__file__).resolve().parents[2] / "benchmarks" / "planted_faults.py"
    spec = importlib.util.spec_from_file_location("planted_faults", path)
    if spec is None or spec.loader is None:
        raise ImportError(path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["planted_faults"] = module
    spec.loader.exec_module(module)
    return module


plants = _planted()
PLANTS = plants.PLANTS


@pytest.fixture(scope="module")
def clean(planar: Robot) -> Log:
    return plants.recorded(planar, 0)


each_plant = pytest.mark.parametrize(
    ("name", "plant"), PLANTS, ids=[plant.__name__ for _, plant in PLANTS]
)


def names(faults: tuple[Fault, ...]) -> set[str]:
    return {fault.fault for fault in faults}


@each_plant
def test_a_planted_fault_is_named(
    planar: Robot, clean: Log, name: str, plant: plants.Plant
) -> None:
    faults = find_faults(planar, plant(planar, clean, np.random.default_rng(1)))
    assert name in names(faults)
    assert names(faults) <= set(FAULTS)
    for fault in faults:
        assert any(character.isdigit() for character in fault.detail), fault.detail
        assert set(fault.joints) <= set(planar.joints)


def test_a_faultless_recording_raises_none(planar: Robot, clean: Log) -> None:
    assert [fault.detail for fault in find_faults(planar, clean)] == []


def test_without_velocity_it_is_faultless_too(planar: Robot, clean: Log) -> None:
    assert [f.detail for f in find_faults(planar, replace(clean, dq=None))] == []


@pytest.mark.parametrize(
    "plant",
    [
        plants.velocity_negated,
        plants.torque_negated,
        plants.position_negated,
        plants.velocity_in_rpm,
        plants.all_in_degrees,
        plants.half_rate,
        plants.half_rate_without_velocity,
        plants.milliseconds,
        plants.counted_samples,
        plants.stamps_twice,
        plants.rows_logged_twice,
        plants.not_a_number,
        plants.torque_outliers,
        plants.position_outliers,
    ],
    ids=lambda plant: plant.__name__,
)
def test_a_repaired_recording_is_faultless(planar: Robot, clean: Log, plant: plants.Plant) -> None:
    log = plant(planar, clean, np.random.default_rng(2))
    faults = find_faults(planar, log)
    repaired, notes = repair(log, faults)
    assert notes
    left = names(find_faults(planar, repaired))
    assert left <= (
        {"dropped_samples"} if plant in (plants.rows_logged_twice, plants.not_a_number) else set()
    )


def test_repair_restores_the_values(planar: Robot, clean: Log) -> None:
    log = plants.torque_negated(
        planar, plants.velocity_in_rpm(planar, clean, None), np.random.default_rng(0)
    )
    repaired, _ = repair(log, find_faults(planar, log))
    np.testing.assert_allclose(repaired.dq, clean.dq, rtol=1e-12)
    np.testing.assert_array_equal(repaired.tau, clean.tau)
    np.testing.assert_array_equal(repaired.t, clean.t)


def test_repair_does_only_what_faults_say(clean: Log) -> None:
    repaired, notes = repair(clean, ())
    assert notes == ()
    np.testing.assert_array_equal(repaired.tau, clean.tau)


def test_the_same_recording_under_two_names_is_found(clean: Log) -> None:
    later = replace(clean, t=clean.t + 5.0)
    other = plants.scaled(clean, "tau", 1.001)
    found = find_copies({"first": clean, "second": later, "third": other})
    assert set(found) == {"second"}
    assert "first" in found["second"].detail


def test_rows_of_a_fault_are_rows_of_the_file(planar: Robot, clean: Log) -> None:
    """Also when rows before them were left out by an earlier test."""
    log = plants.edited(clean, "tau", lambda x: x.__setitem__((600, 0), 1e4))
    log = log.take(np.r_[0, 0, 0, np.arange(1, len(log))])
    faults = {f.fault: f for f in find_faults(planar, log)}
    assert list(faults["duplicate_samples"].evidence["rows"]) == [1, 2]
    assert list(faults["corrupt_rows"].evidence["rows"]) == [602]


def test_nothing_at_all_is_no_traceback(planar: Robot, clean: Log) -> None:
    for rows in (0, 1, 2, 10, 60):
        find_faults(planar, clean.take(np.arange(rows)))
    find_faults(planar, plants.scaled(clean, "q", 0.0))
    find_faults(planar, plants.scaled(clean, "tau", np.nan))


def written(folder: Path, log: Log) -> Path:
    columns = {"t": log.t}
    for name, values in log.channels():
        columns |= {f"{name}{j + 1}": values[:, j] for j in range(log.nv)}
    pd.DataFrame(columns).to_parquet(folder / "run.parquet")
    return folder / "run.parquet"


def test_a_file_that_is_refused_can_be_read_with_repair(
    planar: Robot, clean: Log, tmp_path: Path
) -> None:
    rng = np.random.default_rng(0)
    log = plants.stamps_twice(planar, plants.velocity_negated(planar, clean, rng), rng)
    path = written(tmp_path, log)
    checked = read_checked(load_dataset("planar_2r"), [str(path)], repaired=True)
    assert names(checked.faults["run"]) == {"duplicate_samples", "wrong_sign"}
    assert {entry["recording"] for entry in checked.entries()} == {"run"}
    assert len(checked.notes) == 2
    assert len(checked.recordings[0].t) == len(clean)


def real(folder: Path, dataset: str, name: str) -> tuple[Robot, Log]:
    found = load_dataset(folder / dataset)
    table = pd.read_parquet(folder / dataset / f"{name}.parquet")
    return found.robot, plants.log_of_table(found.robot, table, found.torque_column or "tau")


def test_a_real_recording_without_known_faults_raises_none(data_folder: Path) -> None:
    robot, log = real(data_folder, "ur10", "unisa_exciting")
    assert [fault.detail for fault in find_faults(robot, log)] == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "plant"),
    [pair for pair in PLANTS if pair[1] not in (plants.rows_lost_unseen, plants.noise_for_torque)],
    ids=lambda value: getattr(value, "__name__", value),
)
def test_faults_planted_in_a_real_recording_are_named(
    data_folder: Path, name: str, plant: plants.Plant
) -> None:
    robot, log = real(data_folder, "ur10", "unisa_exciting")
    assert name in names(find_faults(robot, plant(robot, log, np.random.default_rng(4))))


def test_what_a_controller_computes_is_no_measurement(data_folder: Path) -> None:
    """A log with the motor current and the torque that the controller's model asked for."""
    folder = data_folder / "ur10e"
    robot = load_dataset(folder).robot
    table = pd.read_parquet(folder / "id_12harm_30s.parquet")
    measured, computed = (plants.log_of_table(robot, table, name) for name in ("i", "tau_target"))
    assert "not_measured" not in names(find_faults(robot, measured))
    assert "not_measured" in names(find_faults(robot, computed))


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["ur10", "panda"])
def test_faultless_recordings_of_larger_arms_raise_none(robot: str) -> None:
    arm = load_robot(robot)
    assert [f.detail for f in find_faults(arm, plants.recorded(arm, 1))] == []
