"""Each effect of the plant against an expectation that owes nothing to the plant.

Recorded torque minus Pinocchio's inverse dynamics of the nominal bodies at the recorded motion
must be the effect's own law, written here once more; for two-mass joints MuJoCo simulates them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import mujoco
import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plant_recordings import RATE, Recorded, at, away_from_changes, hidden, swing, true_arm

from excitant.exceptions import BadInput, UnknownName
from excitant.robots import Robot, torque
from excitant.robots.effects import EFFECTS
from excitant.robots.plant.arm import stick_or_slip
from excitant.robots.plant.physics import Bristles, Gear
from excitant.robots.plant.planting import PLANTERS, parameters_of
from excitant.robots.virtual_arm import ideal_sensors, virtual_arm


@pytest.fixture(scope="module")
def robot(planar: Robot) -> Robot:
    return planar


Law = Callable[[np.ndarray, np.ndarray], np.ndarray]
LAWS: list[tuple[str, dict[str, float], Law]] = [
    (
        "asymmetric_friction",
        {"Fc_plus": 2.0, "Fc_minus": -0.2, "Fv_plus": 1.5, "Fv_minus": 3.0},
        lambda q, v: np.where(v > 0, 2.0 + 1.5 * v, 0.2 + 3.0 * v),
    ),
    *(
        (
            "nonlinear_viscous_friction",
            {"Fn": 3.0, "exponent": exponent},
            lambda q, v, exponent=exponent: 3.0 * np.abs(v) ** exponent * np.sign(v),
        )
        for exponent in (0.3, 2.0)
    ),
    (
        "torque_ripple",
        {"amplitude": 2.0, "order": 9.0, "phase": 0.4},
        lambda q, v: 2.0 * np.sin(9.0 * q + 0.4),
    ),
    ("spring", {"stiffness": 8.0, "rest": 0.3}, lambda q, v: 8.0 * (q - 0.3)),
    ("spring", {"moment": 5.0, "rest": -0.2}, lambda q, v: 5.0 * np.sin(q + 0.2)),
]


@pytest.mark.parametrize(("kind", "parameters", "law"), LAWS)
def test_torque_by_a_joints_own_state(
    robot: Robot, kind: str, parameters: dict[str, float], law: Law
) -> None:
    """Beside a spring of the other joint: effects add."""
    coil = hidden("spring", robot.joints[0], stiffness=6.0)
    run = Recorded(robot, hidden(kind, robot.joints[1], **parameters), coil)
    expected = at(robot, 1, law(run.q[:, 1], run.dq[:, 1])) + at(robot, 0, 6.0 * run.q[:, 0])
    # nearer to rest a small exponent is too steep for a step to follow
    fast = np.abs(run.dq[:, 1]) > 0.02
    run.agree(expected, 1e-3 if kind == "spring" else 3e-3, fast)


def test_load_dependent_friction(robot: Robot) -> None:
    """Proportional to what the gear carries: the torque of the links, not of the rotor."""
    run = Recorded(robot, hidden("load_dependent_friction", robot.joints[1], Fl=0.1))
    run.agree(at(robot, 1, 0.1 * np.abs(run.rigid()[:, 1]) * np.sign(run.dq[:, 1])), 3e-3)


def test_thermal_friction_drift(robot: Robot) -> None:
    effect = hidden("thermal_friction_drift", robot.joints[0], Fv=2.0, Fc=3.0, time=2.0)
    for warm in (0.0, 1.5):
        run = Recorded(robot, effect, warm=warm)
        v = run.dq[:, 0]
        level = (2.0 * v + 3.0 * np.sign(v)) * np.exp(-(run.t + warm) / 2.0)
        run.agree(at(robot, 0, level), 3e-3)


def test_friction_of_a_coupled_shaft(robot: Robot) -> None:
    """Viscous and dry friction at q̇_j + r q̇_k, felt by j as it is and by k times r."""
    j, k = robot.nv - 2, robot.nv - 1
    names = robot.joints[j], robot.joints[k]
    run = Recorded(robot, hidden("friction_coupling", *names, Fv=0.8, Fc=1.2, ratio=-0.7))
    w = run.dq[:, j] - 0.7 * run.dq[:, k]
    torque = 0.8 * w + 1.2 * np.sign(w)
    expected = at(robot, j, torque) - at(robot, k, 0.7 * torque)
    run.agree(expected, 3e-3, away_from_changes(np.sign(w)))


def test_a_jammed_shaft_couples_the_joints(ur10: Robot) -> None:
    """With dry friction that nothing overcomes, q̇_j + r q̇_k stays zero while both joints move."""
    run = Recorded(ur10, hidden("friction_coupling", *ur10.joints[4:], Fc=1e3, ratio=1.0))
    assert np.abs(run.dq[:, 4]).max() > 0.05
    assert np.abs(run.dq[:, 4] + run.dq[:, 5]).max() < 1e-9


def test_coupled_rotors(robot: Robot) -> None:
    j, k = robot.nv - 2, robot.nv - 1
    run = Recorded(robot, hidden("inertia_coupling", robot.joints[j], robot.joints[k], Ic=0.03))
    run.agree(at(robot, j, 0.03 * run.ddq[:, k]) + at(robot, k, 0.03 * run.ddq[:, j]), 1e-2)


def test_a_tilted_base_turns_gravity(ur10: Robot) -> None:
    """By 0.1 rad about x: the torque is that of an arm on a slope."""
    run = Recorded(ur10, hidden("gravity_direction", roll=0.1))
    g = 9.81 * np.array([0.0, -np.sin(0.1), -np.cos(0.1)])
    tilted = ur10.with_gravity(g)
    run.agree(run.rigid(tilted) - run.rigid())
    assert np.abs(run.rest[:, 0]).max() > 1.0


def test_a_misplaced_joint(ur10: Robot) -> None:
    run = Recorded(ur10, hidden("kinematic_error", ur10.joints[2], dx=0.03, dz=-0.01, rx=0.02))
    model = ur10.model.copy()
    T = model.jointPlacements[3]
    turn = np.array([[1, 0, 0], [0, np.cos(0.02), -np.sin(0.02)], [0, np.sin(0.02), np.cos(0.02)]])
    moved = np.array(T.translation) + np.array([0.03, 0.0, -0.01])
    model.jointPlacements[3] = pin.SE3(turn @ np.array(T.rotation), moved)
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


def test_columns_with_wrong_sign_and_unit(robot: Robot) -> None:
    true, joint = Recorded(robot).table, robot.joints[1]
    wrong = Recorded(robot, hidden("wrong_sign", joint, q=-1.0, dq=-1.0)).table
    assert np.allclose(wrong[["q2", "dq2"]], -true[["q2", "dq2"]])
    pd.testing.assert_frame_equal(
        wrong.drop(columns=["q2", "dq2"]), true.drop(columns=["q2", "dq2"])
    )
    degrees = Recorded(robot, hidden("wrong_unit", q=180 / np.pi)).table
    assert np.allclose(degrees.filter(regex="^q"), np.rad2deg(true.filter(regex="^q")))


def test_presliding_keeps_to_dahls_law(ur10: Robot) -> None:
    """dF/dx = (F_h − F sign ẋ) / x_h along the recorded positions; F_h replaces dry friction."""
    run = Recorded(ur10, hidden("presliding_hysteresis", ur10.joints[1], Fh=15.0, distance=0.03))
    force, forces = 0.0, []
    for dx in np.diff(run.table["q2"].to_numpy(), prepend=run.table["q2"][0]):
        for _ in range(10):
            force += dx / 10 * (15.0 - force * np.sign(dx)) / 0.03
        forces.append(force)
    rest = run.rest[:, 1] + 15.0 * np.sign(run.dq[:, 1])  # the nominal level, taken over
    error = (rest - np.array(forces)[3:-3])[run.sliding]
    assert run.sliding.mean() > 0.5
    assert np.abs(error).max() <= 0.01 * 15.0
    assert np.sqrt(np.mean(error**2)) <= 3e-3 * 15.0


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=50)
def test_bristles_depend_on_the_path_not_on_its_pace(seed: int) -> None:
    """A closed cycle takes work; a slide cut into pieces ends where one slide does."""
    rng = np.random.default_rng(seed)
    bristles = Bristles(float(rng.uniform(0.1, 10)), float(rng.uniform(1e-3, 0.1)))
    force, way = float(rng.uniform(-1, 1)) * bristles.level, float(rng.uniform(-0.3, 0.3))
    cut = force
    for piece in way * rng.dirichlet(np.ones(5)):
        cut = bristles.after(cut, float(piece))
    assert cut == pytest.approx(bristles.after(force, way), rel=1e-9, abs=1e-12)
    path = np.sin(np.linspace(0, 6 * np.pi, 3001)) * 0.05
    forces = [force]
    for dx in np.diff(path):
        forces.append(bristles.after(forces[-1], float(dx)))
    f = np.array(forces)
    work = np.sum((f[1:] + f[:-1]) / 2 * np.diff(path))
    assert work > 0
    assert np.abs(f).max() <= bristles.level * (1 + 1e-12)


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


def test_a_cable_pulls_toward_its_anchor_and_takes_work(ur10: Robot) -> None:
    parameters = {"x": 0.2, "y": 0.4, "z": 1.5, "tension": 30.0, "friction": 12.0, "distance": 0.01}
    run = Recorded(ur10, hidden("cable_pull", **parameters))
    model, data = ur10.model, ur10.model.createData()
    anchor, lengths, grads = np.array([0.2, 0.4, 1.5]), [], []
    for q in run.q:
        J = pin.computeFrameJacobian(model, data, q, ur10.tip, pin.LOCAL_WORLD_ALIGNED)[:3]
        away = np.array(data.oMf[ur10.tip].translation) - anchor
        lengths.append(np.linalg.norm(away))
        grads.append(J.T @ away / np.linalg.norm(away))
    g, rows = np.array(grads), run.sliding
    tension = np.sum(run.rest * g, axis=1) / np.sum(g * g, axis=1)
    assert (
        np.abs(run.rest - g * tension[:, None])[rows].max() <= 0.05 * np.abs(run.rest[rows]).max()
    )
    longer = np.gradient(np.array(lengths), run.t)
    steady = rows & (np.abs(longer) > 0.1)
    assert np.median(tension[steady & (longer > 0)]) == pytest.approx(42.0, rel=0.05)
    assert np.median(tension[steady & (longer < 0)]) == pytest.approx(18.0, rel=0.05)


def test_a_telegraph_switches_at_random(ur10: Robot) -> None:
    run = Recorded(ur10, hidden("telegraph_torque", ur10.joints[1], amplitude=4.0, rate=6.0))
    rest = run.rest[run.sliding, 1]
    assert np.median(np.abs(np.abs(rest) - 4.0)) < 0.01
    assert 2 <= np.count_nonzero(np.diff(np.sign(rest))) <= 30


def two_masses(stiffness: float, damping: float, **joint: str) -> mujoco.MjModel:
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
    from excitant.robots.urdf import robot_from_urdf

    return robot_from_urdf(PENDULUM, source="pendulum.urdf")


def chirp(t: np.ndarray, order: int = 0) -> np.ndarray:
    """0.4 (1 − cos 2π(t + t²)): up to 13 Hz·rad in three seconds, by its own derivatives."""
    t = np.asarray(t, dtype=float)[:, None]
    phase, rate, growth = (
        2 * np.pi * (0.5 * t + 0.3 * t**2),
        2 * np.pi * (0.5 + 0.6 * t),
        1.2 * np.pi,
    )
    values = (
        0.4 * (1 - np.cos(phase)),
        0.4 * rate * np.sin(phase),
        0.4 * (rate**2 * np.cos(phase) + growth * np.sin(phase)),
    )
    return values[order]


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
    inertia = 4 * 0.25 + 0.1
    stiffness, zeta = 900.0, 0.03
    damping = 2 * zeta * np.sqrt(stiffness * inertia)
    bare = pendulum.with_gravity([0.0, 0.0, 0.0])
    gear = hidden("joint_elasticity", "joint", stiffness=stiffness, damping=damping, motor=100.0)
    kick = lambda t, order=0: [  # noqa: E731
        0.05 * (1 - np.exp(-40 * np.asarray(t)[:, None]) * (1 + 40 * np.asarray(t)[:, None])),
        0.05 * 1600 * np.asarray(t)[:, None] * np.exp(-40 * np.asarray(t)[:, None]),
        0.05 * 1600 * (1 - 40 * np.asarray(t)[:, None]) * np.exp(-40 * np.asarray(t)[:, None]),
    ][order]
    limits = bare.limits
    strong = type(limits)(limits.position, limits.velocity, limits.acceleration, [1e6])
    run = true_arm(bare.with_limits(strong), gear).run(kick, 3.0, np.random.default_rng(0))
    tail = (run.link - run.q)[600:, 0]
    up = np.flatnonzero((tail[:-1] < 0) & (tail[1:] >= 0))
    instants = up - tail[up] / (tail[up + 1] - tail[up])
    period = np.diff(instants).mean() / RATE
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


def test_a_gear_with_play_never_pulls() -> None:
    gear = Gear(0, 1000.0, 5.0, 0.02)
    assert gear.torque(0.005, 3.0) == (0.0, 0.0, 0.0)
    assert gear.torque(0.011, -3.0) == (0.0, 0.0, 0.0)
    assert gear.torque(-0.02, 0.0)[0] == pytest.approx(-10.0)
    for load in (-3.0, 0.0, 3.0):
        assert gear.torque(gear.deflection(load), 0.0)[0] == pytest.approx(load)


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
    delta = stick_or_slip(K, impulse, forward, v, backward, G)
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
    for kind in PLANTERS:
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
        ("asymmetric_friction", 1, {"viscous": True}, [2.0, 0.5, 1.0, 0.3]),
        ("nonlinear_viscous_friction", 1, {"exponent": 1.7}, [2.0]),
        ("load_dependent_friction", 1, {}, [0.3]),
        ("presliding_hysteresis", 1, {"distance": 0.02}, [0.6]),
        ("thermal_friction_drift", 1, {"time": 1.5}, [1.0, 2.0]),
        ("torque_ripple", 1, {"order": 8.0}, [1.0, -0.5]),
        ("spring", 1, {}, [4.0, -1.0]),
        ("spring", 1, {"lever": True}, [1.0, -2.0]),
        ("friction_coupling", 2, {"ratio": -1.0}, [0.3, 0.5]),
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
    shaft = run.dq[:, 0] - run.dq[:, 1]  # that of the coupling, which may stick
    rows = run.sliding & away_from_changes(np.sign(shaft)) & (np.abs(shaft) > 1e-3)
    motion = run.motion
    expected = torque(known, motion)
    assert np.abs(expected - torque(planar, motion))[rows].max() > 0.1
    tolerance = 0.01 * np.abs(expected[rows]).max(axis=0)
    assert (np.abs(run.tau - expected)[rows].max(axis=0) <= tolerance).all()


def test_a_drive_filters_and_an_encoder_is_differentiated(robot: Robot) -> None:
    """First-order lag of the torque, and velocity as the difference of two readings."""
    plain = ideal_sensors(robot, RATE)
    true = Recorded(robot)
    lagged = Recorded(robot, sensors=replace(plain, torque_cutoff_hz=20.0))
    slope = np.gradient(lagged.tau, lagged.t, axis=0)
    caught_up = lagged.tau + slope / (2 * np.pi * 20.0)
    rows = true.sliding
    assert np.abs(caught_up - true.tau)[rows].max() <= 0.02 * np.abs(true.tau).max()
    coarse = replace(plain, velocity="encoder", position_resolution=1e-4)
    counted = Recorded(robot, sensors=coarse).table
    steps = counted.filter(regex="^dq").to_numpy() / (1e-4 * RATE)
    assert np.allclose(steps, np.round(steps), atol=1e-6)
    silent = virtual_arm(
        robot, np.random.default_rng(0), hidden=(), sensors=replace(plain, velocity="none")
    ).record(swing(robot), 0.1, np.random.default_rng(0))
    assert not [name for name in silent if name.startswith("dq")]
    with pytest.raises(BadInput, match="tachometer, encoder or none"):
        replace(plain, velocity="gyro")
