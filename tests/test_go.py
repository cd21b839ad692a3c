"""One command from a robot and its recordings to a verdict, which is right or refuses."""

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from excitant.design import random_trajectory
from excitant.reports import load_run
from excitant.robots import load_robot
from excitant.robots.virtual_arm import HiddenEffect, virtual_arm

EXAMPLE = Path(__file__).parents[1] / "examples" / "cell3"
HIDDEN = HiddenEffect("coulomb_friction", "joint2", (("Fc", 1.0),))
Logs = dict[str, pd.DataFrame]
SECTIONS = ("Robot", "Identification", "Identifiability", "Diagnosis")


@pytest.fixture(scope="module")
def logs() -> Logs:
    """Two motions of an arm with more friction than its model, and of one that is its model."""
    robot, tables = load_robot("planar_2r"), {}
    for arm, hidden, tolerance in (("worn", [HIDDEN], 0.02), ("exact", [], 0.0)):
        rng = np.random.default_rng(1)
        true = virtual_arm(robot, rng, hidden=hidden, tolerance=tolerance)
        for name in ("one", "two"):
            motion = random_trajectory(robot, rng, 8.0, 4)
            tables[f"{arm}-{name}"] = true.record(motion, 8.0, rng)
    return tables


@pytest.fixture
def here(logs: Logs, here: Path) -> Path:
    for name, table in logs.items():
        table.to_csv(f"{name}.csv", index=False)
    return here


def test_the_verdict_names_the_cause_its_joint_and_the_model_to_use(here: Path, excitant: Any):
    ran = excitant("go planar_2r worn-one.csv --validate worn-two.csv -o out")
    lines = ran.out.splitlines()
    assert ran.status == 0
    assert len(lines) <= 15
    assert lines[0].startswith("verdict      Of the torque, the given model misses ")
    assert lines[1].strip().startswith("Main cause: joint2: Coulomb friction is ")
    assert lines[1].endswith(" (named).")
    assert any(line.startswith("joint2 ") and line.endswith("Coulomb friction") for line in lines)
    assert lines[-3:] == ["out/extended.urdf", "out/extended.yaml", "out/report.html"]
    result, _ = load_run(here / "out")
    verdict = result.verdict
    assert (verdict.effect, verdict.joints) == ("coulomb_friction", ["joint2"])
    assert (verdict.use, verdict.refused, verdict.next) == ("extended", [], "")
    [friction] = result.diagnose.findings[0].parameters
    assert friction.value - friction.given == pytest.approx(1.0, rel=0.1)
    assert {Path(f).name for f in result.files} >= {"identified.urdf", "model.yaml"}
    assert all(Path(f).is_file() for f in result.files)
    page = (here / "out" / "report.html").read_text(encoding="utf-8")
    assert all(f">{title}</h2>" in page for title in SECTIONS)
    assert excitant("robots", here / "out" / verdict.files[0]).status == 0


@pytest.mark.slow
def test_its_figures_are_those_of_identify_and_diagnose(here: Path, excitant: Any) -> None:
    words = "planar_2r worn-one.csv --validate worn-two.csv --cutoff 8 --json"
    found = excitant(f"go {words} -o out").result
    identify, diagnose = (excitant(f"{x} {words} -o {x}").result for x in ("identify", "diagnose"))
    assert identify["joints"] == found["identify"]["joints"]
    for model in ("simulation", "extended"):
        assert diagnose[model]["joints"] == found["diagnose"][model]["joints"]


def test_a_model_that_is_right_is_kept(here: Path, excitant: Any) -> None:
    ran = excitant("go planar_2r exact-one.csv --validate exact-two.csv -o out")
    assert ran.status == 0
    assert "Keep the given model: no other is better." in ran.out
    assert load_run(here / "out")[0].verdict.use == "given"


@pytest.mark.slow
def test_wrong_data_are_refused_first_until_they_are_repaired(logs, here, excitant):
    one = logs["worn-one"]
    one.assign(q2=np.degrees(one["q2"]), dq2=np.degrees(one["dq2"])).to_csv("deg.csv", index=False)
    words = "go planar_2r deg.csv --validate worn-two.csv -o out"
    ran = excitant(words)
    first = "use no model of these recordings: wrong unit in deg (joint2)"
    lines = ran.out.splitlines()
    assert (ran.status, lines[0]) == (1, first)
    assert any(line.startswith("data fault   deg: q is in degrees") for line in lines)
    assert any(line.startswith("next ") and "--repair" in line for line in lines)
    assert not [*(here / "out").glob("*.urdf")]
    ran = excitant(f"{words} --repair")
    assert (ran.status, "(repaired)" in ran.out) == (0, True)
    assert load_run(here / "out")[0].verdict.effect == "coulomb_friction"


def test_a_hold_out_that_nothing_predicts_is_no_ground_for_a_model(logs, here, excitant):
    """As where it is of another arm: its torque is that of another motion."""
    two = logs["worn-two"]
    other = {f"tau{j}": two[f"tau{j}"].to_numpy()[::-1] for j in (1, 2)}
    two.assign(**other).to_csv("other.csv", index=False)
    ran = excitant("go planar_2r worn-one.csv --validate other.csv -o out")
    assert ran.status == 1
    assert ran.out.startswith("use no model of these recordings: the ")
    assert "Use none of them." in ran.out
    assert load_run(here / "out")[0].verdict.use is None


@pytest.mark.slow
def test_a_folder_stands_for_its_robot_and_recordings(logs: Logs, here: Path, excitant: Any):
    folder = here / "cell"
    folder.mkdir()
    (folder / "robot.urdf").write_text(load_robot("planar_2r").urdf, encoding="utf-8")
    logs["worn-one"].to_csv(folder / "one.csv", index=False)
    found = [excitant(f"go {words} --json -o out") for words in ("cell", "cell/robot.urdf cell")]
    assert [ran.status for ran in found] == [0, 0]
    first, second = (ran.result["verdict"] for ran in found)
    assert first == second


@pytest.mark.slow
def test_the_example_is_what_its_script_writes(here, excitant, monkeypatch, own_steps):
    spec = importlib.util.spec_from_file_location("cell3", EXAMPLE.with_suffix(".py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "FOLDER", here / "again")
    module.main()
    for name in ("run1.csv", "run2.csv"):
        old, new = (pd.read_csv(folder / name) for folder in (EXAMPLE, here / "again"))
        assert list(old) == list(new)
        np.testing.assert_allclose(old, new, atol=0.05)
    assert sum(file.stat().st_size for file in EXAMPLE.iterdir()) < 1_000_000
    run1, run2 = EXAMPLE / "run1.csv", EXAMPLE / "run2.csv"
    verdict = excitant("go", EXAMPLE / "robot.urdf", run1, "--validate", run2, "--json").result
    assert verdict["verdict"]["joints"] == ["elbow_joint"]
    [friction] = verdict["diagnose"]["findings"][0]["parameters"]
    assert friction["value"] - friction["given"] == pytest.approx(8.0, rel=0.05)
