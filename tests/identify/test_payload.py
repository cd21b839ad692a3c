"""Payloads come out exact without noise, within 2 % and 3 mm on a virtual arm, or it says why."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from excitant.design import random_trajectory
from excitant.exceptions import BadInput
from excitant.identify import PayloadEstimate, Recording, identify_payload, recording_from_table
from excitant.identify.information import gaussian, information_of
from excitant.identify.payload import estimate_payload, payload_information
from excitant.identify.prior import base_prior
from excitant.robots import Array, Motion, Robot, base_parameters, load_robot, torque
from excitant.robots.effects import Payload, standard_effects
from excitant.robots.parameters import STANDARD, violations
from excitant.robots.torque import observation_columns
from excitant.robots.virtual_arm import HiddenEffect, industrial_sensors, virtual_arm

# 1.5 kg, centre of mass at (20, −30, 180) mm of the last joint, about that joint's frame
MASS, CENTRE = 1.5, np.array([0.02, -0.03, 0.18])
SPREAD = np.diag([0.004, 0.005, 0.006])
ABOUT_JOINT = SPREAD + MASS * (CENTRE @ CENTRE * np.eye(3) - np.outer(CENTRE, CENTRE))
PHI = np.array([MASS, *(MASS * CENTRE), *ABOUT_JOINT[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])
MotionOf = Callable[..., Motion]
Runs = tuple[Recording, Recording]


def task(robot: Robot, rng: np.random.Generator) -> Callable[[Array, int], Array]:
    """Quintic moves to seven poses in six tenths of the range, within speed limits, with rests."""
    move, leg = 1.4, 1.6  # s
    low, high = np.clip(robot.limits.position, -np.pi, np.pi).T
    found = [(low + high) / 2]
    for target in (low + high) / 2 + 0.3 * (high - low) * rng.uniform(-1, 1, (7, robot.nv)):
        step = target - found[-1]
        fastest = np.max(np.abs(step) * 1.875 / move / robot.limits.velocity)
        found.append(found[-1] + step * min(1.0, 0.9 / fastest))
    poses, shape = np.array(found), np.polynomial.Polynomial([0, 0, 0, 10, -15, 6])

    def at(t: Array, order: int) -> Array:
        k = np.minimum((t // leg).astype(int), len(poses) - 2)
        x = np.clip((t - k * leg) / move, 0, 1)[:, None]
        change = shape.deriv(order)(x) / move**order * (poses[k + 1] - poses[k])
        return np.asarray(change + (poses[k] if order == 0 else 0.0))

    return at


@pytest.fixture(scope="module")
def panda() -> Robot:
    return load_robot("panda")


@pytest.fixture(scope="module")
def held(panda: Robot) -> Runs:
    """Ten seconds of a virtual arm's task with its payload, and an excitation without."""
    payload = HiddenEffect("payload", panda.joints[-1], tuple(zip(STANDARD, PHI, strict=True)))
    sensors = industrial_sensors(panda, 250.0)
    free, loaded = (
        virtual_arm(panda, np.random.default_rng(7), hidden=hidden, sensors=sensors)
        for hidden in ((), (payload,))
    )
    rng = np.random.default_rng(8)
    tables = {
        "task": loaded.record(task(panda, rng), 10.0, rng),
        "free": free.record(random_trajectory(panda, rng, 10.0, 5), 10.0, rng),
    }
    made = {k: recording_from_table(v, 7, file=f"{k}.csv", name=k) for k, v in tables.items()}
    return made["task"], made["free"]


@pytest.fixture(scope="module")
def found(panda: Robot, held: Runs) -> PayloadEstimate:
    loaded, free = held
    return identify_payload(panda, [loaded], unloaded=[free])


def test_mass_and_centre_after_ten_seconds_of_task(found: PayloadEstimate) -> None:
    assert found.mass == pytest.approx(MASS, rel=0.02)
    assert np.linalg.norm(found.centre - CENTRE) < 0.003
    assert not found.shortcomings
    assert (np.abs(found.phi - PHI) < 4 * found.std).all()
    assert (np.abs(found.centre - CENTRE) < 4 * found.centre_std).all()
    assert not violations(found.phi, ["payload"])
    entry = found.result()
    assert [p["name"] for p in entry["parameters"]] == list(STANDARD)
    assert entry["mass"] == {"value": found.mass, "std": found.std[0], "unit": "kg"}
    assert entry["link"] == "panda_link7"


def test_an_arm_that_carries_nothing_is_said_to_carry_nothing(panda: Robot, held: Runs) -> None:
    _, free = held
    first, second = free.between(0, 0.5, "first"), free.between(0.5, 1, "second")
    empty = identify_payload(panda, [first], unloaded=[second])
    assert empty.mass < 0.02 * MASS
    assert "no payload is seen" in empty.shortcomings[0]


def test_too_little_motion_says_so(panda: Robot, held: Runs) -> None:
    loaded, free = held
    poor = identify_payload(panda, [loaded.between(0, 0.06, "half a move")], unloaded=[free])
    assert poor.shortcomings
    assert "only" in poor.shortcomings[0]
    assert (np.abs(poor.centre - CENTRE) < 4 * poor.centre_std).all()


def test_the_given_model_may_stand_for_the_unloaded_arm(panda: Robot, held: Runs) -> None:
    rough = identify_payload(panda, held[:1])
    assert "--unloaded" in rough.notes[0]
    # the model is 3 % off where 1 % is taken, so this is no test of the interval
    assert rough.mass == pytest.approx(MASS, rel=0.3)


def test_without_noise_the_body_is_exact(ur10: Robot, motion_of: MotionOf) -> None:
    effects = standard_effects(ur10.joints)
    base = base_parameters(ur10, effects)
    motion = motion_of(ur10, np.arange(0, 10, 0.05))
    bare = torque(ur10, motion)
    extra = Payload((ur10.joints[-1],)).with_values(PHI).torque(ur10, motion)
    W = observation_columns(ur10, effects, motion)[:, :, base.columns].reshape(-1, len(base))
    sigma = 1e-6
    empty, loaded = (information_of(W / sigma, tau.ravel() / sigma) for tau in (bare, bare + extra))
    body = estimate_payload(ur10, base, loaded, empty)
    np.testing.assert_allclose(body.phi, PHI, atol=1e-5 * np.abs(PHI).max())
    # an arm known exactly leaves what the difference of the torques says
    last = 10 * (ur10.nv - 1)
    columns = W @ base.regrouping[:, last : last + 10] / sigma
    difference = information_of(columns, extra.ravel() / sigma).covariance()
    beta = np.linalg.lstsq(W, bare.ravel(), rcond=None)[0]
    known = gaussian(beta, 1e-24 * np.eye(len(beta)))
    between = payload_information(ur10, base, loaded, known).covariance()
    np.testing.assert_allclose(between, difference, atol=1e-4 * np.abs(difference).max())


def test_information_about_other_parameters_is_refused(ur10: Robot) -> None:
    base = base_parameters(ur10)
    prior = base_prior(ur10, (), base).information()
    effects = standard_effects(ur10.joints)
    other = base_prior(ur10, effects, base_parameters(ur10, effects)).information()
    with pytest.raises(BadInput, match="use one set of effects"):
        estimate_payload(ur10, base, other, prior)


def test_currents_need_the_unloaded_arm_and_leave_the_gain_open(
    panda: Robot, held: Runs, found: PayloadEstimate
) -> None:
    gains = np.array([20.0, 18.0, 17.0, 19.0, 9.0, 8.0, 7.0])
    loaded, free = (replace(r, tau=r.tau / gains, unit="A") for r in held)
    with pytest.raises(BadInput, match="--unloaded"):
        identify_payload(panda, [loaded])
    amperes = identify_payload(panda, [loaded], unloaded=[free])
    assert any("gain that is wrong by 1 %" in note for note in amperes.notes)
    # a common gain leaves the centre of mass alone
    np.testing.assert_allclose(amperes.centre, found.centre, atol=5e-3)
