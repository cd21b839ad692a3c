"""Hidden effects show as much as was wanted, judged by their own laws and by noise itself."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal
from hidden_effects import KINDS, draw_effect, visible_size

from excitant.design import random_trajectory
from excitant.exceptions import UnknownName
from excitant.robots import Robot, load_robot
from excitant.robots.parameters import violations
from excitant.robots.plant.planting import STRUCTURES
from excitant.robots.virtual_arm import (
    HiddenEffect,
    VirtualArm,
    ideal_sensors,
    industrial_sensors,
    virtual_arm,
)

DURATION = 3.0
EVERY = (*KINDS[:-1], *STRUCTURES)


def arm_with(robot: Robot, *effects: HiddenEffect, ideal: bool = False) -> VirtualArm:
    sensors = ideal_sensors(robot) if ideal else industrial_sensors(robot)
    rng = np.random.default_rng(0)
    return virtual_arm(robot, rng, hidden=effects, sensors=sensors, tolerance=0.0)


def filtered_rms(x: np.ndarray, rate_hz: float = 250.0) -> np.ndarray:
    sections = scipy.signal.butter(4, 10.0, fs=rate_hz, output="sos")
    inner = scipy.signal.sosfiltfilt(sections, x, axis=0)[75:-75]
    return np.sqrt(np.mean(inner**2, axis=0))


def test_what_hides_nothing_shows_nothing(planar: Robot) -> None:
    """Less than an eighth of what is just visible."""
    rng = np.random.default_rng(1)
    trajectory = random_trajectory(planar, rng, DURATION, 5)
    assert visible_size(arm_with(planar), trajectory, DURATION, rng).size < 2.0 / 8


def test_the_floor_is_what_the_filter_leaves_of_the_noise(planar: Robot) -> None:
    rng = np.random.default_rng(2)
    trajectory = random_trajectory(planar, rng, DURATION, 5)
    floor = visible_size(arm_with(planar), trajectory, DURATION, rng).floor
    noise = industrial_sensors(planar).torque_noise * rng.standard_normal((40000, planar.nv))
    np.testing.assert_allclose(floor, filtered_rms(noise), rtol=0.05)
    seen = visible_size(arm_with(planar, ideal=True), trajectory, DURATION, rng)
    assert (seen.floor == 0).all()


def test_a_spring_shows_by_its_own_law(planar: Robot) -> None:
    """rms of k (q − q_0) along the recorded positions, filtered."""
    rng, joint = np.random.default_rng(3), planar.joints[1]
    trajectory = random_trajectory(planar, rng, DURATION, 5)
    spring = HiddenEffect("spring", joint, (("stiffness", 3.0), ("rest", 0.2)))
    arm = arm_with(planar, spring, ideal=True)
    q = arm.record(trajectory, DURATION, rng)["q2"].to_numpy()
    seen = visible_size(arm, trajectory, DURATION, rng)
    assert seen.rms[1] == pytest.approx(filtered_rms(3.0 * (q - 0.2)), rel=0.01)
    assert seen.rms[0] < 0.02 * seen.rms[1]
    assert seen.size == np.inf


@pytest.mark.parametrize(
    ("kind", "size"), [("torque_ripple", 2.5), ("encoder_scale", 8.0), ("payload", 25.0)]
)
def test_drawn_effects_show_as_much_as_wanted(planar: Robot, kind: str, size: float) -> None:
    assert_shows(planar, kind, size, 0)


def assert_shows(robot: Robot, kind: str, size: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    trajectory = random_trajectory(robot, rng, DURATION, 5)
    effect = draw_effect(robot, rng, kind, size, trajectory=trajectory, duration=DURATION)
    assert effect.kind == kind
    assert (effect.effect == "unknown") == (kind in STRUCTURES)
    assert set(effect.acts_on) <= set(robot.joints)
    arm = arm_with(robot, effect)
    seen = visible_size(arm, trajectory, DURATION, np.random.default_rng(0))
    assert seen.size == pytest.approx(size, rel=0.16)
    phi = np.concatenate(
        [body.toDynamicParameters() for body in list(arm.truth.model.inertias)[1:]]
    )
    assert violations(phi, robot.links) == violations(robot.phi, robot.links)


@pytest.mark.slow
@pytest.mark.parametrize("kind", EVERY)
def test_every_kind_shows_as_much_as_wanted(kind: str) -> None:
    name = ("ur10", "panda", "puma560", "planar_2r")[EVERY.index(kind) % 4]
    assert_shows(load_robot(name), kind, 8.0, EVERY.index(kind))


def test_refusals(planar: Robot) -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(UnknownName, match="did you mean 'payload'"):
        draw_effect(planar, rng, "payloads", 8.0)
