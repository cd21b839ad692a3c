"""The page of a design: what the motion does, and what it shows worst."""

from itertools import product

import numpy as np
import pytest
from limit_use import limited

from excitant.design import design_trajectory
from excitant.reports import brief, page_of, summary
from excitant.reports.figures.motion import Limits as Drawn
from excitant.reports.figures.motion import motion_figure
from excitant.reports.run import as_saved
from excitant.results import record_of
from excitant.robots import load_robot


@pytest.fixture(scope="module")
def saved():
    """A design without any limit on torque."""
    robot = limited(load_robot("planar_2r"), torque=np.inf)
    found = design_trajectory(robot, harmonics=3, starts=1, jobs=1, criterion="d")
    return found, *as_saved(found.result(), found.series())


def test_every_part_is_there_with_its_figure(written):
    page = written("design")
    parts = ["The arm in motion", "Motion against limits", "Excitation of the parameters"]
    assert page.headings[1:6] == [*parts, "Least excited parameters", "The search"]
    for word in ("velocity", "torque", "singular values"):
        assert word in " ".join(page.labels)
    for own in ("velocity [rad/s]", "velocity [m/s]", "jerk [rad/s³]", "jerk [m/s³]"):
        assert f">{own}<" in page.source


def test_worst_parameters_are_named(make, written):
    result, _ = make["design"]()
    page, said = page_of(result, {}), written("design").words
    for row in result["weakest"]:
        assert row["expression"] in said
        assert row["expression"].replace("−", "-") in summary(page)
    assert result["weakest"][0]["name"] in brief(page)
    assert all("6.21" in text for text in (said, summary(page)))


@pytest.mark.slow
def test_curves_touch_the_certified_envelope_and_stay_inside(saved):
    found, result, series = saved
    certified = record_of(result).certified
    kinds = (("q", "position"), ("dq", "velocity"), ("ddq", "acceleration"))
    for (order, (key, quantity)), k in product(enumerate(kinds), range(2)):
        limit, curve = np.asarray(result["limit_values"][quantity][k], float), series[key][:, k]
        row = certified[quantity][k]
        least, most, size = row.low, row.high, row.high - row.low
        assert least - 1e-9 * size <= curve.min() <= least + 1e-3 * size
        assert most - 1e-3 * size <= curve.max() <= most + 1e-9 * size
        low, high = limit if quantity == "position" else (-limit, limit)
        assert low <= least < most <= high
        there = found.trajectory(row.t, order)[0, k]
        assert min(abs(there - least), abs(there - most)) <= 1e-6 * size


def test_page_of_a_design_without_a_limit_on_torque_or_a_scene(saved, show):
    _, result, series = saved
    page = show(result, series)
    assert result["certified"]["torque"] == [None, None]
    assert any("torque no limit" in label for label in page.labels)
    assert "greatest determinant" in page.words
    assert len(page.source.encode()) < 1_000_000
    assert (result["obstacles"], result["closest"]) == ([], None)
    assert "obstacle" not in " ".join(page.labels)


def test_unlimited_joints_have_no_lines_and_twelve_fit_on_a_small_page(make, show):
    result, series = make["design"]()
    figure = motion_figure(result["joints"], Drawn(None), series)
    assert figure.legend == ()
    assert "no limits" in figure.caption
    assert all("velocity no limit" in panel.label for panel in figure.panels)
    names = [f"{side}_{k}" for side in ("left", "right") for k in range(1, 7)]
    wide = {key: np.tile(series[key][::4], 3) for key in ("q", "dq", "ddq", "tau")}
    wide["t"] = series["t"][::4]
    entries = {"joints": names, "certified": None, "limit_values": None, "revolute": [True] * 12}
    page = show(result | entries, series | wide)
    assert sum("over time" in label for label in page.labels) == 12
    assert len(page.source.encode()) < 1_000_000
