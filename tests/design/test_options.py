"""What a design can be asked for beyond the limits: where, with what, after what."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from distributed import LocalCluster
from limit_use import assert_holds_for_every_mass

from excitant.design import (
    check,
    condition_number,
    design_trajectory,
    information,
    random_trajectory,
)
from excitant.exceptions import BadInput
from excitant.robots import Robot
from excitant.robots.geometry import load_obstacles, scene

Limited = Callable[..., Robot]


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """A scheduler and two workers on the loopback."""
    with LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
    ) as started:
        yield started.scheduler_address


@pytest.mark.slow
def test_a_cluster_finds_what_processes_find(planar: Robot, cluster: str) -> None:
    options = {"duration": 5.0, "harmonics": 3, "starts": 2, "seed": 2}
    here = design_trajectory(planar, jobs=1, **options)  # type: ignore[arg-type]
    there = design_trajectory(planar, cluster=cluster, **options)  # type: ignore[arg-type]
    np.testing.assert_array_equal(here.trajectory.coefficients, there.trajectory.coefficients)


def test_no_cluster_is_one_line(planar: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("excitant.design.search._PATIENCE", "1s")
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
    with pytest.raises(BadInput, match="one positive number"):
        information(planar, noise=[1.0])


def test_what_next_makes_up_for_what_a_recording_lacks(planar: Robot) -> None:
    """After a motion of joint 2 alone, a design that knows of it does better in the sum."""
    rng = np.random.default_rng(1)
    once = random_trajectory(planar, rng, 5.0, 4).sample(500)
    still = np.zeros(500)
    alone = replace(
        once, q=once.q * [0, 1], dq=np.column_stack([still, once.dq[:, 1]]), ddq=once.ddq * [0, 1]
    )
    options = {"duration": 5.0, "harmonics": 3, "columns": "inertial", "starts": 4, "jobs": 1}
    knowing = design_trajectory(planar, earlier=[alone] * 10, **options)  # type: ignore[arg-type]
    unknowing = design_trajectory(planar, **options)  # type: ignore[arg-type]
    both = information(planar, "inertial", earlier=[alone] * 10, duration=5.0)
    values = [condition_number(both.matrix(x.trajectory.sample(500))) for x in (knowing, unknowing)]
    assert knowing.condition_final == pytest.approx(values[0], rel=0.02)
    assert values[0] < 0.99 * values[1]


@pytest.mark.slow
def test_harmonics_are_added_while_they_pay(planar: Robot, limited: Limited) -> None:
    tight = limited(planar, position=[[-0.5, 0.5], [-0.4, 0.4]])
    options = {"duration": 6.0, "columns": "inertial", "starts": 4, "jobs": 1}
    few = design_trajectory(tight, harmonics=5, **options)  # type: ignore[arg-type]
    for series in ("fourier", "spline"):
        more = design_trajectory(tight, harmonics=None, series=series, top_hz=2.5, **options)  # type: ignore[arg-type]
        assert more.limits.hold
        assert more.trajectory.at_rest
        assert 5 < more.harmonics <= 15
        assert more.trajectory.series.name == series
        assert more.condition_final < 0.9 * few.condition_final


@pytest.mark.slow
def test_the_period_is_chosen_between_two(planar: Robot) -> None:
    options = {"harmonics": 3, "columns": "inertial", "starts": 4, "jobs": 1}
    found = design_trajectory(planar, duration=(1.0, 10.0), **options)  # type: ignore[arg-type]
    ends = [design_trajectory(planar, duration=T, **options) for T in (1.0, 10.0)]  # type: ignore[arg-type]
    assert 1.0 <= found.duration <= 10.0
    assert found.condition_final <= 1.05 * min(end.condition_final for end in ends)


def test_torque_holds_for_every_mass_within_the_uncertainty(ur10: Robot, limited: Limited) -> None:
    nominal = limited(ur10, acceleration=10.0, torque=0.45 * ur10.limits.torque)
    wary = nominal.with_limits(replace(nominal.limits, mass_uncertainty=0.2))
    found = design_trajectory(wary, harmonics=3, columns="inertial", starts=1, jobs=1, seed=1)
    assert 0.98 < found.limits.torque.ratio <= 1.0
    assert_holds_for_every_mass(nominal, found.trajectory.motion(400.0), 0.2)
    assert check(nominal, found.trajectory).torque.ratio < 0.95


def test_the_tool_stays_in_its_workspace(ur10: Robot, tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text("- workspace: {low: [-1.3, -0.6, 0.1], high: [1.3, 0.9, 1.6]}\n")
    surroundings = scene(ur10, load_obstacles(path))
    assert surroundings is not None
    found = design_trajectory(
        ur10, harmonics=3, columns="inertial", scene=surroundings, clearance=0.0, starts=1, jobs=1
    )
    model, data = ur10.model, ur10.model.createData()
    points = []
    for q in found.trajectory.sample(1001).q:
        pin.framesForwardKinematics(model, data, q)
        points.append(data.oMf[ur10.tip].translation.copy())
    inside = np.array(points)
    assert np.all(inside >= [-1.3, -0.6, 0.1])
    assert np.all(inside <= [1.3, 0.9, 1.6])
    path.write_text("- workspace: {low: [0, 0, 1], high: [1, 1, 0]}\n")
    with pytest.raises(BadInput, match=r"obstacles\[0\]\.workspace: low must be below high"):
        load_obstacles(path)
