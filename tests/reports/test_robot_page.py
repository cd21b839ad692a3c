"""The page of an arm: its picture, its tables, what looks wrong, and the command that writes it."""

import numpy as np
import pytest

from excitant.reports import brief, load_run, page_of
from excitant.reports.figure import Polygon, Words
from excitant.reports.figures.arm import arm_figure
from excitant.results import record_of
from excitant.robots import builtin_robots, load_robot
from excitant.robots.check import ModelCheck


@pytest.fixture
def here(tmp_path, monkeypatch):
    """With a planar arm whose first joint cannot hold it and whose second has no speed limit."""
    urdf = load_robot("planar_2r").urdf.replace('effort="80"', 'effort="20"')
    (tmp_path / "weak.urdf").write_text(urdf.replace('velocity="5"', 'velocity="0"'))
    monkeypatch.chdir(tmp_path)
    return tmp_path


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
    whole = arm_figure(series)
    bare = arm_figure({**series, "zero_solids": np.empty((0, 8))})
    assert "solids" in whole.caption
    assert "as lines" in bare.caption
    assert len(whole.legend) == len(bare.legend) + 1
    areas = [
        sum(
            isinstance(mark, Polygon) and mark.edge != "" for mark in figure.panels[0].axes[0].marks
        )
        for figure in (whole, bare)
    ]
    assert areas == [len(series["zero_solids"]), 0]


def test_the_page_says_what_is_wrong_and_where(here, excitant, show):
    assert excitant("robots weak.urdf -o out --mass 12").status == 0
    result, series = load_run(here / "out")
    assert [(w.check, w.where, w.hint) for w in result.warnings] == [
        ("no_velocity_limit", ["joint2"], False),
        ("gravity", ["joint1"], False),
        ("total_mass", ["planar_2r"], True),
    ]
    result.files = ["series.npz", "summary.txt", "result.json"]
    page = show(result, series)
    assert (here / "out" / "report.html").read_text() == page.source
    text = (here / "out" / "summary.txt").read_text()
    for written in (page.words, text, brief(page_of(result, {}))):
        for warning in result.warnings:
            assert warning.sentence in written
    assert len(page.labels) == 3
    assert set(series) == {
        f"{pose}_{key}" for pose in ("zero", "bent") for key in ("pose", "points", "axes", "solids")
    }


def test_a_sound_arm_is_said_to_be(here, excitant):
    printed = excitant("robots gen3 -o out --json").result
    saved, _ = load_run(here / "out")
    assert record_of(printed) == saved
    assert saved.warnings == []
    assert saved.kind == "collaborative arm"
    page = (here / "out" / "report.html").read_text()
    assert "Nothing in its description looks wrong" in page
    assert "Kinova" in page
    assert excitant("report out").status == 0
    assert (here / "out" / "report.html").read_text() == page


def test_the_terminal_shows_the_same(here, excitant):
    weak = excitant("robots weak.urdf")
    assert weak.status == 0
    assert "WARNING: joint1: gravity takes up to" in weak.out
    assert "WARNING: joint2: no velocity limit" in weak.out
    out, arm = excitant("robots tx40 --mass 27").out, load_robot("tx40")
    for words in (*arm.joints, *arm.links, "27.21 kg", "No warning"):
        assert words in out


def test_the_list_says_what_each_arm_is(excitant):
    head, *lines = excitant("robots").out.splitlines()
    assert head.split()[:3] == ["name", "joints", "kind"]
    assert [line.split()[0] for line in lines] == list(builtin_robots())
    listed = {arm["name"]: arm for arm in excitant("robots --json").result["robots"]}
    assert listed["ur10"]["payload"] == 10
    assert (listed["scara"]["joints"], listed["scara"]["prismatic"]) == (4, 1)
    assert listed["planar_2r"]["weight"] is None
