"""The page of an arm: its picture, its tables, what looks wrong, and the command that writes it."""

import numpy as np
import pytest

from excitant.reports import load_run
from excitant.reports.player import arm_player
from excitant.results import record_of
from excitant.robots import builtin_robots, load_robot
from excitant.robots.check import ModelCheck


@pytest.mark.parametrize("name", ["planar_2r", "scara", "so100", "iiwa14"])
def test_each_joint_is_shown_to_move_alone_and_within_its_range(name):
    robot = load_robot(name)
    check = ModelCheck(robot)
    series = check.series()
    q, (low, high) = series["play_q"], robot.limits.position.T
    assert ((low <= q) & (q <= high)).all()
    moves = q != q[0]
    assert (moves.sum(axis=1) <= 1).all()
    assert (np.ptp(q, axis=0) > 0.1).all()
    dq, step = series["play_dq"], series["play_t"][1]
    travelled = np.cumsum((dq[1:] + dq[:-1]) / 2 * step, axis=0)  # by the trapezoidal rule
    np.testing.assert_allclose(travelled, q[1:] - q[0], atol=0.01)
    player = arm_player(record_of(check.result()), series)
    assert [joint for joint, _ in player.joints] == list(robot.joints)
    assert arm_player(record_of(check.result()), {}) is None


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
    out = excitant("robots weak.urdf").out
    for words in ("joint1: gravity takes up to", "joint2: no velocity limit"):
        assert f"WARNING: {words}" in out
    assert set(series) == {"play_t", "play_q", "play_dq"}


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
