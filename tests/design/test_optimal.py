from __future__ import annotations

import json
import os
import signal
import threading
import time
from collections.abc import Callable

import numpy as np
import pytest
from limit_use import assert_limits_hold

from excitant.design import Design, design_link_by_link, design_trajectory
from excitant.exceptions import BadInput, UnknownName
from excitant.robots import Robot

Limited = Callable[..., Robot]


@pytest.fixture(scope="module")
def arm(ur10: Robot, limited: Limited) -> Robot:
    return limited(ur10, position=[-np.pi, np.pi], acceleration=10.0)


@pytest.fixture(scope="module")
def found(arm: Robot) -> Design:
    return design_trajectory(arm, columns="inertial", harmonics=4, starts=2, jobs=1, seed=3)


def test_improves_on_random_and_holds_every_limit(found: Design) -> None:
    assert found.condition_final < found.condition_initial / 5
    assert_limits_hold(found)
    assert found.limits.worst.ratio > 0.999


def test_figures_are_those_of_the_trajectory(found: Design) -> None:
    from excitant.robots import regressor

    motion = found.trajectory.motion(100.0)
    W = regressor(found.robot, motion)[:, :, list(found.base.columns)].reshape(-1, len(found.base))
    assert found.condition_final == pytest.approx(np.linalg.cond(W), rel=1e-7)
    eigenvalues = np.linalg.svd(W, compute_uv=False)[::-1] ** 2 / len(motion)
    np.testing.assert_allclose(np.linalg.eigvalsh(found.after), eigenvalues, rtol=1e-6)


def test_result_and_series(found: Design) -> None:
    result = found.result()
    assert json.loads(json.dumps(result, allow_nan=False)) == result
    assert result["verb"] == "design"
    assert result["condition_number"]["final"] == found.condition_final
    assert result["iterations"] == sum(start["iterations"] for start in result["starts"])
    assert [start["status"] for start in result["starts"]] == ["converged"] * 2
    for name, use in result["worst"].items():
        assert use["joint"] in result["joints"]
        assert use["ratio"] == result["limits"][name] <= 1.0
    series = found.series()
    assert len(series["t"]) >= 1000
    share = np.abs(series["tau"]) / found.robot.limits.torque
    assert share.max() == pytest.approx(found.limits.torque.ratio, rel=1e-3)


def test_torque_limits_bind_and_hold(arm: Robot, limited: Limited) -> None:
    weak = limited(arm, torque=arm.limits.torque * 0.25)
    result = design_trajectory(weak, columns="inertial", harmonics=4, starts=1, jobs=1, seed=1)
    assert_limits_hold(result)
    assert result.limits.torque.ratio > 0.999
    assert result.condition_final < result.condition_initial / 5


@pytest.mark.parametrize("criterion", ["d", "a", "e"])
def test_every_criterion_improves_its_own_value(planar: Robot, criterion: str) -> None:
    result = design_trajectory(planar, criterion=criterion, harmonics=3, starts=1, jobs=1)
    before, after = (np.linalg.eigvalsh(M) for M in (result.before, result.after))
    gain = {
        "d": np.log(after).sum() - np.log(before).sum(),
        "a": np.log((1 / before).sum()) - np.log((1 / after).sum()),
        "e": np.log(after[0] / before[0]),
    }
    assert gain[criterion] > 0.5
    assert_limits_hold(result)


def test_number_of_processes_does_not_change_the_result(planar: Robot) -> None:
    one, two = (
        design_trajectory(planar, duration=5.0, harmonics=2, starts=3, jobs=jobs, seed=2)
        for jobs in (1, 2)
    )
    np.testing.assert_array_equal(one.trajectory.coefficients, two.trajectory.coefficients)
    assert [s.history for s in one.starts] == [s.history for s in two.starts]
    other = design_trajectory(planar, duration=5.0, harmonics=2, starts=1, jobs=1, seed=3)
    assert not np.array_equal(one.trajectory.coefficients, other.trajectory.coefficients)


@pytest.mark.parametrize("starts", [None, 500])
def test_time_limit_returns_the_best_so_far(arm: Robot, starts: int | None) -> None:
    began = time.time()
    result = design_trajectory(arm, starts=starts, jobs=1, time_limit=1.0)
    assert time.time() - began < 5.0
    assert_limits_hold(result)
    assert result.condition_final < result.condition_initial
    assert result.starts[-1].status == "time limit"


def test_no_time_at_all_returns_the_first_trajectory(arm: Robot) -> None:
    result = design_trajectory(arm, columns="inertial", starts=1, jobs=1, time_limit=0.0)
    assert result.condition_final == pytest.approx(result.condition_initial, rel=1e-9)
    assert {start.status for start in result.starts} == {"time limit"}
    assert_limits_hold(result)


def test_interrupt_returns_the_best_so_far(arm: Robot) -> None:
    def stop(done: int, total: int | None, condition: float, worst: float) -> None:
        os.kill(os.getpid(), signal.SIGINT)

    assert threading.current_thread() is threading.main_thread()
    result = design_trajectory(arm, columns="inertial", starts=20, jobs=1, progress=stop)
    assert_limits_hold(result)
    assert result.condition_final < result.condition_initial
    assert {start.status for start in result.starts} == {"interrupted"}


def test_progress_tells_what_is_reached(planar: Robot) -> None:
    told: list[tuple[int, int | None, float, float]] = []
    result = design_trajectory(
        planar, harmonics=3, starts=4, jobs=1, progress=lambda *news: told.append(news)
    )
    assert told[-1][0] <= told[-1][1] == 4
    conditions = [news[2] for news in told]
    assert conditions == sorted(conditions, reverse=True)
    assert conditions[-1] == pytest.approx(result.condition_final, rel=0.1)
    assert told[-1][3] == pytest.approx(result.limits.worst.ratio, rel=1e-3)


@pytest.mark.parametrize(
    ("option", "value", "why"),
    [
        ("harmonics", 1, "at least 2"),
        ("duration", -1.0, "duration"),
        ("duration", (5.0, 1.0), "shorter one first"),
        ("starts", 0, "at least one"),
        ("criterion", "best", "criterion"),
        ("series", "chebyshev", "series"),
        ("columns", "frictions", "did you mean 'friction'"),
    ],
)
@pytest.mark.parametrize("design", [design_trajectory, design_link_by_link])
def test_refuses_impossible_options(
    planar: Robot, design: Callable[..., object], option: str, value: object, why: str
) -> None:
    with pytest.raises((BadInput, UnknownName), match=why):
        design(planar, **{option: value})


def test_a_spline_design_keeps_all_limits(planar: Robot, limited: Limited) -> None:
    robot = limited(planar, acceleration=8.0, jerk=15.0)
    found = design_trajectory(robot, duration=6.0, harmonics=5, series="spline", starts=2, jobs=1)
    assert found.trajectory.series.name == "spline"
    assert found.trajectory.at_rest
    assert found.limits.hold
    assert found.condition_final < 0.5 * found.condition_initial
    fine = np.linspace(0, 6, 20_001)
    for order, limit in ((1, robot.limits.velocity), (2, 8.0), (3, 15.0)):
        assert np.all(np.abs(found.trajectory(fine, order)) <= np.asarray(limit) * (1 + 1e-9))
    assert found.limits.jerk is not None
    assert found.limits.jerk.ratio > 0.9
