"""Each effect against closed forms, the balance of energy, or the arm moved by brute force."""

import itertools

import numpy as np
import pytest
import scipy.interpolate
from khosla import close
from known_arms import Call
from plant_recordings import displaced, swinging

from excitant.robots import Motion, Robot, rigid_body_torque, torque
from excitant.robots import effects as fx
from excitant.robots.effects import EFFECTS
from excitant.robots.effects.drive import play
from excitant.robots.effects.friction import bristles

LIMITS = {  # shapes in which effects are what they contain
    "nonlinear_viscous_friction": {"exponent": 1.0},
    "thermal_friction_drift": {"time": 1e15},
}


def alike(t: np.ndarray, q: np.ndarray | float, dq: np.ndarray | float) -> Motion:
    """Both joints of a planar arm in the same states."""
    columns = (np.tile(np.reshape(x, (-1, 1)), 2) for x in np.broadcast_arrays(q, dq, 0 * t))
    return Motion(t, *columns)


T, V = np.array([0.0, 5.0, 25.0, 45.0, 1000.0]), np.array([-2.0, -0.1, 0.0, 0.05, 3.0])
SIGN, SPEED, FADING = np.sign(V), np.abs(V), np.exp([0.0, 0.0, -1.0, -2.0, -49.75])
COLD = {"time": 20.0, "start": 5.0}


@pytest.mark.parametrize(
    ("name", "shape", "values", "expected"),
    [
        ("viscous_friction", {}, (4.0,), 4 * V),
        ("coulomb_friction", {}, (4.0,), 4 * SIGN),
        ("stribeck_friction", {"velocity": 0.1}, (2.0,), 2 * SIGN * np.exp(-((V / 0.1) ** 2))),
        ("nonlinear_viscous_friction", {"exponent": 2.0}, (3.0,), 3 * SIGN * SPEED**2),
        ("nonlinear_viscous_friction", {"exponent": 0.5}, (3.0,), 3 * SIGN * np.sqrt(SPEED)),
        ("asymmetric_friction", {"viscous": False}, (1.0, 2.0), [-2.0, -2.0, 0.0, 1.0, 1.0]),
        ("asymmetric_friction", {}, (1.0, 2.0, 10.0, 20.0), [-42.0, -4.0, 0.0, 1.5, 31.0]),
        ("thermal_friction_drift", COLD, (2.0, 3.0), (2 * V + 3 * SIGN) * FADING),
    ],
)
def test_friction_has_its_closed_form(planar, name, shape, values, expected):
    effect = EFFECTS[name](planar.joints[:1], values, **shape)
    tau = effect.torque(planar, alike(T, 0.0, V))[:, 0]
    np.testing.assert_allclose(tau, expected, rtol=1e-12, atol=1e-100)


@pytest.mark.parametrize("name", [n for n in sorted(EFFECTS) if EFFECTS[n].search.contains])
def test_an_effect_contains_what_it_says(planar: Robot, random_states: Call, name: str) -> None:
    """Columns of the contained effects are combinations of its own, wherever joints move."""
    motion, whole, one = random_states(planar, 5, 40), EFFECTS[name], planar.joints[:1]
    columns = whole(one, **LIMITS.get(name, {})).columns(planar, motion)[:, 0]
    for inner in whole.search.contains:
        part = EFFECTS[inner](one).columns(planar, motion)[:, 0]
        fitted = columns @ np.linalg.lstsq(columns, part, rcond=None)[0]
        assert close(fitted, part)


def test_load_dependent_friction_grows_with_the_torque_of_the_bodies(gantry, random_states):
    motion, joints, n = random_states(gantry, 6, 20), gantry.joints, gantry.nv
    loaded = gantry.with_effects((*gantry.effects, fx.TorqueOffset(joints, (9.0,) * n)))
    tau = fx.LoadDependentFriction(joints, (0.2,) * n).torque(loaded, motion)
    expected = 0.2 * np.abs(rigid_body_torque(gantry, motion)) * np.sign(motion.dq)
    np.testing.assert_allclose(tau, expected, rtol=1e-12)


def test_bristles_follow_the_closed_form_between_reversals() -> None:
    turns, distance = np.array([0.0, 0.4, -0.3, 0.05, -1.0]), 0.1
    legs, levels = [np.zeros(1)], [np.zeros(1)]
    for a, b in itertools.pairwise(turns):
        leg, s = np.linspace(a, b, 300)[1:], np.sign(b - a)
        levels.append(s - (s - levels[-1][-1]) * np.exp(-np.abs(leg - a) / distance))
        legs.append(leg)
    q, expected = np.concatenate(legs), np.concatenate(levels)
    np.testing.assert_allclose(bristles(q, distance), expected, rtol=0, atol=1e-12)
    coarse = np.isin(q, turns)  # what lies between two samples does not matter
    np.testing.assert_allclose(bristles(q[coarse], distance), expected[coarse], rtol=0, atol=1e-12)
    assert (np.diff(bristles(q, distance)) * np.diff(q) >= 0).all()


@pytest.mark.parametrize("distance", [0.02, 0.3, 2.0])
def test_hysteresis_loop_loses_what_dahls_law_says(planar: Robot, distance: float) -> None:
    """∮ F_c z dq = 4 F_c (A − δ tanh(A / δ)) per cycle of amplitude A, once it is periodic."""
    force, amplitude, phase, one = 3.0, 0.5, np.linspace(0, 60 * np.pi, 120_001), planar.joints[:1]
    motion = alike(phase, amplitude * np.sin(phase), amplitude * np.cos(phase))
    dahl = fx.PreslidingHysteresis(one, (force,), distance=distance)
    tau = dahl.torque(planar, motion) + fx.CoulombFriction(one, (force,)).torque(planar, motion)
    loss = np.trapezoid(tau[-4001:, 0], motion.q[-4001:, 0])
    expected = 4 * force * (amplitude - distance * np.tanh(amplitude / distance))
    assert loss == pytest.approx(expected, rel=2e-3)


def test_ripple_repeats_with_its_order_and_no_sooner(planar: Robot) -> None:
    q, turns = np.linspace(0, 1, 2000), np.arange(3) * np.pi / 17
    effect = fx.TorqueRipple(planar.joints, (0.3, 0.4) * 2, order=17.0)
    tau, half, ahead = (effect.torque(planar, alike(q, q + x, 1.0)) for x in turns)
    np.testing.assert_allclose(ahead, tau, rtol=0, atol=1e-12)
    np.testing.assert_allclose(half, -tau, rtol=0, atol=1e-12)
    assert tau.max() == pytest.approx(0.5, rel=1e-4)


@pytest.mark.parametrize("lever", [False, True])
def test_spring_is_the_derivative_of_its_energy(planar: Robot, lever: bool) -> None:
    """½ k (q − q₀)², or M cos(q − q₀) of a weight on a lever."""
    k, rest, step, q = 50.0, 0.4, 1e-5, np.linspace(-4, 4, 41)
    values = (k * np.sin(rest), -k * np.cos(rest)) if lever else (k, -k * rest)
    x = q - rest + np.array([[step], [-step]])
    ahead, back = k * np.cos(x) if lever else k * x**2 / 2
    tau = fx.Spring(planar.joints[:1], values, lever=lever).torque(planar, alike(q, q, 0.0))[:, 0]
    np.testing.assert_allclose(tau, (ahead - back) / (2 * step), rtol=0, atol=1e-6)  # rounding


@pytest.mark.parametrize("ratio", [1.0, -1.0, 0.4])
def test_coupled_friction_takes_the_power_of_its_shaft(gantry, random_states, ratio):
    motion, viscous, coulomb = random_states(gantry, 9, 50), 1.5, 0.7
    pair = (gantry.joints[-1], gantry.joints[0])
    effect = fx.FrictionCoupling(pair, (viscous, coulomb), ratio=ratio)
    tau = effect.torque(gantry, motion)
    shaft = motion.dq[:, -1] + ratio * motion.dq[:, 0]
    power = (tau * motion.dq).sum(axis=1)
    np.testing.assert_allclose(power, viscous * shaft**2 + coulomb * np.abs(shaft), rtol=1e-9)
    assert not tau[:, 1:-1].any()
    assert not effect.torque(gantry, Motion(motion.t, motion.q, 0 * motion.q, motion.ddq)).any()


def test_a_rotor_that_turns_with_two_joints_keeps_its_energy(planar: Robot) -> None:
    """Power into T = ½ J (a q̇₁ + b q̇₂)² is its rate; rotor inertias and coupling make it up."""
    J, a, b = 0.2, 3.0, -5.0
    motion = swinging(planar, np.linspace(0, 2, 4001))
    rotors = fx.RotorInertia(planar.joints, (J * a**2, J * b**2)).torque(planar, motion)
    tau = rotors + fx.InertiaCoupling(planar.joints, (J * a * b,)).torque(planar, motion)
    rate = np.gradient(J * (motion.dq @ [a, b]) ** 2 / 2, motion.t)
    error = (tau * motion.dq).sum(axis=1) - rate
    assert np.abs(error)[1:-1].max() <= 1e-4 * np.abs(rate).max()


STEP = 1e-3  # s


def moved(motion: Motion, j: int, shift: float, scale: float) -> Motion:
    unit = np.eye(motion.nv)[j]
    q, dq, ddq = (x * (1 + scale * unit) for x in (motion.q, motion.dq, motion.ddq))
    return Motion(motion.t, q + shift * unit, dq, ddq)


# differences in time: (w h)² of a frequency below 5 rad/s; rounding over the change
@pytest.mark.parametrize(("kind", "bound"), [(fx.EncoderOffset, 1e-7), (fx.EncoderScale, 1e-4)])
def test_encoder_errors_are_the_torque_of_the_true_motion(arm, kind, bound):
    motion = swinging(arm, np.arange(0, 1, STEP))
    shift, scale = (1e-5, 0.0) if kind is fx.EncoderOffset else (0.0, 1e-5)
    for j, joint in enumerate(arm.joints):
        moves = (moved(motion, j, s * shift, s * scale) for s in (1, -1))
        ahead, behind = (rigid_body_torque(arm, move) for move in moves)
        error = kind((joint,)).columns(arm, motion)[:, :, 0] - (ahead - behind) / 2e-5
        assert np.abs(error)[2:-2].max() <= bound * np.abs(ahead).max()


@pytest.mark.parametrize("joint", ["twist", "swing"])
def test_kinematic_error_is_the_torque_with_the_joint_moved(gantry, random_states, joint):
    """Torque is quadratic in the place of a joint: half the difference is the linear part."""
    motion, d = random_states(gantry, 2, 20), np.array([0.03, -0.02, 0.05])
    moves = (displaced(gantry, gantry.joint_index(joint), s * d) for s in (1, -1))
    ahead, behind = (rigid_body_torque(move, motion) for move in moves)
    tau = fx.KinematicError((joint,), tuple(d)).torque(gantry, motion)
    assert np.abs(tau - (ahead - behind) / 2).max() <= 1e-9 * np.abs(ahead).max()
    assert tau.any() == (joint == "twist")  # a cart that does not turn feels no difference


def test_gravity_direction_is_the_torque_it_changes(arm: Robot, random_states: Call) -> None:
    motion, change = random_states(arm, 3, 10), np.array([2.0, -1.0, 0.5])
    tau = fx.GravityDirection(arm.joints, tuple(change)).torque(arm, motion)
    turned = rigid_body_torque(arm.with_gravity(arm.gravity + change), motion)
    assert close(rigid_body_torque(arm, motion) + tau, turned, 1e-11)


@pytest.fixture(scope="module")
def rubbing(planar: Robot) -> Robot:
    j = planar.joints
    return planar.with_effects([fx.ViscousFriction(j, (3, 3)), fx.TorqueOffset(j, (-2, -2))])


@pytest.mark.parametrize(
    ("delay", "trial"), [(7e-3, 7e-3), (-7e-3, -7e-3), (4e-3, 8e-3), (16e-3, 8e-3)]
)
def test_time_delay_is_the_torque_of_then_to_first_order_around_its_trial(rubbing, delay, trial):
    t, joint = np.arange(0, 2, STEP), rubbing.joints[1:]
    late = fx.TimeDelay(joint, (delay,), trial=trial).torque(rubbing, swinging(rubbing, t))
    assert not late[:, 0].any()
    on_time, then = (torque(rubbing, swinging(rubbing, x))[:, 1] for x in (t, t - delay))
    curvature = np.abs(np.gradient(np.gradient(on_time, t), t)).max()
    bound = abs(delay * (delay - trial)) * curvature / 2 * 1.01 + 1e-9 * np.abs(then).max()
    assert np.abs(on_time + late[:, 1] - then)[20:-20].max() <= bound


def test_torque_gain_is_a_share_of_all_torque_but_its_own(rubbing: Robot) -> None:
    motion, gain, (one, two) = swinging(rubbing, np.arange(0, 1, 0.01)), 0.15, rubbing.joints
    effect, other = fx.TorqueGain((two,), (gain,)), fx.TorqueGain((one,), (0.5,))
    carried = torque(rubbing, motion)[:, 1]
    for beside in ((), (effect,), (effect, other, fx.TimeDelay((one, two), (0.01,)))):
        tau = effect.torque(rubbing.with_effects((*rubbing.effects, *beside)), motion)
        np.testing.assert_allclose(tau[:, 1], gain * carried, rtol=1e-12)
        assert not tau[:, 0].any()
    for effects in ((), (fx.CoulombFriction((one, two)),)):  # without values: left out
        tau = effect.torque(rubbing.with_effects(effects), motion)[:, 1]
        np.testing.assert_allclose(tau, gain * rigid_body_torque(rubbing, motion)[:, 1], rtol=1e-12)


def yielding(robot: Robot, motion: Motion, j: int, compliance: float) -> np.ndarray:
    """Torque of the bodies where one link lags by c τ, derivatives from a quintic spline."""
    lag = compliance * np.outer(rigid_body_torque(robot, motion)[:, j], np.eye(robot.nv)[j])
    link = scipy.interpolate.make_interp_spline(motion.t, motion.q - lag, k=5)
    return rigid_body_torque(robot, Motion(motion.t, *(link(motion.t, k) for k in range(3))))


@pytest.mark.parametrize("j", [1, 2, 4])
def test_joint_elasticity_is_the_torque_of_a_link_that_yields(ur10: Robot, j: int) -> None:
    motion, c = swinging(ur10, np.arange(0, 2, STEP)), 1e-5
    soft, stiff = (yielding(ur10, motion, j, s * c) for s in (1, -1))
    column = fx.JointElasticity((ur10.joints[j],)).columns(ur10, motion)[:, :, 0]
    assert close(column[20:-20], ((soft - stiff) / (2 * c))[20:-20], 1e-3)  # (w h)²


def test_noise_of_positions_does_not_hide_elasticity(ur10: Robot) -> None:
    """The column of a measured motion of 8 s, noise of 20 µrad, is that of the true one to 10 %."""
    t, j = np.arange(0, 8, 0.008), 1
    joint, true = fx.JointElasticity((ur10.joints[j],)), swinging(ur10, t)
    noise = np.random.default_rng(0).normal(0, 2e-5, true.q.shape)
    b = scipy.signal.butter(4, 20.0, fs=125.0, output="sos")
    q = scipy.signal.sosfiltfilt(b, noise, axis=0)
    dq = np.gradient(q, 0.008, axis=0)
    seen = Motion(t, true.q + q, true.dq + dq, true.ddq + np.gradient(dq, 0.008, axis=0))
    column, clean = (joint.columns(ur10, x)[60:-60, j, 0] for x in (seen, true))
    assert np.std(column - clean) < 0.1 * np.std(clean)


def test_backlash_changes_flank_with_the_load(ur10: Robot) -> None:
    t, j, gap = np.arange(0, 8, STEP), 4, 1e-3
    motion, joint = swinging(ur10, t), (ur10.joints[4],)
    load = rigid_body_torque(ur10, motion)[:, j]
    crossing = np.flatnonzero(np.diff(np.sign(load)))
    assert len(crossing) >= 4
    far = np.min(np.abs(np.arange(len(t))[:, None] - crossing), axis=1) > 400
    tau = fx.Backlash(joint, (gap,), trial=gap).torque(ur10, motion)
    flank = fx.EncoderOffset(joint, (gap / 2,)).torque(ur10, motion)
    expected = (-np.sign(load)[:, None] * flank)[far]
    assert close(tau[far], expected, 1e-6)
    assert np.abs(tau).max() > 3 * np.abs(expected).max()  # what lands and takes off is felt


@pytest.mark.parametrize("seed", range(5))
def test_play_stays_in_the_gap_and_on_the_flank_that_the_load_presses(seed: int) -> None:
    rng, gap = np.random.default_rng(seed), np.float64(0.01)
    t = np.arange(0, 10, 2e-3)
    a = np.sin(np.outer(t, rng.uniform(1, 6, 4)) + rng.uniform(0, 6.28, 4)) @ rng.uniform(1, 9, 4)
    lag = play(t, a, gap)
    assert np.abs(lag).max() <= gap / 2
    for s in (1, -1):
        pressed = (lag[:-1] == s * gap / 2) & (s * a[1:] >= 0)
        np.testing.assert_array_equal(lag[1:][pressed], s * gap / 2)
        np.testing.assert_array_equal(play(t, s * (np.abs(a) + 1), gap), s * gap / 2)
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
