"""Friction, drives and couplings against closed forms and the balance of energy."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from excitant.robots import Motion, Robot, rigid_body_torque
from excitant.robots.effects import (
    EFFECTS,
    AsymmetricFriction,
    CoulombFriction,
    Effect,
    FrictionCoupling,
    InertiaCoupling,
    LoadDependentFriction,
    NonlinearViscousFriction,
    PreslidingHysteresis,
    RotorInertia,
    Spring,
    StribeckFriction,
    ThermalFrictionDrift,
    TorqueOffset,
    TorqueRipple,
    ViscousFriction,
)
from excitant.robots.effects.history import bristles

States = Callable[[Robot, int, int], Motion]
LIMITS = {  # shapes in which effects are what they contain
    "nonlinear_viscous_friction": partial(NonlinearViscousFriction, exponent=1.0),
    "thermal_friction_drift": partial(ThermalFrictionDrift, time=1e15),
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
        ViscousFriction(one, (4.0,)): [-8.0, -0.4, 0.0, 0.2, 12.0],
        CoulombFriction(one, (4.0,)): [-4.0, -4.0, 0.0, 4.0, 4.0],
        StribeckFriction(one, (2.0,), velocity=0.1): [
            0.0,
            -2 * np.exp(-1.0),
            0.0,
            2 * np.exp(-0.25),
            0.0,
        ],
        NonlinearViscousFriction(one, (3.0,), exponent=2.0): [-12.0, -0.03, 0.0, 0.0075, 27.0],
        NonlinearViscousFriction(one, (3.0,), exponent=0.5): [
            -3 * np.sqrt(2),
            -3 * np.sqrt(0.1),
            0.0,
            3 * np.sqrt(0.05),
            3 * np.sqrt(3),
        ],
        AsymmetricFriction(one, (1.0, 2.0), viscous=False): [-2.0, -2.0, 0.0, 1.0, 1.0],
        AsymmetricFriction(one, (1.0, 2.0, 10.0, 20.0)): [-42.0, -4.0, 0.0, 1.5, 31.0],
    }
    for effect, tau in expected.items():
        np.testing.assert_allclose(first(effect, planar, motion), tau, rtol=1e-12, atol=1e-100)


@pytest.mark.parametrize(
    "effect",
    [
        ViscousFriction,
        CoulombFriction,
        StribeckFriction,
        NonlinearViscousFriction,
        LoadDependentFriction,
        AsymmetricFriction,
    ],
)
def test_friction_takes_power(gantry: Robot, random_states: States, effect: type[Effect]) -> None:
    motion = random_states(gantry, 3, 50)
    friction = effect(gantry.joints)
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
    loaded = gantry.with_effects((*gantry.effects, TorqueOffset(gantry.joints, (9.0,) * gantry.nv)))
    tau = LoadDependentFriction(gantry.joints, (share,) * gantry.nv).torque(loaded, motion)
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
        for effect, shape in ((CoulombFriction, {}), (PreslidingHysteresis, {"distance": distance}))
    )
    q, last = motion.q[:, 0], slice(-per_cycle - 1, None)
    loss = np.trapezoid(tau[last], q[last])
    expected = 4 * force * (amplitude - distance * np.tanh(amplitude / distance))
    assert loss == pytest.approx(expected, rel=2e-3)


def test_presliding_needs_motion_and_tends_to_coulomb_friction(planar: Robot) -> None:
    t = np.linspace(0, 6, 3001)
    rest = np.zeros((len(t), 2))
    still, one, force = Motion(t, rest + 0.7, rest, rest), planar.joints[:1], 5.0
    assert not PreslidingHysteresis(one, (force,)).torque(planar, still).any()
    moving = turning(np.sin(t), t)
    sizes = [
        np.abs(first(PreslidingHysteresis(one, (force,), distance=d), planar, moving)[1:])
        for d in (1e-1, 1e-2, 1e-3, 1e-10)
    ]
    rms = [float(np.sqrt((size**2).mean())) for size in sizes]
    assert (np.diff(rms) < 0).all()
    assert rms[0] > 0.5
    steady = np.sign(np.diff(moving.q[:, 0])) == np.sign(moving.dq[1:, 0])  # not while reversing
    assert sizes[-1][steady].max() < 1e-12


def test_warming_up_fades_exponentially(planar: Robot) -> None:
    effect = ThermalFrictionDrift(planar.joints[:1], (2.0, 3.0), time=20.0, start=5.0)
    t = np.array([0.0, 5.0, 25.0, 45.0, 1000.0])
    rates = np.tile([[-0.5]], (5, 2))
    tau = first(effect, planar, Motion(t, 0 * rates, rates, 0 * rates))
    fading = np.array([1.0, 1.0, np.exp(-1), np.exp(-2), 0.0])
    np.testing.assert_allclose(tau, -4.0 * fading, rtol=1e-12, atol=1e-20)


def test_ripple_repeats_with_its_order_and_no_sooner(gantry: Robot, random_states: States) -> None:
    motion, order = random_states(gantry, 7, 20), 17.0
    n = gantry.nv
    effect = TorqueRipple(gantry.joints, (0.3, 0.4) * n, order=order)
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

    tau = Spring(gantry.joints, values * n, lever=lever).torque(gantry, motion)
    expected = (energy(motion.q + step) - energy(motion.q - step)) / (2 * step)
    np.testing.assert_allclose(tau, expected, rtol=0, atol=1e-6)  # rounding over the step


@pytest.mark.parametrize("ratio", [1.0, -1.0, 0.4])
def test_coupled_friction_takes_the_power_of_its_shaft(
    gantry: Robot, random_states: States, ratio: float
) -> None:
    motion, viscous, coulomb = random_states(gantry, 9, 50), 1.5, 0.7
    pair = (gantry.joints[-1], gantry.joints[0])
    tau = FrictionCoupling(pair, (viscous, coulomb), ratio=ratio).torque(gantry, motion)
    shaft = motion.dq[:, -1] + ratio * motion.dq[:, 0]
    power = (tau * motion.dq).sum(axis=1)
    np.testing.assert_allclose(power, viscous * shaft**2 + coulomb * np.abs(shaft), rtol=1e-9)
    assert not tau[:, 1:-1].any()
    still = Motion(motion.t, motion.q, motion.dq - motion.dq, motion.ddq)
    assert not FrictionCoupling(pair, (1.0, 1.0)).torque(gantry, still).any()


def test_a_rotor_that_turns_with_two_joints_keeps_its_energy(planar: Robot) -> None:
    """Power into T = ½ J (a q̇₁ + b q̇₂)² is its rate; rotor inertias and coupling make it up."""
    J, a, b = 0.2, 3.0, -5.0
    t = np.linspace(0, 2, 4001)
    phase = np.outer(t, [3.0, 5.0]) + np.array([0.2, 1.0])
    motion = Motion(t, np.sin(phase), np.cos(phase) * [3, 5], -np.sin(phase) * [9, 25])
    effects = (
        RotorInertia(planar.joints, (J * a**2, J * b**2)),
        InertiaCoupling(planar.joints, (J * a * b,)),
    )
    tau = np.sum([effect.torque(planar, motion) for effect in effects], axis=0)
    T = J * (motion.dq @ [a, b]) ** 2 / 2
    power = (tau * motion.dq).sum(axis=1)
    rate = np.gradient(T, t)
    assert np.abs(power - rate)[1:-1].max() <= 1e-4 * np.abs(rate).max()
