"""Two runs side by side: what differs is said, what agrees is not called different."""

import copy
import json
from dataclasses import replace

import numpy as np
import pytest

from excitant.cli import main
from excitant.exceptions import BadInput
from excitant.reports import SavedRun, brief, compare, render, save_run, summarize
from excitant.reports.comparison_rows import compared_findings, compared_parameters
from excitant.robots import load_robot
from excitant.robots.check import ModelCheck

COMPARED = ("design", "check", "identify", "analyze", "diagnose")


def pair(run, change=None):
    result, series = run
    other, curves = copy.deepcopy(result), dict(series)
    if change is not None:
        change(other, curves)
    return SavedRun("runs/one", result, series), SavedRun("runs/two", other, curves)


def worse(result, series):
    for row in result["joints"]:
        if row["validate"]:
            row["validate"] = {key: 2 * x for key, x in row["validate"].items()}
    for row in (*result["base_parameters"], *result["parameters"]):
        row["value"] += 1.0


@pytest.mark.parametrize("verb", COMPARED)
def test_a_run_does_not_differ_from_itself(verb, make):
    result, _ = compare(*pair(make[verb]()))
    assert result["remarks"] == []
    assert all(row["better"] is None for row in result["key_figures"])
    assert all(row["difference"] in (0, None) for row in result["key_figures"])
    assert any(row["a"] is not None for row in result["key_figures"])
    for key in ("base_parameters", "parameters"):
        if key in result:
            assert result[key]["apart"] == 0
            assert result[key]["judged"] > 0
            assert result[key]["only_a"] == result[key]["only_b"] == []
    for key in ("findings", "faults"):
        if key in result:
            assert len(result[key]["common"]) > 0
            assert result[key]["only_a"] == result[key]["only_b"] == []
    assert all(row["change"] in (0, None) for row in result.get("errors", ()))
    assert result.get("categories", []) == []


def test_exchanged_runs_exchange_all(make):
    first, second = pair(make["identify"](), worse)
    there, _ = compare(first, second)
    back, _ = compare(second, first)
    other = {"a": "b", "b": "a", None: None}
    assert any(row["better"] == "a" for row in there["key_figures"])
    for row, twin in zip(there["key_figures"], back["key_figures"], strict=True):
        assert row["better"] == other[twin["better"]]
        assert (row["a"], row["b"]) == (twin["b"], twin["a"])
        if row["difference"] is not None:
            assert row["difference"] == -twin["difference"]
    twins = {row["name"]: row for row in back["base_parameters"]["rows"]}
    for row in there["base_parameters"]["rows"]:
        assert row["deviations"] == twins[row["name"]]["deviations"]
        assert row["difference"] == -twins[row["name"]]["difference"]


def test_a_difference_counts_in_standard_deviations():
    def one(value, std, **more):
        return {"base": [{"expression": "x", "value": value, "std": std, **more}]}

    def row(a, b):
        return compared_parameters(a, b, "base", "expression")["rows"][0]

    apart = row(one(1.0, 0.3), one(2.5, 0.4))
    assert apart["deviations"] == pytest.approx(1.5 / 0.5)
    assert apart["apart"]
    assert not row(one(1.0, 0.3), one(1.9, 0.4))["apart"]
    for a, b in (
        (one(1.0, None), one(9.0, 0.1)),
        (one(None, 0.1), one(9.0, 0.1)),
        (one(1.0, 0.0), one(9.0, 0.0)),
        (one(1.0, 0.1), one(9.0, 0.1, prior_dominated=True)),
    ):
        assert row(a, b)["deviations"] is None
        assert not row(a, b)["apart"]


def test_equal_parameters_are_apart_as_often_as_chance_has_it():
    rng = np.random.default_rng(0)
    n, std = 20_000, np.array([0.3, 1.7])
    runs = [
        {"base": [{"name": str(k), "value": x, "std": s} for k, x in enumerate(values)]}
        for s, values in zip(std, std[:, None] * rng.normal(size=(2, n)), strict=True)
    ]
    share = compared_parameters(*runs, "base", "name")["apart"] / n
    expected = 0.0455  # of a normal variable beyond two standard deviations
    assert abs(share - expected) < 4 * np.sqrt(expected * (1 - expected) / n)


def test_findings_match_by_effect_and_joints():
    def run(*findings):
        return {"findings": [{"effect": effect, "joints": joints} for effect, joints in findings]}

    found = compared_findings(
        run(("stiction", ["j1"]), ("stiction", ["j2", "j3"]), ("spring", ["j1"]), ("drift", [])),
        run(("stiction", ["j3", "j4"]), ("spring", ["j2"]), ("stiction", ["j1"]), ("drift", [])),
        "findings",
        "effect",
    )
    pairs = [(row["a"]["joints"], row["b"]["joints"]) for row in found["common"]]
    assert sorted(pairs) == [([], []), (["j1"], ["j1"]), (["j2", "j3"], ["j3", "j4"])]
    assert [(row["effect"], row["joints"]) for row in found["only_a"]] == [("spring", ["j1"])]
    assert [(row["effect"], row["joints"]) for row in found["only_b"]] == [("spring", ["j2"])]


def test_findings_that_share_most_joints_are_one():
    def run(*findings):
        return {"f": [{"effect": "drift", "joints": joints} for joints in findings]}

    a, b = run(["j1", "j5"], ["j2", "j3", "j4"]), run(["j1", "j2", "j3", "j4"])
    found = compared_findings(a, b, "f", "effect")
    assert [row["a"]["joints"] for row in found["common"]] == [["j2", "j3", "j4"]]
    assert [row["joints"] for row in found["only_a"]] == [["j1", "j5"]]
    assert found["only_b"] == []


def test_one_finding_matches_once():
    rows = {"findings": [{"effect": "spring", "joints": ["j1"]}]}
    twice = {"findings": rows["findings"] * 2}
    found = compared_findings(twice, rows, "findings", "effect")
    assert [len(found[key]) for key in ("common", "only_a", "only_b")] == [1, 1, 0]


def other_filter(result, series):
    worse(result, series)
    result["cutoff_hz"] = 5.0


def other_rows(result, series):
    worse(result, series)
    series["measured"] = 1.1 * series["measured"]


@pytest.mark.parametrize(("change", "why"), [(other_filter, "filters"), (other_rows, "rows")])
def test_errors_that_do_not_compare_are_not_judged(change, why, make):
    result, series = compare(*pair(make["identify"](), change))
    assert any(why in remark for remark in result["remarks"])
    assert all(row["better"] is None for row in result["key_figures"])
    page = render(result, series)
    assert "do not compare one to one" in page
    assert "B is better" not in page


def test_both_models_share_a_drawing_where_they_share_rows(make):
    def drawings(change):
        result, series = compare(*pair(make["identify"](), change))
        return render(result, series).count("measured torque over time")

    assert drawings(worse) == 7
    assert drawings(other_rows) == 14


def test_page_names_both_runs_and_all_that_differs(make):
    result, series = make["compare"]()
    page = render(result, series)
    for words in ("runs/one", "runs/two", "backlash", "only A", "only B", "wrist_roll_joint"):
        assert words in page
    assert set(result["sections"]) == {"design", "identify", "analyze", "diagnose"}
    lines = brief(result).splitlines()
    assert lines[0].startswith("compared")
    assert len(lines) >= 5


@pytest.mark.slow
@pytest.mark.parametrize("verb", COMPARED)
def test_any_value_may_be_null_in_a_comparison(verb, make):
    result, _ = compare(*pair(make[verb]()))
    for key, value in list(result.items()):
        for spoilt in (None, [], {}, "words", [None], {"rows": [None]}):
            if key not in ("verb", "of"):
                render(result | {key: spoilt}, {})
                summarize(result | {key: spoilt})
        if isinstance(value, list) and value and isinstance(value[0], dict):
            for inner in value[0]:
                spoilt = [value[0] | {inner: None}, *value[1:2]]
                render(result | {key: spoilt}, {})
                summarize(result | {key: spoilt})


def model(**changes):
    arm = load_robot("planar_2r")
    phi = arm.phi.copy()
    phi[10] *= changes.get("mass", 1.0)
    limits = replace(arm.limits, velocity=changes.get("speed", 1.0) * arm.limits.velocity)
    joint_1_free = arm.limits.position.copy()
    joint_1_free[0, 0] = changes.get("lower", joint_1_free[0, 0])
    other = arm.with_limits(replace(limits, position=joint_1_free)).with_parameters(phi)
    return ModelCheck(other.with_effects(other.effects[: changes.get("effects", 3)])).result()


def test_two_models_differ_in_what_was_changed():
    def differing(**changes):
        a, b = (SavedRun(name, model(**c), {}) for name, c in (("one", {}), ("two", changes)))
        result, series = compare(a, b)
        assert series == {}
        return result, {row["name"]: row for row in result["models"]["rows"]}

    result, rows = differing()
    assert rows == {}
    assert result["models"]["only_a"] == result["models"]["only_b"] == []
    assert result["models"]["compared"] == 2 * 6 + 20 + 6
    assert "alike" in render(result, {})
    result, rows = differing(mass=1.5, speed=2.0, lower=-np.inf, effects=2)
    weights = {f"joint{k}: greatest torque of gravity" for k in (1, 2)}
    limits = {"joint1: velocity limit", "joint2: velocity limit", "joint1: lower limit"}
    assert set(rows) - weights == limits | {"link2.m"}
    assert rows["link2.m"]["b"] == 1.5 * rows["link2.m"]["a"]
    assert rows["joint1: lower limit"]["b"] is None
    assert result["models"]["only_a"] == ["joint1.Ia", "joint2.Ia"]
    said = f"{len(rows)} of 36 values that both models give differ."
    for written in (render(result, {}), brief(result)):
        assert said in written
    assert "link2.m" in summarize(result)


def test_models_without_a_common_name_are_said_to_have_none():
    other = ModelCheck(load_robot("ur10")).result()
    result, _ = compare(SavedRun("one", model(), {}), SavedRun("two", other, {}))
    assert result["models"]["rows"] == []
    assert "share no name" in brief(result)
    assert "share no name" in render(result, {})


def test_runs_of_different_commands_are_refused(make):
    a, b = (SavedRun(f"runs/{verb}", *make[verb]()) for verb in ("design", "identify"))
    with pytest.raises(BadInput, match=r"runs/identify: .*'identify', but runs/design .*'design'"):
        compare(a, b)
    both = SavedRun("runs/both", *make["compare"]())
    with pytest.raises(BadInput, match="cannot be compared"):
        compare(both, both)


def test_command_writes_a_run_of_its_own(make, tmp_path, capsys):
    for name in ("one", "two"):
        save_run(tmp_path / name, *make["analyze"]())
    save_run(tmp_path / "other", *make["check"]())
    one, two, both = (str(tmp_path / name) for name in ("one", "two", "both"))
    assert main(["report", one, two, "-o", both]) == 0
    assert sorted(path.name for path in (tmp_path / "both").iterdir()) == [
        "report.html", "result.json", "series.npz", "summary.txt"
    ]  # fmt: skip
    assert json.loads((tmp_path / "both/result.json").read_text())["of"] == "analyze"
    page = (tmp_path / "both/report.html").read_text()
    assert "compared" in capsys.readouterr().out
    assert main(["report", both]) == 0
    assert (tmp_path / "both/report.html").read_text() == page
    capsys.readouterr()
    for words in (
        [one, str(tmp_path / "other")],
        [both, both],
        [one, "-o", both],
        [one, "nowhere"],
    ):
        assert main(["report", *words]) == 1
        assert len(capsys.readouterr().err.splitlines()) == 1
