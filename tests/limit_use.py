"""Other limits for a robot, and their use by the definition of the limits alone."""

from dataclasses import replace

import numpy as np

from excitant.design import Design
from excitant.robots import Array, Motion, Robot, torque


def limited(robot: Robot, **changes: object) -> Robot:
    """The robot with some of its limits replaced."""
    shapes = {name: np.shape(getattr(robot.limits, name)) for name in changes}
    limits = {x: np.broadcast_to(np.asarray(changes[x], float), shapes[x]) for x in changes}
    return robot.with_limits(replace(robot.limits, **limits))


def limit_shares(robot: Robot, motion: Motion) -> dict[str, Array]:
    """Largest share of each limit per joint; of position, the distance from the middle."""
    low, high = robot.limits.position.T
    sizes = {
        "position": np.abs(motion.q - (low + high) / 2) / ((high - low) / 2),
        "velocity": np.abs(motion.dq) / robot.limits.velocity,
        "acceleration": np.abs(motion.ddq) / robot.limits.acceleration,
        "torque": np.abs(torque(robot, motion)) / robot.limits.torque,
    }
    return {name: size.max(axis=0) for name, size in sizes.items()}


def assert_limits_hold(found: Design, rate_hz: float = 2000.0) -> None:
    assert found.trajectory.at_rest
    for use in found.limits.uses:
        assert use.ratio <= (1.0 if use.quantity == "position" else found.use)
    for name, shares in limit_shares(found.robot, found.trajectory.motion(rate_hz)).items():
        assert shares.max() <= (1.0 if name == "position" else found.use)


def assert_holds_for_every_mass(robot: Robot, motion: Motion, uncertainty: float) -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        shares = 1 + uncertainty * rng.choice([-1.0, 1.0], robot.nv)
        other = robot.with_parameters(robot.phi * np.repeat(shares, 10))
        assert np.all(np.abs(torque(other, motion)) <= robot.limits.torque)
