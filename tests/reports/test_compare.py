"""Runs side by side: what differs is said, what agrees is not called different."""

import json
from dataclasses import replace

import numpy as np
import pytest

from excitant.exceptions import BadInput
from excitant.reports import SavedRun, brief, compare, html, page_of, save_run, summary
from excitant.reports.pages import deviations
from excitant.results import record_of
from excitant.robots import load_robot
from excitant.robots.check import ModelCheck


def saved(name, result, series):
    return SavedRun(f"runs/{name}", record_of(result), series)


def pair(build, change):
    first, second = build(), build()
    change(*second)
    return saved("one", *first), saved("two", *second)


def worse(result, _series):
    for row in result["joints"]:
        for key in ("rms", "nrmse", "r2", "rms_raw"):
            if row["validate"][key] is not None:
                row["validate"][key] *= 2
    for row in result["base_parameters"]:
        row["value"] = (row["value"] or 0.0) + 1.0


def rows(result):
    return result["figures"]


COMPARED = ("robots", "design", "check", "rehearse", "identify", "analyze", "diagnose", "fleet")


@pytest.mark.parametrize("verb", [*COMPARED, "go", "demo"])
def test_a_run_does_not_differ_from_itself(verb, make):
    run = saved("one", *make[verb]())
    result = compare(run, run)
    found = rows(result)
    assert (result["remarks"], len(found) > 3) == ([], True)
    assert all(len(set(row["written"])) == 1 for row in found)
    assert {x for row in found for x in row["deviations"]} <= {0.0, None}


def test_exchanged_runs_exchange_all(make):
    first, second = pair(make["identify"], worse)
    there, back = rows(compare(first, second)), rows(compare(second, first))
    for row, twin in zip(there, back, strict=True):
        assert (row["written"], row["deviations"]) == (twin["written"][::-1], twin["deviations"])
        assert row["values"] == twin["values"][::-1]
    doubled = [r["values"] for r in there if r["figure"].startswith("Identified, rms")]
    assert [b / a for a, b in doubled if a] == pytest.approx([2.0] * 3)


def test_several_runs_are_compared_with_the_first(make):
    def twice(result, _series):
        result["condition_number"]["final"] *= 2

    first, second = pair(make["design"], twice)
    found = compare(first, first, second)
    (row,) = (r for r in rows(found) if r["name"] == "Condition number")
    assert row["written"] == ["9.31", "9.31", "18.6"]
    assert row["values"] == pytest.approx([9.31, 9.31, 18.62])
    assert ">18.6<" in html(page_of(found, {}))


def test_values_of_the_prior_are_not_judged(make):
    result = compare(*pair(make["identify"], worse))
    parameters = make["identify"]()[0]["parameters"]
    prior = {p["name"] for p in parameters if p["prior_dominated"] and p["link"] in p["name"]}
    values = [row for row in rows(result) if row["figure"] == "Value"]
    judged = {".".join(row["name"].split(", ")[::-1]): row["deviations"] for row in values}
    assert all(judged[name] == [None] for name in prior)
    assert [0.0] in judged.values()


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
        (lambda r, _: r.update(cutoff_hz=5.0), "different cut-offs, 12.50 and 5.000 Hz"),
        (lambda _, s: s.update(measured=1.1 * s["measured"]), "different samples"),
        (lambda r, _: r.update(unit="A"), "different units"),
    ],
)
def test_errors_that_do_not_compare_are_remarked_on(change, why, make):
    result = compare(*pair(make["identify"], change))
    assert any(why in remark for remark in result["remarks"])
    assert why in html(page_of(result, {}))


def test_findings_of_one_run_alone_are_seen(make):
    page = page_of(make["compare"]()[0], {})
    assert [x for x in ("A: one.", "B: two.", "backlash") if x not in html(page)] == []
    assert any(line.split()[:1] == ["backlash"] for line in summary(page).splitlines())
    told = ["Robot", "Excitation design", "Identification", "Identifiability", "Diagnosis"]
    assert [section.title for section in page.sections] == told
    assert len(brief(page).splitlines()) == 5


def test_two_models_differ_in_what_was_changed():
    def model(mass=1.0, speed=1.0):
        arm = load_robot("planar_2r")
        phi = arm.phi * np.where(np.arange(20) == 10, mass, 1.0)
        limits = replace(arm.limits, velocity=speed * arm.limits.velocity)
        return ModelCheck(arm.with_parameters(phi).with_limits(limits)).result()

    def differing(**changes):
        found = rows(compare(saved("one", model(), {}), saved("two", model(**changes), {})))
        return {(row["name"], row["figure"]) for row in found if len(set(row["written"])) > 1}

    assert differing() == set()
    assert differing(speed=2.0) == {(f"{k}.\u00a0joint{k}, link{k}", "Speed") for k in (1, 2)}
    assert {name for name, _ in differing(mass=1.5)} == {"Moving mass", "1.\u00a0joint1, link1"}
    other = saved("two", ModelCheck(load_robot("scara")).result(), {})
    assert "different arms" in compare(saved("one", model(), {}), other)["remarks"][0]


def test_runs_of_different_commands_are_refused(make):
    a, b, both = (saved(x, *make[x]()) for x in ("design", "identify", "compare"))
    for words, named in (
        (r"runs/identify: .*'identify', but runs/design .*'design'", (a, b)),
        ("a comparison already", (both, both)),
        ("name 2 to", (a,)),
    ):
        with pytest.raises(BadInput, match=words):
            compare(*named)


def test_command_writes_a_run_of_its_own(make, here, excitant):
    for name, verb in (("one", "analyze"), ("two", "analyze"), ("other", "check")):
        save_run(here / name, *make[verb]())
    done = excitant("report one two one -o both")
    assert (done.status, "figures differ" in done.out) == (0, True)
    written = {path.name: path.read_bytes() for path in (here / "both").iterdir()}
    assert set(written) == {"report.html", "result.json", "series.npz", "summary.txt"}
    assert json.loads(written["result.json"])["of"] == "analyze"
    assert excitant("report both").status == 0
    assert (here / "both/report.html").read_bytes() == written["report.html"]
