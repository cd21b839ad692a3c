"""Laws of the plant, judged by what owes nothing to it.

Recorded torque minus Pinocchio's inverse dynamics of the nominal bodies at the recorded motion
must be the effect's own law; MuJoCo simulates two-mass joints, and energy must balance.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import mujoco
import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plant_recordings import (
    RATE,
    SMOOTH,
    Recorded,
    at,
    away_from_changes,
    hidden,
    hold,
    swing,
    true_arm,
)

from excitant.exceptions import BadInput, BadRobot, UnknownName
from excitant.robots import Motion, Robot, base_parameters, load_robot, torque
from excitant.robots.effects import EFFECTS, RotorInertia
from excitant.robots.parameters import violations
from excitant.robots.plant import arm as plant_arm
from excitant.robots.plant.arm import Arm, stick_or_slip, tracking_controller
from excitant.robots.plant.planting import KINDS, parameters_of, plant
from excitant.robots.urdf import robot_from_urdf
from excitant.robots.virtual_arm import (
    HiddenEffect,
    Sensors,
    draw_hidden_effect,
    ideal_sensors,
    industrial_sensors,
    nominal_truth,
    typical_torque,
    virtual_arm,
)


@pytest.fixture(scope="module")
def robot(planar: Robot) -> Robot:
    return planar


def test_thermal_friction_drift(robot: Robot) -> None:
    run = Recorded(robot, hidden("thermal_friction_drift", robot.joints[0], Fv=2.0, Fc=3.0, time=2))
    v = run.dq[:, 0]
    run.agree(at(robot, 0, (2.0 * v + 3.0 * np.sign(v)) * np.exp(-run.t / 2)), 3e-3)


def test_a_jammed_shaft_couples_the_joints(ur10: Robot) -> None:
    """With dry friction that nothing overcomes, q̇_j + r q̇_k stays zero while both joints move."""
    run = Recorded(ur10, hidden("friction_coupling", *ur10.joints[4:], Fc=1e3, ratio=1.0))
    assert np.abs(run.dq[:, 4]).max() > 0.05
    assert np.abs(run.dq[:, 4] + run.dq[:, 5]).max() < 1e-9


def test_a_tilted_base_turns_gravity(ur10: Robot) -> None:
    """By 0.1 rad about x: the torque is that of an arm on a slope."""
    run = Recorded(ur10, hidden("gravity_direction", roll=0.1))
    g = 9.81 * np.array([0.0, -np.sin(0.1), -np.cos(0.1)])
    tilted = ur10.with_gravity(g)
    run.agree(run.rigid(tilted) - run.rigid())
    assert np.abs(run.rest[:, 0]).max() > 1.0


def test_a_misplaced_joint(ur10: Robot) -> None:
    run = Recorded(ur10, hidden("kinematic_error", ur10.joints[2], dx=0.03, dz=-0.01))
    model = ur10.model.copy()
    T = model.jointPlacements[3]
    moved = np.array(T.translation) + np.array([0.03, 0.0, -0.01])
    model.jointPlacements[3] = pin.SE3(np.array(T.rotation), moved)
    run.agree(run.rigid(replace(ur10, model=model)) - run.rigid())


@pytest.mark.parametrize(("effect", "scale", "offset"), [("offset", 1.0, 0.08), ("scale", 1.03, 0)])
def test_encoders_that_lie(ur10: Robot, effect: str, scale: float, offset: float) -> None:
    """The controller believes them: the reading follows the trajectory, the arm does not."""
    value = {"offset": offset, "scale": scale}[effect]
    run = Recorded(ur10, hidden(f"encoder_{effect}", ur10.joints[1], **{effect: value}))
    assert np.abs(run.q - swing(ur10)(run.t, 0)).max() < 5e-3
    run.q, run.dq, run.ddq = (np.array(x) for x in (run.q, run.dq, run.ddq))
    run.q[:, 1] = (run.q[:, 1] - offset) / scale
    run.dq[:, 1] /= scale
    run.ddq[:, 1] /= scale
    run.agree(np.zeros_like(run.tau))


def test_torque_gain_and_crosstalk(robot: Robot) -> None:
    true = Recorded(robot).tau
    gain = hidden("torque_gain", robot.joints[1], gain=1.2)
    assert np.allclose(Recorded(robot, gain).tau, true * np.where(np.arange(robot.nv) == 1, 1.2, 1))
    everywhere = hidden("torque_gain", *robot.joints, gain=0.9)
    assert np.allclose(Recorded(robot, everywhere).tau, 0.9 * true)
    talk = hidden("sensor_crosstalk", robot.joints[1], robot.joints[0], gain=0.1)
    assert np.allclose(Recorded(robot, talk).tau, true + at(robot, 1, 0.1 * true[:, 0]))


@pytest.mark.parametrize("delay", [0.0137, -0.0137])
def test_a_delay_is_where_the_correlation_peaks(robot: Robot, delay: float) -> None:
    """Of torque against the torque on time, or of position against the position on time."""
    sensors = ideal_sensors(robot, 2 * RATE)  # where the controller jumps, samples must be near
    on_time = Recorded(robot, sensors=sensors)
    late = Recorded(robot, hidden("time_delay", robot.joints[1], delay=delay), sensors=sensors)
    names = ("tau", "q", "dq") if delay > 0 else ("q", "tau", "tau")
    x, y = (getattr(r, names[0])[:, 1] for r in (on_time, late))
    delays, t = np.arange(0.01, 0.02, 1e-4), on_time.t[100:]
    error = [np.mean((y[100:] - np.interp(t - d, on_time.t, x)) ** 2) for d in delays]
    assert delays[int(np.argmin(error))] == pytest.approx(abs(delay), abs=2e-4)
    for name in names[1:]:
        assert np.array_equal(getattr(late, name), getattr(on_time, name))


def test_a_wall_pushes_only_where_it_is(ur10: Robot) -> None:
    """τ = −Jᵀ f with f = k depth + c speed along the normal, by finite differences of the tip."""
    free = Recorded(ur10)
    model, data = ur10.model, ur10.model.createData()

    def tips(q: np.ndarray) -> np.ndarray:
        places = []
        for x in q:
            pin.forwardKinematics(model, data, x)
            places.append(np.array(pin.updateFramePlacement(model, data, ur10.tip).translation))
        return np.array(places)

    distance = float(np.quantile(tips(free.q)[:, 0], 0.6))
    run = Recorded(
        ur10,
        hidden("wall_contact", nx=2.0, ny=0, nz=0, distance=distance, stiffness=150, damping=3),
    )
    place = tips(run.q)
    speed, depth = (tips(run.q + 1e-6 * run.dq) - place)[:, 0] / 1e-6, place[:, 0] - distance
    push = np.where(depth > 0, np.maximum(150 * depth + 3.0 * speed, 0.0), 0.0)
    J = np.array([(tips(run.q + 1e-6 * e)[:, 0] - place[:, 0]) / 1e-6 for e in np.eye(ur10.nv)]).T
    assert 0.1 < (depth > 0).mean() < 0.9
    run.agree(J * push[:, None], 1e-2, away_from_changes(depth > 0))


def test_a_telegraph_switches_at_random(ur10: Robot) -> None:
    run = Recorded(ur10, hidden("telegraph_torque", ur10.joints[1], amplitude=4.0, rate=6.0))
    rest = run.rest[run.sliding, 1]
    assert np.median(np.abs(np.abs(rest) - 4.0)) < 0.01
    assert 2 <= np.count_nonzero(np.diff(np.sign(rest))) <= 30


def two_masses(stiffness: float, damping: float) -> mujoco.MjModel:
    """A pendulum behind an elastic gear: MuJoCo's own two bodies on one axis."""
    return mujoco.MjModel.from_xml_string(f"""
    <mujoco><compiler autolimits="false"/><option timestep="0.0001" integrator="implicitfast"
      gravity="0 0 -9.81"/>
      <worldbody><body name="motor"><joint name="motor" axis="0 1 0" type="hinge"/>
        <inertial pos="0 0 0" mass="0.001" diaginertia="0.4 0.4 0.4"/>
        <body name="link"><joint name="gear" axis="0 1 0" type="hinge" stiffness="{stiffness}"
          damping="{damping}"/><inertial pos="0 0 -0.5" mass="4" diaginertia="0.1 0.1 0.1"/>
        </body></body></worldbody></mujoco>""")


PENDULUM = """
<robot name="pendulum"><link name="base"/>
  <link name="link"><inertial><origin xyz="0 0 -0.5"/><mass value="4"/><inertia ixx="0.1" ixy="0"
    ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
  <joint name="joint" type="revolute"><parent link="base"/><child link="link"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" velocity="10" effort="200"/></joint></robot>
"""


@pytest.fixture(scope="module")
def pendulum() -> Robot:
    return robot_from_urdf(PENDULUM, source="pendulum.urdf")


def chirp(t: np.ndarray, order: int = 0) -> np.ndarray:
    """0.4 (1 − cos 2π(t + t²)): up to 13 Hz·rad in three seconds, by its own derivatives."""
    t = np.asarray(t, dtype=float)[:, None]
    phase, rate = 2 * np.pi * (0.5 * t + 0.3 * t**2), 2 * np.pi * (0.5 + 0.6 * t)
    slopes = 1 - np.cos(phase), rate * np.sin(phase)
    return 0.4 * (*slopes, rate**2 * np.cos(phase) + 1.2 * np.pi * np.sin(phase))[order]


def test_elastic_joint_is_mujocos_two_bodies(pendulum: Robot) -> None:
    """The torque recorded drives MuJoCo's two masses along the recorded motor angle."""
    gear = hidden("joint_elasticity", "joint", stiffness=300.0, damping=1.5, motor=0.4)
    run = Recorded(pendulum, gear, trajectory=chirp, duration=3.0)
    model = two_masses(300.0, 1.5)
    data, angles = mujoco.MjData(model), []
    table = run.table
    tau = np.interp(np.arange(0, 3.0, 1e-4), table["t"], table["tau1"])
    for k, drive in enumerate(tau):
        if k % 10 == 0:
            angles.append(data.qpos[0])
        data.qfrc_applied[0] = drive
        mujoco.mj_step(model, data)
    q = table["q1"].to_numpy()[:-1]
    assert np.abs(np.array(angles) - q).max() <= 5e-3 * np.abs(q).max()
    rigid = Recorded(
        pendulum, hidden("rotor_inertia", "joint", Ia=0.4), trajectory=chirp, duration=3.0
    )
    assert np.abs(run.tau - rigid.tau).max() > 0.1 * np.abs(rigid.tau).max()


def test_an_elastic_joint_rings_at_its_resonance(pendulum: Robot) -> None:
    """With the motor held, √(k/J) to within a per cent, and damped as told."""
    inertia, stiffness, zeta, rate = 4 * 0.25 + 0.1, 900.0, 0.03, 40.0
    damping = 2 * zeta * np.sqrt(stiffness * inertia)
    limits = pendulum.limits
    strong = type(limits)(limits.position, limits.velocity, limits.acceleration, [1e6])
    bare = pendulum.with_gravity([0.0, 0.0, 0.0]).with_limits(strong)
    gear = hidden("joint_elasticity", "joint", stiffness=stiffness, damping=damping, motor=100.0)

    def kick(t: np.ndarray, order: int = 0) -> np.ndarray:
        x = rate * np.asarray(t)[:, None]
        rest = np.exp(-x)
        return 0.05 * (1 - rest * (1 + x), rate * x * rest, rate**2 * (1 - x) * rest)[order]

    run = true_arm(bare, gear).run(kick, 3.0, np.random.default_rng(0))
    tail = (run.link - run.q)[600:, 0]
    up = np.flatnonzero((tail[:-1] < 0) & (tail[1:] >= 0))
    period = np.diff(up - tail[up] / (tail[up + 1] - tail[up])).mean() / RATE
    assert 2 * np.pi / period == pytest.approx(np.sqrt(stiffness / inertia), rel=0.01)
    peaks = np.array([np.abs(tail[a:b]).max() for a, b in pairwise(up)])
    decrement = np.log(peaks[:-1] / peaks[1:]).mean()
    assert decrement == pytest.approx(2 * np.pi * zeta / np.sqrt(1 - zeta**2), rel=0.05)


def test_an_elastic_joint_sags_under_gravity(pendulum: Robot) -> None:
    """At rest the link hangs lower than its motor by τ_g / k."""
    gear = hidden("joint_elasticity", "joint", stiffness=500.0, damping=10.0, motor=0.4)
    place = lambda t, order=0: np.full((len(t), 1), 1.0 * (order == 0))  # noqa: E731
    run = true_arm(pendulum, gear).run(place, 1.0, np.random.default_rng(0))
    weight = 4 * 9.81 * 0.5 * np.sin(run.link[-1, 0])
    assert run.q[-1, 0] - run.link[-1, 0] == pytest.approx(weight / 500.0, rel=1e-3)
    assert np.abs(run.link - run.link[0]).max() < 5e-4


def test_backlash_opens_by_its_gap_at_reversals(pendulum: Robot) -> None:
    """Without gravity the link trails by half the gap, on the side from which it is pushed."""
    gear = hidden("backlash", "joint", gap=0.02, stiffness=1e5, damping=60.0, motor=0.4)
    bare = pendulum.with_gravity([0.0, 0.0, 0.0])
    run = true_arm(bare, gear).run(chirp, 3.0, np.random.default_rng(0))
    play = (run.q - run.link)[:, 0]
    ddq = chirp(run.t, 2)[:, 0]
    touching = (np.abs(ddq) > 0.5 * np.abs(ddq).max()) & (run.t > 0.5)
    assert np.mean(np.sign(play[touching]) == np.sign(ddq[touching])) > 0.8
    assert np.median(np.abs(play[touching])) == pytest.approx(0.01, rel=0.1)


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 6), shafts=st.integers(0, 2))
@settings(max_examples=200)
def test_dry_friction_of_joints_and_shafts_obeys_coulombs_law(
    seed: int, n: int, shafts: int
) -> None:
    """K δ + Gᵀλ = impulse for some −backward ≤ λ ≤ forward that opposes every motion."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((n, n))
    K = root @ root.T + 0.1 * np.eye(n)
    G = np.vstack([np.eye(n), rng.standard_normal((shafts, n))])
    v = rng.choice([0.0, 1e-3, -1e-3, 1.0, -1.0], n)
    forward, backward = rng.choice([0.0, 0.1, 1.0, 10.0], (2, n + shafts))
    impulse = rng.standard_normal(n) * rng.choice([0.1, 3.0, 30.0])
    delta = stick_or_slip(K, impulse, v, forward, backward, G)
    after = G @ (v + delta)
    scale = 1e-8 * (1 + np.abs(impulse).max() + np.abs(K).max() * (1 + np.abs(delta).max()))
    lower = np.where(after > 1e-9, forward, -backward)
    upper = np.where(after < -1e-9, -backward, forward)
    # the motion is that of some admissible friction: a bounded least-squares problem with no rest
    from scipy.optimize import lsq_linear

    needed = impulse - K @ delta
    fit = lsq_linear(G.T, needed, (lower - 1e-12, upper + 1e-12), tol=1e-14)
    assert np.abs(G.T @ fit.x - needed).max() <= scale


def test_every_effect_has_a_planter_and_refuses_wrong_parameters(robot: Robot) -> None:
    for kind in KINDS:
        with pytest.raises(UnknownName, match=f"parameter of {kind}"):
            Recorded(robot, hidden(kind, *robot.joints[:2], nonsense=1.0), duration=0.01)
        if None in parameters_of(kind).values():
            with pytest.raises(BadInput, match=f"{kind} lacks"):
                Recorded(robot, hidden(kind, *robot.joints[:2]), duration=0.01)
    with pytest.raises(BadInput, match="acts on two joints"):
        Recorded(robot, hidden("inertia_coupling", robot.joints[0], Ic=0.1))
    bare = robot.with_effects(())
    with pytest.raises(BadInput, match="give motor"):
        Recorded(bare, hidden("joint_elasticity", robot.joints[0], stiffness=1e3))
    gear = hidden("joint_elasticity", robot.joints[0], stiffness=1e3, motor=0.1)
    with pytest.raises(BadInput, match="two elastic gears"):
        Recorded(robot, gear, gear)


@pytest.mark.parametrize(
    ("name", "joints", "shape", "values"),
    [
        ("viscous_friction", 1, {}, [3.0]),
        ("coulomb_friction", 1, {}, [4.0]),
        ("stribeck_friction", 1, {"velocity": 0.12}, [3.0]),
        ("torque_offset", 1, {}, [-2.0]),
        ("rotor_inertia", 1, {}, [0.5]),
        ("asymmetric_friction", 1, {"viscous": True}, [2.0, -0.2, 1.5, 3.0]),
        ("nonlinear_viscous_friction", 1, {"exponent": 0.7}, [2.0]),
        ("nonlinear_viscous_friction", 1, {"exponent": 1.7}, [2.0]),
        ("load_dependent_friction", 1, {}, [0.3]),
        ("presliding_hysteresis", 1, {"distance": 0.02}, [0.6]),
        ("thermal_friction_drift", 1, {"time": 1.5}, [1.0, 2.0]),
        ("torque_ripple", 1, {"order": 8.0}, [1.0, -0.5]),
        ("spring", 1, {}, [4.0, -1.0]),
        ("spring", 1, {"lever": True}, [1.0, -2.0]),
        ("friction_coupling", 2, {"ratio": -1.0}, [0.3, 0.5]),
        ("friction_coupling", 2, {"ratio": 0.4}, [0.3, 0.5]),
        ("inertia_coupling", 2, {}, [0.06]),
        ("torque_gain", 2, {}, [0.1]),
    ],
)
def test_a_known_effect_is_the_one_that_is_fitted(
    planar: Robot, name: str, joints: int, shape: dict[str, float], values: list[float]
) -> None:
    """A nominal arm with the effect records the torque that the effect's own formula gives."""
    effect = EFFECTS[name](planar.joints[:joints], **shape).with_values(values)
    known = planar.with_effects((*planar.effects, effect))
    run = Recorded(known)
    # the shaft of a coupling may stick
    shaft = run.dq[:, 0] + shape.get("ratio", -1.0) * run.dq[:, 1]
    rows = run.sliding & away_from_changes(np.sign(shaft)) & (np.abs(shaft) > 1e-3)
    motion = run.motion
    expected = torque(known, motion)
    assert np.abs(expected - torque(planar, motion))[rows].max() > 0.1
    tolerance = 0.01 * np.abs(expected[rows]).max(axis=0)
    assert (np.abs(run.tau - expected)[rows].max(axis=0) <= tolerance).all()


def mujoco_torque(robot: Robot, motion: Motion) -> np.ndarray:
    compiler = '<mujoco><compiler balanceinertia="false" fusestatic="false"/></mujoco>'
    model = mujoco.MjModel.from_xml_string(robot.urdf.replace("</robot>", compiler + "</robot>"))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    data, tau = mujoco.MjData(model), np.empty(motion.q.shape)
    rows = [model.joint(joint).dofadr[0] for joint in robot.joints]
    for k in range(len(motion)):
        data.qpos[rows], data.qvel[rows] = motion.q[k], motion.dq[k]
        data.qacc[rows] = motion.ddq[k]
        mujoco.mj_inverse(model, data)
        tau[k] = data.qfrc_inverse[rows]
    return tau


def mujoco_error(robot: Robot) -> float:
    """Largest difference of the recorded torque from MuJoCo's, relative to the largest torque."""
    run = Recorded(robot, duration=3.0)
    motion, tau = run.motion, run.tau
    return float(np.abs(tau - mujoco_torque(robot, motion)).max() / np.abs(tau).max())


def test_frictionless_arm_needs_the_torque_that_mujoco_says(arm: Robot) -> None:
    assert mujoco_error(arm.with_effects(())) <= SMOOTH


def test_half_the_step_leaves_a_quarter_of_the_error(
    ur10: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    bare, errors = ur10.with_effects(()), []
    for step in (5e-4, 2.5e-4):
        monkeypatch.setattr(plant_arm, "_STEP", step)
        errors.append(mujoco_error(bare))
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.2)


def test_power_goes_into_energy_and_friction(builtin: Robot) -> None:
    """∫ τ·q̇ dt = ΔE + ∫ (F_v q̇² + F_c |q̇|) dt, with the rotors' kinetic energy in E."""
    run = Recorded(builtin, duration=3.0)
    motion, tau = run.motion, run.tau
    data = builtin.model.createData()
    numbers = {effect.name: np.array(effect.values) for effect in builtin.effects}
    energy = [
        pin.computeKineticEnergy(builtin.model, data, q, dq)
        + pin.computePotentialEnergy(builtin.model, data, q)
        + numbers["rotor_inertia"] @ dq**2 / 2
        for q, dq in zip(motion.q, motion.dq, strict=True)
    ]
    friction = numbers["viscous_friction"] * motion.dq**2
    friction += numbers["coulomb_friction"] * np.abs(motion.dq)
    power = np.sum(tau * motion.dq - friction, axis=1)
    work = np.concatenate([[0.0], np.cumsum((power[1:] + power[:-1]) / 2 / RATE)])
    lost = np.abs(np.array(energy) - energy[0] - work).max()
    exchanged = np.sum(np.abs(power)) / RATE
    assert lost <= 2e-4 * exchanged


def test_hidden_payload_is_a_heavier_last_link(builtin: Robot) -> None:
    payload = draw_payload(builtin)
    run = Recorded(builtin, payload, duration=3.0)
    motion, tau, rows = run.motion, run.tau, run.sliding
    formula = EFFECTS["payload"]((payload.joint,)).with_values([v for _, v in payload.parameters])
    expected = torque(builtin.with_effects((*builtin.effects, formula)), motion)
    difference = np.abs(tau - expected)[rows].max(axis=0)
    assert (difference <= 1e-3 * np.abs(expected).max(axis=0)).all()
    values = dict(payload.parameters)
    assert violations(list(values.values()), ("payload",)) == []


def test_a_stuck_joint_stays_while_the_others_move(planar: Robot) -> None:
    j = planar.nv - 1
    grip = HiddenEffect("coulomb_friction", planar.joints[j], (("Fc", 1e4),))
    run = Recorded(planar, grip, duration=1.0).table
    assert run[f"q{j + 1}"].nunique() == 1
    assert (run[f"dq{j + 1}"] == 0).all()
    travel = run.filter(regex=r"^q").max() - run.filter(regex=r"^q").min()
    assert (travel.drop(f"q{j + 1}") > 0.01).all()


def test_a_sliding_joint_comes_to_rest_without_creep_or_chatter() -> None:
    """With its motor off, a pendulum with dry friction stops, and then never moves again."""
    robot = load_robot("planar_2r").with_gravity([0.0, 0.0, 0.0])
    limits = robot.limits
    powerless = type(limits)(limits.position, limits.velocity, limits.acceleration, [1e-9, 1e-9])
    bare = robot.with_limits(powerless).with_effects(())
    rows = {"viscous_friction": 0.6, "coulomb_friction": 0.8}
    drives = tuple(
        HiddenEffect(name, joint, ((symbol, rows[name]),))
        for joint in bare.joints
        for name, symbol in (("viscous_friction", "Fv"), ("coulomb_friction", "Fc"))
    )
    nominal = nominal_truth(bare)
    step = Arm(plant(nominal, bare.joints, drives), 5e-4)
    control = tracking_controller(bare, nominal.model, nominal.drives, hold(bare), np.zeros(1))
    state = (np.zeros(2), np.array([1.0, -2.0]), np.zeros(2))
    speeds = []
    for _ in range(4000):
        state = step.step(*state, control, 0)
        speeds.append(state[1])
    moving = np.abs(np.array(speeds)).max(axis=1) > 0
    stopped = int(np.argmin(moving))
    assert 0 < stopped < 4000
    assert not moving[stopped:].any()


def test_same_seed_same_recording(planar: Robot) -> None:
    def once(seed: int) -> pd.DataFrame:
        rng = np.random.default_rng(seed)
        return virtual_arm(planar, rng).record(swing(planar), 0.5, rng)

    pd.testing.assert_frame_equal(once(3), once(3), check_exact=True)
    assert not once(3).equals(once(4))


def test_truth_is_near_the_nominal_arm_and_possible(arm: Robot) -> None:
    for seed in range(10):
        truth = virtual_arm(arm, np.random.default_rng(seed), hidden=()).truth
        phi = np.concatenate([b.toDynamicParameters() for b in list(truth.model.inertias)[1:]])
        assert violations(phi, arm.links) == []
        masses = phi[::10] / arm.phi[::10] - 1
        assert 0 < np.abs(masses).max() <= 0.03
        for effect in arm.effects:
            row = {"viscous_friction": "viscous", "coulomb_friction": "coulomb"}
            true = getattr(truth.drives, row.get(effect.name, "rotor"))
            assert np.abs(true / effect.values - 1).max() <= 0.05


def draw_payload(robot: Robot) -> HiddenEffect:
    drawn = (draw_hidden_effect(robot, np.random.default_rng(seed)) for seed in range(100))
    return next(effect for effect in drawn if effect.effect == "payload")


def test_drawn_effects_are_of_every_kind_and_show(planar: Robot) -> None:
    drawn = [draw_hidden_effect(planar, np.random.default_rng(seed)) for seed in range(60)]
    friction = {f"{kind}_friction" for kind in ("viscous", "coulomb", "stribeck")}
    assert {e.effect for e in drawn} == {*friction, "torque_offset", "rotor_inertia", "payload"}
    motion = Motion(np.arange(200.0), *planar.random_motion(np.random.default_rng(1), 200))
    half = Motion(motion.t, motion.q, motion.dq / 2, motion.ddq / 2)
    slow = Motion(motion.t, motion.q, motion.dq / 40, motion.ddq / 2)
    typical, noise = typical_torque(planar), industrial_sensors(planar).torque_noise
    for one in drawn:
        parameters = dict(one.parameters)
        shape = {k: parameters.pop(k) for k in ("velocity",) if k in parameters}
        effect = EFFECTS[one.effect]((one.joint,), **shape).with_values([*parameters.values()])
        at = slow if shape else half
        size = np.sqrt(np.mean(effect.torque(planar, at) ** 2, axis=0))
        assert (size >= 0.05 * typical).any(), one
        assert (size >= 3 * noise).any(), one
        assert (size <= np.maximum(typical, 6 * noise)).all(), one


def test_rotor_inertia_is_drawn_only_where_it_can_be_told(planar: Robot) -> None:
    """Its column must not be a combination of the columns of the links."""
    drawn = (draw_hidden_effect(planar, np.random.default_rng(seed)) for seed in range(60))
    joints = {effect.joint for effect in drawn if effect.effect == "rotor_inertia"}
    rigid = len(base_parameters(planar))
    separable = {
        joint
        for joint in planar.joints
        if len(base_parameters(planar, [RotorInertia((joint,))])) > rigid
    }
    assert planar.joints[0] not in separable
    assert joints == separable


def test_recording_has_the_columns_rate_and_noise_of_its_sensors(planar: Robot) -> None:
    nv = planar.nv
    noise, step = np.full(nv, 0.2), np.full(nv, 0.05)
    sensors = Sensors(200.0, 1e-3, 0.01, noise, step)
    kwargs = {"hidden": (), "tolerance": 0.0}
    real = virtual_arm(planar, np.random.default_rng(0), sensors=sensors, **kwargs)
    true = virtual_arm(
        planar, np.random.default_rng(0), sensors=ideal_sensors(planar, 200.0), **kwargs
    )
    seen, truth = (a.record(swing(planar), 2.0, np.random.default_rng(1)) for a in (real, true))
    numbers = range(1, nv + 1)
    assert list(seen) == ["t", *(f"{c}{j}" for c in ("q", "dq", "tau") for j in numbers)]
    assert np.allclose(seen["t"], np.arange(401) / 200, rtol=0, atol=1e-12)
    error = seen - truth
    assert np.abs(error.filter(regex=r"^q")).to_numpy().max() <= 0.5e-3 + 1e-12
    assert error.filter(regex=r"^dq").to_numpy().std() == pytest.approx(0.01, rel=0.1)
    assert error.filter(regex=r"^tau").to_numpy().std() == pytest.approx(0.2, rel=0.1)
    counts = seen.filter(regex=r"^tau").to_numpy() / 0.05
    assert np.allclose(counts, np.round(counts), atol=1e-6)


def test_torque_never_exceeds_the_limits(planar: Robot) -> None:
    limits = planar.limits
    weak = type(limits)(
        limits.position, limits.velocity, limits.acceleration, 0.5 * typical_torque(planar)
    )
    run = Recorded(planar.with_limits(weak), duration=0.5).table
    tau = run.filter(regex=r"^tau").to_numpy()
    assert (np.abs(tau) <= weak.torque).all()
    assert (np.abs(tau) == weak.torque).any()


def test_joint_that_moves_no_inertia_is_refused() -> None:
    robot = load_robot("planar_2r").with_effects(())
    empty = robot.with_parameters([*robot.phi[:10], 1e-16, *np.zeros(9)])
    with pytest.raises(BadRobot, match="joint2 moves nothing"):
        true_arm(empty).record(hold(empty), 0.1, np.random.default_rng(0))


def test_refusals(planar: Robot) -> None:
    arm, rng = true_arm(planar), np.random.default_rng(0)
    moving = swing(planar)
    with pytest.raises(BadInput, match="starts at"):
        arm.record(lambda t, order: moving(t + 0.1, order), 1.0, rng)
    with pytest.raises(BadInput, match="shorter than one sample"):
        arm.record(moving, 0.0, rng)
    with pytest.raises(UnknownName, match="did you mean 'payload'"):
        virtual_arm(planar, rng, hidden=[HiddenEffect("payloads", planar.joints[0], ())])
    with pytest.raises(UnknownName, match="joint"):
        virtual_arm(
            planar, rng, hidden=[HiddenEffect("rotor_inertia", "elsewhere", (("Ia", 1.0),))]
        )
    empty = planar.with_effects([EFFECTS["viscous_friction"](planar.joints)])
    with pytest.raises(BadRobot, match="viscous_friction has no values"):
        virtual_arm(empty, rng)
