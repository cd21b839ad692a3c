"""Arms to state laws on: the built-in ones, and one with a sliding joint and fixed links."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from excitant.robots import Motion, Robot, load_robot
from excitant.robots.urdf import robot_from_urdf


@pytest.fixture(scope="session")
def gantry_urdf() -> str:
    """Sliding, continuous and revolute joints, and links fixed to others that carry mass."""
    return (Path(__file__).parent / "data" / "gantry.urdf").read_text("utf-8")


@pytest.fixture(scope="session")
def gantry(gantry_urdf: str) -> Robot:
    return robot_from_urdf(gantry_urdf, source="gantry.urdf")


KINDS = ("planar_2r", "scara", "ur10", "panda")
"""Two to seven joints, with a sliding one; `test_library` looks at every arm."""


@pytest.fixture(scope="session", params=[*KINDS, "gantry"])
def arm(request: pytest.FixtureRequest, gantry: Robot) -> Robot:
    return gantry if request.param == "gantry" else load_robot(request.param)


@pytest.fixture(scope="session", params=KINDS)
def builtin(request: pytest.FixtureRequest) -> Robot:
    return load_robot(request.param)


@pytest.fixture(scope="session")
def random_states() -> Callable[[Robot, int, int], Motion]:
    """``random_states(robot, seed, n)``: states without relation to one another."""

    def states(robot: Robot, seed: int, n: int) -> Motion:
        return Motion(np.arange(float(n)), *robot.random_motion(np.random.default_rng(seed), n))

    return states
