"""Hidden effects show as much as was wanted, judged by their own laws and by noise itself."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal
from hidden_effects import KINDS, draw_effect, visible_size
from plant_recordings import true_arm
from planted import hidden

from excitant.design import random_trajectory
from excitant.exceptions import BadInput, UnknownName
from excitant.robots import Robot, load_robot
from excitant.robots.parameters import violations
from excitant.robots.plant.planting import STRUCTURES
from excitant.robots.virtual_arm import industrial_sensors

DURATION = 3.0
EVERY = (*KINDS[:-1], *STRUCTURES)


def filtered_rms(x: np.ndarray, rate_hz: float = 250.0) -> np.ndarray:
    sections = scipy.signal.butter(4, 10.0, fs=rate_hz, output="sos")
    inner = scipy.signal.sosfiltfilt(sections, x, axis=0)[75:-75]
    return np.sqrt(np.mean(inner**2, axis=0))


def test_without_effects_noise_alone_shows(planar: Robot) -> None:
    """Less than an eighth of what is just visible, over what the filter leaves of the noise."""
    rng = np.random.default_rng(2)
    trajectory = random_trajectory(planar, rng, DURATION, 5)
    sensors = industrial_sensors(planar)
    seen = visible_size(true_arm(planar, sensors=sensors), trajectory, DURATION, rng)
    assert seen.size < 2.0 / 8
    noise = sensors.torque_noise * rng.standard_normal((40000, planar.nv))
    np.testing.assert_allclose(seen.floor, filtered_rms(noise), rtol=0.05)


def test_a_spring_shows_by_its_own_law(planar: Robot) -> None:
    """rms of k (q − q_0) along the recorded positions, filtered."""
    rng = np.random.default_rng(3)
    trajectory = random_trajectory(planar, rng, DURATION, 5)
    spring = hidden("spring", planar.joints[1], stiffness=3.0, rest=0.2)
    arm = true_arm(planar, spring, rate=250.0)
    q = arm.record(trajectory, DURATION, rng)["q2"].to_numpy()
    seen = visible_size(arm, trajectory, DURATION, rng)
    assert seen.rms[1] == pytest.approx(filtered_rms(3.0 * (q - 0.2)), rel=0.01)
    assert seen.rms[0] < 0.02 * seen.rms[1]
    assert not seen.floor.any()
    assert seen.size == np.inf


SIZES = {"torque_ripple": 2.5, "encoder_scale": 8.0}
ARMS = ("ur10", "panda", "puma560", "planar_2r")
FAST = [("planar_2r", "payload", 25.0, 0)]
SLOW = [pytest.param("planar_2r", *each, 0, marks=pytest.mark.slow) for each in SIZES.items()]
SLOW += [
    pytest.param(ARMS[k % 4], kind, 8.0, k, marks=pytest.mark.slow) for k, kind in enumerate(EVERY)
]


@pytest.mark.sampled
@pytest.mark.parametrize(("name", "kind", "size", "seed"), FAST + SLOW)
def test_drawn_effects_show_as_much_as_wanted(name: str, kind: str, size: float, seed: int) -> None:
    robot, rng = load_robot(name), np.random.default_rng(seed)
    trajectory = random_trajectory(robot, rng, DURATION, 5)
    effect = draw_effect(robot, rng, kind, size, trajectory=trajectory, duration=DURATION)
    assert effect.kind == kind
    assert (effect.effect == "unknown") == (kind in STRUCTURES)
    assert set(effect.acts_on) <= set(robot.joints)
    arm = true_arm(robot, effect, sensors=industrial_sensors(robot))
    seen = visible_size(arm, trajectory, DURATION, np.random.default_rng(0))
    assert seen.size == pytest.approx(size, rel=0.16)
    bodies = list(arm.truth.model.inertias)[1:]
    phi = np.concatenate([body.toDynamicParameters() for body in bodies])
    assert violations(phi, robot.links) == violations(robot.phi, robot.links)


def test_the_same_seed_draws_the_same_effect(planar: Robot) -> None:
    one, other, third = (
        draw_effect(planar, np.random.default_rng(seed), "coulomb_friction", 8.0, duration=1.0)
        for seed in (5, 5, 6)
    )
    assert one == other != third


def test_what_cannot_be_drawn_is_refused(planar: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hidden_effects._DRAWS", 2)
    rng = np.random.default_rng(0)
    with pytest.raises(UnknownName, match="did you mean 'payload'"):
        draw_effect(planar, rng, "payloads", 8.0)
    weightless = planar.with_gravity([0.0, 0.0, 0.0])
    with pytest.raises(BadInput, match="cannot show a gravity_direction"):
        draw_effect(weightless, rng, "gravity_direction", 5.0, duration=1.0)
