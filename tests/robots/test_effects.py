"""Laws every effect obeys."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from excitant.exceptions import BadInput
from excitant.robots import Motion, Robot, rigid_body_torque, torque
from excitant.robots.effects import EFFECTS, Effect, JointEffect, standard_effects
from excitant.robots.effects.serialisation import effect_entries, effects_from_entries
from excitant.robots.parameters import STANDARD

States = Callable[[Robot, int, int], Motion]


@pytest.fixture(scope="module", params=sorted(EFFECTS))
def kind(request: pytest.FixtureRequest) -> type[Effect]:
    return EFFECTS[request.param]


def on(robot: Robot, kind: type[Effect]) -> Effect:
    return kind(robot.joints if issubclass(kind, JointEffect) else robot.joints[-1:])


def valued(robot: Robot, kind: type[Effect], seed: int) -> Effect:
    effect = on(robot, kind)
    rng = np.random.default_rng(seed)
    return effect.with_values(rng.uniform(0.1, 2, len(effect.parameters(robot))))


def test_vocabulary(kind: type[Effect]) -> None:
    assert kind.name == next(name for name, effect in EFFECTS.items() if effect is kind)


@given(seed=st.integers(0, 2**32 - 1), factor=st.floats(-3, 3))
def test_torque_is_linear_in_the_values(
    arm: Robot, random_states: States, kind: type[Effect], seed: int, factor: float
) -> None:
    motion = random_states(arm, seed, 6)
    one, two = valued(arm, kind, seed), valued(arm, kind, seed + 1)
    sum_ = one.with_values(np.array(one.values) + factor * np.array(two.values))
    expected = one.torque(arm, motion) + factor * two.torque(arm, motion)
    scale = np.abs(expected).max() + np.abs(one.torque(arm, motion)).max()
    assert np.abs(sum_.torque(arm, motion) - expected).max() <= 1e-12 * scale


def test_columns_are_the_torque_per_value(
    arm: Robot, random_states: States, kind: type[Effect]
) -> None:
    motion, effect = random_states(arm, 2, 6), valued(arm, kind, 2)
    columns, values = effect.columns(arm, motion), np.array(effect.values)
    assert columns.shape == (6, arm.nv, len(effect.parameters(arm)))
    for k, unit in enumerate(np.eye(len(values))):
        ahead, behind = (effect.with_values(values + s * unit) for s in (0.5, -0.5))
        difference = ahead.torque(arm, motion) - behind.torque(arm, motion)
        scale = np.abs(effect.torque(arm, motion)).max()
        assert np.abs(columns[:, :, k] - difference).max() <= 1e-12 * scale


def test_torque_of_the_robot_is_the_sum(
    arm: Robot, random_states: States, kind: type[Effect]
) -> None:
    motion, effect = random_states(arm, 4, 6), valued(arm, kind, 4)
    robot = arm.with_effects((*arm.effects, effect))
    added = torque(robot, motion) - torque(arm, motion)
    scale = np.abs(torque(robot, motion)).max()
    assert np.abs(added - effect.torque(arm, motion)).max() <= 1e-12 * scale


@pytest.mark.parametrize(
    "name", sorted(name for name, effect in EFFECTS.items() if issubclass(effect, JointEffect))
)
def test_joint_effects_stay_at_their_joint(arm: Robot, random_states: States, name: str) -> None:
    motion = random_states(arm, 5, 6)
    slow = Motion(motion.t, motion.q, motion.dq / 50, motion.ddq)
    for j, joint in enumerate(arm.joints):
        effect = EFFECTS[name]((joint,))
        tau = effect.with_values(np.ones(len(effect.parameters(arm)))).torque(arm, slow)
        assert not np.delete(tau, j, axis=1).any()
        assert tau[:, j].all()


@pytest.mark.parametrize("name", ["viscous_friction", "coulomb_friction", "stribeck_friction"])
@given(seed=st.integers(0, 2**32 - 1))
def test_friction_takes_power(arm: Robot, random_states: States, name: str, seed: int) -> None:
    motion = random_states(arm, seed, 20)
    assert (valued(arm, EFFECTS[name], seed).torque(arm, motion) * motion.dq >= 0).all()


@pytest.mark.parametrize("name", ["payload", "inertial_parameters"])
def test_added_inertia_is_that_of_a_changed_link(
    arm: Robot, random_states: States, name: str
) -> None:
    motion = random_states(arm, 6, 10)
    added = EFFECTS[name](arm.joints[-1:]).with_values(arm.phi[-10:] * 0.3)
    phi = np.array(arm.phi)
    phi[-10:] *= 1.3
    expected = rigid_body_torque(arm.with_parameters(phi), motion)
    tau = rigid_body_torque(arm, motion) + added.torque(arm, motion)
    assert np.abs(tau - expected).max() <= 1e-9 * np.abs(expected).max()
    names = [p.name for p in added.parameters(arm)]
    assert [n.rsplit("_", 1)[1] for n in names] == list(STANDARD)


def test_parameter_names_are_unique(arm: Robot) -> None:
    names = [p.name for e in standard_effects(arm.joints) for p in e.parameters(arm)]
    assert len(set(names)) == len(names)


def test_unknown_values_make_no_torque_up(
    arm: Robot, random_states: States, kind: type[Effect]
) -> None:
    with pytest.raises(ValueError, match="no values"):
        on(arm, kind).torque(arm, random_states(arm, 0, 1))


def test_entries_read_back_to_the_same_effects(arm: Robot) -> None:
    effects = tuple(valued(arm, kind, k) for k, kind in enumerate(EFFECTS.values()))
    assert effects_from_entries(effect_entries(effects), arm, EFFECTS, "given") == effects


@pytest.mark.parametrize(
    ("entry", "culprit"),
    [
        ({"effect": "viscos_friction", "values": 1}, "did you mean 'viscous_friction'"),
        ({"values": [1]}, "effect"),
        ({"effect": "rotor_inertia", "joints": ["no joint"], "values": [1]}, "no joint"),
        ({"effect": "rotor_inertia", "values": [1] * 99}, "99 values"),
        ({"effect": "rotor_inertia"}, "values"),
        ({"effect": "rotor_inertia", "values": ["much"]}, "values"),
        ({"effect": "rotor_inertia", "values": [1], "velocity": 1}, "rotor_inertia"),
    ],
)
def test_bad_entries_are_refused(builtin: Robot, entry: dict[str, object], culprit: str) -> None:
    with pytest.raises(BadInput, match=culprit):
        effects_from_entries([entry], builtin, EFFECTS, "robot.yaml")
