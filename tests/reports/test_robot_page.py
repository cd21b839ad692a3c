"""The page of an arm: its picture, its tables, what looks wrong, and the command that writes it."""

from __future__ import annotations

import json
import re
from html import unescape
from pathlib import Path

import numpy as np
import pytest

from excitant.cli import main
from excitant.reports import brief, html, load_run, page_of, summary
from excitant.reports.arm_figures import arm_figure
from excitant.reports.drawing import style
from excitant.reports.robot import robot_section
from excitant.robots import builtin_robots, load_robot
from excitant.robots.check import ModelCheck


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """With a planar arm whose first joint cannot hold it and whose second has no speed limit."""
    urdf = load_robot("planar_2r").urdf.replace('effort="80"', 'effort="20"')
    (tmp_path / "weak.urdf").write_text(urdf.replace('velocity="5"', 'velocity="0"'))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("name", ["planar_2r", "scara", "so100", "iiwa14"])
def test_arms_have_a_picture(name: str) -> None:
    robot = load_robot(name)
    with style():
        figure = arm_figure(ModelCheck(robot).series())
    assert figure is not None
    assert len(figure.panels) == 3
    assert len({panel.title for panel in figure.panels}) == 3
    for panel in figure.panels:
        numbers = re.findall(r">([\d,]+)</text>", panel.svg)
        shown = {int(k) for group in numbers for k in group.split(",") if k}
        assert set(range(1, robot.nv + 1)) <= shown


def test_the_picture_shows_what_there_is() -> None:
    series = ModelCheck(load_robot("ur10")).series()
    with style():
        whole = arm_figure(series)
        bare = arm_figure({**series, "zero_solids": np.empty((0, 8))})
        assert arm_figure({}) is None
        assert arm_figure({**series, "zero_points": np.zeros((3, 3))}) is None
        assert arm_figure({**series, "zero_axes": np.full((6, 3), np.nan)}) is None
    assert whole is not None
    assert bare is not None
    assert "solids" in whole.caption
    assert "as lines" in bare.caption
    assert len(whole.legend) == len(bare.legend) + 1
    assert whole.panels[0].svg.count("<path") > bare.panels[0].svg.count("<path")


def test_a_section_needs_no_key() -> None:
    with style():
        empty = robot_section({"verb": "robots", "robot": "x"}, {})
    assert "look" in empty.lead
    robot = load_robot("panda")
    result = ModelCheck(robot).result()
    for key in result:
        left = {k: None if k == key else v for k, v in result.items()}
        left["verb"] = "robots"
        assert "<h1" in html(page_of(left, {}))
        assert summary(page_of(left, {}))
        assert brief(page_of(left, {}))


def test_the_page_says_what_is_wrong_and_where(here: Path) -> None:
    assert main(["robots", "weak.urdf", "-o", "out", "--mass", "12"]) == 0
    result, series = load_run(here / "out")
    assert [(w["check"], w["where"]) for w in result["warnings"]] == [
        ("no_velocity_limit", ["joint2"]),
        ("gravity", ["joint1"]),
        ("total_mass", ["planar_2r"]),
    ]
    assert [w["hint"] for w in result["warnings"]] == [False, False, True]
    page, text = ((here / "out" / name).read_text() for name in ("report.html", "summary.txt"))
    for written in (unescape(page), text, brief(page_of(result, {}))):
        for warning in result["warnings"]:
            assert warning["sentence"] in written
    assert page.count("<svg") >= 3
    assert "joint1" in page
    assert set(series) == {
        f"{pose}_{key}" for pose in ("zero", "bent") for key in ("pose", "points", "axes", "solids")
    }


def test_a_sound_arm_is_said_to_be(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robots", "gen3", "-o", "out", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    saved, _ = load_run(here / "out")
    assert printed == saved
    assert saved["warnings"] == []
    assert saved["kind"] == "collaborative arm"
    page = (here / "out" / "report.html").read_text()
    assert "Nothing in its description looks wrong" in page
    assert "Kinova" in page
    assert main(["report", "out"]) == 0
    assert (here / "out" / "report.html").read_text() == page


def test_the_terminal_shows_the_same(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robots", "weak.urdf"]) == 0
    out = capsys.readouterr().out
    assert "WARNING: joint1: gravity takes up to" in out
    assert "WARNING: joint2: no velocity limit" in out
    assert main(["robots", "tx40", "--mass", "27"]) == 0
    out = capsys.readouterr().out
    assert "No warning" in out
    for word in (*load_robot("tx40").joints, *load_robot("tx40").links, "27.21 kg"):
        assert word in out


def test_the_list_says_what_each_arm_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robots"]) == 0
    head, *lines = capsys.readouterr().out.splitlines()
    assert head.split()[:3] == ["name", "joints", "kind"]
    assert [line.split()[0] for line in lines] == list(builtin_robots())
    assert main(["robots", "--json"]) == 0
    listed = {arm["name"]: arm for arm in json.loads(capsys.readouterr().out)["robots"]}
    assert listed["ur10"]["payload"] == 10
    assert listed["scara"]["joints"] == 4
    assert listed["scara"]["prismatic"] == 1
    assert listed["planar_2r"]["weight"] is None


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["robots", "--mass", "3"], "--mass is about one arm"),
        (["robots", "-o", "out"], "-o is about one arm"),
        (["robots", "ur10", "--mass", "0"], "must be positive"),
        (["robots", "ur1"], "did you mean 'ur10'"),
    ],
)
def test_what_cannot_be_is_refused(
    words: list[str], said: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == 1
    assert said in capsys.readouterr().err
    assert not (here / "out").exists()
