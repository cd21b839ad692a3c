"""Figures as axes: what they draw is what the noun holds, and nothing of Matplotlib is changed."""

from collections.abc import Callable, Iterator

import matplotlib as mpl
import numpy as np
import pytest
from marks import refused
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection

import excitant as ex
from excitant.design import design_trajectory
from excitant.exceptions import BadInput, UnknownName
from excitant.identify import Estimate, Recording, identify_robot
from excitant.identify.friction import friction_curves
from excitant.reports.figures.estimate import forest_groups
from excitant.results import record_of
from excitant.robots import Robot


@pytest.fixture(scope="module")
def recordings(planar: Robot, runs: Callable[..., list[Recording]]) -> list[Recording]:
    return runs(planar, 3)


@pytest.fixture(scope="module")
def estimate(planar: Robot, recordings: list[Recording]) -> Estimate:
    return identify_robot(planar, recordings[0], validate=recordings[1])


@pytest.fixture(autouse=True)
def clean() -> Iterator[None]:
    """One new figure at most, and Matplotlib as it was."""
    plt.close("all")
    before = dict(mpl.rcParams)
    yield
    assert dict(mpl.rcParams) == before
    plt.close("all")


def lines(ax: Axes) -> dict[str, np.ndarray]:
    return {str(line.get_color()): np.asarray(line.get_ydata()) for line in ax.get_lines()}


def cloud_of(ax: Axes) -> np.ndarray:
    (points,) = [each for each in ax.collections if isinstance(each, PathCollection)]
    return np.asarray(points.get_offsets())


def titles(axes: list[Axes]) -> list[str]:
    return [ax.texts[0].get_text() for ax in axes if ax.texts]


def test_all_panels_are_axes_of_one_figure_beside_each_other(estimate: Estimate) -> None:
    for plot, each in ((ex.plot.torque, 2), (ex.plot.friction, 1), (ex.plot.residuals, 4)):
        plt.close("all")
        axes = plot(estimate)
        assert len(axes) == 2 * each
        (figure,) = {ax.figure for ax in axes}
        assert plt.get_fignums() == [figure.number]
        assert titles(axes) == ["joint1", "joint2"]
        boxes = [ax.get_tightbbox() for ax in axes]
        width, height = figure.bbox.size
        for k, box in enumerate(boxes):
            assert min(box.x0, box.y0, width - box.x1, height - box.y1) > -1
            assert not any(box.overlaps(other) for other in boxes[each:] if k < each), (plot, k)


def test_torque_is_measured_and_predicted_and_the_rest_below(estimate: Estimate) -> None:
    torque, residual = ex.plot.torque(estimate, "joint2")
    measured, predicted = estimate.holdout.measured[:, 1], estimate.predicted[:, 1]
    drawn, left = lines(torque), lines(residual)
    for found, true in (
        (drawn["#4d4d4d"], measured),
        (drawn["#0072b2"], predicted),
        (left["#0072b2"], measured - predicted),
        (left["#d55e00"], measured - estimate.predicted_given[:, 1]),
    ):
        assert (found.min(), found.max()) == pytest.approx((true.min(), true.max()))


def test_friction_is_the_curve_its_band_and_the_readings(estimate: Estimate) -> None:
    (ax,) = ex.plot.friction(estimate, ["joint2"])
    curve = friction_curves(estimate)[1]
    drawn = np.concatenate([line.get_ydata() for line in ax.get_lines() if line.get_lw() == 1.8])
    np.testing.assert_allclose(drawn, curve.torque)
    points = cloud_of(ax)
    model = np.interp(points[:, 0], curve.velocity, curve.torque)
    left = estimate.holdout.counted(estimate.holdout.measured - estimate.predicted)[1]
    assert (points[:, 1] - model).std() == pytest.approx(left.std(), rel=0.1)
    bands = [each for each in ax.collections if not isinstance(each, PathCollection)]
    edges = np.concatenate([band.get_paths()[0].vertices[:, 1] for band in bands])
    assert edges.max() == pytest.approx((curve.torque + curve.half_width).max())


def test_parameters_are_values_with_intervals_beside_the_given_ones(estimate: Estimate) -> None:
    rows = {row["name"]: row for row in estimate.result()["parameters"]}
    (ax,) = ex.plot.parameters(estimate, "Fv")
    assert [text.get_text() for text in ax.get_yticklabels()] == ["joint1", "joint2"]
    zero, interval, *drawn = [np.asarray(line.get_xdata(), float) for line in ax.get_lines()]
    assert zero.tolist() == [0, 0]
    both = [rows[f"{joint}.Fv"] for joint in ("joint1", "joint2")]
    value, std, given = (np.array([row[key] for row in both]) for key in ("value", "std", "given"))
    assert [row["decided_by"] for row in both] == ["data"] * 2
    for shown, known in zip(drawn, (given, value, []), strict=True):  # none is the prior's
        assert shown == pytest.approx(known)
    intervals = interval.reshape(-1, 3)[:, :2]
    assert intervals == pytest.approx(value[:, None] + 1.96 * std[:, None] * np.array([-1, 1]))
    assert len(ex.plot.parameters(estimate, "link2")) == 3  # mass, first moment, inertia
    groups = forest_groups(record_of(estimate.result()).parameters)
    assert len(ex.plot.parameters(estimate)) == len(groups) == 7


def test_axes_of_ones_own_take_one_drawing_in_their_own_style(estimate: Estimate) -> None:
    figure, (first, second) = plt.subplots(1, 2)
    assert ex.plot.friction(estimate, "joint1", ax=first) == [first]
    assert ex.plot.parameters(estimate, ["joint1.Fc", "joint2.Fc"], ax=second) == [second]
    assert (first.get_title(), first.spines["top"].get_visible()) == ("joint1", True)
    assert second.get_legend().get_texts()[0].get_text() == "given"
    assert plt.get_fignums() == [figure.number]
    third = plt.figure().gca()
    for many in (ex.plot.friction, ex.plot.parameters):
        refused("ax holds one drawing, but these are", many, estimate, ax=third, error=BadInput)
    assert not third.has_data()


def test_motions_are_drawn_against_limits(planar: Robot) -> None:
    trajectory = ex.random_trajectory(planar, np.random.default_rng(0), 6.0, 3)
    for axes in (ex.plot.motion(trajectory, planar), ex.plot.motion(trajectory.sample(500))):
        assert len(axes) == 6
        for order, ax in enumerate(axes[3:]):
            drawn = max((np.asarray(line.get_ydata()) for line in ax.get_lines()), key=len)
            assert drawn.max() == pytest.approx(trajectory.extrema(order)[1][1], rel=1e-3)
    limited, free = ex.plot.motion(trajectory, planar)[1], ex.plot.motion(trajectory)[1]
    assert "of limit" in limited.get_title("right")
    assert free.get_title("right") == "no limit"
    design = design_trajectory(planar, duration=6.0, harmonics=3, starts=1, jobs=1, time_limit=0.0)
    assert len(ex.plot.motion(design, joints=["joint2"])) == 4  # torque too


def test_unknown_names_and_nothing_to_draw_are_refused(estimate, planar, recordings):
    with pytest.raises(UnknownName, match="unknown joint 'joint3': did you mean 'joint"):
        ex.plot.residuals(estimate, "joint3")
    refused("unknown parameter 'mass'", ex.plot.parameters, estimate, "mass", error=UnknownName)
    bare = identify_robot(planar, recordings[0], effects=())
    refused("nothing to draw", ex.plot.friction, bare, error=BadInput)


def test_joints_come_in_the_order_in_which_they_are_named(estimate: Estimate) -> None:
    axes = ex.plot.friction(estimate, ["joint2", "joint1"])
    assert titles(axes) == ["joint2", "joint1"]
    extents = [cloud_of(ax)[:, 0].max() for ax in axes]
    tops = [np.nanmax(column) for column in estimate.series()["velocity"].T[::-1]]
    assert extents == pytest.approx(tops, rel=0.05)
