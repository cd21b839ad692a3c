"""Laws every effect obeys, whatever it is; a new one is held to them once it is registered."""

import json
from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np
import pytest
import yaml
from khosla import close
from known_arms import Call
from marks import refused

from excitant.exceptions import BadInput
from excitant.identify.export import comment, folded, held_by
from excitant.robots import Motion, Robot, load_robot, rigid_body_torque, torque
from excitant.robots import effects as fx
from excitant.robots.effects import EFFECTS, Effect
from excitant.robots.effects.base import length
from excitant.robots.effects.experiments import BETWEEN
from excitant.robots.parameters import STANDARD

Proposals = list[tuple[Effect, int]]
JOINTWISE = sorted(name for name, kind in EFFECTS.items() if kind.acts_on is fx.Acts.EACH)
CARRIED = ("gravity_direction", "payload", "inertial_parameters")


@pytest.fixture(scope="module", params=sorted(EFFECTS))
def kind(request: pytest.FixtureRequest) -> type[Effect]:
    return EFFECTS[request.param]


def on(robot: Robot, kind: type[Effect]) -> Effect:
    return kind(robot.joints[-kind.acts_on.count :])


def test_units_follow_the_joint() -> None:
    robot = load_robot("scara")  # its third joint slides
    kinds = (fx.ViscousFriction, fx.CoulombFriction, fx.RotorInertia, fx.NonlinearViscousFriction)
    found = [[p.unit for p in kind(robot.joints).parameters(robot)][1:3] for kind in kinds]
    turning = ["N·m·s/rad", "N·m", "kg·m²", "N·m·(s/rad)^a"]
    sliding = ["N·s/m", "N", "kg", "N·(s/m)^a"]
    assert found == [list(pair) for pair in zip(turning, sliding, strict=True)]
    assert [robot.torque_unit(joint=j) for j in range(4)] == ["N·m", "N·m", "N", "N·m"]
    assert (robot.torque_unit(), robot.torque_unit("A")) == ("N·m or N", "A")
    stribeck = [fx.StribeckFriction((joint,)) for joint in robot.joints[1:3]]
    assert [e.shape_unit(robot, e.search.shapes[0]) for e in stribeck] == ["rad/s", "m/s"]


def valued(robot: Robot, kind: type[Effect], seed: int) -> Effect:
    effect = on(robot, kind)
    rng = np.random.default_rng(seed)
    return effect.with_values(rng.uniform(0.1, 2, len(effect.parameters(robot))))


def sizes_of(robot: Robot, effect: Effect) -> tuple[fx.Size, ...]:
    """Sizes of an effect that the given model lacks, all coefficients known to 0.1."""
    units = [p.unit for p in effect.parameters(robot)]
    k = len(units)
    return effect.sizes(np.array(effect.values), np.zeros(k), 0.01 * np.eye(k), units)


@pytest.mark.parametrize("phase", [0.0, 0.7, np.pi / 2, 2.0, np.pi])
def test_ripple_and_lever_are_told_by_their_amplitude_whatever_the_phase(planar, phase):
    joint, values = planar.joints[:1], (2.5 * np.cos(phase), 2.5 * np.sin(phase))
    ripple = fx.TorqueRipple(joint, values, order=12.0)
    for effect in (ripple, fx.Spring(joint, values, lever=True)):
        [size] = sizes_of(planar, effect)
        assert (size.value, size.std) == pytest.approx((2.5, 0.1))
        said = effect.words.sentence(effect, planar, joint, [size])
        assert f"{effect.label} of 2.5 ± 0.1 N·m" in said
    [moved] = sizes_of(planar, fx.KinematicError(joint, (0.3, 0.0, -0.4)))
    assert moved.value == pytest.approx(0.5)
    both = sizes_of(planar, fx.FrictionCoupling(planar.joints, (0.0, 3.0)))
    assert [(size.name, size.value) for size in both] == [("Fv", 0.0), ("Fc", 3.0)]


def test_a_body_is_told_by_what_makes_torque(planar: Robot) -> None:
    """No torque of a pendulum depends on where at its axis how much mass is."""
    pendulum = load_robot("planar_2r", lock={"joint2": 0.0})
    for robot, told in ((planar, "2 kg"), (pendulum, "0.3 kg·m")):
        body = np.array([2.0, 0.3, *np.zeros(8)])
        load = fx.Payload(robot.joints[-1:], tuple(body))
        assert load.search.feasible(load, robot, body, 0 * body) == (robot is planar)
        link = fx.InertialParameters(load.joints, load.values)
        said = link.words.sentence(link, robot, link.joints, sizes_of(robot, link))
        assert f"mcx is off by {told[:3]}" in said or "it is 2 ± 0.1 kg heavier" in said, said


def test_amplitude_has_the_spread_of_its_samples() -> None:
    """√(uᵀ C u) far from zero; near zero no less than what amplitudes of noise are."""
    rng = np.random.default_rng(0)
    covariance = np.array([[0.04, 0.03], [0.03, 0.09]])
    for x in (np.array([3.0, -2.0]), np.array([0.1, 0.05])):
        size, std = length(x, covariance)
        samples = np.linalg.norm(rng.multivariate_normal(x, covariance, 20_000), axis=1)
        assert size == pytest.approx(np.linalg.norm(x))
        expected = np.sqrt(np.mean((samples - size) ** 2))
        assert std == pytest.approx(expected, rel=0.02) or 0 < size < 2 * std
        assert std >= 0.9 * samples.std()
    assert length(np.zeros(2), covariance)[1] == pytest.approx(np.sqrt(0.1040512), rel=1e-3)


def test_vocabulary(kind: type[Effect], planar: Robot) -> None:
    assert EFFECTS[kind.name] is kind
    assert len(EFFECTS) == 26
    told = (name for names in kind.words.separated_by for name in names.split())
    assert {*kind.search.contains, *told} <= {*EFFECTS}
    assert set(kind.search.imitates) <= set(kind.search.contains)
    assert frozenset((kind.family,)) in BETWEEN
    assert kind.search.standard <= kind.search.usual <= (kind.acts_on is fx.Acts.EACH)
    effect = valued(planar, kind, 0)
    sentence = effect.words.sentence(effect, planar, effect.joints[:1], sizes_of(planar, effect))
    for said in (effect.words.noun(effect, planar), sentence):
        assert said == said.strip()
        assert "_" not in said.replace(kind.name, "")


def test_torque_is_columns_times_values(arm, random_states, kind):
    motion, effect = random_states(arm, 1, 6), valued(arm, kind, 2)
    columns, tau = effect.columns(arm, motion), effect.torque(arm, motion)
    assert columns.shape == (6, arm.nv, len(effect.values))
    assert columns.any() or kind.name in ("kinematic_error", "encoder_offset")  # none on a cart
    scale = np.abs(columns * np.array(effect.values)).max()
    assert np.abs(tau - columns @ np.array(effect.values)).max() <= 1e-12 * scale
    robot = arm.with_effects((*arm.effects, effect))
    whole = torque(robot, motion)
    assert np.abs(whole - torque(arm, motion) - tau).max() <= 1e-12 * np.abs(whole).max()
    refused("no values", effect.without_values().torque, arm, motion, error=ValueError)


@pytest.mark.parametrize("name", JOINTWISE)
def test_jointwise_effects_are_those_of_each_joint(ur10, random_states, name):
    states = random_states(ur10, 5, 6)
    motion = Motion(states.t, states.q, states.dq / 50, states.ddq)
    together = EFFECTS[name](ur10.joints)
    alone = together.singles()
    for j, effect in enumerate(alone):
        columns = effect.columns(ur10, motion)
        assert not np.delete(columns, j, axis=1).any()
        assert columns[:, j].any()
        assert effect.affected(ur10) == effect.rows(ur10) == [j]
    columns = np.concatenate([effect.columns(ur10, motion) for effect in alone], axis=2)
    np.testing.assert_array_equal(together.columns(ur10, motion), columns)
    names = [p.name for effect in alone for p in effect.parameters(ur10)]
    assert [p.name for p in together.parameters(ur10)] == names
    assert fx.merged(alone) == [together]


def test_columns_depend_on_the_model_where_an_effect_says_so(ur10, random_states, kind):
    """On inertias or other effects, which never move what an effect of the motion alone does."""
    motion, effect = random_states(ur10, 7, 8), on(ur10, kind)
    rubbing = [e.with_values([3.0] * ur10.nv) for e in fx.standard_effects(ur10.joints)]
    other = ur10.with_parameters(2 * ur10.phi).with_effects(rubbing)
    same = np.array_equal(effect.columns(ur10, motion), effect.columns(other, motion))
    assert same != kind.physics.on_model


def test_what_is_applied_to_the_arm_makes_the_torque_of_its_columns(planar, random_states, kind):
    effect, motion = valued(planar.with_effects(()), kind, 3), random_states(planar, 9, 20)
    changed = rigid_body_torque(effect.applied(planar), motion) - rigid_body_torque(planar, motion)
    expected = effect.torque(planar, motion) if kind.name in CARRIED else 0 * motion.q
    np.testing.assert_allclose(changed, expected, rtol=1e-9, atol=1e-9)


@pytest.fixture(scope="module")
def facts(ur10: Robot, random_states: Call) -> list[fx.JointFacts]:
    motion = random_states(ur10, 3, 200)
    found = fx.joint_facts([motion], [slice(None)], np.cos(9 * motion.q), 1e3, load=9.0)
    return [replace(seen, blur=0.0) for seen in found]  # states in no order have no reversals


@pytest.fixture(scope="module")
def proposed(ur10: Robot, facts: list[fx.JointFacts]) -> Proposals:
    return fx.proposals(ur10, facts)


def test_every_effect_proposes_shapes_that_can_be(ur10, proposed, facts, kind):
    own = {effect: trials for effect, trials in proposed if effect.name == kind.name}
    assert len(own) == sum(effect.name == kind.name for effect, _ in proposed) > 0
    for effect, trials in own.items():
        assert trials >= 1
        assert effect.values is None
        assert set(effect.joints) <= set(ur10.joints)
        alike = [other for other in own if other.joints == effect.joints]
        seen = replace(facts[ur10.joint_index(effect.joints[0])], q=np.array([-1.0, 1.0]))
        finer = effect.search.refined(effect, alike, seen)
        others = fx.alternatives(effect, seen)
        assert effect in others
        assert not set(finer) & {*alike}
        assert {(x.name, x.joints) for x in (*finer, *others)} == {(kind.name, effect.joints)}


def test_a_joint_at_rest_is_asked_for_what_shows_there(planar: Robot) -> None:
    zero = np.zeros((5, 2))
    facts = fx.joint_facts([Motion(np.arange(5.0), zero, zero, zero)])
    resting = {effect.name for effect, _ in fx.proposals(planar, facts)}
    assert {"torque_offset", "inertial_parameters"} <= resting
    assert not resting & {*JOINTWISE} - {"torque_offset"}


def test_what_is_believed_is_considered_again_with_shapes_beside_it(ur10, proposed, facts):
    grid = [e for e, _ in proposed if e.name == "stribeck_friction"][:8]
    ripple = EFFECTS["torque_ripple"](ur10.joints[:1]).reshaped("order", 9.0)
    found = fx.proposals(ur10, facts, [(grid[3], 1), (ripple, 600)])
    added = dict(found[len(proposed) :])
    speeds = sorted(e.velocity for e in added if e.name == "stribeck_friction")
    below, own, above = (effect.velocity for effect in grid[2:5])
    expected = [*np.geomspace(below, own, 4)[1:3], *np.geomspace(own, above, 4)[1:3]]
    np.testing.assert_allclose(speeds, expected, rtol=1e-12)
    orders = sorted(e.order for e in added if e.name == "torque_ripple")
    step = np.pi / 2 / facts[0].reach
    ends = [9 + sign * far for far in (step, step / 3) for sign in (-1, 1)]
    expected = sorted({9.0, *(order for end in ends for order in np.geomspace(9, end, 4)[1:3])})
    np.testing.assert_allclose(orders, expected, rtol=1e-12)
    assert {added[e] for e in added if e.name == "torque_ripple"} == {600}


def test_ripple_is_looked_for_where_the_error_has_it(ur10: Robot, proposed: Proposals) -> None:
    for joint in ur10.joints:
        orders = [e.order for e, _ in proposed if e.name == "torque_ripple" and joint in e.joints]
        assert min(abs(order - 9) for order in orders) < 0.5


@pytest.mark.parametrize("file_format", ["urdf", "mjcf", "sdf"])
def test_a_file_of_the_model_holds_it_or_says_that_it_does_not(planar, kind, file_format):
    effect = valued(planar, kind, 4)
    arm = folded(planar.with_effects((effect,)))
    said = "not in this file" in comment(arm, file_format, "model.yaml")
    assert said != (kind.role != "torque" or file_format in kind.export.formats)
    assert bool(kind.export.formats) == bool(kind.export.joint_property)
    held = held_by(arm, file_format).effects
    assert len(held) == (file_format in kind.export.formats)
    for kept in held:
        lowest = [p.lower for p in effect.parameters(planar)]
        np.testing.assert_allclose(kept.values, np.maximum(effect.values, lowest))


def test_parameter_names_are_unique_and_entries_read_back_to_the_same_effects(ur10: Robot) -> None:
    names = [p.name for kind in EFFECTS.values() for p in on(ur10, kind).parameters(ur10)]
    assert len(set(names)) == len(names)
    effects = []
    for k, kind in enumerate(EFFECTS.values()):
        defaults = {field.name: field.default for field in fields(kind)[2:]}
        shape = {n: not x if isinstance(x, bool) else x + 0.25 for n, x in defaults.items()}
        shaped = replace(on(ur10, kind), **shape)
        values = np.random.default_rng(k).standard_normal(len(shaped.parameters(ur10)))
        effects += [valued(ur10, kind, k), shaped.with_values(values)]
    entries = fx.effect_entries(effects)
    for written in (json.loads(json.dumps(entries)), yaml.safe_load(yaml.safe_dump(entries))):
        assert fx.effects_from_entries(written, ur10, "given") == tuple(effects)
    entry = {"effect": "torque_offset", "values": [1.0] * ur10.nv}  # joints not named: all
    assert fx.effects_from_entries([entry], ur10, "given")[0].joints == ur10.joints


@pytest.mark.parametrize("name", ["payload", "inertial_parameters"])
def test_added_inertia_is_that_of_a_changed_link(arm, random_states, name):
    motion = random_states(arm, 6, 10)
    added = EFFECTS[name](arm.joints[-1:]).with_values(arm.phi[-10:] * 0.3)
    phi = np.array(arm.phi)
    phi[-10:] *= 1.3
    expected = rigid_body_torque(arm.with_parameters(phi), motion)
    assert close(rigid_body_torque(arm, motion) + added.torque(arm, motion), expected, 1e-9)
    assert close(rigid_body_torque(added.applied(arm), motion), expected, 1e-9)
    assert [p.name.rsplit("_", 1)[1] for p in added.parameters(arm)] == list(STANDARD)


@pytest.mark.parametrize(
    ("name", "entry", "culprit"),
    [
        ("viscos_friction", {"values": 1}, "did you mean 'viscous_friction'"),
        ("", {"values": [1]}, "unknown effect"),
        ("rotor_inertia", {"joints": ["no joint"], "values": [1]}, "no joint"),
        ("rotor_inertia", {"joints": "joint1", "values": [1]}, "not 'joint1'"),
        ("rotor_inertia", {"joints": ["joint1"] * 2, "values": [1, 1]}, "a joint twice: joint1"),
        ("rotor_inertia", {}, "needs 'values: "),
        ("rotor_inertia", {"values": [1] * 99}, "99 values"),
        ("rotor_inertia", {"values": ["much"]}, "needs 'values: "),
        ("rotor_inertia", {"values": [10**400]}, "needs 'values: "),
        ("torque_gain", {"values": [float("nan")]}, "all finite"),
        ("rotor_inertia", {"values": [1], "velocity": 1}, "rotor_inertia"),
        ("friction_coupling", {"joints": ["joint1"], "values": [1, 1]}, "2 joints"),
        ("payload", {"values": [1] * 10}, "payload acts on one joint"),
        ("backlash", {"joints": [], "values": [0.1]}, "backlash acts on one joint"),
        ("stribeck_friction", {"values": [1], "velocity": 0}, "velocity must be posit"),
        ("stribeck_friction", {"values": [1], "velocity": "fast"}, "velocity"),
        ("torque_ripple", {"values": [1, 1], "order": float("inf")}, "order"),
        ("spring", {"values": [1, 1], "lever": "no"}, "lever"),
        ("time_delay", {"values": [1e-3], "trial": 0}, "trial must not be zero"),
    ],
)
def test_bad_entries_are_refused(planar, name, entry, culprit):
    with pytest.raises(BadInput, match=f"^robot.yaml: .*{culprit}"):
        fx.effects_from_entries([{"effect": name, **entry}], planar, "robot.yaml")


def test_presliding_is_a_good_part_of_dry_friction_over_more_than_a_blurred_reversal() -> None:
    planar = load_robot("planar_2r")
    given = planar.with_effects([fx.CoulombFriction(planar.joints).with_values([1.0, 1.0])])
    effect, std = fx.PreslidingHysteresis(planar.joints[:1], distance=0.01), np.array([0.01])
    assert fx.plausible(effect, given, np.array([0.5]), std)
    assert not fx.plausible(effect, given, np.array([0.1]), std)
    assert fx.plausible(effect, planar.with_effects([]), np.array([0.1]), std)
    facts = fx.JointFacts(speed=1.0, reach=2.0, blur=0.01)
    assert min(each.distance for each in effect.search.candidates(effect, facts)) >= 0.01


def rippled(unexplained: Callable[[np.ndarray], np.ndarray]) -> fx.JointFacts:
    """A joint that swings by 1.1 rad, and what is not explained of its torque."""
    t = np.linspace(0.0, 40.0, 1500)
    q, dq = np.sin(t) * 1.1, np.cos(t) * 1.1
    return fx.JointFacts(q=q, dq=dq, unexplained=unexplained(q), cutoff_hz=10.0)


def ripples(facts: fx.JointFacts) -> list[fx.TorqueRipple]:
    return list(fx.TorqueRipple.search.candidates(fx.TorqueRipple(("joint1",)), facts))


@pytest.mark.parametrize("order", [2.0, 3.0, 7.0])
def test_ripple_of_any_order_is_proposed_beside_a_spring(order: float) -> None:
    """Within a third of a turn, where two or three periods in a turn look much like a spring."""
    noise = 0.01 * np.random.default_rng(0).normal(size=1500)
    facts = rippled(lambda q: 3 + 2 * q - np.cos(q + 0.4) + 0.3 * np.sin(order * q + 0.7) + noise)
    step, best = np.pi / (2 * np.ptp(facts.q)), ripples(facts)[0]
    assert abs(best.order - order) <= step / 2 * (1 + 1e-9)
    for _ in range(4):  # as each round of a diagnosis does
        finer = best.search.refined(best, [], facts)
        best = min([best, *finer], key=lambda effect: abs(effect.order - order))
    assert abs(best.order - order) <= step / 18 * 1.01


@pytest.mark.parametrize("order", [5.3, 30.0, 60.0])
def test_orders_of_ripple_are_those_of_least_squares(order: float) -> None:
    noise = 0.1 * np.random.default_rng(1).normal(size=1500)
    facts = rippled(lambda q: 2.0 + q + 0.3 * np.cos(order * q) + noise)
    q, step = facts.q, np.pi / (2 * np.ptp(facts.q))
    orders = 1 + step * np.arange(1, 110)
    local, left = [np.ones_like(q), q, np.cos(q), np.sin(q)], []
    for each in orders:
        columns = np.column_stack([*local, np.cos(each * q), np.sin(each * q)])
        left.append(float(np.linalg.lstsq(columns, facts.unexplained, rcond=None)[1][0]))
    wanted: list[float] = []
    for each in orders[np.argsort(left)].tolist():
        if len(wanted) < 3 and all(abs(each - known) > 3 * step for known in wanted):
            wanted.append(each)
    np.testing.assert_allclose([effect.order for effect in ripples(facts)], wanted, rtol=1e-12)
