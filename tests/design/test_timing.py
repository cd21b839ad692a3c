from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from limit_use import assert_holds_for_every_mass, limit_shares

from excitant.design import HermiteTrajectory, check
from excitant.design.timing import (
    HOLDING,
    approach,
    rounded_path,
    static_torque,
    time_optimal,
    timed,
)
from excitant.exceptions import BadInput, Infeasible
from excitant.robots import Array, Motion, Robot, load_robot, torque

Limited = Callable[..., Robot]

RATE = 125.0


def one_joint(planar: Robot, limited: Limited, v: float, a: float) -> Robot:
    """Joint 1 with the given limits; nothing else binds."""
    return limited(
        planar, position=(-100.0, 100.0), velocity=(v, 50.0), acceleration=(a, 500.0), torque=np.inf
    )


def excess_between_samples(robot: Robot, motion: Motion, factor: int = 20) -> float:
    """Worst share of any limit that the motion takes at samples ``factor`` times as dense."""
    fine = np.linspace(motion.t[0], motion.t[-1], factor * (len(motion) - 1) + 1)
    dense = HermiteTrajectory(motion).at(fine)
    low, high = robot.limits.position.T
    assert np.maximum(low - dense.q, dense.q - high).max() <= 1e-9
    shares = limit_shares(robot, dense)
    return max(float(shares[name].max()) for name in ("velocity", "acceleration", "torque"))


def assert_rests(motion: Motion, start: Array, goal: Array) -> None:
    np.testing.assert_array_equal(motion.q[[0, -1]], [start, goal])
    np.testing.assert_array_equal(motion.dq[[0, -1]], 0.0)
    np.testing.assert_array_equal(motion.ddq[[0, -1]], 0.0)


def random_poses(robot: Robot, rng: np.random.Generator, n: int) -> list[Array]:
    """Poses inside the limits that are held with some torque left in both directions."""
    low, high = np.clip(robot.limits.position, -np.pi, np.pi).T
    poses: list[Array] = []
    while len(poses) < n:
        q = rng.uniform(low, high)
        up = static_torque(robot, q[None], np.ones((1, robot.nv)))
        down = static_torque(robot, q[None], -np.ones((1, robot.nv)))
        if np.all(np.maximum(np.abs(up), np.abs(down)) < 0.9 * HOLDING * robot.limits.torque):
            poses.append(q)
    return poses


@pytest.mark.parametrize(
    ("name", "share"), [("planar_2r", 0.4), ("ur10", 0.4), ("panda", 1.0), ("panda", 0.4)]
)
def test_limits_hold_between_the_samples_and_the_ends_rest(name: str, share: float) -> None:
    robot = load_robot(name)
    robot = robot.with_limits(replace(robot.limits, torque=share * robot.limits.torque))
    poses = random_poses(robot, np.random.default_rng(5), 4)
    for start, goal in itertools.pairwise(poses):
        motion = approach(robot, start, goal, rate_hz=RATE)
        assert_rests(motion, start, goal)
        np.testing.assert_allclose(np.diff(motion.t), 1 / RATE, rtol=1e-9)
        assert excess_between_samples(robot, motion) <= 1 + 1e-9
        report = check(robot, motion)
        assert all(use.ratio <= 1 for use in report.uses[1:])
        if (name, share) == ("ur10", 0.4):  # a fast motion uses some limit in full
            assert report.worst.ratio > 0.98


@pytest.mark.parametrize(("way", "v", "a"), [(6.0, 1.5, 2.0), (1.0, 9.0, 1.0), (-20.0, 3.0, 5.0)])
def test_one_joint_takes_the_time_of_the_trapezoid(
    planar: Robot, limited: Limited, way: float, v: float, a: float
) -> None:
    """Bang-bang with a speed limit: D/v + v/a, or 2 √(D/a) when the speed is never reached."""
    distance = abs(way)
    exact = distance / v + v / a if distance > v**2 / a else 2 * np.sqrt(distance / a)
    robot = one_joint(planar, limited, v, a)
    ends = np.array([0.0, 0.3]), np.array([way, 0.3])
    duration = approach(robot, *ends, rate_hz=1000.0).t[-1]
    assert exact <= duration <= 1.01 * exact
    profile = time_optimal(robot, rounded_path(np.stack(ends), 1.0))
    assert profile.duration == pytest.approx(exact, rel=2e-3)


def test_torque_limit_alone_gives_the_bang_bang_time_of_a_free_inertia(
    planar: Robot, limited: Limited
) -> None:
    """No gravity, no effects, elbow held straight by ample torque: T = 2 √(D I / τ)."""
    robot = limited(
        planar.with_gravity(np.zeros(3)).with_effects([]),
        position=(-100.0, 100.0),
        velocity=np.inf,
        acceleration=np.inf,
        torque=(5.0, np.inf),
    )
    unit = Motion(np.zeros(1), np.zeros((1, 2)), np.zeros((1, 2)), np.array([[1.0, 0.0]]))
    inertia = torque(robot, unit)[0, 0]
    exact = 2 * np.sqrt(4.0 * inertia / 5.0)
    duration = approach(robot, [0, 0], [4.0, 0], rate_hz=1000.0).t[-1]
    assert exact * (1 - 1e-4) <= duration <= 1.01 * exact


def test_viscous_friction_limits_the_speed_that_a_torque_limit_allows(
    planar: Robot, limited: Limited
) -> None:
    """Far from the ends the speed is v = (τ − F_c) / F_v, without gravity."""
    robot = limited(
        planar.with_gravity(np.zeros(3)),
        position=(-200.0, 200.0),
        velocity=np.inf,
        acceleration=np.inf,
        torque=(2.0, np.inf),
    )
    Fv, Fc = (effect.values[0] for effect in robot.effects[:2] if effect.values)
    motion = approach(robot, [-30, 0], [30, 0])
    assert motion.dq[:, 0].max() == pytest.approx((2.0 - Fc) / Fv, rel=5e-3)


def test_without_any_limit_the_default_acceleration_holds(planar: Robot, limited: Limited) -> None:
    robot = limited(planar, velocity=np.inf, acceleration=np.inf, torque=np.inf)
    duration = approach(robot, [0, 0], [1.0, 0], rate_hz=1000.0).t[-1]
    assert duration == pytest.approx(2 * np.sqrt(1.0 / 10.0), rel=0.01)


@pytest.mark.parametrize("step", [1e-2, 1e-6, 1e-13, 0.0])
def test_tiny_ways(ur10: Robot, step: float) -> None:
    start = np.full(6, -1.0)
    motion = approach(ur10, start, start + step, rate_hz=RATE)
    assert_rests(motion, start, start + step)
    assert motion.t[-1] < 0.2
    assert step > 0 or len(motion) == 2
    assert check(ur10, motion).hold


class Post:
    """A planar arm before a post, with distances in closed form."""

    def distances(self, q: Array) -> Array:
        return np.array([[post_clearance(pose)] for pose in q])


def post_clearance(q: Array) -> float:
    """Distance of both links of a planar arm (0.5 m each) to a post of 0.1 m radius."""
    post, elbow = np.array([0.8, 0.0]), 0.5 * np.array([np.cos(q[0]), np.sin(q[0])])
    tip = elbow + 0.5 * np.array([np.cos(q[0] + q[1]), np.sin(q[0] + q[1])])
    distances = []
    for a, b in ((np.zeros(2), elbow), (elbow, tip)):
        share = np.clip((post - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        distances.append(float(np.linalg.norm(a + share * (b - a) - post)))
    return min(distances) - 0.1


def test_an_obstacle_is_passed_by_via_points(planar: Robot) -> None:
    start, goal = np.array([-1.0, 0.0]), np.array([1.0, 0.0])
    straight = np.linspace(start, goal, 200)
    assert min(map(post_clearance, straight)) < -0.09
    motion = approach(planar, start, goal, scene=Post(), clearance=0.01)
    assert_rests(motion, start, goal)
    fine = np.linspace(0.0, motion.t[-1], 20 * len(motion))
    passed = min(map(post_clearance, HermiteTrajectory(motion)(fine)))
    assert passed >= 0.01 - 1e-3  # poses are checked 0.02 rad apart
    assert excess_between_samples(planar, motion) <= 1 + 1e-9
    again = approach(planar, start, goal, scene=Post(), clearance=0.01)
    np.testing.assert_array_equal(again.q, motion.q)


def test_a_pose_that_cannot_be_held_is_passed_by_via_points(
    planar: Robot, limited: Limited
) -> None:
    """The stretched arm is too heavy halfway; with the elbow bent it passes."""
    robot = limited(planar, torque=0.4 * planar.limits.torque)
    start, goal = np.array([-1.2, -0.4]), np.array([1.9, -0.5])
    holding = np.abs(
        static_torque(robot, np.linspace(start, goal, 99), np.tile(goal - start, (99, 1)))
    )
    assert np.any(holding > robot.limits.torque)
    motion = approach(robot, start, goal)
    assert_rests(motion, start, goal)
    assert excess_between_samples(robot, motion) <= 1 + 1e-9


def test_infeasible_says_where(planar: Robot, ur10: Robot, limited: Limited) -> None:
    straight = limited(planar, position=((-2.0, 2.0), (-0.2, 0.2)))
    with pytest.raises(Infeasible, match=r"approach: clearance is -.*, at 4\d.* % of the straight"):
        approach(straight, [-1, 0], [1, 0], scene=Post())
    with pytest.raises(Infeasible, match=r"return: the goal pose has a clearance of -0\.1 m"):
        approach(planar, [-1, 0], [0, 0], scene=Post(), name="return")
    weak = limited(ur10, torque=0.1 * ur10.limits.torque)
    up, out = [0, -np.pi / 2, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0]
    with pytest.raises(Infeasible, match=r"joint shoulder_lift_joint needs .* in the goal pose"):
        approach(weak, up, out)


@pytest.mark.parametrize(
    ("start", "goal", "options", "why"),
    [
        ([0.0], [0, 0], {}, r"start has shape \(1,\), expected \(2,\) for the 2 joints of planar"),
        ([0, 0], [[0, 0]], {}, r"goal has shape \(1, 2\)"),
        ([0, 0], [0, 99], {}, "goal: joint joint2 at 99 is outside its limits"),
        ([np.nan, 0], [0, 0], {}, "start: joint joint1 at nan"),
        (["a", "b"], [0, 0], {}, "start is not a list of numbers"),
        ([0, 0], [0, 0], {"rate_hz": 0.0}, "rate 0 Hz"),
        ([0, 0], [0, 0], {"rate_hz": np.nan}, "rate nan Hz"),
    ],
)
def test_bad_input(
    planar: Robot, start: object, goal: object, options: dict[str, float], why: str
) -> None:
    with pytest.raises(BadInput, match=why) as error:
        approach(planar, start, goal, **options)  # type: ignore[arg-type]
    assert "\n" not in str(error.value)


def test_a_path_with_corners_is_followed_within_all_limits(planar: Robot) -> None:
    corners = np.array([[0, 0], [1, 0.5], [0, 1.0], [-1, 0.0]])
    path = rounded_path(corners, 0.05)
    motion = timed(planar, path, 500.0)
    assert_rests(motion, path(0.0), path(1.0))
    for corner in corners:
        assert np.linalg.norm(motion.q - corner, axis=1).min() < 0.05
    assert excess_between_samples(planar, motion) <= 1 + 1e-9


def test_torque_holds_on_the_way_for_every_mass_within_the_uncertainty(
    ur10: Robot, limited: Limited
) -> None:
    nominal = limited(ur10, acceleration=10.0, torque=0.5 * ur10.limits.torque)
    wary = nominal.with_limits(replace(nominal.limits, mass_uncertainty=0.2))
    start, goal = np.array([0.0, -1.57, 0.5, 0, 0, 0]), np.array([1.0, -1.0, 1.2, 0.4, 0.6, 0])
    motion = approach(wary, start, goal)
    assert_holds_for_every_mass(nominal, motion, 0.2)
    assert approach(nominal, start, goal).t[-1] < motion.t[-1]
