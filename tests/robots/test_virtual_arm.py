"""Laws of the plant, judged by MuJoCo, by the balance of power and by the effects' own formulas."""

from __future__ import annotations

import mujoco
import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
from plant_recordings import RATE, SMOOTH, Recorded, hold, swing, true_arm

from excitant.exceptions import BadInput, BadRobot, UnknownName
from excitant.robots import (
    Motion,
    Robot,
    base_parameters,
    load_robot,
    torque,
)
from excitant.robots.effects import EFFECTS, RotorInertia
from excitant.robots.parameters import violations
from excitant.robots.plant import run as plant_run
from excitant.robots.plant.arm import Arm
from excitant.robots.plant.controller import tracking_controller
from excitant.robots.plant.planting import plant
from excitant.robots.virtual_arm import (
    HiddenEffect,
    Sensors,
    draw_hidden_effect,
    ideal_sensors,
    industrial_sensors,
    nominal_truth,
    typical_torque,
)
from excitant.robots.virtual_arm import virtual_arm as build


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
    builtin: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    bare, errors = builtin.with_effects(()), []
    for step in (5e-4, 2.5e-4):
        monkeypatch.setattr(plant_run, "_STEP", step)
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


def test_a_stuck_joint_stays_while_the_others_move(builtin: Robot) -> None:
    j = builtin.nv - 1
    grip = HiddenEffect("coulomb_friction", builtin.joints[j], (("Fc", 1e4),))
    run = Recorded(builtin, grip, duration=1.0).table
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


def test_same_seed_same_recording(builtin: Robot) -> None:
    def once(seed: int) -> pd.DataFrame:
        rng = np.random.default_rng(seed)
        return build(builtin, rng).record(swing(builtin), 0.5, rng)

    pd.testing.assert_frame_equal(once(3), once(3), check_exact=True)
    assert not once(3).equals(once(4))


def test_truth_is_near_the_nominal_arm_and_possible(arm: Robot) -> None:
    for seed in range(10):
        truth = build(arm, np.random.default_rng(seed), hidden=())
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


def test_drawn_effects_are_of_every_kind_and_show(builtin: Robot) -> None:
    drawn = [draw_hidden_effect(builtin, np.random.default_rng(seed)) for seed in range(60)]
    assert {effect.effect for effect in drawn} == {
        "viscous_friction",
        "coulomb_friction",
        "stribeck_friction",
        "torque_offset",
        "rotor_inertia",
        "payload",
    }
    motion = Motion(np.arange(200.0), *builtin.random_motion(np.random.default_rng(1), 200))
    half = Motion(motion.t, motion.q, motion.dq / 2, motion.ddq / 2)
    slow = Motion(motion.t, motion.q, motion.dq / 40, motion.ddq / 2)
    typical, noise = typical_torque(builtin), industrial_sensors(builtin).torque_noise
    for hidden in drawn:
        parameters = dict(hidden.parameters)
        shape = {k: parameters.pop(k) for k in ("velocity",) if k in parameters}
        effect = EFFECTS[hidden.effect]((hidden.joint,), **shape).with_values(
            [*parameters.values()]
        )
        at = slow if shape else half
        size = np.sqrt(np.mean(effect.torque(builtin, at) ** 2, axis=0))
        assert (size >= 0.05 * typical).any(), hidden
        assert (size >= 3 * noise).any(), hidden
        assert (size <= np.maximum(typical, 6 * noise)).all(), hidden


def test_rotor_inertia_is_drawn_only_where_it_can_be_told(builtin: Robot) -> None:
    """Its column must not be a combination of the columns of the links."""
    drawn = (draw_hidden_effect(builtin, np.random.default_rng(seed)) for seed in range(60))
    joints = {effect.joint for effect in drawn if effect.effect == "rotor_inertia"}
    rigid = len(base_parameters(builtin))
    separable = {
        joint
        for joint in builtin.joints
        if len(base_parameters(builtin, [RotorInertia((joint,))])) > rigid
    }
    assert builtin.joints[0] not in separable
    assert joints == separable


def test_recording_has_the_columns_rate_and_noise_of_its_sensors(builtin: Robot) -> None:
    nv = builtin.nv
    noise, step = np.full(nv, 0.2), np.full(nv, 0.05)
    sensors = Sensors(200.0, 1e-3, 0.01, noise, step)
    kwargs = {"hidden": (), "tolerance": 0.0}
    real = build(builtin, np.random.default_rng(0), sensors=sensors, **kwargs)
    true = build(builtin, np.random.default_rng(0), sensors=ideal_sensors(builtin, 200.0), **kwargs)
    seen, truth = (a.record(swing(builtin), 2.0, np.random.default_rng(1)) for a in (real, true))
    numbers = range(1, nv + 1)
    assert list(seen) == ["t", *(f"{c}{j}" for c in ("q", "dq", "tau") for j in numbers)]
    assert np.allclose(seen["t"], np.arange(401) / 200, rtol=0, atol=1e-12)
    error = seen - truth
    assert np.abs(error.filter(regex=r"^q")).to_numpy().max() <= 0.5e-3 + 1e-12
    assert error.filter(regex=r"^dq").to_numpy().std() == pytest.approx(0.01, rel=0.1)
    assert error.filter(regex=r"^tau").to_numpy().std() == pytest.approx(0.2, rel=0.1)
    counts = seen.filter(regex=r"^tau").to_numpy() / 0.05
    assert np.allclose(counts, np.round(counts), atol=1e-6)


def test_torque_never_exceeds_the_limits(builtin: Robot) -> None:
    limits = builtin.limits
    weak = type(limits)(
        limits.position, limits.velocity, limits.acceleration, 0.5 * typical_torque(builtin)
    )
    run = Recorded(builtin.with_limits(weak), duration=0.5).table
    tau = run.filter(regex=r"^tau").to_numpy()
    assert (np.abs(tau) <= weak.torque).all()
    assert (np.abs(tau) == weak.torque).any()


def test_impossible_nominal_inertia_still_runs(builtin: Robot) -> None:
    phi = np.array(builtin.phi)
    phi[9] += 5.0
    strange = builtin.with_parameters(phi)
    assert violations(strange.phi, strange.links)
    run = build(strange, np.random.default_rng(0), hidden=()).record(
        swing(strange), 0.2, np.random.default_rng(0)
    )
    assert np.isfinite(run.to_numpy()).all()


def test_joint_that_moves_no_inertia_is_refused() -> None:
    robot = load_robot("planar_2r").with_effects(())
    empty = robot.with_parameters([*robot.phi[:10], 1e-16, *np.zeros(9)])
    with pytest.raises(BadRobot, match="joint2 moves nothing"):
        true_arm(empty).record(hold(empty), 0.1, np.random.default_rng(0))


def test_refusals(builtin: Robot) -> None:
    arm, rng = true_arm(builtin), np.random.default_rng(0)
    moving = swing(builtin)
    with pytest.raises(BadInput, match="starts at"):
        arm.record(lambda t, order: moving(t + 0.1, order), 1.0, rng)
    with pytest.raises(BadInput, match="shorter than one sample"):
        arm.record(moving, 0.0, rng)
    with pytest.raises(UnknownName, match="did you mean 'payload'"):
        build(builtin, rng, hidden=[HiddenEffect("payloads", builtin.joints[0], ())])
    with pytest.raises(UnknownName, match="joint"):
        build(builtin, rng, hidden=[HiddenEffect("rotor_inertia", "elsewhere", (("Ia", 1.0),))])
    empty = builtin.with_effects([EFFECTS["viscous_friction"](builtin.joints)])
    with pytest.raises(BadRobot, match="viscous_friction has no values"):
        build(empty, rng)
