"""What is played is the motion that was checked, with every instant that a check names."""

import numpy as np
import pytest

from excitant.design import HermiteTrajectory, random_trajectory
from excitant.design.constraints import shares_of_limits
from excitant.design.playback import Playback
from excitant.robots import Motion, load_robot
from excitant.robots.geometry import floor, scene

QUANTITIES = ("position", "velocity", "acceleration", "torque")


@pytest.fixture(scope="module", params=["planar_2r", "scara", "ur10"])
def played(request: pytest.FixtureRequest) -> Playback:
    robot = load_robot(request.param)
    path = random_trajectory(robot, np.random.default_rng(1), 6.0, 3)
    cell = scene(robot, (floor(-0.4),))
    strict = robot.with_limits(robot.limits.used(0.15))  # some limits are exceeded
    return Playback(strict, path, cell)


def test_frames_hold_every_instant_at_which_a_limit_is_touched(played: Playback) -> None:
    series, touched = played.series(), 0
    for k, name in enumerate(QUANTITIES):
        use = getattr(played.limits, name)
        for j in np.flatnonzero(use.ratios >= 0.99):
            [frame] = np.flatnonzero(series["play_t"] == use.times[j])
            assert series["play_shares"][frame, k, j] == use.ratios[j]
            touched += 1
        assert (series["play_shares"][:, k] <= use.ratios * (1 + 1e-6)).all()
    assert touched >= 2
    assert np.diff(series["play_t"]).max() <= 0.021


def test_shares_are_those_of_the_check(played: Playback) -> None:
    dense = played.path.at(np.linspace(0, played.path.period, 20001))
    most = shares_of_limits(played.robot, dense).max(axis=0)
    for k, name in enumerate(QUANTITIES):
        np.testing.assert_allclose(most[k], getattr(played.limits, name).ratios, rtol=2e-3)


def test_nearest_bodies_are_as_far_apart_as_their_points(played: Playback) -> None:
    series, cell = played.series(), played.scene
    if cell is None:
        assert not {"play_pair", "play_points"} & set(series)
        return
    distances, pair = cell.distances(played.frames.q), series["play_pair"].astype(int)
    least = distances.min(axis=1)
    np.testing.assert_allclose(distances[np.arange(len(pair)), pair], least)
    np.testing.assert_allclose(series["play_distance"] * cell.scale[pair], least)
    apart = np.linalg.norm(np.diff(series["play_points"], axis=1)[:, 0], axis=1)
    np.testing.assert_allclose(apart, np.abs(series["play_distance"]), atol=1e-5)
    assert played.clearance.time in series["play_t"]
    assert played.result()["bodies"][pair[apart.argmin()]] in [list(x) for x in cell.pairs]


def test_a_long_recording_is_played_from_end_to_end_within_bounds() -> None:
    robot, t = load_robot("planar_2r"), 3.0 + np.arange(2_101) / 20
    q = np.stack([np.sin(t), np.cos(2 * t)], axis=1)
    dq = np.gradient(q, t, axis=0)
    motion = Motion(t, q, dq, np.gradient(dq, t, axis=0))
    found = Playback(robot, HermiteTrajectory(motion), None)
    assert found.frames.t[[0, -1]].tolist() == t[[0, -1]].tolist()
    assert 4990 < len(found.frames) < 5010
