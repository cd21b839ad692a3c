"""Virtual arms, recorded and diagnosed."""

from functools import cache

import pytest
from planted import Case, Diagnosed, Runs, drawn

from excitant.analysis.diagnosis import Diagnosis, diagnose
from excitant.robots import Robot
from excitant.robots.virtual_arm import HiddenEffect, industrial_sensors


@pytest.fixture(scope="session")
def diagnosed(runs: Runs) -> Diagnosed:
    """``diagnosed(robot, seed, *hidden, given=..., tolerance=..., duration=...)``."""

    def found(
        robot: Robot, seed: int, *hidden: HiddenEffect, given: Robot | None = None,
        tolerance: float = 0.03, **more: float,
    ) -> Diagnosis:  # fmt: skip
        fitted, held = runs(robot, seed, hidden, industrial_sensors(robot), tolerance, **more)
        return diagnose(given or robot, [fitted], validate=[held])

    return found


@pytest.fixture(scope="session")
def case(diagnosed: Diagnosed, ur10: Robot, planar: Robot) -> Case:
    """``case(kind)``: an arm with an effect of this kind hidden, diagnosed once for all tests."""

    @cache
    def of(kind: str) -> tuple[HiddenEffect, Diagnosis]:
        robot = ur10 if kind == "payload" else planar  # where it is a change of the last link
        effect = drawn(robot, kind, 0)
        return effect, diagnosed(robot, 1, effect)

    return of
