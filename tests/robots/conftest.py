"""Arms to state laws on: the built-in ones, and one with a sliding joint and fixed links."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from excitant.exceptions import ExcitantError
from excitant.robots import DHChain, Motion, Robot, load_robot
from excitant.robots.dh import Convention
from excitant.robots.parameters import from_pseudo_inertia
from excitant.robots.urdf import robot_from_urdf

GANTRY = (Path(__file__).parent / "data" / "gantry.urdf").read_text("utf-8")


@pytest.fixture(scope="session")
def gantry_urdf() -> str:
    """Sliding, continuous and revolute joints, and links fixed to others that carry mass."""
    return GANTRY


@pytest.fixture(scope="session")
def gantry() -> Robot:
    return robot_from_urdf(GANTRY, source="gantry.urdf")


KINDS = ("planar_2r", "scara", "ur10", "panda")
"""Two to seven joints, with a sliding one; `test_library` looks at every arm."""


@pytest.fixture(scope="session", params=[*KINDS, "gantry"])
def arm(request: pytest.FixtureRequest, gantry: Robot) -> Robot:
    return gantry if request.param == "gantry" else load_robot(request.param)


@pytest.fixture(scope="session", params=KINDS)
def builtin(request: pytest.FixtureRequest) -> Robot:
    return load_robot(request.param)


Refused = Callable[..., str]


@pytest.fixture(scope="session")
def refused() -> Refused:
    """``refused(match, call, ...)``: what a call is refused with, in one line."""

    def message(
        match: str,
        call: Callable[..., object],
        *given: Any,
        error: type[Exception] = ExcitantError,
        **options: Any,
    ) -> str:
        with pytest.raises(error, match=match) as raised:
            call(*given, **options)
        assert "\n" not in str(raised.value)
        return str(raised.value)

    return message


@pytest.fixture(scope="session")
def random_states() -> Callable[[Robot, int, int], Motion]:
    """``random_states(robot, seed, n)``: states without relation to one another."""

    def states(robot: Robot, seed: int, n: int) -> Motion:
        motion = robot.random_motion(np.random.default_rng(seed), n)
        return Motion(np.arange(n, dtype=float), *motion)

    return states


@pytest.fixture(scope="session")
def random_bodies() -> Callable[[int, int], np.ndarray]:
    """``random_bodies(seed, links)``: physically consistent standard parameters (10 links,)."""

    def bodies(seed: int, links: int) -> np.ndarray:
        rng = np.random.default_rng(seed)
        root = rng.standard_normal((links, 4, 4)) * [0.1, 0.1, 0.1, 1.0]
        P = root @ root.transpose(0, 2, 1) * np.array([0.1, 0.1, 0.1, 1.0])[:, None]
        P = P * np.array([0.1, 0.1, 0.1, 1.0])
        return from_pseudo_inertia(P + 1e-3 * np.eye(4)).ravel()

    return bodies


@pytest.fixture(scope="session")
def random_chain(random_bodies: Callable[[int, int], np.ndarray]) -> Callable[..., DHChain]:
    """``random_chain(seed, joints, convention)``: joints of both kinds, any twist, any mounting."""

    def chain(seed: int, nv: int, convention: Convention = "standard") -> DHChain:
        rng = np.random.default_rng(seed)
        special = rng.choice([0.0, np.pi / 2, -np.pi / 2, np.pi], nv)
        a, d = rng.uniform(-0.6, 0.6, (2, nv)) * rng.choice([0.0, 1.0, 1.0], (2, nv))
        base, tool = (pin.exp6(rng.uniform(-2, 2, 6)).homogeneous for _ in range(2))
        return DHChain(
            name="chain",
            convention=convention,
            joints=tuple(f"j{i}" for i in range(nv)),
            links=tuple(f"l{i}" for i in range(nv)),
            revolute=rng.random(nv) < 0.7,
            a=a,
            d=d,
            alpha=np.where(rng.random(nv) < 0.5, special, rng.uniform(-3, 3, nv)),
            theta=rng.uniform(-3, 3, nv),
            phi=random_bodies(seed, nv),
            gravity=rng.uniform(-10, 10, 3),
            base=base,
            tool=tool,
        )

    return chain
