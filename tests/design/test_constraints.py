import numpy as np
import pytest
from limit_use import limit_shares, limited
from marks import refused, slow

from excitant.design import Trajectory, check, random_trajectory
from excitant.design.constraints import KINEMATIC
from excitant.exceptions import BadInput, Infeasible
from excitant.robots import Robot, torque
from excitant.robots.effects import CoulombFriction, ViscousFriction

UNLIMITED = dict.fromkeys(("velocity", "acceleration", "torque"), np.inf)
UNLIMITED["position"] = [-np.inf, np.inf]


@pytest.mark.parametrize("friction", [slow(False), True])
@pytest.mark.parametrize("kind", ["fourier", "sampled"])
def test_ratios_cover_dense_sampling(ur10: Robot, kind: str, friction: bool) -> None:
    effects = [CoulombFriction(ur10.joints, (9.0,) * 6), ViscousFriction(ur10.joints, (5.0,) * 6)]
    robot = limited(ur10, acceleration=12.0).with_effects(effects if friction else ())
    trajectory = random_trajectory(robot, np.random.default_rng(4), 6.0, 6)
    report = check(robot, trajectory.motion(100) if kind == "sampled" else trajectory)
    exact = limit_shares(robot, trajectory.sample(100_001))
    for use in report.uses:
        # the dense samples miss the edge of a friction jump by up to one step of 60 µs
        rtol = 2e-4 if friction and use.quantity == "torque" else 2e-5
        np.testing.assert_allclose(use.ratios, exact[use.quantity], rtol=rtol)
        if kind != "sampled":
            assert np.all(use.ratios >= exact[use.quantity] * (1 - 1e-7))


@pytest.mark.parametrize("sampled", [False, True])
@pytest.mark.parametrize("quantity", [*KINEMATIC[::2], *map(slow, KINEMATIC[1::2]), "torque"])
def test_flags_a_planted_violation(ur10: Robot, quantity: str, sampled: bool) -> None:
    robot = limited(ur10, acceleration=12.0)
    trajectory = random_trajectory(robot, np.random.default_rng(7), 6.0, 5)
    assert check(robot, trajectory).hold
    fine = trajectory.sample(60_001)
    values = {"position": fine.q, "velocity": fine.dq, "acceleration": fine.ddq}
    values |= {"jerk": trajectory(fine.t, 3), "torque": torque(robot, fine)}
    j, excess = 2, 1.07
    size = np.abs(values[quantity][:, j])
    limit = np.array(getattr(robot.limits, quantity))
    limit[j] = size.max() / excess * (np.array([-1, 1]) if quantity == "position" else 1)
    tight = limited(robot, **{quantity: limit})
    report = check(tight, trajectory.motion(50) if sampled else trajectory)
    worst = report.worst
    assert (report.hold, worst.quantity, worst.joint) == (False, quantity, robot.joints[j])
    assert worst.ratio == pytest.approx(excess, rel=1e-4)
    k = round(worst.time / 6.0 * 60_000)
    assert size[max(k - 2, 0) : k + 3].max() == pytest.approx(size.max(), rel=1e-4)


def test_sees_what_happens_between_samples(planar: Robot) -> None:
    trajectory = Trajectory([[0, 0], [0, 0], [0, 0], [0, 0], [0.5, 0]], 2.0)
    coarse = trajectory.at(np.arange(9) / 4 + 1 / 16)
    assert np.abs(coarse.q).max() < 0.48
    worst = check(limited(planar, **UNLIMITED | {"position": [-0.49, 0.49]}), coarse).worst
    assert (worst.quantity, worst.ratio) == ("position", pytest.approx(0.5 / 0.49, rel=5e-3))


def test_no_limit_is_never_exceeded(planar: Robot) -> None:
    robot = limited(planar, **UNLIMITED)
    report = check(robot, random_trajectory(robot, np.random.default_rng(0), 5.0, 3))
    assert (report.worst.ratio, report.hold) == (0.0, True)


@pytest.mark.filterwarnings("error")
def test_hardly_any_limit_is_exceeded_beyond_all_numbers_and_other_arms_refused(planar, ur10):
    trajectory = random_trajectory(planar, np.random.default_rng(0), 5.0, 3)
    worst = check(limited(planar, acceleration=1e-308), trajectory).worst
    assert (worst.quantity, worst.ratio > 1e300) == ("acceleration", True)
    refused("2 joints, robot ur10 has 6", check, ur10, trajectory, error=BadInput)
    refused("1 samples", check, planar, trajectory.at([0.0]), error=BadInput)


@pytest.mark.parametrize("seed", [0, slow(1), slow(2)])
def test_random_trajectories_hold_every_limit(ur10: Robot, seed: int) -> None:
    rng = np.random.default_rng(seed)
    middle, half = rng.uniform(-2, 2, 6), rng.uniform(0.3, 3.0, 6)
    position = np.column_stack([middle - half, middle + half])
    rates = {"velocity": rng.uniform(0.5, 3, 6), "acceleration": rng.uniform(1, 20, 6)}
    robot = limited(ur10, position=position, **rates)
    for duration, harmonics in ((4.0, 2), (12.0, 7)):
        trajectory = random_trajectory(robot, rng, duration, harmonics)
        assert trajectory.at_rest
        assert check(robot, trajectory).hold
    weak = limited(ur10, torque=ur10.limits.torque * 0.15)
    assert check(weak, random_trajectory(weak, rng, 10.0, 5)).hold


def test_gravity_above_the_torque_limit_names_the_joint(ur10: Robot) -> None:
    position, weak = np.array(ur10.limits.position), np.array(ur10.limits.torque)
    position[1:3], weak[1] = [[-0.2, 0.2], [-0.1, 0.1]], 1.0  # stretched
    robot = limited(ur10, torque=weak, position=position)
    why = rf"torque limit of {ur10.joints[1]} \(1 N·m\) .* within the position limits"
    refused(why, random_trajectory, robot, np.random.default_rng(0), 10.0, 5, error=Infeasible)


def test_friction_above_the_torque_limit_names_the_joint(planar: Robot) -> None:
    sticky = float(planar.limits.torque[1]) * 1.2
    robot = planar.with_effects([CoulombFriction(planar.joints, (0.0, sticky))])
    with pytest.raises(Infeasible, match=f"torque limit of joint {planar.joints[1]}"):
        random_trajectory(robot, np.random.default_rng(0), 10.0, 3)
