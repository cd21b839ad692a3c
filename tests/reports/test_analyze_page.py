"""The page of an analysis: one section for each link, and what a motion leaves open, in words."""

import re

import pytest

from excitant.analysis.identifiability import analyze
from excitant.reports import brief, page_of
from excitant.robots import load_robot


def test_every_link_has_its_section_and_parameters(make, written):
    (result, _), page = make["analyze"](), written("analyze")
    assert {f"{link['link']} at {link['joint']}" for link in result["links"]} <= {*page.headings}
    said = [row["name"] for row in result["practical"]]
    for words in (*said, "weigh or swing the link apart from the arm"):
        assert words in page.words
    assert len(page.source.encode()) < 1_000_000


def test_a_link_section_says_what_the_result_says(make, written):
    link = make["analyze"]()[0]["links"][1]
    said = re.split("(?:upper_arm|forearm)_link at ", written("analyze").words)[-2]
    assert "Link 2 of 6" in said
    for row in link["parameters"]:
        symbol, unit = row["name"].rpartition(".")[2], row["unit"]
        assert re.search(rf" {re.escape(symbol)} [^A-Za-z]*{re.escape(unit)} ", said), symbol
    spread = {p["name"]: p["prior_influence"] for p in link["parameters"]}
    assert spread["upper_arm_link.m"] == pytest.approx(1.0)
    assert spread["shoulder_lift_joint.Fv"] < 0.05
    assert said.count("not at all") >= len(link["unidentifiable"])


def test_what_the_motion_does_not_show_is_named_with_its_cure(make, written):
    (result, _), said = make["analyze"](), written("analyze").words
    lost = {row["name"] for row in result["not_shown"]}
    assert {"elbow_joint.Fv", "elbow_joint.Fc", "elbow_joint.Ia"} <= lost
    cures = ("moving elbow_joint, which rests", "at rest: elbow_joint", "Not shown by this motion")
    assert [words for words in cures if words not in said] == []
    for words in ("does not show", "elbow_joint"):
        assert words in brief(page_of(result, {}))


def test_without_a_motion_there_is_structure_alone(show):
    arm = load_robot("ur10")
    found = analyze(arm)
    page = show(found.result(), found.series())
    assert "gravity along −z of the base" in page.words
    assert "Follows prior" not in page.words
    assert "Least determined by the motion" not in page.headings
    assert f"{arm.links[-1]} at {arm.joints[-1]}" in page.headings
    assert found.series() == {}
