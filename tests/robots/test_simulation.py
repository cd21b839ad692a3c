"""Forward dynamics of a model: closed forms, conservation, and simulators that share no code."""

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import scipy
from known_arms import Call
from marks import refused, slow
from plant_recordings import PENDULUM, energy, mujoco_model, swing, swinging

from excitant.exceptions import BadInput
from excitant.robots import Motion, Robot, simulation, torque
from excitant.robots import effects as fx
from excitant.robots.simulation import REST, Controller, Diverged, simulate

TIME = np.arange(0, 1.5, 5e-3)
pytestmark = pytest.mark.usefixtures("own_steps")


def falling(robot: Robot, t: np.ndarray, *q: float, step: float = 1e-3) -> Motion:
    """From rest at some position, without torque."""
    rest = np.zeros((len(t), robot.nv))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulation, "STEP", step)
        return simulate(robot, Motion(t, rest + q, rest, rest))


def with_drives(robot: Robot, rotor: float | np.ndarray, viscous: float | np.ndarray) -> Robot:
    drives = (fx.RotorInertia(robot.joints), rotor), (fx.ViscousFriction(robot.joints), viscous)
    return robot.with_effects([e.with_values(np.broadcast_to(x, robot.nv)) for e, x in drives])


@pytest.mark.parametrize("name", [slow("ur10"), "gantry"])
def test_energy_of_a_falling_arm_is_conserved(name: str, request: pytest.FixtureRequest) -> None:
    robot, spread = request.getfixturevalue(name), []
    for step in (1e-3, 5e-4):
        motion = falling(with_drives(robot, 0.3, 0.0), TIME, 0.3, step=step)
        E = energy(robot, np.full(robot.nv, 0.3), motion)
        spread.append(np.abs(E - E[0]).max())
    kinetic = np.abs(motion.dq).max() ** 2 * 0.3
    assert kinetic > 1  # it does fall
    assert spread[1] < 1e-3 * kinetic
    assert spread[1] < spread[0] / 3  # second order at least


def test_the_closed_loop_is_that_of_an_adaptive_solver(ur10: Robot) -> None:
    """Articulated-body algorithm under Dormand and Prince's method; a controller that errs."""
    robot, t, omega = ur10.with_effects(()), TIME, 20.0
    command, path = swinging(robot, t), swing(robot)
    rotor, viscous = np.linspace(0.2, 1, 6), np.linspace(1, 8, 6)
    model = robot.model.copy()
    model.armature = rotor
    data, believed = model.createData(), robot.model.createData()

    def slope(at: float, state: np.ndarray) -> np.ndarray:
        q, v = np.split(state, 2)
        qd, vd, ad = (path(np.array([at]), order)[0] for order in range(3))
        B = pin.crba(robot.model, believed, qd)
        forward = pin.rnea(robot.model, believed, qd, vd, ad)
        tau = forward + B @ (omega**2 * (qd - q) + 2 * omega * (vd - v)) - viscous * v
        return np.concatenate([v, pin.aba(model, data, q, v, tau)])

    start = np.concatenate([command.q[0], command.dq[0]])
    solved = scipy.integrate.solve_ivp(slope, (0, t[-1]), start, t_eval=t, rtol=1e-8, atol=1e-9).y.T
    motion = simulate(with_drives(robot, rotor, viscous), command, Controller(omega, robot))
    off = np.abs(command.q - solved[:, :6]).max()
    assert off > 0.01
    assert np.abs(motion.q - solved[:, :6]).max() < 2e-3 * off
    assert np.abs(motion.dq - solved[:, 6:]).max() < 2e-3 * np.abs(command.dq).max()
    slopes = np.array([slope(at, state)[6:] for at, state in zip(t, solved, strict=True)])
    assert np.abs(motion.ddq - slopes)[2:-2].max() < 5e-3 * np.abs(slopes).max()


def test_a_falling_arm_is_that_of_mujoco(planar: Robot) -> None:
    model = mujoco_model(planar)
    model.dof_armature[:], model.dof_damping[:] = 0.1, 0.2
    data, found = mujoco.MjData(model), []
    data.qpos[:] = 0.4, -0.6
    for _ in range(1001):
        found.append(data.qpos.copy())
        mujoco.mj_step(model, data)
    motion = falling(with_drives(planar, 0.1, 0.2), np.arange(101) / 100, 0.4, -0.6, step=5e-4)
    assert np.ptp(motion.q, axis=0).min() > 0.5
    np.testing.assert_allclose(motion.q, found[::10], atol=5e-5)


@pytest.mark.slow
def test_dry_friction_is_that_of_the_plant(ur10: Robot, runs: Call) -> None:
    """The virtual arm knows stiction as a set and shares no code; 3 % wrong masses for both."""
    [seen] = runs(ur10, 3, duration=4.0, names=["run"])
    motion = Motion(seen.t, seen.q, seen.dq, np.gradient(seen.dq, seen.t, axis=0))
    loops = (Controller(6.0, believed=ur10.with_parameters(s * ur10.phi)) for s in (1.0, 1.03))
    errors = (motion.q - simulate(ur10, motion, loop).q for loop in loops)
    right, wrong = (np.sqrt((error**2).mean(axis=0)).max() for error in errors)
    assert right < 1.5e-3
    assert wrong > 4 * right


def test_a_joint_held_by_dry_friction_creeps_no_faster_than_rest() -> None:
    held = PENDULUM.with_effects((fx.CoulombFriction(("joint",), (24.0,)),))
    motion = falling(held, np.arange(0, 2, 1e-2), np.pi / 2)  # gravity asks 19.62 N·m
    np.testing.assert_allclose(motion.dq[5:, 0], -19.62 / 24 * REST, rtol=1e-2)


def test_friction_heavier_than_its_joint_neither_chatters_nor_overshoots() -> None:
    """A rod of hardly any inertia: dry friction would turn it back within a thousandth step."""
    dry = PENDULUM.with_effects((fx.CoulombFriction(("joint",), (5.0,)),))
    robot, heavier = (dry.with_parameters(s * dry.phi) for s in (1e-4, 0.01 / 1.1))  # 0.01 kg·m²
    command = swinging(robot, np.arange(0, 3, 2e-3))
    motion = simulate(robot, command, Controller(40.0, believed=heavier))
    assert np.abs(motion.q - command.q).max() < 0.35  # 5 N·m over 0.01 · 40² N·m/rad
    assert (np.sign(motion.dq[:, 0]) == np.sign(command.dq[:, 0])).mean() > 0.95


def test_the_motor_gives_what_inverse_dynamics_asks(planar: Robot) -> None:
    """Also of an effect with a state of its own; torque low-passed on either side alike."""
    believed = with_drives(planar, 0.2, 0.8)
    effect = fx.PreslidingHysteresis(planar.joints, (1.0, 1.0), 0.02)
    robot = believed.with_effects((*believed.effects, effect))
    command, loop = swinging(planar, np.arange(0, 4, 2e-3)), Controller(believed=believed)
    motion, (K, C) = simulate(robot, command, loop), loop.gains(robot, command.q)
    tau = torque(believed, command) + np.einsum("kij,kj->ki", K, command.q - motion.q)
    tau += np.einsum("kij,kj->ki", C, command.dq - motion.dq)
    error = scipy.ndimage.uniform_filter1d(tau - torque(robot, motion), 50, axis=0)[25:-25]
    without = torque(robot, motion) - torque(believed, motion)
    assert np.sqrt((error**2).mean()) < 0.05 * np.sqrt((without**2).mean())


@pytest.mark.parametrize("count", [2, 300])
def test_irregular_time_is_followed(planar: Robot, count: int) -> None:
    t = np.cumsum(np.random.default_rng(0).uniform(2e-3, 9e-3, count))
    command = swinging(planar, t)
    assert np.abs(simulate(planar, command, Controller()).q - command.q).max() < 1e-4


def test_what_cannot_be_simulated_is_refused_in_one_line(planar: Robot) -> None:
    motion = swinging(planar, TIME)
    unknown = planar.with_effects([fx.ViscousFriction(planar.joints)])
    refused("two instants or more", simulate, planar, motion[:1], error=BadInput)
    refused("must rise", simulate, planar, motion[::-1], error=BadInput)
    refused("no values", simulate, unknown, motion, error=BadInput)


def test_an_arm_with_driving_friction_diverges_and_says_where(planar: Robot) -> None:
    motion = swinging(planar, np.arange(0, 5, 0.01))
    robot = planar.with_effects((fx.ViscousFriction(planar.joints, (0.0, -3.0)),))
    with pytest.raises(Diverged, match="diverges at t =") as refusal:
        simulate(robot, motion, Controller(2.0, believed=planar.with_effects(())))
    assert refusal.value.joint == planar.joints[1]
    assert 0 < refusal.value.t < 5
