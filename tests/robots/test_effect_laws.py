"""Each effect against closed forms, the balance of energy, or the arm moved by brute force."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import partial

import numpy as np
import pinocchio as pin
import pytest
import scipy.interpolate

from excitant.robots import Motion, Robot, rigid_body_torque, torque
from excitant.robots import effects as fx
from excitant.robots.effects import EFFECTS, Effect
from excitant.robots.effects.drive import play
from excitant.robots.effects.friction import bristles
from excitant.robots.urdf import robot_from_urdf

States = Callable[[Robot, int, int], Motion]
LIMITS = {  # shapes in which effects are what they contain
    "nonlinear_viscous_friction": partial(fx.NonlinearViscousFriction, exponent=1.0),
    "thermal_friction_drift": partial(fx.ThermalFrictionDrift, time=1e15),
}


def turning(q: np.ndarray, t: np.ndarray, nv: int = 2) -> Motion:
    """All joints at the same angles, derivatives by differences."""
    dq = np.gradient(q, t)
    return Motion(t, *(np.tile(x[:, None], (1, nv)) for x in (q, dq, np.gradient(dq, t))))


def speeds(dq: list[float], nv: int = 2) -> Motion:
    rates = np.tile(np.array(dq)[:, None], (1, nv))
    return Motion(np.arange(float(len(dq))), 0 * rates, rates, 0 * rates)


def first(effect: Effect, robot: Robot, motion: Motion) -> np.ndarray:
    j = robot.joint_index(effect.joints[0])
    return np.asarray(effect.torque(robot, motion)[:, j])


def test_static_friction_has_the_closed_forms(planar: Robot) -> None:
    one, at = planar.joints[:1], [-2.0, -0.1, 0.0, 0.05, 3.0]
    motion = speeds(at)
    expected = {
        fx.ViscousFriction(one, (4.0,)): [-8.0, -0.4, 0.0, 0.2, 12.0],
        fx.CoulombFriction(one, (4.0,)): [-4.0, -4.0, 0.0, 4.0, 4.0],
        fx.StribeckFriction(one, (2.0,), velocity=0.1): [
            0.0,
            -2 * np.exp(-1.0),
            0.0,
            2 * np.exp(-0.25),
            0.0,
        ],
        fx.NonlinearViscousFriction(one, (3.0,), exponent=2.0): [-12.0, -0.03, 0.0, 0.0075, 27.0],
        fx.NonlinearViscousFriction(one, (3.0,), exponent=0.5): [
            -3 * np.sqrt(2),
            -3 * np.sqrt(0.1),
            0.0,
            3 * np.sqrt(0.05),
            3 * np.sqrt(3),
        ],
        fx.AsymmetricFriction(one, (1.0, 2.0), viscous=False): [-2.0, -2.0, 0.0, 1.0, 1.0],
        fx.AsymmetricFriction(one, (1.0, 2.0, 10.0, 20.0)): [-42.0, -4.0, 0.0, 1.5, 31.0],
    }
    for effect, tau in expected.items():
        np.testing.assert_allclose(first(effect, planar, motion), tau, rtol=1e-12, atol=1e-100)


FRICTION = ["viscous", "coulomb", "stribeck", "nonlinear_viscous", "load_dependent", "asymmetric"]


@pytest.mark.parametrize("name", FRICTION)
def test_friction_takes_power(gantry: Robot, random_states: States, name: str) -> None:
    motion = random_states(gantry, 3, 50)
    friction = EFFECTS[f"{name}_friction"](gantry.joints)
    count = len(friction.parameters(gantry))
    valued = friction.with_values(np.random.default_rng(3).uniform(0.1, 2, count))
    assert (valued.torque(gantry, motion) * motion.dq >= 0).all()


@pytest.mark.parametrize("name", sorted(name for name, kind in EFFECTS.items() if kind.contains))
def test_an_effect_contains_what_it_says(planar: Robot, random_states: States, name: str) -> None:
    """Columns of the contained effects are combinations of its own, wherever joints move."""
    whole, one = EFFECTS[name], planar.joints[:1]
    effect = LIMITS.get(name, whole)(one)
    columns = effect.columns(planar, random_states(planar, 5, 40))[:, 0]
    for inner in whole.contains:
        part = EFFECTS[inner](one).columns(planar, random_states(planar, 5, 40))[:, 0]
        rest = part - columns @ np.linalg.lstsq(columns, part, rcond=None)[0]
        assert np.abs(rest).max() <= 1e-10 * np.abs(part).max()


def test_load_dependent_friction_grows_with_the_torque_of_the_bodies(
    gantry: Robot, random_states: States
) -> None:
    motion, share = random_states(gantry, 6, 20), 0.2
    loaded = gantry.with_effects(
        (*gantry.effects, fx.TorqueOffset(gantry.joints, (9.0,) * gantry.nv))
    )
    tau = fx.LoadDependentFriction(gantry.joints, (share,) * gantry.nv).torque(loaded, motion)
    expected = share * np.abs(rigid_body_torque(gantry, motion)) * np.sign(motion.dq)
    np.testing.assert_allclose(tau, expected, rtol=1e-12)


def test_bristles_follow_the_closed_form_between_reversals() -> None:
    turns, distance = np.array([0.0, 0.4, -0.3, 0.05, -1.0]), 0.1
    legs = [np.linspace(a, b, 300) for a, b in itertools.pairwise(turns)]
    q = np.concatenate([legs[0], *(leg[1:] for leg in legs[1:])])
    expected, state = [np.zeros(1)], 0.0
    for leg in legs:
        s = np.sign(leg[-1] - leg[0])
        z = s - (s - state) * np.exp(-np.abs(leg - leg[0]) / distance)
        expected.append(z[1:])
        state = z[-1]
    z = bristles(q, distance)
    np.testing.assert_allclose(z, np.concatenate(expected), rtol=0, atol=1e-12)
    coarse = np.isin(q, turns)  # what lies between two samples does not matter
    np.testing.assert_allclose(bristles(q[coarse], distance), z[coarse], rtol=0, atol=1e-12)
    assert np.abs(z).max() <= 1
    assert (np.diff(z) * np.diff(q) >= 0).all()


@pytest.mark.parametrize("distance", [0.02, 0.3, 2.0])
def test_hysteresis_loop_loses_what_dahls_law_says(planar: Robot, distance: float) -> None:
    """∮ F_c z dq = 4 F_c (A − δ tanh(A / δ)) per cycle of amplitude A, once it is periodic."""
    force, amplitude, per_cycle, cycles = 3.0, 0.5, 4000, 30
    phase = np.arange(cycles * per_cycle + 1) * 2 * np.pi / per_cycle
    motion = turning(amplitude * np.sin(phase), phase)
    tau = sum(
        first(effect(planar.joints[:1], (force,), **shape), planar, motion)
        for effect, shape in (
            (fx.CoulombFriction, {}),
            (fx.PreslidingHysteresis, {"distance": distance}),
        )
    )
    q, last = motion.q[:, 0], slice(-per_cycle - 1, None)
    loss = np.trapezoid(tau[last], q[last])
    expected = 4 * force * (amplitude - distance * np.tanh(amplitude / distance))
    assert loss == pytest.approx(expected, rel=2e-3)


def test_presliding_needs_motion_and_tends_to_coulomb_friction(planar: Robot) -> None:
    t = np.linspace(0, 6, 3001)
    rest = np.zeros((len(t), 2))
    still, one, force = Motion(t, rest + 0.7, rest, rest), planar.joints[:1], 5.0
    assert not fx.PreslidingHysteresis(one, (force,)).torque(planar, still).any()
    moving = turning(np.sin(t), t)
    sizes = [
        np.abs(first(fx.PreslidingHysteresis(one, (force,), distance=d), planar, moving)[1:])
        for d in (1e-1, 1e-2, 1e-3, 1e-10)
    ]
    rms = [float(np.sqrt((size**2).mean())) for size in sizes]
    assert (np.diff(rms) < 0).all()
    assert rms[0] > 0.5
    steady = np.sign(np.diff(moving.q[:, 0])) == np.sign(moving.dq[1:, 0])  # not while reversing
    assert sizes[-1][steady].max() < 1e-12


def test_warming_up_fades_exponentially(planar: Robot) -> None:
    effect = fx.ThermalFrictionDrift(planar.joints[:1], (2.0, 3.0), time=20.0, start=5.0)
    t = np.array([0.0, 5.0, 25.0, 45.0, 1000.0])
    rates = np.tile([[-0.5]], (5, 2))
    tau = first(effect, planar, Motion(t, 0 * rates, rates, 0 * rates))
    fading = np.array([1.0, 1.0, np.exp(-1), np.exp(-2), 0.0])
    np.testing.assert_allclose(tau, -4.0 * fading, rtol=1e-12, atol=1e-20)


def test_ripple_repeats_with_its_order_and_no_sooner(gantry: Robot, random_states: States) -> None:
    motion, order = random_states(gantry, 7, 20), 17.0
    n = gantry.nv
    effect = fx.TorqueRipple(gantry.joints, (0.3, 0.4) * n, order=order)
    tau = effect.torque(gantry, motion)
    ahead, half = (
        effect.torque(gantry, Motion(motion.t, motion.q + turn, motion.dq, motion.ddq))
        for turn in (2 * np.pi / order, np.pi / order)
    )
    np.testing.assert_allclose(ahead, tau, rtol=0, atol=1e-12)
    np.testing.assert_allclose(half, -tau, rtol=0, atol=1e-12)
    fine = turning(np.linspace(0, 1, 2000), np.linspace(0, 1, 2000), n)
    assert effect.torque(gantry, fine).max() == pytest.approx(0.5, rel=1e-4)


@pytest.mark.parametrize("lever", [False, True])
def test_spring_is_the_derivative_of_its_energy(
    gantry: Robot, random_states: States, lever: bool
) -> None:
    """½ k (q − q₀)², or M cos(q − q₀) of a weight on a lever."""
    k, rest, step = 50.0, 0.4, 1e-5
    motion, n = random_states(gantry, 8, 20), gantry.nv
    values = (k * np.sin(rest), -k * np.cos(rest)) if lever else (k, -k * rest)

    def energy(q: np.ndarray) -> np.ndarray:
        return k * np.cos(q - rest) if lever else k * (q - rest) ** 2 / 2

    tau = fx.Spring(gantry.joints, values * n, lever=lever).torque(gantry, motion)
    expected = (energy(motion.q + step) - energy(motion.q - step)) / (2 * step)
    np.testing.assert_allclose(tau, expected, rtol=0, atol=1e-6)  # rounding over the step


@pytest.mark.parametrize("ratio", [1.0, -1.0, 0.4])
def test_coupled_friction_takes_the_power_of_its_shaft(
    gantry: Robot, random_states: States, ratio: float
) -> None:
    motion, viscous, coulomb = random_states(gantry, 9, 50), 1.5, 0.7
    pair = (gantry.joints[-1], gantry.joints[0])
    tau = fx.FrictionCoupling(pair, (viscous, coulomb), ratio=ratio).torque(gantry, motion)
    shaft = motion.dq[:, -1] + ratio * motion.dq[:, 0]
    power = (tau * motion.dq).sum(axis=1)
    np.testing.assert_allclose(power, viscous * shaft**2 + coulomb * np.abs(shaft), rtol=1e-9)
    assert not tau[:, 1:-1].any()
    still = Motion(motion.t, motion.q, motion.dq - motion.dq, motion.ddq)
    assert not fx.FrictionCoupling(pair, (1.0, 1.0)).torque(gantry, still).any()


def test_a_rotor_that_turns_with_two_joints_keeps_its_energy(planar: Robot) -> None:
    """Power into T = ½ J (a q̇₁ + b q̇₂)² is its rate; rotor inertias and coupling make it up."""
    J, a, b = 0.2, 3.0, -5.0
    t = np.linspace(0, 2, 4001)
    phase = np.outer(t, [3.0, 5.0]) + np.array([0.2, 1.0])
    motion = Motion(t, np.sin(phase), np.cos(phase) * [3, 5], -np.sin(phase) * [9, 25])
    effects = (
        fx.RotorInertia(planar.joints, (J * a**2, J * b**2)),
        fx.InertiaCoupling(planar.joints, (J * a * b,)),
    )
    tau = np.sum([effect.torque(planar, motion) for effect in effects], axis=0)
    T = J * (motion.dq @ [a, b]) ** 2 / 2
    power = (tau * motion.dq).sum(axis=1)
    rate = np.gradient(T, t)
    assert np.abs(power - rate)[1:-1].max() <= 1e-4 * np.abs(rate).max()


STEP = 1e-3  # s


def smooth(robot: Robot, t: np.ndarray, seed: int = 0) -> Motion:
    """Two harmonics per joint, with exact derivatives."""
    rng = np.random.default_rng(seed)
    w = np.array([[1.5], [3.1]]) + rng.uniform(-0.3, 0.3, (2, robot.nv))
    size, phase = rng.uniform(0.2, 0.5, (2, robot.nv)), rng.uniform(0, 6.28, (2, robot.nv))
    angle = w * t[:, None, None] + phase
    return Motion(
        t,
        (size * np.sin(angle)).sum(axis=1),
        (size * w * np.cos(angle)).sum(axis=1),
        (-size * w**2 * np.sin(angle)).sum(axis=1),
    )


def moved(motion: Motion, j: int, shift: np.ndarray | float, scale: float = 1.0) -> Motion:
    q, dq, ddq = (np.array(values) for values in (motion.q, motion.dq, motion.ddq))
    q[:, j], dq[:, j], ddq[:, j] = scale * q[:, j] + shift, scale * dq[:, j], scale * ddq[:, j]
    return Motion(motion.t, q, dq, ddq)


def close(found: np.ndarray, expected: np.ndarray, relative: float) -> None:
    assert np.abs(found - expected).max() <= relative * np.abs(expected).max()


def test_encoder_offset_is_the_torque_at_the_true_angle(arm: Robot, random_states: States) -> None:
    motion, d = random_states(arm, 1, 10), 1e-5
    for j, joint in enumerate(arm.joints):
        ahead, behind = (rigid_body_torque(arm, moved(motion, j, s * d)) for s in (1, -1))
        column = fx.EncoderOffset((joint,)).columns(arm, motion)[:, :, 0]
        scale = np.abs(ahead).max()
        assert np.abs(column - (ahead - behind) / (2 * d)).max() <= 1e-7 * scale


def test_encoder_scale_is_the_torque_of_the_true_motion(arm: Robot) -> None:
    motion, d = smooth(arm, np.arange(0, 1, STEP)), 1e-5
    for j, joint in enumerate(arm.joints):
        ahead, behind = (rigid_body_torque(arm, moved(motion, j, 0.0, 1 + s * d)) for s in (1, -1))
        expected = ((ahead - behind) / (2 * d))[2:-2]
        column = fx.EncoderScale((joint,)).columns(arm, motion)[2:-2, :, 0]
        # differences in time: (w h)² of a frequency below 3.4 rad/s; rounding over d
        assert np.abs(column - expected).max() <= 1e-4 * np.abs(ahead).max()


TWIST = ("twist", '<origin xyz="0.1 0 0.05" rpy="1 0 0"/>', (0.2, -0.4, 1.0))  # behind the weld
SWING = ("swing", '<origin xyz="0 0.1 0" rpy="0 1.2 0"/>', (0.0, 0.0, 0.0))


@pytest.mark.parametrize(("joint", "origin", "rpy"), [TWIST, SWING])
def test_kinematic_error_is_the_torque_with_the_joint_moved(
    gantry: Robot,
    gantry_urdf: str,
    random_states: States,
    joint: str,
    origin: str,
    rpy: tuple[float, float, float],
) -> None:
    """Torque is quadratic in the place of a joint: half the difference is the linear part."""
    assert gantry_urdf.count(origin) == 1
    motion, d = random_states(gantry, 2, 20), np.array([0.03, -0.02, 0.05])
    before = origin.split('"')[1]
    torques = []
    for s in (1, -1):
        xyz = np.array([float(x) for x in before.split()]) + s * d
        after = origin.replace(before, " ".join(repr(float(x)) for x in xyz))
        text = gantry_urdf.replace(origin, after)
        torques.append(rigid_body_torque(robot_from_urdf(text, source="moved"), motion))
    shift = pin.rpy.rpyToMatrix(*rpy) @ d
    tau = fx.KinematicError((joint,), tuple(shift)).torque(gantry, motion)
    assert np.abs(tau - (torques[0] - torques[1]) / 2).max() <= 1e-9 * np.abs(torques[0]).max()
    # a cart that does not turn feels no difference
    assert tau.any() == (joint == "twist")


def test_gravity_direction_is_the_static_torque_it_changes(
    arm: Robot, random_states: States
) -> None:
    motion, change = random_states(arm, 3, 10), np.array([2.0, -1.0, 0.5])
    zero, torques = np.zeros(arm.nv), []
    for gravity in (arm.gravity + change, arm.gravity):
        model = arm.model.copy()
        model.gravity.linear = gravity
        data = model.createData()
        torques.append(np.array([pin.rnea(model, data, q, zero, zero) for q in motion.q]))
    tau = fx.GravityDirection(arm.joints, tuple(change)).torque(arm, motion)
    assert np.abs(tau - (torques[0] - torques[1])).max() <= 1e-11 * np.abs(torques).max()
    turned = arm.with_gravity(arm.gravity + change)
    close(rigid_body_torque(arm, motion) + tau, rigid_body_torque(turned, motion), 1e-11)


def with_friction(robot: Robot) -> Robot:
    n = robot.nv
    return robot.with_effects(
        (fx.ViscousFriction(robot.joints, (3.0,) * n), fx.TorqueOffset(robot.joints, (-2.0,) * n))
    )


@pytest.mark.parametrize("steps", [7, -7])
def test_time_delay_of_its_trial_is_the_torque_of_then(planar: Robot, steps: int) -> None:
    robot, t, delay = with_friction(planar), np.arange(0, 1, STEP), steps * STEP
    effect = fx.TimeDelay(planar.joints, (delay,), trial=delay)
    reading = torque(robot.with_effects((*robot.effects, effect)), smooth(robot, t))
    then = torque(robot, smooth(robot, t - delay))
    inside = slice(10, -10)
    close(reading[inside], then[inside], 1e-9)


def test_time_delay_is_linear_around_its_trial(planar: Robot) -> None:
    t, j = np.arange(0, 2, STEP), 1
    robot = with_friction(planar)
    motion = smooth(robot, t)
    for delay in (4e-3, 16e-3):
        effect = fx.TimeDelay(planar.joints[j:], (delay,), trial=8e-3)
        late = torque(robot, smooth(robot, t - delay)) - torque(robot, motion)
        tau = effect.torque(robot, motion)
        assert not tau[:, 0].any()
        curvature = np.abs(np.gradient(np.gradient(torque(robot, motion)[:, j], t), t)).max()
        bound = delay * abs(delay - 8e-3) * curvature / 2 * 1.01
        assert np.abs(tau[20:-20, j] - late[20:-20, j]).max() <= bound


def test_torque_gain_is_a_share_of_all_torque_but_its_own(planar: Robot) -> None:
    motion, j, gain = smooth(planar, np.arange(0, 1, 0.01)), 1, 0.15
    robot = with_friction(planar)
    carried = torque(robot, motion)
    effect, other = (
        fx.TorqueGain(robot.joints[j:], (gain,)),
        fx.TorqueGain(robot.joints[:1], (0.5,)),
    )
    for beside in ((), (effect,), (effect, other, fx.TimeDelay(robot.joints, (0.01,)))):
        seen = robot.with_effects((*robot.effects, *beside))
        tau = effect.torque(seen, motion)
        np.testing.assert_allclose(tau[:, j], gain * carried[:, j], rtol=1e-12)
        assert not tau[:, 0].any()
    bare = planar.with_effects(())
    tau = effect.torque(bare, motion)[:, j]
    np.testing.assert_allclose(tau, gain * rigid_body_torque(bare, motion)[:, j], rtol=1e-12)


def yielding(robot: Robot, motion: Motion, j: int, compliance: float) -> np.ndarray:
    """Torque of the bodies where one link lags by c τ, derivatives from a quintic spline."""
    q = np.array(motion.q)
    q[:, j] -= compliance * rigid_body_torque(robot, motion)[:, j]
    link = scipy.interpolate.make_interp_spline(motion.t, q[:, j], k=5)
    dq, ddq = np.array(motion.dq), np.array(motion.ddq)
    dq[:, j], ddq[:, j] = link(motion.t, 1), link(motion.t, 2)
    return rigid_body_torque(robot, Motion(motion.t, q, dq, ddq))


def test_joint_elasticity_is_the_torque_of_a_link_that_yields(ur10: Robot) -> None:
    motion, c = smooth(ur10, np.arange(0, 2, STEP)), 1e-5
    inside = slice(20, -20)
    for j in (1, 2, 4):
        soft, stiff = (yielding(ur10, motion, j, s * c)[inside] for s in (1, -1))
        column = fx.JointElasticity((ur10.joints[j],)).columns(ur10, motion)[inside, :, 0]
        close(column, (soft - stiff) / (2 * c), 1e-3)  # (w h)², fourth derivatives of the motion


def test_gap_that_never_opens_is_an_encoder_offset(ur10: Robot) -> None:
    """The shoulder lift carries the stretched arm all the time: always the same flank."""
    t, j, gap = np.arange(0, 1, STEP), 1, 2e-3
    zero = np.zeros((len(t), 6))
    motion = Motion(t, zero + 0.05 * np.sin(t)[:, None], zero, zero)
    load = rigid_body_torque(ur10, motion)[:, j]
    assert np.abs(load).min() > 1
    joint = (ur10.joints[j],)
    shift = -np.sign(load[0]) * gap / 2
    expected = fx.EncoderOffset(joint, (shift,)).torque(ur10, motion)
    close(fx.Backlash(joint, (gap,)).torque(ur10, motion), expected, 1e-6)


def test_backlash_changes_flank_with_the_load(ur10: Robot) -> None:
    t, j, gap = np.arange(0, 8, STEP), 4, 1e-3
    motion, joint = smooth(ur10, t), (ur10.joints[4],)
    load = rigid_body_torque(ur10, motion)[:, j]
    crossing = np.flatnonzero(np.diff(np.sign(load)))
    assert len(crossing) >= 4
    far = np.min(np.abs(np.arange(len(t))[:, None] - crossing), axis=1) > 400
    tau = fx.Backlash(joint, (gap,), trial=gap).torque(ur10, motion)
    flank = fx.EncoderOffset(joint, (gap / 2,)).torque(ur10, motion)
    expected = (-np.sign(load)[:, None] * flank)[far]
    close(tau[far], expected, 1e-6)
    assert np.abs(tau).max() > 3 * np.abs(expected).max()  # what lands and takes off is felt


@pytest.mark.parametrize("seed", range(5))
def test_play_stays_in_the_gap_and_on_the_flank_that_the_load_presses(seed: int) -> None:
    rng, gap = np.random.default_rng(seed), 0.01
    t = np.arange(0, 10, 2e-3)
    a = np.sin(np.outer(t, rng.uniform(1, 6, 4)) + rng.uniform(0, 6.28, 4)) @ rng.uniform(1, 9, 4)
    lag = play(t, a, gap)
    assert np.abs(lag).max() <= gap / 2
    for s in (1, -1):
        pressed = (lag[:-1] == s * gap / 2) & (s * a[1:] >= 0)
        np.testing.assert_array_equal(lag[1:][pressed], s * gap / 2)
    np.testing.assert_array_equal(play(t, np.abs(a) + 1, gap), gap / 2)
    np.testing.assert_array_equal(play(t, -np.abs(a) - 1, gap), -gap / 2)
    flying = np.abs(lag) < gap / 2
    jump = np.abs(np.diff(lag, 2))[~(flying[1:-1] ^ flying[2:]) & ~(flying[1:-1] ^ flying[:-2])]
    assert jump.max() <= np.abs(a).max() * 2e-3**2 * (1 + 1e-9)


@pytest.mark.parametrize(("gap", "slope"), [(1e-3, 5.0), (1e-2, 5.0), (1e-3, 300.0)])
def test_flight_through_a_gap_takes_its_time(gap: float, slope: float) -> None:
    """The lag's acceleration is a = −s t, so that the gap is crossed when s t³ / 6 = g."""
    h, expected = 1e-4, (6 * gap / slope) ** (1 / 3)
    t = np.arange(-0.5, 0.5, h)
    lag = play(t, -slope * t, gap)
    flight = t[np.argmax(lag == -gap / 2)] - t[np.argmax(t >= 0)]
    assert flight == pytest.approx(expected, abs=3 * h)
