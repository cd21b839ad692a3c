"""Designs improve, keep every limit, report what least squares finds, and heed what is asked."""

import json
import os
import signal
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from distributed import LocalCluster
from limit_use import assert_holds_for_every_mass, assert_limits_hold, limited
from marks import refused, slow
from threadpoolctl import threadpool_limits

from excitant.design import Design, check, design_trajectory, random_trajectory
from excitant.design.criterion import condition_number, information
from excitant.design.sequence import design_link_by_link
from excitant.exceptions import BadInput, UnknownName
from excitant.robots import Robot, load_robot
from excitant.robots.effects import standard_effects
from excitant.robots.torque import observation_columns


@pytest.fixture(scope="module")
def arm() -> Robot:
    """The first four joints of six."""
    first = load_robot("ur10", lock={"wrist_2_joint": 0.3, "wrist_3_joint": 0.0})
    return limited(first, position=[-np.pi, np.pi], acceleration=10.0)


@pytest.fixture(scope="module", params=[slow("ample"), "scarce"])
def found(arm: Robot, ur10: Robot, request: pytest.FixtureRequest) -> Design:
    """Of six joints with ample torque, and of four with so little that it binds."""
    robot, n = limited(arm, torque=0.25 * arm.limits.torque), 2
    if request.param == "ample":
        robot, n = limited(ur10, position=[-np.pi, np.pi], acceleration=10.0), 4
    options: dict[str, Any] = {"columns": "inertial", "harmonics": n, "periods": 1}
    return design_trajectory(robot, **options, starts=n // 2, jobs=1, seed=3)


def test_improves_on_random_and_holds_every_limit(arm: Robot, found: Design) -> None:
    assert found.condition_final < found.condition_initial / 5
    assert_limits_hold(found)
    weak = found.robot.nv == arm.nv
    assert (found.limits.torque if weak else found.limits.worst).ratio > 0.999 * found.use


@pytest.fixture(scope="module")
def weighted(planar: Robot) -> Design:
    return design_trajectory(planar, harmonics=3, periods=1, starts=2, jobs=1, noise=[1.0, 4.0])


def test_result_and_series(weighted: Design) -> None:
    found, result, starts = weighted, weighted.result(), weighted.result()["starts"]
    assert json.loads(json.dumps(result, allow_nan=False)) == result
    assert result["verb"] == "design"
    assert result["condition_number"]["final"] == found.condition_final
    assert result["iterations"] == sum(start["iterations"] for start in starts)
    assert [start["status"] for start in starts] == ["converged"] * 2
    for name, use in result["worst"].items():
        assert use["joint"] in result["joints"]
        assert use["ratio"] == result["limits"][name] <= 1.0
    series = found.series()
    assert len(series["t"]) >= 1000
    share = np.abs(series["tau"]) / found.robot.limits.torque
    assert share.max() == pytest.approx(found.limits.torque.ratio, rel=1e-3)


@pytest.mark.parametrize("criterion", ["d", slow("a"), slow("e")])
def test_every_criterion_improves_its_own_value(planar: Robot, criterion: str) -> None:
    options: dict[str, Any] = {"harmonics": 3, "periods": 1, "starts": 1, "jobs": 1}
    result = design_trajectory(planar, criterion=criterion, seed=3, **options)
    before, after = (np.linalg.eigvalsh(M) for M in (result.before, result.after))
    gain = {
        "d": np.log(after).sum() - np.log(before).sum(),
        "a": np.log((1 / before).sum()) - np.log((1 / after).sum()),
        "e": np.log(after[0] / before[0]),
    }
    assert gain[criterion] > 0.5
    assert_limits_hold(result)


@pytest.mark.slow
def test_numbers_of_processes_and_threads_do_not_change_a_digit(planar: Robot) -> None:
    found = []
    options: dict[str, Any] = {"duration": 5.0, "harmonics": 2, "starts": 3}
    for jobs, threads in ((1, 1), (2, 2), (1, 2)):
        with threadpool_limits(threads):
            found.append(design_trajectory(planar, jobs=jobs, **options, seed=2))
    one, *others = found
    for other in others:
        np.testing.assert_array_equal(one.trajectory.coefficients, other.trajectory.coefficients)
        assert one.condition_final == other.condition_final
        assert [s.history for s in one.starts] == [s.history for s in other.starts]
    assert not any("machine" in note for note in one.result()["notes"])
    other = design_trajectory(planar, **options | {"starts": 1}, jobs=1, seed=3)
    assert not np.array_equal(one.trajectory.coefficients, other.trajectory.coefficients)


@pytest.mark.parametrize(
    ("limit", "options"),
    [(1.0, {}), (1.0, {"starts": 500}), (0.0, {"starts": 1, "columns": "inertial"})],
)
def test_time_limit_returns_the_best_so_far(arm: Robot, limit: float, options: Any) -> None:
    began = time.time()
    result = design_trajectory(arm, jobs=1, time_limit=limit, scene=(), **options)
    assert time.time() - began < 5.0
    assert_limits_hold(result)
    gain = result.condition_initial / result.condition_final
    assert gain > 1 if limit else gain == pytest.approx(1, rel=1e-9)
    assert result.starts[-1].status == "time limit"
    assert any("depends on the machine" in note for note in result.result()["notes"])


def test_after_the_time_limit_no_more_than_three_starts_are_drawn(planar: Robot) -> None:
    """In a scene of thousands of pairs, one takes seconds."""
    result = design_trajectory(planar, jobs=1, time_limit=0.0, starts=8)
    assert [bool(start.history) for start in result.starts][:3] == [True] * 3
    assert not any(start.history for start in result.starts[3:])


def test_interrupt_returns_the_best_so_far(planar: Robot) -> None:
    def stop(done: int, total: int | None, condition: float, worst: float) -> None:
        os.kill(os.getpid(), signal.SIGINT)

    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell may have made it deaf
    result = design_trajectory(planar, columns="inertial", starts=20, jobs=1, progress=stop)
    assert_limits_hold(result)
    assert result.condition_final < result.condition_initial
    assert {start.status for start in result.starts} == {"interrupted"}


@pytest.mark.slow
def test_progress_tells_what_is_reached(planar: Robot) -> None:
    told: list[tuple[int, int | None, float, float]] = []
    options = {"harmonics": 3, "periods": 1, "starts": 2, "jobs": 1}
    result = design_trajectory(planar, progress=lambda *news: told.append(news), **options)
    done, total, conditions, worst = zip(*told, strict=True)
    assert done[-1] <= total[-1] == 2
    assert [*conditions] == sorted(conditions, reverse=True)
    assert conditions[-1] == pytest.approx(result.condition_final, rel=0.1)
    assert worst[-1] == pytest.approx(result.limits.worst.ratio, rel=1e-3)


@pytest.mark.parametrize(
    ("option", "value", "why"),
    [
        ("harmonics", 1, "at least 2"),
        ("duration", -1.0, "duration"),
        ("periods", 0, "at least one"),
        ("starts", 0, "at least one"),
        ("criterion", "best", "criterion"),
        ("columns", "frictions", "did you mean 'friction'"),
    ],
)
@pytest.mark.parametrize("design", [design_trajectory, design_link_by_link])
def test_refuses_impossible_options(planar, design, option, value, why):
    refused(why, design, planar, **{option: value}, error=(BadInput, UnknownName))


@pytest.mark.slow
def test_a_design_keeps_a_limit_on_jerk(planar: Robot) -> None:
    robot = limited(planar, acceleration=8.0, jerk=15.0)
    options: Any = {"duration": 6.0, "harmonics": 5, "starts": 1, "jobs": 1, "use": 1.0}
    found = design_trajectory(robot, **options)
    assert found.condition_final < 0.5 * found.condition_initial
    assert_limits_hold(found)
    assert np.abs(found.trajectory(np.linspace(0, 6, 20_001), 3)).max() <= 15.0 * (1 + 1e-9)
    assert found.limits.jerk.ratio > 0.9


def test_what_parameters_are_seen_is_that_of_weighted_least_squares(weighted: Design) -> None:
    result, motion = weighted.result(), weighted.trajectory.sample(1001)
    Y = observation_columns(weighted.robot, standard_effects(weighted.robot.joints), motion)
    W = (Y[:, :, weighted.base.columns] * [[2.0], [0.5]]).reshape(-1, len(weighted.base))
    std = np.sqrt(np.diag(np.linalg.inv(W.T @ W)))
    names = [weighted.base.names[k] for k in weighted.base.columns]
    order = np.argsort(-std, kind="stable")[:10]
    assert [row["name"] for row in result["weakest"]] == [names[k] for k in order]
    for k, row in zip(order, result["weakest"], strict=True):
        assert row["std_per_unit_noise_final"] == pytest.approx(std[k], rel=1e-6)
        assert row["expression"] == weighted.base.expressions[k]
    assert result["condition_number"]["final"] == pytest.approx(np.linalg.cond(W), rel=1e-8)
    scaled = np.linalg.cond(W / np.linalg.norm(W, axis=0))
    assert result["condition_number_scaled"]["final"] == pytest.approx(scaled, rel=1e-6)
    assert result["joint_weights"] == pytest.approx([2.0, 0.5])
    sizes = np.linalg.svd(W / np.sqrt(len(motion)), compute_uv=False)
    np.testing.assert_allclose(np.linalg.eigvalsh(weighted.after), sizes[::-1] ** 2, rtol=1e-6)


@pytest.mark.slow
def test_a_cluster_finds_what_processes_find(planar: Robot) -> None:
    options = {"duration": 5.0, "harmonics": 3, "starts": 2, "seed": 2}
    loopback = {"host": "127.0.0.1", "dashboard_address": None}
    here = design_trajectory(planar, jobs=1, **options)
    with LocalCluster(n_workers=2, threads_per_worker=1, **loopback) as cluster:
        there = design_trajectory(planar, cluster=cluster.scheduler_address, **options)
    np.testing.assert_array_equal(here.trajectory.coefficients, there.trajectory.coefficients)


def test_no_cluster_is_one_line(planar: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("excitant.processes.CLUSTER_TIMEOUT", "1s")
    with pytest.raises(BadInput, match=r"cluster tcp://127\.0\.0\.1:9: no Dask scheduler"):
        design_trajectory(planar, cluster="tcp://127.0.0.1:9", starts=1)


def test_noise_weights_equations(planar: Robot) -> None:
    noise = np.array([0.1, 5.0])
    motion = random_trajectory(planar, np.random.default_rng(0), 5.0, 4).sample(200)
    plain, weighted = information(planar), information(planar, noise=noise)
    W = plain.observation(motion) / noise[:, None]
    M = weighted.matrix(motion)
    expected = np.einsum("nja,njb->ab", W, W) / len(motion) * (0.1 * 5.0)
    np.testing.assert_allclose(M, expected, rtol=1e-9, atol=1e-12)
    exact = weighted.linearise(motion)
    np.testing.assert_allclose(exact.Y, weighted.observation(motion, smooth=True), atol=1e-12)
    refused("one positive number", information, planar, noise=[1.0], error=BadInput)


@pytest.mark.slow
def test_what_next_makes_up_for_what_a_recording_lacks(planar: Robot) -> None:
    """After a motion of joint 2 alone, a design that knows of it does better in the sum."""
    once = random_trajectory(planar, np.random.default_rng(1), 5.0, 4).sample(500)
    alone = replace(once, **{name: getattr(once, name) * [0, 1] for name in ("q", "dq", "ddq")})
    options = {"duration": 5.0, "harmonics": 3, "columns": "inertial", "starts": 4, "jobs": 1}
    knowing = design_trajectory(planar, after=[alone] * 10, **options)
    unknowing = design_trajectory(planar, **options)
    both = information(planar, "inertial", earlier=[alone] * 10, duration=5.0)
    values = [condition_number(both.matrix(x.trajectory.sample(500))) for x in (knowing, unknowing)]
    assert knowing.condition_final == pytest.approx(values[0], rel=0.02)
    assert values[0] < 0.99 * values[1]


@pytest.mark.slow
def test_harmonics_are_added_while_they_pay(planar: Robot) -> None:
    tight = limited(planar, position=[[-0.5, 0.5], [-0.4, 0.4]])
    options = {"duration": 6.0, "periods": 1, "columns": "inertial", "starts": 4, "jobs": 1}
    few = design_trajectory(tight, harmonics=5, **options)
    search = options | {"harmonics": "search"}
    searched = design_trajectory(tight, max_frequency=2.5, **search)
    best = design_trajectory(tight, **search | {"periods": "search"})
    assert best.trajectory.periods * best.trajectory.period == best.duration == 6.0
    for more in (searched, best):
        assert (more.limits.hold, more.trajectory.at_rest) == (True, True)
        assert more.condition_final < 0.9 * few.condition_final
    assert 5 < searched.harmonics <= 15


@pytest.mark.slow
@pytest.mark.parametrize(("duration", "columns"), [(12.0, "inertial"), (8.0, "friction")])
def test_a_motion_has_as_many_periods_as_excite_best(planar: Robot, duration: float, columns: str):
    options = {"duration": duration, "harmonics": 3, "columns": columns, "starts": 3, "jobs": 1}
    found = design_trajectory(planar, **options)
    one_by_one = {k: design_trajectory(planar, periods=k, **options) for k in (1, 2, 3, 4, 6)}
    least, best = min((design.condition_final, k) for k, design in one_by_one.items())
    assert (best > 1) == (columns == "inertial")
    assert found.condition_final <= 1.1 * least
    assert found.duration == duration == found.trajectory.motion(100.0).t[-1]
    assert found.trajectory.series.periods * found.trajectory.period == duration
    assert found.limits.hold


@pytest.mark.slow
def test_torque_holds_for_every_mass_within_the_uncertainty(ur10: Robot) -> None:
    nominal = limited(ur10, acceleration=10.0, torque=0.45 * ur10.limits.torque)
    wary = limited(nominal, mass_uncertainty=0.2)
    options = {"periods": 1, "harmonics": 3, "starts": 1, "jobs": 1, "seed": 1}
    found = design_trajectory(wary, columns="inertial", scene=(), **options)
    assert 0.98 < found.limits.torque.ratio / found.use <= 1.0
    assert_holds_for_every_mass(nominal, found.trajectory.motion(400.0), 0.2)
    assert check(nominal, found.trajectory).torque.ratio < 0.95
