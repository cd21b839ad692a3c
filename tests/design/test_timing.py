import itertools

import numpy as np
import pytest
from limit_use import assert_holds_for_every_mass, limit_shares, limited
from marks import refused, slow

from excitant.design import HermiteTrajectory, approach, check
from excitant.design.timing import HOLDING, rounded_path, static_torque, time_optimal, timed
from excitant.exceptions import BadInput, Infeasible
from excitant.robots import Array, Motion, Robot, load_robot, torque

RATE = 125.0
FREE = dict.fromkeys(("velocity", "acceleration", "torque"), np.inf) | {"position": (-200, 200)}


def assert_follows(robot: Robot, motion: Motion, start: Array, goal: Array) -> None:
    """It rests at both ends, and keeps all limits at samples 20 times as dense."""
    np.testing.assert_array_equal(motion.q[[0, -1]], [start, goal])
    np.testing.assert_array_equal([motion.dq[[0, -1]], motion.ddq[[0, -1]]], 0.0)
    fine = np.linspace(motion.t[0], motion.t[-1], 20 * (len(motion) - 1) + 1)
    dense = HermiteTrajectory(motion).at(fine)
    low, high = robot.limits.position.T
    assert np.maximum(low - dense.q, dense.q - high).max() <= 1e-9
    shares = limit_shares(robot, dense)
    assert max(shares[x].max() for x in ("velocity", "acceleration", "torque")) <= 1 + 1e-9


def holding_torque(robot: Robot, start: Array, goal: Array) -> Array:
    """Largest torque per joint that any pose on a straight way needs to be held, either way."""
    poses = np.linspace(start, goal, 99)
    ways = (np.tile(sign * np.ones(robot.nv), (99, 1)) for sign in (1, -1))
    return np.max([np.abs(static_torque(robot, poses, way)).max(axis=0) for way in ways], axis=0)


@pytest.mark.parametrize(
    ("name", "share"), [("planar_2r", 0.4), ("ur10", 0.4), slow("panda", 1.0), slow("panda", 0.4)]
)
def test_limits_hold_between_the_samples_and_the_ends_rest(name: str, share: float) -> None:
    robot, rng = load_robot(name), np.random.default_rng(5)
    robot = limited(robot, torque=share * robot.limits.torque)
    low, high = np.clip(robot.limits.position, -np.pi, np.pi).T
    drawn = (rng.uniform(low, high) for _ in itertools.count())
    room = 0.9 * HOLDING * robot.limits.torque
    held = (pose for pose in drawn if np.all(holding_torque(robot, pose, pose) < room))
    for start, goal in itertools.pairwise(itertools.islice(held, 3)):
        motion = approach(robot, start, goal, rate_hz=RATE)
        assert_follows(robot, motion, start, goal)
        np.testing.assert_allclose(np.diff(motion.t), 1 / RATE, rtol=1e-9)
        report = check(robot, motion)
        assert all(use.ratio <= 1 for use in report.uses[1:])
        if (name, share) == ("ur10", 0.4):  # a fast motion uses some limit in full
            assert report.worst.ratio > 0.98


@pytest.mark.parametrize(("way", "v", "a"), [(6.0, 1.5, 2.0), (1.0, 9.0, 1.0), (-20.0, 3.0, 5.0)])
def test_one_joint_takes_the_time_of_the_trapezoid(planar: Robot, way: float, v: float, a: float):
    """Bang-bang with a speed limit: D/v + v/a, or 2 √(D/a) when the speed is never reached."""
    distance = abs(way)
    exact = distance / v + v / a if distance > v**2 / a else 2 * np.sqrt(distance / a)
    robot = limited(planar, **FREE | {"velocity": (v, 50.0), "acceleration": (a, 500.0)})
    ends = np.array([[0.0, 0.3], [way, 0.3]])
    duration = approach(robot, *ends, rate_hz=250.0).t[-1]
    assert exact <= duration <= 1.01 * exact
    assert time_optimal(robot, rounded_path(ends, 1.0)).duration == pytest.approx(exact, rel=2e-3)


def test_torque_limit_alone_gives_the_bang_bang_time_of_a_free_inertia(planar: Robot) -> None:
    """No gravity, no effects, elbow held straight by ample torque: T = 2 √(D I / τ)."""
    weightless = planar.with_gravity(np.zeros(3)).with_effects([])
    robot = limited(weightless, **FREE | {"torque": (5.0, np.inf)})
    unit = Motion(np.zeros(1), np.zeros((1, 2)), np.zeros((1, 2)), np.array([[1.0, 0.0]]))
    exact = 2 * np.sqrt(4.0 * torque(robot, unit)[0, 0] / 5.0)
    duration = approach(robot, [0, 0], [4.0, 0], rate_hz=1000.0).t[-1]
    assert exact * (1 - 1e-4) <= duration <= 1.01 * exact


def test_viscous_friction_or_the_default_acceleration_limits_the_speed(planar: Robot) -> None:
    """Far from the ends the speed is v = (τ − F_c) / F_v, without gravity."""
    robot = limited(planar.with_gravity(np.zeros(3)), **FREE | {"torque": (2.0, np.inf)})
    Fv, Fc = (effect.values[0] for effect in robot.effects[:2] if effect.values)
    motion = approach(robot, [-20, 0], [20, 0])
    assert motion.dq[:, 0].max() == pytest.approx((2.0 - Fc) / Fv, rel=5e-3)
    # without any limit, the default acceleration holds
    duration = approach(limited(planar, **FREE), [0, 0], [1.0, 0], rate_hz=1000.0).t[-1]
    assert duration == pytest.approx(2 * np.sqrt(1.0 / 10.0), rel=0.01)


@pytest.mark.parametrize("step", [1e-2, 1e-6, 1e-13, 0.0])
def test_tiny_ways(ur10: Robot, step: float) -> None:
    start = np.full(6, -1.0)
    motion = approach(ur10, start, start + step, rate_hz=RATE)
    assert_follows(ur10, motion, start, start + step)
    assert motion.t[-1] < 0.2
    assert step > 0 or len(motion) == 2
    assert check(ur10, motion).hold


class Post:
    """A planar arm with links of 0.5 m before a post of 0.1 m radius, in closed form."""

    @staticmethod
    def distances(q: Array) -> Array:
        post, angles = np.array([0.8, 0.0]), np.cumsum(q, axis=1)
        links = 0.5 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        joints = np.cumsum(links, axis=1) - links
        share = np.clip(((post - joints) * links).sum(axis=-1) / 0.5**2, 0.0, 1.0)
        return np.linalg.norm(joints + share[..., None] * links - post, axis=-1) - 0.1


def test_an_obstacle_is_passed_by_via_points(planar: Robot) -> None:
    start, goal = np.array([-1.0, 0.0]), np.array([1.0, 0.0])
    assert Post.distances(np.linspace(start, goal, 200)).min() < -0.09
    motion, again = (approach(planar, start, goal, scene=Post, clearance=0.01) for _ in range(2))
    assert_follows(planar, motion, start, goal)
    fine = np.linspace(0.0, motion.t[-1], 20 * len(motion))
    passed = Post.distances(HermiteTrajectory(motion)(fine)).min()
    assert passed >= 0.01 - 1e-3  # poses are checked 0.02 rad apart
    np.testing.assert_array_equal(again.q, motion.q)


def test_a_pose_that_cannot_be_held_is_passed_by_via_points(planar: Robot) -> None:
    """The stretched arm is too heavy halfway; with the elbow bent it passes."""
    robot = limited(planar, torque=0.4 * planar.limits.torque)
    start, goal = np.array([-1.2, -0.4]), np.array([1.9, -0.5])
    assert np.any(holding_torque(robot, start, goal) > robot.limits.torque)
    assert_follows(robot, approach(robot, start, goal), start, goal)


def test_infeasible_says_where(planar: Robot, ur10: Robot) -> None:
    straight = limited(planar, position=((-2.0, 2.0), (-0.2, 0.2)))
    with pytest.raises(Infeasible, match=r"approach: clearance is -.*, at 4\d.* % of the straight"):
        approach(straight, [-1, 0], [1, 0], scene=Post)
    with pytest.raises(Infeasible, match=r"return: the goal pose has a clearance of -0\.1 m"):
        approach(planar, [-1, 0], [0, 0], scene=Post, name="return")
    weak = limited(ur10, torque=0.1 * ur10.limits.torque)
    with pytest.raises(Infeasible, match=r"joint shoulder_lift_joint needs .* in the goal pose"):
        approach(weak, [0, -np.pi / 2, 0, 0, 0, 0], np.zeros(6))


@pytest.mark.parametrize(
    ("start", "goal", "rate_hz", "why"),
    [
        ([0.0], [0, 0], RATE, r"start has shape \(1,\), expected \(2,\) for the 2 joints of pla"),
        ([0, 0], [[0, 0]], RATE, r"goal has shape \(1, 2\)"),
        ([0, 0], [0, 99], RATE, "goal: joint joint2 at 99 is outside its limits"),
        ([np.nan, 0], [0, 0], RATE, "start: joint joint1 at nan"),
        (["a", "b"], [0, 0], RATE, "start is not a list of numbers"),
        ([0, 0], [0, 0], 0.0, "rate 0 Hz"),
        ([0, 0], [0, 0], np.nan, "rate nan Hz"),
    ],
)
def test_bad_input(planar: Robot, start: object, goal: object, rate_hz: float, why: str) -> None:
    refused(why, approach, planar, start, goal, rate_hz=rate_hz, error=BadInput)


def test_a_path_with_corners_is_followed_within_all_limits(planar: Robot) -> None:
    corners = np.array([[0, 0], [1, 0.5], [0, 1.0], [-1, 0.0]])
    path = rounded_path(corners, 0.05)
    motion = timed(planar, path, 500.0)
    assert_follows(planar, motion, path(0.0), path(1.0))
    for corner in corners:
        assert np.linalg.norm(motion.q - corner, axis=1).min() < 0.05


def test_torque_holds_on_the_way_for_every_mass_within_the_uncertainty(ur10: Robot) -> None:
    nominal = limited(ur10, acceleration=10.0, torque=0.5 * ur10.limits.torque)
    ends = np.array([[0.0, -1.57, 0.5, 0, 0, 0], [1.0, -1.0, 1.2, 0.4, 0.6, 0]])
    motion = approach(limited(nominal, mass_uncertainty=0.2), *ends)
    assert_holds_for_every_mass(nominal, motion, 0.2)
    assert approach(nominal, *ends).t[-1] < motion.t[-1]
