"""The demo names what its virtual arm hides, for a seed fixed here and for others."""

import json
from pathlib import Path
from typing import Any

import pytest

from excitant.cli import main
from excitant.demo import run_demo, truth_of
from excitant.results import record_of
from excitant.robots import load_robot
from excitant.robots.virtual_arm import HiddenEffect

SEED = 2


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Of a motion from one start, which is as good here as one from eight."""
    folder = tmp_path_factory.mktemp("demo") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("excitant.demo._STARTS", 1)
        assert main(["demo", "--robot", "planar_2r", "--seed", str(SEED), "-o", str(folder)]) == 0
    return {"folder": folder, **json.loads((folder / "result.json").read_text())}


def test_the_hidden_effect_is_named_on_its_joint(result: dict[str, Any]) -> None:
    truth, lead = result["truth"], result["diagnose"]["findings"][0]
    effect, joint = truth["effect"], truth["joint"]
    assert (lead["effect"], lead["joints"], lead["verdict"]) == (effect, [joint], "named")
    known = {"effect": effect, "joints": [joint], "correct": True, "truth": "named"}
    assert {key: result["verdict"][key] for key in known} == known
    for name in ("summary.txt", "report.html"):
        text = (result["folder"] / name).read_text(encoding="utf-8")
        assert effect.replace("_", " ") in text.lower()
        assert joint in text


def test_the_result_is_the_record_of_every_verb(result: dict[str, Any]) -> None:
    record = record_of({key: value for key, value in result.items() if key != "folder"})
    for verb in ("design", "identify", "analyze", "diagnose"):
        assert getattr(record, verb).__struct_config__.tag == verb
    assert result["identify"]["physical"]["consistent"]
    assert max(v for v in result["design"]["limits"].values() if v is not None) <= 1.0
    assert all(Path(file).is_file() for file in result["files"])


def test_what_is_named_makes_the_model_better(result: dict[str, Any]) -> None:
    holdout = result["diagnose"]["findings"][0]["holdout"]
    assert holdout["rms_after"] < holdout["rms_before"]
    for joint in result["identify"]["joints"]:
        assert joint["validate"]["rms"] < joint["baseline"]["rms"] or joint["validate"]["r2"] > 0.97


def test_the_written_recordings_give_the_same_diagnosis(result, excitant, tmp_path):
    run, held = (result["folder"] / f"{name}.parquet" for name in ("excitation", "holdout"))
    again = excitant("diagnose planar_2r --json", run, "--validate", held, "-o", tmp_path).result
    for found, expected in zip(again["findings"], result["diagnose"]["findings"], strict=True):
        assert (found["effect"], found["joints"]) == (expected["effect"], expected["joints"])
        assert found["holdout"] == pytest.approx(expected["holdout"], rel=1e-9)


@pytest.mark.slow
def test_the_hidden_effect_is_named_on_an_arm_of_six_joints() -> None:
    result, *_ = run_demo(load_robot("ur10"), 3, lambda fraction, words: None)
    assert result["verdict"]["correct"], (result["truth"], result["verdict"])


@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        ({"effect": "spring", "joints": ["j2", "j1"], "verdict": "named"}, "named"),
        ({"effect": "spring", "joints": ["j1"], "verdict": "undecided"}, "undecided"),
        ({"effect": "backlash", "rivals": [{"effect": "spring", "joints": ["j1"]}]}, "undecided"),
        ({"effect": "friction", "parts": [{"effect": "spring", "verdict": "named"}]}, "named"),
        ({"effect": "spring", "joints": ["j3"], "verdict": "named"}, "missed"),
        ({"effect": "backlash", "joints": ["j1"], "verdict": "named"}, "missed"),
    ],
)
def test_an_answer_is_right_where_the_truth_is_named_or_left_open(entry, expected):
    whole = {"joints": ["j1"], "verdict": "undecided", "rivals": []}
    parts = [whole | part for part in entry.get("parts", ())]
    others = whole | {"effect": "payload", "joints": ["j6"], "verdict": "named"}
    findings = [others, whole | entry | ({"parts": parts} if parts else {})]
    assert truth_of(HiddenEffect("spring", "j1", ()), findings) == expected
    assert truth_of(HiddenEffect("spring", "j1", ()), []) == "missed"
