"""Laws every effect obeys."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np
import pytest
import yaml

from excitant.exceptions import BadInput
from excitant.robots import Motion, Robot, rigid_body_torque, torque
from excitant.robots.effects import (
    EFFECTS,
    Effect,
    JointEffect,
    JointwiseEffect,
    effect_entries,
    effects_from_entries,
    standard_effects,
)
from excitant.robots.parameters import STANDARD

States = Callable[[Robot, int, int], Motion]
JOINTWISE = sorted(name for name, kind in EFFECTS.items() if issubclass(kind, JointwiseEffect))
MEMORYLESS = sorted(name for name, kind in EFFECTS.items() if issubclass(kind, JointEffect))
SHAPES = {
    "stribeck_friction": {"velocity": 0.23},
    "nonlinear_viscous_friction": {"exponent": 0.7},
    "presliding_hysteresis": {"distance": 0.03},
    "thermal_friction_drift": {"time": 7.0, "start": -2.0},
    "torque_ripple": {"order": 13.5},
    "spring": {"lever": True},
    "asymmetric_friction": {"viscous": False},
    "friction_coupling": {"ratio": -1.5},
    "time_delay": {"trial": -4e-3},
    "backlash": {"trial": 2e-3},
}


@pytest.fixture(scope="module", params=sorted(EFFECTS))
def kind(request: pytest.FixtureRequest) -> type[Effect]:
    return EFFECTS[request.param]


def on(robot: Robot, kind: type[Effect]) -> Effect:
    return kind(robot.joints[-kind.arity :])


def valued(robot: Robot, kind: type[Effect], seed: int) -> Effect:
    effect = on(robot, kind)
    rng = np.random.default_rng(seed)
    return effect.with_values(rng.uniform(0.1, 2, len(effect.parameters(robot))))


def test_vocabulary(kind: type[Effect]) -> None:
    assert kind.name == next(name for name, effect in EFFECTS.items() if effect is kind)
    assert len(EFFECTS) == 24
    assert set(kind.contains) <= set(EFFECTS)
    assert set(kind.imitates) <= set(kind.contains)


@pytest.mark.parametrize("factor", [-2.7, 0.0, 1e3])
def test_torque_is_linear_in_the_values(
    arm: Robot, random_states: States, kind: type[Effect], factor: float
) -> None:
    motion = random_states(arm, 1, 6)
    one, two = valued(arm, kind, 2), valued(arm, kind, 3)
    sum_ = one.with_values(np.array(one.values) + factor * np.array(two.values))
    expected = one.torque(arm, motion) + factor * two.torque(arm, motion)
    scale = np.abs(one.torque(arm, motion)).max() + abs(factor) * np.abs(
        two.torque(arm, motion)
    ).max(initial=0.0)
    assert np.abs(sum_.torque(arm, motion) - expected).max() <= 1e-12 * scale


def test_columns_are_the_torque_per_value(
    arm: Robot, random_states: States, kind: type[Effect]
) -> None:
    motion, effect = random_states(arm, 2, 6), on(arm, kind)
    columns = effect.columns(arm, motion)
    count = len(effect.parameters(arm))
    assert columns.shape == (6, arm.nv, count)
    for k, unit in enumerate(np.eye(count)):
        tau = effect.with_values(unit).torque(arm, motion)
        assert np.abs(columns[:, :, k] - tau).max() <= 1e-12 * np.abs(tau).max(initial=0.0)


def test_torque_of_the_robot_is_the_sum(
    arm: Robot, random_states: States, kind: type[Effect]
) -> None:
    motion, effect = random_states(arm, 4, 6), valued(arm, kind, 4)
    robot = arm.with_effects((*arm.effects, effect))
    added = torque(robot, motion) - torque(arm, motion)
    scale = np.abs(torque(robot, motion)).max()
    assert np.abs(added - effect.torque(arm, motion)).max() <= 1e-12 * scale


@pytest.mark.parametrize("name", JOINTWISE)
def test_jointwise_effects_stay_at_their_joint(
    arm: Robot, random_states: States, name: str
) -> None:
    motion = random_states(arm, 5, 6)
    slow = Motion(motion.t, motion.q, motion.dq / 50, motion.ddq)
    for j, joint in enumerate(arm.joints):
        effect = EFFECTS[name]((joint,))
        tau = effect.with_values(np.ones(len(effect.parameters(arm)))).torque(arm, slow)
        assert not np.delete(tau, j, axis=1).any()
        assert tau[:, j].any()


@pytest.mark.parametrize("name", JOINTWISE)
def test_jointwise_effects_of_many_joints_are_those_of_each(
    arm: Robot, random_states: States, name: str
) -> None:
    motion = random_states(arm, 6, 6)
    together = EFFECTS[name](arm.joints)
    alone = [EFFECTS[name]((joint,)) for joint in arm.joints]
    columns = np.concatenate([effect.columns(arm, motion) for effect in alone], axis=2)
    np.testing.assert_array_equal(together.columns(arm, motion), columns)
    names = [p.name for effect in alone for p in effect.parameters(arm)]
    assert [p.name for p in together.parameters(arm)] == names


@pytest.mark.parametrize("name", MEMORYLESS)
def test_memoryless_effects_do_not_know_the_order_of_instants(
    arm: Robot, random_states: States, name: str
) -> None:
    motion, effect = random_states(arm, 7, 8), valued(arm, EFFECTS[name], 7)
    order = np.random.default_rng(7).permutation(8)
    shuffled = effect.torque(arm, motion[order])
    np.testing.assert_array_equal(shuffled, effect.torque(arm, motion)[order])


@pytest.mark.parametrize(
    "name",
    ["encoder_offset", "encoder_scale", "kinematic_error", "joint_elasticity", "backlash"],
)
def test_effects_of_a_joints_place_reach_the_joints_before_it(
    gantry: Robot, random_states: States, name: str
) -> None:
    motion = random_states(gantry, 8, 30)
    columns = EFFECTS[name](gantry.joints[-1:]).columns(gantry, motion)
    assert columns.any(axis=(0, 2)).all()


def test_parameter_names_are_unique(arm: Robot) -> None:
    effects = [on(arm, kind) for kind in EFFECTS.values()]
    names = [p.name for effect in effects for p in effect.parameters(arm)]
    assert len(set(names)) == len(names)
    assert {type(e) for e in standard_effects(arm.joints)} <= {type(e) for e in effects}


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


def test_unknown_values_make_no_torque_up(
    arm: Robot, random_states: States, kind: type[Effect]
) -> None:
    with pytest.raises(ValueError, match="no values"):
        on(arm, kind).torque(arm, random_states(arm, 0, 1))


def test_entries_read_back_to_the_same_effects(arm: Robot) -> None:
    effects = []
    for k, (name, kind) in enumerate(EFFECTS.items()):
        shaped = replace(on(arm, kind), **SHAPES.get(name, {}))
        values = np.random.default_rng(k).standard_normal(len(shaped.parameters(arm)))
        effects += [valued(arm, kind, k), shaped.with_values(values)]
    entries = effect_entries(effects)
    for written in (json.loads(json.dumps(entries)), yaml.safe_load(yaml.safe_dump(entries))):
        assert effects_from_entries(written, arm, "given") == tuple(effects)


def test_every_shape_is_written(kind: type[Effect]) -> None:
    shape = {field.name for field in fields(kind)} - {"joints", "values"}
    assert shape == set(SHAPES.get(kind.name, {}))


def test_joints_not_named_are_all_of_them(builtin: Robot) -> None:
    entry = {"effect": "torque_offset", "values": [1.0] * builtin.nv}
    (effect,) = effects_from_entries([entry], builtin, "robot.yaml")
    assert effect.joints == builtin.joints


@pytest.mark.parametrize(
    ("entry", "culprit"),
    [
        ({"effect": "viscos_friction", "values": 1}, "did you mean 'viscous_friction'"),
        ({"values": [1]}, "effect"),
        ({"effect": "rotor_inertia", "joints": ["no joint"], "values": [1]}, "no joint"),
        ({"effect": "rotor_inertia", "joints": None, "values": [1]}, "rotor_inertia needs 'joints"),
        ({"effect": "rotor_inertia", "joints": "{first}", "values": [1]}, "not '{first}'"),
        (
            {"effect": "rotor_inertia", "joints": ["{first}", "{first}"], "values": [1, 1]},
            "names a joint twice: {first}",
        ),
        ({"effect": "rotor_inertia", "values": [1] * 99}, "99 values"),
        ({"effect": "rotor_inertia"}, "values"),
        ({"effect": "rotor_inertia", "values": ["much"]}, "values"),
        ({"effect": "torque_gain", "values": [float("nan")]}, "all finite"),
        ({"effect": "rotor_inertia", "values": [1], "velocity": 1}, "rotor_inertia"),
        ({"effect": "friction_coupling", "joints": ["{first}"], "values": [1, 1]}, "2 joints"),
        ({"effect": "inertia_coupling", "joints": ["{first}"], "values": [1]}, "2 joints"),
        ({"effect": "payload", "values": [1] * 10}, "payload acts on one joint"),
        ({"effect": "encoder_offset", "values": [0.1]}, "encoder_offset acts on one joint"),
        ({"effect": "backlash", "joints": [], "values": [0.1]}, "backlash acts on one joint"),
        ({"effect": "stribeck_friction", "values": [1], "velocity": 0}, "velocity must be posit"),
        ({"effect": "stribeck_friction", "values": [1], "velocity": "fast"}, "velocity"),
        ({"effect": "torque_ripple", "values": [1, 1], "order": float("inf")}, "order"),
        ({"effect": "spring", "values": [1, 1], "lever": "no"}, "lever"),
        ({"effect": "time_delay", "values": [1e-3], "trial": 0}, "trial must not be zero"),
        ({"effect": "presliding_hysteresis", "values": [1], "distance": -1}, "distance must be"),
    ],
)
def test_bad_entries_are_refused(builtin: Robot, entry: dict[str, object], culprit: str) -> None:
    first = builtin.joints[0]
    entry = json.loads(json.dumps(entry).replace("{first}", first))
    with pytest.raises(BadInput, match=culprit.replace("{first}", first)) as refusal:
        effects_from_entries([entry], builtin, "robot.yaml")
    assert str(refusal.value).startswith("robot.yaml: ")
