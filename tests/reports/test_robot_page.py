"""The page of an arm: its picture, its tables, what looks wrong, and the command that writes it."""

import numpy as np
import pytest

from excitant.reports import load_run
from excitant.reports.figure import Polygon, Words
from excitant.reports.figures.arm import arm_figure
from excitant.results import record_of
from excitant.robots import builtin_robots, load_robot
from excitant.robots.check import ModelCheck


@pytest.mark.parametrize("name", ["planar_2r", "scara", "so100", "iiwa14"])
def test_arms_have_a_picture(name):
    robot = load_robot(name)
    figure = arm_figure(ModelCheck(robot).series())
    assert len(figure.panels) == len({panel.title for panel in figure.panels}) == 3
    for panel in figure.panels:
        words = [mark.text for mark in panel.axes[0].marks if isinstance(mark, Words)]
        numbers = {int(k) for group in words for k in group.split(",") if k.isdigit()}
        assert numbers == set(range(1, robot.nv + 1))


def test_the_picture_shows_what_there_is():
    series = ModelCheck(load_robot("ur10")).series()
    whole, bare = map(arm_figure, (series, series | {"zero_solids": np.empty((0, 8))}))
    assert "solids" in whole.caption
    assert "as lines" in bare.caption
    assert len(whole.legend) == len(bare.legend) + 1
    for figure, count in ((whole, len(series["zero_solids"])), (bare, 0)):
        marks = figure.panels[0].axes[0].marks
        assert sum(isinstance(mark, Polygon) and mark.edge != "" for mark in marks) == count


def test_page_and_terminal_say_what_is_wrong_and_where(here, excitant, show):
    """Of an arm whose first joint cannot hold it and whose second has no speed limit."""
    urdf = load_robot("planar_2r").urdf.replace('effort="80"', 'effort="20"')
    (here / "weak.urdf").write_text(urdf.replace('velocity="5"', 'velocity="0"'))
    ran = excitant("robots weak.urdf -o out --mass 12")
    result, series = load_run(here / "out")
    assert ran.status == 0
    found = [(w.check, *w.where, w.hint) for w in result.warnings]
    wrong = [("no_velocity_limit", "joint2", False), ("gravity", "joint1", False)]
    assert found == [*wrong, ("total_mass", "planar_2r", True)]
    result.files = ["series.npz", "summary.txt", "result.json"]
    page = show(result, series)
    assert (here / "out" / "report.html").read_text() == page.source
    text = (here / "out" / "summary.txt").read_text()
    for written in (page.words, text, ran.out):
        assert [warning for warning in result.warnings if warning.sentence not in written] == []
    assert len(page.labels) == 3
    out = excitant("robots weak.urdf").out
    for words in ("joint1: gravity takes up to", "joint2: no velocity limit"):
        assert f"WARNING: {words}" in out
    kinds = ("pose", "points", "axes", "solids")
    assert set(series) == {f"{pose}_{kind}" for pose in ("zero", "bent") for kind in kinds}


def test_a_sound_arm_is_said_to_be(here, excitant):
    printed = excitant("robots gen3 -o out --json").result
    saved, _ = load_run(here / "out")
    assert record_of(printed) == saved
    assert (saved.warnings, saved.kind) == ([], "collaborative arm")
    assert tuple(joint.name for joint in saved.joints) == load_robot("gen3").joints
    page = (here / "out" / "report.html").read_text()
    for words in ("Nothing in its description looks wrong", "Kinova"):
        assert words in page
    assert excitant("report out").status == 0
    assert (here / "out" / "report.html").read_text() == page


def test_the_terminal_shows_joints_and_links(excitant):
    out, arm = excitant("robots tx40 --mass 27").out, load_robot("tx40")
    for words in (*arm.joints, *arm.links, "27.21 kg", "No warning"):
        assert words in out


def test_the_list_says_what_each_arm_is(excitant):
    head, *lines = excitant("robots").out.splitlines()
    assert head.split()[:3] == ["name", "joints", "kind"]
    assert [line.split()[0] for line in lines] == list(builtin_robots())
    listed = {arm["name"]: arm for arm in excitant("robots --json").result["robots"]}
    assert (listed["ur10"]["payload"], listed["planar_2r"]["weight"]) == (10, None)
    assert (listed["scara"]["joints"], listed["scara"]["prismatic"]) == (4, 1)
