"""Runs side by side: what differs is said, what agrees is not called different."""

import copy
import json

import numpy as np
import pytest

from excitant.cli import main
from excitant.exceptions import BadInput
from excitant.reports import SavedRun, brief, compare, html, page_of, save_run, summary
from excitant.reports.pages import deviations
from excitant.robots import load_robot
from excitant.robots.check import ModelCheck

pytestmark = pytest.mark.usefixtures("undrawn")
COMPARED = ("design", "check", "identify", "analyze", "diagnose", "demo")


def runs(run, change=None):
    result, series = run
    other, curves = copy.deepcopy(result), dict(series)
    if change is not None:
        change(other, curves)
    return SavedRun("runs/one", result, series), SavedRun("runs/two", other, curves)


def rows(result):
    return [row for s in result["sections"] for t in s["tables"] for row in t["rows"]]


def worse(result, _series):
    for row in result["joints"]:
        if row["validate"]:
            row["validate"] = {key: 2 * x for key, x in row["validate"].items()}
    for row in result["base_parameters"]:
        row["value"] += 1.0


@pytest.mark.parametrize("verb", COMPARED)
def test_a_run_does_not_differ_from_itself(verb, make):
    result = compare(*runs(make[verb]()))
    assert result["remarks"] == []
    found = rows(result)
    assert len(found) > 3
    assert all(len(set(row["written"])) == 1 for row in found)
    assert {x for row in found for x in row.get("difference", ())} <= {0.0, None}
    assert {x for row in found for x in row.get("ratio", ())} <= {1.0, None}
    assert {x for row in found for x in row.get("deviations", ())} <= {0.0, None}


def test_exchanged_runs_exchange_all(make):
    first, second = runs(make["identify"](), worse)
    there, back = rows(compare(first, second)), rows(compare(second, first))
    assert len(there) == len(back)
    for row, twin in zip(there, back, strict=True):
        assert row["written"] == twin["written"][::-1]
        assert row["deviations"] == twin["deviations"]
        for x, y in zip(row["difference"], twin["difference"], strict=True):
            assert x == (None if y is None else -y)
        for x, y in zip(row["ratio"], twin["ratio"], strict=True):
            assert (x is None) or (y is None) or x * y == pytest.approx(1.0)
    doubled = [r for r in there if r["figure"].startswith("Identified, rms")]
    assert [r["ratio"][0] for r in doubled if r["values"][0]] == pytest.approx([2.0] * 3)


def test_several_runs_are_compared_with_the_first(make):
    first, second = runs(make["design"]())
    third = runs(make["design"](), lambda r, _: r["condition_number"].update(final=18.62))[1]
    found = compare(first, second, third)
    (row,) = (r for r in rows(found) if r["name"] == "Condition number")
    assert row["written"] == ["9.31", "9.31", "18.6"]
    assert row["difference"] == [0.0, pytest.approx(9.31)]
    assert row["ratio"] == [1.0, pytest.approx(2.0)]
    assert "C / A" in html(page_of(found, {}))


def test_values_of_the_prior_are_not_judged(make):
    result = compare(*runs(make["identify"](), worse))
    names = [p["name"] for p in make["identify"]()[0]["parameters"] if p["prior_dominated"]]
    judged = [row for row in rows(result) if row["figure"] == "Value"]
    for row in judged:
        if ".".join(reversed(row["name"].split(", "))) in names:
            assert row["deviations"] == [None]
    assert any(row["deviations"] == [0.0] for row in judged)


def test_differences_count_in_standard_deviations_as_often_as_chance_has_it():
    rng = np.random.default_rng(0)
    n, (s, t) = 20_000, (0.3, 1.7)
    pairs = (np.array([[s], [t]]) * rng.normal(size=(2, n))).T
    share = np.mean([deviations(a, s, b, t) > 2 for a, b in pairs])
    assert deviations(1.0, 0.3, 2.5, 0.4) == pytest.approx(1.5 / 0.5)
    for case in ((1.0, None, 9.0, 0.1), (None, 0.1, 9.0, 0.1), (1.0, 0.0, 9.0, 0.0)):
        assert deviations(*case) is None
    expected = 0.0455  # of a normal variable beyond two standard deviations
    assert abs(share - expected) < 4 * np.sqrt(expected * (1 - expected) / n)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda r, _: r.update(cutoff_hz=5.0), "different cut-offs, 12.5 and 5.0 Hz"),
        (lambda _, s: s.update(measured=1.1 * s["measured"]), "different samples"),
        (lambda r, _: r.update(unit="A"), "different units"),
    ],
)
def test_errors_that_do_not_compare_are_not_compared(change, why, make):
    result = compare(*runs(make["identify"](), change))
    assert any(why in remark for remark in result["remarks"])
    for row in rows(result):
        if "rms" in row["figure"]:
            assert "ratio" not in row
    assert why in html(page_of(result, {}))


def test_findings_of_one_run_alone_are_seen(make):
    result, _ = make["compare"]()
    page, text = page_of(result, {}), summary(page_of(result, {}))
    for words in ("A: one.", "B: two.", "backlash"):
        assert words in html(page)
    lines = [line.split() for line in text.splitlines() if line.strip().startswith("backlash")]
    assert lines
    assert {s["title"] for s in result["sections"]} == {
        "Excitation design", "Identification", "Identifiability", "Diagnosis"
    }  # fmt: skip
    assert len(brief(page).splitlines()) == 4


def test_two_models_differ_in_what_was_changed():
    def model(mass=1.0):
        arm = load_robot("planar_2r")
        phi = arm.phi.copy()
        phi[10] *= mass
        return ModelCheck(arm.with_parameters(phi)).result()

    def differing(mass):
        result = compare(SavedRun("one", model(), {}), SavedRun("two", model(mass), {}))
        return {row["name"] for row in rows(result) if len(set(row["written"])) > 1}

    assert differing(1.0) == set()
    assert differing(1.5) == {"Moving mass", "1.\u00a0joint1, link1"}


@pytest.mark.slow
@pytest.mark.parametrize("key", ["runs", "remarks", "sections", "of", "robot"])
def test_any_value_may_be_null_in_a_comparison(key, make):
    result, _ = make["compare"]()
    for spoilt in (None, [], {}, "words", [None], [{"tables": [{"rows": [{}]}]}]):
        page = page_of(result | {key: spoilt}, {})
        assert html(page)
        assert summary(page)


def test_runs_of_different_commands_are_refused(make):
    a, b = (SavedRun(f"runs/{verb}", *make[verb]()) for verb in ("design", "identify"))
    with pytest.raises(BadInput, match=r"runs/identify: .*'identify', but runs/design .*'design'"):
        compare(a, b)
    both = SavedRun("runs/both", *make["compare"]())
    with pytest.raises(BadInput, match="a comparison already"):
        compare(both, both)
    with pytest.raises(BadInput, match="name 2 to"):
        compare(a)


def test_command_writes_a_run_of_its_own(make, tmp_path, capsys):
    for name in ("one", "two"):
        save_run(tmp_path / name, *make["analyze"]())
    save_run(tmp_path / "other", *make["check"]())
    one, two, both = (str(tmp_path / name) for name in ("one", "two", "both"))
    assert main(["report", one, two, one, "-o", both]) == 0
    assert sorted(path.name for path in (tmp_path / "both").iterdir()) == [
        "report.html", "result.json", "series.npz", "summary.txt"
    ]  # fmt: skip
    assert json.loads((tmp_path / "both/result.json").read_text())["of"] == "analyze"
    page = (tmp_path / "both/report.html").read_text()
    assert "figures differ" in capsys.readouterr().out
    assert main(["report", both]) == 0
    assert (tmp_path / "both/report.html").read_text() == page
    capsys.readouterr()
    for words in ([one, str(tmp_path / "other")], [both, both], [one, "-o", both], ["nowhere"], []):
        assert main(["report", *words]) == 1
        assert len(capsys.readouterr().err.splitlines()) == 1
