"""A folder with its robot and recordings needs nothing else said."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from excitant.exceptions import BadInput, BadRecording, ExcitantError
from excitant.identify import load_dataset
from excitant.robots import Robot, load_robot


@pytest.fixture
def folder(table: pd.DataFrame, planar: Robot, tmp_path: Path, save: Callable[..., Path]) -> Path:
    (tmp_path / "robot.urdf").write_text(planar.urdf, encoding="utf-8")
    save(table.assign(i1=table.tau1 / 2, i2=table.tau2 / 2), tmp_path / "first.parquet")
    save(table, tmp_path / "second.csv")
    (tmp_path / "dataset.json").write_text("{}")
    return tmp_path


def test_recordings_are_named_relative_to_the_folder_or_are_paths(
    folder: Path, monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    dataset = load_dataset(folder)
    named = dataset.recordings(["first", "first.parquet", "second", "second.csv"])
    assert [r.name for r in named] == ["first", "first", "second", "second"]
    assert {Path(r.file).parent for r in named} == {folder}
    assert [r.name for r in dataset.recordings([])] == ["first", "second"]
    without = load_dataset("planar_2r")
    assert without.recordings([str(folder / "second.csv")])[0].name == "second"
    with pytest.raises(BadInput, match="name at least one file"):
        without.recordings([])


def test_the_sidecar_names_the_torque_column_its_gains_and_units(
    folder: Path, table: pd.DataFrame
) -> None:
    assert load_dataset(folder).recordings(["first"])[0].unit == "N·m"
    torque, units = {"column": "i"}, {"q": "deg"}
    (folder / "dataset.json").write_text(json.dumps({"torque": torque}))
    assert load_dataset(folder).recordings(["first"])[0].unit == "A"
    with pytest.raises(BadRecording, match="'i1'"):
        load_dataset(folder).recordings(["second"])
    torque |= {"drive_gain_Nm_per_A": [1, 3]}
    (folder / "dataset.json").write_text(json.dumps({"torque": torque, "units": units}))
    [found] = load_dataset(folder).recordings(["first"])
    np.testing.assert_allclose(found.tau, table[["tau1", "tau2"]] * [0.5, 1.5])
    np.testing.assert_allclose(found.q, np.radians(table[["q1", "q2"]]), atol=1e-12)


def test_the_sidecar_locks_joints(folder: Path, planar: Robot) -> None:
    sidecar = {"kinematics": {"urdf": "robot.urdf", "lock": ["joint2"]}}
    (folder / "dataset.json").write_text(json.dumps(sidecar))
    robot = load_dataset(folder).robot
    assert robot.joints == ("joint1",)
    assert dict(robot.locked) == {"joint2": 0.0}
    expected = load_robot(folder / "robot.urdf", lock={"joint2": 0.0})
    assert robot.phi.tolist() == expected.phi.tolist()
    assert robot.phi[0] == pytest.approx(planar.phi[::10].sum())  # the outer link rides along


@pytest.mark.parametrize(
    "content",
    [
        "{",
        "[]",
        '{"kinematics": "robot.urdf"}',
        '{"torque": "i"}',
        '{"torque": {"column": 3}}',
        '{"kinematics": {"lock": "joint2"}}',
        '{"kinematics": {"lock": ["joint9"]}}',
        '{"kinematics": {"urdf": "nothing.urdf"}}',
    ],
)
def test_a_bad_sidecar_is_refused_in_one_line(folder: Path, content: str) -> None:
    (folder / "dataset.json").write_text(content)
    with pytest.raises(ExcitantError, match=str(folder)) as refusal:
        load_dataset(folder)
    assert ("dataset.json" in str(refusal.value)) == ("nothing" not in content)
    assert "\n" not in str(refusal.value)
    (folder / "dataset.json").unlink()
    assert load_dataset(folder).robot.nv == 2


def test_a_folder_without_robot_or_recordings_is_refused(folder: Path) -> None:
    (folder / "first.parquet").unlink()
    (folder / "second.csv").unlink()
    with pytest.raises(BadInput, match=r"no \.parquet or \.csv recording"):
        load_dataset(folder).recordings([])
    (folder / "robot.urdf").unlink()
    with pytest.raises(BadInput, match="no robot model"):
        load_dataset(folder)


def test_real_data_sets_read_and_what_is_held_out_is_never_fitted(data_folder: Path) -> None:
    for name, nv, unit in (("ur10", 6, "N·m"), ("panda", 7, "N·m"), ("ur10e", 6, "A")):
        dataset = load_dataset(data_folder / name)
        assert dataset.robot.nv == nv
        assert {r.unit for r in dataset.recordings([])} == {unit}
    dataset = load_dataset(data_folder / "dualarm_v2")
    names = [path.stem for path in dataset.paths([], without=["exc_52p2.parquet"])]
    assert "exc_52p2" not in names
    assert "exc_13p5" in names
    with pytest.raises(BadInput, match="exc_52p2 is to be fitted and held out"):
        dataset.recordings(["exc_52p2"], without=["exc_52p2.parquet"])
