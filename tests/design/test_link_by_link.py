"""One motion per link: limits, rest, held joints, and that row i alone shows link i."""

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from limit_use import limit_shares

from excitant.design import LinkByLinkDesign, check, design_link_by_link, load_trajectory
from excitant.reports.player import player
from excitant.reports.run import as_saved
from excitant.results import record_of
from excitant.robots import Robot, base_parameters, load_robot


@pytest.fixture(scope="module")
def puma() -> LinkByLinkDesign:
    """The first joints of an arm whose inner joints carry the outer ones' weight."""
    robot = load_robot("puma560", lock={"joint4": 0.0, "joint5": 0.3, "joint6": 0.0})
    options = {"duration": 5.0, "harmonics": 2, "columns": "inertial", "starts": 1, "jobs": 1}
    return design_link_by_link(robot, **options)


def test_one_motion_per_link_from_the_last_inward(puma: LinkByLinkDesign) -> None:
    assert list(puma.motions) == [2, 1, 0]
    assert list(puma.files(10.0))[::2] == ["link3.csv", "link2.csv", "link1.csv"]
    determined = sum(len(design.base) for design in puma.motions.values())
    assert determined == puma.base == len(base_parameters(puma.robot))


def test_motions_rest_at_both_ends_and_hold_outer_joints(puma: LinkByLinkDesign) -> None:
    for joint, design in puma.motions.items():
        path = design.trajectory
        t = np.linspace(0, path.period, 1501)
        for order in (1, 2):
            assert np.abs(path(t[[0, -1]], order)).max() < 1e-9
        way = np.ptp(path(t), axis=0)
        assert way[joint + 1 :].max(initial=0.0) == 0.0
        assert (way[: joint + 1] > 0.1).all()
        for shares in limit_shares(puma.robot, path.at(t)).values():
            assert shares.max() <= 1.0
        assert check(puma.robot, path).hold


def test_the_motions_are_played_one_after_the_other(puma: LinkByLinkDesign) -> None:
    result, series = puma.result(), puma.series()
    t, start = series["play_t"], 0.0
    assert (np.diff(t) >= 0).all()
    for design in puma.motions.values():
        period = design.trajectory.period
        inside = (t > start) & (t < start + period)
        there = design.trajectory(t[inside] - start)
        np.testing.assert_allclose(series["play_q"][inside], there, atol=1e-9)
        start += period
    assert t[-1] == pytest.approx(start)
    plain, arrays = as_saved(result, series)
    assert player(record_of(plain), arrays) is not None


def test_the_condition_number_is_that_of_the_link_in_its_own_row(puma: LinkByLinkDesign) -> None:
    model, data = puma.robot.model, puma.robot.model.createData()
    for joint, design in puma.motions.items():
        path = design.trajectory
        t = np.linspace(0, path.period, 1001)
        states = zip(*(path(t, order) for order in range(3)), strict=True)
        rows = [pin.computeJointTorqueRegressor(model, data, *state)[joint] for state in states]
        own = np.array(rows)[:, 10 * joint : 10 * joint + 10]
        chosen = [c - 10 * joint for c in design.base.columns]
        s = np.linalg.svd(own[:, chosen], compute_uv=False)
        assert design.condition_final == pytest.approx(s[0] / s[-1], rel=1e-6)
        # the other parameters of the link add nothing: these are all that the row can show
        scaled = own / np.maximum(np.linalg.norm(own, axis=0), 1e-12)
        assert np.linalg.matrix_rank(scaled, tol=1e-7 * np.sqrt(len(t))) == len(chosen)
        if len(chosen) > 1:
            assert design.condition_final < design.condition_initial


@pytest.mark.slow
def test_command_writes_a_file_per_link(tmp_path: Path, planar: Robot, excitant: Any) -> None:
    words = "design planar_2r --link-by-link --duration 4 --starts 1 --harmonics 3"
    ran = excitant(f"{words} --columns inertial --jobs 1 --json -o", tmp_path)
    assert (ran.status, ran.err) == (0, "")
    stages = ran.result["link_by_link"]["stages"]
    found = [(stage["file"], len(stage["moves"])) for stage in stages]
    assert found == [("link2.csv", 2), ("link1.csv", 1)]
    assert ran.result["duration"] == sum(stage["duration"] for stage in stages) == 8.0
    worst = max(stage["condition_number"]["final"] for stage in stages)
    assert ran.result["condition_number"]["final"] == worst
    for quantity, ratio in ran.result["limits"].items():
        assert ratio == max(stage["limits"][quantity] for stage in stages) <= 1
    for stem in ("link2", "link1"):
        exact = load_trajectory(tmp_path / f"{stem}.json", planar)
        sampled = load_trajectory(tmp_path / f"{stem}.csv", planar)
        assert sampled.q == pytest.approx(exact(sampled.t), abs=1e-6)
    assert "One motion per link" in (tmp_path / "report.html").read_text(encoding="utf-8")
