"""Forward dynamics of a model: closed forms, conservation, and simulators that share no code."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import scipy.integrate
import scipy.special

from excitant.design import random_trajectory
from excitant.exceptions import BadInput, ExcitantError
from excitant.identify import recording_from_table
from excitant.robots import Motion, Robot, load_robot, torque
from excitant.robots.effects import (
    CoulombFriction,
    Effect,
    EncoderScale,
    InertiaCoupling,
    Payload,
    PreslidingHysteresis,
    RotorInertia,
    TorqueGain,
    TorqueOffset,
    ViscousFriction,
)
from excitant.robots.simulation import REST, Controller, Diverged, forward_error, simulate
from excitant.robots.urdf import robot_from_urdf
from excitant.robots.virtual_arm import ideal_sensors, virtual_arm

PENDULUM = """
<robot name="pendulum">
  <link name="base"/>
  <link name="rod"><inertial><origin xyz="0.5 0 0"/><mass value="2"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
  <joint name="pivot" type="revolute"><parent link="base"/><child link="rod"/>
    <axis xyz="0 1 0"/><limit lower="-9" upper="9" velocity="20" effort="99"/></joint>
</robot>
"""


@pytest.fixture(scope="module")
def pendulum() -> Robot:
    return robot_from_urdf(PENDULUM, source="pendulum.urdf")


def at_rest(t: np.ndarray, q: np.ndarray) -> Motion:
    zeros = np.zeros((len(t), len(q)))
    return Motion(t, zeros + q, zeros, zeros)


def smooth(robot: Robot, t: np.ndarray, size: float = 0.5) -> Motion:
    """Sines of different frequencies, differentiated on paper."""
    w = 2 * np.pi * np.linspace(0.4, 0.7, robot.nv)
    angle = w * t[:, None]
    middle = np.clip(robot.limits.position, -3, 3).mean(axis=1)
    return Motion(
        t,
        middle + size * np.sin(angle),
        size * w * np.cos(angle),
        -size * w**2 * np.sin(angle),
    )


def standard(robot: Robot) -> tuple[Effect, ...]:
    j, each = robot.joints, np.ones(robot.nv)
    return (
        ViscousFriction(j, tuple(0.8 * each)),
        CoulombFriction(j, tuple(1.5 * each)),
        TorqueOffset(j, tuple(0.3 * each)),
        RotorInertia(j, tuple(0.2 * each)),
    )


def test_a_pendulum_swings_as_elliptic_functions_say(pendulum: Robot) -> None:
    """2.5 rad to either side, four periods: sin(θ/2) = k sn(K(k) − ω₀ t, k)."""
    inertia, moment, amplitude = 0.1 + 2 * 0.5**2, 2 * 9.81 * 0.5, 2.5
    k, omega = np.sin(amplitude / 2), np.sqrt(moment / inertia)
    K = scipy.special.ellipk(k**2)
    t = np.arange(0, 16 * K / omega, 2e-3)
    exact = 2 * np.arcsin(k * scipy.special.ellipj(K - omega * t, k**2)[0])
    errors = []
    for step in (1e-3, 5e-4):
        # the rod hangs along gravity at q = π/2
        motion = simulate(pendulum, at_rest(t, np.array([np.pi / 2 + amplitude])), step=step).motion
        errors.append(np.abs(motion.q[:, 0] - np.pi / 2 - exact).max())
    assert errors[1] < 1e-3
    assert errors[0] / errors[1] > 3.5  # second order


@pytest.mark.parametrize("name", ["ur10", "gantry"])
def test_energy_of_a_falling_arm_is_conserved(name: str, gantry: Robot) -> None:
    robot = (gantry if name == "gantry" else load_robot(name)).with_effects(())
    rotor = 0.3 * np.ones(robot.nv)
    moved = robot.with_effects((RotorInertia(robot.joints, tuple(rotor)),))
    model, t = robot.model.copy(), np.arange(0, 1.5, 5e-3)
    model.armature = rotor
    data, spread = model.createData(), []
    for step in (1e-3, 5e-4):
        motion = simulate(moved, at_rest(t, np.full(robot.nv, 0.3)), step=step).motion
        energy = np.array(
            [
                v @ pin.crba(model, data, q) @ v / 2 + pin.computePotentialEnergy(model, data, q)
                for q, v in zip(motion.q, motion.dq, strict=True)
            ]
        )
        spread.append(np.abs(energy - energy[0]).max())
    kinetic = np.abs(motion.dq).max() ** 2 * rotor[0]
    assert kinetic > 1  # it does fall
    assert spread[1] < 1e-3 * kinetic
    assert spread[1] < spread[0] / 3  # second order at least


def test_the_closed_loop_is_that_of_an_adaptive_solver(ur10: Robot) -> None:
    """Articulated-body algorithm under Dormand and Prince's method; a controller that errs."""
    robot, t = ur10.with_effects(()), np.arange(0, 1.5, 5e-3)
    command, omega = smooth(robot, t), 20.0
    rotor, viscous = np.linspace(0.2, 1, 6), np.linspace(1, 8, 6)
    moved = robot.with_effects(
        (RotorInertia(robot.joints, tuple(rotor)), ViscousFriction(robot.joints, tuple(viscous)))
    )
    model = robot.model.copy()
    model.armature = rotor
    data, believed = model.createData(), robot.model.createData()

    def desired(at: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        motion = smooth(robot, np.array([at]))
        return motion.q[0], motion.dq[0], motion.ddq[0]

    def slope(at: float, state: np.ndarray) -> np.ndarray:
        q, v = np.split(state, 2)
        qd, vd, ad = desired(at)
        B = pin.crba(robot.model, believed, qd)
        forward = pin.rnea(robot.model, believed, qd, vd, ad)
        tau = forward + B @ (omega**2 * (qd - q) + 2 * omega * (vd - v)) - viscous * v
        return np.concatenate([v, pin.aba(model, data, q, v, tau)])

    start = np.concatenate([command.q[0], command.dq[0]])
    solved = scipy.integrate.solve_ivp(slope, (0, t[-1]), start, t_eval=t, rtol=1e-8, atol=1e-9).y.T
    run = simulate(moved, command, Controller(omega, believed=robot))
    off = np.abs(command.q - solved[:, :6]).max()
    assert off > 0.01
    assert np.abs(run.motion.q - solved[:, :6]).max() < 2e-3 * off
    assert np.abs(run.motion.dq - solved[:, 6:]).max() < 2e-3 * np.abs(command.dq).max()
    inner = slice(2, -2)
    slopes = np.array([slope(at, state)[6:] for at, state in zip(t, solved, strict=True)])
    assert np.abs(run.motion.ddq - slopes)[inner].max() < 5e-3 * np.abs(slopes).max()


def test_a_falling_arm_is_that_of_mujoco(planar: Robot) -> None:
    rotor, viscous = (0.1, 0.05), (0.2, 0.1)
    spec = mujoco.MjSpec.from_string(planar.urdf)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    spec.option.timestep = 1e-3
    spec.option.gravity = planar.gravity
    spec.option.disableflags = (
        mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    )
    model = spec.compile()
    model.dof_armature[:], model.dof_damping[:] = rotor, viscous
    data = mujoco.MjData(model)
    data.qpos[:] = 0.4, -0.6
    found = []
    for k in range(1001):
        if k % 10 == 0:
            found.append(data.qpos.copy())
        mujoco.mj_step(model, data)
    j = planar.joints
    robot = planar.with_effects((RotorInertia(j, rotor), ViscousFriction(j, viscous)))
    t = np.arange(101) / 100
    motion = simulate(robot, at_rest(t, np.array([0.4, -0.6])), step=5e-4).motion
    assert np.ptp(motion.q, axis=0).min() > 0.5
    np.testing.assert_allclose(motion.q, np.array(found), atol=5e-5)


def test_dry_friction_is_that_of_the_plant(ur10: Robot) -> None:
    """The virtual arm knows stiction as a set and shares no code; 3 % wrong masses for both."""
    rng = np.random.default_rng(3)
    arm = virtual_arm(ur10, rng, hidden=(), sensors=ideal_sensors(ur10), tolerance=0.0)
    trajectory = random_trajectory(ur10, rng, 6.0, 4)
    seen = recording_from_table(arm.record(trajectory, 6.0, rng), ur10, file="run", name="run")
    assert seen.dq is not None
    motion = Motion(seen.t, seen.q, seen.dq, np.gradient(seen.dq, seen.t, axis=0))
    right = forward_error(ur10, motion, seen.tau, bandwidth_hz=1.0)
    wrong = forward_error(ur10.with_parameters(1.03 * ur10.phi), motion, seen.tau, bandwidth_hz=1.0)
    assert right.rms.max() < 1.5e-3
    assert wrong.rms.max() > 4 * right.rms.max()
    assert right.error.shape == seen.q.shape


def test_a_joint_held_by_dry_friction_creeps_no_faster_than_rest(pendulum: Robot) -> None:
    held = pendulum.with_effects((CoulombFriction(("pivot",), (12.0,)),))
    t = np.arange(0, 2, 1e-2)
    motion = simulate(held, at_rest(t, np.zeros(1))).motion  # gravity asks 9.81 N·m
    speed = 9.81 / 12 * REST
    np.testing.assert_allclose(motion.dq[5:, 0], speed, rtol=1e-2)


def test_friction_heavier_than_its_joint_neither_chatters_nor_overshoots(pendulum: Robot) -> None:
    """A rod of hardly any inertia: dry friction would turn it back within a thousandth step."""
    light = pendulum.with_parameters(1e-4 * pendulum.phi)
    robot = light.with_effects((CoulombFriction(("pivot",), (5.0,)),))
    t = np.arange(0, 3, 2e-3)
    command = smooth(robot, t)
    run = simulate(robot, command, Controller(40.0, floor=0.01))
    assert np.abs(run.error).max() < 0.35  # 5 N·m over 0.01 · 40² N·m/rad
    same = np.sign(run.motion.dq[:, 0]) == np.sign(command.dq[:, 0])
    assert same.mean() > 0.95


@pytest.mark.parametrize(
    "effect",
    [
        InertiaCoupling(("shoulder", "elbow"), (0.05,)),
        PreslidingHysteresis(("shoulder", "elbow"), (1.0, 1.0), 0.02),
        Payload(("elbow",), (1.0, 0.1, 0.05, 0.0, 0.02, 0.0, 0.02, 0.0, 0.0, 0.02)),
    ],
    ids=lambda effect: effect.name,
)
def test_the_motor_gives_what_inverse_dynamics_asks(effect: Effect, planar: Robot) -> None:
    """Torque of the controller is that of the model on the simulated motion, low-passed alike."""
    renamed = {"shoulder": planar.joints[0], "elbow": planar.joints[1]}
    own = type(effect)(
        **{**vars(effect), "joints": tuple(renamed[joint] for joint in effect.joints)}
    )
    t = np.arange(0, 4, 2e-3)
    base = standard(planar)[::3]  # without dry friction, whose jumps fall between two samples
    robot, believed = planar.with_effects((*base, own)), planar.with_effects(base)
    run = simulate(robot, smooth(planar, t), Controller(believed=believed))
    window = np.ones(50) / 50
    error = run.tau - torque(robot, run.motion)
    mean = np.array([np.convolve(column, window, "valid") for column in error.T])
    without = torque(robot, run.motion) - torque(believed, run.motion)
    assert np.sqrt((mean**2).mean()) < 0.05 * np.sqrt((without**2).mean())


def test_a_torque_sensor_does_not_move_the_arm(planar: Robot) -> None:
    t = np.arange(0, 1, 5e-3)
    plain = planar.with_effects(standard(planar))
    read = planar.with_effects((*standard(planar), TorqueGain(planar.joints, (0.2,))))
    runs = [
        simulate(robot, smooth(planar, t), Controller(believed=planar)) for robot in (plain, read)
    ]
    assert (runs[0].motion.q == runs[1].motion.q).all()


def test_irregular_time_is_followed(planar: Robot) -> None:
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(2e-3, 9e-3, 300))
    run = simulate(planar, smooth(planar, t), Controller())
    assert (run.motion.t == t).all()
    assert np.abs(run.error).max() < 1e-4


@pytest.mark.parametrize(
    ("make", "why"),
    [
        (lambda r, m: simulate(r, m[:1]), "two instants or more"),
        (lambda r, m: simulate(r, m[::-1]), "must rise"),
        (lambda r, m: simulate(r, m, applied=m.q[1:]), "one row per instant"),
        (lambda r, m: simulate(r.with_effects((ViscousFriction(r.joints),)), m), "has no values"),
        (
            lambda r, m: simulate(r.with_effects((EncoderScale(r.joints[:1], (0.1,)),)), m),
            "encoder_scale depends on the past",
        ),
    ],
)
def test_what_cannot_be_simulated_is_refused_in_one_line(
    make: Callable[[Robot, Motion], object], why: str, planar: Robot
) -> None:
    with pytest.raises(BadInput, match=why) as refusal:
        make(planar, smooth(planar, np.arange(0, 1, 0.01)))
    assert "\n" not in str(refusal.value)


def test_an_arm_with_driving_friction_diverges_and_says_where(planar: Robot) -> None:
    motion = smooth(planar, np.arange(0, 5, 0.01))
    robot = planar.with_effects((ViscousFriction(planar.joints, (0.0, -3.0)),))
    with pytest.raises(Diverged, match="diverges at t =") as refusal:
        forward_error(robot, motion, torque(planar.with_effects(()), motion), bandwidth_hz=1.0)
    assert isinstance(refusal.value, ExcitantError)
    assert refusal.value.joint == planar.joints[1]
    assert 0 < refusal.value.t < 5
