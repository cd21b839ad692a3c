"""`excitant identify --online` and `--payload`: what they write, and what they refuse."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from excitant.cli import main
from excitant.design import random_trajectory
from excitant.robots import Robot
from excitant.robots.virtual_arm import HiddenEffect, industrial_sensors, virtual_arm

LOAD = (("m", 1.0), ("mcx", 0.2), ("mcy", 0.0), ("mcz", 0.0), ("Ixx", 0.01), ("Ixy", 0.0),
        ("Iyy", 0.055), ("Ixz", 0.0), ("Iyz", 0.0), ("Izz", 0.055))  # fmt: skip


@pytest.fixture(scope="module")
def folder(planar: Robot, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The planar arm recorded without and with a load."""
    folder, rng = tmp_path_factory.mktemp("recordings"), np.random.default_rng(0)
    load = HiddenEffect("payload", planar.joints[-1], LOAD)
    for name, hidden in (("free", ()), ("held", (load,))):
        sensors = industrial_sensors(planar, 200.0)
        arm = virtual_arm(planar, rng, hidden=hidden, sensors=sensors, tolerance=0.0)
        table = arm.record(random_trajectory(planar, rng, 10.0, 5), 10.0, rng)
        table.to_csv(folder / f"{name}.csv", index=False)
    return folder


def test_online_writes_estimates_over_time(folder: Path, tmp_path: Path) -> None:
    words = ["identify", "planar_2r", str(folder / "free.csv"), "--online", "--forgetting", "20"]
    words += ["--force"]  # the given model is the true one here
    assert main([*words, "-o", str(tmp_path)]) == 0
    result = json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))
    online = result["online"]
    assert {"messages", "history", "converged", "delay_s", "differentiator"} <= online.keys()
    assert len(online["history"]["t"]) > 5
    assert all(joint["validate"]["r2"] > 0.98 for joint in result["joints"])
    last = online["history"]["value"][-1]
    assert last == [entry["value"] for entry in result["base_parameters"]]
    for name in ("series.npz", "summary.txt", "report.html", "model.yaml"):
        assert (tmp_path / name).is_file()


def test_payload_against_the_unloaded_arm(folder: Path, tmp_path: Path) -> None:
    words = ["identify", "planar_2r", str(folder / "held.csv"), "--payload"]
    words += ["--unloaded", str(folder / "free.csv"), "-o", str(tmp_path)]
    assert main(words) == 0
    payload = json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))["payload"]
    values = {p["name"]: p for p in payload["parameters"]}
    # two parallel axes show what is felt in their plane
    for name, true in (("mcx", 0.2), ("mcz", 0.0)):
        assert abs(values[name]["value"] - true) < 4 * values[name]["std"], name
    assert values["mcx"]["value"] == pytest.approx(0.2, rel=0.1)


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--unloaded", "free.csv"], "give --payload too"),
        (["--forgetting", "3"], "give --online too"),
        (["--online", "--forgetting", "0"], "longer time constant"),
    ],
)
def test_options_that_do_not_fit_are_refused(
    folder: Path, words: list[str], why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [str(folder / w) if w.endswith(".csv") else w for w in words]
    assert main(["identify", "planar_2r", str(folder / "held.csv"), *words]) == 1
    error = capsys.readouterr().err
    assert why in error
    assert len(error.splitlines()) == 1
