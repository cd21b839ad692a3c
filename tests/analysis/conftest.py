from __future__ import annotations

import pytest

from excitant.robots import Robot, load_robot


@pytest.fixture(scope="session")
def planar() -> Robot:
    return load_robot("planar_2r")


@pytest.fixture(scope="session")
def ur10() -> Robot:
    return load_robot("ur10")
