"""Laws of the plant, judged by Pinocchio, MuJoCo, closed forms and the balance of energy."""

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pandas as pd
import pytest
import scipy
from hypothesis import example, given, settings
from hypothesis import strategies as st
from marks import refused
from plant_recordings import (
    PENDULUM,
    RATE,
    SMOOTH,
    Recorded,
    displaced,
    energy,
    inverse_dynamics,
    mujoco_model,
    steady,
    swing,
    true_arm,
)
from planted import DRAWN, drawn, hidden

from excitant.exceptions import BadInput, BadRobot, UnknownName
from excitant.robots import Motion, Robot, base_parameters, torque
from excitant.robots import virtual_arm as va
from excitant.robots.effects import EFFECTS, RotorInertia
from excitant.robots.parameters import violations
from excitant.robots.plant import arm as plant_arm
from excitant.robots.plant.physics import Gear
from excitant.robots.plant.planting import KINDS, parameters_of, plant

pytestmark = pytest.mark.usefixtures("own_steps")


def without_gravity(robot: Robot, strength: float) -> Robot:
    """The bare arm without gravity, with this limit of torque."""
    limits = replace(robot.limits, torque=np.full(robot.nv, strength))
    return robot.with_gravity([0.0, 0.0, 0.0]).with_limits(limits).with_effects(())


def mujoco_error(robot: Robot) -> float:
    """Largest difference of the recorded torque from MuJoCo's, relative to the largest torque."""
    run = Recorded(robot, duration=1.0)
    expected = inverse_dynamics(mujoco_model(robot), robot.joints, run.motion)
    return float(np.abs(run.tau - expected).max() / np.abs(run.tau).max())


def test_frictionless_arm_needs_the_torque_that_mujoco_says(arm: Robot) -> None:
    assert mujoco_error(arm.with_effects(())) <= SMOOTH


@pytest.mark.slow
def test_half_the_step_leaves_a_quarter_of_the_error(ur10: Robot, monkeypatch: Any) -> None:
    bare, errors = ur10.with_effects(()), []
    for step in (5e-4, 2.5e-4):
        monkeypatch.setattr(plant_arm, "LONGEST_STEP", step)
        errors.append(mujoco_error(bare))
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.2)


@pytest.mark.slow
def test_power_goes_into_energy_and_friction_on_the_motion_commanded(builtin: Robot) -> None:
    """∫ τ·q̇ dt = ΔE + ∫ (F_v q̇² + F_c |q̇|) dt, with the rotors' kinetic energy in E."""
    run, numbers = Recorded(builtin), {e.name: e.values for e in builtin.effects}
    dq, E = run.motion.dq, energy(builtin, np.array(numbers["rotor_inertia"]), run.motion)
    friction = numbers["viscous_friction"] * dq**2 + numbers["coulomb_friction"] * np.abs(dq)
    power = np.sum(run.tau * dq - friction, axis=1)
    work = scipy.integrate.cumulative_trapezoid(power, dx=1 / RATE, initial=0.0)
    assert np.abs(E - E[0] - work).max() <= 2e-4 * np.sum(np.abs(power)) / RATE
    table, wanted = run.table.filter(regex="^q").to_numpy(), swing(builtin)
    assert np.array_equal(table[:1], wanted(np.zeros(1), 0))
    assert np.abs(run.motion.q - wanted(run.motion.t, 0)).max() < 5e-3


@example(seed=45038, n=6, shafts=2)  # the sets alternate
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 6), shafts=st.integers(0, 2))
@settings(max_examples=200)
def test_dry_friction_of_joints_and_shafts_obeys_coulombs_law(seed, n, shafts):
    """K δ + Gᵀλ = impulse for some −backward ≤ λ ≤ forward that opposes every motion."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((n, n))
    K = root @ root.T + 0.1 * np.eye(n)
    G = np.vstack([np.eye(n), rng.standard_normal((shafts, n))])
    v = rng.choice([0.0, 1e-3, -1e-3, 1.0, -1.0], n)
    forward, backward = rng.choice([0.0, 0.1, 1.0, 10.0], (2, n + shafts))
    impulse = rng.standard_normal(n) * rng.choice([0.1, 3.0, 30.0])
    delta = plant_arm.stick_or_slip(K, impulse, v, forward, backward, G)
    after = G @ (v + delta)
    scale = 1e-8 * (1 + np.abs(impulse).max() + np.abs(K).max() * (1 + np.abs(delta).max()))
    lower = np.where(after > 1e-9, forward, -backward)
    upper = np.where(after < -1e-9, -backward, forward)
    # the motion is that of some admissible friction: a bounded least-squares problem with no rest
    needed = impulse - K @ delta
    fit = scipy.optimize.lsq_linear(G.T, needed, (lower - 1e-12, upper + 1e-12), tol=1e-14)
    assert np.abs(G.T @ fit.x - needed).max() <= scale


def test_a_stuck_joint_stays_while_the_others_move(planar: Robot) -> None:
    run = Recorded(planar, hidden("coulomb_friction", planar.joints[1], Fc=1e4), duration=1.0).table
    assert (run["q2"].nunique(), *run["dq2"].unique()) == (1, 0.0)
    assert np.ptp(run["q1"]) > 0.01


@pytest.mark.slow
def test_a_sliding_joint_comes_to_rest_without_creep_or_chatter(planar: Robot) -> None:
    """With its motor off, a pendulum with dry friction stops, and then never moves again."""
    bare = without_gravity(planar, 1e-9)
    nominal = va.nominal_truth(bare)
    friction = hidden("viscous_friction", Fv=0.6), hidden("coulomb_friction", Fc=0.8)
    step = plant_arm.Arm(plant(nominal, bare.joints, friction), 5e-4)
    control = plant_arm.tracking_controller(bare, nominal, swing(bare), np.zeros(1))
    state, moving = (np.zeros(2), np.array([1.0, -2.0]), np.zeros(2)), []
    for _ in range(4000):
        state = step.step(state, control, 0, 0.0)
        moving.append(bool(state[1].any()))
    assert (moving[0], moving[-1]) == (True, False)
    assert moving == sorted(moving, reverse=True)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "shape", "values"),
    [
        ("viscous_friction", {}, [3.0]),
        ("coulomb_friction", {}, [4.0]),
        ("stribeck_friction", {"velocity": 0.12}, [3.0]),
        ("torque_offset", {}, [-2.0]),
        ("rotor_inertia", {}, [0.5]),
        ("asymmetric_friction", {"viscous": True}, [2.0, -0.2, 1.5, 3.0]),
        ("nonlinear_viscous_friction", {"exponent": 0.3}, [3.0]),
        ("nonlinear_viscous_friction", {"exponent": 1.7}, [2.0]),
        ("load_dependent_friction", {}, [0.1]),
        ("presliding_hysteresis", {"distance": 0.02}, [0.6]),
        ("thermal_friction_drift", {"time": 1.5}, [1.0, 2.0]),
        ("torque_ripple", {"order": 8.5}, [1.0, -0.5]),
        ("spring", {}, [4.0, -1.0]),
        ("spring", {"lever": True}, [1.0, -2.0]),
        ("friction_coupling", {"ratio": -1.0}, [0.3, 0.5]),
        ("friction_coupling", {"ratio": 0.4}, [0.3, 0.5]),
        ("inertia_coupling", {}, [0.06]),
        ("torque_gain", {}, [0.1]),
    ],
)
def test_a_known_effect_is_the_one_that_is_fitted(planar, name, shape, values):
    """The plant and the effect that will be fitted are written apart and must agree."""
    kind = EFFECTS[name]
    effect = kind(planar.joints[: kind.acts_on.count or 1], **shape).with_values(values)
    known = planar.with_effects((*planar.effects, effect))
    run = Recorded(known, duration=1.0)
    run.robot, dq = planar, run.motion.dq
    shaft = dq[:, 0] + shape.get("ratio", -1.0) * dq[:, 1]  # of a coupling, which may stick
    # nearer to rest a small exponent is too steep for a step to follow
    rows = steady(shaft) & (np.abs(shaft) > 1e-3) & (np.abs(dq[:, 0]) > 0.02)
    expected = torque(known, run.motion) - torque(planar, run.motion)
    assert np.abs(expected[run.sliding & rows]).max() > 0.1
    run.agree(expected, where=rows)


def test_effects_compose_in_any_order(planar: Robot) -> None:
    ripple = hidden("torque_ripple", planar.joints[0], amplitude=3.0, order=7.0)
    spring = hidden("spring", planar.joints[1], stiffness=6.0)
    run = Recorded(planar, ripple, spring)
    q = run.motion.q
    run.agree(np.column_stack([3 * np.sin(7 * q[:, 0]), 6 * q[:, 1]]), 3e-3)
    swapped = Recorded(planar, spring, ripple)
    np.testing.assert_allclose(swapped.tau, run.tau, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_a_jammed_shaft_couples_the_joints(ur10: Robot) -> None:
    """With dry friction that nothing overcomes, q̇_j + r q̇_k stays zero while both joints move."""
    run = Recorded(ur10, hidden("friction_coupling", *ur10.joints[4:], Fc=1e3, ratio=1.0))
    speed = run.motion.dq[:, 4:]
    assert np.abs(speed[:, 0]).max() > 0.05
    assert np.abs(speed.sum(axis=1)).max() < 1e-9


def test_a_tilted_base_and_a_misplaced_joint(ur10: Robot) -> None:
    """The torque is that of an arm on a slope, by 0.1 rad about x, or of one that is built so."""
    slope, place = np.array([0.0, -np.sin(0.1), -np.cos(0.1)]), np.array([0.03, 0.0, -0.01])
    moved = hidden("kinematic_error", ur10.joints[2], dx=0.03, dz=-0.01)
    for effect, other in (
        (hidden("gravity_direction", roll=0.1), ur10.with_gravity(9.81 * slope)),
        (moved, displaced(ur10, 2, place)),
    ):
        run = Recorded(ur10, effect)
        run.agree(torque(other, run.motion) - torque(ur10, run.motion))
        assert np.abs(run.rest[:, 0]).max() > 1.0 or effect is moved


@pytest.mark.parametrize(("name", "value"), [("offset", 0.08), ("scale", 1.03)])
def test_encoders_that_lie(ur10: Robot, name: str, value: float) -> None:
    """The controller believes them: the reading follows the trajectory, the arm does not."""
    run = Recorded(ur10, hidden(f"encoder_{name}", ur10.joints[1], **{name: value}))
    t, q, dq, ddq = run.motion.t, run.motion.q, run.motion.dq, run.motion.ddq
    assert np.abs(q - swing(ur10)(t, 0)).max() < 5e-3
    scale, offset = np.ones(6), np.zeros(6)
    {"offset": offset, "scale": scale}[name][1] = value
    run.motion = Motion(t, (q - offset) / scale, dq / scale, ddq / scale)
    run.agree(np.zeros_like(run.tau))


def test_torque_gain_and_crosstalk(planar: Robot) -> None:
    true, (first, second) = Recorded(planar, duration=0.5).tau, planar.joints
    crosstalk = np.outer(true[:, 0], [0, 0.1])
    for effect, expected in (
        (hidden("torque_gain", second, gain=1.2), true * [1, 1.2]),
        (hidden("torque_gain", first, second, gain=0.9), 0.9 * true),
        (hidden("sensor_crosstalk", second, first, gain=0.1), true + crosstalk),
    ):
        assert np.allclose(Recorded(planar, effect, duration=0.5).tau, expected)


@pytest.mark.slow
@pytest.mark.parametrize(("delay", "late"), [(0.0137, ["tau2"]), (-0.0137, ["q2", "dq2"])])
def test_a_delay_is_where_the_error_is_least(planar: Robot, delay: float, late: list[str]) -> None:
    """Of torque beside the torque on time, or of position beside the position on time."""
    effect = hidden("time_delay", planar.joints[1], delay=delay)
    rate = 2 * RATE  # where the controller jumps, samples must be near
    true, run = (Recorded(planar, *effects, rate=rate).table for effects in ((), (effect,)))
    delays, t, x = np.arange(0.01, 0.02, 1e-4), true["t"], true[late[0]]
    error = [np.mean((run[late[0]] - np.interp(t - d, t, x))[100:] ** 2) for d in delays]
    assert delays[int(np.argmin(error))] == pytest.approx(abs(delay), abs=2e-4)
    pd.testing.assert_frame_equal(run.drop(columns=late), true.drop(columns=late), check_exact=True)


@pytest.mark.slow
def test_a_telegraph_switches_at_random(ur10: Robot) -> None:
    run = Recorded(ur10, hidden("telegraph_torque", ur10.joints[1], amplitude=4.0, rate=6.0))
    rest = run.rest[run.sliding, 1]
    assert np.median(np.abs(np.abs(rest) - 4.0)) < 0.01
    assert 2 <= np.count_nonzero(np.diff(np.sign(rest))) <= 30


def chirp(t: np.ndarray, order: int = 0) -> np.ndarray:
    """0.4 (1 − cos 2π(t + t²)): up to 13 Hz·rad in three seconds, by its own derivatives."""
    t = np.asarray(t, dtype=float)[:, None]
    phase, rate = 2 * np.pi * (0.5 * t + 0.3 * t**2), 2 * np.pi * (0.5 + 0.6 * t)
    slopes = 1 - np.cos(phase), rate * np.sin(phase)
    return 0.4 * (*slopes, rate**2 * np.cos(phase) + 1.2 * np.pi * np.sin(phase))[order]


TWO_MASSES = """<mujoco><compiler autolimits="false"/>
  <option timestep="0.0001" integrator="implicitfast" gravity="0 0 -9.81"/>
  <worldbody><body name="motor"><joint name="motor" axis="0 1 0" type="hinge"/>
    <inertial pos="0 0 0" mass="0.001" diaginertia="0.4 0.4 0.4"/>
    <body name="link"><joint name="gear" axis="0 1 0" type="hinge" stiffness="300" damping="1.5"/>
      <inertial pos="0 0 -0.5" mass="4" diaginertia="0.1 0.1 0.1"/></body></body></worldbody>
</mujoco>"""


@pytest.mark.slow
def test_elastic_joint_is_mujocos_two_bodies() -> None:
    """The torque of the motor drives MuJoCo's two masses along the same angles."""
    gear = hidden("joint_elasticity", "joint", stiffness=300.0, damping=1.5, motor=0.4)
    rotor = hidden("rotor_inertia", "joint", Ia=0.4)
    rng = np.random.default_rng(0)
    run, rigid = (true_arm(PENDULUM, x).run(chirp, 3.0, rng) for x in (gear, rotor))
    assert np.abs(run.tau - rigid.tau).max() > 0.1 * np.abs(rigid.tau).max()
    model = mujoco.MjModel.from_xml_string(TWO_MASSES)
    data, angles = mujoco.MjData(model), []
    for drive in np.interp(np.arange(0, 3.0, 1e-4), run.t, run.tau[:, 0]):
        angles.append(np.cumsum(data.qpos))
        data.qfrc_applied[0] = drive
        mujoco.mj_step(model, data)
    motor_and_link = np.hstack([run.q, run.link])[:-1]
    error = np.abs(angles[::10] - motor_and_link).max(axis=0)
    assert (error <= 5e-3 * np.abs(motor_and_link).max(axis=0)).all()


def test_an_elastic_joint_sags_under_gravity() -> None:
    """At rest the link hangs lower than its motor by τ_g / k."""
    gear = hidden("joint_elasticity", "joint", stiffness=500.0, damping=10.0, motor=0.4)
    place = lambda t, order=0: np.full((len(t), 1), 1.0 * (order == 0))  # noqa: E731
    run = true_arm(PENDULUM, gear).run(place, 1.0, np.random.default_rng(0))
    weight = 4 * 9.81 * 0.5 * np.sin(run.link[-1, 0])
    assert run.q[-1, 0] - run.link[-1, 0] == pytest.approx(weight / 500.0, rel=1e-3)
    assert np.abs(run.link - run.link[0]).max() < 5e-4


def test_backlash_opens_by_its_gap_at_reversals() -> None:
    """Without gravity the link trails by half the gap, on the side from which it is pushed."""
    gear = hidden("backlash", "joint", gap=0.02, stiffness=1e5, damping=60.0, motor=0.4)
    run = true_arm(without_gravity(PENDULUM, 200.0), gear).run(chirp, 3.0, np.random.default_rng(0))
    play, ddq = (run.q - run.link)[:, 0], chirp(run.t, 2)[:, 0]
    touching = (np.abs(ddq) > 0.5 * np.abs(ddq).max()) & (run.t > 0.5)
    assert np.mean(np.sign(play[touching]) == np.sign(ddq[touching])) > 0.8
    assert np.median(np.abs(play[touching])) == pytest.approx(0.01, rel=0.1)


def test_a_gear_with_play_never_pulls() -> None:
    gear = Gear(0, 1000.0, 5.0, 0.02, 0.0)
    assert gear.torque(0.005, 3.0) == gear.torque(0.011, -3.0) == (0.0, 0.0, 0.0)
    assert gear.torque(-0.02, 0.0)[0] == pytest.approx(-10.0)
    for load in (-3.0, 0.0, 3.0):
        assert gear.torque(gear.deflection(load), 0.0)[0] == pytest.approx(load)


@pytest.mark.slow
def test_hidden_payload_is_a_heavier_last_link(builtin: Robot) -> None:
    """Which a bare arm bears too: light wrists get the stiffness that their motors can give."""
    payload, phi = drawn(builtin, "payload", 0), np.array(builtin.phi)
    values = [value for _, value in payload.parameters]
    assert violations(values, ("payload",)) == []
    run = Recorded(builtin, payload)
    formula = EFFECTS["payload"]((payload.joint,)).with_values(values)
    heavier = torque(builtin.with_effects((*builtin.effects, formula)), run.motion)
    difference = np.abs(run.tau - heavier)[run.sliding].max(axis=0)
    assert (difference <= 1e-3 * np.abs(heavier).max(axis=0)).all()
    bare = Recorded(builtin.with_effects(()), payload, duration=0.5)
    assert np.abs(bare.motion.q - swing(builtin)(bare.motion.t, 0)).max() < 0.05
    assert np.array_equal(builtin.phi, phi)
    assert not builtin.model.armature.any()


def test_same_seed_same_recording(planar: Robot) -> None:
    rngs, path = map(np.random.default_rng, (3, 3, 4)), swing(planar)
    one, again, other = (va.virtual_arm(planar, rng).record(path, 0.5, rng) for rng in rngs)
    pd.testing.assert_frame_equal(one, again, check_exact=True)
    assert not one.equals(other)


def test_truth_is_near_the_nominal_arm_and_possible(arm: Robot) -> None:
    for seed in range(10):
        truth = va.virtual_arm(arm, np.random.default_rng(seed), hidden=()).truth
        phi = np.concatenate([b.toDynamicParameters() for b in list(truth.model.inertias)[1:]])
        assert violations(phi, arm.links) == []
        assert 0 < np.abs(phi[::10] / arm.phi[::10] - 1).max() <= 0.03
        for effect in arm.effects:
            true = getattr(truth.drives, effect.name.partition("_")[0])
            assert np.abs(true / effect.values - 1).max() <= 0.05


def test_impossible_nominal_inertia_still_runs(planar: Robot) -> None:
    strange = planar.with_parameters(planar.phi + 5.0 * (np.arange(20) == 9))
    assert violations(strange.phi, strange.links)
    assert np.isfinite(Recorded(strange, duration=0.2).table.to_numpy()).all()


def test_drawn_effects_are_of_every_kind_and_show(planar: Robot) -> None:
    """Rotor inertia only where its column is no combination of the columns of the links."""
    found = [va.draw_hidden_effect(planar, np.random.default_rng(seed)) for seed in range(60)]
    assert {e.effect for e in found} == {*DRAWN}
    q, dq, ddq = planar.random_motion(np.random.default_rng(1), 200)
    half, slow = (Motion(np.arange(200.0), q, dq / n, ddq / 2) for n in (2, 40))
    typical, noise = va.typical_torque(planar), va.industrial_sensors(planar).torque_noise
    for one in found:
        parameters = dict(one.parameters)
        shape = {k: parameters.pop(k) for k in ("velocity",) if k in parameters}
        effect = EFFECTS[one.effect]((one.joint,), **shape).with_values([*parameters.values()])
        tau = effect.torque(planar, slow if shape else half)
        size = np.sqrt(np.mean(tau**2, axis=0))
        assert (size >= 0.05 * typical).any(), one
        assert (size >= 3 * noise).any(), one
        assert (size <= np.maximum(typical, 6 * noise)).all(), one
    counts = [len(base_parameters(planar, [RotorInertia((joint,))])) for joint in planar.joints]
    assert counts == [rigid := len(base_parameters(planar)), rigid + 1]
    assert {e.joint for e in found if e.effect == "rotor_inertia"} == {planar.joints[1]}
    # no joint would feel it, and nobody could find it
    found = (va.draw_hidden_effect(PENDULUM, np.random.default_rng(seed)) for seed in range(40))
    assert "payload" not in {effect.effect for effect in found}


def test_recording_has_the_columns_rate_and_noise_of_its_sensors(planar: Robot) -> None:
    sensors = va.Sensors(200.0, 1e-3, 0.01, np.full(2, 0.2), np.full(2, 0.05))
    true, told = true_arm(planar, rate=200.0), list[float]()
    run = true.run(swing(planar), 2.0, np.random.default_rng(1), told.append)
    assert told == sorted(told)
    assert told[-1] == 1.0
    noisy, rng = replace(true, sensors=sensors), np.random.default_rng(1)
    seen, truth = (arm.recorded(run, rng) for arm in (noisy, true))
    assert list(seen) == ["t", "q1", "q2", "dq1", "dq2", "tau1", "tau2"]
    assert np.allclose(seen["t"], np.arange(401) / 200, rtol=0, atol=1e-12)
    q, dq, tau = np.split((seen - truth).to_numpy()[:, 1:], 3, axis=1)
    assert np.abs(q).max() <= 0.5e-3 + 1e-12
    assert dq.std() == pytest.approx(0.01, rel=0.1)
    assert tau.std() == pytest.approx(0.2, rel=0.1)
    counts = seen[["tau1", "tau2"]] / 0.05
    assert np.allclose(counts, counts.round(), atol=1e-6)


def test_torque_never_exceeds_the_limits(planar: Robot) -> None:
    weak = replace(planar.limits, torque=0.5 * va.typical_torque(planar))
    tau = np.abs(Recorded(planar.with_limits(weak), duration=0.5).tau)
    assert (tau <= weak.torque).all()
    assert (tau == weak.torque).any()


@pytest.mark.parametrize("kind", KINDS)
def test_parameters_unknown_or_lacking_are_refused(planar: Robot, kind: str) -> None:
    unknown, none = (hidden(kind, *planar.joints, **more) for more in ({"nonsense": 1.0}, {}))
    refused(f"parameter of {kind}", true_arm, planar, unknown, error=UnknownName)
    if None in parameters_of(kind).values():
        refused(f"{kind} lacks", true_arm, planar, none, error=BadInput)


def test_effects_refused(planar: Robot) -> None:
    bare, gear = planar.with_effects(()), {"stiffness": 1e3}
    refused("did you mean 'payload'", true_arm, bare, hidden("payloads", "joint1"))
    refused("joint", true_arm, bare, hidden("rotor_inertia", "elsewhere", Ia=1.0))
    refused("acts on two joints", true_arm, bare, hidden("inertia_coupling", "joint1", Ic=0.1))
    refused("give motor", true_arm, bare, hidden("joint_elasticity", "joint1", **gear))
    two = [hidden("backlash", "joint1", **gear, motor=0.1)] * 2
    refused("two elastic gears", true_arm, bare, *two)


def test_motions_and_arms_refused(planar: Robot) -> None:
    arm, rng, moving = true_arm(planar), np.random.default_rng(0), swing(planar)
    refused("starts at", arm.record, lambda t, k: moving(t + 0.1, k), 1.0, rng, error=BadInput)
    refused("shorter than one sample", arm.record, moving, 0.0, rng, error=BadInput)
    unknown = planar.with_effects([EFFECTS["viscous_friction"](planar.joints)])
    refused("viscous_friction has no values", va.virtual_arm, unknown, rng, error=BadRobot)
    weightless = [*planar.phi[:10], 1e-16, *np.zeros(9)]
    empty = true_arm(planar.with_effects(()).with_parameters(weightless))
    refused("joint2 moves nothing", empty.record, moving, 0.1, rng, error=BadRobot)
