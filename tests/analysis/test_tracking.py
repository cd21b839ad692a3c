"""An arm follows a motion by models: errors are what statics says, and MuJoCo agrees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import tracking as benchmark
from plant_recordings import Trajectory, swing, true_arm

from excitant.analysis.tracking import BANDWIDTH_HZ, track
from excitant.robots import Robot
from excitant.robots.effects import CoulombFriction, TorqueOffset
from excitant.robots.virtual_arm import HiddenEffect, ideal_sensors, industrial_sensors


@pytest.fixture(scope="module")
def bare(planar: Robot) -> Robot:
    """Without friction, in which it would stick."""
    return planar.with_effects(())


def still(pose: np.ndarray) -> Trajectory:
    return lambda t, order=0: np.tile(pose, (len(t), 1)) if order == 0 else np.zeros((len(t), 2))


def test_a_constant_error_of_torque_is_borne_by_the_stiffness(bare: Robot) -> None:
    """δτ = K δq with K = ω² M of the nominal arm, no softer than 5 % of a limit at 0.01 rad."""
    pose, wrong = np.array([0.4, 0.8]), np.array([3.0, -2.0])
    bare = bare.with_gravity(np.zeros(3))  # which changes with the pose, too
    off = bare.with_effects([TorqueOffset(bare.joints).with_values(wrong)])
    arm, models = true_arm(bare, sensors=ideal_sensors(bare)), {"off": off, "true": bare}
    found = track(arm, models, still(pose), 0.7, np.random.default_rng(0))
    K = pin.crba(bare.model, bare.model.createData(), pose) * (2 * np.pi * BANDWIDTH_HZ) ** 2
    j = np.arange(2)
    K[j, j] = np.maximum(K[j, j], 5 * bare.limits.torque)
    np.testing.assert_allclose(found.error[0, -1], -np.linalg.solve(K, wrong), rtol=1e-6)
    assert np.abs(found.error[1]).max() < 1e-9
    np.testing.assert_allclose(found.rms, np.sqrt((found.error**2).mean(axis=1)))


def test_gains_are_the_same_whatever_the_model(bare: Robot) -> None:
    """Links twice as heavy in weightlessness, at rest, need no torque: nothing changes."""
    free = bare.with_gravity(np.zeros(3))
    heavy = free.with_parameters(2 * free.phi)
    pushed = (TorqueOffset(free.joints).with_values(np.array([1.0, 1.0])),)
    models = {name: m.with_effects(pushed) for name, m in (("a", free), ("b", heavy))}
    pose = still(np.array([0.4, 0.8]))
    arm = true_arm(free, sensors=ideal_sensors(free))
    found = track(arm, models, pose, 0.2, np.random.default_rng(0))
    assert np.abs(found.error[0]).max() > 1e-5
    np.testing.assert_allclose(found.error[0], found.error[1], atol=1e-12)


def test_knowing_what_is_hidden_follows_closer(planar: Robot) -> None:
    """And an offset of the sensor is part of what the drives are told."""
    hidden = (
        HiddenEffect("coulomb_friction", "joint2", (("Fc", 2.0),)),
        HiddenEffect("torque_offset", "joint1", (("offset", 3.0),)),
    )
    arm = true_arm(planar, *hidden, sensors=ideal_sensors(planar))
    known = planar.with_effects(
        [*planar.effects, CoulombFriction(("joint2",), (2.0,)), TorqueOffset(("joint1",), (3.0,))]
    )
    found = track(
        arm, {"given": planar, "known": known}, swing(planar), 1.0, np.random.default_rng(0)
    )
    assert (found.ratio > 20).all(), found.ratio
    entry = found.entries(planar)[1]
    assert (entry["name"], entry["unit"]) == ("joint2", "rad")
    assert entry["ratio"] == pytest.approx(entry["rms"]["given"] / entry["rms"]["known"])


def test_readings_are_noisy_and_alike_for_all_models(planar: Robot) -> None:
    arm, path = true_arm(planar, sensors=industrial_sensors(planar)), swing(planar)
    models = {"one": planar, "same": planar}
    first, again, other = (
        track(arm, models, path, 0.3, np.random.default_rng(k)) for k in (0, 0, 1)
    )
    np.testing.assert_array_equal(first.error[0], first.error[1])
    np.testing.assert_array_equal(first.error, again.error)
    assert not np.allclose(first.error, other.error, atol=1e-9)
    exact = replace(arm, sensors=ideal_sensors(planar))
    quiet = track(exact, models, path, 0.3, np.random.default_rng(0))
    assert (first.rms > 1.3 * quiet.rms).all()


def test_mujoco_agrees_on_the_errors(planar: Robot) -> None:
    """Bodies, rotors and friction of another simulator under the same controller."""
    hidden = (
        HiddenEffect("coulomb_friction", "joint2", (("Fc", 1.0),)),
        HiddenEffect("rotor_inertia", "joint1", (("Ia", 0.5),)),
        HiddenEffect("torque_offset", "joint2", (("offset", 1.0),)),
    )
    arm, path = true_arm(planar, *hidden, sensors=ideal_sensors(planar)), swing(planar)
    both = [
        track(each, {"given": planar}, path, 1.0, np.random.default_rng(0))
        for each in (arm, benchmark.MuJoCoArm(arm))
    ]
    np.testing.assert_allclose(both[0].rms, both[1].rms, rtol=0.02)
