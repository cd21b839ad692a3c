"""Curves of friction are the effects' own torque, with the uncertainty of their coefficients."""

from dataclasses import replace

import numpy as np
import pytest
from known_arms import Call

from excitant.identify import Estimate, Recording, identify_robot
from excitant.identify.friction import curves_over_velocity, friction_curves
from excitant.robots import Motion, Robot
from excitant.robots.effects import CoulombFriction, RotorInertia, StribeckFriction, ViscousFriction


@pytest.fixture(scope="module")
def recordings(planar: Robot, runs: Call, own_steps: None) -> list[Recording]:
    return runs(planar, 3, duration=12.0)


@pytest.fixture(scope="module")
def estimate(planar: Robot, recordings: list[Recording]) -> Estimate:
    effects = [RotorInertia(planar.joints), StribeckFriction(("joint2",), velocity=0.2)]
    effects += [ViscousFriction(("joint2", "joint1")), CoulombFriction(("joint2",))]
    return identify_robot(planar, recordings[0], validate=recordings[1], effects=effects)


def test_a_curve_is_the_torque_of_the_joints_friction(estimate: Estimate, planar: Robot) -> None:
    friction = [e for e in estimate.model.effects if e.family == "friction"]
    for j, curve in enumerate(friction_curves(estimate)):
        v = np.zeros((len(curve.velocity), 2))
        v[:, j] = curve.velocity
        motion = Motion(np.arange(float(len(v))), 0 * v, v, 0 * v)
        torque = sum(effect.torque(planar, motion)[:, j] for effect in friction)
        np.testing.assert_allclose(curve.torque, torque, rtol=1e-9)
        seen = estimate.series()["velocity"][:, j]
        assert np.nanmin(seen) <= curve.velocity[0] < curve.velocity[-1] <= np.nanmax(seen)
        assert (curve.velocity != 0).all()
        assert curve.entry() == {"unit": "N·m", "velocity_unit": "rad/s", "per_reading": 1.0}


def test_its_interval_is_that_of_draws_of_the_coefficients(estimate: Estimate) -> None:
    places = [estimate.base.names.index(f"joint2.{symbol}") for symbol in ("Fs", "Fv", "Fc")]
    covariance = estimate.physical.covariance[np.ix_(places, places)]
    draws = np.random.default_rng(0).multivariate_normal(np.zeros(3), covariance, 20_000)
    curve = friction_curves(estimate)[1]
    v, sign = curve.velocity, np.sign(curve.velocity)
    spread = (draws @ np.array([sign * np.exp(-((v / 0.2) ** 2)), v, sign])).std(axis=0)
    np.testing.assert_allclose(curve.half_width, 1.96 * spread, rtol=0.05)


@pytest.mark.slow
def test_true_friction_lies_in_the_interval(planar: Robot, runs: Call, own_steps: None) -> None:
    inside, given = [], {effect.name: effect.values for effect in planar.effects}
    for seed in range(8):
        fit, held = runs(planar, seed)
        for j, curve in enumerate(friction_curves(identify_robot(planar, fit, validate=held))):
            Fv, Fc = (given[f"{kind}_friction"][j] for kind in ("viscous", "coulomb"))
            error = Fv * curve.velocity + Fc * np.sign(curve.velocity) - curve.torque
            inside.append((np.abs(error) <= curve.half_width).mean())
    assert np.mean(inside) > 0.8  # by chance below in one of some hundred such sets


def test_curves_of_currents_are_told_as_the_coefficients_are(planar, recordings):
    fit, held = (replace(run, tau=run.tau / [20.0, 5.0], unit="A") for run in recordings)
    known = identify_robot(planar, fit, validate=held)
    free = replace(known, drive=replace(known.drive, possible=0.0))  # no gain is known
    for found, unit in ((known, "N·m"), (free, "A")):
        rows = {row["name"]: row["value"] for row in found.result()["parameters"]}
        for j, curve in enumerate(friction_curves(found)):
            v, (Fv, Fc) = curve.velocity, (rows[f"{curve.joint}.{x}"] for x in ("Fv", "Fc"))
            np.testing.assert_allclose(curve.torque, Fv * v + Fc * np.sign(v))
            gain = known.drive.gains[j] if unit == "N·m" else 1.0
            assert (curve.unit, curve.per_reading) == (unit, pytest.approx(gain))


def test_joints_without_friction_have_no_curve(planar: Robot, recordings: list[Recording]) -> None:
    effects = [ViscousFriction(("joint1",)), RotorInertia(planar.joints)]
    curves = friction_curves(found := identify_robot(planar, recordings[0], effects=effects))
    assert curves[1] is None
    arrays = curves_over_velocity(curves)
    names = {f"friction_{name}" for name in ("velocity", "torque", "half_width")}
    assert {name: x.shape for name, x in arrays.items()} == dict.fromkeys(names, (100, 2))
    assert np.isnan(arrays["friction_torque"][:, 1]).all()
    assert ["friction" in joint for joint in found.result()["joints"]] == [True, False]
