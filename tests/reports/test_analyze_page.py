"""The page of an analysis: one section for each link, and what a motion leaves open, in words."""

import copy
import re

import numpy as np
import pytest

from excitant.analysis.identifiability import analyze
from excitant.design import random_trajectory
from excitant.reports import brief, html, page_of, save_run
from excitant.reports.run import as_saved
from excitant.robots import Motion, load_robot
from excitant.robots.effects import standard_effects


def render(result, series):
    return html(page_of(result, series))


def plain(page):
    inside = re.sub(r"<style.*?</style>|<wbr>", "", page, flags=re.DOTALL)
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", inside)).replace("\u00a0", " ")


def headings(page):
    return [plain(h).strip() for h in re.findall(r"<h3[^>]*>(.*?)</h3>", page, flags=re.DOTALL)]


def through_json(result):
    """What a saved run gives back."""
    return as_saved(result, {})[0]


def motion_of(robot, resting=None):
    motion = random_trajectory(robot, np.random.default_rng(0), 10.0, 5).motion(50.0)
    if resting is None:
        return motion
    q, dq, ddq = (np.array(x) for x in (motion.q, motion.dq, motion.ddq))
    q[:, resting], dq[:, resting], ddq[:, resting] = 0.4, 0.0, 0.0
    return Motion(motion.t, q, dq, ddq)


@pytest.fixture(scope="module")
def arm():
    return load_robot("ur10")


@pytest.fixture(scope="module")
def moved(arm):
    found = analyze(arm, effects=standard_effects(arm.joints), motion=motion_of(arm, resting=2))
    return found, through_json(found.result()), found.series()


@pytest.fixture(scope="module")
def page(moved):
    return render(*moved[1:])


def test_every_link_has_its_section_and_parameters(moved, page, arm):
    found, result, _ = moved
    for link, joint in zip(arm.links, arm.joints, strict=True):
        assert f"{link} at {joint}" in headings(page)
    said = plain(page)
    for p in found.practical:
        assert p.expression in said
    for direction in result["directions"]:
        assert direction["meaning"] in said
    assert "weigh or swing the link apart from the arm" in said


def test_a_link_section_says_what_the_result_says(moved, page):
    _, result, _ = moved
    _, section, _ = re.split(r"<h3[^>]*>(?=upper_|forearm_)", page)
    said = plain(section)
    assert "Link 2 of 6" in said
    for row in result["links"][1]["parameters"]:
        symbol, unit = row["name"].rpartition(".")[2], row["unit"]
        assert re.search(rf" {re.escape(symbol)} [^A-Za-z]*{re.escape(unit)} ", said), symbol
    spread = {p["name"]: p["prior_influence"] for p in result["links"][1]["parameters"]}
    assert spread["upper_arm_link.m"] == pytest.approx(1.0)
    assert spread["shoulder_lift_joint.Fv"] < 0.05
    assert said.count("not at all") >= len(result["links"][1]["unidentifiable"])


def test_what_the_motion_does_not_show_is_named_with_its_cure(moved, page):
    _, result, _ = moved
    said = plain(page)
    lost = {row["name"] for row in result["not_shown"]}
    assert {"elbow_joint.Fv", "elbow_joint.Fc", "elbow_joint.Ia"} <= lost
    assert "moving elbow_joint, which rests" in said
    assert "at rest: elbow_joint" in said
    assert "Not shown by this motion" in said
    assert "does not show" in brief(page_of(result, {}))
    assert "elbow_joint" in brief(page_of(result, {}))


def test_without_a_motion_there_is_structure_alone(arm):
    found = analyze(arm)
    result, series = through_json(found.result()), found.series()
    page = render(result, series)
    said = plain(page)
    assert "gravity along −z of the base" in said
    assert "Follows prior" not in said
    assert "Least determined by the motion" not in headings(page)
    assert f"{arm.links[-1]} at {arm.joints[-1]}" in headings(page)
    assert series == {}


@pytest.mark.slow
def test_any_key_may_be_missing_or_null(moved, undrawn):
    _, result, series = moved
    result = copy.deepcopy(result)
    result["links"] = result["links"][:2]
    for key in result:
        if key != "verb":
            render({**result, key: None}, series)
    for key in result["links"][0]["parameters"][0]:
        spoilt = copy.deepcopy(result)
        for row in spoilt["links"][0]["parameters"]:
            row[key] = None
        render(spoilt, series)
        for row in spoilt["links"][0]["parameters"]:
            del row[key]
        render(spoilt, {})
    for name in series:
        render(result, {**series, name: np.full_like(series[name], np.nan)})
        render(result, {**series, name: np.zeros(3)})


def test_the_page_stays_small_and_the_run_is_saved(moved, tmp_path):
    _, result, series = moved
    paths, _ = save_run(tmp_path, result, series)
    report = next(path for path in paths if path.suffix == ".html")
    assert report.stat().st_size < 1_000_000
