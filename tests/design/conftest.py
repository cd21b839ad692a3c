from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from excitant.robots import Limits, Robot


@pytest.fixture(scope="session")
def limited() -> Callable[..., Robot]:
    """A robot with some of its limits replaced."""

    def replaced(robot: Robot, **changes: object) -> Robot:
        names = ("position", "velocity", "acceleration", "torque", "jerk")
        values = {name: changes.get(name, getattr(robot.limits, name)) for name in names}
        shapes = {name: (robot.nv, 2) if name == "position" else (robot.nv,) for name in names}
        return robot.with_limits(
            Limits(
                **{k: np.broadcast_to(np.asarray(v, float), shapes[k]) for k, v in values.items()}
            )
        )

    return replaced
